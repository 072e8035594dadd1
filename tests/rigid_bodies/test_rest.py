"""Rest: bodies keep their places, and a slope a millionth too steep lets them slide."""

from __future__ import annotations

import math

import numpy as np
import pytest

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STACK = """
kind: scene
name: stack
gravity: 9.81
bodies:
  box:
    copies: 30
    mass: 1
    inertia: 0.004
    shape: {polygon: [[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]}
    start: {x: 5e-4*index, y: 0.05 + 0.1*index}
surfaces: {ground: {height: 0}}
collisions: {all: {bodies: [box], surfaces: [ground], friction: 0.5, restitution: 0}}
stop: {time: 10}
settings: {engine: impulse, step: 1e-3}
"""


def test_a_stack_of_thirty_stands_for_ten_seconds_without_creeping():
    trace = Runner(interpret(read_text(STACK))).run().trace
    assert trace.outcome is Outcome.HORIZON
    assert np.abs(trace.final - trace.initial).max() < 1e-11
    assert trace.counts["iterations"] < 2 * trace.counts["steps"]


SLOPE = """
kind: scene
name: slope
parameters: {mu: 0.5, beyond: 0, lean: atan(mu) + beyond, dx: 0.3, h: 0.05}
gravity: 9.81
bodies:
  block:
    copies: 100
    mass: 1
    inertia: 0.01
    shape: {polygon: [[-0.1, -h], [0.1, -h], [0.1, h], [-0.1, h]]}
    start:
      x: dx*index*cos(lean) - h*sin(lean)
      y: dx*index*sin(lean) + h*cos(lean)
      angle: lean
surfaces: {slope: {incline: lean}}
collisions: {all: {bodies: [block], surfaces: [slope], friction: mu, restitution: 0}}
stop: {time: 0.2}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize("beyond", [-1e-6, 1e-6])
def test_a_hundred_blocks_at_the_friction_angle_rest_below_and_slide_above(beyond):
    trace = Runner(interpret(read_text(SLOPE))).run({"beyond": beyond}).trace
    lean = math.atan(0.5) + beyond
    speeds = np.hypot(*trace.final[300:].reshape(-1, 3)[:, :2].T)
    expected = max(0.0, 0.2 * 9.81 * (math.sin(lean) - 0.5 * math.cos(lean)))
    assert speeds == pytest.approx(np.full(100, expected), abs=1e-11)
    assert set(trace.final_mode) == {"slide" if beyond > 0.0 else "pin"}
