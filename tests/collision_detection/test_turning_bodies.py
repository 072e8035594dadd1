"""A rod that turns by 0.3 radians in a step strikes exactly the obstacles in its way."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

# It reaches as far as its corners do.
_REACH, _RADIUS = math.hypot(1.0, 0.01), 0.05
SCENE = """
kind: scene
name: turning
gravity: 0
parameters: {angle: -0.5, x: 0.9, y: 0, dx: 0, dy: 0, dangle: 300}
bodies:
  rod:
    mass: 1
    inertia: 1/3
    shape: {polygon: [[-1, -0.01], [1, -0.01], [1, 0.01], [-1, 0.01]]}
    start: {angle: angle, dangle: dangle}
  ball: {mass: 0.1, inertia: 0.0001, shape: {disc: 0.05}, start: {x: x, y: y, dx: dx, dy: dy}}
collisions: {all: {bodies: [rod, ball], friction: 0, restitution: 1}}
stop: {time: 0.005}
settings: {engine: impulse, step: 1e-3}
"""
# Part of the step at which it arrives.
_PHASES = [-0.16, -0.2, -0.24, -0.3, -0.37, -0.41, -0.45, -0.52, -0.6, -0.7]


@pytest.fixture(scope="module")
def runner():
    return Runner(interpret(read_text(SCENE)))


def run(runner, **values):
    trace = runner.run(values).trace
    return trace, dict(zip(trace.variables, trace.final.tolist(), strict=True))


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("angle", _PHASES)
def test_a_rod_that_passes_at_two_percent_distance_has_no_impact(runner, angle, sense):
    x = 1.02 * _REACH + _RADIUS
    _, final = run(runner, angle=sense * angle, dangle=sense * 300, x=x)
    assert [final["ball.x"], final["ball.y"], final["rod.dangle"]] == [x, 0, sense * 300]


@pytest.mark.parametrize("x", [0.5, 0.9])
@pytest.mark.parametrize("angle", _PHASES)
def test_a_turning_rod_strikes_an_obstacle_at_any_time_of_a_step(runner, angle, x):
    """Both separate at their approach velocity, up to the rotation of the lever in half a step.

    The impulse is 2 v / (1 / m + 1 / M + x^2 / I).
    """
    _, final = run(runner, angle=angle, x=x)
    speed = 2.0 * 300.0 * x / (1.0 / 0.1 + 1.0 + 3.0 * x**2) / 0.1
    assert math.hypot(final["ball.dx"], final["ball.dy"]) == pytest.approx(speed, rel=0.06)
    energy = 0.05 * (final["ball.dx"] ** 2 + final["ball.dy"] ** 2)
    energy += 0.5 * (final["rod.dx"] ** 2 + final["rod.dy"] ** 2) + final["rod.dangle"] ** 2 / 6.0
    assert energy == pytest.approx(300.0**2 / 6.0, rel=1e-9)


@pytest.mark.parametrize("offset", [-0.02, 0.02])
@pytest.mark.parametrize("phase", [0.0, 0.1, 0.2])
def test_passing_ball_is_struck_only_within_reach_of_the_rod(runner, phase, offset):
    """The ball passes along y, 0.02 inside or outside the circle of the rod's end."""
    x = _REACH + _RADIUS + offset
    _, final = run(runner, angle=-0.45 - phase, x=x, y=0.04, dy=-20)
    assert (final["ball.dy"] == -20.0) == (offset > 0.0)
