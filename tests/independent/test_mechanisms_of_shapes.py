"""Mechanisms of colliding shapes beside closed forms and equations of motion of their own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs_of_shapes import assert_moves_as_its_image, run
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

G = 9.81


def turned(angle, x, y):
    return np.array(
        [math.cos(angle) * x - math.sin(angle) * y, math.sin(angle) * x + math.cos(angle) * y]
    )


TEETH = "\n".join(
    f"      - polygon: [[r*cos({k}*p), r*sin({k}*p)], [R*cos({k}*p), R*sin({k}*p)], "
    f"[r*cos({k + 1}*p), r*sin({k + 1}*p)]]"
    for k in range(12)
)
RATCHET = f"""
kind: scene
name: ratchet
parameters: {{r: 0.8, R: 1, p: pi/6, L: 1, d: 0.03, M: 5, m: 0.3, B: 5, w0: 4}}
gravity: {G}
bodies:
  wheel:
    mass: M
    inertia: M*R**2/2
    start: {{dangle: w0}}
    shape:
      - {{disc: r}}
{TEETH}
  pawl:
    mass: m
    inertia: m*L**2/12
    shape: {{polygon: [[-L/2, -d], [L/2, -d], [L/2, d], [-L/2, d]]}}
    start: {{x: 0.1 + L/2, y: 1.1 + d}}
joints:
  axle: {{point: {{body: wheel}}, to: [0, 0]}}
  hinge: {{point: {{body: pawl, at: [L/2, 0]}}, to: [0.1 + L, 1.1 + d]}}
forces: {{back: {{body: wheel, moment: -B}}}}
collisions: {{teeth: {{bodies: [wheel, pawl], friction: 0.1, restitution: 0}}}}
stop: {{time: 2.5}}
outputs: {{turned: {{value: wheel.angle}}, least: {{minimum: wheel.angle}}}}
settings: {{engine: impulse, step: STEP}}
"""


def locked():
    """Return the angles of wheel and pawl where one end of it is on a tooth and before the next."""

    def left_of(one, two, place):
        (x, y), (u, v) = two - one, place - one
        return x * v - y * u

    def apart(angles):
        wheel, pawl = angles
        middle = np.array([1.1, 1.13]) - turned(pawl, 0.5, 0)
        ends = [middle + turned(pawl, -0.5, side) for side in (-0.03, 0.03)]
        # The fourth tooth before the top, and the third.
        tip, root, edge = (
            turned(wheel - k * math.pi / 6, reach, 0) for k, reach in ((4, 1), (3, 0.8), (3, 1))
        )
        return left_of(tip, root, ends[0]), left_of(root, edge, ends[1])

    return fsolve(apart, [3.0, 0.3], xtol=1e-13)


def test_a_ratchet_turns_on_and_locks_on_the_way_back():
    wheel, pawl = locked()
    for step in (2e-3, 1e-3):
        result = run(RATCHET, step=step)
        final = result.trace.final
        assert result.outputs["least"] == 0.0
        # A tooth strikes the pawl at 1.15 radians a second; it may be a step deep.
        assert [final[2], final[5]] == pytest.approx([wheel, pawl], abs=1.2 * step)
        assert np.abs(final[6:12]).max() < 1e-9


def test_a_mirrored_ratchet_has_the_mirrored_run():
    # Twice the pawl comes to lie on a tooth, all along or on its end, but for rounding.
    assert_moves_as_its_image(RATCHET, step=1e-3, within=1e-8, M=3.0, B=3.0)


PLANK = f"""
kind: scene
name: plank
parameters: {{r: 0.1, L: 2, t: 0.02, M: 2, m: 0.5, F: 3}}
gravity: {G}
bodies:
  roller: {{copies: 2, mass: m, inertia: m*r**2/2, shape: {{disc: r}},
    start: {{x: 0.5*index, y: r}}}}
  plank: {{mass: M, inertia: M*L**2/12, start: {{x: 0.2, y: 2*r + t/2}},
    shape: {{polygon: [[-L/2, -t/2], [L/2, -t/2], [L/2, t/2], [-L/2, t/2]]}}}}
