"""Guards on variables of controllers that start at zero, in any unit."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

# A body glides, with its way summed up; a second variable sums up the first.
GLIDING = """
kind: scene
name: gliding
parameters: {v: 1, Q: 0.1, end: 1}
bodies: {cart: {mass: 1, start: {dx: v}}}
regions:
  meter:
    variables: {way: 0, sum: 0}
    initial: adds
    states: {adds: {flows: {way: cart.x, sum: way}}, full: {}}
    transitions: [{name: fills, from: adds, to: full, guard: sum >= Q}]
stop: {time: end}
outputs: {t: {value: time, at: first fills}}
"""


@pytest.mark.parametrize("length", [1.0, 1e-9, 1e9])
@pytest.mark.parametrize("time", [1.0, 1e-9, 1e6])
@pytest.mark.parametrize("engine", ["auto", "impulse"])
def test_the_time_of_a_guard_on_a_sum_does_not_depend_on_units(
    engine: str, length: float, time: float
) -> None:
    step = 1e-3 * time if engine == "impulse" else None
    result = Runner(read_text(GLIDING), engine=engine, step=step).run(
        {"v": length / time, "Q": 0.1 * length * time**2, "end": time}
    )
    # sum = v t^3/6
    allowed = 1e-3 if step else 1e-12
    assert result.outputs["t"] / time == pytest.approx(math.cbrt(0.6), abs=allowed)
