"""Least and greatest values where nothing flows: modes of no duration, and after the last jump."""

from __future__ import annotations

import pytest

from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.reporting.report import invariants
from statechart.testing.guards import assert_invariants
from statechart.testing.subject import Subject

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


# The push of 5 N is more than the pin can bear: it slips in a second jump at the same instant.
PUSHED = """\
kind: scene
name: pushed
gravity: 9.81
bodies: {b: {mass: 1}}
surfaces: {f: {height: 0}}
contacts: {t: {point: {body: b}, surface: f, friction: 0.1, restitution: 0}}
controls: {push: 0}
forces: {motor: {body: b, force: [push, 0]}}
regions:
  c:
    initial: a
    states: {a: {}, b: {sets: {push: 5}}}
    transitions: [{name: go, from: a, to: b, after: 0.2}]
stop: {time: 1}
invariants: {bound: abs(t.H) <= 0.1*t.V + 1e-9}
outputs: {H: {maximum: abs(t.H)}, push: {maximum: push}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_mode_of_zero_duration_has_no_forces(engine: str) -> None:
    result = Runner(read_text(PUSHED), engine=engine).run()
    assert result.outputs["push"] == 5.0
    assert result.outputs["H"] == pytest.approx(0.981, rel=1e-9)


def test_invariants_do_not_judge_forces_of_a_mode_of_zero_duration() -> None:
    subject = Subject(Runner(read_text(PUSHED)).model)
    for trace in subject.case({}).traces.values():
        assert_invariants(subject, trace)
