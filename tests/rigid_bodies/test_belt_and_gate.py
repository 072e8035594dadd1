"""A belt carries boxes against a gate that a controller opens, beside its times by hand."""

from __future__ import annotations

import pytest

from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.body_properties import assert_free_fall
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

V, MU, G, WAIT, LIFT = 0.8, 0.4, 9.81, 1.0, 2.0
BELT = f"""
kind: scene
name: conveyor
parameters: {{a: 0.1, b: 0.08, m: 2, v: {V}, mu: {MU}, D: 1, u: {LIFT}, wait: {WAIT}}}
gravity: {G}
bodies:
  box:
    copies: 3
    mass: m
    inertia: m*(a**2 + b**2)/3
    shape: {{polygon: [[-a, -b], [a, -b], [a, b], [-a, b]]}}
    start: {{x: -0.5*index, y: b}}
surfaces:
  belt: {{height: 0, displacement: [v*time, 0]}}
  gate: {{edge: [[D, 0], [D, 1]], displacement: [0, lift]}}
collisions:
  belt: {{bodies: [box], surfaces: [belt], friction: mu, restitution: 0}}
  gate: {{bodies: [box], surfaces: [gate], friction: 0, restitution: 0}}
regions:
  keeper:
    initial: closed
    variables: {{lift: 0}}
    states:
      closed: {{}}
      waiting: {{}}
      opening: {{flows: {{lift: u}}}}
      free: {{}}
    transitions:
      - {{name: arrived, from: closed, to: waiting, on: box2.impact}}
      - {{name: opens, from: waiting, to: opening, after: wait}}
      - {{name: stays, from: opening, to: free, guard: lift >= 0.5}}
stop: {{time: 4}}
outputs:
  rides: {{value: time, at: first box0.stick}}
  hits: {{value: time, at: first box0.impact}}
  queued: {{value: time, at: first keeper.waiting}}
  places: {{value: box0.x}}
  last: {{value: box2.x}}
settings: {{engine: impulse, step: STEP}}
"""


def test_boxes_queue_at_a_gate_and_ride_on():
    # A box gains the speed of the belt in v/(mu g), and loses half the way of that time.
    gains = V / (MU * G)
    rides = [(way / V + gains / 2) for way in (0.9, 1.5)]
    opened = rides[1] + WAIT + 0.16 / LIFT
    place = 0.9 + V * (4 - opened - gains / 2)
    for h in (2e-3, 1e-3):
        model = interpret(read_text(BELT.replace("STEP", str(h))))
        result = Runner(model).run()
        assert result.trace.outcome is Outcome.HORIZON
        found = [result.outputs[name] for name in ("rides", "hits", "queued")]
        assert found == pytest.approx([gains, *rides], abs=1.5 * h)
        # A box stops up to half a step before the gate, and goes on at the end of a step.
        assert result.outputs["places"] == pytest.approx(place, abs=2 * h * V)
        assert result.outputs["last"] == pytest.approx(place - 0.4, abs=3 * h * V)
        # A controller has states, too, and may call one as bodies do.
        assert_free_fall(body_numbers(model, model.values()), result.trace)


def test_boxes_without_mutual_pressure_slide_together():
    # Open from the start, and the last one against the others: all gain the belt's speed alike.
    text = BELT.replace("-0.5*index", "-2*a*index").replace("D: 1", "D: 100")
    trace = Runner(interpret(read_text(text.replace("STEP", "1e-3")))).run(until=0.4).trace
    reported = [(jump.region, jump.cause, jump.target[:3]) for jump in trace.jumps]
    assert reported[2][2] == ("slide",) * 3
    assert reported[-1][2] == ("pin",) * 3
    assert [cause for _, cause, _ in reported] == ["touchdown"] * 3 + ["stick"] * 3
