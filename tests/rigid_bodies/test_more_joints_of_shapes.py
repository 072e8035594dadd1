"""Welds, rods, ropes, limits and joints that let go between bodies with shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from contacts.testing.symmetry import rescaled
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81

ONE = """
kind: scene
name: one
parameters: {{m: 2, l: 1, e: 0, x: 0, y: 0, a: 0, v: 0, u: 0, w: 0}}
gravity: 9.81
bodies:
  bar:
    mass: m
    inertia: m*l**2/12
    shape: {{polygon: [[-l/2, -0.01], [l/2, -0.01], [l/2, 0.01], [-l/2, 0.01]]}}
    start: {{x: x, y: y, angle: a, dx: v, dy: u, dangle: w}}
joints:
  held: {joint}
collisions:
  all: {{bodies: [bar], friction: 0.5, restitution: 0}}
stop: {{time: {end}}}
settings: {{engine: impulse, step: 1e-3}}
outputs:
{outputs}
"""


def run(joint, outputs, end, parameters=None, **settings):
    text = ONE.format(
        joint=joint, end=end, outputs="\n".join(f"  {n}: {{{o}}}" for n, o in outputs.items())
    )
    return Runner(interpret(read_text(text)), **settings).run(parameters, throw=False)


def test_a_cantilever_bears_its_weight_by_a_couple():
    """The couple of a bar welded to a wall by its end is m g l/2."""
    outputs = run(
        "{point: {body: bar, at: [-l/2, 0]}, to: [-l/2, 0], angle: held}",
        {"M": "value: held.M", "Y": "value: held.Y", "angle": "value: bar.angle"},
        0.5,
    ).outputs
    assert outputs["M"] == pytest.approx(2 * G / 2, rel=1e-9)
    assert outputs["Y"] == pytest.approx(2 * G, rel=1e-9)
    assert outputs["angle"] == pytest.approx(0, abs=1e-12)


def test_welded_bodies_swing_as_one():
    """Two bars end to end on a pivot: a bar of twice the length, from a small angle."""
    text = """
kind: scene
name: welded
parameters: {l: 0.5, a: 0.05}
gravity: 9.81
bodies:
  up: {mass: 1, inertia: l**2/12,
    shape: {polygon: [[-0.01, -l/2], [0.01, -l/2], [0.01, l/2], [-0.01, l/2]]},
    start: {x: l/2*sin(a), y: -l/2*cos(a), angle: a}}
  low: {mass: 1, inertia: l**2/12,
    shape: {polygon: [[-0.01, -l/2], [0.01, -l/2], [0.01, l/2], [-0.01, l/2]]},
    start: {x: 1.5*l*sin(a), y: -1.5*l*cos(a), angle: a}}
joints:
  pivot: {point: {body: up, at: [0, l/2]}, to: [0, 0]}
  weld: {point: {body: low, at: [0, l/2]}, to: {body: up, at: [0, -l/2]}, angle: held}
collisions: {all: {bodies: [up, low], friction: 0, restitution: 0}}
stop: {time: 3}
settings: {engine: impulse, step: 1e-3}
outputs:
  bent: {maximum: abs(low.angle - up.angle)}
  swings: {value: time, at: first up.angle < -0.05}
  angle: {value: up.angle}
