"""Landings on surfaces that curve up from flat: one touchdown, at the closed form's instant."""

from __future__ import annotations

import math

import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

RAMP = """
kind: scene
name: ramp
gravity: 0
bodies: {b: {mass: 1, start: {x: -1, dx: SPEED}}}
surfaces: {floor: {height: HEIGHT}}
contacts:
  c: {point: {body: b}, surface: floor, friction: 0, restitution: BOUNCE, impact: moreau, GATE}
stop: {time: 0.9}
settings: {engine: impulse, step: STEP}
"""


@pytest.mark.parametrize("height", ["5*x**3", "50*x**3", "5*x**5", "5*x**2"])
@pytest.mark.parametrize("bounce", ["0", "0.5", "0.9"])
@pytest.mark.parametrize(("speed", "step"), [(1.237, 1e-3), (2.0, 1e-3), (3.0, 2.5e-4)])
def test_point_that_meets_a_surface_tangentially_lands_once(
    height: str, bounce: str, speed: float, step: float
) -> None:
    text = RAMP.replace("GATE", "enabled: b.x >= 0" if "**2" in height else "")
    for word, value in (("HEIGHT", height), ("BOUNCE", bounce), ("SPEED", speed), ("STEP", step)):
        text = text.replace(word, str(value))
    trace = run(read_text(text)).trace
    events = [jump for jump in trace.jumps if jump.cause != "enable"]
    assert [jump.cause for jump in events] == ["touchdown"]
    assert events[0].t == pytest.approx(1 / speed, abs=2 * step)
    # Without friction the surface turns the velocity, and keeps its size.
    assert math.hypot(*trace.final[2:]) == pytest.approx(speed, rel=1e-4)


@pytest.mark.parametrize(
    "shape", ["{disc: 0.05}", "{polygon: [[0.3, 0], [-0.15, 0.2], [-0.15, -0.2]]}"]
)
@pytest.mark.parametrize("bounce", ["0", "0.5", "0.9"])
@pytest.mark.parametrize("turning", [0.0, 2.0])
def test_disc_or_corner_that_starts_along_a_hollow_circle_lands_once(
    shape: str, bounce: str, turning: float
) -> None:
    """Without friction and gravity the circle keeps the energy and its moment about the centre."""
    text = f"""
kind: scene
name: drum
gravity: 0
bodies:
  b: {{mass: 1, inertia: 0.05, shape: {shape}, start: {{x: X, dy: 2, dangle: {turning}}}}}
surfaces: {{drum: {{circle: [0, 0], radius: 1, hollow: true}}}}
collisions: {{a: {{bodies: [b], surfaces: [drum], friction: 0, restitution: {bounce}}}}}
stop: {{time: 0.1}}
settings: {{engine: impulse, step: 1e-3}}
"""
    start = 0.95 if "disc" in shape else 0.7
    trace = run(read_text(text.replace("X", str(start)))).trace
    assert [jump.cause for jump in trace.jumps] == ["touchdown"]
    x, y, _, dx, dy, dangle = trace.final
    assert dx * dx + dy * dy + 0.05 * dangle**2 == pytest.approx(4 + 0.05 * turning**2, rel=2e-3)
    moment = x * dy - y * dx + 0.05 * dangle
    assert moment == pytest.approx(2 * start + 0.05 * turning, rel=2e-3)
