"""Balls over steep terrains: the scenes where looking at the signs of a gap tunnels."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import sympy as sp
from crossings import first_crossing

from statechart.documents.yaml_reader import read_text
from statechart.engines.event_location import Verdict
from statechart.formulas.writer import compile_tape
from statechart.running.runner import Runner

X, Y, T, A, K, PHASE, C, W = sp.symbols("x y t A k phase c w")
HILLS = compile_tape(
    [Y - A * sp.sin(K * X + PHASE)], variables=[X, Y], parameters=[A, K, PHASE], time=T
)
BUMPS = compile_tape(
    [Y - A * sp.exp(-(((X - C) / W) ** 2))], variables=[X, Y], parameters=[A, C, W], time=T
)
GOLDEN = Path(__file__).parents[1] / "golden" / "hilly_ball.json"


def flight(x, y, vx, vy, g, h):
    """The coefficients of a ballistic flight over one step of length h."""
    coeffs = np.zeros((1, 2, 3))
    coeffs[0, 0, :2] = x, vx * h
    coeffs[0, 1] = y, vy * h, -g * h * h / 2
    return coeffs


def march(gap, slope, bend, t_end):
    """First root of the gap: from where it is positive, as far as no fall can reach.

    If gap'' >= -bend then gap(t + d) >= gap + slope d - bend d^2 / 2, which is positive up to the
    root d of the right side: no step of that length can pass a root. A Newton step, which may
    not go further than the next root of a parabola below, ends the approach.
    """
    t = 0.0
    for _ in range(200_000):
        g, v = gap(t), slope(t)
        d = (v + np.sqrt(v * v + 2 * bend * g)) / bend
        if d <= 4e-16 * t or g <= 0:
            return t
        t += d
        if t > t_end:
            return None
    raise AssertionError("the march did not end")


def terrains(count, seed):
    generator = np.random.default_rng(seed)
    for index in range(count):
        x, vx = generator.uniform(-1, 1), generator.uniform(0.5, 8) * generator.choice([-1, 1])
        vy, g = generator.uniform(-3, 5), 9.81
        h = 1.0
        if index % 2:
            height, width = generator.uniform(0.2, 2), abs(vx) * h * 10 ** generator.uniform(-3, -1)
            centre = x + vx * h * generator.uniform(0.05, 0.95)
            y = generator.uniform(0.05, 2)

            def ground(p, a=height, c=centre, w=width):
                u = (p - c) / w
                e = a * np.exp(-u * u)
                return e, -2 * u / w * e

            # |f''| <= 2 a / w^2 for the bell a exp(-(u / w)^2)
            curvature = 2 * height / width**2
            tape, parameters = BUMPS, [height, centre, width]
        else:
            height, number = generator.uniform(0.2, 2), generator.uniform(3, 60)
            phase = generator.uniform(0, 2 * np.pi)
            y = height + generator.uniform(-0.2, 0.6)

            def ground(p, a=height, k=number, f=phase):
                return a * np.sin(k * p + f), a * k * np.cos(k * p + f)

            curvature = height * number**2
            tape, parameters = HILLS, [height, number, phase]
        if y <= ground(x)[0] + 1e-3:
            y = ground(x)[0] + 0.05
        yield tape, parameters, (x, y, vx, vy, g, h), ground, g + vx * vx * curvature


def test_no_ball_tunnels_through_a_terrain():
    hits = 0
    for tape, parameters, (x, y, vx, vy, g, h), ground, bend in terrains(2000, seed=20):

        def gap(t, y=y, vy=vy, g=g, x=x, vx=vx, ground=ground):
            return y + t * (vy - g * t / 2) - ground(x + vx * t)[0]

        def slope(t, vy=vy, g=g, x=x, vx=vx, ground=ground):
            return vy - g * t - vx * ground(x + vx * t)[1]

        truth = march(gap, slope, bend, h)
        found = first_crossing(tape, [0.0], [0.0, h], flight(x, y, vx, vy, g, h), parameters, 0.0)
        if truth is None:
            assert found.verdict is Verdict.NONE
            continue
        hits += 1
        assert found.verdict is Verdict.CROSSING
        assert found.crossing is not None
        # The gap is known to some 1e-15; a flat approach divides that by its slope.
        reach = 1e-12 * truth + 2e-14 * (1 + abs(vx) * bend**0.5) / abs(slope(truth))
        assert abs(found.crossing.time - truth) <= reach
        assert found.crossing.crossed >= found.crossing.time
    assert 1000 < hits < 2000


@pytest.mark.parametrize("tolerance", [0.0, 1e-12, 1e-9])
def test_first_impacts_of_the_golden_terrains(tolerance):
    for case in json.loads(GOLDEN.read_text())["cases"]:
        x, y, vx, vy, g = (float(case[name]) for name in ("x0", "y0", "vx0", "vy0", "g"))
        parameters = [float(case[name]) for name in ("A", "k", "phase")]
        found = first_crossing(
            HILLS, [tolerance], [0.0, 10.0], flight(x, y, vx, vy, g, 10.0), parameters, 0.0
        )
        assert found.verdict is Verdict.CROSSING
        assert found.crossing is not None
        assert found.crossing.time == pytest.approx(case["true_first_impact_t"], rel=1e-12)


def test_a_ball_that_bounces_along_one_path_strikes_the_hill_to_the_tolerance() -> None:
    """At 19.2476 the quadrature of the gap's slope over the flight was off by 1.5e-12."""
    text = """
kind: scene
name: ball_on_hills
gravity: 1
parameters: {A: 0.661866097142484, w: 5.515500314624218}
bodies:
  ball:
    mass: 1
    start:
      {x: 0.2449914600607852, y: 1.1705658633902716, dx: -0.44953186554437075,
       dy: -0.3826366838006494}
surfaces: {hills: {height: A*sin(w*x)}}
contacts:
  tip: {point: {body: ball}, surface: hills, friction: 0.7464446269791014, restitution: 1}
stop: {time: 20}
"""
    trace = Runner(read_text(text)).run().trace
    a, w = trace.parameters["A"], trace.parameters["w"]
    depths = [a * math.sin(w * jump.before[0]) - jump.before[1] for jump in trace.jumps]
    assert len(depths) == 39
    assert max(map(abs, depths)) <= trace.tolerances["gap"]
