"""Time stepping of bodies without impacts is of second order."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

SCENE = """
kind: scene
name: pair
gravity: 9.81
bodies:
{bodies}
surfaces: {{ground: {{height: 0}}}}
collisions:
  all: {{bodies: [low, up], surfaces: [ground], friction: {mu}, restitution: 0}}
stop: {{time: 0.3}}
settings: {{engine: impulse, step: {step}, impulse_tolerance: 1e-10}}
"""
CYLINDERS = """
  low: {mass: 2, inertia: 0.01, shape: {disc: 0.1}, start: {y: 0.1}}
  up: {mass: 1, inertia: 0.005, shape: {disc: 0.1},
    start: {x: 0.04, y: 0.1 + sqrt(0.04 - 0.0016)}}
"""
PLATE = """
  low: {mass: 2, inertia: 0.1, start: {y: 0.2},
    shape: {polygon: [[-0.5, -0.2], [0.5, -0.2], [0.5, 0.2], [-0.5, 0.2]]}}
  up: {mass: 1, inertia: 0.03, start: {x: 0.3, y: 0.4 + 0.05*sin(0.2) + 0.3*cos(0.2), angle: -0.2},
    shape: {polygon: [[-0.05, -0.3], [0.05, -0.3], [0.05, 0.3], [-0.05, 0.3]]}}
"""
PAIRS = {
    "cylinders that roll on each other": (CYLINDERS, 5, ("pin", "pin")),
    "a plate that topples on a box": (PLATE, 1, ("pin", "pin")),
    "a plate whose foot slides on a box": (PLATE, 0, ("slide", "slide")),
}


@pytest.mark.parametrize("pair", PAIRS)
def test_halving_the_step_quarters_the_error(pair):
    bodies, mu, modes = PAIRS[pair]
    ends = []
    for step in (2e-3, 1e-3, 5e-4):
        text = SCENE.format(bodies=bodies, mu=mu, step=step)
        trace = Runner(interpret(read_text(text))).run().trace
        assert trace.final_mode == modes
        ends.append(trace.final)
    coarse, fine = (float(np.abs(one - other).max()) for one, other in itertools.pairwise(ends))
    assert coarse / fine == pytest.approx(4, rel=0.05)