"""
    text = text.replace("  swings: {value: time, at: first up.angle < -0.05}\n", "")
    outputs = Runner(interpret(read_text(text))).run().outputs
    period = 2 * math.pi * math.sqrt(2 / 3 * 1.0 / G) * 2 / math.pi * ellipk(math.sin(0.025) ** 2)
    assert outputs["bent"] < 1e-9
    assert outputs["angle"] == pytest.approx(0.05 * math.cos(2 * math.pi * 3 / period), abs=1e-4)


def test_taut_rope_removes_the_velocity_along_it():
    """Falls 0.8 beside its pivot: then as a pendulum with the velocity across the rope."""
    fallen = math.sqrt(2 * G * 0.8)
    lowest = math.sqrt((0.6 * fallen) ** 2 + 2 * G * 0.2)
    for step in (2e-3, 5e-4):
        result = run(
            "{point: {body: bar}, to: [0, 0], rope: 1}",
            {
                "fast": "maximum: 'hypot(bar.dx, bar.dy)'",
                "far": "maximum: 'hypot(bar.x, bar.y)'",
                "speed": "maximum: -bar.dx",
            },
            1.0,
            {"x": 0.6},
            step=step,
        )
        assert result.outputs["fast"] == pytest.approx(max(fallen, lowest), rel=5 * step)
        assert result.outputs["speed"] == pytest.approx(lowest, rel=10 * step)
        assert result.outputs["far"] == pytest.approx(1, abs=4 * step)


@pytest.mark.parametrize("step", [4e-3, 3e-3, 2e-3, 1.5e-3, 1e-3])
def test_a_rope_that_becomes_taut_pulls_at_once(step):
    """It has no slack left: the weight circles on, and its tension is m (v^2/l + g cos)."""
    taut = math.sqrt(1.6 / G)
    angle, speed = math.atan2(0.6, 0.8), 0.6 * math.sqrt(1.6 * G)
    swing = solve_ivp(
        lambda t, q: (q[1], -G * math.sin(q[0])), (0.0, 0.05), (angle, -speed), rtol=1e-10
    )
    a, w = swing.y[:, -1]
    outputs = run(
        "{point: {body: bar}, to: [0, 0], rope: 1}",
        {"V": "value: held.V", "out": "value: (bar.x*bar.dx + bar.y*bar.dy)", "x": "value: bar.x"},
        taut + 0.05,
        {"x": 0.6},
        step=step,
    ).outputs
    assert outputs["V"] == pytest.approx(2 * (w**2 + G * math.cos(a)), rel=20 * step)
    assert outputs["out"] == pytest.approx(0, abs=2 * step)
    assert outputs["x"] == pytest.approx(math.sin(a), abs=2 * step)


@pytest.mark.parametrize("e", [0, 0.5])
def test_motion_alone_loads_a_rope(e):
    """Around the whole circle: V = m (v^2/l - 2 g (1 + y) - g y), to second order in the step."""
    errors = []
    for step in (4e-3, 2e-3):
        outputs = run(
            f"{{point: {{body: bar}}, to: [0, 0], rope: 1, restitution: {e}}}",
            {
                "start": "value: held.V, at: start",
                "least": "minimum: held.V",
                "most": "maximum: held.V",
                "far": "maximum: bar.x**2 + bar.y**2",
            },
            4.0,
            {"y": -1, "v": 8},
            step=step,
        ).outputs
        errors.append([outputs["start"] - 2 * (64 + G), outputs["least"] - 2 * (64 - 5 * G)])
        assert outputs["most"] == pytest.approx(2 * (64 + G), rel=30 * step**2)
        # Half a step along the tangent, beyond the circle.
        assert 1.0 < outputs["far"] < 1.0 + (8 * step) ** 2 / 4
    assert np.abs(errors[1]).max() < 0.05
    assert np.array(errors[0]) / errors[1] == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize("step", [4e-3, 1e-3])
def test_a_rope_that_motion_loads_goes_slack(step):
    """It does at 3 g y = v^2 - 2 g; the parabola meets the circle at the tripled angle from the
    vertical, on the other side."""
    y = (36 - 2 * G) / (3 * G)
    away, speed = math.acos(y), math.sqrt(G * y)
    late = 4 * math.sin(away) * speed / G
    outputs = run(
        "{point: {body: bar}, to: [0, 0], rope: 1}",
        {
            "apex": "maximum: bar.y",
            "least": "minimum: held.V",
            "taut": "value: bar.x",
        },
        _time_on_circle(6, y) + late,
        {"y": -1, "v": 6},
        step=step,
    ).outputs
    assert outputs["least"] == 0
    assert outputs["apex"] == pytest.approx(y + (speed * math.sin(away)) ** 2 / (2 * G), abs=step)
    assert outputs["taut"] == pytest.approx(-math.sin(3 * away), abs=6 * step)


def _time_on_circle(speed, height):
    """Return the time from the bottom of a circle of radius 1 up to a height."""
    return solve_ivp(
        lambda t, q: (q[1], -G * math.sin(q[0])),
        (0.0, 5.0),
        (0.0, speed),
        events=[_reaches(height)],
        rtol=1e-10,
    ).t[-1]


def _reaches(height):
    def event(t, q):
        return -math.cos(q[0]) - height

    event.terminal = True
    return event


def test_a_hanging_rope_bears_the_weight():
    outputs = run(
        "{point: {body: bar}, to: [0, 0], rope: 1}", {"V": "value: held.V"}, 0.2, {"y": -1}
    ).outputs
    assert outputs["V"] == pytest.approx(2 * G, rel=1e-9)


def test_a_rope_rebounds_by_its_restitution():
    fallen = math.sqrt(2 * G)
    outputs = run(
        "{point: {body: bar}, to: [0, 0], rope: 1, restitution: 0.5}",
        {"up": "maximum: bar.dy"},
        0.6,
        step=2e-4,
    ).outputs
    assert outputs["up"] == pytest.approx(0.5 * fallen, rel=2e-3)


def test_discs_on_one_rope_collide():
    """The rope takes half of 2 m/s after 0.35 s, and the discs meet 0.8 further on at 1.15 s."""
    text = """
