"""Delay of runs that leave an unstable equilibrium, against closed forms."""

from __future__ import annotations

import math
import re

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result
from statechart.running.runner import run

PENCIL = """
kind: scene
name: pencil
parameters: {theta0: 1.0e-16}
gravity: 9.81
bodies:
  stick:
    {mass: 1, inertia: 1/12, start: {x: sin(theta0)/2, y: cos(theta0)/2, angle: -theta0}}
joints:
  foot: {point: {body: stick, at: [0, -1/2]}, to: [0, 0]}
stop: {time: 100, conditions: {fallen: stick.angle <= -1}}
"""
# lambda**2 = m g l / (I + m l**2)
LAMBDA = math.sqrt(9.81 * 0.5 / (1 / 12 + 1 / 4))

CHART = """
kind: chart
name: c
parameters: {x0: 1.0e-16}
variables: {x: x0, v: 0}
regions: {p: {initial: a, states: {a: {flows: {x: v, v: RATE}}}}}
stop: {time: 20}
"""


def time_of_fall(theta0: float) -> float:
    """Return the time from rest at theta0 to angle 1, to order theta0**2.

    On the separatrix lambda t = ln tan(theta/4), which theta0 cosh(lambda t) joins.
    """
    return math.log(8.0 * math.tan(0.25) / theta0) / LAMBDA


def warned_delay(result: Result) -> float | None:
    """Return the delay that a warning gives, or None."""
    found = [re.search(r"off by about ([0-9.e+-]+);", text) for text in result.warnings]
    return next((float(match[1]) for match in found if match), None)


@pytest.mark.parametrize(
    ("engine", "tolerance", "theta0"),
    [
        ("scipy", 1e-12, 1e-12),
        ("scipy", 1e-12, 1e-16),
        ("scipy", 1e-6, 1e-12),
        ("taylor", 2.2e-16, 1e-16),
        ("taylor", 2.2e-16, 1e-40),
    ],
)
def test_a_warning_estimates_how_late_a_pencil_falls(
    engine: str, tolerance: float, theta0: float
) -> None:
    values = {"theta0": theta0}
    result = run(read_text(PENCIL), engine=engine, tolerance=tolerance, parameters=values)
    late, warned = abs(result.trace.t_end - time_of_fall(theta0)), warned_delay(result)
    assert warned is not None
    assert 0.5 * late < warned < 2.0 * late


def test_a_pencil_that_steps_resolve_falls_in_time_without_a_warning() -> None:
    result = run(read_text(PENCIL), engine="taylor", parameters={"theta0": 1e-8})
    assert result.trace.t_end == pytest.approx(time_of_fall(1e-8), rel=1e-12)
    assert warned_delay(result) is None


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(
    "rate",
    [
        "9*sin(x)",  # without scales, tolerances follow the motion
        "-9*sin(x)",  # stays near a stable equilibrium
        "-9*x + exp(-(time - 10)**2)",  # a pulse moves it
        "0",  # at rest
    ],
)
def test_other_slow_starts_have_no_warning(engine: str, rate: str) -> None:
    result = run(read_text(CHART.replace("RATE", rate)), engine=engine)
    assert warned_delay(result) is None
