"""Collapse of masonry, cards, ladders and bicycles: limit analysis and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import linprog

import statechart
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G = 9.81


def run(text, **settings):
    return statechart.run(interpret(read_text(text)), **settings)


def moved(text):
    """Return by how much the coordinates of a run by steps change at most."""
    trace = run(text).trace
    assert trace.outcome is Outcome.HORIZON
    n = len(trace.final) // 2
    return np.abs(trace.final - trace.arcs[0].states(np.zeros(1))[0])[:n].max()


def blocks(placed, mu, *, gravity=f"[0, -{G}]", ground="height: 0", time=1.0):
    """Return a scene of boxes (x, y, width, height) that touch where they do."""
    bodies = "\n".join(
        f"  b{i}: {{mass: {w * h!r}, inertia: {w * h * (w * w + h * h) / 12!r}, "
        f"start: {{x: {x + w / 2!r}, y: {y + h / 2!r}}}, shape: {{polygon: "
        f"{[[s * w / 2, t * h / 2] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]!r}}}}}"
        for i, (x, y, w, h) in enumerate(placed)
    )
    return f"""
kind: scene
name: blocks
gravity: {gravity}
bodies:
{bodies}
surfaces: {{ground: {{{ground}}}}}
collisions:
  all: {{bodies: [{", ".join(f"b{i}" for i in range(len(placed)))}], surfaces: [ground],
    friction: {mu!r}, restitution: 0}}
stop: {{time: {time}}}
settings: {{engine: impulse, step: 2e-3}}
"""


@pytest.mark.parametrize("n", [2, 3, 5, 8])
def test_bricks_overhang_by_the_harmonic_series(n):
    # All but the lowest within their bounds; the table bears the common centre.
    ends = np.cumsum([0.0, *(0.49 / j for j in range(n - 1, 0, -1))])
    for beyond in (-1e-3, 1e-3):
        left = ends - ends.mean() + beyond - 0.5
        placed = [(float(x), 0.2 * k, 1.0, 0.2) for k, x in enumerate(left)]
        found = moved(blocks(placed, 0.5, ground="edge: [[-3, 0], [0, 0]]"))
        assert found < 1e-12 if beyond < 0 else found > 2e-3


def wall(rng):
    """Return courses of boxes with gaps between them."""
    placed, y = [], 0.0
    for _ in range(rng.integers(2, 5)):
        x, h = rng.uniform(-0.2, 0.2), rng.uniform(0.15, 0.4)
        for _ in range(rng.integers(1, 4)):
            w = rng.uniform(0.3, 0.8)
            placed.append((float(x), float(y), float(w), float(h)))
            x += w + rng.uniform(0.02, 0.2)
        y += h
    return placed


def corners(placed):
    """Return (upper, lower or -1, x, y) of the ends of where boxes bear each other."""
    for i, (x, y, w, _) in enumerate(placed):
        if y == 0.0:
            yield from ((i, -1, x, 0.0), (i, -1, x + w, 0.0))
        for j, (u, v, a, b) in enumerate(placed):
            first, last = max(x, u), min(x + w, u + a)
            if v + b == y and last > first:
                yield from ((i, j, first, y), (i, j, last, y))


def greatest_pull(placed, mu):
    """Return the largest part of the weight that forces within friction bear along the ground."""
    bearing = list(corners(placed))
    n, m = len(placed), len(bearing)
    balance, weight = np.zeros((3 * n, 2 * m + 1)), np.zeros(3 * n)
    for i, (_, _, w, h) in enumerate(placed):
        balance[3 * i, -1] = weight[3 * i + 1] = w * h
    for k, (upper, lower, px, py) in enumerate(bearing):
        for i, sign in ((upper, 1.0), (lower, -1.0)):
            if i >= 0:
                x, y, w, h = placed[i]
                balance[3 * i : 3 * i + 3, 2 * k] += 0.0, sign, sign * (px - x - w / 2)
                balance[3 * i : 3 * i + 3, 2 * k + 1] += sign, 0.0, sign * (y + h / 2 - py)
    cone = np.kron(np.eye(m), [[-mu, 1.0], [-mu, -1.0]])
    found = linprog(
        [*np.zeros(2 * m), -1.0],
        A_ub=np.hstack([cone, np.zeros((2 * m, 1))]),
        b_ub=np.zeros(2 * m),
        A_eq=balance,
        b_eq=weight,
        bounds=[(0.0, None), (None, None)] * m + [(0.0, None)],
    )
    return -found.fun if found.status == 0 else 0.0


def test_walls_stand_up_to_the_tilt_of_limit_analysis():
    rng, tried, slid = np.random.default_rng(7), 0, 0
    while tried < 8:
        placed, mu = wall(rng), float(rng.uniform(0.4, 0.95))
        pull = greatest_pull(placed, mu)
        alone = pull > 0.999 * mu
        if pull < 0.01 or (alone and slid == 3):
            continue
        tried, slid = tried + 1, slid + alone
        # Above, nothing can stand. Just below, friction leaves some walls both ways (Drucker 1954):
        # one of these falls at 0.98, by forces that agree with the law as those at rest do.
        for part in (0.9, 1.005):
            found = moved(blocks(placed, mu, gravity=f"[{G * part * pull!r}, -{G}]"))
            assert found < 1e-9 if part < 1 else found > 5e-4, (placed, mu, pull, found)


CARD = "[{disc: r, at: [0, -L/2]}, {disc: r, at: [0, L/2]}]"
CARDS = f"""
kind: scene
name: cards
parameters: {{L: 1, r: 0.01, q: 0.5, mu: 1, X: r + L/2*sin(q), Y: r + L/2*cos(q)}}
gravity: {G}
bodies:
  right: {{mass: 1, inertia: L**2/12, start: {{x: X, y: Y, angle: q}}, shape: {CARD}}}
  left: {{mass: 1, inertia: L**2/12, start: {{x: -X, y: Y, angle: -q}}, shape: {CARD}}}
