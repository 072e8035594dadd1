"""Reasons of rebounds: the recorded candidates agree with the impact law."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.event_driven.compiled_laws import CompiledSceneLaws
from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.clock import Clock
from statechart.automaton.laws import Instant
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner


@pytest.mark.parametrize(
    ("name", "values"),
    [("bouncing_ball", {}), ("bouncing_ball_hills", {}), ("two_balls", {"h2": 1.6, "apart": 0.7})],
)
def test_candidates_at_a_rebound_agree_with_the_laws(
    name: str, values: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = Runner(name)

    def path_entries() -> list[dict[str, str]]:
        return [dict(jump.considered) for jump in runner.run(values).trace.jumps]

    found = path_entries()
    assert sum("taken: it leaves its surface at" in str(event) for event in found) > 2
    monkeypatch.setattr(CompiledSceneLaws, "_rebound", lambda *_: None)
    assert path_entries() == found


_BALL = """
kind: scene
name: ball
gravity: 10
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts: {foot: {point: {body: ball}, surface: floor, friction: 0, restitution: 0.5}}
stop: {time: 1}
"""


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
