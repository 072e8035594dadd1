"""Serialisation of models as YAML text."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel
from ruamel.yaml import YAML, events

from statechart.documents.yaml_text import resolve, scalar

_FLOW_WIDTH = 80


def dump(model: BaseModel) -> str:
    """Return a model as YAML text that loads back to an equal model, without default values."""
    data = model.model_dump(by_alias=True, exclude_defaults=True)
    if hasattr(model, "kind"):
        data = {"kind": model.kind, **data}
    stream = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.width = 100
    yaml.allow_unicode = True
    yaml.emit(_document(data), stream)
    return stream.getvalue()


def _document(data: Any) -> Iterator[events.Event]:
    yield events.StreamStartEvent()
    yield events.DocumentStartEvent(explicit=False)
    yield from _yaml_events(data, block=True)
    yield events.DocumentEndEvent(explicit=False)
    yield events.StreamEndEvent()


def _yaml_events(value: Any, *, block: bool) -> Iterator[events.Event]:
    # Short values in flow style, others in block style.
    if isinstance(value, Mapping):
        flow = not block or _is_short(value)
        yield events.MappingStartEvent(None, None, implicit=True, flow_style=flow)
        for key, item in value.items():
            # Keys are text, also if they look like numbers.
            yield events.ScalarEvent(None, None, (True, True), str(key))
            yield from _yaml_events(item, block=not flow)
        yield events.MappingEndEvent()
    elif isinstance(value, list | tuple):
        flow = not block or _is_short(value)
        yield events.SequenceStartEvent(None, None, implicit=True, flow_style=flow)
        for item in value:
            yield from _yaml_events(item, block=not flow)
        yield events.SequenceEndEvent()
    else:
        text = scalar(value)
        quoted = isinstance(value, str) and not _reads_as_text(text)
        yield events.ScalarEvent(
            None, None, (not quoted, True), text, style='"' if quoted else None
        )


def _reads_as_text(text: str) -> bool:
    try:
        return isinstance(resolve(text), str)
    except ValueError:
        return False


def _is_short(value: Any) -> bool:
    items = list(value.values()) if isinstance(value, Mapping) else list(value)
    flat = not any(isinstance(item, Mapping | list | tuple) for item in items)
    return flat and len(str(value)) <= _FLOW_WIDTH
