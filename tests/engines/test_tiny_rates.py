"""Rates whose squares underflow."""

from __future__ import annotations

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
def test_a_rate_of_next_to_nothing_is_none(engine: str, v: float) -> None:
    trace = run(read_text(_DRIFT.format(v=v, w=v / 6.4)), engine=engine, throw=False).trace
    assert trace.outcome is Outcome.HORIZON
    assert trace.final.tolist() == pytest.approx([0.883333015, -0.468576, 0.0, 0.0], abs=1e-15)
