"""Points that come to rest in a kink, or slide over one, by steps."""

from __future__ import annotations

import math

import numpy as np
import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

VALLEY = """
kind: scene
name: valley
parameters: {s: 0.4, q: 0.7}
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: -0.5, y: 0.4, dx: 0.3}}}
surfaces: {left: {SURFACE_A}, right: {SURFACE_B}}
contacts:
  a: {point: {body: ball}, surface: left, friction: 0.1, restitution: 0.3ENABLED_A}
  b: {point: {body: ball}, surface: right, friction: 0.1, restitution: 0.3ENABLED_B}
stop: {time: 3}
"""
HEIGHTS = ("height: -s*x", "height: q*x", ", enabled: ball.x <= 0", ", enabled: ball.x >= 0")
EDGES = ("edge: [[-3, 3*s], [0, 0]]", "edge: [[0, 0], [3, 3*q]]", "", "")


@pytest.mark.parametrize("pieces", [HEIGHTS, EDGES])
@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_a_ball_comes_to_rest_in_a_valley_of_two_pieces(pieces, step):
    text = VALLEY
    for word, piece in zip(
        ("SURFACE_A", "SURFACE_B", "ENABLED_A", "ENABLED_B"), pieces, strict=True
    ):
        text = text.replace(word, piece)
    trace = statechart.run(interpret(read_text(text)), engine="impulse", step=step).trace
    assert trace.final[:2] == pytest.approx([0, 0], abs=0.1 * step)
    assert trace.final[2:] == pytest.approx([0, 0], abs=1e-12)
    assert trace.final_mode == ("pin", "pin")
    # They do not go off and on while it rests: events have 4 and 9 of them before.
    assert sum(jump.cause in ("enable", "disable") for jump in trace.jumps) < 20


@pytest.mark.parametrize(
    ("slopes", "into"), [((0.4, 0.7), (-0.3, -1.0)), ((1.0, 1.2), (0.2, -0.8))]
)
@pytest.mark.parametrize("step", [1e-3, 1e-4])
def test_a_ball_that_starts_in_a_kink_into_the_ground_stays_there(slopes, into, step):
    text = VALLEY.replace("x: -0.5, y: 0.4, dx: 0.3", "dx: {}, dy: {}".format(*into))
    text = text.replace("{s: 0.4, q: 0.7}", "{{s: {}, q: {}}}".format(*slopes))
    text = text.replace("restitution: 0.3", "restitution: 0").replace("time: 3", "time: 0.5")
    for word, piece in zip(
        ("SURFACE_A", "SURFACE_B", "ENABLED_A", "ENABLED_B"), EDGES, strict=True
    ):
        text = text.replace(word, piece)
    trace = statechart.run(interpret(read_text(text)), engine="impulse", step=step).trace
    assert trace.final[:2] == pytest.approx([0, 0], abs=2 * step)
    assert trace.final[2:] == pytest.approx([0, 0], abs=1e-9)


STEEP = """
kind: scene
name: steep
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: -0.28, y: 1.18, dx: -0.51}}}
surfaces:
  down: {edge: [[-0.52, 0.174], [0.227, -0.045]]}
  up: {edge: [[0.227, -0.045], [1.16, 0.876]]}
contacts:
  one: {point: {body: ball}, surface: down, friction: 0.05, restitution: 0}
  two: {point: {body: ball}, surface: up, friction: 0.05, restitution: 0}
stop: {time: 1.5}
"""


@pytest.mark.parametrize("step", [1e-3, 3e-4, 1e-4])
def test_deeply_landed_point_slides_onto_the_next_edge(step):
    model = interpret(read_text(STEEP))
    wanted = statechart.run(model).trace
    trace = statechart.run(model, engine="impulse", step=step).trace
    assert trace.final == pytest.approx(wanted.final, abs=30 * step)
    assert not [warning for warning in trace.warnings if "stays off" in warning]


