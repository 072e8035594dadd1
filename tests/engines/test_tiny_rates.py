"""Rates whose squares underflow."""

from __future__ import annotations

import math

import pytest
from runs import ENGINES

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import run

_DRIFT = """\
kind: chart
name: drift
variables: {{x: 0.883333015, y: -0.468576, v: {v}, w: {w}}}
regions:
  m: {{initial: a, states: {{a: {{flows: {{x: v, y: w, v: 0.0, w: 0.0}}}}}}}}
stop: {{time: 5}}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("v", [1e-120, 3e-157, 1e-157, 2e-158, 1e-300])
def test_a_negligible_rate_is_zero(engine: str, v: float) -> None:
    trace = run(read_text(_DRIFT.format(v=v, w=v / 6.4)), engine=engine, throw=False).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final.tolist() == pytest.approx([0.883333015, -0.468576, 0.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("unit", [1e-15, 1e-9, 1.0, 1e12])
def test_the_motion_is_invariant_under_change_of_the_unit_of_time(engine: str, unit: float) -> None:
    # Falls to 1/2 in ln 2, and climbs towards 2 back to 1 in ln 1.5.
    text = f"""\
kind: chart
name: clock
parameters: {{k: {1 / unit!r}}}
variables: {{x: 1}}
regions:
  m:
    initial: falls
    states: {{falls: {{flows: {{x: -k*x}}}}, climbs: {{flows: {{x: k*(2 - x)}}}}}}
    transitions:
      - {{name: low, from: falls, to: climbs, guard: x <= 0.5}}
      - {{name: high, from: climbs, to: falls, guard: x >= 1}}
stop: {{time: 10/k}}
outputs: {{lows: {{value: k*time, at: each m.low}}}}
"""
    lows = run(read_text(text), engine=engine).outputs["lows"]
    period = math.log(2.0) + math.log(1.5)
    assert lows == pytest.approx([math.log(2.0) + k * period for k in range(9)], rel=1e-10)