kind: scene
name: leash
bodies:
  a: {mass: 1, inertia: 0.01, shape: {disc: 0.1}}
  b: {mass: 3, inertia: 0.03, shape: {disc: 0.1}, start: {x: 0.3, dx: 2}}
joints: {rope: {point: {body: a}, to: {body: b}, rope: 1, restitution: 0.5}}
collisions: {all: {bodies: [a, b], friction: 0, restitution: 0.8}}
stop: {time: 2.5}
settings: {engine: impulse, step: 1e-3}
outputs: {met: {value: time, at: first a.touchdown}, rate: {value: b.dx - a.dx}}
"""
    outputs = Runner(interpret(read_text(text))).run().outputs
    assert outputs["met"] == pytest.approx(1.15, abs=2e-3)
    # It was -1 before the discs met, 0.8 until the rope was taut again, and -0.4 then.
    assert outputs["rate"] == pytest.approx(-0.4, rel=1e-9)


HELD = """
kind: scene
name: held
parameters: {T: 0.4}
gravity: 10
bodies:
  arm:
    mass: 1
    inertia: 0.01
    shape: {disc: 0.05}
    start: {x: 0.1, y: 1.2, angle: 0.3, dx: 0.5, dy: 1}
  box:
    mass: 2
    inertia: 0.01
    shape: {polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}
    start: {y: 1, angle: 0.1, dx: 0.5, dy: 1}
  ball: {mass: 1, inertia: 0.01, shape: {disc: 0.05}, start: {x: 3, y: 5}}
joints:
  lead: {point: {body: arm}, to: ["0.1 + 0.5*time", "1.2 + time"], angle: held}
  cup:
    point: {body: box, at: [0, 0.1]}
    to: {body: arm}
    angle: held
    rest: captured
    enabled: time <= T
  hook: {point: {body: ball}, to: [2, 2], rest: captured, enabled: time <= 0.2}
