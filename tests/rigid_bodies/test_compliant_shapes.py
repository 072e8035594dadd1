"""Compliant contacts between bodies with shapes, beside the damped spring."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81

BALL = """
kind: scene
name: ball
parameters: {r: 0.1, k: 4000, d: 10, y: 0.3, m: 2, end: 0.5}
gravity: 9.81
bodies:
  ball: {mass: m, inertia: m*r**2/2, shape: {disc: r}, start: {y: y}}
surfaces: {floor: {height: 0}}
collisions:
  all: {bodies: [ball], surfaces: [floor], friction: 0.4, stiffness: k, damping: d}
stop: {time: end}
settings: {engine: impulse, step: 1e-3}
outputs:
  y: {value: ball.y}
  up: {maximum: ball.dy}
  touches: {value: time, at: first ball.touchdown}
  leaves: {value: time, at: first ball.liftoff}
  deepest: {maximum: r - ball.y}
"""

BOX = """
kind: scene
name: box
parameters: {a: 0.2, k: 4000, d: 400, m: 2}
gravity: 9.81
bodies:
  box:
    mass: m
    inertia: m*a**2/6
    shape: {polygon: [[-a/2, -a/2], [a/2, -a/2], [a/2, a/2], [-a/2, a/2]]}
    start: {y: a/2}
surfaces: {floor: {height: 0}}
collisions:
  all: {bodies: [box], surfaces: [floor], friction: 0.4, stiffness: k, damping: d}
stop: {time: 3}
settings: {engine: impulse, step: 1e-3}
outputs:
  y: {value: box.y}
  angle: {value: box.angle}
