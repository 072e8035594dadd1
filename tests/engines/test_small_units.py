"""Small pendulums against the elliptic integral: heyoka's tolerance is absolute below 1."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ellipkinc

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.engines.taylor_loop import limited_length

_START, _END = 0.5, -0.3
_PENDULUM = f"""
kind: chart
name: pendulum
parameters: {{L: 1}}
variables: {{x: {_START}*L, v: 0}}
regions:
  p:
    initial: swings
    states: {{swings: {{flows: {{x: v, v: -L*sin(x/L)}}}}}}
    transitions:
      - name: hit
        from: swings
        to: swings
        guard: x <= {_END}*L
        updates: {{x: {_START}*L, v: 0}}
  clock:
    initial: runs
    states: {{runs: {{}}}}
    transitions: [{{name: tick, from: runs, every: 7}}]
stop: {{time: 20}}
outputs: {{hits: {{value: time, at: each hit}}}}
"""


def _fall() -> float:
    """Return the time from rest at the start to the end of a pendulum of length and gravity 1."""
    k = math.sin(_START / 2)
    return float(
        ellipkinc(math.pi / 2, k * k) + ellipkinc(math.asin(math.sin(-_END / 2) / k), k * k)
    )


@pytest.mark.parametrize("length", [1.0, 1e-3, 1e-6, 1e-8, 1e-12])
def test_times_of_small_pendulums_are_as_exact_as_of_large_ones(length: float) -> None:
    result = statechart.run(read_text(_PENDULUM), engine="taylor", parameters={"L": length})
    assert result.outputs["hits"] == pytest.approx(
        [_fall() * k for k in range(1, 9)], rel=2e-15, abs=0.0
    )


@pytest.mark.parametrize("size", [1e-4, 1e-30, 1e-200])
def test_the_length_of_a_step_is_that_of_a_motion_of_size_one(size: float) -> None:
    # 1/(1 - t): its terms are all 1. Jorba and Zou's length at order 20 is exp(-2 - 0.7/19).
    series = np.full((2, 21), size)
    series[1] = 0.0
    series[1, :2] = 1e9  # a clock, exact
    known = math.exp(-2.0 - 0.7 / 19.0)
    absolute = known * size ** (-1.0 / 20.0)
    h = limited_length(series, absolute)
    assert known < h < 1.02 * known
    assert limited_length(series, h) == h
    assert limited_length(series[1:], absolute) == absolute