collisions: {all: {bodies: [arm, box, ball], friction: 0.5, restitution: 0}}
stop: {time: 0.8}
settings: {engine: impulse, step: 1e-3}
outputs: {x: {value: box.x}, y: {value: box.y}, angle: {value: box.angle}, ball: {value: ball.y}}
"""


def test_joints_that_start_closed_capture_the_pose_of_the_start():
    outputs = Runner(interpret(read_text(HELD))).run().outputs
    # The box rises at 1 for 0.4 s, and flies from there; the ball falls from 0.2 s on.
    expected = {"x": 0.4, "y": 1.0 + 0.8 - 5.0 * 0.4**2, "angle": 0.1, "ball": 5.0 - 5.0 * 0.6**2}
    assert outputs == pytest.approx(expected, abs=2e-5)


def test_a_joint_that_only_the_declared_parameters_close_names_them():
    scene = interpret(read_text(HELD.replace("dx: 0.5, dy: 1}\n  ball", "dx: 0.4, dy: 1}\n  ball")))
    with pytest.raises(DeclarationError, match="does not hold at the start"):
        Runner(scene).run()
    with pytest.raises(DeclarationError, match="the declared parameters close joint 'cup'"):
        Runner(scene).run({"T": -1})


def test_a_rod_is_a_pendulum():
    """From the horizontal: sqrt(2 g) at the lowest point, after K(1/2)/sqrt(g) = 0.59196 s."""
    quarter = float(ellipk(0.5)) / math.sqrt(G)
    for step in (2e-3, 5e-4):
        outputs = run(
            "{point: {body: bar}, to: [0, 0], rod: 1}",
            {
                "speed": "maximum: 'hypot(bar.dx, bar.dy)'",
                "far": "maximum: 'abs(hypot(bar.x, bar.y) - 1)'",
                "T": "maximum: held.T",
                "x": "value: bar.x",
            },
            0.592,
            {"x": 1},
            step=step,
        ).outputs
        assert outputs["speed"] == pytest.approx(math.sqrt(2 * G), rel=2 * step)
        assert outputs["T"] == pytest.approx(3 * 2 * G, rel=5 * step)
        assert outputs["far"] < 4 * step
        assert outputs["x"] == pytest.approx((quarter - 0.592) * math.sqrt(2 * G), abs=step)


def test_a_rod_pendulum_keeps_its_energy():
    outputs = run(
        "{point: {body: bar}, to: [0, 0], rod: 1}",
        {"most": "maximum: energy", "least": "minimum: energy"},
        20,
        {"x": 1},
    ).outputs
    assert outputs["most"] - outputs["least"] < 0.02 * 2 * 2 * G


def test_a_bar_rebounds_at_its_limit():
    """A bar on a pivot at its end falls from the horizontal onto a stop 0.3 below."""
    omega = math.sqrt(3 * G * math.sin(0.3))
    result = run(
        "{point: {body: bar, at: [-l/2, 0]}, to: [0, 0], limits: [-0.3, 1], restitution: e}",
        {"down": "minimum: bar.dangle", "up": "maximum: bar.dangle", "least": "minimum: bar.angle"},
        0.4,
        {"x": 0.5, "e": 0.5},
        step=2e-4,
    ).outputs
    assert result["down"] == pytest.approx(-omega, rel=2e-3)
    assert result["up"] == pytest.approx(0.5 * omega, rel=4e-3)
    assert result["least"] == pytest.approx(-0.3, abs=1e-3)


def test_a_limit_bears_the_weight():
    outputs = run(
        "{point: {body: bar, at: [-l/2, 0]}, to: [0, 0], limits: [0, 1]}",
        {"M": "value: held.M", "angle": "value: bar.angle"},
        0.3,
        {"x": 0.5},
    ).outputs
    assert outputs["M"] == pytest.approx(2 * G / 2, rel=1e-9)
    assert outputs["angle"] == pytest.approx(0, abs=1e-9)


def test_a_bar_in_flight_is_caught_by_its_end():
    """The angular momentum about the hook stays: m v l/2 = m l^2/3 w."""
    for step in (2e-3, 5e-4):
        outputs = run(
            "{point: {body: bar, at: [0, 0.25]}, to: [0, 0], rest: captured, enabled: time >= 0.1}",
            {"spin": "value: bar.dangle", "events": "count: held.enable"},
            0.105,
            {"v": 3},
            step=step,
        ).outputs
        inertia = 1 / 12 + 0.25**2
        assert outputs["spin"] == pytest.approx(3 * 0.25 / inertia, rel=40 * step)
        assert outputs["events"] == 1


def test_opening_joint_throws_its_body():
    """A bar spins about a pivot at its end, and flies on with the velocity of its middle."""
    result = run(
        "{point: {body: bar, at: [-l/2, 0]}, to: [0, 0], enabled: time < 0.2}",
        {"gone": "value: time, at: first held.disable", "vx": "value: bar.dx"},
        0.4,
        {"x": 0.5, "w": 3, "u": 1.5},
    )
    trace = result.trace
    free = trace.arcs[-1].states(np.array([0.0, 0.1]))
    assert result.outputs["gone"] == pytest.approx(0.2, abs=2e-3)
    assert free[1, 3] == pytest.approx(free[0, 3], abs=1e-9)
    assert free[1, 4] - free[0, 4] == pytest.approx(-G * 0.1, rel=1e-6)
    assert free[1, 5] == pytest.approx(free[0, 5], abs=1e-9)
    assert math.hypot(*free[0, 3:5]) == pytest.approx(0.5 * abs(free[0, 5]), rel=2e-2)


def test_a_joint_breaks_at_its_strength():
    """A bar on a pivot from the horizontal: at the angle b below it pulls by m g 5/2 sin b."""
    outputs = run(
        "{point: {body: bar, at: [-l/2, 0]}, to: [0, 0], enabled: abs(held.X) <= 10}",
        {"angle": "value: bar.angle, at: first held.disable"},
        1,
        {"x": 0.5},
        step=2e-4,
    ).outputs
    # X = m (l/2) (-w' sin b + w^2 cos b) with w' = 3 g cos b/(2 l), w^2 = 3 g sin b/l.
    b = -outputs["angle"]
    force = 2 * 0.5 * (1.5 * G * math.cos(b) * math.sin(b) + 3 * G * math.sin(b) * math.cos(b))
    assert force == pytest.approx(10, rel=5e-3)


def test_gripper_carries_a_box():
    text = """
