"""Rolling resistance of discs in `collisions`, beside closed forms.

A disc (inertia m r^2/2) that rolls has a couple l N against its rotation and friction F at its rim:
m a = F, (m r^2/2) a/r = l N - F r. So F = 2 l N/(3 r), and it slows down by a = 2 l g/(3 r).
"""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G, R, LENGTH = 9.81, 0.1, 0.01

ROLLING = """
kind: scene
name: rolling
parameters: {r: 0.1, l: 0.01, v: 0.5, alpha: 0, m: 3, mu: 0.5}
gravity: 9.81
bodies:
  wheel:
    mass: m
    inertia: m*r**2/2
    shape: {disc: r}
    start: {x: -r*sin(alpha), y: r*cos(alpha), dx: v*cos(alpha), dy: v*sin(alpha), dangle: -v/r}
surfaces: {ramp: {incline: alpha}}
collisions:
  all: {bodies: [wheel], surfaces: [ramp], friction: mu, restitution: 0, rolling_resistance: l}
stop: {time: 2}
settings: {engine: impulse, step: 1e-3}
outputs:
  way: {value: wheel.x*cos(alpha) + wheel.y*sin(alpha)}
  turned: {value: wheel.angle}
  speed: {value: wheel.dangle}
"""


def run(text, parameters=None, **settings):
    return Runner(interpret(read_text(text)), **settings).run(parameters).outputs


def test_a_disc_on_a_floor_comes_to_rest():
    slows = 2 * LENGTH * G / (3 * R)
    for step in (4e-3, 1e-3):
        outputs = run(ROLLING, step=step)
        assert outputs["way"] == pytest.approx(0.5**2 / (2 * slows), abs=0.5 * step)
        assert outputs["turned"] == pytest.approx(-outputs["way"] / R, abs=1e-6)
        assert outputs["speed"] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("share", [0.9, 0.999])
def test_a_disc_on_a_slight_slope_stays(share):
    outputs = run(ROLLING, {"v": 0, "alpha": share * math.atan(LENGTH / R)})
    assert outputs["way"] == pytest.approx(0, abs=1e-9)
    assert outputs["turned"] == pytest.approx(0, abs=1e-9)


def test_disc_rolls_down_a_steeper_slope():
    alpha = 0.3
    pull = 2 / 3 * G * (math.sin(alpha) - LENGTH / R * math.cos(alpha))
    outputs = run(ROLLING, {"v": 0, "alpha": alpha})
    assert outputs["way"] == pytest.approx(-pull / 2 * 2**2, rel=2e-3)


def test_a_disc_rolled_up_a_steep_slope_returns():
    alpha, v = 0.3, 1.0
    up = 2 / 3 * G * (math.sin(alpha) + LENGTH / R * math.cos(alpha))
    down = 2 / 3 * G * (math.sin(alpha) - LENGTH / R * math.cos(alpha))
    way = v**2 / (2 * up) - down / 2 * (2 - v / up) ** 2
    assert run(ROLLING, {"v": v, "alpha": alpha})["way"] == pytest.approx(way, abs=5e-3)


def test_without_friction_the_couple_alone_stops_the_rotation():
    """A smooth floor: the disc spins down by l m g/(m r^2/2), and glides on."""
    text = ROLLING.replace("stop: {time: 2}", "stop: {time: 0.2}")
    outputs = run(text, {"mu": 0})
    assert outputs["way"] == pytest.approx(0.1, abs=1e-6)
    assert outputs["speed"] == pytest.approx(-0.5 / R + 0.2 * 2 * LENGTH * G / R**2, abs=1e-3)


def test_a_disc_between_discs_resists_their_relative_rotation():
    """One disc lies on another, spinning, in a frictionless slot: the other gains its lost spin."""
    text = """
kind: scene
name: stack
parameters: {r: 0.1, l: 0.01, w: 30}
gravity: 9.81
bodies:
  low: {mass: 1, inertia: r**2/2, shape: {disc: r}, start: {y: r}}
  high: {mass: 1, inertia: r**2/2, shape: {disc: r}, start: {y: 3*r, dangle: w}}
surfaces:
  floor: {height: 0}
  left: {line: [[-r, 0], [-r, -1]]}
  right: {line: [[r, -1], [r, 0]]}
collisions:
  pair: {bodies: [low, high], friction: 0, restitution: 0, rolling_resistance: l}
  slot: {bodies: [low, high], surfaces: [floor, left, right], friction: 0, restitution: 0}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
outputs:
  low: {value: low.dangle}
  high: {value: high.dangle}
"""
    outputs = run(text)
    gained = 0.5 * LENGTH * G / (R**2 / 2)
    assert outputs["low"] == pytest.approx(gained, rel=5e-3)
    assert outputs["high"] == pytest.approx(30 - gained, rel=5e-3)


def test_a_polygon_does_not_roll():
    text = ROLLING.replace("{disc: r}", "{polygon: [[-r, -r], [r, -r], [0, r]]}")
    with pytest.raises(DeclarationError, match="no body has a disc"):
        interpret(read_text(text))


def test_a_landing_lists_the_impulse_of_rolling_resistance():
    """A spinning disc lands on a smooth floor: the couple is at its bound."""
    text = ROLLING.replace("y: r*cos(alpha)", "y: r + 0.2").replace("-v/r", "-20")
    text = text.replace("mu: 0.5", "mu: 0").replace("stop: {time: 2}", "stop: {time: 0.3}")
    (jump,) = (j for j in Runner(interpret(read_text(text))).run().trace.jumps if j.impulse)
    impulse = jump.impulse["wheel"][0]
    assert impulse == pytest.approx(3 * math.sqrt(2 * G * 0.2), rel=3e-3)
    assert jump.joint_impulse == {"wheel_rolling.M": pytest.approx(LENGTH * impulse, rel=1e-9)}
    spin = (jump.after - jump.before)[5]
    assert 3 * R**2 / 2 * spin == pytest.approx(LENGTH * impulse, rel=1e-9)