surfaces: {{floor: {{height: 0}}}}
forces: {{pull: {{body: plank, force: [F, 0]}}}}
collisions: {{all: {{bodies: [roller, plank], surfaces: [floor], friction: 0.6, restitution: 0}}}}
stop: {{time: 0.6}}
settings: {{engine: impulse, step: STEP}}
"""


def test_a_plank_goes_twice_as_far_as_its_rollers():
    # A roller at v/2 has the kinetic energy 3/16 m v^2.
    way = 0.5 * 3 / (2 + 2 * 3 / 8 * 0.5) * 0.6**2
    final = run(PLANK, step=4e-3).trace.final
    assert final[[0, 3, 6]] == pytest.approx([way / 2, 0.5 + way / 2, 0.2 + way], abs=1e-10)
    assert final[[2, 5]] == pytest.approx([-way / 2 / 0.1] * 2, abs=1e-9)


BOWL = f"""
kind: scene
name: bowl
parameters: {{R: 1, r: 0.1, A: 0.1, w: 4, mu: 0, q: 0.4}}
gravity: {G}
bodies:
  ball: {{mass: 1, inertia: r**2/2, shape: {{disc: r}},
    start: {{x: (R - r)*sin(q), y: -(R - r)*cos(q)}}}}
surfaces:
  bowl: {{circle: [0, 0], radius: R, hollow: true, displacement: [A*(1 - cos(w*time)), 0]}}
collisions: {{balls: {{bodies: [ball], surfaces: [bowl], friction: mu, restitution: 0}}}}
stop: {{time: 3}}
settings: {{engine: impulse, step: STEP}}
"""


@pytest.mark.parametrize(("mu", "inertia"), [(0.0, 0.0), (5.0, 0.5)])
def test_a_ball_swings_in_a_bowl_that_is_shaken(mu, inertia):
    def rates(t, s):
        pull = -G * math.sin(s[0]) - 1.6 * math.cos(4 * t) * math.cos(s[0])
        return s[1], pull / (0.9 * (1 + inertia))

    angle = solve_ivp(rates, (0, 3), (0.4, 0), rtol=1e-11, atol=1e-12).y[0, -1]
    place = [0.1 * (1 - math.cos(12)) + 0.9 * math.sin(angle), -0.9 * math.cos(angle)]
    errors = [
        np.abs(run(BOWL, step=step, mu=mu).trace.final[:2] - place).max() for step in (4e-3, 2e-3)
    ]
    assert errors[0] < 2e-5
    assert errors[1] < 0.3 * errors[0]


WEDGE = """
kind: scene
name: wedge
parameters: {a: 10*pi/180, mu: 0.3, k: 2000, F: 100, h: 0.4, tip: 0.02, top: tip + 2*h*tan(a),
  c: h/3*(tip + 2*top)/(tip + top), b: 0.1*tan(a)}
bodies:
  wedge: {mass: 1, inertia: 0.01, start: {y: c},
    shape: {polygon: [[-tip/2, -c], [tip/2, -c], [top/2, h - c], [-top/2, h - c]]}}
  right: {mass: 2, inertia: 0.02, start: {x: tip/2 + 2*b + 0.1, y: 0.2},
    shape: {polygon: [[-0.1 - b, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1 + b, 0.1]]}}
  left: {mass: 2, inertia: 0.02, start: {x: -tip/2 - 2*b - 0.1, y: 0.2},
    shape: {polygon: [[-0.1, -0.1], [0.1 + b, -0.1], [0.1 - b, 0.1], [-0.1, 0.1]]}}
joints:
  right_guide: {point: {body: right, at: [0.1, 0]}, to: {y: 0.2}}
  right_level: {point: {body: right, at: [-0.05, 0]}, to: {y: 0.2}}
  left_guide: {point: {body: left, at: [-0.1, 0]}, to: {y: 0.2}}
  left_level: {point: {body: left, at: [0.05, 0]}, to: {y: 0.2}}
forces:
  drive: {body: wedge, force: [0, -F]}
  right_spring: {body: right, force: [-k*(right.x - tip/2), 0]}
  left_spring: {body: left, force: [-k*(left.x + tip/2), 0]}