kind: scene
name: gripper
gravity: 9.81
parameters: {b: 0.1}
bodies:
  arm: {mass: 1, inertia: 0.01, shape: {polygon: [[-b, 0], [b, 0], [b, b], [-b, b]]},
    start: {y: 0.4, dy: -0.2*pi}}
  box: {mass: 2, inertia: 0.01, shape: {polygon: [[-b, -b], [b, -b], [b, b], [-b, b]]},
    start: {x: 0.02, y: b}}
  lamp: {mass: 1, inertia: 0.001, shape: {disc: 0.05}, start: {x: 0.6, y: 1}}
surfaces: {floor: {height: 0}}
joints:
  cord: {point: {body: lamp}, to: [1, 1.3], rope: 0.5}
  lead: {point: {body: arm}, to: [0, "0.4 - 0.2*sin(pi*time)"], angle: held}
  suction:
    point: {body: box}
    to: {body: arm}
    angle: held
    rest: captured
    enabled: time >= 0.5 and time < 0.9
collisions:
  all: {bodies: [arm, box, lamp], surfaces: [floor], friction: 0.5, restitution: 0}
stop: {time: 1}
settings: {engine: impulse, step: 1e-3}
outputs:
  lifted: {maximum: box.y}
  force: {maximum: suction.Y}
  cord: {minimum: lamp.y}
"""
    result = Runner(interpret(read_text(text))).run()
    # A rope beside a joint that lets go.
    assert result.outputs["cord"] == pytest.approx(0.8, abs=1e-3)
    lifted = 0.1 + 0.2 * (1 - math.sin(0.9 * math.pi))
    assert result.outputs["lifted"] == pytest.approx(lifted, abs=2e-2)
    assert result.trace.outcome == Outcome.HORIZON


def test_a_joint_that_closed_rests_when_steps_up_to_a_transition_are_repeated():
    """Steps beyond the transition are reverted; the joint still rests where it closed."""
    text = """
kind: scene
name: caught
bodies: {box: {mass: 1, inertia: 0.01, shape: {disc: 0.05}, start: {x: 0.3, dx: 1}}}
collisions: {all: {bodies: [box], friction: 0, restitution: 0}}
joints:
  link: {point: {body: box}, to: {x: 0}, rest: captured, enabled: time >= 0.11}
regions:
  later:
    initial: a
    variables: {w: 0}
    states: {a: {flows: {w: 1}}, b: {}}
    transitions: [{name: go, from: a, to: b, guard: w >= 0.15}]
