"""Bodies that collide run without an engine or a step being named."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from contacts.rigid_bodies.default_step import inscribed_radius
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.running.runner import Runner

DISCS = """\
kind: scene
name: discs
gravity: 9.81
parameters: {scale: 1}
bodies:
  disc:
    mass: 1
    inertia: 0.005*scale**2
    shape: {disc: 0.1*scale}
    copies: 2
    start: {x: 0.05*index*scale, y: (0.15 + 0.25*index)*scale}
surfaces:
  floor: {height: 0}
collisions:
  all: {bodies: [disc], surfaces: [floor], friction: 0.5, restitution: 0.3}
stop: {time: 0.3}
"""


def test_the_default_step_of_colliding_bodies_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "discs.yaml"
    path.write_text(DISCS)
    assert main(["run", str(path), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["engine"] == "impulse"
    assert shown["outcome"] == "HORIZON"
    (said,) = [w for w in shown["warnings"] if "; step " in w]
    assert f"{shown['step']:g}" in said
    for verb in (["validate", str(path)], ["check", str(path), "--examples", "2", "--seed", "1"]):
        assert main(verb) == 0, verb


def test_default_step_follows_the_scales_unless_set():
    own = Runner(read_text(DISCS)).setting.step
    # Falling takes twice the time at four times the size.
    larger = Runner(read_text(DISCS.replace("{scale: 1}", "{scale: 4}"))).setting.step
    assert larger == pytest.approx(2.0 * own, rel=0.3)
    assert Runner(read_text(DISCS), engine="auto", step=1e-4).setting.step == 1e-4
    assert not Runner(read_text(DISCS), engine="impulse", step=1e-3).run(until=0.0).warnings


@pytest.mark.parametrize("far", [1e3, 1e6])
def test_the_default_step_is_as_long_far_from_the_origin(far):
    own = Runner(read_text(DISCS)).setting.step
    text = DISCS.replace("height: 0", f"height: {far}").replace("{x: ", f"{{x: {far} + ")
    text = text.replace(", y: ", f", y: {far} + ")
    assert own / 4 <= Runner(read_text(text)).setting.step <= own


def test_engines_with_events_still_refuse_colliding_bodies():
    with pytest.raises(DeclarationError):
        Runner(read_text(DISCS), engine="impulse")
    with pytest.raises(DeclarationError, match="the engine taylor cannot run bodies that collide"):
        Runner(read_text(DISCS), engine="taylor").run()


def tooth(k: int) -> str:
    """Return the corners of a tooth of the wheel, an eighth of a turn after the last."""
    c, s = math.cos(k * math.pi / 4), math.sin(k * math.pi / 4)
    ends = ((0.095, 0.0), (0.12, 0.0), (0.1 * math.cos(0.7069), 0.1 * math.sin(0.7069)))
    return str([[c * x - s * y, s * x + c * y] for x, y in ends])


TEETH = "".join(f"      - {{polygon: {tooth(k)}}}\n" for k in range(8))
RATCHET = f"""\
kind: scene
name: ratchet
parameters: {{T: 0.3, k: 0.2}}
bodies:
  wheel:
    mass: 1
    inertia: 0.005
    shape:
      - {{disc: 0.1}}
{TEETH}  pawl:
    mass: 0.05
    inertia: 1e-4
    shape: {{polygon: [[-0.04, -0.004], [0.04, -0.004], [0.04, 0.004], [-0.04, 0.004]]}}
    start: {{x: 0.17 - 0.04*cos(0.2), y: 0.06 + 0.04*sin(0.2), angle: -0.2}}
joints:
  axle: {{point: {{body: wheel}}, to: [0, 0]}}
  pin: {{point: {{body: pawl, at: [0.04, 0]}}, to: [0.17, 0.06]}}
collisions:
  all: {{bodies: [wheel, pawl], friction: 0.2, restitution: 0}}
controls: {{drive: 0}}
forces:
  motor: {{body: wheel, moment: drive - 0.01*wheel.dangle}}
  spring: {{body: pawl, moment: -k*(pawl.angle - 0.5) - 0.001*pawl.dangle}}
regions:
  hand:
    initial: forth
    states: {{forth: {{sets: {{drive: T}}}}, back: {{sets: {{drive: -T}}}}}}
    transitions: [{{name: turn, from: forth, to: back, after: 1.5}}]
stop: {{time: 3}}
outputs:
  at_turn: {{value: wheel.angle, at: first turn}}
  at_end: {{value: wheel.angle}}
"""


def test_a_pawl_holds_at_the_step_of_the_run_and_sinks_with_a_warning_at_long_ones():
    result = Runner(read_text(RATCHET)).run()
    assert result.outputs["at_end"] == pytest.approx(19.54, abs=0.01)
    assert not any("inner radius" in warning for warning in result.warnings)
    long = Runner(read_text(RATCHET), engine="impulse", step=2e-3).run()
    (said,) = [warning for warning in long.warnings if "inner radius" in warning]
    assert "'pawl'" in said
    assert "'wheel'" in said
    assert "of inner radius 0.004" in said


DICE = """\
kind: scene
name: dice
gravity: 9.81
bodies:
  die:
    mass: 0.01
    inertia: 4e-7
    shape: {polygon: [[-8e-3, -8e-3], [8e-3, -8e-3], [8e-3, 8e-3], [-8e-3, 8e-3]]}
    copies: 5
    start: {y: 0.1 + 0.1*index, angle: index, dangle: 30}
