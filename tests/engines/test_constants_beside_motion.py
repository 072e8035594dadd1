"""Counts, clocks and other constants do not set the tolerance of the variables that move."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import run

NEURON = """\
kind: chart
name: neuron
parameters: {{n0: {count}}}
variables: {{v: 0, n: n0}}
regions:
  r:
    initial: charges
    states: {{charges: {{flows: {{v: ({unit}*1.3 - v)/0.02}}}}, rests: {{}}}}
    transitions:
      - {{name: spike, from: charges, to: rests, guard: v >= {unit},
         updates: {{v: 0.1*{unit}, n: n + 1}}}}
      - {{name: ready, from: rests, to: charges, after: 0.003}}
stop: {{time: 0.3}}
outputs: {{spikes: {{value: time, at: first 5 r.spike}}}}
"""
RELAY = """\
kind: chart
name: relay
variables: {x: 0, v: 1e-9, n: 1e6}
regions: {r: {initial: s, states: {s: {flows: {x: v, v: -x - 1e-9*sign(x)}}}}}
stop: {time: 3*pi/4}
outputs: {x: {value: x}}
"""


@pytest.mark.parametrize("method", ["DOP853", "RK45", "LSODA"])
@pytest.mark.parametrize(("unit", "count"), [("1", 0), ("1e-12", 0), ("1", 1e6)])
def test_spikes_are_independent_of_counts(method: str, unit: str, count: float) -> None:
    text = read_text(NEURON.format(unit=unit, count=count))
    spikes = run(text, engine="scipy", method=method).outputs["spikes"]
    first, period = 0.02 * math.log(13 / 3), 0.003 + 0.02 * math.log(4)
    assert spikes == pytest.approx([first + k * period for k in range(5)], rel=1e-10)


def test_a_switching_variable_at_zero_has_the_size_of_what_moves() -> None:
    found = run(read_text(RELAY), engine="scipy").outputs["x"]
    assert found == pytest.approx(-1e-9 * (math.sqrt(2.0) - 1.0), rel=1e-9)
