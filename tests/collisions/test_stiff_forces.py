"""Forces that steps would swing ever farther: springs and dampers, free, held, and with others."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import StepTooLarge
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STEP = 1e-3
SPRING = """\
kind: scene
name: spring
parameters: {k: 0, c: 0, mu: 0, x0: 0.01, y0: 0.3}
gravity: 9.81
bodies: {a: {mass: 2, inertia: 0.02, shape: {disc: 0.1}, start: {x: x0, y: y0}}}
surfaces: {floor: {height: 0}}
forces: {pull: {body: a, force: [-k*a.x - c*a.dx, 0], moment: -c*a.dangle/100}}
collisions: {all: {bodies: [a], surfaces: [floor], friction: mu, restitution: 0}}
stop: {time: 0.2}
outputs: {far: {maximum: a.x}}
settings: {engine: impulse, step: 1e-3}
"""
PLANKS = """\
kind: scene
name: planks
parameters: {c: 1}
gravity: 9.81
bodies:
  one: {mass: 1, inertia: 0.00337, shape: {polygon: SHAPE}, start: {x: 0.1}}
  two: {mass: 1, inertia: 0.00337, shape: {polygon: SHAPE}, start: {x: 0.3}}
joints:
  first: {point: {body: one, at: [-0.1, 0]}, to: [0, 0]}
  second: {point: {body: two, at: [-0.1, 0]}, to: {body: one, at: [0.1, 0]}}
forces:
  rub1: {body: one, force: [0, 0], moment: -c*one.dangle}
  rub2: {body: two, force: [0, 0], moment: -c*two.dangle}
collisions: {all: {bodies: [one, two], friction: 0, restitution: 0}}
stop: {time: 0.5}
outputs: {most: {maximum: energy}}
settings: {engine: impulse, step: 1e-3}
""".replace("SHAPE", "[[-0.09, -0.01], [0.09, -0.01], [0.09, 0.01], [-0.09, 0.01]]")
# Of the mass matrix of the two angles, hanging straight: 1/3 + 1 squares of lengths, and 1/2.
QUICKEST = 1.0 / (0.5 * (0.05337 + 0.01337) - (0.25 * 0.04**2 + 0.02**2) ** 0.5)


@pytest.mark.parametrize("stiff", [{"k": 8e6}, {"c": 4e3}, {"k": 4e6, "c": 2e3}])
def test_a_spring_and_a_damper_are_followed_up_to_two_radians_a_step(stiff):
    runner = Runner(interpret(read_text(SPRING)))
    followed = runner.run({name: 0.98 * value for name, value in stiff.items()})
    assert followed.outputs["far"] < 0.2
    with pytest.raises(StepTooLarge, match=r"swing bodies by 2\.\d+ radians in one step") as caught:
        runner.run({name: 1.02 * value for name, value in stiff.items()})
    step = float(str(caught.value).rsplit("take ", 1)[1].split()[0])
    assert 1e-5 < step < STEP


def test_what_rolls_swings_with_what_turns_and_what_slides_without():
    runner = Runner(interpret(read_text(SPRING)))
    for mu, mass in ((1e9, 4.0), (0.0, 2.0)):
        # So near that it is within the steepest friction that is computed with.
        limit = {"x0": 1e-5, "y0": 0.1, "mu": mu, "k": mass * (2.0 / STEP) ** 2}
        assert runner.run({**limit, "k": 0.98 * limit["k"]}).outputs["far"] < 2e-4
        with pytest.raises(StepTooLarge):
            runner.run({**limit, "k": 1.02 * limit["k"]})


def test_what_joints_hold_is_as_heavy_as_all_that_moves():
    runner = Runner(interpret(read_text(PLANKS)))
    limit = 2.0 / (STEP * QUICKEST)
    # Alone a plank would swing from 6.7 on.
    assert limit > 6.7
    assert runner.run({"c": 0.98 * limit}).outputs["most"] < 1e-3
    with pytest.raises(StepTooLarge):
        runner.run({"c": 1.02 * limit})
