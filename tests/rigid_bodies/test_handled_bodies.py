"""Bodies that are gripped, cracked, pulled and thrown, beside answers worked out by hand."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import solve_ivp

from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.testing.body_properties import assert_depths
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81


def run(text, **values):
    result = Runner(interpret(read_text(text))).run(values)
    assert result.trace.outcome is Outcome.HORIZON, result.trace.message
    return result


GRIPPER = """
kind: scene
name: gripper
parameters: {mu: 0.4, grip: 20, w: 0.05, m: 1, v: 0.2, d: 40, h: 0.06}
gravity: 9.81
bodies:
  left:
    mass: 0.2
    inertia: 0.001
    shape: {polygon: [[-0.02, -h], [0.02, -h], [0.02, h], [-0.02, h]]}
    start: {x: -0.1, y: 0.08}
  right:
    mass: 0.2
    inertia: 0.001
    shape: {polygon: [[-0.02, -h], [0.02, -h], [0.02, h], [-0.02, h]]}
    start: {x: 0.1, y: 0.08}
  box:
    mass: m
    inertia: 2*m*w**2/3
    shape: {polygon: [[-w, -w], [w, -w], [w, w], [-w, w]]}
    start: {y: w}
surfaces: {ground: {height: 0}}
collisions:
  hand: {bodies: [left, right, box], friction: mu, restitution: 0}
  floor: {bodies: [box], surfaces: [ground], friction: 0.5, restitution: 0}
joints:
  left_one: {point: {body: left, at: [-0.02, 0]}, to: {y: 0.08 + lift}}
  left_two: {point: {body: left, at: [0.02, 0]}, to: {y: 0.08 + lift}}
  right_one: {point: {body: right, at: [-0.02, 0]}, to: {y: 0.08 + lift}}
  right_two: {point: {body: right, at: [0.02, 0]}, to: {y: 0.08 + lift}}
forces:
  left: {body: left, force: [grip - d*left.dx, 0]}
  right: {body: right, force: [-grip - d*right.dx, 0]}
regions:
  grasp:
    initial: closing
    variables: {lift: 0}
    states:
      closing: {}
      lifting: {flows: {lift: v}}
    transitions:
      - {name: raise, from: closing, to: lifting, after: 0.2}
stop: {time: 0.4}
outputs:
  raised: {value: box.y - w}
  slipped: {value: lift - (box.y - w)}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.mark.parametrize("step", [4e-3, 2e-3, 1e-3, 5e-4])
def test_jaws_lift_a_box_once_it_has_their_speed(step):
    result = run(GRIPPER.replace("step: 1e-3", f"step: {step}"))
    # Until then it slips, as both jaws pull it up with mu grip.
    slipped = 0.2**2 / (2 * (2 * 0.4 * 20 - G))
    assert result.outputs["slipped"] == pytest.approx(slipped, abs=2 * step * 0.2**2)
    jumps = result.trace.jumps
    raised = next(i for i, jump in enumerate(jumps) if jump.cause == "raise")
    # Contacts held by friction neither slip nor stick by the residual of iterated impulses.
    assert not {"slip", "stick"} & {jump.cause for jump in jumps[:raised]}
    last = [jump for jump in jumps if jump.cause == "stick"]
    assert [jump.t for jump in last] == pytest.approx(
        [0.2 + 0.2 / (2 * 0.4 * 20 - G)] * len(last), abs=3 * step
    )


def test_jaws_cannot_lift_a_too_heavy_box():
    threshold = G / (2 * 20)
    assert run(GRIPPER, mu=0.995 * threshold).outputs["raised"] == pytest.approx(0.0, abs=1e-9)
    pull = 2 * 1.05 * threshold * 20 - G
    raised = run(GRIPPER, mu=1.05 * threshold).outputs["raised"]
    assert raised == pytest.approx(pull * 0.2**2 / 2, rel=0.02)


