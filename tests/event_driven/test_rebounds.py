"""Rebounds: the reasons recorded for them, and gaps within the round-off of time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.clock import Clock
from statechart.automaton.laws import Instant
from statechart.documents.yaml_reader import read_text
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


def test_the_reason_of_a_rebound_is_its_speed() -> None:
    scene = interpret(read_text(_BALL))
    assert isinstance(scene, Scene)
    runner = Runner(scene)
    for _ in range(2):  # the compiled loop takes the second run
        jumps = runner.run().trace.jumps
        for k, jump in enumerate(jumps[:3]):
            leaving = f"it leaves its surface at {math.sqrt(20.0) / 2 ** (k + 1):.3g}"
            reasons = {"free": f"taken: {leaving}", "slide": leaving}
            assert jump.considered == {f"foot:{state}": why for state, why in reasons.items()}


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
