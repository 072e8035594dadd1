"""Awaited events of bodies with shapes that cannot happen: a warning names those that can."""

from __future__ import annotations

import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

BALL = """
kind: scene
name: ball
gravity: 9.81
bodies: {ball: {mass: 1, inertia: 0.001, shape: SHAPE, start: {y: 0.25}}}
surfaces: {floor: {height: 0}, wall: {line: [[9, 0], [9, 1]]}}
collisions: {all: {bodies: [ball], surfaces: SURFACES, friction: MU, restitution: 0}}
stop: {time: 0.4}
settings: {engine: impulse, step: 1e-3}
outputs:
  t: {value: time, at: first EVENT}
"""
DISC, BOX = "{disc: 0.05}", "{polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}"


@pytest.mark.parametrize(
    ("shape", "surfaces", "mu", "event", "known"),
    [
        (DISC, "[floor]", "0.5", "ball.impact", "touchdown, liftoff, slip, stick"),
        (DISC, "[floor]", "0", "ball.stick", "touchdown, liftoff"),
        (BOX, "[floor, wall]", "0", "ball.pin", "touchdown, impact, liftoff"),
        (DISC, "[floor, wall]", "0.5", "ball.impact", ""),
        (BOX, "[floor]", "0.5", "ball.impact", ""),
        (DISC, "[floor]", "0.5", "ball.stick", ""),
        (DISC, "[floor]", "{static: 0, kinetic: 0}", "ball.stick", ""),
    ],
)
def test_output_at_an_event_that_its_body_never_has_warns(
    shape: str, surfaces: str, mu: str, event: str, known: str
) -> None:
    text = BALL.replace("SHAPE", shape).replace("SURFACES", surfaces)
    result = run(read_text(text.replace("MU", mu).replace("EVENT", event)))
    found = [text for text in result.trace.warnings if "never happens" in text]
    expected = f"outputs.t: {event} never happens in this scene; its events are {known}"
    assert found == ([expected] if known else [])
    if known:
        assert result.outputs["t"] is None
