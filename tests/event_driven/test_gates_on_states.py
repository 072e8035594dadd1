"""Contacts go off and come back as controllers enter and leave the states of their conditions."""

from __future__ import annotations

import math

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret

G = 9.81
LIFTED, DOWN, END = 0.5, 1.0, 1.25
STEP = 1e-3
SCENE = """
kind: scene
name: gated
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: HEIGHT, dx: 1}}}
surfaces: {floor: {height: 0}}
contacts:
  b:
    point: {body: ball}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: 0
    enabled: "ENABLED"
regions:
  leg:
    initial: stance
    states:
      stance: {initial: firm, states: {firm: {}, soft: {}}}
      swing: {}
      again: {}
    transitions:
      - {name: soften, from: firm, to: soft, guard: time >= 0.25}
      - {name: lift, from: stance, to: swing, LIFT}
      - {name: down, from: swing, to: again, guard: ball.x >= 1}
stop: {time: 1.25}
"""
# High above the floor: a relation, and when it changes from true at the start to false, and so on.
ALOFT = {
    "in(leg.soft) or not (in(leg.stance) and ball.x >= 0.125)": (0.125, 0.25),
    "in(leg.firm) and ball.x < 0.2 or in(leg.swing) and ball.x >= 0.7": (0.2, 0.7, 1.0),
    "ball.x <= 0.3 and (in(leg.stance) or in(leg.again)) or in(leg.again)": (0.3, 1.0),
    "not in(leg.soft) and not (in(leg.swing) and ball.x > 0.6)": (0.25, 0.5, 0.6, 1.0),
}
LIFTS = pytest.mark.parametrize("lift", ["after: 0.5", "guard: ball.x >= 0.5"])
ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])


def run(enabled: str, height: float, lift: str, engine: str):
    text = SCENE.replace("ENABLED", enabled).replace("HEIGHT", str(height))
    step = {"step": STEP} if engine == "impulse" else {}
    model = interpret(read_text(text.replace("LIFT", lift)))
    return statechart.run(model, engine=engine, **step).trace


def error_of(enabled: str) -> str:
    with pytest.raises(DeclarationError) as caught:
        run(enabled, 0, "after: 0.5", "taylor")
    return str(caught.value)


@ENGINES
@LIFTS
@pytest.mark.parametrize(
    "enabled",
    [
        "in(leg.stance)",
        "in(leg.firm) or in(leg.soft)",
        "not (in(leg.swing) or in(leg.again))",
        "in(leg.stance) or b.gap > 0.1 and time < 0.5",
        "in(leg.stance) and ball.x <= 3",
    ],
)
def test_a_ball_falls_once_a_controller_takes_its_floor(enabled, lift, engine):
    trace = run(enabled, 0, lift, engine)
    assert [jump.cause for jump in trace.jumps] == ["soften", "lift", "disable", "down"]
    within = 2 * STEP if engine == "impulse" else 1e-12
    times = [jump.t for jump in trace.jumps]
    assert times == pytest.approx([0.25, LIFTED, LIFTED, DOWN], abs=within)
    fallen = END - LIFTED
    assert trace.final[1] == pytest.approx(-G * fallen**2 / 2, abs=2 * G * within)


@ENGINES
@LIFTS
def test_contact_is_enabled_by_a_state_that_allows_it(lift, engine):
    # The ball is dropped so that it lands after the floor is back.
    height = G * 1.1**2 / 2
    trace = run("not in(leg.swing)", height, lift, engine)
    causes = ["soften", "lift", "disable", "down", "enable", "touchdown"]
    assert [jump.cause for jump in trace.jumps] == causes
    within = 2 * STEP if engine == "impulse" else 1e-12
    times = [0.25, LIFTED, LIFTED, DOWN, DOWN, 1.1]
    assert [jump.t for jump in trace.jumps] == pytest.approx(times, abs=within)
    assert trace.final[1] == pytest.approx(0, abs=G * within)


@ENGINES
def test_initial_state_may_disable_a_contact(engine):
    trace = run("in(leg.again)", G * 1.1**2 / 2, "after: 0.5", engine)
    assert [jump.cause for jump in trace.jumps] == ["soften", "lift", "down", "enable", "touchdown"]


@ENGINES
def test_an_inner_state_ends_a_contact_inside_its_superstate(engine):
    trace = run("in(leg.firm)", 0, "after: 0.5", engine)
    assert [jump.cause for jump in trace.jumps] == ["soften", "disable", "lift", "down"]
    within = 2 * STEP if engine == "impulse" else 1e-12
    assert trace.final[1] == pytest.approx(-G / 2, abs=2 * G * within)