collisions: {faces: {bodies: [wedge, right, left], friction: mu, restitution: 0}}
stop: {time: 0.05}
settings: {engine: impulse, step: STEP}
"""
LEAN = math.radians(10)
SPRING = 2000 * (0.2 * math.tan(LEAN) + 0.1)


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.6])
def test_a_wedge_sticks_between_its_two_force_limits(mu):
    friction = math.atan(mu)
    into, out = (2 * SPRING * math.tan(LEAN + sign * friction) for sign in (1, -1))
    # Below its angle of friction it has to be drawn.
    assert (out < 0) == (mu > math.tan(LEAN))
    moved = {}
    for name, force in (
        ("holds", 0.995 * into), ("sinks", 1.005 * into),
        ("stays", out + 0.01 * abs(out)), ("rises", out - 0.01 * abs(out)),
    ):  # fmt: skip
        trace = run(WEDGE, step=2e-3, mu=mu, F=force).trace
        moved[name] = trace.final[1] - trace.initial[1]
    assert abs(moved["holds"]) < 1e-12
    assert abs(moved["stays"]) < 1e-12
    assert moved["sinks"] < -1e-4
    assert moved["rises"] > 1e-4


def test_a_wedge_that_slides_in_moves_as_by_its_balance():
    slope, mu = math.tan(LEAN), 0.3
    lever = (math.sin(LEAN) + mu * math.cos(LEAN)) / (math.cos(LEAN) - mu * math.sin(LEAN))

    def rates(_, s):
        return s[1], (400 - 2 * lever * (SPRING + 2000 * s[0] * slope)) / (1 + 4 * lever * slope)

    depth = solve_ivp(rates, (0, 0.05), (0, 0), rtol=1e-11, atol=1e-12).y[0, -1]
    trace = run(WEDGE, step=1e-3, mu=mu, F=400.0).trace
    assert trace.initial[1] - trace.final[1] == pytest.approx(depth, rel=1e-4)


CRADLE = f"""
kind: scene
name: cradle
parameters: {{L: 1, r: 0.05, q: 0.3, d: 0.12}}
gravity: {G}
bodies:
  one: {{mass: 1, inertia: r**2/2, shape: {{disc: r}},
    start: {{x: -L*sin(q), y: -L*cos(q), angle: -q}}}}
  two: {{mass: 0.5, inertia: 0.5*r**2/2, shape: {{disc: r}}, start: {{x: d, y: -L}}}}
  three: {{mass: 0.25, inertia: 0.25*r**2/2, shape: {{disc: r}}, start: {{x: 2*d, y: -L}}}}
joints:
  first: {{point: {{body: one, at: [0, L]}}, to: [0, 0]}}
  second: {{point: {{body: two, at: [0, L]}}, to: [d, 0]}}
  third: {{point: {{body: three, at: [0, L]}}, to: [2*d, 0]}}
