"""Contacts with lines, circles, moving surfaces and surfaces carried by bodies."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, engine, modes

from contacts.kind import automaton
from contacts.scene.modes import Free, Pin, Slide
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.execution.simulator import Simulator

pytestmark = pytest.mark.parametrize("name", ENGINES)


def run(scene: Scene, name: str, until: float) -> Trace:
    return Simulator(automaton(scene), engine(name)).run(until=until)


def test_a_particle_leaves_a_smooth_sphere_at_the_angle_whose_cosine_is_two_thirds(
    name: str,
) -> None:
    lean = 0.01
    scene = Scene(
        name="sphere",
        gravity=1,
        bodies={"bead": Body(mass=1, start={"x": f"sin({lean})", "y": f"cos({lean})"})},
        surfaces={"sphere": Surface(circle=(0, 0), radius=1)},
        contacts={
            "touch": Contact(
                point=Point(body="bead"), surface="sphere", friction=0, restitution=0,
                modes=(Free(), Slide()),
            )
        },
    )  # fmt: skip
    trace = run(scene, name, 20.0)
    assert modes(trace)[:2] == ["slide", "free"]
    x, y = trace.jumps[0].before[:2]
    # Energy from rest at the lean: 3 cos = 2 cos(lean).
    assert y == pytest.approx(2 / 3 * math.cos(lean), abs=1e-9)
    assert math.hypot(x, y) == pytest.approx(1.0, abs=1e-12)


def over_a_bump(width: float, speed: float) -> Scene:
    return Scene(
        name="bump",
        gravity=9.81,
        parameters={"w": width, "u0": speed, "mu": 0},
        bodies={"ball": Body(mass=1, start={"dx": "u0"})},
        surfaces={"ground": Surface(height="0.1*exp(-((x - 2)/w)**2)")},
        contacts={
            "tip": Contact(
                point=Point(body="ball"), surface="ground", friction="mu", restitution=0.5,
                modes=(Free(), Slide()),
            )
        },
    )  # fmt: skip


@pytest.mark.parametrize("width", [0.05, 2e-3])
def test_a_slow_ball_slides_up_a_narrow_bump_and_back(name: str, width: float) -> None:
    # Derivatives at the start vanish below round-off and do not show the bump.
    trace = run(over_a_bump(width, 1.0), name, 3.0)
    assert [jump.cause for jump in trace.jumps] == ["reverse"]
    assert trace.jumps[0].after[1] == pytest.approx(1 / (2 * 9.81), rel=1e-9)
    assert trace.final[1:] == pytest.approx([0.0, -1.0, 0.0], abs=1e-9)


def test_a_fast_ball_takes_off_from_a_narrow_bump(name: str) -> None:
    trace = run(over_a_bump(0.05, 8.0), name, 0.5)
    assert [jump.cause for jump in trace.jumps] == ["liftoff"]
    x, y, u, v = trace.jumps[0].after.tolist()
    height = 0.1 * math.exp(-(((x - 2) / 0.05) ** 2))
    slope = -2 * (x - 2) / 0.05**2 * height
    assert y == pytest.approx(height, abs=1e-11)
    assert v == pytest.approx(slope * u, rel=1e-9)
    # It takes off where the bump bends down as its parabola does, with the energy it came with.
    bend = ((2 * (x - 2) / 0.05**2) ** 2 - 2 / 0.05**2) * height
    assert bend * u**2 == pytest.approx(-9.81, rel=1e-8)
    assert (u**2 + v**2) / 2 + 9.81 * y == pytest.approx(32, rel=1e-10)


def test_a_particle_bounces_between_two_walls(name: str) -> None:
    wall = {"friction": 0, "restitution": 1, "modes": (Free(), Slide())}
    scene = Scene(
        name="walls",
        bodies={"ball": Body(mass=1, start={"x": 0.25, "dx": 1})},
        surfaces={
            # The solid is on the right of the line's direction.
            "right": Surface(line=((1, 0), (1, 1))),
            "left": Surface(line=((0, 1), (0, 0))),
        },
        contacts={
            "right": Contact(point=Point(body="ball"), surface="right", **wall),
            "left": Contact(point=Point(body="ball"), surface="left", **wall),
        },
    )
    trace = run(scene, name, 5.0)
    hits = [(jump.region, jump.t) for jump in trace.jumps]
    assert [region for region, _ in hits] == ["right", "left", "right", "left", "right"]
    assert [t for _, t in hits] == pytest.approx([0.75, 1.75, 2.75, 3.75, 4.75], abs=1e-12)


def test_a_block_rides_on_a_belt_until_its_acceleration_beats_friction(name: str) -> None:
    scene = Scene(
        name="belt",
        gravity=10,
        bodies={"block": Body(mass=1)},
        surfaces={"belt": Surface(height=0, displacement=("time**3/6", 0))},
        contacts={
            "base": Contact(
                point=Point(body="block"), surface="belt", friction=0.3, modes=(Slide(), Pin())
            )
        },
    )
    trace = run(scene, name, 5.0)
    # The belt accelerates at t; friction holds up to 0.3 g.
    assert modes(trace) == ["pin", "slide-"]
    assert trace.jumps[0].t == pytest.approx(3.0, abs=1e-9)
    speed = 3.0**2 / 2 + 3.0 * 2.0
    assert trace.final[2] == pytest.approx(speed, abs=1e-9)


def test_a_block_sticks_to_a_shaken_table(name: str) -> None:
    scene = Scene(
        name="table",
        gravity=10,
        bodies={"block": Body(mass=1, start={"x": 0.5, "y": 0.1, "dx": 1, "dy": 0.2})},
        surfaces={"table": Surface(height=0, displacement=("sin(time)", "sin(2*time)/10 + 0.1"))},
        contacts={
            "base": Contact(
                point=Point(body="block"), surface="table", friction=0.8, modes=(Slide(), Pin())
            )
        },
    )
    trace = run(scene, name, 40.0)
    assert modes(trace) == ["pin"]
    x, y = trace.final[:2]
    assert x == pytest.approx(0.5 + math.sin(40.0), abs=1e-9)
    assert y == pytest.approx(0.1 + math.sin(80.0) / 10, abs=1e-9)


def test_a_block_on_a_free_cart_shares_its_momentum(name: str) -> None:
    scene = Scene(
        name="cart",
        gravity=10,
        bodies={
            "cart": Body(mass=3),
            "block": Body(mass=1, start={"y": 1, "dx": 2}),
        },
        surfaces={"floor": Surface(height=0), "deck": Surface(height=1, body="cart")},
        contacts={
            "wheels": Contact(
                point=Point(body="cart"), surface="floor", friction=0, modes=(Slide(),)
            ),
            "base": Contact(
                point=Point(body="block"), surface="deck", friction=0.5, modes=(Slide(), Pin())
            ),
        },
    )
    trace = run(scene, name, 2.0)
    assert trace.modes[0] == ("slide", "slide+")
    assert trace.modes[-1] == ("slide", "pin")
    cart, block = trace.final[4], trace.final[6]
    assert cart == pytest.approx(0.5, abs=1e-9)
    assert block == pytest.approx(0.5, abs=1e-9)
    # mu g on the block, a third of it on the cart, until both are as fast.
    assert trace.jumps[0].t == pytest.approx(2 / (5 + 5 / 3), abs=1e-9)
    assert np.abs(trace.final[3] - 1.0) < 1e-12


def test_a_surface_with_two_forms_is_refused(name: str) -> None:
    with pytest.raises(DeclarationError, match="one of height, incline, line"):
        Surface(height=0, incline=0.1)


@pytest.mark.parametrize("height", ["abs(x)", "max(0, sin(2*x))", "s*min(x, 1)**3", "sign(x - s)"])
def test_height_with_kinks_is_refused_with_advice(name: str, height: str) -> None:
    text = read_text(GROOVE.replace("{height: s*x}", f'{{height: "{height}"}}'))
    with pytest.raises(DeclarationError, match="a surface and a contact for each") as caught:
        validate(text, Scene)
    assert "surfaces.up.height" in str(caught.value)


def test_a_path_whose_velocity_jumps_is_refused(name: str) -> None:
    joint = "joints: {hand: {point: {body: ball}, to: {x: 'min(time, s)'}}}\n"
    with pytest.raises(DeclarationError, match="write a smooth formula"):
        validate(read_text(GROOVE + joint), Scene)


GROOVE = """\
kind: scene
name: groove
gravity: 1
parameters: {s: 0.5, x0: -1, u: 0}
bodies: {ball: {mass: 1, start: {x: x0, y: 0.5, dx: u, dy: s*u}}}
surfaces: {up: {height: s*x}, down: {height: -s*x}}
contacts:
  right: {point: {body: ball}, surface: up, friction: 0, restitution: 0, modes: [free, slide]}
  left: {point: {body: ball}, surface: down, friction: 0, restitution: 0, modes: [free, slide]}
