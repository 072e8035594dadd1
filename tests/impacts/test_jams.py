"""Friction that presses contacts into their surfaces: on the way there, and several at once."""

from __future__ import annotations

import math
from functools import cache

import pytest
from runs import ENGINES, engine

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.clock import Clock
from statechart.automaton.laws import UNBOUNDED, Flow, Instant
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.errors import NoConsistentMode
from statechart.execution.simulator import Simulator

ROD = """\
kind: scene
name: rod
parameters: {k: 0.03, mu: 1.5, phi: 1.2, omega: 1, v: 3}
gravity: 1
bodies:
  rod:
    mass: 1
    inertia: k
    start: {x: sin(phi), y: cos(phi), angle: -phi, dx: v + cos(phi)*omega, dy: -sin(phi)*omega,
            dangle: -omega}
surfaces: {floor: {height: 0}}
contacts:
  end: {point: {body: rod, at: [0, -1]}, surface: floor, friction: mu, restitution: 0}
"""
# A heavy ball slides off a light one: friction at both contacts wedges the light one in.
WEDGE = """\
kind: scene
name: wedge
parameters: {mu: 1.5, m: 30, lean: 1.2, v: -1, w: 1}
gravity: 1
bodies:
  low: {mass: 1, start: {y: 0.5, dx: v}}
  high:
    mass: m
    start: {x: sin(lean), y: 0.5 + cos(lean), dx: v + w*cos(lean), dy: -w*sin(lean)}
surfaces:
  floor: {height: 0}
  shell: {circle: [0, 0], radius: 1, body: low}
contacts:
  ground: {point: {body: low, at: [0, -0.5]}, surface: floor, friction: mu, restitution: 0}
  between: {point: {body: high}, surface: shell, friction: mu, restitution: 0}
"""


@cache
def simulator(text: str, name: str) -> Simulator:
    return Simulator(automaton(validate(read_text(text), Scene)), engine(name))


def jam(trace: Trace) -> int:
    return next(i for i, jump in enumerate(trace.jumps) if jump.cause == "jam")


@pytest.mark.parametrize("k", [0.03, 0.001])
def test_a_force_without_bound_stops_the_slip_where_p_vanishes(k: float) -> None:
    trace = simulator(ROD, "taylor").run({"k": k}, until=2.0)
    jump = trace.jumps[jam(trace)]
    _, _, angle, *rates = jump.before
    # p = (1 + s (s - mu c sign(slip)) / k) / m, in sine and cosine of the angle.
    s, c = math.sin(angle), math.cos(angle)
    slip = rates[0] + rates[2] * c
    assert k + s * (s - 1.5 * c * math.copysign(1.0, slip)) == pytest.approx(0.0, abs=1e-8)
    dx, dy, turn = jump.after[3:]
    assert dx + turn * c == pytest.approx(0.0, abs=1e-8)
    assert dy + turn * s == pytest.approx(0.0, abs=1e-8)
    normal, tangential = jump.impulse["end"]
    assert abs(tangential) == pytest.approx(1.5 * normal, rel=1e-12)
    assert jump.energy is not None
    assert jump.energy[1] < jump.energy[0]
    assert any("without bound" in warning for warning in trace.warnings)


def test_the_stop_message_reports_an_unbounded_force() -> None:
    stopping = simulator(ROD + "paradox: stop\n", "taylor")
    trace = stopping.run({}, until=2.0, throw=False)
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    # The run ends where p is zero: round-off decides its sign, and so which message appears.
    _, _, ending = trace.message.partition(
        "the force of end grows without bound: sliding of end is "
    )
    assert ending.removeprefix("about to be ").startswith("inconsistent (Painleve")


def test_a_flow_that_ends_for_another_reason_is_no_jam() -> None:
    built = simulator(ROD, "taylor").automaton
    setup = built.setup({}, 2.2e-16)
    flow, state = built.laws.begin(setup)
    assert flow.mode == ("slide+",)
    assert built.laws.jump(Instant(setup, Clock(), 0, Flow(*flow), state, (UNBOUNDED,))) is None


@pytest.mark.parametrize("name", ENGINES)
def test_contacts_that_jam_each_other_end_the_run(name: str) -> None:
    with pytest.raises(NoConsistentMode, match="several contacts at once, take the engine impulse"):
        simulator(WEDGE, name).run({}, until=0.1)


SCISSORS = """\
kind: scene
name: scissors
parameters: {half: 0.1, w: 0.4}
gravity: 1
coordinates:
  x: {start: 0, rate: -2*w*cos(half)}
  y: {start: 2*cos(half), rate: 2*w*sin(half)}
  a: {start: pi - half, rate: w}
  b: {start: half - pi, rate: -w}
bodies:
  left: {mass: 1, inertia: 0.1, position: [x - sin(a), y + cos(a)], angle: a}
  right: {mass: 3, inertia: 0.1, position: [x - sin(b), y + cos(b)], angle: b}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: left, at: [0, 1]}, surface: floor, friction: 100, restitution: 0}
  B: {point: {body: right, at: [0, 1]}, surface: floor, friction: 0.1, restitution: 0}
"""


def test_folding_rods_report_a_dead_point() -> None:
    trace = simulator(SCISSORS, "taylor").run({}, until=1.0, throw=False)
    assert trace.outcome is Outcome.SINGULAR_MODE
    assert "the constraints of A, B have become dependent" in trace.message
