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


@pytest.mark.parametrize(
    ("old", "new", "event", "known"),
    [
        ("{height: 0}", "{circle: [0, -1], radius: 1}", "ball.impact", True),
        ("{height: 0}", "{circle: [0, 1], radius: 1, hollow: true}", "ball.impact", True),
        ("{height: 0}", "{height: 0.1*x**2}", "ball.impact", False),
        ("{y: 0.25}}", "{x: index, y: 0.25}, copies: 2}", "ball1.impact", False),
        ("{y: 0.25}}", "{x: index, y: 0.25}, copies: 1}", "ball0.impact", False),
        ("friction: 0.5", "friction: 0", "ball.impact", True),
    ],
    ids=["circle", "drum", "valley", "copies", "one copy", "smooth"],
)
def test_a_single_disc_on_one_line_or_circle_has_no_impact(
    old: str, new: str, event: str, known: bool
) -> None:
    text = BALL.replace("SHAPE", DISC).replace("SURFACES", "[floor]").replace("MU", "0.5")
    result = run(read_text(text.replace("EVENT", event).replace(old, new)))
    found = [text for text in result.trace.warnings if "never happens" in text]
    events = "touchdown, liftoff" + ", slip, stick" * ("friction" not in old)
    expected = f"outputs.t: {event} never happens in this scene; its events are {events}"
    assert found == [expected] * known


@pytest.mark.parametrize(("mu", "warned"), [("0", True), ("0.5", False)])
@pytest.mark.parametrize(
    ("start", "body"), [("{y: 0.25}}", "ball"), ("{x: index, y: 0.25}, copies: 2}", "ball1")]
)
def test_transition_on_an_event_that_its_body_never_has_warns(
    start: str, body: str, mu: str, warned: bool
) -> None:
    region = (
        "regions: {r: {initial: a, states: {a: {}, b: {}}, "
        f"transitions: [{{name: go, from: a, to: b, on: {body}.stick}}]}}}}\nstop:"
    )
    text = BALL.replace("SHAPE", DISC).replace("SURFACES", "[floor]").replace("MU", mu)
    text = text.replace("EVENT", f"{body}.touchdown").replace("stop:", region)
    result = run(read_text(text.replace("{y: 0.25}}", start)))
    found = [text for text in result.trace.warnings if "never happens" in text]
    causes = "touchdown, impact, liftoff" if body == "ball1" else "touchdown, liftoff"
    expected = f"{body}.stick never happens in this scene; its events are {causes}"
    assert found == [f"regions.r.transitions.0: {expected}"] * warned