"""


def test_a_ball_slides_into_a_groove_of_two_pieces_and_rests(name: str) -> None:
    trace = run(validate(read_text(GROOVE), Scene), name, 12.0)
    assert trace.final_mode == ("slide", "slide")
    # Down a slope of length hypot(1, s). At the bottom the speed is multiplied by the cosine of the
    # angle between the slopes, and so is the time to go up and down again.
    first, ratio = math.sqrt(2 * 1.25 / 0.5), 0.6
    assert trace.jumps[0].t == pytest.approx(first, abs=1e-9)
    last = trace.jumps[-1]
    assert last.t == pytest.approx(first * (1 + 2 * ratio / (1 - ratio)), abs=1e-6)
    assert trace.final == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-9)


def test_a_ball_flies_off_a_ridge_of_two_pieces_and_lands_on_the_other_side(name: str) -> None:
    ridge = (
        GROOVE.replace("y: 0.5", "y: s*x0")
        .replace("u: 0}", "u: 2}")
        .replace("surface: up,", "surface: up, enabled: ball.x <= 0,")
        .replace("surface: down,", "surface: down, enabled: ball.x >= 0,")
    )
    trace = run(validate(read_text(ridge), Scene), name, 6.0)
    causes = [(jump.region, jump.cause) for jump in trace.jumps]
    assert causes[-1] == ("left", "touchdown")
    # From the ridge it flies with the rate v along x until y = s x - (x/v)^2/2 is -s x.
    v2 = 4.0 - 2 * 0.5 / (1 + 0.25)
    assert trace.jumps[-1].after[0] == pytest.approx(2 * v2, abs=1e-9)
    assert trace.final_mode == ("off", "slide")
