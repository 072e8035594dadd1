"""Extremes and invariants where a mode lasts no time."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner
from statechart.testing.guards import assert_invariants
from statechart.testing.subject import Subject

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
