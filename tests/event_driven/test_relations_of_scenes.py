"""Controllers and stop conditions of scenes with several comparisons, by events and by steps."""

from __future__ import annotations

import math

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G = 9.81
# The ball falls to the floor, rests there and slides against friction until it stops.
FALL = math.sqrt(2 * 0.5 / G)
V = 1.0 - 0.2 * G * FALL  # speed along the floor after the friction of the landing
STOPS = FALL + V / (0.2 * G)
SCENE = """
kind: scene
name: watched
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 0.5, dx: 1}}}
surfaces: {floor: {height: 0}}
controls: {push: 0}
forces: {f: {body: ball, force: [0, push]}}
contacts: {foot: {point: {body: ball}, surface: floor, friction: 0.2, restitution: 0}}
regions:
  c:
    variables: {n: 0}
    initial: w
    states: {w: {}, "on": {sets: {push: 1}}}
    transitions: [{name: go, from: w, to: "on", guard: "GUARD"}]
stop: {time: 1, conditions: {met: "STOP"}}
"""
FIRST = {
    "max(ball.y - 0.25, n) <= 0": FALL / math.sqrt(2),
    "ball.y <= 0.25 and ball.dx >= 0": FALL / math.sqrt(2),
    "abs(ball.y - 0.25) <= 0.125": math.sqrt(2 * 0.125 / G),
    "in(foot.closed) and time > 0.1": FALL,
    "in(foot.slide)": FALL,
    "in(foot.slide+) and not in(foot.slide-)": FALL,
    "not in(foot.free) and max(ball.dx, 2*n) <= 0": STOPS,
    "in(foot.pin) and n == 0": STOPS,
    "foot.V > 0 and ball.x <= 2": FALL,
}
ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
STEP = 1e-4


def run(engine: str, guard: str, stop: str):
    text = SCENE.replace("GUARD", guard).replace("STOP", stop)
    step = {"step": STEP} if engine == "impulse" else {}
    return statechart.run(interpret(read_text(text)), engine=engine, **step).trace


@ENGINES
@pytest.mark.parametrize("relation", FIRST)
def test_a_controller_answers_when_its_relation_first_holds(relation, engine):
    fired = [j.t for j in run(engine, relation, "time > 2").jumps if j.cause == "go"]
    # Friction in steps ends a slip at the end of the step after it.
    within = 5 * STEP if engine == "impulse" else 1e-9
    assert fired == [pytest.approx(FIRST[relation], abs=within)]


@ENGINES
@pytest.mark.parametrize("relation", FIRST)
def test_a_run_stops_when_its_condition_first_holds(relation, engine):
    trace = run(engine, "time > 2", relation)
    within = 5 * STEP if engine == "impulse" else 1e-9
    assert trace.jumps[-1].cause == "stop"
    assert trace.t_end == pytest.approx(FIRST[relation], abs=within)


@ENGINES
def test_a_condition_waits_for_a_controller(engine):
    trace = run(engine, "ball.y <= 0.25", "in(c.on) and ball.y <= 0.2 and n == 0")
    within = 5 * STEP if engine == "impulse" else 1e-9
    assert [jump.cause for jump in trace.jumps] == ["go", "stop"]
    assert 0 < trace.t_end - math.sqrt(2 * 0.3 / G) + within < 1e-2