surfaces: {{table: {{height: 0}}}}
collisions: {{all: {{bodies: [right, left], surfaces: [table], friction: mu, restitution: 0}}}}
stop: {{time: 0.5}}
outputs: {{right: {{value: right.angle - q}}, left: {{value: left.angle + q}}}}
settings: {{engine: impulse, step: 2e-3}}
"""


@pytest.mark.parametrize("lean", [0.2, 0.9])
def test_two_cards_lean_on_each_other_as_far_as_friction_holds_their_feet(lean):
    # Moments of one card about where it touches the other, which bears no weight.
    least = math.sin(lean) / 2 / (0.01 + math.cos(lean))
    for part in (0.99, 1.01):
        found = run(CARDS, parameters={"q": lean, "mu": part * least}).outputs
        if part > 1:
            assert list(found.values()) == pytest.approx([0, 0], abs=1e-12)
        else:
            assert found["right"] > 1e-3
            assert found["left"] == pytest.approx(-found["right"], abs=1e-9)


LADDER = f"""
kind: scene
name: ladder
parameters: {{L: 4, m: 10, M: 70, q: pi/3, mu: 0.4, muw: 0.2, v: 0.05}}
gravity: {G}
bodies:
  ladder: {{mass: m, inertia: m*L**2/12, start: {{x: L/2*cos(q), y: L/2*sin(q), angle: q}}}}
surfaces:
  floor: {{height: 0}}
  wall: {{line: [[L*cos(q), 0], [L*cos(q), 1]]}}
contacts:
  foot: {{point: {{body: ladder, at: [-L/2, 0]}}, surface: floor, friction: mu, restitution: 0}}
  top: {{point: {{body: ladder, at: [L/2, 0]}}, surface: wall, friction: muw, restitution: 0}}
forces:
  man: {{body: ladder, force: [0, -M*{G}], moment: -M*{G}*(v*time - L/2)*cos(ladder.angle)}}
stop: {{time: 80, conditions: {{slipped: ladder.angle < q - 0.01}}}}
outputs: {{height: {{value: v*time, at: first foot.slip}}}}
"""


@pytest.mark.parametrize(
    ("settings", "error"), [({}, 1e-10), ({"engine": "impulse", "step": 1e-2}, 1e-3)]
)
def test_a_ladder_slips_as_a_man_comes_to_where_both_its_ends_are_at_their_bounds(settings, error):
    floor = 80 * G / (1 + 0.4 * 0.2)
    wall = 0.4 * floor
    lever = wall * 4 * (math.tan(math.pi / 3) + 0.2) - 10 * G * 2
    found = run(LADDER, **settings).outputs["height"]
    assert found == pytest.approx(lever / (70 * G), abs=error)


BICYCLE = f"""
kind: scene
name: bicycle
parameters: {{b: 0.6, a: 0.5, h: 0.9, r: 0.35, m: 80, mw: 1, v: 10, T: 150}}
gravity: {G}
bodies:
  frame: {{mass: m, inertia: 10, start: {{y: h, dx: v}}}}
  front: {{mass: mw, inertia: mw*r**2, start: {{x: b, y: r, dx: v, dangle: -v/r}}}}
  rear: {{mass: mw, inertia: mw*r**2, start: {{x: -a, y: r, dx: v, dangle: -v/r}}}}
surfaces: {{road: {{height: 0}}}}
joints:
  fork: {{point: {{body: front}}, to: {{body: frame, at: [b, r - h]}}}}
  stay: {{point: {{body: rear}}, to: {{body: frame, at: [-a, r - h]}}}}
contacts:
  F: {{point: {{body: front}}, radius: r, surface: road, friction: 1.2, restitution: 0}}
  R: {{point: {{body: rear}}, radius: r, surface: road, friction: 1.2, restitution: 0}}
forces: {{disc: {{body: front, moment: T}}, back: {{body: frame, moment: -T}}}}
stop: {{time: 0.3}}
outputs:
  rear: {{value: R.V, at: start}}
  held: {{value: F.H + R.H, at: start}}
  tilt: {{value: frame.angle}}
"""


@pytest.mark.parametrize(
    "settings", [{}, {"engine": "scipy"}, {"engine": "impulse", "step": 1e-3}], ids=str
)
def test_a_bicycle_goes_over_its_front_wheel_above_a_moment_of_its_brake(settings):
    # Both wheels roll: slowing by `slow`, whatever weighs and turns; moments about the road.
    def slow(moment):
        return moment / 0.35 / (80 + 2 + 2)

    def rear(moment):
        turned = (80 * 0.9 + 2 * 0.35 + 2 * 0.35) * slow(moment)
        return (80 * G * 0.6 + 1.1 * G - turned) / 1.1

    over = 150 * rear(0) / (rear(0) - rear(150))
    # Close to there friction does not slow the rear wheel any more, as it bears too little.
    for moment in (150, over - 10, over + 10):
        found = run(BICYCLE, parameters={"T": moment}, **settings).outputs
        if moment < over:
            wanted = [rear(moment), -82 * slow(moment), 0.0]
            assert list(found.values()) == pytest.approx(wanted, abs=1e-8)
        else:
            assert found["rear"] == 0.0
            assert found["tilt"] < -1e-3
