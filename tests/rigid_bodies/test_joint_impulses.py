"""Impulses of joints in impacts by steps."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81

WELDED = """
kind: scene
name: welded
parameters: {a: 0.1, y: 0.5}
gravity: 9.81
bodies:
  below:
    mass: 2
    inertia: 0.01
    shape: {polygon: [[-a, -a], [a, -a], [a, a], [-a, a]]}
    start: {y: a + y}
  above: {mass: 1, inertia: 0.01, shape: {disc: a}, start: {y: 3*a + y}}
surfaces: {floor: {height: 0}}
joints: {weld: {point: {body: above}, to: {body: below, at: [0, 2*a]}, angle: held}}
collisions: {all: {bodies: [below, above], surfaces: [floor], friction: 0.5, restitution: 0}}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""

# A rod on a hinge falls on its tip.
ROD = """
kind: scene
name: rod
parameters: {L: 1, m: 3}
gravity: 9.81
bodies: {rod: {mass: m, inertia: m*L**2/12, start: {x: L/2*cos(0.5), y: L/2*sin(0.5), angle: 0.5}}}
joints: {hinge: {point: {body: rod, at: [-L/2, 0]}, to: [0, 0]}}
surfaces: {floor: {height: 0}}
contacts: {tip: {point: {body: rod, at: [L/2, 0]}, surface: floor, friction: 0, restitution: 0}}
stop: {time: 0.7}
settings: {engine: impulse, step: 1e-4}
"""


def run(text, parameters=None, **settings):
    return Runner(interpret(read_text(text)), **settings).run(parameters or {})


def test_a_landing_lists_the_impulse_of_a_weld():
    jump = next(j for j in run(WELDED).trace.jumps if j.cause == "touchdown")
    impulse = jump.impulse["below"][0]
    assert impulse == pytest.approx(3 * math.sqrt(2 * G * 0.5), rel=3e-3)
    assert jump.joint_impulse["weld.Y"] == pytest.approx(impulse / 3, rel=1e-9)
    assert all(abs(jump.joint_impulse.get(f"weld.{x}", 0)) < 1e-9 * impulse for x in "XM")


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_points_list_impulses_of_joints_by_steps_as_with_events(engine):
    """By hand: P L = m L^2/3 w at the tip, and the hinge takes the rest of m L/2 w."""
    settings = {"step": 1e-4} if engine == "impulse" else {}
    jump = next(j for j in run(ROD, engine=engine, **settings).trace.jumps if j.impulse)
    rate = math.sqrt(3 * G * math.sin(0.5))
    assert jump.impulse["tip"][0] == pytest.approx(rate, rel=1e-3)
    assert jump.joint_impulse["hinge.Y"] == pytest.approx(rate / 2, rel=1e-3)
    assert jump.joint_impulse.get("hinge.X", 0) == pytest.approx(0, abs=5e-3)


BAR = """
kind: scene
name: bar
gravity: 9.81
parameters: {y: 0}
bodies:
  bar:
    mass: 1
    inertia: 0.1
    shape: {polygon: [[-0.5, -0.02], [0.5, -0.02], [0.5, 0.02], [-0.5, 0.02]]}
    start: {x: 0.5, y: y}
surfaces: {floor: {height: -0.02}}
joints: {pin: {point: {body: bar, at: [-0.5, 0]}, to: [0, y]}}
collisions: {all: {bodies: [bar], surfaces: [floor], friction: 0, restitution: 0}}
outputs: {most: {maximum: pin.Y}}
stop: {time: 0.02}
"""


@pytest.mark.parametrize("y", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("step", [2e-3, 1e-3, 5e-4])
def test_the_force_of_a_hinge_has_no_peak_as_its_bar_lands(y, step):
    """Lying, a bar is carried in halves; falling, its hinge bears less."""
    found = run(BAR, {"y": y}, engine="impulse", step=step)
    assert found.outputs["most"] == pytest.approx(9.81 / 2, rel=2e-3)
