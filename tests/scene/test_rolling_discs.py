"""Discs that touch with their rims: declaration, and invariants of rolling."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scenes import run, scene

import statechart
from contacts.testing.symmetry import mirrored, rescaled
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret, load
from statechart.testing.subject import Subject

RING = """
kind: scene
name: ring
parameters: {R: 1, r: 0.2, v0: 12, m: 2, g: 9.81}
gravity: g
bodies:
  ball: {mass: m, inertia: m*r**2/2, start: {y: r - R, dx: v0, dangle: -v0/r}}
surfaces: {SURFACE}
contacts: {rim: {point: {body: ball}, radius: RADIUS, surface: ring, friction: inf, restitution: 0}}
stop: {time: 2}
"""
HOLLOW = "ring: {circle: [0, 0], radius: R, hollow: true}"


def model(surface: str = HOLLOW, radius: str = "r") -> Any:
    text = RING.replace("SURFACE", surface).replace("RADIUS", radius)
    return interpret(read_text(text, "f.yaml"))


@pytest.mark.parametrize(
    ("surface", "radius", "reported"),
    [
        ("ring: {height: x**2}", "r", "write a slope as an incline or a line"),
        ("ring: {edge: [[0, 0], [1, 0]]}", "r", "for each end a circle of radius 0"),
        (HOLLOW, "0", "contacts.rim.radius: must be positive, not 0"),
        (HOLLOW, "-r", "must be positive, not -0.2"),
        (HOLLOW, "1/0", "radius"),
        (HOLLOW, "2*R", "a disc of radius 2 does not roll in a circle of radius 1"),
        (HOLLOW, "size", "unknown name 'size'"),
    ],
)
def test_surfaces_that_a_disc_cannot_touch_are_reported(
    surface: str, radius: str, reported: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        statechart.run(model(surface, radius))
    assert reported in str(caught.value)


@pytest.mark.parametrize("radius", [" radius: r,", ""])
@pytest.mark.parametrize("at", ["[0, 0]", "[0.05, -0.1]"])
def test_only_contacts_off_the_centre_have_impacts_that_depend_on_the_law(
    at: str, radius: str
) -> None:
    text = RING.replace("SURFACE", "ring: {height: 0}").replace(" radius: RADIUS,", radius)
    changes = {
        "{y: r - R, dx: v0, dangle: -v0/r}": "{y: 1, dx: 0.5}",
        "{body: ball}": f"{{body: ball, at: {at}}}",
        "inf, restitution: 0": "0.9, restitution: 0.5, impact: LAW",
        "time: 2": "time: 0.6",
    }
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    finals = []
    for law in ("stronge", "moreau"):
        declared = interpret(read_text(text.replace("LAW", law)))
        finals.append(statechart.run(declared).trace.final)
    stepped = interpret(read_text(text.replace("LAW", "stronge")))
    warned = "Moreau's law" in " ".join(
        statechart.run(stepped, engine="impulse", step=1e-3).trace.warnings
    )
    assert warned == (at != "[0, 0]")
    assert (finals[0] == pytest.approx(finals[1], abs=1e-9)) != warned


KERB = """
kind: scene
name: kerb
parameters: {r: 0.3, h: 0.08, v: 1.5}
gravity: 9.81
bodies: {wheel: {mass: 5, inertia: 5*r**2/2, start: {x: -1, y: r, dx: v, dangle: -v/r}}}
surfaces: {road: {height: 0}, corner: {circle: [0, h], radius: 0}}
contacts:
  tread: {point: {body: wheel}, radius: r, surface: road, friction: 1, restitution: 0}
  kerb: {point: {body: wheel}, radius: r, surface: corner, friction: inf, restitution: 0}
stop: {time: 1, conditions: {over: wheel.x >= 0}}
outputs:
  t: {value: time, at: first kerb.touchdown}
  w: {value: wheel.dangle, at: first kerb.touchdown}
  top: {value: wheel.dangle}
