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
def test_a_box_meets_a_wall_of_edges_as_one_of_lines(v, mu):
    for tilt in (0.0, 0.1):
        values = {"v": v, "mu": mu, "tilt": tilt}
        np.testing.assert_allclose(ended("edge", **values), ended("line", **values), atol=1e-9)


def slid(ground: dict[str, str], listed: tuple[str, ...], mu: float) -> np.ndarray:
    text = SCENE.replace(
        "GROUND", "\n".join(f"  {name}: {{{form}}}" for name, form in ground.items())
    )
    text = text.replace("surfaces: [low, rise]", f"surfaces: [{', '.join(listed)}]")
    result = Runner(read_text(text)).run({"mu": mu, "e": 0})
    assert result.trace.outcome.succeeded
    return result.trace.final


FOOT = "[[0.5, 0], [1.5, 0.3]]"


@pytest.mark.parametrize(
    ("low", "rise"),
    [
        ("height: 0", f"edge: {FOOT}"),
        ("height: 1e-9*(x - 0.5)**2", f"edge: {FOOT}"),
        ("edge: [[-5, 0], [5, 0]]", f"edge: {FOOT}"),
        ("edge: [[-5, 0], [0.5, 0]]", "edge: [[1.5, 0.3], [0.5, 0]]"),
        ("circle: [0.5, -1e7], radius: 1e7", f"edge: {FOOT}"),
        ("edge: [[-5, 0], [0.5, 0]]", "edge: [[1/2 + 1e-15, 0], [1.5, 0.3]]"),
    ],
)
def test_a_ramp_on_a_floor_equals_a_ramp_that_ends_at_it(low, rise):
    joined = {"low": "edge: [[-5, 0], [0.5, 0]]", "rise": f"edge: {FOOT}"}
    both = "low", "rise"
    found = slid({"low": low, "rise": rise}, both, 0.05)
    np.testing.assert_allclose(found, slid(joined, both, 0.05), atol=1e-3)


def test_bodies_slide_over_the_ends_of_overlapping_edges():
    whole = slid({"low": "edge: [[-5, 0], [5, 0]]"}, ("low",), 0.1)
    apart = {"low": "edge: [[-5, 0], [0.6, 0]]", "rise": "edge: [[0.4, 0], [5, 0]]"}
    for listed in (("low", "rise"), ("rise", "low")):
        np.testing.assert_allclose(slid(apart, listed, 0.1), whole, atol=1e-12)


def test_foot_of_a_ramp_is_a_corner_unless_the_floor_is_touched():
    free = {"low": "height: 0.05 - 0.05", "rise": "edge: [[0.1, 0], [0.1, -1]]"}
    alone = {"low": "height: 0 - 3", "rise": "edge: [[0.1, 0], [0.1, -1]]"}
    found, same = (slid(ground, ("rise",), 0.1) for ground in (free, alone))
    np.testing.assert_array_equal(found, same)
    # It turns about the end of the edge, on which its lower face is.
    assert abs(found[2]) > 0.1