"""


def run(text, parameters=None, **settings):
    return Runner(interpret(read_text(text)), **settings).run(parameters)


def test_a_ball_rests_at_its_weight_over_its_stiffness():
    outputs = run(BALL, {"y": 0.1, "d": 400, "end": 2}).outputs
    assert outputs["y"] == pytest.approx(0.1 - 2 * G / 4000, rel=1e-9)


def test_a_box_shares_its_load_among_its_corners():
    outputs = run(BOX).outputs
    assert outputs["y"] == pytest.approx(0.1 - 2 * G / 8000, abs=1e-9)
    assert outputs["angle"] == pytest.approx(0, abs=1e-12)


def closed_form(k, d, m, speed):
    """Return the time in contact, the velocity after, and the depth of a ball that lands."""
    decay, rest = d / (2 * m), m * G / k
    w = math.sqrt(k / m - decay**2)

    def moved(t):
        """Depth, and its rate, from that of the weight: a damped oscillation."""
        e, c, s = math.exp(-decay * t), math.cos(w * t), math.sin(w * t)
        begin, rate = -rest, speed
        amp = (rate + decay * begin) / w
        x = e * (begin * c + amp * s)
        v = e * ((amp * w - decay * begin) * c - (begin * w + decay * amp) * s)
        return x + rest, v

    low, high = 0.75 * math.pi / w, 1.2 * math.pi / w
    for _ in range(100):
        t = 0.5 * (low + high)
        x, v = moved(t)
        low, high = (t, high) if k * x + d * v > 0 else (low, t)
    return low, -moved(low)[1], max(moved(i * low / 2000)[0] for i in range(2000))


def test_a_drop_follows_the_damped_spring_to_second_order():
    speed = math.sqrt(2 * G * 0.2)
    lasts, up, deepest = closed_form(4000, 10, 2, speed)
    text = BALL.replace("{maximum: ball.dy}", "{value: ball.dy, at: first ball.liftoff}")
    for step in (1e-3, 2.5e-4):
        outputs = run(text, step=step).outputs
        assert outputs["touches"] == pytest.approx(speed / G, abs=2 * step)
        assert outputs["leaves"] - outputs["touches"] == pytest.approx(lasts, abs=2 * step)
        assert outputs["up"] == pytest.approx(up, abs=G * 2 * step)
        assert outputs["deepest"] == pytest.approx(deepest, rel=0.5 * 4000 / 2 * step**2)


@pytest.mark.parametrize("step", [1e-3, 5e-4, 2.5e-4])
@pytest.mark.parametrize("corners", [False, True])
def test_an_undamped_bounce_keeps_its_energy_to_second_order(step, corners):
    """Implicit Euler took pi/2 times frequency and step: 22 % at 1e-3."""
    text = BALL
    if corners:
        text = text.replace("{disc: r}", "{polygon: [[-r, -r], [r, -r], [r, r], [-r, r]]}")
    energy = "energy: {value: ball.dy**2/2 + 9.81*(ball.y - r)}"
    text = text.replace("outputs:", f"outputs:\n  {energy}")
    k = 2e4 if corners else 4e4
    outputs = run(text, {"k": k, "d": 0, "end": 0.3}, step=step).outputs
    assert outputs["energy"] == pytest.approx(G * 0.2, rel=2e4 * step**2)


@pytest.mark.parametrize("d", [0, 1e3])
def test_any_stiffness_is_stable(d):
    """h^2 k = 1e6: most of the bounce is lost, and it rests where it should.

    The place moves by the mean of both velocities: it is up to h v/2 inside after the step in which
    it arrives, and comes back at v/2.
    """
    result = run(BALL, {"k": 1e12, "d": d, "end": 3}, step=1e-3)
    assert result.outputs["up"] <= 0.5 * math.sqrt(2 * G * 0.2)
    assert result.outputs["y"] == pytest.approx(0.1, abs=1e-6)
    assert result.trace.warnings == ()


def test_a_compliant_contact_never_pulls():
    """An overdamped ball comes back slowly: a linear damper would hold it, this one lets it go."""
    result = run(BALL, {"d": 3000, "k": 4e5, "end": 0.6}, step=1e-4)
    trace, column = result.trace, 4
    for before, after in itertools.pairwise(trace.arcs):
        if after.mode == ("free",):
            assert after.states(np.zeros(1))[0, column] >= before.states(np.zeros(1))[0, column]
    assert result.outputs["y"] == pytest.approx(0.1 - 2 * G / 4e5, abs=1e-6)


def test_a_compliant_ball_sticks_and_slides_as_a_rigid_one():
    """Thrown along the floor it slips until it rolls: at 2/3 of its velocity."""
    text = BALL.replace("start: {y: y}", "start: {y: r - m*9.81/k, dx: 3}")
    text = text.replace("outputs:", "outputs:\n  speed: {value: ball.dx}")
    outputs = run(text, {"d": 400, "end": 1}).outputs
    assert outputs["speed"] == pytest.approx(2, rel=1e-6)


@pytest.mark.parametrize("ground", ["fixed: true, start: {y: -0.2}", "position: [0*time, -0.2]"])
@pytest.mark.parametrize("start", [(1, 0), (0.5, -5)])
def test_a_compliant_disc_rolls_on_its_radius(ground, start):
    """v = r w, on fixed and led bodies as on surfaces: 2/3 of the velocity of a sliding start."""
    dx, dangle = start
    text = f"""
kind: scene
name: roll
gravity: 10
bodies:
  disc:
    mass: 1
    inertia: 0.005
    shape: {{disc: 0.1}}
    start: {{y: 0.1 - 10/3000, dx: {dx}, dangle: {dangle}}}
  crate: {{{ground}, shape: {{polygon: [[-6, -0.2], [6, -0.2], [6, 0.2], [-6, 0.2]]}}}}
collisions: {{all: {{bodies: [disc, crate], friction: 0.1, stiffness: 3000, damping: 0}}}}
stop: {{time: 0.5}}
settings: {{engine: impulse, step: 1e-3}}
outputs: {{v: {{value: disc.dx}}, w: {{value: disc.dangle}}}}
"""
    outputs, v = run(text).outputs, 2 / 3 if dangle == 0 else 0.5
    assert outputs["v"] == pytest.approx(v, rel=1e-9)
    assert outputs["w"] == pytest.approx(-10 * v, rel=1e-9)


def test_rigid_neighbours_of_compliant_contacts_bounce_no_higher_than_they_fell():
    text = """
kind: scene
name: mixed
gravity: 9.81
bodies:
  pad: {mass: 5, inertia: 0.2, shape: {polygon: [[-1, -0.1], [1, -0.1], [1, 0.1], [-1, 0.1]]},
    start: {y: 0.1 - 5*9.81/2e5}}
  ball: {mass: 1, inertia: 0.002, shape: {disc: 0.05}, start: {y: 0.5}}
