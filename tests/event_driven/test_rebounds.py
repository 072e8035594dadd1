"""Rebounds: the reasons recorded for them, and gaps within the round-off of time."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
from scipy.optimize import brentq

from contacts.event_driven.compiled_laws import CompiledSceneLaws
from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.clock import Clock
from statechart.automaton.laws import Instant
from statechart.documents.yaml_reader import read_text
from statechart.execution import compiled_loop
from statechart.loading.load import interpret
from statechart.running.runner import Runner

_BALL = """
kind: scene
name: ball
gravity: 10
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts: {foot: {point: {body: ball}, surface: floor, friction: 0, restitution: 0.5}}
stop: {time: 1}
"""
# The ball falls from y = 0.28 to y = -0.32 at x = 0.8.
_HILL = _BALL.replace("start: {y: 1}", "start: {x: 0.8, y: 0.28}").replace(
    "{height: 0}", "{height: -x**2/2}"
)
_BAR = """
kind: scene
name: bar
gravity: 10
bodies: {bar: {mass: 1, inertia: 0.02, start: {y: 1, angle: TILT}}}
surfaces: {floor: {height: 0}}
contacts:
  left: {point: {body: bar, at: [-0.25, 0]}, surface: floor, friction: 0, restitution: 0.5}
  right: {point: {body: bar, at: [0.25, 0]}, surface: floor, friction: 0, restitution: 0.5}
stop: {time: 0.6}
"""
_FALL = math.sqrt(20.0)  # speed after a fall by 1


def _tilted(angle: float) -> list[dict[str, float]]:
    """Speeds at which the ends of a bar leave the floor in its first two impacts."""
    drop, mass, inertia, arm = 1.0 - 0.25 * math.sin(angle), 1.0, 0.02, 0.25 * math.cos(angle)
    speed = math.sqrt(20.0 * drop)
    impulse = 1.5 * speed / (1.0 / mass + arm**2 / inertia)
    rise, turn = impulse / mass - speed, -impulse * arm / inertia
    # The right end meets the floor at the first root of its height.
    height = partial(_height_of_right_end, 0.25 * math.sin(angle), rise, angle, turn)
    time = brentq(height, 1e-3, 0.1)
    end = rise - 10.0 * time + 0.25 * math.cos(angle + turn * time) * turn
    return [{"left": 0.5 * speed}, {"right": -0.5 * end}]


def _height_of_right_end(y: float, rise: float, angle: float, turn: float, t: float) -> float:
    return y + rise * t - 5.0 * t**2 + 0.25 * math.sin(angle + turn * t)


REBOUNDS = {
    "in turn": (_BALL, [{"foot": 0.5 * _FALL}, {"foot": 0.25 * _FALL}]),
    # It falls by 0.6 on a slope of 0.8.
    "on a hill": (_HILL, [{"foot": 0.5 * math.sqrt(20.0 * 0.6 / (1.0 + 0.8**2))}]),
    "at both ends": (_BAR.replace("TILT", "0"), [{"left": 0.5 * _FALL, "right": 0.5 * _FALL}]),
    "at one end, then the other": (_BAR.replace("TILT", "0.3"), _tilted(0.3)),
}


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("case", REBOUNDS)
def test_the_reason_of_a_rebound_is_its_speed(
    case: str, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CompiledSceneLaws, "compiled", lambda self: False)
    monkeypatch.setattr(CompiledSceneLaws, "ready", lambda self: False)
    monkeypatch.setattr(compiled_loop, "_WORTH_COMPILING", -1 if compiled else math.inf)
    text, speeds = REBOUNDS[case]
    scene = interpret(read_text(text))
    assert isinstance(scene, Scene)
    runner = Runner(scene)
    runner.run()  # it makes the modes that the compiled loop knows
    trace = runner.run().trace
    # The compiled loop leaves impacts of several contacts to Python.
    in_loop = compiled and len(speeds[0]) == 1
    assert trace.counts["python_instants"] == (0 if in_loop else len(trace.jumps))
    assert len(trace.jumps) >= len(speeds)
    for jump, leaving in zip(trace.jumps, speeds, strict=False):
        expected = {}
        for name, speed in leaving.items():
            reason = f"it leaves its surface at {speed:.3g}"
            expected |= {f"{name}:free": f"taken: {reason}", f"{name}:slide": reason}
        assert jump.considered == expected


@pytest.mark.parametrize(("fired", "struck"), [(("foot.gap",), True), ((), False)])
def test_a_gap_that_falls_within_the_round_off_of_time_is_closed(
    fired: tuple[str, ...], struck: bool
) -> None:
    # Its margin fell between two floats of time; at the first of them it is above its tolerance.
    scene = interpret(read_text(_BALL))
    assert isinstance(scene, Scene)
    model = automaton(scene)
    setup = model.setup({}, 2.2e-16)
    flow, _ = model.laws_of_events.begin(setup)
    time, speed = 100.0, -20.0
    gap = setup.tolerances["gap"] + 0.9 * math.ulp(time) * abs(speed)
    state = np.array([0.0, gap, 0.0, speed])
    at = Instant(setup, Clock(time), 0, flow, state, fired)
    result = model.laws_of_events.jump(at)
    assert (result is not None and result[0] is not None) == struck
