"""Superstates of contacts, and the edges of a drawn statechart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import statechart
from contacts.kind import automaton
from contacts.scene.scene import Scene
from models import names, path
from statechart.automaton.regions import Edge, Region, hierarchical_edges
from statechart.errors import DeclarationError
from statechart.running.runner import Runner


def contact(**declared: Any) -> Region:
    """Return the region of a contact of a rod."""
    scene = Scene.model_validate(
        {
            "name": "rod",
            "bodies": {"rod": {"mass": 1, "inertia": 1}},
            "surfaces": {"ground": {"height": 0}},
            "contacts": {
                "tip": {"point": {"body": "rod", "at": [1, 0]}, "surface": "ground"} | declared
            },
        }
    )
    (region,) = automaton(scene).regions
    return region


def test_contact_states_nest_pin_and_slide_in_closed() -> None:
    region = contact(friction=1, restitution=0)
    assert region.superstates == {
        "slide+": "slide", "slide-": "slide", "slide": "closed", "pin": "closed",
    }  # fmt: skip
    assert region.active("slide+") == ("slide+", "slide", "closed")
    assert region.active("free") == ("free",)
    assert set(region.within("closed")) == {"pin", "slide+", "slide-"}
    assert [region.declared(s) for s in ("slide-", "pin", "free")] == ["slide", "pin", "free"]


def test_thirteen_edges_of_a_contact_are_drawn_as_eight() -> None:
    region = contact(friction=1, restitution=0)
    flat = [e for e in region.edges if e.cause not in ("zeno", "jam")]
    drawn = [e for e in hierarchical_edges(region) if e.cause not in ("zeno", "jam")]
    assert (len(flat), len(drawn)) == (13, 8)
    ends = {(e.cause, e.source, e.target) for e in drawn}
    assert ends == {
        ("touchdown", "free", "closed"),
        ("touchdown", "free", "free"),
        ("liftoff", "closed", "free"),
        ("stick", "slide", "pin"),
        ("slip", "pin", "slide+"),
        ("slip", "pin", "slide-"),
        ("reverse", "slide+", "slide-"),
        ("reverse", "slide-", "slide+"),
    }
    (touchdown,) = (e for e in drawn if (e.cause, e.target) == ("touchdown", "closed"))
    resets = {c.target: c.reset for c in touchdown.choices}
    assert resets["pin"].endswith("slip := 0")
    assert resets["slide+"] == resets["slide-"] == "impact; dgap := 0"


@pytest.mark.parametrize("model", names())
def test_flattening_the_drawn_edges_gives_those_of_the_executor(model: str) -> None:
    for region in Runner(model).automaton.regions:
        drawn = hierarchical_edges(region)
        if region.nesting.configurations:
            # As declared; states show their entry and exit actions themselves.
            leaving = {(e.cause, source) for e in drawn for source in region.within(e.source)}
            assert leaving == {(e.cause, e.source) for e in region.edges}
            continue
        flat = [
            Edge(edge.cause, source, choice.target, edge.guard, choice.reset, edge.on_zeno)
            for edge in drawn
            for source in region.within(edge.source)
            for choice in edge.choices
        ]
        assert len(drawn) <= len(region.edges)
        assert sorted(map(repr, flat)) == sorted(map(repr, region.edges))


@pytest.fixture
def stick(tmp_path: Path) -> Callable[[str], Path]:
    """Return a function that writes the shipped stick with other final sections."""
    shipped = path("toppling_stick")
    assert shipped is not None
    text = shipped.read_text(encoding="utf-8")

    def written(end: str) -> Path:
        file = tmp_path / "stick.yaml"
        file.write_text(text[: text.index("\noutputs:")] + end, encoding="utf-8")
        return file

    return written


def test_a_superstate_serves_in_outputs_as_a_state_does(stick: Callable[[str], Path]) -> None:
    outputs = """
outputs:
  touches: {integral: 1, during: {tip: closed}}
  pinned: {integral: 1, during: {tip: pin}}
  slides: {integral: 1, during: {tip: slide}}
  closes: {count: tip.closed}
"""
    found = statechart.run(stick(outputs)).outputs
    assert found["touches"] == pytest.approx(found["pinned"] + found["slides"], rel=1e-12)
    assert found["pinned"] > 0.0 < found["slides"]
    # It starts closed; slip and stick enter no state that is already active.
    assert found["closes"] == 0


def test_a_contact_may_be_declared_closed_at_the_start(stick: Callable[[str], Path]) -> None:
    modes = "\nmodes: {tip: closed}\n"
    assert statechart.run(stick(modes)).trace.start_mode == ("pin",)
    with pytest.raises(DeclarationError, match="cannot start in mode 'free'"):
        statechart.run(stick("\nmodes: {tip: free}\n"))
    with pytest.raises(DeclarationError, match="does not list the mode 'off'"):
        statechart.run(stick("\nmodes: {tip: 'off'}\n"))
