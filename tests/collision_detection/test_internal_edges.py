"""Internal edges: bodies slide over seams of edges, tiles and ramps as on one edge; steps catch."""

from __future__ import annotations

import numpy as np
import pytest

import statechart
from contacts.collision_detection.convex import FOUND, ConvexShape, shape_contacts
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

BOX = "{polygon: [[-w, -w], [w, -w], [w, w], [-w, w]]}"
DISC = "{disc: w}"
WEDGE = "{polygon: [[-1.5*w, -w], [1.5*w, -w], [0, 2*w]]}"
SCENE = """kind: scene
name: seams
parameters: {{v: 5, mu: 0.2, w: 0.2, g: 9.81}}
gravity: g
bodies:
  box: {{mass: 1, inertia: (2*w)**2/6, shape: {shape}, start: {{x: 0.5, y: w, dx: v}}}}
{bodies}
{surfaces}
{joints}
collisions:
  all: {{bodies: [{named}], surfaces: [{on}], friction: mu, restitution: 0}}
stop: {{time: {time}}}
settings: {{engine: impulse, step: {step}}}
"""


def final(surfaces, step, *, tiles=None, shape=BOX, time=3, **values):
    """Return pose and rates of the box on edges, and on tiles that are joined to the world."""
    bodies, joints = [], []
    for name, (x0, x1, y0, y1) in (tiles or {}).items():
        x, y, a, b = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
        outline = f"[[{-a}, {-b}], [{a}, {-b}], [{a}, {b}], [{-a}, {b}]]"
        bodies.append(
            f"  {name}: {{mass: 9, inertia: 1, shape: {{polygon: {outline}}}, "
            f"start: {{x: {x}, y: {y}}}}}"
        )
        joints += [
            f"  {name}{i}: {{point: {{body: {name}, at: [{at}, 0]}}, to: [{x + at}, {y}]}}"
            for i, at in enumerate((-a / 2, a / 2))
        ]
    edges = [f"  {name}: {{{form}}}" for name, form in surfaces.items()]
    text = SCENE.format(
        shape=shape,
        bodies="\n".join(bodies),
        surfaces="\n".join(["surfaces:", *edges] if edges else []),
        joints="\n".join(["joints:", *joints] if joints else []),
        named=", ".join(["box", *(tiles or {})]),
        on=", ".join(surfaces),
        time=time,
        step=step,
    )
    result = Runner(read_text(text)).run(values)
    assert result.trace.outcome.succeeded, result.trace.message
    state = result.trace.final
    n = len(state) // 2
    return np.concatenate([state[:3], state[n : n + 3]])


def edge(*ends):
    return f"edge: {[list(end) for end in ends]}"


SEAM = {
    "a": edge((-1, 0), (2, 0)),
    "b": edge((2, 0), (20, 0)),
    "wall": edge((2, 0), (2, -1)),
}
OUTLINES = {
    "top1": edge((0, 0), (1, 0)),
    "side1": edge((1, 0), (1, -1)),
    "side2": edge((1, -1), (1, 0)),
    "top2": edge((1, 0), (20, 0)),
}
STEPS = [2e-2, 1.3e-2, 7e-3, 5e-3, 1.7e-3, 1e-3, 3e-4]


@pytest.mark.parametrize("step", STEPS)
@pytest.mark.parametrize("grounds", [SEAM, OUTLINES])
def test_a_box_slides_over_a_seam_until_friction_stops_it(grounds, step):
    for listed in (grounds, dict(reversed(grounds.items()))):
        x, y, angle, *rates = final(listed, step, v=5)
        assert x == pytest.approx(0.5 + 25 / (2 * 0.2 * 9.81), abs=step**2 + 1e-6)
        assert [y, angle, *rates] == pytest.approx([0.2, 0, 0, 0, 0], abs=1e-9)


GROUNDS = {
    "walls aslant": ({"t": edge((-9, 0), (2, 0)), "s": edge((40, 0), (2, 0)),
                      "w": edge((1.7, -1), (2, 0)), "z": edge((2, 0), (2.4, -1))}, {}),
    "an end inside": ({"t": edge((-9, 0), (40, 0)), "w": edge((2, -1), (2, 0))}, {}),
    "overlap": ({"t": edge((-9, 0), (2.5, 0)), "s": edge((2, 0), (40, 0)),
                 "w": edge((2, 0), (2, -1)), "z": edge((2.5, -1), (2.5, 0))}, {}),
    "a gap": ({"t": edge((-9, 0), (2, 0)), "s": edge((2 + 1e-9, 0), (40, 0)),
               "w": edge((2 + 1e-9, 0), (2, -1))}, {}),
    "below a line": ({"t": "height: 0", "w": edge((2, -1), (2, 0))}, {}),
    "tiles": ({}, {"t": (-9, 2, -1, 0), "s": (2, 3.1, -1, 0), "u": (3.1, 40, -1, 0)}),
    "tiles of other heights": ({}, {"t": (-9, 2, -1, 0), "s": (2, 3.1, -0.2, 0),
                                    "u": (3.1, 40, -2, 0)}),
    "tiles with gaps": ({}, {"t": (-9, 2, -1, 0), "s": (2 + 1e-9, 3.1, -1, 0),
                             "u": (3.1 + 1e-9, 40, -1, 0)}),
    "a tile beside an edge": ({"t": edge((-9, 0), (2, 0)), "w": edge((2, 0), (2, -1)),
                               "s": edge((3.1, 0), (40, 0)), "z": edge((3.1, -1), (3.1, 0))},
                              {"u": (2, 3.1, -1, 0)}),
}  # fmt: skip


