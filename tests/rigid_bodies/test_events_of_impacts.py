"""Event names of impacts, for struck bodies and others whose contacts change."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STEP, LARGE, SMALL, AWAY, SPEED = 1e-3, 0.1, 0.05, 0.5, 2.0

STRUCK = f"""
kind: scene
name: struck
gravity: 9.81
bodies:
  ball: {{mass: 1, inertia: 0.005, shape: {{disc: {LARGE}}}, start: {{x: 0, y: {LARGE}}}}}
  club: {{mass: 5, inertia: 0.006, shape: {{disc: {SMALL}}},
    start: {{x: {-AWAY}, y: {SMALL}, dx: {SPEED}}}}}
surfaces: {{ground: {{height: 0}}}}
collisions: {{all: {{bodies: [ball, club], surfaces: [ground], friction: 0, restitution: 0.2}}}}
outputs:
  off: {{value: time, at: first ball.liftoff}}
  hit: {{value: time, at: first ball.impact}}
  slips: {{count: ball.slip}}
stop: {{time: 0.3}}
settings: {{engine: impulse, step: {STEP}}}
"""

# A plank on a pivot, a ball on its one end: its other end is struck, then it strikes the ground.
DROP, RAISED = 0.4, 0.25
TIPPED = f"""
kind: scene
name: tipped
gravity: 9.81
bodies:
  plank: {{mass: 1, inertia: 0.35, start: {{y: {RAISED}}},
    shape: {{polygon: [[-1, -0.05], [1, -0.05], [1, 0.05], [-1, 0.05]]}}}}
  ball: {{mass: 0.1, inertia: 4e-4, shape: {{disc: 0.1}}, start: {{x: 0.9, y: {RAISED + 0.15}}}}}
  load: {{mass: 1, inertia: 4e-3, shape: {{disc: 0.1}},
    start: {{x: -0.9, y: {RAISED + 0.15 + DROP}}}}}
surfaces: {{ground: {{height: 0}}}}
joints: {{pivot: {{point: {{body: plank, at: [0, 0]}}, to: [0, {RAISED}]}}}}
collisions:
  all: {{bodies: [plank, ball, load], surfaces: [ground], friction: 0.3, restitution: 0.3}}
outputs:
  off: {{value: time, at: first ball.liftoff}}
  free: {{value: time, at: first ball.free}}
  hits: {{count: ball.impact}}
  blow: {{value: time, at: first plank.impact}}
  ground: {{value: time, at: last plank.impact}}
stop: {{time: 0.39}}
settings: {{engine: impulse, step: {STEP}}}
"""


def outputs(scene: str) -> dict[str, object]:
    return dict(Runner(interpret(read_text(scene))).run().outputs)


def test_a_struck_body_that_flies_off_has_an_impact_and_a_liftoff() -> None:
    found = outputs(STRUCK)
    # Two discs on one ground touch where their middles are 2 sqrt(R r) apart.
    met = (AWAY - 2 * math.sqrt(LARGE * SMALL)) / SPEED
    assert found["off"] == found["hit"] == pytest.approx(met, abs=STEP)
    assert found["slips"] == 0


def test_a_body_that_lifts_off_by_another_impact_has_a_liftoff_only() -> None:
    found = outputs(TIPPED)
    # The ball's weight raises the end that the load meets.
    turns = 0.1 * 9.81 * 0.9 / (0.35 + 0.1 * 0.9**2)
    met = math.sqrt(2 * DROP / (9.81 + 0.9 * turns))
    assert found["blow"] == pytest.approx(met, abs=2 * STEP) != found["ground"]
    # The ball flies on when the end under it meets the ground.
    assert found["off"] == found["free"] == found["ground"]
    assert found["hits"] == 0
