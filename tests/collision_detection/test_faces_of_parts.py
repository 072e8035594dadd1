"""Contacts with faces that several parts of a body share, and messages on starts inside."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

SCENE = """
kind: scene
name: faces
bodies:
{bodies}
{surfaces}collisions:
  all: {{bodies: [{names}], {touched}friction: 0, restitution: 0}}
stop: {{time: 0.05}}
settings: {{engine: impulse, step: 1e-3}}
"""
FOOT = "{polygon: [[-0.1, -0.1], [0.2, -0.1], [0.2, 0], [-0.1, 0]]}"
ARM = "{polygon: [[-0.1, -0.1], [0, -0.1], [0, 0.25], [-0.1, 0.25]]}"
# Each has a face at x = -0.1, below y = 0 made by both of its parts.
BODIES = {"an L": (FOOT, ARM), "an L the other way": (ARM, FOOT), "twice the same": (ARM, ARM)}


def scene(bodies, surfaces=""):
    """Return a scene as text; `bodies`: name -> the rest of its declaration."""
    inside = "\n".join(f"  {name}: {{mass: {text}}}" for name, text in bodies.items())
    grounds = f"surfaces: {{{surfaces}}}\n" if surfaces else ""
    touched = "surfaces: [floor], " if surfaces else ""
    return SCENE.format(bodies=inside, names=", ".join(bodies), surfaces=grounds, touched=touched)


@pytest.mark.parametrize("parts", BODIES)
@pytest.mark.parametrize("y", [-0.06, -0.001, 0.0, 0.001, 0.1])
@pytest.mark.parametrize("angle", [0.0, 0.3])
def test_a_common_face_of_two_parts_keeps_bodies_out(parts, y, angle):
    """A disc without restitution moves on beside the heavy body, at no speed along its normal."""
    cos, sin = math.cos(angle), math.sin(angle)
    x = -0.1 - 0.05 - 0.01
    start = f"x: {cos * x - sin * y}, y: {sin * x + cos * y}, dx: {cos}, dy: {sin}"
    shapes = ", ".join(BODIES[parts])
    text = scene(
        {
            "whole": f"1e9, inertia: 1e9, shape: [{shapes}], start: {{angle: {angle}}}",
            "disc": f"1, inertia: 1, shape: {{disc: 0.05}}, start: {{{start}}}",
        }
    )
    trace = Runner(interpret(read_text(text))).run().trace
    final = dict(zip(trace.variables, trace.final.tolist(), strict=True))
    along = cos * final["disc.x"] + sin * final["disc.y"]
    assert along == pytest.approx(-0.15, abs=1e-3)
    assert cos * final["disc.dx"] + sin * final["disc.dy"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (0.1, 0.2, "body 'box' starts 0.1 deep in body 'disc'; move it by (-0.1, 0) out"),
        # Below the box is the floor.
        (0.05, 0.2, "body 'disc' starts 0.1 deep in body 'box'; move it by (0, 0.1) out"),
    ],
)
def test_a_disc_whose_centre_is_on_a_polygon_is_reported(x, y, words):
    box = "{polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}"
    text = scene(
        {
            "box": f"1, inertia: 1, shape: {box}, start: {{y: 0.1}}",
            "disc": f"1, inertia: 1, shape: {{disc: 0.1}}, start: {{x: {x}, y: {y}}}",
        },
        surfaces="floor: {height: 0}",
    )
    with pytest.raises(DeclarationError) as caught:
        Runner(read_text(text)).run()
    assert words in str(caught.value)
