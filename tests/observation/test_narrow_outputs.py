"""Integrals and extremes of formulas with kinks and peaks that are narrower than a step."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.kernels.boxes import Steps
from statechart.kernels.quadrature import EXACT, integrate_outputs

FLIGHT = """\
kind: scene
name: flight
parameters: {a: 0.3, w: 0.01}
gravity: 0
bodies: {b: {mass: 1, start: {y: 100, dx: 1}}}
stop: {time: 1}
outputs:
  kink: {integral: "abs(b.x-a)"}
  step: {integral: "sign(b.x-a)"}
  peak: {integral: "1/(1+((b.x-a)/w)**2)"}
  bell: {integral: "exp(-((b.x-a)/w)**2)"}
  edge: {integral: "max(b.x-a, 0)**2"}
  top: {maximum: "1/(1+((b.x-a)/w)**2)"}
  low: {minimum: "abs(b.x-a) + b.x"}
  zero: {integral: "abs(b.dy)"}
"""


@pytest.fixture(scope="module", params=["taylor", "scipy"])
def flight(request: pytest.FixtureRequest) -> Runner:
    return Runner(read_text(FLIGHT), engine=request.param)


@given(a=st.floats(0.01, 0.99), power=st.floats(-5.0, -0.5))
def test_integrals_resolve_kinks_jumps_and_peaks(flight: Runner, a: float, power: float) -> None:
    w = 10.0**power
    found = flight.run({"a": a, "w": w}).outputs
    exact = {
        "kink": 0.5 * (a**2 + (1.0 - a) ** 2),
        "step": 1.0 - 2.0 * a,
        "peak": w * (math.atan((1.0 - a) / w) + math.atan(a / w)),
        "bell": 0.5 * w * math.sqrt(math.pi) * (math.erf((1.0 - a) / w) + math.erf(a / w)),
        "edge": (1.0 - a) ** 3 / 3.0,
        "top": 1.0,
        "low": a,
        "zero": 0.0,
    }
    # The place of a jump is known to the rounding of the motion alone.
    assert found == pytest.approx(exact, rel=1e-9, abs=1e-11)


NOISE = "abs(cos(b.angle)**2 + sin(b.angle)**2 - 1)"
SPIN = """\
kind: scene
name: spin
gravity: 0
bodies: {b: {mass: 1, inertia: 1, start: {angle: 0.3, dangle: 31, x: 0.1}}}
stop: {time: 20}
outputs:
  noise: {integral: "abs(cos(b.angle)**2 + sin(b.angle)**2 - 1)"}
  turns: {integral: "abs(cos(b.angle))"}
  most: {maximum: "abs(cos(b.angle)**2 + sin(b.angle)**2 - 1)"}
  apart: {maximum: "hypot(b.x - 0.1, cos(b.angle)**2 + sin(b.angle)**2 - 1)"}
  side: {maximum: "sqrt((sin(b.angle)**2 + cos(b.angle)**2 - 1)**2)"}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_round_off_outputs_leave_other_outputs_exact(
    engine: str,
) -> None:
    result = Runner(read_text(SPIN), engine=engine).run()

    def upto(angle: float) -> float:
        turns = math.floor(angle / math.pi + 0.5)
        return 2.0 * turns + math.sin(angle - turns * math.pi)

    rounding = dict.fromkeys(("noise", "most", "apart", "side"), 0.0)
    exact = {**rounding, "turns": (upto(620.3) - upto(0.3)) / 31.0}
    assert result.outputs == pytest.approx(exact, rel=1e-12, abs=1e-13)
    # Halving ends at rounding, not where there are too many pieces.
    observer, trace = result.observer, result.trace
    tape = observer.programs.tape(observer.programs.expressions((NOISE,)), None)
    for arc in trace.arcs:
        steps = Steps(arc.times, arc.coefficients, trace.values, 0.0)
        _, ends = integrate_outputs(tape.parts, steps, 0.0, 20.0, EXACT)
        assert len(ends) < 4000 * (len(arc.times) - 1)
