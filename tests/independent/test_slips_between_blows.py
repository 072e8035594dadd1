"""Motions that friction or a rope changes between blows, by equations in other coordinates."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G, SIDE, SLOPE, MU = 9.81, 0.1, 0.35, 1.5
_CORNERS = "\n".join(
    f'  c{k}: {{point: {{body: nut, at: ["a*cos({k}*pi/3)", "a*sin({k}*pi/3)"]}}, '
    "surface: slope, friction: 1.5, restitution: 0}"
    for k in range(6)
)
_NUT = f"""
kind: scene
name: nut
parameters: {{a: 0.1, slope: 0.35, w: 6, h: "a*cos(pi/6)"}}
gravity: [9.81*sin(slope), -9.81*cos(slope)]
bodies: {{nut: {{mass: 1, inertia: 5/12*a**2, start: {{y: h, dangle: -w, dx: w*h, dy: w*a/2}}}}}}
surfaces: {{slope: {{height: 0}}}}
contacts:
{_CORNERS}
stop: {{time: 1}}
outputs:
  t: {{value: time, at: each touchdown}}
  w: {{value: nut.dangle, at: each touchdown}}
"""
_ROPE = """
kind: scene
name: rope
gravity: 9.81
bodies:
  a: {mass: 1, start: {y: 1, dx: 1, dy: 3}}
  b: {mass: 0.4, inertia: 1e-3, start: {x: 0.2, y: 1, dx: -1, dy: 1}}
surfaces: {reach: {circle: [0, 0], radius: 0.5, hollow: true, body: a}}
contacts:
  rope: {point: {body: b}, surface: reach, modes: [free, slide], friction: 0, restitution: 0.3}
stop: {time: 3}
outputs:
  t: {value: time, at: first 5 rope.touchdown}
  taut: {value: time, at: first rope.zeno}
  x: {value: b.x - a.x}
  y: {value: b.y - a.y}
"""


def _rolled(end: float) -> tuple[list[float], list[float]]:
    """Return when a hexagon lands on its next corner, and how fast it turns then.

    The angle is that of its centre about the corner it stands on, from the slope's normal. Before
    each blow the corner slips: its load falls as the centre goes round it.
    """
    along, into, inertia = G * math.sin(SLOPE), G * math.cos(SLOPE), 5 / 12 * SIDE**2
    whole = inertia + SIDE**2

    def forces(y: Any) -> tuple[float, float, float]:
        s, c = math.sin(y[0]), math.cos(y[0])
        gains = SIDE * (along * c + into * s) / whole
        H = SIDE * (gains * c - y[1] ** 2 * s) - along
        return gains, H, into - SIDE * (gains * s + y[1] ** 2 * c)

    def sliding(way: float, y: Any) -> list[float]:
        s, c = math.sin(y[0]), math.cos(y[0])
        arm = SIDE * (s + way * MU * c)
        load = (into - SIDE * y[1] ** 2 * c) / (1 + SIDE * s * arm / inertia)
        gains = arm * load / inertia
        drawn = along - way * MU * load - SIDE * (gains * c - y[1] ** 2 * s)
        return [y[1], gains, y[3], drawn]

    def first(rates: Any, state: list[float], *events: Any) -> tuple[list[float], bool]:
        for event in events:
            event.terminal, event.direction = True, -1
        made = solve_ivp(
            rates, (t, t + 1.0), state, "DOP853", rtol=1e-13, atol=1e-16, events=events
        )
        return [made.t[-1], *made.y[:, -1]], len(made.t_events[0]) > 0

    t, rate, times, rates = 0.0, 6.0, [], []
    while True:
        (t, *state), lands = first(
            lambda _, y: [y[1], forces(y)[0]], [-math.pi / 6, rate],
            lambda _, y: math.pi / 6 - y[0], lambda _, y: MU * forces(y)[2] - abs(forces(y)[1]),
        )  # fmt: skip
        slip = 0.0
        if not lands:
            way = -math.copysign(1.0, forces(state)[1])
            (t, *state), lands = first(
                lambda _, y, way=way: sliding(way, y), [*state, 0.0, way * 1e-15],
                lambda _, y: math.pi / 6 - y[0], lambda _, y, way=way: way * y[3],
            )  # fmt: skip
            assert lands
            slip = state[3]
        if t > end:
            return times, rates
        x, y = -SIDE / 2, SIDE * math.cos(math.pi / 6)
        speed = slip + y * state[1], x * state[1]
        rate = (inertia * state[1] + y * speed[0] - x * speed[1]) / whole
        times.append(t)
        rates.append(-rate)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_hexagon_that_rolls_down_slips_before_each_blow(engine: str) -> None:
    found = statechart.run(interpret(read_text(_NUT, "nut.yaml")), engine=engine).outputs
    times, rates = _rolled(1.0)
    assert found["t"] == pytest.approx(times, rel=1e-10)
    assert found["w"] == pytest.approx(rates, rel=1e-10)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_masses_on_a_rope_end_in_mutual_rotation(engine: str) -> None:
    # Beside their centre they move straight, and along chords of the circle that the rope lets.
    # Each impact leaves 0.3 of the normal velocity, so that the sequence ends; the other stays.
    reach, place, speed = 0.5, np.array([0.2, 0.0]), np.array([-2.0, -2.0])
    a, b, c = speed @ speed, place @ speed, place @ place - reach**2
    times = [(-b + math.sqrt(b * b - a * c)) / a]
    out = (place + times[0] * speed) / reach
    across = out[0] * speed[1] - out[1] * speed[0]
    turned, apart = math.atan2(out[1], out[0]), 0.3 * (speed @ out)
    for _ in range(60):
        took = 2.0 * reach * apart / (apart**2 + across**2)
        turned += 2.0 * math.atan2(apart, across)
        times.append(times[-1] + took)
        apart *= 0.3
    turned += across / reach * (3.0 - times[-1])
    found = statechart.run(interpret(read_text(_ROPE, "rope.yaml")), engine=engine).outputs
    assert found["t"] == pytest.approx(times[:5], rel=1e-10)
    # The last bounces are summed as if they were equal.
    assert found["taut"] == pytest.approx(times[-1], rel=3e-9)
    wanted = [reach * math.cos(turned), reach * math.sin(turned)]
    assert [found["x"], found["y"]] == pytest.approx(wanted, abs=1e-9)
