"""Flattened regions against the plain interpreter of nested states."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from statechart.charts.chart import Region
from statechart.charts.flatten import FlatRegion, flatten
from statechart.documents.outputs import parse_events
from statechart.errors import DeclarationProblem
from tests.charts.scxml import EVENTS, Interpreter, numbered, random_region


def flat_of(region: dict[str, Any]) -> FlatRegion:
    return flatten("r", Region.model_validate(region))


def active(flat: FlatRegion, state: str) -> set[str]:
    """Return all states active in a configuration."""
    found = set()
    for leaf in flat.nesting.configurations.get(state, (state,)):
        found.add(leaf)
        while leaf in flat.superstates:
            leaf = flat.superstates[leaf]
            found.add(leaf)
    return found


def compare(region: dict[str, Any], events: list[str]) -> None:
    """Check that flat and nested do the same, in the same order."""
    reference = Interpreter(region)
    regions = {n for n in reference.order if reference.parent[n] is not None
               and reference.parallel(str(reference.parent[n]))}  # fmt: skip
    written, actions = numbered(region)
    flat = flat_of(written)
    state = flat.initial
    done = [actions[str(block["log"])] for block in flat.begins]
    for event in [None, *events]:
        if event is not None:
            reference.send(event)
            (wanted,) = parse_events(event)
            enabled = [t.place for t in flat.triggers[state] if wanted in t.declared.events]
            done = []
            if enabled:
                taken = flat.answer(state, enabled)
                assert taken.source == state
                state = taken.target
                done = [actions[str(block["log"])] for block in taken.blocks]
        assert active(flat, state) == reference.active
        expected = [what for what in reference.done if what.split()[1] not in regions]
        assert done == expected


@given(st.integers(0, 2**32), st.lists(st.sampled_from(EVENTS), min_size=1, max_size=12))
def test_flattened_charts_act_in_the_same_order(seed: int, events: list[str]) -> None:
    compare(random_region(Random(seed)), events)


NESTED: dict[str, Any] = {
    "initial": "off",
    "states": {
        "off": {},
        "on": {
            "initial": "low",
            "states": {"low": {}, "high": {}, "last": {"history": "shallow"}},
            "transitions": [{"name": "up", "from": "low", "to": "high", "on": "env.a"}],
        },
    },
    "transitions": [
        {"name": "leave", "from": "on", "to": "off", "on": "env.a or env.b"},
        {"name": "resume", "from": "off", "to": "last", "on": "env.b"},
        {"name": "start", "from": "off", "to": "on", "on": "env.a"},
    ],
}


def test_flat_states_remember_history() -> None:
    flat = flat_of(NESTED)
    assert flat.ordered == ("off", "low", "high", "off[last=high]")
    edges = {(t.name, t.source, t.target) for t in flat.transitions}
    assert edges == {
        ("start", "off", "low"), ("resume", "off", "low"),
        ("up", "low", "high"), ("leave", "low", "off"), ("leave", "high", "off[last=high]"),
        ("start", "off[last=high]", "low"), ("resume", "off[last=high]", "high"),
    }  # fmt: skip


def test_inner_transitions_come_before_outer_ones() -> None:
    flat = flat_of(NESTED)
    (event,) = parse_events("env.a")
    enabled = [t.place for t in flat.triggers["low"] if event in t.declared.events]
    assert len(enabled) == 2
    assert flat.answer("low", enabled).name == "up"


def test_one_event_triggers_all_regions() -> None:
    side = {"initial": "x0", "states": {"x0": {}, "x1": {}},
            "transitions": [{"name": "x", "from": "x0", "to": "x1", "on": "env.a"}]}  # fmt: skip
    other = {"initial": "y0", "states": {"y0": {}, "y1": {}},
             "transitions": [{"name": "y", "from": "y0", "to": "y1", "on": "env.a"}]}  # fmt: skip
    flat = flat_of({"initial": "both", "states": {"both": {"regions": {"x_": side, "y_": other}}}})
    taken = flat.answer("x0|y0", [t.place for t in flat.triggers["x0|y0"]])
    assert (taken.name, taken.target) == ("x+y", "x1|y1")
    assert taken in flat.transitions


def test_too_many_configurations_are_refused() -> None:
    def region(i: int) -> dict[str, Any]:
        return {
            "initial": f"a{i}",
            "states": {f"a{i}": {}, f"b{i}": {}},
            "transitions": [{"name": f"t{i}", "from": f"a{i}", "to": f"b{i}", "guard": f"x > {i}"}],
        }

    many = {f"r{i}": region(i) for i in range(13)}
    with pytest.raises(DeclarationProblem, match="more than 4096 configurations"):
        flat_of({"initial": "all", "states": {"all": {"regions": many}}})
