"""Declarations as people write them first: no modes without friction, a step as a fraction."""

from __future__ import annotations

import math

import pytest

from contacts import Scene
from statechart.documents.yaml_reader import read_text
from statechart.errors import EventLoop
from statechart.running.runner import Runner

PUCK = """\
kind: scene
name: puck
gravity: 9.81
bodies: {puck: {mass: 1, start: {y: 1, dx: 2}}}
surfaces: {ice: {height: 0}}
contacts: {rim: {point: {body: puck}, surface: ice, friction: 0, restitution: 0%s}}
settings: {engine: impulse, step: %s}
stop: {time: 1}
"""


def puck(modes: str = "", step: str = "0.01") -> Scene:
    return Scene.model_validate(read_text(PUCK % (modes, step)).data)


def test_a_contact_without_friction_needs_no_modes() -> None:
    free, listed = puck(), puck(", modes: [free, slide]")
    assert free.contacts["rim"].kinds == listed.contacts["rim"].kinds == {"free", "slide"}
    found, expected = (Runner(scene).run() for scene in (free, listed))
    assert [jump.target for jump in found.trace.jumps] == [("slide",)]
    assert found.trace.jumps[0].after.tolist() == expected.trace.jumps[0].after.tolist()
    with pytest.raises(ValueError, match="a frictionless contact has no pin"):
        puck(", modes: [free, slide, pin]")


def test_a_friction_set_later_restores_the_mode_pin() -> None:
    contact = puck().contacts["rim"].model_copy(update={"friction": 0.5})
    assert contact.kinds == {"free", "slide", "pin"}
    assert "modes" not in str(puck())


@pytest.mark.parametrize(("written", "step"), [("1/60", 1 / 60), ("2e-3", 2e-3)])
def test_a_step_is_a_formula_of_numbers(written: str, step: float) -> None:
    scene = puck(step=written)
    assert scene.settings.step == step
    assert Scene.model_validate(read_text(str(scene)).data) == scene


BALL = """\
kind: scene
name: n
gravity: 9.81
bodies: {ball: {mass: 1, inertia: 0.004, start: {y: Y, dx: 1}}}
surfaces: {floor: {height: 0}}
stop: {time: 1}
"""


def test_forces_that_use_contact_forces_are_advised_the_matching_law() -> None:
    rim = "contacts: {rim: {point: {body: ball}, radius: 0.1, surface: floor, modes: [pin]}}"
    force = "forces: {f: {body: ball, force: [0, 0], moment: -0.01*%s*sign(ball.dangle)}}"
    for quantity, advice in (("V", "rolling_resistance: LENGTH"), ("gap", "stiffness and damping")):
        text = f"{BALL.replace('Y', '0.1')}{rim}\n{force % f'rim.{quantity}'}\n"
        with pytest.raises(ValueError, match=f"'rim.{quantity}': .*{advice} of 'rim'"):
            Scene.model_validate(read_text(text).data)


@pytest.mark.parametrize(
    "part",
    [
        "forces: {f: {body: ball, force: [0, 0], moment: -0.1*abs(hook.X)}}",
        "couplings: {f: {joint: hook, limit: 0.1*abs(hook.X)}}",
    ],
)
def test_forces_that_use_joint_forces_are_advised_a_coupling_with_a_limit(part: str) -> None:
    hook = "joints: {hook: {point: {body: ball, at: [0, 1]}, to: [0, 1]}}"
    text = f"{BALL.replace('Y', '0')}{hook}\n{part}\n"
    with pytest.raises(ValueError, match=r"'hook.X': .*forces; .*\{joint: JOINT, limit: F\}"):
        Scene.model_validate(read_text(text).data)


PUSHED = """\
controls: {push: 0}
forces: {gap: {body: ball, force: [0, push]}}
regions:
  gap:
    initial: apart
    states: {apart: {}, pressed: {sets: {push: -1e3*ball.y - 20*ball.dy}}}
    transitions:
      - {name: touch, from: apart, to: pressed, guard: ball.y <= 0}
      - {name: part, from: pressed, to: apart, guard: -1e3*ball.y - 20*ball.dy <= 0}
"""


def test_guards_that_hold_together_without_end_are_named() -> None:
    scene = Scene.model_validate(read_text(f"{BALL.replace('Y', '0.5')}{PUSHED}").data)
    with pytest.raises(
        EventLoop, match=r"part \(.*\) and touch \(ball.y <= 0\) hold at once; leave"
    ):
        Runner(scene).run()
    further = PUSHED.replace("ball.y <= 0}", "[ball.y <= 0, -1e3*ball.y - 20*ball.dy > 0]}")
    scene = Scene.model_validate(read_text(f"{BALL.replace('Y', '0.5')}{further}").data)
    assert [jump.cause for jump in Runner(scene).run().trace.jumps][:2] == ["touch", "part"]


DRAGGED = """\
controls: {mu: 0.9}
contacts: {base: {point: {body: ball}, surface: floor, modes: [slide, pin], friction: %s}}
forces: {spring: {body: ball, force: [50*(0.1*time - ball.x), 0]}}
regions:
  law:
    initial: stuck
    states: {stuck: {sets: {mu: 0.9}}, moving: {sets: {mu: 0.2}}}
    transitions:
      - {name: breaks, from: stuck, to: moving, on: base.slip}
      - {name: holds, from: moving, to: stuck, on: base.stick}
"""


def test_static_friction_by_a_controller_is_warned_of() -> None:
    text = BALL.replace("Y, dx: 1", "0").replace("time: 1", "time: 5.5")
    runner = Runner(Scene.model_validate(read_text(text + DRAGGED % "mu").data))
    assert any("write friction: {static: S, kinetic: K}" in w for w in runner.run().trace.warnings)
    both = text + DRAGGED % "{static: mu, kinetic: mu/2}"
    warnings = Runner(Scene.model_validate(read_text(both).data)).run().trace.warnings
    assert not any("write friction" in warning for warning in warnings)
    law = "{static: 0.9, kinetic: 0.2}"
    scene = Scene.model_validate(read_text(text + DRAGGED % law).data)
    trace = Runner(scene).run().trace
    slips = [jump.t for jump in trace.jumps if jump.cause == "slip"]
    # It stops where the spring pushes by (2 k - s) m g, and holds until that is s m g.
    weight = 9.81 / 5
    stop = 0.9 * weight + math.pi / math.sqrt(50)
    assert not any("static" in warning for warning in trace.warnings)
    assert slips == pytest.approx([0.9 * weight, 4.9859], abs=1e-3)
    assert stop < slips[1]
