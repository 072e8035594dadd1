"""What models of documents say of a place in them: its keys, an example, where else a key is."""

from __future__ import annotations

import difflib
import types
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

from pydantic import BaseModel, Tag

from statechart.documents.yaml_text import flow

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

# A key that is as like a known one as this is that one, misspelt.
_NEARLY = 0.8


def example(model: type[BaseModel], loc: Sequence[str | int], *, built: bool) -> str:
    """Return an example of what stands at `loc`, as it is written there; empty where none is told.

    That of a whole has those of its parts.
    """
    annotations: list[Any] = [model]
    shown: Any = None
    for part in loc:
        found = _field(annotations, part)
        below = list(_below(annotations, part)) or list(_tagged(annotations, part))
        if found is not None:
            shown = found.examples[0] if found.examples else None
        elif isinstance(shown, Mapping) and not isinstance(part, int):  # else a list of one
            shown = next(iter(shown.values()), None)
        elif isinstance(shown, list) and isinstance(part, int):
            shown = shown[min(part, len(shown) - 1)]
        annotations = below or annotations
    if shown is None:
        return ""
    return repr(shown) if built else flow(shown)


def _field(annotations: Sequence[Any], part: str | int) -> FieldInfo | None:
    """Return the field that a part of a place is."""
    for annotation in _members(annotations):
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            for name, field in annotation.model_fields.items():
                if part in (name, field.alias):
                    return field
    return None


def known_keys(model: type[BaseModel], loc: Sequence[str | int]) -> dict[str, str]:
    """Return the keys that the mapping at `loc` may have, and what Python calls these fields."""
    return {
        field.alias or name: name
        for annotation in _members(_reached(model, loc)[0])
        if isinstance(annotation, type) and issubclass(annotation, BaseModel)
        for name, field in annotation.model_fields.items()
    }


def other_word(model: type[BaseModel], loc: Sequence[str | int]) -> str:
    """Return what is written for a key that goes by another name at its place; empty for none."""
    key = str(loc[-1])
    for annotation in _members(_reached(model, loc[:-1])[0]):
        written: str = getattr(annotation, "OTHER_WORDS", {}).get(key, "")
        if written:
            return written
    return ""


def _reached(
    model: type[BaseModel], loc: Sequence[str | int]
) -> tuple[list[Any], tuple[str | int, ...]]:
    """Return what may stand at `loc`, and the fields on the way there."""
    annotations: list[Any] = [model]
    place: tuple[str | int, ...] = ()
    for part in loc:
        if _field(annotations, part) is not None:
            place = (*place, part)
        annotations = (
            list(_below(annotations, part)) or list(_tagged(annotations, part)) or annotations
        )
    return annotations, place


def elsewhere(model: type[BaseModel], loc: Sequence[str | int], known: Collection[str]) -> str:
    """Return of which parts a key is that has no meaning where it stands; empty for none.

    Those on the way to it come first. Of a key that is nearly a known one nothing is told.
    """
    key = str(loc[-1])
    if difflib.get_close_matches(key, known, cutoff=_NEARLY):
        return ""
    here = _reached(model, loc[:-1])[1]
    places = sorted(
        {place for place in _keyed(model, key) if place and place != here},
        key=lambda place: (-sum(part in loc for part in place), len(place), place),
    )
    if not places:
        return ""
    told = " and of ".join(".".join(place) for place in places[:2])
    return f"{key!r} is a key of {told}; known keys here: {', '.join(sorted(known))}"


def _keyed(
    annotation: Any, key: str, place: tuple[str, ...] = (), above: tuple[Any, ...] = ()
) -> Iterator[tuple[str, ...]]:
    """Yield the places of the parts, and of the mappings of known keys, that have a key."""
    for member in _members([annotation]):
        if isinstance(member, type) and issubclass(member, BaseModel):
            if member in above:  # states in states
                continue
            for name, field in member.model_fields.items():
                if (field.alias or name) == key:
                    yield place
                below = (*place, field.alias or name)
                yield from _keyed(field.annotation, key, below, (*above, member))
        else:
            arguments = get_args(member)
            if arguments and key in get_args(arguments[0]):
                yield place
            for argument in arguments:
                yield from _keyed(argument, key, place, above)


def _members(annotations: Sequence[Any]) -> Iterator[Any]:
    """Yield every alternative of the annotations, without what is only attached to them."""
    for annotation in annotations:
        if get_origin(annotation) is Annotated:
            yield from _members(get_args(annotation)[:1])
        elif get_origin(annotation) in (Union, types.UnionType):
            yield from _members(get_args(annotation))
        else:
            yield annotation


def _tagged(annotations: Sequence[Any], part: str | int) -> Iterator[Any]:
    """Yield the member of a union that pydantic calls `part` in the place of an error."""
    for annotation in annotations:
        if get_origin(annotation) is Annotated:
            member, *attached = get_args(annotation)
            if Tag(str(part)) in attached:
                yield member
            else:
                yield from _tagged([member], part)
        elif get_origin(annotation) in (Union, types.UnionType):
            yield from _tagged(get_args(annotation), part)


def _below(annotations: Sequence[Any], part: str | int) -> Iterator[Any]:
    for annotation in _members(annotations):
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            for name, field in annotation.model_fields.items():
                if part in (name, field.alias):
                    yield field.annotation
        elif isinstance(origin := get_origin(annotation), type):
            arguments = get_args(annotation)
            if issubclass(origin, Mapping):
                yield arguments[1]
            elif issubclass(origin, Sequence) and isinstance(part, int):
                yield arguments[0]
