"""Positions to equations of motion, against published ones."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from contacts.event_driven.laws import SceneLaws
from contacts.kind import automaton
from contacts.scene.joints import Force
from contacts.scene.parts import Body, Coordinate
from contacts.scene.scene import Scene
from statechart.automaton.automaton import Places


def snapshot(scene: Scene, state: list[float]):
    built = automaton(scene)
    laws = built.laws
    assert isinstance(laws, SceneLaws)
    setup = built.setup({}, 1e-16)
    return laws.tape.at(setup.values, np.array(state), 0.3)


def test_a_two_link_walker_has_the_published_equations() -> None:
    m, mH, a, b, g = 5.0, 10.0, 0.5, 0.5, 9.81
    length = a + b
    hip = ["-l*sin(s)", "l*cos(s)"]
    scene = Scene(
        name="legs",
        parameters={"m": m, "mH": mH, "a": a, "b": b, "l": "a + b", "g": g},
        gravity="g",
        coordinates={"ns": Coordinate(), "s": Coordinate()},
        bodies={
            "hip": Body(mass="mH", position=hip),
            "stance": Body(mass="m", position=["-a*sin(s)", "a*cos(s)"]),
            "swing": Body(mass="m", position=[f"{hip[0]} + b*sin(ns)", f"{hip[1]} - b*cos(ns)"]),
        },
    )
    ns, s, dns, ds = -0.32, 0.22, -0.38, -1.09
    found = snapshot(scene, [ns, s, dns, ds])
    acceleration = np.linalg.solve(found.mass, found.forces)
    # Goswami, Thuilot, Espiau: the compass gait's equations, D = s - ns.
    D, cos, sin = s - ns, np.cos, np.sin
    left = np.array(
        [
            [m * b**2, -m * length * b * cos(D)],
            [-m * length * b * cos(D), (mH + m) * length**2 + m * a**2],
        ]
    )
    right = -np.array(
        [
            m * length * b * sin(D) * ds**2 + m * g * b * sin(ns),
            -m * length * b * sin(D) * dns**2 - g * (m * a + mH * length + m * length) * sin(s),
        ]
    )
    assert acceleration == pytest.approx(np.linalg.solve(left, right), rel=1e-13)


def test_energy_of_a_pendulum_with_inertia() -> None:
    scene = Scene(
        name="pendulum",
        parameters={"g": 9.81},
        gravity="g",
        coordinates={"phi": Coordinate()},
        bodies={"bob": Body(mass=2, inertia=0.3, position=["sin(phi)", "-cos(phi)"], angle="phi")},
    )
    found = snapshot(scene, [0.4, 1.5])
    assert found.energy == pytest.approx(0.5 * (2 + 0.3) * 1.5**2 - 2 * 9.81 * np.cos(0.4))
    assert found.mass == pytest.approx(np.array([[2.3]]))
    assert found.forces == pytest.approx(np.array([-2 * 9.81 * np.sin(0.4)]))


def test_a_driven_pivot_moves_the_bob() -> None:
    scene = Scene(
        name="cart",
        coordinates={"phi": Coordinate()},
        bodies={"bob": Body(mass=1, position=["sin(phi)", "-cos(phi)"])},
        forces={"push": Force(body="bob", force=["3*time", 0])},
    )
    found = snapshot(scene, [0.5, 0.0])
    assert found.forces == pytest.approx([3 * 0.3 * np.cos(0.5)])


def test_a_moment_and_a_force_off_centre_turn_a_body() -> None:
    scene = Scene(
        name="plate",
        bodies={"plate": Body(mass=2, inertia=4)},
        forces={"couple": Force(body="plate", force=[0, 3], at=[0.5, 0], moment=1)},
    )
    found = snapshot(scene, [0.0] * 6)
    assert np.linalg.solve(found.mass, found.forces) == pytest.approx([0.0, 1.5, 2.5 / 4])


def particles(count: int) -> Scene:
    """Return particles above the ground, with a contact each."""
    heights = {f"p{i}": 1.0 + 0.1 * i for i in range(count)}
    return Scene(
        name="particles",
        gravity=9.81,
        bodies={name: {"mass": 1, "start": {"y": y}} for name, y in heights.items()},
        surfaces={"ground": {"height": 0}},
        contacts={
            f"c{name}": {
                "point": {"body": name},
                "surface": "ground",
                "friction": 0.3,
                "restitution": 0,
            }
            for name in heights
        },
    )


def test_the_cost_of_composition_is_linear_in_the_number_of_independent_bodies() -> None:
    def calls(count: int) -> int:
        scene, made = particles(count), 0

        def called(frame: object, event: str, argument: object) -> None:
            nonlocal made
            made += event == "call"

        sys.setprofile(called)
        try:
            built = automaton(scene)
            for component in built.components():
                Places(component, built)
        finally:
            sys.setprofile(None)
        return made

    calls(2)
    assert calls(80) < 2.1 * calls(40)