surfaces: {floor: {height: 0}}
collisions: {dice: {bodies: [die], surfaces: [floor], friction: 0.3, restitution: 0.4}}
settings: {engine: impulse, step: 1/60}
stop: {time: 1}
"""


@pytest.mark.parametrize("copies", [3, 5, 8])
def test_all_warnings_of_long_steps_name_one_step(copies):
    """They name the shortest that one of them needs; steps half as long leave no warning.

    Dice at other steps fall otherwise, so that the step itself may be too long for their way.
    """
    text = DICE.replace("copies: 5", f"copies: {copies}")
    warnings = Runner(read_text(text)).run().warnings
    too_long = [warning for warning in warnings if "; take steps of" in warning]
    assert len(too_long) >= 2
    (advice,) = {warning.rsplit("; ", 1)[1] for warning in too_long}
    shorter = 0.5 * float(advice.split()[3])
    found = Runner(read_text(text), step=shorter).run()
    assert not any("; take steps of" in warning for warning in found.warnings)


THRUST = """\
kind: scene
name: thrust
bodies: {b: {mass: 2, inertia: 1, shape: {disc: 0.1}}}
surfaces: {floor: {height: -9}}
collisions: {all: {bodies: [b], surfaces: [floor], friction: 0, restitution: 0}}
forces: {f: {body: b, FORCE}}
stop: {time: 4}
"""


@pytest.mark.parametrize(
    ("force", "speed"),
    [
        ("moment: 50", 50 * 4 * 0.1),
        ("moment: 50 - 2*b.dangle", 50 / 2 * 0.1),
        ("moment: 50 - 400*b.angle", 50 / 20 * 0.1),
        ("moment: 50*sin(pi*time/4)", 50 * 4 * 0.1),
    ],
)
def test_the_chosen_step_follows_the_speed_that_forces_reach(force, speed):
    step = Runner(read_text(THRUST.replace("FORCE", force))).setting.step
    assert step == pytest.approx(0.1 * 0.1 / max(speed, 1.0), rel=0.1)


@pytest.mark.parametrize(
    ("corners", "radius"),
    [
        ([[-2, -1], [2, -1], [2, 1], [-2, 1]], 1),
        ([[0, 0], [4, 0], [0, 3]], 1),
        ([[5, 5], [5.02, 5], [5.02, 9], [5, 9]], 0.01),
        ([[math.cos(k), math.sin(k)] for k in np.arange(12) * math.pi / 6], math.cos(math.pi / 12)),
    ],
)
def test_the_largest_circle_in_a_polygon_touches_three_edges(corners, radius):
    assert inscribed_radius(np.array(corners, dtype=float)) == pytest.approx(radius, rel=1e-9)


SOFT = """
kind: scene
name: soft_ball
gravity: 9.81
bodies:
  ball: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {y: 0.3}}
  other: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {x: 1, y: 0.3}}
  grain: {mass: 1e-3, inertia: 5e-6, shape: {disc: 0.1}, start: {x: 2, y: 0.3}}
surfaces: {floor: {height: 0}}
collisions:
  soft: {bodies: SOFT, surfaces: [floor], friction: 0, stiffness: 1e5, damping: 0}
  hard: {bodies: [grain], surfaces: [floor], friction: 0, restitution: 0}
stop: {time: 0.35}
"""


@pytest.mark.parametrize(("soft", "step"), [("[ball]", 3e-4), ("[ball, other]", 2e-4)])
def test_the_default_step_is_a_tenth_of_the_time_of_a_compliant_pair(soft, step):
    # sqrt(m/k) is 3.16e-3 s on the floor, 2.24e-3 s between two balls.
    assert Runner(read_text(SOFT.replace("SOFT", soft))).setting.step == step


JOINTED = """
kind: scene
name: far_pendulum
parameters: {X: 0}
gravity: 9.81
bodies:
  bob: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {x: X + 0.8, y: X}}
  puck: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {x: X + 2, y: X}}
joints: {pin: {point: {body: bob, at: [-0.5, 0]}, to: ["X + 0.3", "X"]}}
collisions: {all: {bodies: [bob, puck], friction: 0, restitution: 0}}
stop: {time: 0.1}
outputs: {turned: {value: bob.angle}}
"""


def test_a_joint_far_from_the_origin_holds_at_the_start():
    near, far = (Runner(read_text(JOINTED)).run({"X": x}).outputs["turned"] for x in (0, 1e6))
    assert near < -0.05
    assert far == pytest.approx(near, rel=1e-4)


def test_the_default_step_resolves_a_bounce_on_a_compliant_contact():
    text = SOFT.replace("SOFT", "[ball]")
    # It falls by 0.2 m, returns from a half period of the spring, and rises.
    speed, w = math.sqrt(2 * 9.81 * 0.2), math.sqrt(1e5)
    contact = 2 * (math.pi - math.atan(speed * w / 9.81)) / w
    flight = 0.35 - speed / 9.81 - contact
    height = 0.1 + speed * flight - 9.81 * flight**2 / 2
    result = Runner(read_text(text)).run()
    assert result.at(0.35).values["ball.y"] == pytest.approx(height, abs=3e-3)
