"""Impacts of points that touch in turn within a step."""

from __future__ import annotations

import math

import pytest

from statechart import run
from statechart.documents.yaml_reader import read_text

G = 9.81

BAR = """
kind: scene
name: bar
gravity: 9.81
bodies: {s: {mass: 1, inertia: 0.08, start: {y: 9.81*0.45**2/2, angle: TILT}}}
surfaces: {floor: {height: 0}}
contacts:
  r: {point: {body: s, at: [0.5, 0]}, surface: floor, friction: 0, restitution: E, impact: moreau}
  l: {point: {body: s, at: [-0.5, 0]}, surface: floor, friction: 0, restitution: E, impact: moreau}
stop: {time: 0.5}
settings: {engine: impulse, step: STEP}
"""


@pytest.mark.parametrize(
    ("tilt", "e", "step", "warns"),
    [
        (4e-4, 0.5, 1e-3, True),
        (4e-4, 0.5, 2e-5, False),
        (4e-4, 0.0, 1e-3, False),
        (0, 0.5, 1e-3, False),
    ],
)
def test_elastic_impacts_in_turn_that_a_step_makes_at_once_are_told(
    tilt: float, e: float, step: float, warns: bool
) -> None:
    text = BAR.replace("TILT", str(tilt)).replace("E,", f"{e},").replace("STEP", str(step))
    warnings = [line for line in run(read_text(text)).warnings if "at once" in line]
    assert len(warnings) == int(warns)
    # The ends are at heights that differ by 2 L sin(tilt), and fall with g t.
    apart = math.sin(tilt) / (G * 0.45)
    assert all(f"r and l touch {apart:.2g} apart" in line for line in warnings)
