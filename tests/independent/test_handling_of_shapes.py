"""A gripper, a shaker, a drum, a kerb and a slope, against answers by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs_of_shapes import assert_moves_as_its_image, run
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

G = 9.81

GRIPPER = f"""
kind: scene
name: gripper
parameters: {{m: 1, mu: 0.5, F: 12, fades: 0, a: 0.05, v: 0.3}}
gravity: {G}
bodies:
  box: {{mass: m, inertia: 2/3*m*a**2, start: {{y: a}},
    shape: {{polygon: [[-a, -a], [a, -a], [a, a], [-a, a]]}}}}
  left: {{mass: 0.2, inertia: 0.001, start: {{x: -a - 0.02, y: a}},
    shape: {{polygon: [[-0.02, -0.03], [0.02, -0.03], [0.02, 0.03], [-0.02, 0.03]]}}}}
  right: {{mass: 0.2, inertia: 0.001, start: {{x: a + 0.02, y: a}},
    shape: {{polygon: [[-0.02, -0.03], [0.02, -0.03], [0.02, 0.03], [-0.02, 0.03]]}}}}
surfaces: {{table: {{height: 0}}}}
regions:
  hand:
    initial: waits
    variables: {{up: 0}}
    states: {{waits: {{}}, lifts: {{flows: {{up: v}}}}, holds: {{}}}}
    transitions:
      - {{name: begin, from: waits, to: lifts, after: 0.1}}
      - {{name: end, from: lifts, to: holds, after: 1}}
joints:
  left_in: {{point: {{body: left, at: [0.015, 0]}}, to: {{y: a + up}}}}
  left_out: {{point: {{body: left, at: [-0.015, 0]}}, to: {{y: a + up}}}}
  right_in: {{point: {{body: right, at: [-0.015, 0]}}, to: {{y: a + up}}}}
  right_out: {{point: {{body: right, at: [0.015, 0]}}, to: {{y: a + up}}}}
forces:
  from_left: {{body: left, force: [F - fades*time, 0]}}
  from_right: {{body: right, force: [-F + fades*time, 0]}}
collisions:
  jaws: {{bodies: [box, left, right], friction: mu, restitution: 0}}
  below: {{bodies: [box], surfaces: [table], friction: mu, restitution: 0}}
stop: {{time: 1.6}}
outputs:
  lift: {{value: box.y - a}}
  slips: {{value: time, at: last box.slip}}
settings: {{engine: impulse, step: STEP}}
"""


@pytest.mark.parametrize("force", [9.7, 10.5, 12.0, 30.0])
def test_a_gripper_lifts_up_to_its_friction_limit(force):
    # It closes at rest and starts at once: the box lags until it has the speed of the jaws, and
    # goes on a little where they stop.
    gains, loses = 2 * 0.5 * force - G, 2 * 0.5 * force + G
    way = 0.3 - 0.3**2 / (2 * gains) + 0.3**2 / (2 * loses)
    # Jaws that slide up by more than 0.08 are off it.
    lifted = gains > 0 and 0.3**2 / (2 * gains) < 0.08
    result = run(GRIPPER, step=2e-3, F=force)
    assert result.outputs["lift"] == pytest.approx(way if lifted else 0.0, abs=1e-4)


def test_a_gripper_whose_force_fades_drops_its_box_at_a_limit():
    for step in (2e-3, 5e-4):
        result = run(GRIPPER, step=step, F=15.0, fades=4.0)
        # 2 mu F(t) = m g.
        assert result.outputs["slips"] == pytest.approx((15 - G) / 4, abs=1.01 * step)
    assert_moves_as_its_image(GRIPPER, step=2e-3, within=1e-9, F=15.0, fades=4.0)


SHAKER = f"""
kind: scene
name: shaker
parameters: {{A: 0.01, w: 20, B: 0.0025, q: 0.6, a: 0.02, mu: 0.4}}
gravity: {G}
bodies:
  box: {{copies: 3, mass: 0.1, inertia: 0.1*2/3*a**2, start: {{x: 0.1*index, y: a}},
    shape: {{polygon: [[-a, -a], [a, -a], [a, a], [-a, a]]}}}}
surfaces:
  plate:
    edge: [[-5, 0], [5, 0]]
    displacement: [A*sin(w*time) + B*(sin(2*w*time + q) - sin(q)), 0]
collisions: {{all: {{bodies: [box], surfaces: [plate], friction: mu, restitution: 0}}}}
stop: {{time: 3}}
settings: {{engine: impulse, step: STEP}}
"""


def test_a_shaker_conveys_by_the_phase_of_its_second_harmonic():
    times = (np.arange(150_000) + 0.5) * 2e-5
    plate = 0.2 * np.cos(20 * times) + 0.1 * np.cos(40 * times + 0.6)
    x = v = 0.0
    for speed in plate.tolist():
        change = min(max(speed - v, -0.4 * G * 2e-5), 0.4 * G * 2e-5)
        x, v = x + (v + 0.5 * change) * 2e-5, v + change
    assert x < -0.05
    for step in (2e-3, 1e-3):
        final = run(SHAKER, step=step).trace.final
        # Displacement of the plate in two steps.
        assert final[[0, 3, 6]] == pytest.approx(x + np.array([0, 0.1, 0.2]), abs=0.4 * step)
        assert final[[1, 4, 7, 2, 5, 8]] == pytest.approx([0.02] * 3 + [0] * 3, abs=1e-9)


DRUM = f"""
kind: scene
name: drum
parameters: {{R: 1, a: 0.05, mu: 0.5, w: 20}}
gravity: {G}
bodies:
  box: {{mass: 1, inertia: 2/3*a**2, start: {{y: a - sqrt(R**2 - a**2)}},
    shape: {{polygon: [[-a, -a], [a, -a], [a, a], [-a, a]]}}}}