@pytest.mark.parametrize("shape", [BOX, DISC, WEDGE])
@pytest.mark.parametrize("name", GROUNDS)
def test_sliding_over_flush_grounds_equals_sliding_on_one_edge(name, shape):
    surfaces, tiles = GROUNDS[name]
    for step, mu in ((1.1e-2, 0.1), (2.7e-3, 0.05), (1e-3, 0.1)):
        found = final(surfaces, step, tiles=tiles, shape=shape, time=0.8, mu=mu)
        whole = final({"one": edge((-9, 0), (40, 0))}, step, shape=shape, time=0.8, mu=mu)
        np.testing.assert_allclose(found, whole, atol=1e-6)


@pytest.mark.parametrize("step", [5e-3, 1.1e-3])
def test_a_protruding_tile_catches_a_sliding_body(step):
    tiles = {"t": (-9, 2, -1, 0), "s": (2, 40, -1, 0.05)}
    edges = {"t": edge((-9, 0), (2, 0)), "kerb": edge((2, 0), (2, 0.05)),
             "s": edge((2, 0.05), (40, 0.05))}  # fmt: skip
    for surfaces, bodies in (({}, tiles), (edges, {})):
        x, y, angle, *_ = final(surfaces, step, tiles=bodies, v=2, time=0.8, mu=0.05)
        assert x < 1.85
        assert abs(angle) > 0.02
        # It falls back, and slides away from it.
        x, y, angle, *_ = final(surfaces, step, tiles=bodies, v=2, time=1.5, mu=0.05)
        assert x < 1.75
        assert [y, angle] == pytest.approx([0.2, 0], abs=1e-2)


@pytest.mark.parametrize("steps", [80.3, 300.25, 1000.4])
def test_a_sharp_corner_does_not_pass_under_a_wall_on_the_floor(steps):
    grounds = {"floor": edge((-9, 0), (2, 0)), "wall": edge((2, 0), (2, 0.3))}
    # It would be at the wall after so many steps.
    x, y, angle, *_ = final(grounds, 1.2 / 5 / steps, shape=WEDGE, time=0.32, mu=0)
    corner = x + 0.3 * np.cos(angle) + 0.2 * np.sin(angle)
    assert 1.9 < corner < 2.01
    assert y + 0.3 * np.sin(angle) - 0.2 * np.cos(angle) > -1e-2


def test_a_box_that_falls_on_the_end_of_a_wall_or_on_a_ridge_is_held():
    wall = {"wall": edge((0.5, -1), (0.5, -0.1))}
    ridge = {"up": edge((-1, -1.6), (0.5, -0.1)), "down": edge((0.5, -0.1), (2, -1.6))}
    for grounds in (wall, ridge):
        _, y, angle, *_ = final(grounds, 1e-3, v=0, time=0.5)
        assert [y, angle] == pytest.approx([0.1, 0], abs=1e-6)


def test_adjacent_resting_bodies_form_one_floor():
    crate = "shape: {polygon: [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]}"
    text = f"""kind: scene
name: crates
gravity: 9.81
bodies:
  box: {{mass: 1, inertia: 0.03, shape: {{polygon: [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2],
    [-0.2, 0.2]]}}, start: {{x: -0.5, y: 1.2, dx: 3}}}}
  one: {{mass: 500, inertia: 200, {crate}, start: {{x: 0, y: 0.5}}}}
  two: {{mass: 500, inertia: 200, {crate}, start: {{x: 2, y: 0.5}}}}
surfaces: {{ground: {{height: 0}}}}
collisions:
  floor: {{bodies: [one, two], surfaces: [ground], friction: 1, restitution: 0}}
  slide: {{bodies: [box, one, two], friction: 0.2, restitution: 0}}
stop: {{time: 2}}
outputs: {{x: {{value: box.x}}, turned: {{maximum: abs(box.angle)}}}}
"""
    for step in (8e-3, 1.7e-3, 1e-3):
        result = statechart.run(interpret(read_text(text)), step=step)
        assert result.outputs["x"] == pytest.approx(-0.5 + 9 / (0.4 * 9.81), abs=1e-5)
        assert result.outputs["turned"] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize(
    ("above", "hits"), [(-1e-6, 1), (-1e-11, 1), (0.0, 0), (1e-11, 0), (1e-6, 1)]
)
def test_plate_is_hit_at_its_end_not_at_a_cut_side(above, hits):
    # Its start is nearly as high as the leading corner, and it rises by rounding: cut to the width
    # of the box's side it began somewhere along itself. At the same height it is passed.
    plate = np.array([[0.0, 0.0], [0.2, 1e-7]])
    box = np.array([[-0.4, above], [-0.0015, above], [-0.0015, 0.1], [-0.4, 0.1]])
    found, features = np.zeros((16, FOUND)), np.zeros(16, dtype=np.int64)
    shapes = (ConvexShape(c, c.mean(axis=0), 0.0) for c in (plate, box))
    assert shape_contacts(*shapes, 0.01, found, features) == hits
    assert found[:hits, 4] == pytest.approx([0.0015] * hits, rel=1e-4)
    assert np.abs(found[:hits, :2]) == pytest.approx(
        np.array([[1, 0]] * hits).reshape(-1, 2), abs=1e-3
    )