# Two edges that meet in a kink, in which a point slides to and fro until it rests.
KINK = """
kind: scene
name: kink
gravity: 9.81
bodies: {b: {mass: 1, start: {x: -0.3858, y: 0.4137, dx: -0.376}}}
surfaces:
  f: {edge: [[-2, 1.626], [0, 0]]}
  g: {edge: [[0, 0], [2, 0.8479]]}
contacts:
  c: {point: {body: b}, surface: f, friction: 0.3, restitution: 0, impact: moreau}
  d: {point: {body: b}, surface: g, friction: 0.3, restitution: 0, impact: moreau}
stop: {time: 1.2}
"""


@pytest.mark.parametrize("h", [2e-3, 5e-4, 1e-4])
def test_point_oscillating_over_a_kink_does_not_fall_through(h: float) -> None:
    model = interpret(read_text(KINK, "f.yaml"))
    final = Runner(model, engine="impulse", step=h).run().trace.final
    assert np.abs(final[:2]).max() < 4 * h


# Acute and obtuse valleys, with and without rebounds and friction: a point that lies deep in one
# edge is beyond the end of the other.
@pytest.mark.parametrize("h", [2e-3, 4e-4])
@pytest.mark.parametrize(
    ("left", "right", "start", "friction", "restitution"),
    [
        ("[-2, 2.3033]", "[2, 2.2852]", "x: 0.3355, y: 0.4864, dx: 0.472", 0, 0),
        ("[-1.367064, 4.095629]", "[2.593651, 3.531769]", "x: 0.2857, y: 0.4661, dx: 0.227", 0, 0),
        ("[-2, 1.1095]", "[2, 1.9894]", "x: 0.0401, y: 0.1399, dx: 0.573", 0, 0.4),
        ("[-2, 1.1095]", "[2, 1.9894]", "x: 0.0401, y: 0.1399, dx: 0.573", 0.3, 0.4),
    ],
)
def test_a_point_comes_to_rest_in_a_valley_of_edges(left, right, start, friction, restitution, h):
    law = f"friction: {friction}, restitution: {restitution}, impact: moreau"
    text = f"""
kind: scene
name: valley
gravity: 9.81
bodies: {{b: {{mass: 1, start: {{{start}}}}}}}
surfaces:
  f: {{edge: [{left}, [0, 0]]}}
  g: {{edge: [[0, 0], {right}]}}
contacts:
  c: {{point: {{body: b}}, surface: f, {law}}}
  d: {{point: {{body: b}}, surface: g, {law}}}
stop: {{time: 1.2}}
"""
    final = statechart.run(interpret(read_text(text)), engine="impulse", step=h).trace.final
    # It lies as deep as its way in two steps.
    assert np.abs(final[:2]).max() < 8 * h
    assert final[2:] == pytest.approx([0, 0], abs=1e-9)


# A corner away from the origin, where a start at rest is round-off beyond the ends of both edges.
CORNER = """
kind: scene
name: corner
gravity: 9.81
parameters: {X: 0, Y: 0}
bodies: {b: {mass: 1, start: {x: X, y: Y, dx: DX, dy: DY}}}
surfaces:
  f: {edge: [[X - LEFT_X, Y + LEFT_Y], [X, Y]]}
  g: {edge: [[X, Y], [X + RIGHT_X, Y + RIGHT_Y]]}
contacts:
  c: {point: {body: b}, surface: f, friction: MU, restitution: E1}
  d: {point: {body: b}, surface: g, friction: MU, restitution: E2}
stop: {time: 0.7}
"""


