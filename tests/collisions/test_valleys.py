"""A ground of edges, with a valley, is the same as one of lines that never end."""

from __future__ import annotations

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

SCENE = """kind: scene
name: valley
parameters: {v: 2, mu: 0.4, e: 0.2, tilt: 0}
gravity: 9.81
bodies:
  box:
    mass: 1
    inertia: 0.02
    start: {x: 0, y: 0.1 + 0.2*sin(tilt), angle: tilt, dx: v}
    shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}
surfaces:
GROUND
collisions:
  all: {bodies: [box], surfaces: [low, rise], friction: mu, restitution: e}
stop: {time: 0.6}
settings: {engine: impulse, step: 1e-3}
"""


def ended(kind: str, **values: float) -> np.ndarray:
    ground = f"""  low: {{{kind}: [[-5, 0], [0.5, 0]]}}
  rise: {{{kind}: [[0.5, 0], [0.5, 3]]}}"""
    result = Runner(read_text(SCENE.replace("GROUND", ground))).run(values)
    assert result.trace.outcome.succeeded
    return result.trace.final


@pytest.mark.parametrize("v", [0.7, 2.0, 3.0])
@pytest.mark.parametrize("mu", [0.0, 0.1, 0.4, 1.0])
def test_a_box_that_comes_to_a_wall_does_what_it_does_before_lines(v, mu):
    for tilt in (0.0, 0.1):
        values = {"v": v, "mu": mu, "tilt": tilt}
        np.testing.assert_allclose(ended("edge", **values), ended("line", **values), atol=1e-9)
