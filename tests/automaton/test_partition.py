"""Partition of a declaration into independent groups of entities."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from statechart.automaton.components import Data, split

MOVING = ("bodies", "contacts", "joints", "regions")
REGIONS = ("contacts", "regions")


@pytest.fixture
def schema(tmp_path: Path) -> Path:
    """A schema whose only word is "mass"."""
    file = tmp_path / "schema.json"
    file.write_text('{"properties": {"mass": {}}}')
    return file


def parts(schema: Path, **sections: Any) -> list[list[str]]:
    """Return the names in every part."""
    data: Data = {
        "bodies": {"p": {"mass": 1}, "q": {"mass": 1}},
        "surfaces": {"ground": {"height": 0}},
        "contacts": {
            "one": {"point": {"body": "p"}, "surface": "ground"},
            "two": {"point": {"body": "q"}, "surface": "ground"},
        },
        **sections,
    }
    return [sorted(names.values()) for _, names in split(data, MOVING, REGIONS, schema)]


APART = [["one", "p"], ["q", "two"]]


def test_uncoupled_bodies_are_separate_components(schema: Path) -> None:
    assert parts(schema) == APART


@pytest.mark.parametrize(
    "sections",
    [
        {"joints": {"rope": {"point": {"body": "p"}, "to": {"body": "q"}}}},
        {"regions": {"watch": {"states": {"on": {}}, "transitions": [{"guard": "p.x > q.x"}]}}},
        {"regions": {"r": {"on": "one.touchdown"}, "s": {"on": "two.touchdown and r.x"}}},
        {"surfaces": {"ground": {"height": 0, "body": "p"}}},
        {"stop": {"conditions": {"met": "p.x > q.x"}}},
    ],
)  # fmt: skip
def test_entities_that_read_two_bodies_couple_them(schema: Path, sections: Data) -> None:
    assert parts(schema, **sections) == []


def test_conditions_stay_with_their_component(schema: Path) -> None:
    data = {"conditions": {"far": "q.x > 1", "late": "time > 3"}}
    assert parts(schema, stop=data) == APART


def test_uncoupled_free_body_joins_the_first_component(schema: Path) -> None:
    found = parts(schema, bodies={"p": {}, "q": {}, "free": {"mass": 1}})
    assert found == [["free", "one", "p"], ["q", "two"]]


def test_renaming_skips_document_keywords(schema: Path) -> None:
    data: Data = {
        "bodies": {"mass": {}, "q": {}},
        "contacts": {"one": {"point": {"body": "mass"}}, "two": {"point": {"body": "q"}}},
    }
    (one, names), (other, _) = split(data, MOVING, REGIONS, schema)
    assert names["mass"] == "mass"
    assert one["bodies"].keys() == {"mass"}
    assert other["bodies"].keys() != {"q"}


def test_components_use_neutral_names(schema: Path) -> None:
    data: Data = {
        "bodies": {"p": {"start": {"x": "L"}}, "q": {"start": {"x": "L"}}},
        "contacts": {
            "one": {"point": {"body": "p"}, "enabled": "p.x < p.dx*L"},
            "two": {"point": {"body": "q"}, "enabled": "q.x < q.dx*L"},
        },
        "parameters": {"L": 1},
    }
    (one, _), (other, names) = split(data, MOVING, REGIONS, schema)
    assert one == other
    assert set(names.values()) == {"q", "two"}
