"""Landing without a bounce: the contact is closed from the moment of touching."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STEP, GRAVITY = 1e-3, 9.81
HEIGHTS = [0.05 + 0.0137 * k for k in range(20)]
BOX = "polygon: [[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]"
SHAPES = {"disc": "disc: 0.05", "box": BOX}
BENCH = f"low: {{mass: 3, inertia: 0.02, shape: {{{BOX}}}, start: {{y: 0.05}}}}"


def text(shape: str, bench: bool, simultaneous: str = "capped") -> str:
    """Return a scene in which a body falls on the ground, or on a box that rests there."""
    low, others = (BENCH, "low, ") if bench else ("", "")
    restitution = 0 if simultaneous == "capped" else 0.5
    return f"""
kind: scene
name: dropped
parameters: {{height: 0.1}}
gravity: {GRAVITY}
bodies:
  b: {{mass: 1, inertia: 0.002, shape: {{{SHAPES[shape]}}},
    start: {{y: height + {0.15 if bench else 0.05}}}}}
  {low}
surfaces: {{ground: {{height: 0}}}}
collisions:
  all: {{bodies: [{others}b], surfaces: [ground], friction: 0.5, restitution: {restitution}}}
simultaneous: {simultaneous}
outputs:
  y: {{value: b.y}}
stop: {{time: 0.35}}
settings: {{engine: impulse, step: {STEP}}}
"""


@cache
def dropped(shape: str, bench: bool, simultaneous: str = "capped") -> Runner:
    """Return what runs it."""
    return Runner(interpret(read_text(text(shape, bench, simultaneous))))


CASES = [("disc", False), ("box", False), ("disc", True), ("box", True)]


@pytest.mark.parametrize(("shape", "bench"), CASES)
def test_a_landed_body_stays_in_contact(shape, bench):
    rest, early = 0.15 if bench else 0.05, 0
    for height in HEIGHTS:
        trace = dropped(shape, bench).run({"height": height}).trace
        met, speed = math.sqrt(2 * height / GRAVITY), math.sqrt(2 * height * GRAVITY)
        (jump,) = [jump for jump in trace.jumps if jump.impulse]
        assert jump.cause == "touchdown"
        assert jump.impulse["b"][0] == pytest.approx(speed, rel=2e-2)
        assert [arc.mode[0] for arc in trace.arcs] == ["free", "pin"]
        assert jump.after[:3] == pytest.approx(jump.before[:3], abs=1e-12)
        gap = trace.final[trace.variables.index("b.y")] - rest
        # Struck at the step nearest to when it touches: in it, or at its middle.
        if math.fmod(met, STEP) > 0.5 * STEP:
            early += 1
            assert jump.t == pytest.approx(met, abs=STEP**2)
            assert gap == pytest.approx(0, abs=1e-12)
        else:
            assert met <= jump.t <= met + 0.5 * STEP
            assert -0.5 * STEP * speed - 1e-5 <= gap <= 1e-12
    assert 5 < early < 15


def test_both_corners_of_a_plastic_box_land_at_the_touch_point():
    trace = dropped("box", False, "plastic").run({"height": HEIGHTS[0]}).trace
    alike = dropped("box", False).run({"height": HEIGHTS[0]}).trace
    assert math.fmod(math.sqrt(2 * HEIGHTS[0] / GRAVITY), STEP) > 0.5 * STEP
    assert np.array_equal(trace.final, alike.final)
    assert [jump.t for jump in trace.jumps] == [jump.t for jump in alike.jumps]


@pytest.mark.parametrize("record", ["poses", "nothing"])
def test_the_recording_policy_does_not_change_the_landing(record):
    runner = dropped("box", True)
    runner = Runner(interpret(read_text(text("box", True))), record=record)
    for height in HEIGHTS[::4]:
        expected = dropped("box", True).run({"height": height}).outputs["y"]
        assert runner.run({"height": height}).outputs["y"] == expected


PUSHED = """
  b: {mass: 1, inertia: 0.002, shape: {BOX}, start: {y: 0.05}}
  wall: {fixed: true, shape: {polygon: [[1, 0], [2, 0], [2, 1], [1, 1]]}}
