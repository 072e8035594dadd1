"""Declarations as people write them first: no modes without friction, a step as a fraction."""

from __future__ import annotations

import pytest

from contacts import Scene
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

PUCK = """\
kind: scene
name: puck
gravity: 9.81
bodies: {puck: {mass: 1, start: {y: 1, dx: 2}}}
surfaces: {ice: {height: 0}}
contacts: {rim: {point: {body: puck}, surface: ice, friction: 0, restitution: 0%s}}
settings: {engine: impulse, step: %s}
stop: {time: 1}
"""


def puck(modes: str = "", step: str = "0.01") -> Scene:
    return Scene.model_validate(read_text(PUCK % (modes, step)).data)


def test_a_contact_without_friction_needs_no_modes() -> None:
    free, listed = puck(), puck(", modes: [free, slide]")
    assert free.contacts["rim"].kinds == listed.contacts["rim"].kinds == {"free", "slide"}
    found, expected = (Runner(scene).run() for scene in (free, listed))
    assert [jump.target for jump in found.trace.jumps] == [("slide",)]
    assert found.trace.jumps[0].after.tolist() == expected.trace.jumps[0].after.tolist()
    with pytest.raises(ValueError, match="a frictionless contact has no pin"):
        puck(", modes: [free, slide, pin]")


def test_friction_that_is_given_later_brings_the_pin_back() -> None:
    contact = puck().contacts["rim"].model_copy(update={"friction": 0.5})
    assert contact.kinds == {"free", "slide", "pin"}
    assert "modes" not in str(puck())


@pytest.mark.parametrize(("written", "step"), [("1/60", 1 / 60), ("2e-3", 2e-3)])
def test_a_step_is_a_formula_of_numbers(written: str, step: float) -> None:
    scene = puck(step=written)
    assert scene.settings.step == step
    assert Scene.model_validate(read_text(str(scene)).data) == scene
