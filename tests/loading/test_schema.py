"""The committed JSON Schemas equal the generated ones; the shipped documents agree with them."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

import models
from statechart.documents.yaml_reader import read
from statechart.errors import DeclarationError
from statechart.loading.load import schema

FOLDER = Path(__file__).parents[2] / "docs" / "schema"


@pytest.mark.parametrize("kind", ["scene", "chart"])
def test_the_committed_schema_equals_the_output_of_the_verb(kind: str) -> None:
    assert (FOLDER / f"{kind}.json").read_text(encoding="utf-8") == schema(kind)


@pytest.mark.parametrize("kind", ["scene", "chart"])
def test_a_document_must_name_its_kind(kind: str) -> None:
    assert json.loads(schema(kind))["required"][0] == "kind"


def test_all_kinds_are_alternatives_of_one_schema() -> None:
    validator = jsonschema.Draft202012Validator(json.loads(schema()))
    chart = {
        "kind": "chart",
        "name": "a",
        "variables": {"x": 0},
        "regions": {"r": {"initial": "s", "states": {"s": {}}}},
    }
    scene = {"kind": "scene", "name": "a", "bodies": {"b": {"mass": 1}}}
    assert validator.is_valid(chart)
    assert validator.is_valid(scene)
    assert not validator.is_valid({**scene, "kind": "chart"})
    assert not validator.is_valid({**chart, "colour": "red"})


@pytest.mark.parametrize("name", models.names())
def test_shipped_models_agree_with_the_schema_that_they_name(name: str) -> None:
    path = models.path(name)
    assert path is not None
    first = path.read_text(encoding="utf-8").splitlines()[0]
    prefix = "# yaml-language-server: $schema="
    assert first.startswith(prefix)
    named = (path.parent / first.removeprefix(prefix)).resolve()
    jsonschema.validate(read(path).data, json.loads(named.read_text(encoding="utf-8")))


def test_unknown_kind_is_refused_with_the_known_ones() -> None:
    with pytest.raises(DeclarationError, match="chart, scene"):
        schema("statue")
