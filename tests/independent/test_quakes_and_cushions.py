"""A block on ground that shakes, and a disc between cushions, against answers worked out apart."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

_QUAKE = """
kind: scene
name: quake
parameters: {b: 0.2, h: 0.6, a: 6, w: 7, g: 9.81}
gravity: g
bodies: {block: {mass: 1, inertia: (b**2 + h**2)/3, start: {y: h}}}
surfaces: {ground: {height: 0, displacement: ["a/w*time - a/w**2*sin(w*time)", 0]}}
contacts:
  left: {point: {body: block, at: [-b, -h]}, surface: ground, modes: [free, pin], restitution: 0}
  right: {point: {body: block, at: [b, -h]}, surface: ground, modes: [free, pin], restitution: 0}
stop: {time: 4, conditions: {overturned: abs(block.angle) >= pi/2}}
outputs:
  t: {value: time}
  angle: {value: block.angle}
  rocks: {value: time, at: first liftoff}
  lands: {value: time, at: each touchdown}
  rates: {value: block.dangle, at: each touchdown}
"""


def _rocking(b: float, h: float, a: float, w: float, g: float = 9.81) -> dict[str, object]:
    """Housner (1963): it rocks about the corner that the ground's acceleration leaves it."""
    slim, r = math.atan2(b, h), math.hypot(b, h)
    t = math.asin(g * b / h / a) / w
    state, side, rocks, lands, rates = [0.0, 0.0], -1.0, t, [], []

    def lean(side: float) -> Callable[[float, np.ndarray], list[float]]:
        def rate(t: float, y: np.ndarray) -> list[float]:
            leaning = side * slim - y[0]
            pull = g * math.sin(leaning) + a * math.sin(w * t) * math.cos(leaning)
            return [y[1], -0.75 * pull / r]

        return rate

    while True:
        events = [lambda t, y: side * y[0], lambda t, y: abs(y[0]) - math.pi / 2.0]
        for event, way in zip(events, (-1.0, 1.0), strict=True):
            event.terminal, event.direction = True, way  # type: ignore[attr-defined]
        flown = solve_ivp(
            lean(side), (t, 4.0), state, "DOP853", events=events, rtol=1e-12, atol=1e-14
        )
        t, (angle, rate) = flown.t[-1], flown.y[:, -1]
        if not len(flown.t_events[0]):
            return {"t": t, "angle": -angle, "rocks": rocks, "lands": lands, "rates": rates}
        rate *= 1.0 - 1.5 * math.sin(slim) ** 2
        state, side = [0.0, rate], -side
        lands.append(t)
        rates.append(-rate)


@pytest.mark.parametrize("a_w", [(6.0, 7.0), (4.0, 6.0), (12.0, 20.0)], ids=str)
def test_a_block_rocks_on_ground_that_shakes(a_w: tuple[float, float]) -> None:
    a, w = a_w
    found = statechart.run(interpret(read_text(_QUAKE)), parameters={"a": a, "w": w}).outputs
    for name, wanted in _rocking(0.2, 0.6, a, w).items():
        assert found[name] == pytest.approx(wanted, rel=1e-8, abs=1e-8), name


_CUSHIONS = """
kind: scene
name: cushions
parameters: {r: 0.03, mu: 0.2, e: 0.85, spin: 20, X: 0}
gravity: 0
bodies:
  d: {mass: 0.2, inertia: 0.08*r**2, start: {x: X + 0.3, y: 0.2, dx: 3.1, dy: 1.7, dangle: spin}}
surfaces:
  south: {line: [[X, 0], [X + 1.2, 0]]}
  east: {line: [[X + 1.2, 0], [X + 1.2, 0.7]]}
  north: {line: [[X + 1.2, 0.7], [X, 0.7]]}
  west: {line: [[X, 0.7], [X, 0]]}
contacts:
  s: {point: {body: d}, radius: r, surface: south, friction: mu, restitution: e}
  o: {point: {body: d}, radius: r, surface: east, friction: mu, restitution: e}
  n: {point: {body: d}, radius: r, surface: north, friction: mu, restitution: e}
  w: {point: {body: d}, radius: r, surface: west, friction: mu, restitution: e}
stop: {time: 12}
outputs:
  t: {value: time, at: each touchdown}
  x: {value: d.x - X}
  y: {value: d.y}
  spin: {value: d.dangle}
"""


def _billiard(
    mu: float, e: float, spin: float, r: float = 0.03, k: float = 0.4
) -> dict[str, object]:
    """Routh's impact of a disc: friction reduces the slip within its cone."""
    place, v, t, hits = np.array([0.3, 0.2]), np.array([3.1, 1.7]), 0.0, []
    normals = np.array([[0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 0.0]])
    depths = np.array([r, r - 1.2, r - 0.7, r])  # n . place where it touches
    while True:
        closing = normals @ v
        times = np.full(4, np.inf)
        times[closing < 0] = ((depths - normals @ place) / closing)[closing < 0]
        side = int(np.argmin(times))
        if t + times[side] > 12.0:
            x, y = place + v * (12.0 - t)
            return {"t": hits, "x": x, "y": y, "spin": spin}
        t, place, n = t + times[side], place + v * times[side], normals[side]
        hits.append(t)
        along = np.array([n[1], -n[0]])
        slip = v @ along + r * spin
        push = -(1.0 + e) * (v @ n)
        drag = -math.copysign(min(mu * push, abs(slip) / (1.0 + 1.0 / k)), slip)
        v = v + push * n + drag * along
        spin += drag / (k * r)


@pytest.mark.parametrize("shift", [0.0, 1e5])
@pytest.mark.parametrize(
    "case", [(0.2, 0.85, 20.0), (0.05, 0.85, -60.0), (0.5, 0.99, 0.0)], ids=str
)
def test_a_disc_between_cushions_follows_the_closed_form(
    case: tuple[float, float, float], shift: float
) -> None:
    mu, e, spin = case
    given = {"mu": mu, "e": e, "spin": spin, "X": shift}
    found = statechart.run(interpret(read_text(_CUSHIONS)), parameters=given).outputs
    # Far off, places have four or five digits less.
    error = 1e-11 if shift == 0.0 else 1e-7
    for name, wanted in _billiard(mu, e, spin).items():
        assert found[name] == pytest.approx(wanted, rel=error, abs=error), name