surfaces: {{wall: {{circle: [0, 0], radius: R, hollow: true, turn: w*time}}}}
collisions: {{all: {{bodies: [box], surfaces: [wall], friction: mu, restitution: 0}}}}
stop: {{time: 3}}
settings: {{engine: impulse, step: STEP}}
"""


def test_a_box_swings_in_a_drum_that_spins_under_it():
    half, away, mu = 0.05, math.sqrt(1 - 0.05**2) - 0.05, 0.5
    corners = np.array([[half, -half], [-half, -half]])
    normals = np.array([[-half, away + half], [half, away + half]])
    pushes = normals + mu * np.column_stack([normals[:, 1], -normals[:, 0]])
    turns = corners[:, 0] * pushes[:, 1] - corners[:, 1] * pushes[:, 0]
    # Both forces, and the acceleration of the angle.
    left = np.array([[*pushes[:, 0], -away], [*pushes[:, 1], 0], [*turns, -2 / 3 * half**2]])

    def rates(_, s):
        right = [G * math.sin(s[0]), G * math.cos(s[0]) + away * s[1] ** 2, 0]
        return s[1], np.linalg.solve(left, right)[2]

    angle, speed = solve_ivp(rates, (0, 3), (0, 0), rtol=1e-10, atol=1e-12).y[:, -1]
    place = [away * math.sin(angle), -away * math.cos(angle), angle]
    errors = []
    for step in (2e-3, 1e-3):
        final = run(DRUM, step=step).trace.final
        errors.append(np.abs(final[:3] - place).max())
        assert final[5] == pytest.approx(speed, abs=0.1 * step)
    assert errors[0] < 3e-5
    assert errors[1] < 0.35 * errors[0]


KERB = f"""
kind: scene
name: kerb
parameters: {{r: 0.3, h: 0.1, m: 10, F: 0, v: 0, far: 0}}
gravity: {G}
bodies:
  wheel: {{mass: m, inertia: m*r**2/2, shape: {{disc: r}},
    start: {{x: -sqrt(r**2 - (r - h)**2) - far, y: r, dx: v, dangle: -v/r}}}}
surfaces:
  low: {{edge: [[-3, 0], [0, 0]]}}
  face: {{edge: [[0, 0], [0, h]]}}
  high: {{edge: [[0, h], [3, h]]}}
forces: {{pull: {{body: wheel, force: [F, 0]}}}}
collisions: {{all: {{bodies: [wheel], surfaces: [low, face, high], friction: 2, restitution: 0}}}}
stop: {{time: 3}}
outputs: {{top: {{maximum: wheel.y}}, x: {{value: wheel.x}}}}
settings: {{engine: impulse, step: STEP}}
"""


def test_a_wheel_climbs_a_kerb_above_a_force():
    force = 10 * G * math.sqrt(0.3**2 - 0.2**2) / 0.2
    assert run(KERB, step=2e-3, F=0.999 * force).outputs["top"] == 0.3
    assert run(KERB, step=2e-3, F=1.001 * force).outputs["top"] > 0.35


def test_a_wheel_climbs_a_kerb_above_a_speed():
    # It keeps its angular momentum about the edge, and has to lift its weight by h.
    kept = (0.5 * 0.3 + 0.2) / (1.5 * 0.3)
    speed = math.sqrt(2 * G * 0.1 / 1.5) / kept
    for part, climbs in ((0.99, False), (1.01, True)):
        result = run(KERB, step=1e-3, v=part * speed, far=0.5)
        assert (result.outputs["x"] > 0) == climbs


PLANK = f"""
kind: scene
name: plank
parameters: {{L: 2, t: 0.02, H: 0.8, mu: 0.3, q: 0.6, s: H/sin(q)}}
gravity: {G}
bodies:
  plank: {{mass: 5, inertia: 5*(L**2 + t**2)/12,
    start: {{x: (L/2 - s)*cos(q) - t/2*sin(q), y: L/2*sin(q) + t/2*cos(q), angle: q}},
    shape: {{polygon: [[-L/2, -t/2], [L/2, -t/2], [L/2, t/2], [-L/2, t/2]]}}}}
surfaces:
  floor: {{edge: [[-5, 0], [0, 0]]}}
  face: {{edge: [[0, 0], [0, H]]}}
  top: {{edge: [[0, H], [3, H]]}}
collisions: {{all: {{bodies: [plank], surfaces: [floor, face, top], friction: mu, restitution: 0}}}}
stop: {{time: 1}}
settings: {{engine: impulse, step: STEP}}
"""


@pytest.mark.parametrize("lean", [0.5, 0.6, 0.8])
def test_a_plank_leans_on_the_edge_of_a_step_as_far_as_friction_holds_both_its_ends(lean):
    along, up = (
        np.array([math.cos(lean), math.sin(lean)]),
        np.array([-math.sin(lean), math.cos(lean)]),
    )
    reach = 0.8 / math.sin(lean)

    def missing(mu):
        # Both forces at their bounds: distance of the line of the weight from their intersection.
        floor, edge = np.array([mu, 1.0]), up + mu * along
        foot, top = -reach * along + [0, 0.8], np.array([0, 0.8])
        on, _ = np.linalg.solve(np.column_stack([floor, -edge]), top - foot)
        return (foot + on * floor)[0] - (foot + along + 0.01 * up)[0]

    limit = brentq(missing, 0.05, 0.95)
    for part, stands in ((0.999, False), (1.001, True)):
        trace = run(PLANK, step=2e-3, mu=part * limit, q=lean).trace
        assert (abs(trace.final - trace.initial).max() < 1e-10) == stands