collisions: {{balls: {{bodies: [one, two, three], friction: 0, restitution: 1}}}}
stop: {{time: 1}}
outputs: {{clicks: {{value: time, at: each touchdown}}, of_two: {{count: two.touchdown}}}}
settings: {{engine: impulse, step: STEP}}
"""


def swung(masses, start, time):
    """Return when pendulums with gaps strike, one after another, and their angles at the end."""
    inertias = np.array(masses) * (1 + 0.05**2 / 2)
    pull, hangs = G * np.array(masses) / inertias, 0.12 * np.arange(3)

    def ball(s, k):
        return np.array([hangs[k] + math.sin(s[k]), -math.cos(s[k])])

    def gap(k):
        def event(_, s):
            return np.hypot(*(ball(s, k + 1) - ball(s, k))) - 0.1

        event.terminal, event.direction = True, -1
        return event

    state, now, times = np.array([*start, 0, 0, 0]), 0.0, []
    while True:
        found = solve_ivp(
            lambda _, s: np.concatenate([s[3:], -pull * np.sin(s[:3])]), (now, time), state,
            events=[gap(0), gap(1)], rtol=1e-11, atol=1e-12, max_step=0.02,
        )  # fmt: skip
        state, now = found.y[:, -1].copy(), found.t[-1]
        if found.status == 0:
            return times, state[:3]
        k = 0 if len(found.t_events[0]) else 1
        normal = ball(state, k + 1) - ball(state, k)
        normal /= np.hypot(*normal)
        ways = np.zeros(3)
        for i, sign in ((k, -1), (k + 1, 1)):
            ways[i] = sign * (math.cos(state[i]) * normal[0] + math.sin(state[i]) * normal[1])
        rate = ways @ state[3:]
        state[3:] -= 2 * rate / (ways @ (ways / inertias)) * ways / inertias
        times.append(now)


def test_unequal_balls_strike_one_after_another():
    clicks, angles = swung([1, 0.5, 0.25], [-0.3, 0, 0], 1)
    assert len(clicks) == 2
    for step in (1e-3, 2.5e-4):
        result = run(CRADLE, step=step)
        # Each is an event of the two that meet.
        assert result.outputs["of_two"] == 2
        assert result.outputs["clicks"] == pytest.approx(clicks, abs=step)
        assert result.trace.final[[2, 5, 8]] == pytest.approx(angles, abs=0.5 * step)


RAM = f"""
kind: scene
name: ram
parameters: {{a: 0.2, l: 0.6, torque: 3, mu: 0.3, m: 2}}
gravity: {G}
coordinates: {{q: {{start: pi + 0.1}}}}
bodies:
  crank: {{mass: 1, inertia: 0.05, position: [0, 0.1], angle: q}}
  ram:
    mass: 1
    position: [a*cos(q) + sqrt(l**2 - (a*sin(q))**2), 0.1]
    shape: {{polygon: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}}
  box:
    mass: m
    inertia: m*0.04/6
    shape: {{polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}}
    start: {{x: a*cos(pi + 0.1) + sqrt(l**2 - (a*sin(pi + 0.1))**2) + 0.25, y: 0.1}}
surfaces: {{floor: {{height: 0}}}}
forces: {{motor: {{body: crank, moment: torque}}}}
collisions:
  pushes: {{bodies: [ram, box], friction: 0, restitution: 0}}
  rubs: {{bodies: [box], surfaces: [floor], friction: mu, restitution: 0}}
stop: {{time: 0.43}}
settings: {{engine: impulse, step: STEP}}
outputs:
  leaves: {{value: time, at: each ram.liftoff}}
  strikes: {{value: time, at: each ram.touchdown}}
"""


@pytest.mark.parametrize("step", [1e-3, 7e-4, 2.5e-4, 1e-4])
def test_a_ram_that_slows_down_leaves_its_box_once(step):
    """The face that it pushes bears at one of its two ends.

    As its path bent by more than gravity, the other end pressed and both left in turn.
    """
    a, long, torque, mu, m = 0.2, 0.6, 3.0, 0.3, 2.0

    def path(q):
        """Return the place of the ram and its first two derivatives."""
        root, bent = math.sqrt(long**2 - (a * math.sin(q)) ** 2), a * a * math.sin(2 * q) / 2
        first = -a * math.sin(q) - bent / root
        turned = a * a * math.cos(2 * q) / root + bent**2 / root**3
        return a * math.cos(q) + root, first, -a * math.cos(q) - turned

    def push(_, state, moved, drag):
        q, w = state
        _, first, second = path(q)
        force = torque - moved * first * second * w * w - drag * first
        return [w, force / (0.05 + moved * first**2)]

    def meets(_, state, *_rest):
        return path(state[0])[0] - path(math.pi + 0.1)[0] - 0.1

    def leaves(t, state, moved, drag):
        _, first, second = path(state[0])
        return first * push(t, state, moved, drag)[1] + second * state[1] ** 2 + mu * G

    meets.terminal = leaves.terminal = True
    exact = {"rtol": 1e-11, "atol": 1e-12}
    way = solve_ivp(push, (0, 1), [math.pi + 0.1, 0], args=(1, 0), events=meets, **exact)
    q, w = way.y[:, -1]
    first = path(q)[1]
    w *= (0.05 + first**2) / (0.05 + (1 + m) * first**2)
    rest = solve_ivp(push, (0, 1), [q, w], args=(1 + m, mu * m * G), events=leaves, **exact)
    outputs = run(RAM, step=step).outputs
    assert outputs["strikes"] == pytest.approx([way.t[-1]], abs=step)
    assert outputs["leaves"] == pytest.approx([way.t[-1] + rest.t[-1]], abs=2 * step)
