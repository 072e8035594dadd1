"""The energy of random heaps never grows by more than the scheme's bound."""

from __future__ import annotations

import numpy as np
import pytest

from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.body_properties import assert_depths, assert_energy_of_steps
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.testing.subject import Subject

HEAP = """
kind: scene
name: boxes
parameters: {{n: {n}, e: {e}, mu: {mu}}}
gravity: 9.81
bodies:
  box:
    copies: n
    mass: 1
    inertia: 0.01
    shape: {{polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}}
    start:
      x: {aside}*sin(3*index + {phase})
      y: 0.1 + {apart}*(index + {lifted})
      angle: {tilt}*sin(5*index + {phase})
      dx: {speed}*cos(index)
surfaces: {{ground: {{height: 0}}, left: {{line: [[-1, 1], [-1, 0]]}}}}
collisions: {{all: {{bodies: [box], surfaces: [ground, left], friction: mu, restitution: e}}}}
stop: {{time: {time}}}
settings: {{engine: impulse, step: {step}}}
"""
STACK = {"aside": 0.02, "apart": 0.2, "lifted": 0, "tilt": 0, "speed": 0}
DROPPED = {"aside": 0.05, "apart": 0.21, "lifted": 0.1, "tilt": 0, "speed": 0.5}
THROWN = {"aside": 0.1, "apart": 0.45, "lifted": 0.5, "tilt": 0.7, "speed": 2}


@pytest.mark.parametrize("start", [STACK, DROPPED, THROWN])
@pytest.mark.parametrize(
    ("restitution", "law"), [(0, "capped"), (1, "capped"), (0, "sequential"), (1, "sequential")]
)
@pytest.mark.parametrize("friction", ["0", "0.3", "2", "inf"])
def test_energy_and_depth_stay_within_the_bounds_of_a_step(start, restitution, law, friction):
    generator = np.random.default_rng(5 + len(friction) + 10 * restitution)
    step = float(generator.choice([1e-2, 3e-3, 1e-3]))
    text = HEAP.format(
        n=generator.integers(4, 10),
        e=restitution,
        mu=friction,
        phase=generator.uniform(0, 6),
        time=0.8,
        step=step,
        **start,
    )
    subject = Subject(interpret(read_text(f"{text}simultaneous: {law}\n")))
    trace = subject.case({}).trace
    assert trace.outcome.succeeded, trace.message
    scene = subject.model
    numbers = body_numbers(scene, scene.values())
    assert_energy_of_steps(numbers, subject, trace)
    assert_depths(numbers, trace)


SHAPES = {
    "stick": "[[-0.3, -0.02], [0.3, -0.02], [0.3, 0.02], [-0.3, 0.02]]",
    "wedge": "[[-0.2, -0.1], [0.3, -0.1], [-0.2, 0.15]]",
    "hexagon": "[[0.2, 0], [0.1, 0.17], [-0.1, 0.17], [-0.2, 0], [-0.1, -0.17], [0.1, -0.17]]",
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("restitution", "friction"), [(0, "0"), (0, "0.5"), (1, "0.5")])
def test_tumbling_shapes_gain_no_energy(shape: str, restitution: int, friction: str) -> None:
    # Corners turn off and onto the ground and other bodies by up to 0.3 rad in a step.
    text = HEAP.format(
        n=6, e=restitution, mu=friction, phase=1.0, time=0.8, step=1e-2,
        aside=0.2, apart=0.5, lifted=0.5, tilt=3, speed=2,
    )  # fmt: skip
    corners = "[[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]"
    text = text.replace(corners, SHAPES[shape])
    text = text.replace("      dx:", "      dangle: 30*cos(2*index)\n      dx:")
    assert SHAPES[shape] in text
    subject = Subject(interpret(read_text(text)))
    trace = subject.case({}).trace
    assert trace.outcome.succeeded, trace.message
    scene = subject.model
    numbers = body_numbers(scene, scene.values())
    assert_energy_of_steps(numbers, subject, trace)
    assert_depths(numbers, trace)
