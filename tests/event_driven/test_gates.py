"""Contacts go off and come back when their conditions of several comparisons change."""

from __future__ import annotations

import math

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G = 9.81
LANDS = math.sqrt(0.2 / G)
SCENE = """
kind: scene
name: gated
gravity: 9.81
parameters: {k: 0}
bodies: {ball: {mass: 1, start: {y: HEIGHT, dx: 1}}}
surfaces: {floor: {height: 0}}
contacts:
  b:
    point: {body: ball}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: 0
    enabled: ENABLED
stop: {time: 2}
"""
# On a floor of height 0.1 below the ball until x = 1.
UNTIL_ONE = [
    "max(ball.x - 1, 0) <= 0",
    "max(1 - ball.x, 0) > 0",
    "max(ball.x - 1, k) <= 0",
    "max(1 - ball.x, k) > 0",
    "abs(ball.x) <= 1",
    "not (ball.x > 1 and time >= 0)",
    "ball.x <= 1 or ball.x >= 3",
]
# High above it: the relation, and when it changes from true at the start to false, and so on.
ALOFT = {
    "min(ball.x, 1 - ball.x) >= 0 or ball.x >= 1.5": (1.0, 1.5),
    "abs(ball.x - 1) >= 0.25 and max(k, ball.x - 1.75) <= 0": (0.75, 1.25, 1.75),
    "sin(4*time) >= 0 or (time >= 0.9 and ball.x <= 1.25)": (math.pi / 4, 0.9, 1.25, math.pi / 2),
    "2 - 3*max(ball.x, k) > 0.5": (0.5,),
    "k*abs(ball.x) + ball.x <= 0.5 and k == 0": (0.5,),
}
ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
STEP = 1e-3


def run(enabled: str, height: float, engine: str):
    text = SCENE.replace("ENABLED", f'"{enabled}"').replace("HEIGHT", str(height))
    step = {"step": STEP} if engine == "impulse" else {}
    return statechart.run(interpret(read_text(text)), engine=engine, **step).trace


@ENGINES
@pytest.mark.parametrize("enabled", UNTIL_ONE)
def test_floor_ends_with_its_condition(enabled, engine):
    trace = run(enabled, 0.1, engine)
    within = 2 * STEP if engine == "impulse" else 1e-12
    assert [jump.cause for jump in trace.jumps] == ["touchdown", "disable"]
    assert [jump.t for jump in trace.jumps] == pytest.approx([LANDS, 1.0], abs=within)
    assert trace.final[1] == pytest.approx(-G / 2, abs=G * within)


@ENGINES
@pytest.mark.parametrize("enabled", ALOFT)
def test_every_change_of_a_relation_switches_the_contact(enabled, engine):
    trace = run(enabled, 50, engine)
    within = 2 * STEP if engine == "impulse" else 1e-12
    expected = ALOFT[enabled]
    assert [jump.cause for jump in trace.jumps] == ["disable", "enable", "disable", "enable"][
        : len(expected)
    ]
    assert [jump.t for jump in trace.jumps] == pytest.approx(expected, abs=within)


@pytest.mark.parametrize("enabled", UNTIL_ONE[:3])
def test_check_judges_whole_relations(enabled):
    text = SCENE.replace("ENABLED", f'"{enabled}"').replace("HEIGHT", "0.1")
    report = statechart.check(interpret(read_text(text)), examples=1)
    assert report.passed, report


def test_a_point_inside_its_surface_comes_back_once_its_gap_opens():
    # It passes the floor twice, the second time at 0.3 s; its condition is 0 all the time.
    rises = (0.3 * G / 2) + 0.1 / 0.3
    text = SCENE.replace("ENABLED", '"max(ball.x - 1, k) <= 0"').replace("HEIGHT", "-0.1")
    text = text.replace("dx: 1", f"dx: 1, dy: {rises!r}") + "modes: {b: off}\n"
    trace = statechart.run(interpret(read_text(text))).trace
    assert [jump.cause for jump in trace.jumps][:1] == ["enable"]
    assert trace.jumps[0].t == pytest.approx(0.2 / (G * 0.3), abs=1e-12)


@ENGINES
def test_a_strict_relation_does_not_hold_of_a_velocity_that_friction_stops_at_zero(engine):
    text = """\
kind: scene
name: strict_rate
gravity: 10
bodies: {b: {mass: 1, start: {dx: 1}}, w: {mass: 1, start: {x: 1, y: 0.5}}}
surfaces: {floor: {height: 0}, low: {height: 0}}
contacts:
  c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0}
  d: {point: {body: w}, surface: low, friction: 0.5, restitution: 0, enabled: "b.dx < 0"}
stop: {time: 1.5}
"""
    step = {"step": STEP} if engine == "impulse" else {}
    trace = statechart.run(interpret(read_text(text)), engine=engine, **step).trace
    assert trace.final[3] == pytest.approx(0.5 - 5.0 * 1.5**2)


@ENGINES
@pytest.mark.parametrize("belt", [0.3, 0.25])
def test_a_strict_relation_fails_where_a_belt_holds_the_body_at_its_speed(belt, engine):
    text = f"""\
kind: scene
name: slowed_by_a_belt
gravity: 10
bodies: {{b: {{mass: 1, start: {{dx: 0.9}}}}}}
surfaces: {{floor: {{height: 0, displacement: ["{belt}*time", 0]}}}}
contacts:
  c: {{point: {{body: b}}, surface: floor, friction: 0.5, restitution: 0, enabled: "b.dx > {belt}"}}
stop: {{time: 1}}
"""
    step = {"step": STEP} if engine == "impulse" else {}
    trace = statechart.run(interpret(read_text(text)), engine=engine, **step).trace
    fall = 1.0 - (0.9 - belt) / 5.0
    tolerance = {"abs": 20.0 * STEP} if step else {"rel": 1e-9}
    assert trace.final[1] == pytest.approx(-5.0 * fall**2, **tolerance)
    assert trace.final[2] == pytest.approx(belt, abs=1e-9 if not step else STEP * 10.0)