def in_corner(left, right, *, v=(0.0, 0.0), at=(0.0, 0.0), mu=0.0, e=(0.0, 0.0)):
    numbers = {
        "LEFT_X": 2 * math.cos(left), "LEFT_Y": 2 * math.sin(left),
        "RIGHT_X": 2 * math.cos(right), "RIGHT_Y": 2 * math.sin(right),
        "DX": v[0], "DY": v[1], "MU": mu, "E1": e[0], "E2": e[1],
    }  # fmt: skip
    text = CORNER.replace("{X: 0, Y: 0}", f"{{X: {at[0]!r}, Y: {at[1]!r}}}")
    for word, value in numbers.items():
        text = text.replace(word, repr(value))
    return interpret(read_text(text, "f.yaml"))


@pytest.mark.parametrize("at", [(0.0, 0.0), (-2.343068, 0.748813), (3e3, -4e3)])
@pytest.mark.parametrize("angles", [(1.15, 0.7), (0.37, 1.13), (0.53, 0.86), (1.2, 1.2)])
@pytest.mark.parametrize("e", [(0.9, 0.8), (0.5, 0.0), (0.0, 0.0)])
def test_a_point_at_rest_in_a_corner_stays_there(at, angles, e):
    model = in_corner(*angles, at=at, e=e)
    trace = statechart.run(model, engine="impulse", step=1e-3).trace
    assert trace.final == pytest.approx([*at, 0, 0], abs=1e-9)
    assert trace.final_mode == ("slide", "slide")
    assert not any(jump.cause in ("enable", "disable") for jump in trace.jumps)


# The plastic side absorbs the rebound of the other: the point slides on it, and comes back.
@pytest.mark.parametrize("h", [1e-3, 1e-4])
@pytest.mark.parametrize("at", [(0.0, 0.0), (0.604994, 0.101475)])
@pytest.mark.parametrize(
    ("left", "right", "v", "e", "mu"),
    [
        (0.79, 0.89, (-1.043, -1.586), (0.0, 0.5), 0.0),
        (0.90, 0.99, (-0.0187, -0.2055), (0.0, 0.8), 0.0),
        (0.37, 1.13, (0.2013, -0.0859), (0.5, 0.0), 0.3),
        (0.79, 1.15, (1.1525, -1.3069), (1.0, 0.0), 0.3),
    ],
)
def test_a_point_between_a_plastic_and_an_elastic_edge_comes_to_rest(left, right, v, e, mu, at, h):
    model = in_corner(left, right, v=v, at=at, e=e, mu=mu)
    trace = statechart.run(model, engine="impulse", step=h).trace
    assert trace.final[:2] == pytest.approx(at, abs=8 * h)
    assert trace.final[2:] == pytest.approx([0, 0], abs=1e-9)


LANDING = """
kind: scene
name: landing
gravity: 9.81
parameters: {end: 0, s: 0}
bodies: {puck: {mass: 1, start: {x: end - 2*0.4/sqrt(2*9.81*0.2), dx: 2, y: 0.2}}}
surfaces: {a: {edge: [[-2, 0], [0, 0]]}, b: {edge: [[0, 0], [3, 3*s]]}}
contacts:
  on_a: {point: {body: puck}, surface: a, friction: 0.05, restitution: RESTITUTION}
  on_b: {point: {body: puck}, surface: b, friction: 0.05, restitution: RESTITUTION}
stop: {time: 0.4}
"""


@pytest.mark.parametrize("restitution", [0, 0.5])
def test_a_point_that_lands_in_the_step_in_which_it_passes_the_end_of_an_edge_stays(restitution):
    step, speed = 1e-2, math.hypot(2.0, math.sqrt(2 * 9.81 * 0.2))
    scene = interpret(read_text(LANDING.replace("RESTITUTION", str(restitution))))
    runner = Runner(scene, engine="impulse", step=step)
    for slope in (0.0, 0.2, 1.0, 2.5, -0.2, -1.0):
        # It lands up to a step before the seam, and a bit after it.
        for end in np.linspace(-0.025, 0.005, 7).tolist():
            x, y = runner.run({"end": end, "s": slope}).trace.final[:2]
            gap = y if x < 0.0 else (y - slope * x) / math.hypot(1.0, slope)
            assert gap > -step * speed