stop: {time: 0.2}
outputs: {x: {value: box.x}}
"""
    result = Runner(read_text(text), engine="impulse", step=1e-3).run()
    assert [jump.cause for jump in result.trace.jumps] == ["enable", "go"]
    assert result.outputs["x"] == pytest.approx(0.41, abs=1e-3)


def test_mistakes_are_reported():
    for joint, message in {
        "{point: {body: bar}, to: [0, 0], rope: 1}": "ends are 2 apart",
        "{point: {body: bar}, to: [0, 0], rod: 1}": "ends are 2 apart",
        "{point: {body: bar}, to: [0, 0], rope: 3, enabled: time < 1}": "is never off",
        "{point: {body: bar}, to: [2, 0], limits: [0.1, 1]}": "beyond its limit",
    }.items():
        with pytest.raises(DeclarationError, match=message):
            run(joint, {"y": "value: bar.y"}, 1, {"x": 2})


def test_points_that_do_not_meet_are_not_joined():
    result = run(
        "{point: {body: bar}, to: [0, 3], enabled: time >= 0.1}", {"y": "value: bar.y"}, 0.2
    )
    assert result.trace.outcome == Outcome.NO_CONSISTENT_MODE
    assert "rest: captured" in result.trace.message


CAUGHT = """
kind: scene
name: caught
gravity: 9.81
parameters: {{F: 1000}}
bodies: {{bob: {{mass: 1, inertia: 0.01, shape: {{disc: 0.05}}, start: {{dx: 1, dangle: 3}}}}}}
joints:
  j:
    point: {{body: bob, at: [0.1, 0]}}
    to: [0, 0]
    rest: captured
    enabled: time >= 0.2 and hypot(j.X, j.Y) <= F{keys}
collisions: {{all: {{bodies: [bob], friction: 0, restitution: 0}}}}
settings: {{engine: impulse, step: {step}}}
outputs:
  X: {{maximum: abs(j.X)}}
  Y: {{maximum: j.Y}}
  breaks: {{value: time, at: first j.disable}}
"""


@pytest.mark.parametrize("step", [2e-3, 5e-4])
def test_forces_of_a_joint_that_closes_contain_no_impulse(step):
    """A weld in mid-flight bears the weight alone, and holds if its strength is above it."""
    runner = Runner(interpret(read_text(CAUGHT.format(keys="\n    angle: held", step=step))))
    outputs = runner.run({"F": 9.9}, until=0.3).outputs
    assert outputs["breaks"] is None
    assert outputs["Y"] == pytest.approx(G, rel=1e-6)
    assert outputs["X"] == pytest.approx(0.0, abs=1e-6)
    assert runner.run({"F": 9.7}, until=0.3).outputs["breaks"] == pytest.approx(0.2, abs=step)


@pytest.mark.parametrize("step", [2e-3, 5e-4])
def test_a_hinge_that_closes_bears_the_centripetal_force(step):
    """The largest forces are those of the pendulum with the angular momentum about the hinge."""
    turned, falls, arm, inertia = 0.6, G * 0.2, 0.1, 0.01 + 0.1**2
    across = -math.sin(turned), math.cos(turned)
    rate = (0.01 * 3 - arm * (across[0] * 1 - across[1] * falls)) / inertia

    def forces(t, y):
        c, s = math.cos(y[0]), math.sin(y[0])
        bend = arm * G * c / inertia  # the mass is at -arm (c, s)
        return arm * (bend * s + y[1] ** 2 * c), arm * (-bend * c + y[1] ** 2 * s) + G

    def rates(t, y):
        return [y[1], arm * G * math.cos(y[0]) / inertia]

    times = np.linspace(0.0, 0.1, 2001)
    path = solve_ivp(rates, (0.0, 0.1), [turned, rate], t_eval=times, rtol=1e-10, atol=1e-12).y
    x, y = np.array([forces(t, state) for t, state in zip(times, path.T, strict=True)]).T
    outputs = Runner(interpret(read_text(CAUGHT.format(keys="", step=step)))).run(until=0.3).outputs
    assert outputs["X"] == pytest.approx(np.abs(x).max(), abs=60 * step)
    assert outputs["Y"] == pytest.approx(y.max(), abs=60 * step)


LATCH = """
kind: scene
name: latch
gravity: 0
parameters: {{F: 1000}}
bodies:
  wall: {{fixed: true, shape: {{disc: 0.05}}}}
  door:
    mass: 20
    inertia: 1
    shape: {{polygon: [[-0.4, -0.02], [0.4, -0.02], [0.4, 0.02], [-0.4, 0.02]]}}
    start: {{x: 0.4*cos(0.8), y: 0.4*sin(0.8), angle: 0.8}}
