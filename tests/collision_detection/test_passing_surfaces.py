"""Bodies that cross a surface, or turn through it, within a step strike it."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

ROD = "polygon: [[-1, -0.01], [1, -0.01], [1, 0.01], [-1, 0.01]]"
SCENE = """
kind: scene
name: passing
gravity: 0
bodies: {{it: {{mass: 1, inertia: 1/3, shape: {{{shape}}}, start: {start}}}}}
surfaces: {{s: {{{surface}}}}}
collisions: {{all: {{bodies: [it], surfaces: [s], friction: 0, restitution: {e}}}}}
stop: {{time: 0.02}}
settings: {{engine: impulse, step: 1e-3}}
"""


def run(shape, start, surface, e=1):
    text = SCENE.format(shape=shape, start=start, surface=surface, e=e)
    trace = Runner(interpret(read_text(text))).run().trace
    return trace, dict(zip(trace.variables, trace.final.tolist(), strict=True))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_disc_strikes_the_end_of_an_edge_that_its_middle_passes(sign):
    """It goes six times its radius in a step, and its middle passes 0.4 of that beside the edge."""
    surface = f"edge: [[0, {0.02 * sign}], [0, {0.5 * sign}]]"
    _, final = run("disc: 0.05", "{x: -1, dx: 300}", surface)
    # Reflected by the line from the end to the middle.
    nx, ny = -math.sqrt(1 - 0.4**2), -0.4 * sign
    expected = [300 - 2 * nx * nx * 300, -2 * nx * ny * 300]
    # It is looked at every 64th of that way.
    assert [final["it.dx"], final["it.dy"]] == pytest.approx(expected, abs=0.2 * 300)
    assert math.hypot(final["it.dx"], final["it.dy"]) == pytest.approx(300, rel=1e-9)


def test_a_rod_that_turns_over_a_pin_within_a_step_strikes_it():
    """The impulse at the pin (at 0.8) reverses the velocity there."""
    _, final = run(ROD, "{angle: 0.3, dangle: 300}", "circle: [0, 0.8], radius: 0.02")
    impulse = 2 * 300 * 0.8 / (1 + 3 * 0.8**2)
    assert math.hypot(final["it.dx"], final["it.dy"]) == pytest.approx(impulse, rel=0.03)
    assert final["it.dangle"] == pytest.approx(300 - 3 * 0.8 * impulse, rel=0.05)


def test_a_rod_strikes_a_spike_of_the_ground_that_it_passes_within_a_step():
    """An upright rod meets with its lower end, 0.8 to 1 below its middle, a flank next to level."""
    spike = "height: -0.6 + 0.3*exp(-(100*x)**2)"
    _, final = run(ROD, "{x: -1.2, y: 0.5, angle: pi/2, dx: 200}", spike, e=0)
    slowest, fastest = (200 - 200 / (1 + 3 * lever**2) for lever in (0.8, 1.0))
    assert slowest < final["it.dx"] < fastest


@pytest.mark.parametrize(
    ("shape", "start", "surface"),
    [
        (ROD, "{angle: 0.3, dangle: 300}", "edge: [[-0.05, 1.1], [0.05, 1.1]]"),
        ("disc: 0.05", "{x: -1, dx: 300}", "edge: [[0, 0.051], [0, 0.5]]"),
        ("disc: 0.05", "{x: -1, y: 0.2, dx: 300}", "height: 0.14*exp(-(100*x)**2)"),
    ],
)
def test_body_passing_a_surface_has_no_impact(shape, start, surface):
    trace, _ = run(shape, start, surface)
    assert trace.warnings == ()
    assert trace.counts["contacts"] == 0


WALLS = """
kind: scene
name: walls
parameters: {r: 10, u: 0, v: 0}
bodies: {ball: {mass: 1, inertia: 100, shape: SHAPE, start: {x: 300, y: 200, dx: u, dy: v}}}
surfaces:
  floor: {edge: [[0, 0], [600, 0]]}
  right: {edge: [[600, 0], [600, 400]]}
  ceiling: {edge: [[600, 400], [0, 400]]}
  left: {edge: [[0, 400], [0, 0]]}
collisions:
  all: {bodies: [ball], surfaces: [floor, right, ceiling, left], friction: 0, restitution: 1}
stop: {time: 0.5}
settings: {engine: impulse, step: 1/60}
outputs: {across: {maximum: abs(ball.x - 300)}, up: {maximum: abs(ball.y - 200)}}
"""


ROUND, SQUARE = "{disc: r}", "{polygon: [[-r, -r], [r, -r], [r, r], [-r, r]]}"


@pytest.mark.parametrize("shape", [ROUND, SQUARE])
@pytest.mark.parametrize(
    ("u", "v", "r"),
    [(8000, 10000, 10), (-3077, 8843, 30), (7600, 3538, 10), (-8959, -11957, 1), (8633, -11121, 3)],
)
def test_a_fast_body_stays_between_thin_walls(shape, u, v, r):
    """It goes up to 200 times its radius in a step, and may be in a wall, half past, in mid-step.

    Its energy stays, and that of each direction if it is round.
    """
    run = Runner(interpret(read_text(WALLS.replace("SHAPE", shape)))).run({"u": u, "v": v, "r": r})
    final = dict(zip(run.trace.variables, run.trace.final.tolist(), strict=True))
    dx, dy, dangle = (final[f"ball.{rate}"] for rate in ("dx", "dy", "dangle"))
    assert run.outputs["across"] <= 300 - 0.5 * r
    assert run.outputs["up"] <= 200 - 0.5 * r
    assert dx**2 + dy**2 + 100 * dangle**2 == pytest.approx(u**2 + v**2, rel=1e-9)
    if shape == ROUND:
        assert [abs(dx), abs(dy)] == pytest.approx([abs(u), abs(v)], rel=1e-9)


@pytest.mark.parametrize("step", [1 / 60, 1 / 120, 1 / 500])
def test_a_ball_does_not_rebound_far_from_a_wall(step):
    """A step of 195 in a room of 400; without parts it turns back half-way to the walls."""
    runner = Runner(interpret(read_text(WALLS.replace("SHAPE", ROUND))), step=step)
    reached = runner.run({"u": 1936, "v": -11722}).outputs["up"]
    assert reached == pytest.approx(190, abs=0.1 * 300)