NUT = """
kind: scene
name: nut
parameters: {mu: 0.4, half: 0.35, r: 0.02, l: 0.2, t: 0.01, ma: 0.1, m: 0.05, M: 2, x: r/sin(half)}
bodies:
  upper:
    mass: ma
    inertia: ma*l**2/12
    shape: {polygon: [[-0.4*l, 0], [l/2, 0], [l/2, t], [-0.4*l, t]]}
    start: {x: l/2*cos(half), y: l/2*sin(half), angle: half}
  lower:
    mass: ma
    inertia: ma*l**2/12
    shape: {polygon: [[-0.4*l, -t], [l/2, -t], [l/2, 0], [-0.4*l, 0]]}
    start: {x: l/2*cos(half), y: -l/2*sin(half), angle: -half}
  nut: {mass: m, inertia: m*r**2/2, shape: {disc: r}, start: {x: x}}
joints:
  up: {point: {body: upper, at: [-l/2, 0]}, to: [0, 0]}
  low: {point: {body: lower, at: [-l/2, 0]}, to: [0, 0]}
forces:
  up: {body: upper, moment: -M}
  low: {body: lower, moment: M}
collisions: {all: {bodies: [upper, lower, nut], friction: mu, restitution: 0}}
stop: {time: 0.02}
outputs: {moved: {value: nut.x - x}, speed: {value: nut.dx}}
settings: {engine: impulse, step: 1e-4}
"""


def squeezed(mu, half=0.35, r=0.02, arm=0.1 * 0.2**2 / 3, m=0.05, moment=2.0):
    """Return how far arms have squeezed a nut out, and its speed: friction is against its way."""

    def rates(_, state):
        x, speed = state
        angle = math.asin(r / x)
        slope = -r / (x * math.sqrt(x * x - r * r))
        bend = r * (2 * x * x - r * r) / (x * x * (x * x - r * r) ** 1.5)
        pull = 2 * (math.sin(angle) - mu * math.cos(angle)) / m
        force = (moment + arm * bend * speed**2) / (x * math.cos(angle) - arm * slope * pull)
        return speed, pull * force

    start = r / math.sin(half)
    x, speed = solve_ivp(rates, (0, 0.02), (start, 0), rtol=1e-11, atol=1e-13).y[:, -1]
    return x - start, speed


def test_a_nut_is_cracked_within_the_angle_of_friction_and_squeezed_out_beyond():
    edge = math.tan(0.35)
    assert abs(run(NUT, mu=1.001 * edge).outputs["moved"]) < 1e-12
    assert run(NUT, mu=0.999 * edge).outputs["moved"] > 1e-6
    moved, speed = squeezed(0.3)
    errors = []
    for step in (4e-4, 2e-4, 1e-4):
        result = run(NUT.replace("step: 1e-4", f"step: {step}"), mu=0.3)
        assert result.outputs["speed"] == pytest.approx(speed, rel=1e-4)
        errors.append(abs(result.outputs["moved"] - moved))
    # Nothing strikes: of the second order.
    assert errors[2] < 0.3 * errors[1] < 0.09 * errors[0]


WHEEL = """
kind: scene
name: wheel
parameters: {R: 0.3, s: 0.1, m: 5, F: 40}
gravity: 9.81
bodies:
  wheel: {mass: m, inertia: m*R**2/2, shape: {disc: R}, start: {x: -sqrt(R**2 - (R - s)**2), y: R}}
surfaces:
  ground: {edge: [[-3, 0], [0, 0]]}
  face: {edge: [[0, 0], [0, s]]}
  top: {edge: [[0, s], [3, s]]}
forces: {rope: {body: wheel, force: [F, 0]}}
collisions: {all: {bodies: [wheel], surfaces: [ground, face, top], friction: 1, restitution: 0}}
stop: {time: 0.3}
outputs: {y: {value: wheel.y}}
settings: {engine: impulse, step: 1e-3}
"""


