"""Condition number of the time of an event with respect to errors of the state."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import run

FEET = """\
kind: scene
name: feet
gravity: 1
bodies: {block: {mass: 1, inertia: 1, start: {y: 0.5}}}
surfaces: {floor: {height: 0}}
contacts:
  left: {point: {body: block, at: [-1, -0.5]}, surface: floor, friction: 2, restitution: 0}
  right: {point: {body: block, at: [1, -0.5]}, surface: floor, friction: 2, restitution: 0}
forces: {pull: {body: block, at: [0, 0.5], force: [time, 0]}}
stop: {time: 2}
"""


def test_shared_forces_have_condition_numbers() -> None:
    # The block tips at t = 1 about its right foot, where no force is left on the other: turned by
    # an angle, the arm of its weight grows by half of that, the arm of the pull falls by it.
    result = run(read_text(FEET), accuracy=1e-6)
    trace = result.trace
    (jump,), (kappa,) = trace.jumps, result.conditions
    assert (jump.t, jump.fired) == (pytest.approx(1.0, abs=1e-9), ("left.V",))
    angle = abs(trace.final[trace.variables.index("block.angle")])
    assert kappa == pytest.approx((0.5 + 1.0) / 2.0 * angle / (2.0 * 0.5), rel=1e-6)
