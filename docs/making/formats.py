"""The reference of the documents, out of the JSON Schemas that their models make."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from making.texts import in_cell, write
from statechart.loading.load import schema

KINDS = ("scene", "chart")

# Parts of a kind that have pages of their own, by subject; the page of the kind has the others.
PAGES = {
    "scene": {
        "bodies": ("Body", "Coordinate", "Force", "Path", "Point", "Shape", "Surface"),
        "contacts": (
            "Collision", "Contact", "Coupling", "Free", "Friction", "Joint", "Pin", "Slide",
            "StaticKinetic",
        ),
        "controllers": ("ControlRegion", "ControlState", "Controller", "Transition"),
    }
}  # fmt: skip

_FORMULA = {"string", "integer", "number"}

Schema = Mapping[str, Any]


def make(folder: Path) -> None:
    """Write a page for each kind of document."""
    for kind in KINDS:
        whole = json.loads(schema(kind))
        lines = [f"# Keys of a {kind}", "", f"{whole['description'].splitlines()[0]}", ""]
        lines += [
            "Made of the models that read the documents. [The format of documents](../format.md) "
            "says what the keys mean together; `statechart schema` prints the same as JSON Schema.",
            "",
        ]
        lines += _table(whole)
        apart = PAGES.get(kind, {})
        parts = dict(sorted(whole["$defs"].items()))
        for subject, names in apart.items():
            page = [f"# Keys of a {kind}: {subject}", ""]
            page += _sections(kind, {name: parts.pop(name) for name in names})
            write(folder / f"keys-of-a-{kind}-{subject}.md", _linked(page, kind))
        lines += _sections(kind, parts)
        lines += ["```{toctree}", ":hidden:", ""] if apart else []
        lines += [f"keys-of-a-{kind}-{subject}" for subject in apart]
        lines += ["```"] if apart else []
        write(folder / f"keys-of-a-{kind}.md", _linked(lines, kind))


def _sections(kind: str, parts: Schema) -> Iterator[str]:
    for name, part in parts.items():
        yield from (f"({kind}-{name.lower()})=", f"## {name}", "")
        yield from (part.get("description", "").splitlines()[0], "")
        yield from _table(part)


def _linked(lines: list[str], kind: str) -> Iterator[str]:
    for line in lines:
        yield line.replace("](#", f"](#{kind}-")


def _table(part: Schema) -> Iterator[str]:
    needed = part.get("required", ())
    yield from ("| key | value | default | meaning |", "|---|---|---|---|")
    for key, field in part.get("properties", {}).items():
        default = "needed" if key in needed else _default(field)
        yield f"| `{key}` | {in_cell(_value(field))} | {default} | {in_cell(_meaning(field))} |"
    yield ""


def _meaning(field: Schema) -> str:
    said = [field.get("description", "")]
    if "unit" in field:
        said.append(f"Unit: {field['unit']}.")
    if field.get("examples"):
        said.append("Such as " + ", ".join(f"`{_json(e)}`" for e in field["examples"]) + ".")
    return " ".join(filter(None, said))


def _default(field: Schema) -> str:
    # What is empty by default is not written, nor what has a table of its own.
    default = field.get("default")
    reported = default not in (None, [], "") and not isinstance(default, dict)
    return f"`{in_cell(_json(default))}`" if reported else ""


def _json(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _value(field: Schema) -> str:
    """Return in words what a key may have."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in field:
        return f"`{_json(field['const'])}`"
    if "enum" in field:
        return " or ".join(f"`{_json(value)}`" for value in field["enum"])
    for several in ("anyOf", "oneOf"):
        if several in field:
            return _one_of(field[several])
    match field.get("type"):
        case "array":
            return _list(field)
        case "object" if isinstance(field.get("additionalProperties"), Mapping):
            return f"name: {_value(field['additionalProperties'])}"
        case kind:
            return {"string": "text", "number": "number", "integer": "whole number",
                    "boolean": "true or false", "object": "name: value",
                    None: "anything"}[kind]  # fmt: skip


def _one_of(choices: list[Schema]) -> str:
    plain = {choice.get("type") for choice in choices if set(choice) <= {"type"}}
    found = []
    if plain >= _FORMULA:
        found, plain = ["formula"], plain - _FORMULA
    several = [c for c in choices if len(c) > 1 or not {"type", "$ref"}.intersection(c)]
    found += [_value(c) for c in choices if c.get("type") in plain - {"null"} or c in several]
    found += [_value(c) for c in choices if set(c) == {"$ref"}]
    return " or ".join(dict.fromkeys(found))


def _list(field: Schema) -> str:
    if "prefixItems" in field:
        return "[" + ", ".join(_value(item) for item in field["prefixItems"]) + "]"
    return f"list of {_value(field.get('items', {}))}"