@ENGINES
@pytest.mark.parametrize("enabled", ALOFT)
def test_states_and_comparisons_switch_a_contact_together(enabled, engine):
    trace = run(enabled, 50, "after: 0.5", engine)
    found = [jump for jump in trace.jumps if jump.cause in ("disable", "enable")]
    expected = ALOFT[enabled]
    within = 2 * STEP if engine == "impulse" else 1e-12
    assert [jump.t for jump in found] == pytest.approx(expected, abs=within)
    causes = ["disable", "enable"] * len(expected)
    assert [jump.cause for jump in found] == causes[: len(expected)]


def test_a_ball_passes_a_floor_that_is_off_until_it_is_below():
    trace = run("not in(leg.swing)", G * 0.75**2 / 2, "after: 0.5", "taylor")
    assert "enable" not in [jump.cause for jump in trace.jumps]
    assert trace.final[1] == pytest.approx(G * (0.75**2 - END**2) / 2, rel=1e-12)
    assert math.isclose(trace.final[0], END)


def test_enabled_accepts_controller_states_only():
    assert "in(b.free) asks for a state of a contact" in error_of("in(b.free)")
    assert "no state 'stanec'" in error_of("in(leg.stanec)")
    assert "no region 'lag'" in error_of("in(lag.stance)")


BESIDE = """
kind: scene
name: beside
coordinates: {q: {start: 1}, z: {start: 2}}
bodies:
  a: {mass: 1, position: [q, 0]}
  d: {mass: 1, position: [0, z]}
forces: {f: {body: a, force: [-q, 0]}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: d}, surface: floor, friction: 0, restitution: 0, enabled: "ENABLED"}}
regions: {idle: {initial: w, states: {w: {}}}}
stop: {time: 3}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("enabled", ["-dq > 0.6", "max(-dq, dz) >= 0.6"])
def test_gate_combines_a_rate_and_a_controller_state(enabled: str, engine: str) -> None:
    text = BESIDE.replace("ENABLED", enabled)
    trace = statechart.run(interpret(read_text(text)), engine=engine).trace
    # -dq = sin(t) passes 0.6 upwards and downwards.
    assert [(jump.cause, jump.t) for jump in trace.jumps] == [
        ("enable", pytest.approx(math.asin(0.6), abs=1e-9)),
        ("disable", pytest.approx(math.pi - math.asin(0.6), abs=1e-9)),
    ]


TURNS = """
kind: scene
name: turns
gravity: 9.81
bodies: {ball: {mass: 1, start: {dx: 2}}}
surfaces: {floor: {height: 0}}
contacts:
  b: {point: {body: ball}, surface: floor, friction: 0, restitution: 0, enabled: "ENABLED"}
regions:
  c:
    initial: counts
    variables: {n: 0}
    states: {counts: {}}
    transitions: [{name: tick, from: counts, every: 0.7, updates: {n: n + 1}}]
stop: {time: 2}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
@pytest.mark.parametrize(
    ("enabled", "off"),
    [
        ("n < 2", 1.4),
        ("max(n, 1) < 2", 1.4),
        ("not n >= 2", 1.4),
        ("floor(time/0.6) < 2", 1.2),
        ("atan2(sin(ball.x), cos(ball.x)) > -1", math.pi / 2),
        ("atan2(sin(ball.x - 4), cos(ball.x - 4)) <= -1 or n < 1", (6.0 - 3.0) / 2.0),
        ("sign(2 - ball.x) > -1", 1.0),
        ("10*max(ball.x - 0.6, 0)**1.5 <= 1", 0.3 + 0.5 * 0.1 ** (2.0 / 3.0)),
    ],
)
def test_contact_goes_off_where_its_condition_jumps_or_comes_to_its_bound(enabled, off, engine):
    step = {"step": STEP} if engine == "impulse" else {}
    model = interpret(read_text(TURNS.replace("ENABLED", enabled)))
    result = statechart.run(model, engine=engine, **step)
    times = [jump.t for jump in result.trace.jumps if jump.cause == "disable"]
    assert times == pytest.approx([off], abs=2 * STEP if step else 1e-12)
    # It falls until the end.
    y = result.trace.final[1]
    assert y == pytest.approx(-0.5 * G * (2.0 - off) ** 2, abs=10 * STEP if step else 1e-11)
    assert not any("stays off" in warning for warning in result.warnings)
