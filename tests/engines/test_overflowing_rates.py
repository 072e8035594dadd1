"""Motions whose rates overflow."""

from __future__ import annotations

import statechart
from statechart.automaton.trace import Outcome


def test_an_implicit_method_whose_matrix_overflows_ends_as_a_failed_step() -> None:
    # A hopper of 1e-12 kg under a torque for 80 kg: its angle turns by 1e13 rad/s^2.
    result = statechart.run("raibert_hopper", throw=False, parameters={"m": 1e-12})
    assert result.trace.outcome is Outcome.STEP_FAILURE
    assert "steps shorter than the resolution of time" in result.trace.message