"""
ON_A_CART = """
  b: {mass: 1, inertia: 0.002, shape: {BOX}, start: {x: 0.3, y: 0.8}}
  cart: {mass: 3, inertia: 1, shape: {polygon: [[-1, 0], [1, 0], [1, 0.2], [-1, 0.2]]},
    start: {dx: 1}}
"""
ABOVE = "\n  b: {mass: 1, inertia: 0.002, shape: {BOX}, start: {y: 1}}\n"
HELD = {
    "along a rough floor against a wall": (PUSHED, "{}", "[5, 0]", 9.81, 0.2),
    "without gravity": (PUSHED, "{}", "[5, -3]", 0, 0.2),
    "on a cart that rolls": (ON_A_CART, "{}", "[0, 0]", 9.81, 0.5),
    "on a slack rope": (ABOVE, "{j: {point: {body: b}, to: [0, 0], rope: 2}}", "[0, 0]", 9.81, 0.5),
    "after its joint let go": (
        ABOVE,
        "{j: {point: {body: b}, to: [0, 1], angle: held, enabled: time < 0.3}}",
        "[0, -10*time]",
        9.81,
        0.5,
    ),
}


@pytest.mark.parametrize("case", HELD)
def test_a_body_lands_once_whatever_holds_it_elsewhere(case):
    """Other contacts slip in the impact, joints are off: the landing waits for the touch."""
    bodies, joints, push, gravity, mu = HELD[case]
    names = "[b, wall]" if "wall" in bodies else "[b, cart]" if "cart" in bodies else "[b]"
    scene = f"""
kind: scene
name: held
gravity: {gravity}
bodies: {bodies.replace("BOX", BOX)}
joints: {joints}
forces: {{push: {{body: b, force: {push}}}}}
surfaces: {{ground: {{height: 0}}}}
collisions: {{all: {{bodies: {names}, surfaces: [ground], friction: {mu}, restitution: 0}}}}
stop: {{time: 1}}
"""
    model = interpret(read_text(scene))
    for step in (3e-3, 2e-3, 1.5e-3, 1e-3, 7e-4, 5e-4):
        trace = Runner(model, step=step).run().trace
        struck = [jump for jump in trace.jumps if jump.t > 0.0 and "b" in jump.impulse]
        assert len(struck) == 1, step
        assert not any(jump.cause == "liftoff" for jump in trace.jumps)


@pytest.mark.parametrize(("step", "rocks"), [(2e-5, True), (1e-4, True), (1e-3, False)])
def test_a_box_that_lands_nearly_flat_rocks_where_steps_part_its_corners(step, rocks):
    """Plastic impacts at one corner, then at the other 0.27 ms later; in one step they stop it."""
    a, b, tilt, speed = 0.1, 0.2, 1e-3, 1.0
    text = f"""
kind: scene
name: box
bodies:
  box:
    mass: 1
    inertia: {(a * a + b * b) / 3!r}
    shape: {{polygon: [[-{a}, -{b}], [{a}, -{b}], [{a}, {b}], [-{a}, {b}]]}}
    start: {{y: {b * math.cos(tilt) + a * math.sin(tilt) + 0.0103!r}, angle: {tilt}, dy: {-speed}}}
