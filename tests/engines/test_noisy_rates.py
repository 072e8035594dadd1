"""Steps of SciPy where round-off of the rates exceeds the absolute tolerance."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import run

# A box on an incline s, turned from it by a, whose compliant feet stick. That both stick forbids it
# to turn, by forces of order 1/a. The moment M keeps it at rest, and r*time makes a foot slip.
FEET = """
kind: scene
name: feet
parameters: {k: 14000, a: 8.0e-5, s: -0.113, mu: 0.8, r: 1, M: 0, h: 0.1*cos(a) - 5*cos(s)/k}
gravity: 10
surfaces: {floor: {incline: s}}
bodies:
  b: {mass: 1, inertia: 0.02, start: {x: -h*sin(s), y: h*cos(s), angle: s + a}}
  load: {mass: 1, inertia: 0.01, start: {y: 3, angle: s + a}}
contacts:
  left:
    {point: {body: b, at: [-0.2, -0.1]}, surface: floor, friction: mu, stiffness: k, damping: 80}
  right:
    {point: {body: b, at: [0.2, -0.1]}, surface: floor, friction: mu, stiffness: k, damping: 80}
couplings: {rub: {bodies: [load, b], limit: 1}}
forces: {turn: {body: b, moment: M + r*time}}
stop: {time: 0.039}
"""


@pytest.mark.parametrize("tolerance", [1e-10, 1e-12, 1e-13])
def test_steps_do_not_shrink_below_the_round_off_of_the_rates(tolerance: float) -> None:
    k, a, s, mu, slip = 14000.0, 8e-5, -0.113, 0.8, 0.03
    h = 0.1 * math.cos(a) - 5.0 * math.cos(s) / k
    arms = [math.cos(a) * x + 0.1 * math.sin(a) for x in (-0.2, 0.2)]
    heights = [math.sin(a) * x - 0.1 * math.cos(a) for x in (-0.2, 0.2)]
    normal = [-k * (h + y) for y in heights]
    friction = 10.0 * math.sin(s) / 2.0  # of each foot at the start
    moment = -sum(n * x - friction * y for n, x, y in zip(normal, arms, heights, strict=True))
    # The moment r t shifts r t/(0.4 sin a) of the friction between the feet, until the left slips.
    growth = (mu * normal[0] + friction) * 0.4 * math.sin(a) / slip
    result = run(
        read_text(FEET),
        engine="scipy",
        tolerance=tolerance,
        parameters={"M": moment, "r": growth},
    )
    first = result.trace.jumps[0]
    assert (first.region, first.cause) == ("left", "slip")
    # Forces of order 1/a magnify round-off, as taylor's: 0.0300037.
    assert first.t == pytest.approx(slip, rel=1e-3)
    assert result.trace.counts["steps"] < 1000  # 37546 at 1e-12 if errors of round-off shorten them