surfaces: {floor: {height: 0}}
collisions:
  soft: {bodies: [pad], surfaces: [floor], friction: 0.4, stiffness: 1e5, damping: 10}
  hard: {bodies: [ball, pad], friction: 0.4, restitution: 0.8}
stop: {time: 1}
settings: {engine: impulse, step: 1e-4}
outputs:
  up: {maximum: ball.dy}
"""
    outputs = run(text).outputs
    fell = math.sqrt(2 * G * (0.45 - 0.2 + 5 * G / 2e5))
    assert 0.4 * fell < outputs["up"] < 0.8 * fell


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("damping: 3, restitution: 0", "damping belongs to a compliant contact"),
        ("stiffness: 3, restitution: 0", "no impacts, and no restitution"),
        ("rolling_resistance: 0.1", "need a coefficient of restitution"),
        ("stiffness: 0", "must be"),
    ],
)
def test_mistakes_are_reported(law, message):
    text = BALL.replace("stiffness: k, damping: d", law)
    with pytest.raises(DeclarationError, match=message):
        run(text)


@pytest.mark.parametrize("h_times_rate", [0.05, 0.1, 0.2, 0.5, 0.8, 1, 2, 12])
def test_an_undamped_bounce_never_gains_energy(h_times_rate):
    """Whatever part of a step the touchdown leaves; and no more is lost than declared."""
    text = BALL.replace("outputs:", "outputs:\n  energy: {value: ball.dy**2/2 + 9.81*(ball.y - r)}")
    step = 1e-3
    stiffness = 2 * (h_times_rate / step) ** 2
    for part in range(5):
        y = 0.2 + 4e-4 * part
        outputs = run(text, {"k": stiffness, "d": 0, "y": y, "end": 0.25}, step=step).outputs
        kept = outputs["energy"] / (G * (y - 0.1))
        assert 1 - 1.01 * h_times_rate**2 <= kept <= 1 + 1e-9


def test_parts_of_a_step_return_no_more_energy_than_the_whole():
    """Hinged slabs were thrown up with 384 J. A rotor has all steps taken in parts."""
    slab = (
        "{mass: 0.4, inertia: 0.4*l**2/12, shape: {polygon: [[-l/2, -w], [l/2, -w], [l/2, w], "
        "[-l/2, w]]}, start: {y: 0.5, angle: SIGN*a, x: -SIGN*l/2*cos(a)}}"
    )
    text = f"""
kind: scene
name: slabs
parameters: {{k: 1.5e8, a: 0.3, l: 0.4, w: 0.02}}
gravity: 9.81
bodies:
  one: {slab.replace("SIGN", "1")}
  two: {slab.replace("SIGN", "-1")}
  rotor: {{mass: 1, inertia: 1, start: {{x: 2, dangle: 4000}}}}
surfaces: {{floor: {{height: 0}}}}
joints: {{pin: {{point: {{body: one, at: [l/2, 0]}}, to: {{body: two, at: [-l/2, 0]}}}}}}
collisions:
  all: {{bodies: [one, two], surfaces: [floor], friction: 0.5, stiffness: k, damping: 0}}
stop: {{time: 0.6}}
settings: {{engine: impulse, step: 1e-3}}
outputs:
  energy:
    maximum: "0.2*(one.dx**2 + one.dy**2 + two.dx**2 + two.dy**2) \\
      + l**2/60*(one.dangle**2 + two.dangle**2) + 0.4*9.81*(one.y + two.y)"
"""
    result = run(text)
    assert any("had to be split" in warning for warning in result.warnings)
    assert result.outputs["energy"] <= 0.4 * G * (1 + 1e-9)


@pytest.mark.parametrize("stiffness", [1e3, 2e4, 1e6])
def test_a_guide_beside_a_compliant_contact_does_no_work(stiffness):
    """Springs that return their energy had every step taken in 256 parts, as a wedged joint has."""
    text = """
kind: scene
name: buffer
parameters: {k: 1e3, r: 0.1}
gravity: 9.81
bodies:
  car: {mass: 1, inertia: 0.01, shape: {disc: r}, start: {x: 0.3, y: r, dx: -1}}
  wall: {fixed: true, shape: {polygon: [[-0.1, 0], [0.1, 0], [0.1, 1], [-0.1, 1]]}}
