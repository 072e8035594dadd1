"""Every field has a description, a unit and an example."""

from __future__ import annotations

import inspect
import json
import pydoc
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args
from urllib.request import urlopen

import jsonschema
import pytest
from pydantic import BaseModel

import contacts.testing
import statechart.testing
from statechart.cli.main import main
from statechart.documents.declaration import Declaration
from statechart.documents.fields import Part
from statechart.documents.yaml_reader import read
from statechart.loading.kind import kind, kinds
from statechart.loading.load import schema

FACES = (statechart, contacts, statechart.testing, contacts.testing)
NAMED = [getattr(face, name) for face in FACES for name in face.__all__]
PUBLIC = [named for named in NAMED if isinstance(named, type)]


def parts(model: type[BaseModel]) -> Iterator[type[BaseModel]]:
    """Yield the models that a document of a kind is made of."""
    waiting: list[Any] = [model]
    seen: set[type] = set()
    while waiting:
        annotation = waiting.pop()
        waiting += get_args(annotation)
        if isinstance(annotation, type) and issubclass(annotation, Part) and annotation not in seen:
            seen.add(annotation)
            yield annotation
            waiting += [field.annotation for field in annotation.model_fields.values()]


FIELDS = [
    pytest.param(part, name, id=f"{part.__name__}.{name}")
    for part in dict.fromkeys(part for name in kinds() for part in parts(kind(name).model))
    for name in part.model_fields
]


def measured(annotation: object) -> bool:
    """Return whether values of a type are numbers or formulas."""
    if annotation is float:
        return True
    return any(measured(part) for part in get_args(annotation) if not _is_part(part))


def _is_part(annotation: object) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, Part)


def test_all_fields_are_covered() -> None:
    assert len(FIELDS) > 110


@pytest.mark.parametrize(("part", "name"), FIELDS)
def test_every_field_has_a_description_and_an_example(part: type[Part], name: str) -> None:
    field = part.model_fields[name]
    assert field.description
    assert field.examples
    if measured(field.annotation):
        assert isinstance(field.json_schema_extra, dict)
        assert field.json_schema_extra["unit"]


@pytest.mark.parametrize("name", sorted(kinds()))
def test_examples_agree_with_the_schema_that_holds_them(name: str) -> None:
    whole = json.loads(schema(name))
    assert whole["$id"] == f"urn:contact-statecharts:schema:{name}"
    validator = jsonschema.Draft202012Validator
    validator.check_schema(whole)
    count = 0
    for model in ({"properties": whole["properties"]}, *whole["$defs"].values()):
        for field in model.get("properties", {}).values():
            assert field["description"]
            for example in field["examples"]:
                validator({**field, "$defs": whole["$defs"]}).validate(example)
                count += 1
    assert count > 30


@pytest.mark.parametrize("name", sorted(kinds()))
def test_the_description_of_a_part_excludes_those_of_its_fields(name: str) -> None:
    definitions = json.loads(schema(name))["$defs"].values()
    assert all("Parameters" not in model.get("description", "") for model in definitions)


def test_a_new_file_names_a_schema_that_it_agrees_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "mine"]) == 0
    first, *_ = (tmp_path / "mine.yaml").read_text(encoding="utf-8").splitlines()
    found = re.fullmatch(r"# yaml-language-server: \$schema=(file:///.*)", first)
    assert found is not None
    with urlopen(found[1]) as answer:
        named = json.load(answer)
    validator = jsonschema.Draft202012Validator(named)
    data = read(tmp_path / "mine.yaml").data
    validator.validate(data)
    assert not validator.is_valid({**data, "gravty": 9.81})


@pytest.mark.parametrize("named", NAMED, ids=lambda named: named.__name__)
def test_help_shows_no_addresses(named: object) -> None:
    said = pydoc.render_doc(named, renderer=pydoc.plaintext)
    assert not re.search(r"0x[0-9a-f]{6}", said)


def test_help_of_returned_objects_lists_public_methods() -> None:
    said = pydoc.render_doc(statechart.Result, renderer=pydoc.plaintext)
    for name in ("animate", "at", "diagram", "plot", "report", "save", "to_xarray"):
        assert re.search(rf"^ \|  {name}\(self", said, re.MULTILINE)
    for name in ("events", "outputs", "samples", "warnings"):
        assert re.search(rf"^ \|  {name}\b", said, re.MULTILINE)
    # The completions of a shell are complete.
    assert {"trace", "events", "__dict__"} <= set(dir(statechart.run("bouncing_ball_chart")))


@pytest.mark.parametrize("public", PUBLIC, ids=lambda public: public.__name__)
def test_help_reads_like_documentation(public: type) -> None:
    said = pydoc.render_doc(public, renderer=pydoc.plaintext)
    assert not re.search(r"0x[0-9a-f]{6}|pydantic_|Validator\(", said)
    assert inspect.getdoc(public)
    if issubclass(public, Part):
        for name, field in public.model_fields.items():
            assert re.search(rf"\| +{name} : ", said)
            assert (field.description or "")[:30] in " ".join(said.replace("|", " ").split())


def test_help_shows_a_unit_and_an_example() -> None:
    said = " ".join((inspect.getdoc(contacts.Body) or "").split())
    assert "mass : formula, optional Above 0; bodies that are fixed" in said
    assert "have none. Unit: mass. Example: ``m``." in said
    assert str(inspect.signature(contacts.Point)) == "(*, body, at=(0, 0))"


DECLARED = [public for public in PUBLIC if issubclass(public, Declaration)]


@pytest.mark.parametrize("public", DECLARED, ids=lambda public: public.__name__)
def test_help_of_a_document_lists_public_methods(public: type) -> None:
    said = pydoc.render_doc(public, renderer=pydoc.plaintext)
    assert not re.search(r"__\w+__", said)
    shown = re.findall(r"^ \|  (\w+)\(self", said, re.MULTILINE)
    assert shown == ["check", "diagram", "equations", "modes", "with_"]
