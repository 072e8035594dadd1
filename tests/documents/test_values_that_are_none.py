"""Formulas without a finite value are reported with their place, before or as a run starts."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NonFinite
from statechart.running.runner import Runner

SCENE = """\
kind: scene
name: block
gravity: 9.81
bodies:
  block: {mass: 1, start: {y: 1}}
surfaces:
  floor: {height: 0}
contacts:
  base: {point: {body: block}, surface: floor, friction: 0.5, restitution: 0}
controls: {u: 0}
regions:
  r: {initial: on, states: {on: {sets: {u: 1}}}}
forces:
  push: {body: block, force: [0, u]}
stop: {time: 1}
outputs:
  reached: {value: block.y}
"""
CHART = """\
kind: chart
name: ball
variables: {x: 1, v: 0}
regions:
  r:
    initial: fly
    states: {fly: {flows: {x: v, v: -1}}}
    transitions: [{name: hit, from: fly, guard: x <= 0, updates: {v: -v/2}}]
stop: {time: 3}
"""


@pytest.mark.parametrize(
    ("text", "old", "new", "place"),
    [
        (SCENE, "value: block.y", "value: inf", "17:20: outputs.reached.value"),
        (SCENE, "value: block.y", "minimum: 2*inf", "17:22: outputs.reached.minimum"),
        (SCENE, "value: block.y", "integral: inf", "17:23: outputs.reached.integral"),
        (SCENE, "u: 1", "u: inf", "12:44: regions.r.states.on.sets.u"),
        (SCENE, "u: 0", "u: inf", "10:15: controls.u"),
    ],
)
def test_infinite_values_in_formulas_are_reported_with_their_place(
    text: str, old: str, new: str, place: str
) -> None:
    with pytest.raises(DeclarationError, match="must be finite") as caught:
        Runner(read_text(text.replace(old, new), "f.yaml"))
    assert str(caught.value).startswith(f"f.yaml:{place}: ")


def test_infinite_friction_may_be_set() -> None:
    text = SCENE.replace("friction: 0.5", "friction: u").replace("u: 1", "u: inf")
    assert Runner(read_text(text.replace("[0, u]", "[0, 0]"))).start()[0] == ("free", "on")


def test_a_division_by_zero_is_reported_with_its_place() -> None:
    text = CHART.replace("-v/2", "-v/(x - x)")
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text, "f.yaml")).run()
    assert str(caught.value).startswith("f.yaml:8:72: regions.r.transitions.0.updates.v: formula")


@pytest.mark.parametrize("force", ["1/block.x", "log(block.x)"])
def test_undefined_initial_force_is_not_blamed_on_speed_or_mass(force: str) -> None:
    with pytest.raises(NonFinite, match="forces or inertias have no finite value"):
        Runner(read_text(SCENE.replace("[0, u]", f"[u, {force}]"))).start()


@pytest.mark.parametrize(("path", "what"), [("[1/time, 0]", "place"), ("[sqrt(time), 0]", "speed")])
def test_a_path_without_a_start_is_reported(path: str, what: str) -> None:
    text = SCENE.replace("height: 0", f"height: 0, displacement: {path}")
    with pytest.raises(DeclarationError, match=f"contacts.base: its {what} at the start is not"):
        Runner(read_text(text)).start()
