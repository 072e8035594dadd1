"""Least and greatest values where nothing flows: modes of no duration, and after the last jump."""

from __future__ import annotations

import pytest

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.reporting.report import invariants

# x is set to -7 and back at once, as the time is 1; as it is 1.5, the run ends at x = 20.
PASSING = """\
kind: chart
name: passing
variables: {x: 0, k: 0}
regions:
  r:
    initial: a
    states: {a: {flows: {x: 1}}, b: {flows: {x: 1}}, c: {flows: {x: 1}}, d: {}}
    transitions:
      - {name: down, from: a, to: b, guard: x >= 1, updates: {x: -7, k: 3}}
      - {name: back, from: b, to: c, guard: x <= -6, updates: {x: 0.5, k: 1}}
      - {name: up, from: c, to: d, guard: x >= 1, updates: {x: 20}}
stop: {time: 3, conditions: {far: x >= 19}}
invariants: {few: k <= 2, low: x <= 10}
outputs: {least: {minimum: x}, most: {maximum: x}, k: {maximum: k}, still: {minimum: k}}
"""
# At t = 1 the ball falls at 2, and rises at 1 as the run ends.
STRUCK = """\
kind: scene
name: struck
gravity: 2
bodies: {ball: {mass: 1, start: {y: 1, dx: 0}}}
surfaces: {floor: {height: 0}}
contacts:
  touch:
    {point: {body: ball}, surface: floor, modes: [free, slide], friction: 0, restitution: 0.5}
stop: {time: 3, conditions: {rises: ball.dy >= 0.9}}
outputs: {least: {minimum: ball.dy}, most: {maximum: ball.dy}, force: {maximum: touch.V}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_states_without_duration_count_for_extremes(engine: str) -> None:
    result = Runner(read_text(PASSING), engine=engine).run()
    assert dict(result.outputs) == {"least": -7.0, "most": 20.0, "k": 3.0, "still": 0.0}
    assert invariants(result.observer, result.trace) == {"few": -1.0, "low": -10.0}
    struck = Runner(read_text(STRUCK), engine=engine).run().outputs
    assert struck == pytest.approx({"least": -2.0, "most": 1.0, "force": 0.0}, abs=1e-14)