joints:
  hinge: {{point: {{body: door, at: [-0.4, 0]}}, to: {{body: wall}}}}
  latch:
    point: {{body: door, at: [0.4, 0]}}
    to: {{body: wall, at: [0.8, 0]}}
    rest: captured
    enabled: door.angle <= 0.01 and hypot(latch.X, latch.Y) <= F
forces: {{closer: {{body: door, moment: -8*(door.angle + 0.2)}}}}
collisions: {{all: {{bodies: [door, wall], friction: 0, restitution: 0}}}}
stop: {{time: 1.2}}
settings: {{engine: impulse, step: {step}}}
outputs:
  breaks: {{value: time, at: first latch.disable}}
  force: {{maximum: "hypot(latch.X, latch.Y)"}}
"""


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_a_redundant_latch_bears_the_force_that_the_motion_needs(step):
    """Hinge and latch both hold the door along itself; its moment needs a couple of forces."""
    runner = Runner(interpret(read_text(LATCH.format(step=step))))
    result = runner.run()
    assert "other joints imply 'latch'" in " ".join(result.trace.warnings)
    assert result.outputs["breaks"] is None
    turned = result.trace.final[2]
    assert result.outputs["force"] == pytest.approx(8.0 * (turned + 0.2) / 0.8, rel=5e-3)
    assert runner.run({"F": 2.0}).outputs["breaks"] is not None
    # The swing's energy, 8/2 (1 - 0.21^2), stops at once.
    caught = next(jump for jump in result.trace.jumps if jump.cause == "enable")
    inertia = 1.0 + 20.0 * 0.4**2
    speed = math.sqrt(8.0 * (1.0 - (turned + 0.2) ** 2) / inertia)
    assert caught.joint_impulse["latch.Y"] == pytest.approx(inertia * speed / 0.8, rel=2 * step)


def test_a_joint_that_closes_lists_the_impulse_of_its_closing():
    """The velocity of the caught end becomes zero: v + w x r = 0 with L about it conserved."""
    text = """
kind: scene
name: catch
gravity: 0
bodies:
  post: {fixed: true, start: {x: 2}, shape: {disc: 0.1}}
  box:
    mass: 2
    inertia: 0.5
    shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}
    start: {dx: 3, dy: 1}
joints:
  latch:
    point: {body: box, at: [0.2, 0]}
    to: {body: post}
    rest: captured
    enabled: box.x >= 1
collisions: {all: {bodies: [box, post], friction: 0, restitution: 0}}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""
    [jump] = Runner(interpret(read_text(text))).run().trace.jumps
    # Turning about the end with the moment of momentum m dy r = (I + m r^2) w.
    w = -2.0 * 1.0 * 0.2 / (0.5 + 2.0 * 0.2**2)
    assert jump.cause == "enable"
    assert jump.joint_impulse["latch.X"] == pytest.approx(-6.0, rel=1e-3)
    assert jump.joint_impulse["latch.Y"] == pytest.approx(2.0 * (-0.2 * w - 1.0), rel=1e-3)


def test_other_units_give_the_same_rebounds_at_a_limit():
    """Angular velocities at limits are not compared with velocities, whose unit has a length."""
    held = "{point: {body: bar, at: [-l/2, 0]}, to: [0, 0], limits: [-0.3, 1], restitution: 0.5}"
    text = ONE.format(joint=held, end=1, outputs="  a: {value: bar.angle}").replace(
        "x: 0,", "x: 0.5,"
    )
    declared = interpret(read_text(text))
    changed, reading = rescaled(declared)
    one, other = (Runner(model).run().trace for model in (declared, changed))
    assert other.final * reading.factors == pytest.approx(one.final, abs=1e-9)
