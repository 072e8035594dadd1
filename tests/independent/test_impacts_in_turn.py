"""Alternating impacts of bodies that carry each other accumulate, and end in `zeno` events."""

from __future__ import annotations

from typing import Any

import pytest

import statechart
from contacts.scene.scene import Scene
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.testing.properties import assert_edges

# A weight falls on one end of a board and throws up what lies on the other. As that comes down
# again, it and the board's end strike in turn, ever sooner, without any restitution.
_TEETER = """
kind: scene
name: teeter
parameters: {L: 1, a: 0.125}
gravity: 16
coordinates: {tilt: {start: a}}
bodies:
  board: {mass: 2, inertia: 0.5, position: [0, L*sin(a)], angle: tilt}
  heavy: {mass: 3, start: {x: 0.9*cos(a), y: 2}}
  light: {mass: 1, start: {x: -0.8*cos(a), y: L*sin(a) - 0.8*sin(a)}}
surfaces: {ground: {height: 0}, top: {height: 0, body: board}}
contacts:
  left: {point: {body: board, at: [-L, 0]}, surface: ground, friction: 0.2, restitution: 0}
  right: {point: {body: board, at: [L, 0]}, surface: ground, friction: 0.2, restitution: 0}
  falls: {point: {body: heavy}, surface: top, friction: 0.5, restitution: 0}
  flies: {point: {body: light}, surface: top, friction: 0.5, restitution: 0}
stop: {time: 1.6}
outputs:
  rests: {value: time, at: first flies.zeno}
  strikes: {value: time, at: last 3 flies.touchdown}
"""
_TWO = """
kind: scene
name: two
bodies: {a: {mass: 1, inertia: 1, start: {}}, b: {mass: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}, top: {height: 0.5, body: a}}
contacts:
  low: {point: {body: a}, surface: floor, friction: 1, restitution: 0}
  high: {point: {body: b}, surface: SURFACE, friction: 1, restitution: 0}
stop: {time: 1}
"""


def scene(text: str) -> Any:
    return interpret(read_text(text, "scene.yaml"))


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_bounces_on_a_bouncing_body_may_accumulate(engine: str) -> None:
    result = statechart.run(scene(_TEETER), engine=engine)
    assert_edges(result.observer.automaton, result.trace)
    strikes, rests = result.outputs["strikes"], result.outputs["rests"]
    # Intervals shrink geometrically: the rest of the sequence is the last times r/(1 - r).
    first, last = strikes[1] - strikes[0], strikes[2] - strikes[1]
    assert rests - strikes[2] == pytest.approx(last**2 / (first - last), rel=1e-3)


def test_contacts_of_bodies_apart_do_not_accumulate() -> None:
    for surface, together in (("top", True), ("floor", False)):
        model = scene(_TWO.replace("SURFACE", surface))
        assert isinstance(model, Scene)
        assert [model.bounces("low"), model.bounces("high")] == [together] * 2


def test_a_point_does_not_touch_its_own_body() -> None:
    text = _TWO.replace("SURFACE", "top").replace("body: b}", "body: a}")
    with pytest.raises(DeclarationError, match=r"its point and its surface are of one body, 'a'"):
        scene(text)
