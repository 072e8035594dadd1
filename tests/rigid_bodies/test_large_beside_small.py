"""A small box on a large one: neither its size nor the order of declaration matters."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

TABLE = """
  table: {{mass: 1e9, inertia: 1e12, start: {{x: {x}, y: -0.5}},
    shape: {{polygon: [[{a}, -0.5], [{b}, -0.5], [{b}, 0.5], [{a}, 0.5]]}}}}"""
BOX = """
  box: {{mass: 1, inertia: 0.0125/3, start: {{x: {x}, y: 0.05, dx: {dx}}},
    shape: {{polygon: [[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]}}}}"""
SCENE = """
kind: scene
name: ledge
gravity: 9.81
bodies: {bodies}
surfaces: {{ground: {{height: -1}}}}
collisions:
  all: {{bodies: [box, table], surfaces: [ground], friction: {mu}, restitution: 0}}
forces: {{push: {{body: box, force: [{push}, 0]}}}}
stop: {{time: 0.5}}
settings: {{engine: impulse, step: 1e-3}}
"""


def end(length, first, *, x, dx, mu, push=0):
    """Return where a box is that slides on a table, which ends at x = 0 or goes on."""
    table = TABLE.format(x=-length / 2 if dx else 0, a=-length / 2, b=length / 2)
    box = BOX.format(x=x, dx=dx)
    bodies = table + box if first == "table" else box + table
    text = SCENE.format(bodies=bodies, mu=mu, push=push)
    trace = Runner(interpret(read_text(text))).run().trace
    final = dict(zip(trace.variables, trace.final.tolist(), strict=True))
    return [final[f"box.{name}"] for name in ("x", "y", "angle")]


@pytest.mark.parametrize("first", ["table", "box"])
@pytest.mark.parametrize("length", [2, 20, 200])
def test_a_box_tips_over_the_edge_of_a_table_as_by_its_equations_of_motion(length, first):
    """Integrated apart: it tips from x = -mu b on, on the corner of the table, and leaves it.

    The normal on the corner is that of the box's face.
    """
    found = end(length, first, x=-0.05, dx=0.6, mu=0.2)
    assert found == pytest.approx([0.1391162, -0.3731838, -2.3274448], abs=4e-5)


@pytest.mark.parametrize("first", ["table", "box"])
@pytest.mark.parametrize("length", [2, 1000])
def test_a_box_rests_on_both_its_corners_however_long_its_table(length, first):
    found = end(length, first, x=0.1, dx=0, mu=0.5, push=3)
    assert found == pytest.approx([0.1, 0.05, 0.0], abs=1e-9)
