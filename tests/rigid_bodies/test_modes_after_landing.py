"""Bodies with shapes by steps have the events of their corners with events."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STEP = 1e-3
TRIANGLE = [(0.2, 0.02), (-0.12, 0.15), (-0.1, -0.16)]
SQUARE = [(-0.168, -0.138), (0.168, -0.138), (0.168, 0.138), (-0.168, 0.138)]
FLAT = [(-0.25, -0.08), (0.25, -0.08), (0.25, 0.08), (-0.25, 0.08)]

# Corners, friction, slope, angle, and velocities at the start.
THROWS = {
    "square rocks": (SQUARE, 0.95, 0.187, 2.059, (1.259, -0.208, -2.917)),
    "square slides": (SQUARE, 0.15, 0.1, 0.4, (-1.0, 0.0, 2.0)),
    "flat turns back": (FLAT, 0.5, -0.1, 0.3, (0.8, -0.5, -3.0)),
    "flat without friction": (FLAT, 0.0, 0.05, -0.5, (0.3, 0.0, 3.5)),
    "triangle": (TRIANGLE, 0.3, 0.05, 0.7, (0.6, 0.2, -2.0)),
    "rough triangle": (TRIANGLE, 1.1, -0.15, -1.1, (-0.9, 0.1, 3.0)),
}


def text(name: str, shapes: bool) -> str:
    """Return a scene of a body that is thrown, with a shape or with points at its corners."""
    corners, mu, slope, angle, (dx, dy, dangle) = THROWS[name]
    polygon = ", ".join(f"[{x}, {y}]" for x, y in corners)
    modes = "" if mu > 0.0 else ", modes: [free, slide]"
    law = f"surface: floor, friction: {mu}, restitution: 0, impact: moreau{modes}"
    points = "\n".join(
        f"  c{i}: {{point: {{body: b, at: [{x}, {y}]}}, {law}}}" for i, (x, y) in enumerate(corners)
    )
    touched = f"  all: {{bodies: [b], surfaces: [floor], friction: {mu}, restitution: 0}}"
    return f"""
kind: scene
name: thrown
gravity: 9.81
bodies:
  b: {{mass: 2, inertia: 0.04, start: {{y: 0.6, angle: {angle}, dx: {dx}, dy: {dy},
    dangle: {dangle}}}{f", shape: {{polygon: [{polygon}]}}" if shapes else ""}}}
surfaces: {{floor: {{line: [[-6, {-6 * slope}], [6, {6 * slope}]]}}}}
{"collisions" if shapes else "contacts"}:
{touched if shapes else points}
stop: {{time: 0.6}}
settings: {{{f"engine: impulse, step: {STEP}" if shapes else "engine: taylor"}}}
"""


def events(name: str, shapes: bool) -> list[tuple[float, str]]:
    """Return times and modes of a body at its changes; points have their joint mode."""
    trace = Runner(interpret(read_text(text(name, shapes)))).run({}).trace
    found: list[tuple[float, str]] = []
    for arc in trace.arcs:
        kinds = {mode.rstrip("+-") for mode in arc.mode}
        mode = next((mode for mode in ("pin", "slide") if mode in kinds), "free")
        if not found or mode != found[-1][1]:
            found.append((arc.start.high, mode))
    return found


@pytest.mark.parametrize("name", THROWS)
def test_a_landing_box_has_the_events_of_its_corners(name):
    shaped, exact = events(name, True), events(name, False)
    assert [mode for _, mode in shaped] == [mode for _, mode in exact]
    assert [t for t, _ in shaped] == pytest.approx([t for t, _ in exact], abs=4 * STEP)