surfaces: {{ground: {{height: 0}}}}
collisions: {{all: {{bodies: [box], surfaces: [ground], friction: 0, restitution: 0}}}}
stop: {{time: 0.02}}
settings: {{engine: impulse, step: {step}}}
"""
    _, dy, turn = Runner(interpret(read_text(text))).run().trace.final[3:6]
    k = 3.0 * a * a / (a * a + b * b)
    rises = 2.0 * k * (1.0 - k) / (1.0 + k) ** 2 * speed if rocks else 0.0
    assert dy == pytest.approx(0.5 * rises, rel=1e-2, abs=1e-12)
    assert turn == pytest.approx(-0.5 * rises / a, rel=1e-2, abs=1e-12)


DROPS = """
kind: scene
name: drops
gravity: 9.81
bodies:
  stone: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {y: 0.1 + 9.81*0.20073**2/2}}
  late: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {x: 1, y: 0.1 + 9.81*0.20095**2/2}}
  early: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {x: 2, y: 0.1 + 9.81*0.20065**2/2}}
  bouncer: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {x: 3, y: 0.1 + 9.81*0.2008**2/2}}
  thrown: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {x: 4, y: 0.1}}
surfaces: {floor: {height: 0}}
collisions:
  soft: {bodies: [stone, late, early, thrown], surfaces: [floor], friction: 0.3, restitution: 0}
  hard: {bodies: [bouncer], surfaces: [floor], friction: 0.3, restitution: 0.5}
forces: {throw: {body: thrown, force: [0, 9.81*time/0.2005]}}
regions:
  first:
    initial: none
    states: {none: {}, stone: {}, late: {}, early: {}}
    transitions:
      - {name: a, from: none, to: stone, on: stone.touchdown}
      - {name: b, from: none, to: late, on: late.touchdown}
      - {name: c, from: none, to: early, on: early.touchdown}
stop: {time: 0.21}
settings: {engine: impulse, step: 1e-3}
outputs: {leaves: {value: time, at: first thrown.liftoff}}
"""


def test_bodies_that_land_in_one_step_have_their_own_times_of_touch():
    """And the order of the bodies in the file does not decide what a controller hears first."""
    result = statechart.run(read_text(DROPS))
    trace = result.trace
    at = {jump.region: jump for jump in trace.jumps if jump.impulse}
    touches = {"early": 0.20065, "stone": 0.20073, "late": 0.20095}
    for name, touch in touches.items():
        assert at[name].t == pytest.approx(touch, abs=1e-6)
        assert set(at[name].impulse) == {name}
        assert trace.final[trace.variables.index(f"{name}.y")] == pytest.approx(0.1, abs=1e-12)
    assert at["bouncer"].t == pytest.approx(0.2008, abs=1e-3)
    assert trace.final_mode[-1] == "early"
    assert float(result.outputs["leaves"]) == pytest.approx(0.2005, abs=1e-3)


SPUN = """
kind: scene
name: spun
gravity: 9.81
bodies:
  d: {mass: 1, inertia: 0.005, start: {x: -0.5, y: 0.1, dx: 1, dangle: -10}, shape: {disc: 0.1}}
surfaces: {floor: {height: 0}, wall: {edge: [[0, 3], [0, -3]]}}
collisions: {a: {bodies: [d], surfaces: [floor, wall], friction: 0.3, restitution: 0}}
stop: {time: 0.6}
settings: {engine: impulse}
"""


@pytest.mark.parametrize("step", [1e-3, 3e-4, 1e-4])
def test_a_rolling_disc_that_climbs_a_wall_lands_once_and_spins_down_in_the_corner(step):
    """The wall's friction mu m v throws it up; in the corner both surfaces brake its spin.

    It flies for 2 mu v/g, and spins down at mu (1 + mu)/(1 + mu^2) m g r/I after its landing.
    """
    mu, v, m, r, inertia, g = 0.3, 1.0, 1.0, 0.1, 0.005, 9.81
    braking = mu * (1 + mu) / (1 + mu**2) * m * r / inertia
    lands = 0.4 + 2 * mu * v / g
    spin = v / r - mu * m * v * r / inertia - braking * mu * v
    trace = statechart.run(read_text(SPUN), step=step).trace
    struck = [jump.t for jump in trace.jumps if jump.impulse]
    assert struck == pytest.approx([0.4, lands], abs=2 * step)
    assert trace.jumps[-1].cause == "stick"
    assert trace.jumps[-1].t == pytest.approx(lands + spin / (braking * g), abs=2 * step)
