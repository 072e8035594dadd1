"""Contacts that open as the force on them falls to zero: nothing strikes, and nothing kicks."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G, STEEP, ASIDE, REACH = 9.81, 1.2, 0.2, 1.1
SCENE = """
kind: scene
name: leaving
gravity: 9.81
bodies:
  body: {{mass: 1, inertia: {inertia}, shape: {{{shape}}},
    start: {{x: {x!r}, y: {y!r}, angle: {angle}}}}}
surfaces: {{{surfaces}}}
collisions:
  all: {{bodies: [body], surfaces: [{names}], friction: 0, restitution: 0}}
stop: {{time: {time}}}
settings: {{engine: impulse, step: {step}}}
"""
LADDER = {
    "inertia": 1 / 12,
    "shape": "polygon: [[-0.5, 0], [0, -0.001], [0.5, 0], [0, 0.001]]",
    "surfaces": "floor: {height: 0}, wall: {line: [[0, 0], [0, 2]]}",
    "names": "floor, wall",
    "x": -0.5 * math.cos(STEEP),
    "y": 0.5 * math.sin(STEEP),
    "angle": STEEP,
    "time": 0.45,
}
DISC = {
    "inertia": 0.005,
    "shape": "disc: 0.1",
    "surfaces": "post: {circle: [0, 0], radius: 1}",
    "names": "post",
    "x": REACH * math.sin(ASIDE),
    "y": REACH * math.cos(ASIDE),
    "angle": 0,
    "time": 0.9,
}


@pytest.mark.parametrize(
    ("what", "speed"),
    [
        # At two thirds of its height: from there on it goes on at the speed it has.
        (LADDER, -math.sin(STEEP) / 3 * math.sqrt(G * math.sin(STEEP))),
        (DISC, math.sqrt(G * REACH * (2 / 3 * math.cos(ASIDE)) ** 3)),
    ],
    ids=["a ladder leaves its wall", "a disc leaves a post"],
)
@pytest.mark.parametrize("step", [2e-3, 1e-3])
def test_a_body_that_leaves_a_surface_keeps_its_tangential_velocity(what, speed, step):
    result = Runner(interpret(read_text(SCENE.format(step=step, **what)))).run()
    assert result.trace.final[3] == pytest.approx(speed, abs=1e-5)