def test_wheel_climbs_a_step_above_the_threshold():
    edge = 5 * G * math.sqrt(0.3**2 - 0.2**2) / 0.2
    assert run(WHEEL, F=0.999 * edge).outputs["y"] == pytest.approx(0.3, abs=1e-12)
    assert run(WHEEL, F=1.001 * edge).outputs["y"] > 0.3 + 1e-5

    def rates(_, state):
        angle, rate = state
        return rate, (60 * math.cos(angle) + 5 * G * math.sin(angle)) / (1.5 * 5 * 0.3)

    angle = solve_ivp(rates, (0, 0.3), (-math.acos(2 / 3), 0), rtol=1e-11, atol=1e-12).y[0, -1]
    height = 0.1 + 0.3 * math.cos(angle)
    errors = [
        abs(run(WHEEL.replace("step: 1e-3", f"step: {step}"), F=60).outputs["y"] - height)
        for step in (4e-3, 2e-3, 1e-3)
    ]
    assert errors[2] < 0.3 * errors[1] < 0.09 * errors[0]
    assert errors[0] < 2e-6


@pytest.mark.parametrize(("text", "values"), [(NUT, {"mu": 0.3}), (WHEEL, {"F": 60})])
def test_penetration_of_a_turning_body_equals_the_reported_one(text, values):
    # Touching bodies approach only by rotation.
    model = interpret(read_text(text))
    trace = Runner(model).run(values).trace
    assert_depths(body_numbers(model, model.values(values)), trace)
    assert trace.tolerances["gap"] < 1e-6


def test_a_disc_next_to_the_end_of_a_plate_does_not_penetrate_it():
    # Its centre is on the line of the step's upper side.
    text = WHEEL.replace("{R: 0.3, s: 0.1", "{R: 0.1, s: 0.1")
    model = interpret(read_text(text))
    trace = Runner(model).run({"F": 0}).trace
    assert_depths(body_numbers(model, model.values({"F": 0})), trace)


WALLS = """
kind: scene
name: walls
parameters: {tt: 5.9, L: 1, V: 0.1, v: 1, r: 0.02, m: 0.1, e: 1}
bodies:
  ball: {mass: m, inertia: m*r**2/2, shape: {disc: r}, start: {x: r, dx: v}}
surfaces:
  left: {line: [[0, 1], [0, -1]]}
  right: {line: [[L + 2*r, -1], [L + 2*r, 1]], displacement: [-V*time, 0]}
collisions: {all: {bodies: [ball], surfaces: [left, right], friction: 0, restitution: e}}
stop: {time: tt}
outputs:
  times: {value: time, at: each ball.touchdown}
  speeds: {value: abs(ball.dx), at: each ball.touchdown}
settings: {engine: impulse, step: 1e-3}
"""


def test_a_ball_between_walls_that_near_each_other_is_as_fast_as_their_distance_allows():
    outputs = run(WALLS).outputs
    # The speed grows by 2 V at every second bounce; (v + V) L is invariant, L at that bounce.
    speed, width, instant = 1.0, 1.0, 0.0
    for k, (time, found) in enumerate(zip(outputs["times"], outputs["speeds"], strict=True)):
        if k % 2 == 0:
            instant += width / (speed + 0.1)
            width, speed = 1.0 - 0.1 * instant, speed + 0.2
            assert (speed - 0.1) * width == pytest.approx(1.0, rel=1e-12)
        else:
            instant += width / speed
            width = 1.0 - 0.1 * instant
        assert found == pytest.approx(speed, rel=1e-10)
        assert time == pytest.approx(instant, abs=(k + 1) * 1e-3)
    # The bounce k + 1 is at 6.
    assert k == 13


def test_closing_walls_around_a_ball_end_the_run():
    trace = Runner(interpret(read_text(WALLS))).run({"V": 0.1875, "e": 0}, throw=False).trace
    assert trace.outcome is Outcome.UNSOLVED_IMPULSES
    assert "ball cannot get out" in trace.message
    # The gap equals the diameter then; the ball may sink by its first approach in a step.
    assert 1 / 0.1875 < trace.t_end < 1 / 0.1875 + 0.02
