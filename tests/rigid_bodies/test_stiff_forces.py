"""Forces that steps would swing ever farther: springs and dampers, free, held, and with others."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress

import pytest

from contacts.rigid_bodies import rigid_body_run
from contacts.rigid_bodies.rigid_body_run import RigidBodyRun
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
# Largest eigenvalue of the inverse mass matrix of the two angles, hanging straight.
QUICKEST = 1.0 / (0.5 * (0.05337 + 0.01337) - (0.25 * 0.04**2 + 0.02**2) ** 0.5)


@pytest.mark.parametrize("stiff", [{"k": 8e6}, {"c": 4e3}, {"k": 4e6, "c": 2e3}])
def test_a_spring_and_a_damper_are_followed_up_to_two_radians_a_step(stiff):
    runner = Runner(interpret(read_text(SPRING)))
    followed = runner.run({name: 0.98 * value for name, value in stiff.items()})
    assert followed.outputs["far"] < 0.2
    with pytest.raises(StepTooLarge, match=r"oscillate by 2\.\d+ radians in one step") as caught:
        runner.run({name: 1.02 * value for name, value in stiff.items()})
    step = float(str(caught.value).rsplit("take ", 1)[1].split()[0])
    assert 1e-5 < step < STEP


def test_rolling_adds_rotational_inertia_to_the_stability_limit_and_sliding_does_not():
    runner = Runner(interpret(read_text(SPRING)))
    for mu, mass in ((1e9, 4.0), (0.0, 2.0)):
        # So near that it is within the steepest friction that is computed with.
        limit = {"x0": 1e-5, "y0": 0.1, "mu": mu, "k": mass * (2.0 / STEP) ** 2}
        assert runner.run({**limit, "k": 0.98 * limit["k"]}).outputs["far"] < 2e-4
        with pytest.raises(StepTooLarge):
            runner.run({**limit, "k": 1.02 * limit["k"]})


def test_the_stability_limit_uses_the_mass_of_all_jointed_bodies():
    runner = Runner(interpret(read_text(PLANKS)))
    limit = 2.0 / (STEP * QUICKEST)
    # Alone a plank would swing from 6.7 on.
    assert limit > 6.7
    assert runner.run({"c": 0.98 * limit}).outputs["most"] < 1e-3
    with pytest.raises(StepTooLarge):
        runner.run({"c": 1.02 * limit})


MANY = """\
kind: scene
name: many
parameters: {c: 0}
gravity: 0
bodies: {a: {mass: 2, inertia: 0.02, shape: {disc: 0.1}, copies: 600, start: {x: 0.3*index, dx: 1}}}
forces: {drag: {body: a, force: [-c*a.dx, 0]}}
collisions: {all: {bodies: [a], friction: 0, restitution: 0}}
stop: {time: 0.02}
outputs: {far: {value: energy}}
settings: {engine: impulse, step: 1e-3}
"""


def test_stiffness_is_checked_for_any_number_of_bodies():
    # One step of a damper leaves 1 - h c/m of a speed.
    runner = Runner(interpret(read_text(MANY)))
    assert runner.run({"c": 0.98 * 4e3}).outputs["far"] < 600.0
    with pytest.raises(StepTooLarge, match="oscillate by 2"):
        runner.run({"c": 1.02 * 4e3})


def bridge(mass, step):
    """Ten planks on an arc of one radian between pins, and a box that falls on them."""
    d = 0.1
    radius = 0.1 / math.sin(d / 2)
    at = [
        (radius * math.sin(0.5) + radius * math.sin(i * d - 0.5),
         radius * math.cos(0.5) - radius * math.cos(i * d - 0.5))
        for i in range(11)
    ]  # fmt: skip
    plank, names = "[[-0.09, -0.01], [0.09, -0.01], [0.09, 0.01], [-0.09, 0.01]]", ["box"]
    bodies, joints = [], [f"  end: {{point: {{body: p9, at: [0.1, 0]}}, to: [{at[-1][0]!r}, 0]}}"]
    for i, ((x, y), (u, v)) in enumerate(itertools.pairwise(at)):
        start = f"{{x: {(x + u) / 2!r}, y: {(y + v) / 2!r}, angle: {math.atan2(v - y, u - x)!r}}}"
        names.append(f"p{i}")
        bodies.append(
            f"  p{i}: {{mass: 1, inertia: 0.00337, shape: {{polygon: {plank}}}, start: {start}}}"
        )
        to = f"{{body: p{i - 1}, at: [0.1, 0]}}" if i else "[0, 0]"
        joints.append(f"  j{i}: {{point: {{body: p{i}, at: [-0.1, 0]}}, to: {to}}}")
    box = "[[-0.25, -0.25], [0.25, -0.25], [0.25, 0.25], [-0.25, 0.25]]"
    bodies.append(
        f"  box: {{mass: {mass}, inertia: {mass / 50}, shape: {{polygon: {box}}}, "
        f"start: {{x: {at[-1][0] / 2!r}, y: {at[5][1] + 0.3!r}}}}}"
    )
    return "\n".join([
        "kind: scene", "name: bridge", "gravity: 9.81", "bodies:", *bodies, "joints:", *joints,
        f"collisions: {{all: {{bodies: {names}, friction: 0.5, restitution: 0}}}}".replace("'", ""),
        "stop: {time: 0.3}",
        "outputs: {most: {maximum: energy}, y: {value: box.y}}",
        f"settings: {{engine: impulse, step: {step}}}",
    ])  # fmt: skip


def test_joints_that_add_energy_end_the_run(monkeypatch):
    monkeypatch.setattr(rigid_body_run, "_ADDED", 1e-3)
    with pytest.raises(StepTooLarge, match=r"for the joints: these have added .* take") as caught:
        Runner(interpret(read_text(bridge(500, 1e-3)))).run()
    assert 1e-6 < float(str(caught.value).rsplit("take ", 1)[1].split()[0]) < 1e-2


def test_a_reverted_next_step_keeps_the_error_of_the_run(monkeypatch):
    monkeypatch.setattr(rigid_body_run, "_ADDED", 1e-3)
    runner, steps = Runner(interpret(read_text(bridge(500, 1e-3)))), RigidBodyRun.steps
    with pytest.raises(StepTooLarge) as first:
        runner.run()

    def reverting(self, start, h, state, count):
        chunk = steps(self, start, h, state, count)
        with suppress(StepTooLarge):
            steps(self, start + len(chunk.codes) * h, h, chunk.states[-1], 1)
        self.forget()
        return chunk

    monkeypatch.setattr(RigidBodyRun, "steps", reverting)
    with pytest.raises(StepTooLarge) as second:
        runner.run()
    assert str(second.value) == str(first.value)


@pytest.mark.parametrize(("mass", "height"), [(500, 0.0231), (5000, 0.0231), (50000, 0.026)])
def test_a_load_that_jerks_a_bridge_taut_is_carried(mass, height):
    # Torn through, or ended, where arms turned as in the step before. Steps of 1e-3 split for loads
    # of 50000, heavier by up to 2e-3, end between 0.0226 and 0.0294.
    text = bridge(mass, 1e-3).replace("outputs: {", "outputs: {first: {value: energy, at: start}, ")
    outputs = Runner(interpret(read_text(text))).run().outputs
    assert outputs["y"] == pytest.approx(height, abs=5e-4 if mass < 5e4 else 4e-3)
    assert outputs["most"] < 1.005 * outputs["first"]


def test_short_steps_of_a_heavy_load_on_a_bridge_agree():
    """Steps of 1e-4, and loads heavier by up to 2e-3, end at 0.0522, too."""
    outputs = Runner(interpret(read_text(bridge(50000, 2.5e-4)))).run().outputs
    assert outputs["y"] == pytest.approx(0.0522, abs=1e-4)


def test_checks_of_forces_have_room_for_all_contacts(monkeypatch):
    """A disc under 60 ceilings: steps enlarge both arrays, and write up to the workspace's size."""
    take, rooms = RigidBodyRun._accepted_steps, []

    def noting(self, *arguments):
        rooms.append((len(self._warm.keys), len(self._workspace.known)))
        return take(self, *arguments)

    monkeypatch.setattr(RigidBodyRun, "_accepted_steps", noting)
    lids = [f"lid{k}" for k in range(60)]
    lines = ", ".join(f"{lid}: {{line: [[1, 2], [0, 2]]}}" for lid in lids)
    text = f"""
kind: scene
name: press
gravity: 1
bodies: {{disc: {{mass: 1, inertia: 1, start: {{y: 1}}, shape: {{disc: 1}}}}}}
surfaces: {{{lines}, ground: {{height: 0}}}}
forces: {{spring: {{body: disc, force: [0, 1e5*(1 - disc.y)]}}}}
collisions:
  all: {{bodies: [disc], surfaces: [{", ".join(lids)}, ground], friction: 0, restitution: 0}}
stop: {{time: 6}}
settings: {{engine: impulse, step: 1e-2}}
"""
    Runner(interpret(read_text(text))).run()
    assert all(warm == workspace for warm, workspace in rooms)
    assert rooms[0] != rooms[-1]