"""


@pytest.mark.parametrize("settings", [{"engine": "taylor"}, {"engine": "scipy"}, {"step": 5e-4}])
def test_a_wheel_climbs_a_corner_which_is_a_circle_of_radius_zero(settings: dict[str, Any]) -> None:
    engine = {"engine": "impulse"} if "step" in settings else {}
    found = statechart.run(interpret(read_text(KERB, "f.yaml")), **settings, **engine).outputs
    r, h, v, g = 0.3, 0.08, 1.5, 9.81
    # The angular momentum about the corner stays.
    w = (v * (r - h) + r * v / 2) / (1.5 * r**2)
    top = math.sqrt(w**2 - 2 * g * h / (1.5 * r**2))
    close = 5e-3 if engine else 1e-11
    assert found["t"] == pytest.approx((1 - math.sqrt(r**2 - (r - h) ** 2)) / v, rel=close)
    assert (found["w"], found["top"]) == pytest.approx((-w, -top), rel=close)


def test_a_point_cannot_touch_a_corner() -> None:
    text = KERB.replace(
        "point: {body: wheel}, radius: r, surface: corner", "point: {body: wheel}, surface: corner"
    )
    with pytest.raises(
        DeclarationError, match=r"radius: must be positive, not 0; a point cannot touch a corner"
    ):
        interpret(read_text(text, "f.yaml"))


def test_a_disc_that_loops_keeps_its_energy_and_its_place() -> None:
    found = statechart.run(model(), tolerance=2.2e-16)
    trace = found.trace
    assert [jump.cause for jump in trace.jumps] == []
    x, y, angle, dx, dy, spin = trace.final
    # Turned more than a round, against the angle of a looping.
    assert abs(angle) > 4 * math.tau
    assert math.hypot(x, y) == pytest.approx(0.8, abs=1e-13)
    rolled = 0.2 / 0.8 * angle
    assert (x, y) == pytest.approx((-0.8 * math.sin(rolled), -0.8 * math.cos(rolled)), abs=1e-11)
    energy = dx**2 + dy**2 + 0.02 * spin**2 + 2 * 9.81 * y
    assert energy == pytest.approx(1.5 * 144 - 2 * 9.81 * 0.8, rel=1e-13)


def test_a_rolling_mode_has_one_coordinate() -> None:
    built = statechart.run(model(), until=0.1).to_dict()["built"]["modes"]
    assert [mode["integrated"] for mode in built] == [["ball.angle"]]


@pytest.mark.parametrize("change", [mirrored, rescaled])
def test_the_image_moves_as_the_image(change: Any) -> None:
    declared = load("ball_in_a_bowl")
    image, reading = change(declared)
    one, other = Subject(declared).case({}).trace, Subject(image).case({}).trace
    assert [jump.cause for jump in one.jumps] == [jump.cause for jump in other.jumps]
    assert np.allclose(other.final * reading.factors, one.final, atol=1e-9)


def test_a_wheel_in_declared_coordinates_moves_as_a_free_one() -> None:
    rolls = scene("""
kind: scene
name: wheel
gravity: 9.81
coordinates: {turned: {start: 0, rate: 1}}
bodies: {wheel: {mass: 2, inertia: 0.3, position: [-0.5*turned, 0.5], angle: turned}}
surfaces: {ground: {height: 0}}
forces: {push: {body: wheel, force: [1, 0], at: [0, 0.1]}}
stop: {time: 1}
""")
    touches = scene("""
kind: scene
name: wheel
gravity: 9.81
bodies: {wheel: {mass: 2, inertia: 0.3, start: {y: 0.5, dx: -0.5, dangle: 1}}}
surfaces: {ground: {height: 0}}
contacts: {rim: {point: {body: wheel}, radius: 0.5, surface: ground, modes: [pin]}}
forces: {push: {body: wheel, force: [1, 0], at: [0, 0.1]}}
stop: {time: 1}
""")
    one, other = run(rolls, "taylor", 1.0), run(touches, "taylor", 1.0)
    assert other.final[2] == pytest.approx(one.final[0], abs=1e-13)
    assert other.final[0] == pytest.approx(-0.5 * one.final[0], abs=1e-13)
