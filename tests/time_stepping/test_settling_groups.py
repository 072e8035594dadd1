"""Modes that settle: coupled contacts only, whatever else happens in the scene."""

from __future__ import annotations

import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

POINTS = """
kind: scene
name: points
gravity: 9.81
bodies:
  near: {mass: 1, start: {dx: 0.5}}
  far: {mass: 1, start: {x: 5}}
surfaces: {floor: {height: 0}}
contacts:
  slides: {point: {body: near}, surface: floor, friction: 0.5, restitution: 0}
  lifts: {point: {body: far}, surface: floor, friction: 0.5, restitution: 0}
forces: {pull: {body: far, force: [1e-12*near.x, 9.81 + 100*(time - LIFT)]}}
stop: {time: 0.12}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize("steps_before", [1.4, 2.4, 3.4, 4.4])
def test_a_slip_ends_when_friction_stops_it_not_when_a_far_point_lifts_off(
    steps_before: float,
) -> None:
    end = 0.5 / (0.5 * 9.81)
    text = POINTS.replace("LIFT", str(end - steps_before * 1e-3))
    jumps = run(read_text(text)).trace.jumps
    assert [jump.region for jump in jumps] == ["lifts", "slides"]
    assert 0.0 <= jumps[1].t - end < 1e-3


BOX = """
kind: scene
name: box
gravity: 9.81
bodies:
  box: {mass: 1, inertia: 0.02, start: {y: 0.1, dx: 0.232}}
  far: {mass: 1, start: {x: 50, y: START}}
surfaces: {floor: {height: 0}}
contacts:
  one: {point: {body: box, at: [-0.2, -0.1]}, surface: floor, friction: 0.5, restitution: 0,
    impact: moreau}
  two: {point: {body: box, at: [0.2, -0.1]}, surface: floor, friction: 0.5, restitution: 0,
    impact: moreau}
  beside: {point: {body: far}, surface: floor, friction: 0.7, LAW}
forces:
  rock: {body: box, force: [10.2*sin(34*time), 1e-12*far.x], moment: -2.02*sin(45.4*time)}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""


def test_a_far_compliant_contact_changes_no_event_of_a_box() -> None:
    laws = {"0": "restitution: 0, impact: moreau", "-1e-3": "stiffness: 9810, damping: 0"}
    events = []
    for start, law in laws.items():
        jumps = run(read_text(BOX.replace("START", start).replace("LAW", law))).trace.jumps
        events.append([(round(jump.t, 6), jump.region, jump.cause) for jump in jumps])
        events[-1] = [event for event in events[-1] if event[1] != "beside"]
    assert events[0] == events[1]
    assert len(events[0]) >= 16
