"""Bounces with slip in flight, or with slip that ends among them, independent of the origin."""

from __future__ import annotations

import numpy as np
import pytest
from runs import ENGINES

from statechart import Runner
from statechart.documents.yaml_reader import read_text

SLOPE = """\
kind: scene
name: slope
parameters: {x0: 0, dx: 0, s: 0, mu: 0.8}
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: x0, y: x0 + 0.5, dx: dx}}}
surfaces: {floor: {line: [[x0, x0], [x0 + 1, x0 + s]]}}
contacts: {low: {point: {body: ball}, surface: floor, friction: mu, restitution: 0.3}}
stop: {time: 0.9}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("dx", "s"), [(0.9, 0.02), (-0.2, 0.3), (0.0, 0.2), (4.14, 0.0)])
def test_a_point_comes_to_rest_at_the_same_place(engine: str, dx: float, s: float) -> None:
    runner = Runner(read_text(SLOPE), engine=engine)
    here = runner.run({"dx": dx, "s": s}).trace
    assert here.jumps[-1].cause in ("zeno", "stick")
    for x0 in (1.0, -30.0, 1000.0):
        there = runner.run({"dx": dx, "s": s, "x0": x0}).trace
        moved = np.array(there.final) - [x0, x0, 0.0, 0.0]
        assert moved == pytest.approx(np.array(here.final), abs=1e-9)


HILLS = """\
kind: scene
name: hills
parameters: {x0: 0, dx: 0, k: 3}
gravity: 9.81
bodies:
  ball:
    mass: 1
    start: {x: x0 + 0.438720703125, y: x0 + 1.2578125, dx: dx, dy: 0.095}
surfaces: {hills: {height: x0 + 0.356689453125*sin(k*(x - x0) + 5.66)}}
contacts: {low: {point: {body: ball}, surface: hills, friction: 0, restitution: 0}}
stop: {time: 1}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("x0", "dx", "k"),
    [(0.0, -0.37, 5.4), (7035.0, -0.34, 5.4), (7724.0, -0.23, 4.8), (11105.0, -0.16, 3.2)],
)
def test_a_ball_that_leaves_a_hill_has_no_impact(
    engine: str, x0: float, dx: float, k: float
) -> None:
    """Round-off of the place turns the normal: the velocity is brought along it there."""
    jumps = Runner(read_text(HILLS), engine=engine).run({"x0": x0, "dx": dx, "k": k}).trace.jumps
    left = [jump.cause for jump in jumps if jump.fired == ("low.V",)]
    assert left
    assert set(left) == {"liftoff"}
