"""A leg whose knee locks strikes a wall with its toe: between stop and latch nothing has play."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G, M1, M2, L, B, I1, I2, WALL, E = 9.81, 2.0, 1.0, 0.5, 0.25, 0.04, 0.02, 0.3, 0.6
_HITS = 3
_LEG = f"""
kind: scene
name: locked_knee
gravity: {G}
parameters: {{m1: {M1}, m2: {M2}, l: {L}, b: {B}, p: 0.1}}
MOVED
surfaces:
  front: {{line: [[0, 1], [0, -1]], body: thigh}}
  back: {{line: [[0, -1], [0, 1]], body: thigh}}
  wall: {{line: [[{WALL}, -2], [{WALL}, 2]]}}
controls: {{hold: -1}}
contacts:
  stop:
    point: {{body: shank, at: [0, b + p]}}
    surface: front
    modes: [free, slide]
    friction: 0
    restitution: 0
  latch:
    point: {{body: shank, at: [0, HOW]}}
    surface: back
    modes: [free, slide]
    friction: 0
    restitution: 0
    enabled: hold > 0
  toe:
    point: {{body: shank, at: [0, -b]}}
    surface: wall
    modes: [free, slide]
    friction: 0
    restitution: {E}
regions:
  lock:
    initial: loose
    states: {{loose: {{}}, locked: {{sets: {{hold: 1}}}}}}
    transitions:
      - {{name: locks, from: loose, to: locked, on: stop.touchdown}}
stop: {{time: 2.7}}
outputs:
  locks: {{value: time, at: first locks}}
  hits: {{value: time, at: first {_HITS} toe.touchdown}}
  rates: {{value: RATE, at: first {_HITS} toe.touchdown}}
"""


# Formulas of two angles place the bodies, or joints do.
_ANGLES = f"""
coordinates: {{q: {{start: -0.6, rate: 3}}, s: {{start: -1.4}}}}
bodies:
  thigh: {{mass: m1, inertia: {I1}, position: [b*sin(q), -b*cos(q)], angle: q}}
  shank:
    {{mass: m2, inertia: {I2}, position: [l*sin(q) + b*sin(s), -l*cos(q) - b*cos(s)], angle: s}}
"""
_JOINTS = f"""
bodies:
  thigh:
    mass: m1
    inertia: {I1}
    start:
      x: -b*sin(0.6)
      y: -b*cos(0.6)
      angle: -0.6
      dx: 3*b*cos(0.6)
      dy: -3*b*sin(0.6)
      dangle: 3
  shank:
    mass: m2
    inertia: {I2}
    start:
      x: -l*sin(0.6) - b*sin(1.4)
      y: -l*cos(0.6) - b*cos(1.4)
      angle: -1.4
      dx: 3*l*cos(0.6)
      dy: -3*l*sin(0.6)
joints:
  hip: {{point: {{body: thigh, at: [0, b]}}, to: [0, 0]}}
  knee: {{point: {{body: thigh, at: [0, -b]}}, to: {{body: shank, at: [0, b]}}}}
"""


@functools.cache
def _moves() -> dict[str, np.ndarray]:
    """Return when the knee locks, and when the toe strikes and how fast the leg turns then."""
    masses = np.array([[I1 + M1 * B**2 + M2 * L**2, M2 * L * B], [M2 * L * B, I2 + M2 * B**2]])
    pull = np.array([(M1 * B + M2 * L) * G, M2 * B * G])

    def loose(t, z):
        matrix = masses * [[1.0, math.cos(z[0] - z[1])], [math.cos(z[0] - z[1]), 1.0]]
        turning = M2 * L * B * math.sin(z[0] - z[1])
        forces = [-turning * z[3] ** 2, turning * z[2] ** 2] - pull * np.sin(z[:2])
        return [z[2], z[3], *np.linalg.solve(matrix, forces)]

    def straight(t, z):
        return z[1] - z[0]

    def locked(t, z):
        return [z[1], -pull.sum() * math.sin(z[0]) / masses.sum()]

    def strikes(t, z):
        return (L + 2.0 * B) * math.sin(z[0]) - WALL

    straight.terminal = strikes.terminal = True
    strikes.direction = 1.0
    exact = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"}
    way = solve_ivp(loose, (0.0, 2.0), [-0.6, -1.4, 3.0, 0.0], events=straight, **exact)
    locks, (q, _, w, u) = way.t[-1], way.y[:, -1]
    z = [q, float(masses.sum(axis=0) @ [w, u]) / masses.sum()]
    t, hits, rates = locks, [], []
    for _ in range(_HITS):
        way = solve_ivp(locked, (t, 4.0), z, events=strikes, **exact)
        t, z = way.t[-1], [math.asin(WALL / (L + 2.0 * B)), -E * way.y[1, -1]]
        hits.append(t)
        rates.append(z[1])
    return {"locks": locks, "hits": np.array(hits), "rates": np.array(rates)}


def _run(arm="b + p", moved=_ANGLES, **settings):
    text = _LEG.replace("HOW", arm).replace("MOVED", moved)
    text = text.replace("RATE", "dq" if moved == _ANGLES else "thigh.dangle")
    return statechart.run(interpret(read_text(text)), **settings)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("moved", [_ANGLES, _JOINTS], ids=["angles", "joints"])
def test_latched_legs_move_as_one_with_events(engine, moved):
    found = _run(moved=moved, engine=engine).outputs
    for name, wanted in _moves().items():
        assert found[name] == pytest.approx(wanted, rel=1e-9), name


@pytest.mark.parametrize(
    ("arm", "moved"),
    [("b + p", _ANGLES), ("b + 3*p", _ANGLES), ("b + p", _JOINTS)],
    ids=["one point", "two points", "joints"],
)
@pytest.mark.parametrize("step", [4e-3, 1e-3, 3e-4])
def test_steps_strike_latched_bodies_as_one(step, arm, moved):
    found = _run(arm, moved, engine="impulse", step=step).outputs
    for name, wanted in _moves().items():
        assert np.abs(found[name] - wanted).max() <= 12.0 * step, (name, found[name], wanted)