collisions: {hits: {bodies: [car, wall], friction: 0, stiffness: k, damping: 5}}
joints: {rail: {point: {body: car}, to: {y: r}}}
stop: {time: 0.3}
settings: {engine: impulse, step: 1e-3}
outputs: {v: {value: car.dx}}
"""
    guided = run(text, {"k": stiffness})
    alone = run(
        text.replace("joints: {rail: {point: {body: car}, to: {y: r}}}", "").replace(
            "gravity: 9.81", "gravity: 0"
        ),
        {"k": stiffness},
    )
    assert not guided.warnings
    assert guided.outputs["v"] == pytest.approx(alone.outputs["v"], abs=1e-12)


LIFTED = """
kind: scene
name: lifted
parameters: {jerk: 10, squeeze: 2e-3, k: 5000, mu: 0.4}
gravity: 9.81
bodies:
  left:
    position: [squeeze - 0.1, jerk*time**3/6]
    shape: {polygon: [[-0.05, -0.1], [0.05, -0.1], [0.05, 0.1], [-0.05, 0.1]]}
  right:
    position: [0.1 - squeeze, jerk*time**3/6]
    shape: {polygon: [[-0.05, -0.1], [0.05, -0.1], [0.05, 0.1], [-0.05, 0.1]]}
  box:
    mass: 1
    inertia: 0.002
    shape: {polygon: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}
collisions: {grip: {bodies: [left, right, box], friction: mu, stiffness: k, damping: 0}}
stop: {time: 1}
outputs: {t: {value: time, at: first box.slip}, y: {value: box.y}}
"""


@pytest.mark.parametrize("h", [1e-3, 2.5e-4, 5e-5])
def test_soft_fingers_lose_a_box_at_the_same_instant_at_all_steps(h: float) -> None:
    found = run(LIFTED, engine="impulse", step=h)
    # Each finger touches at two corners: the box slips where 4 mu k squeeze = m (g + jerk t).
    force = 4 * 0.4 * 5000 * 2e-3
    slips = (force - 9.81) / 10
    rest = 1 - slips
    y = 10 * slips**3 / 6 + 10 * slips**2 / 2 * rest + (force - 9.81) * rest**2 / 2
    assert [jump.cause for jump in found.trace.jumps] == ["touchdown", "slip"]
    assert found.outputs["t"] == pytest.approx(slips, abs=2 * h)
    assert found.outputs["y"] == pytest.approx(y, abs=2 * h**2)


SEAMS = """
kind: scene
name: seams
gravity: 9.81
bodies:
  box:
    mass: 1
    inertia: 0.002
    shape: {polygon: [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]]}
    start: {x: 0.945, y: 0.04964, dx: 0.95, angle: -0.00125}
  FLOOR
collisions: {all: {bodies: [box, crate], friction: 0.18, stiffness: 13772, damping: 5.04}}
stop: {time: 0.2}
outputs:
  highest: {maximum: box.y}
  lowest: {minimum: box.y}
  left: {maximum: box.angle}
  right: {minimum: box.angle}
"""
TILE = "[[-0.5, -0.2], [0.5, -0.2], [0.5, 0], [-0.5, 0]]"
TILES = f"crate: {{fixed: true, copies: 3, shape: {{polygon: {TILE}}}, start: {{x: index - 0.5}}}}"
SLAB = "crate: {fixed: true, shape: {polygon: [[-1, -0.2], [2, -0.2], [2, 0], [-1, 0]]}}"


@pytest.mark.parametrize("h", [1e-3, 1e-4])
def test_a_box_slides_over_the_seam_of_two_compliant_crates_as_over_one(h: float) -> None:
    """It rests on its own corners: crates side by side are one floor, no stiffer at their seam."""
    tiles, slab = (
        Runner(interpret(read_text(SEAMS.replace("FLOOR", floor))), engine="impulse", step=h)
        .run()
        .outputs
        for floor in (TILES, SLAB)
    )
    depth = 9.81 / (2.0 * 13772)
    for name, within in {"highest": 0.05, "lowest": 0.05, "left": 0.2, "right": 0.2}.items():
        assert tiles[name] == pytest.approx(slab[name], abs=within * depth)
