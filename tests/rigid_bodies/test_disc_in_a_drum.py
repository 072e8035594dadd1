"""Discs that start on the inside of a drum without gravity, against closed forms."""

from __future__ import annotations

import math

import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

DRUM = """
kind: scene
name: drum
gravity: 0
bodies: {ball: {mass: 1, inertia: 0.00125, shape: {disc: 0.05}, start: {x: 0.95, dy: 2}}}
surfaces: {drum: {circle: [0, 0], radius: 1, hollow: true, turn: TURN}}
collisions: {all: {bodies: [ball], surfaces: [drum], friction: 0.3, restitution: BOUNCE}}
stop: {time: 0.3}
settings: {engine: impulse, step: STEP}
"""


@pytest.mark.parametrize("step", [1e-3, 1e-4])
@pytest.mark.parametrize("bounce", [0, 0.5, 0.9])
@pytest.mark.parametrize("turn", ["0", "2*time", "-10*time"])
def test_disc_that_starts_along_a_drum_touches_once(turn: str, bounce: float, step: float) -> None:
    text = DRUM.replace("TURN", turn).replace("BOUNCE", str(bounce)).replace("STEP", str(step))
    trace = run(read_text(text)).trace
    assert [jump.cause for jump in trace.jumps] == ["touchdown"]
    # It rolls with a drum that turns at its speed; else v' = -mu v^2/(R - r).
    way, mu, apart = 2.0 * 0.3, 0.3, 0.95
    angle = way / apart if turn == "2*time" else math.log(1 + mu * way / apart) / mu
    assert trace.final[0] == pytest.approx(apart * math.cos(angle), abs=2e-2 * step)
