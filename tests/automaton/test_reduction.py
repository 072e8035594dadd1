"""Minimal coordinates reproduce the motion in all coordinates, without drift."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp
from runs import ENGINES, engine
from runs import automaton as shipped
from scipy.integrate import solve_ivp

from contacts.kind import automaton as compose
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.modes import build_mode, mode_reconstruction
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Role
from statechart.execution.simulator import Simulator

PIN = "pin"


def scene(**declared: Any) -> Automaton:
    return compose(Scene.model_validate({"name": "s", **declared}))


def mode_of(automaton: Automaton, *states: str, zeros: frozenset[sp.Symbol] = frozenset()) -> Mode:
    return build_mode(automaton, tuple(Role(state) for state in states), zeros)


def whole(automaton: Automaton) -> Automaton:
    """Return the automaton without minimal coordinates."""
    return replace(automaton, coordinates=None)


def zeros_of(automaton: Automaton) -> frozenset[sp.Symbol]:
    return frozenset(automaton.parameters[i] for i in automaton.setup({}, 1e-12).zeros)


def solved(automaton: Automaton, mode: Mode, state: Array, parameters: Array, t: float) -> Array:
    """Return the accelerations and forces of a mode."""
    return automaton.tape(automaton.unknowns, mode).values(state, parameters, t)


def names(automaton: Automaton, mode: Mode) -> list[str]:
    return [automaton.names[place] for place in mode.eliminated]


ROD = {"mass": "m", "inertia": "I", "start": {"x": 0.3, "y": "cos(0.3)", "angle": -0.3}}


def pinned_rod(**more: Any) -> Automaton:
    """A rod of unit length below its centre, on flat ground."""
    return scene(
        **{
            "parameters": {"m": 2, "I": 0.3, "mu": 5},
            "gravity": 9.81,
            "bodies": {"rod": ROD},
            "surfaces": {"ground": {"height": 0}},
            "contacts": {
                "tip": {
                    "point": {"body": "rod", "at": [0, -1]},
                    "surface": "ground",
                    "friction": "mu",
                    "restitution": 0,
                }
            },
            **more,
        }
    )


@pytest.mark.parametrize("inertia", [0.3, 1e-9, 0.0])
def test_the_hinge_phase_is_the_papers_section_4_3(inertia: float) -> None:
    model = shipped("toppling_stick")
    M, g, L, lean, rate = 1.7, 9.81, 0.6, 0.4, -2.3
    setup = model.setup({"M": M, "g": g, "L": L, "I_G": inertia}, 1e-12)
    gone = frozenset(model.parameters[i] for i in setup.zeros)
    mode = mode_of(model, PIN, zeros=gone)
    assert names(model, mode) == ["stick.x", "stick.y", "stick.dx", "stick.dy"]
    # The values of eliminated variables do not matter.
    state = np.array([7.0, 8.0, -lean, 9.0, 10.0, -rate])
    *_, turning, V, H = solved(model, mode, state, setup.values, 0.0)
    expected = M * g * L * math.sin(lean) / (inertia + M * L**2)
    assert -turning == pytest.approx(expected, rel=1e-14)
    # The centre is at L (sin, cos) of the lean.
    along = L * (math.cos(lean) * expected - math.sin(lean) * rate**2)
    down = L * (math.sin(lean) * expected + math.cos(lean) * rate**2)
    assert pytest.approx(M * along, rel=1e-13) == H
    assert pytest.approx(M * (g - down), rel=1e-13) == V


def test_a_pinned_point_stays_where_it_was_when_it_was_pinned() -> None:
    model = pinned_rod()
    mode = mode_of(model, PIN)
    setup = model.setup({}, 1e-12)
    begun = np.array([3.0, math.cos(0.2), -0.2, 0.0, 0.0, 0.7])
    reconstruction = mode_reconstruction(model, mode).start(begun, setup.values, 0.0)
    point = 3.0 - math.sin(0.2)
    found = reconstruction.onto(np.array([0.0, 0.0, -0.9, 0.0, 0.0, 0.7]), 1.0)
    expected = [point + math.sin(0.9), math.cos(0.9), -0.9, -math.cos(0.9) * 0.7]
    assert found[:4] == pytest.approx(expected, abs=1e-15)
    assert found[4] == pytest.approx(0.7 * math.sin(0.9), abs=1e-15)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("moving", [False, True])
def test_minimal_coordinates_reproduce_full_motion(name: str, moving: bool) -> None:
    plate = {"height": 0}
    if moving:
        plate |= {"displacement": ["0.1*sin(3*time)", "0.05*cos(2*time)"]}
    start = {"x": 0.3, "y": "cos(0.3)", "angle": -0.3}
    if moving:
        start |= {"y": "cos(0.3) + 0.05", "dx": 0.3}
    model = pinned_rod(surfaces={"ground": plate}, bodies={"rod": {**ROD, "start": start}})
    found = Simulator(model, engine(name)).run(until=0.4)
    expected = Simulator(whole(model), engine(name)).run(until=0.4)
    assert found.start_mode == (PIN,)
    assert found.final == pytest.approx(expected.final, abs=1e-11)


def chain(random: np.random.Generator, count: int, loop: bool) -> Automaton:
    """A tree of bodies on joints; in a loop where the last one is jointed to the ground, too."""
    bodies: dict[str, Any] = {}
    joints: dict[str, Any] = {}
    arms: list[tuple[Array, Array]] = []
    centres: list[Array] = []
    for k in range(count):
        angle = random.uniform(-1.5, 1.5)
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        near, far = random.uniform(-1, 1, 2), random.uniform(-1, 1, 2)
        parent = int(random.integers(0, k)) if k else 0
        place = centres[parent] + arms[parent][1] if k else np.zeros(2)
        centres.append(place - turned @ near)
        arms.append((near, turned @ far))
        x, y = centres[k].tolist()
        bodies[f"b{k}"] = {
            "mass": random.uniform(0.5, 2),
            "inertia": random.uniform(0.1, 1),
            "start": {"x": x, "y": y, "angle": angle},
        }
        target: Any = [0, 0]
        if k:
            there = np.linalg.solve(
                np.array(
                    [
                        [np.cos(a := bodies[f"b{parent}"]["start"]["angle"]), -np.sin(a)],
                        [np.sin(a), np.cos(a)],
                    ]
                ),
                arms[parent][1],
            )
            target = {"body": f"b{parent}", "at": there.tolist()}
        joints[f"j{k}"] = {"point": {"body": f"b{k}", "at": near.tolist()}, "to": target}
    if loop:
        end = bodies[f"b{count - 1}"]["start"]
        joints["last"] = {
            "point": {"body": f"b{count - 1}", "at": [0, 0]},
            "to": [end["x"], end["y"]],
        }
    return scene(gravity=9.81, bodies=bodies, joints=joints)


@pytest.mark.parametrize("seed", range(8))
def test_random_linkages_accelerate_as_in_all_coordinates(seed: int) -> None:
    random = np.random.default_rng(seed)
    model = chain(random, 2 + seed % 3, loop=False)
    zeros = zeros_of(model)
    mode = mode_of(model, zeros=zeros)
    size = len(model.variables) // 2
    assert len(mode.eliminated) == 2 * (size - size // 3)
    setup = model.setup({}, 1e-12)
    reconstruction = mode_reconstruction(model, mode).start(setup.initial, setup.values, 0.0)
    full = mode_of(whole(model), zeros=zeros)
    for _ in range(5):
        state = reconstruction.onto(random.uniform(-2, 2, 2 * size), 0.0)
        found = solved(model, mode, state, setup.values, 0.0)
        expected = solved(model, full, state, setup.values, 0.0)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-10)


def test_a_closed_loop_keeps_all_coordinates() -> None:
    model = chain(np.random.default_rng(3), 3, loop=True)
    assert mode_of(model, zeros=zeros_of(model)).eliminated == {}


@pytest.mark.parametrize("hill", [{"circle": [0, 0], "radius": 1}, {"incline": "steep"}])
def test_discs_and_placed_bodies_keep_all_coordinates(hill: dict[str, Any]) -> None:
    ball = scene(
        parameters={"steep": 1.5},
        gravity=1,
        bodies={"ball": {"mass": 1, "start": {"y": 1}}},
        surfaces={"hill": hill},
        contacts={
            "c": {
                "point": {"body": "ball"},
                "surface": "hill",
                "modes": ["free", "slide"],
                "friction": 0,
                "restitution": 0,
            }
        },
    )
    assert mode_of(ball, "slide").eliminated == {}


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize(
    ("height", "slope", "bend"),
    [
        ("x**2", lambda x: 2 * x, lambda x: 2.0),
        ("1000*x**4", lambda x: 4e3 * x**3, lambda x: 12e3 * x**2),
        ("cosh(x) - 1", math.sinh, math.cosh),
    ],
)
def test_a_bead_follows_the_height_of_its_bowl(
    name: str,
    height: str,
    slope: Callable[[float], float],
    bend: Callable[[float], float],
) -> None:
    model = scene(
        gravity=9.81,
        bodies={"bead": {"mass": 2, "start": {"dx": 4}}},
        surfaces={"bowl": {"height": height}},
        contacts={
            "c": {"point": {"body": "bead"}, "surface": "bowl", "modes": ["slide"], "friction": 0}
        },
    )
    trace = Simulator(model, engine(name)).run(until=1.5)
    (arc,) = trace.arcs
    assert names(model, mode_of(model, "slide")) == ["bead.y", "bead.dy"]
    x, y, dx, dy = arc.coefficients[:, :, 0].T
    profile = sp.lambdify(sp.Symbol("x"), sp.sympify(height))
    assert dy == pytest.approx(np.array([slope(u) for u in x]) * dx, rel=1e-14, abs=1e-15)
    assert y == pytest.approx(profile(x), rel=1e-14, abs=1e-15)
    energy = (dx**2 + dy**2) / 2 + 9.81 * y
    assert np.abs(energy / 8 - 1).max() < (1e-13 if name == "taylor" else 1e-9)

    def rates(t: float, state: Array) -> list[float]:
        # Rate of x along the bowl, from the energy by hand.
        u, v = state
        f = slope(u)
        return [v, -f * (bend(u) * v * v + 9.81) / (1 + f * f)]

    if name == "taylor":
        expected = solve_ivp(rates, (0, 1.5), [0, 4], method="DOP853", rtol=1e-13, atol=1e-14)
        assert trace.final[0] == pytest.approx(expected.y[0, -1], abs=2e-11)


def test_sliding_friction_keeps_all_coordinates() -> None:
    assert mode_of(pinned_rod(), "slide+").eliminated == {}


def test_a_frictionless_slide_leaves_the_coordinate_along_the_line() -> None:
    model = pinned_rod(parameters={"m": 2, "I": 0.3, "mu": 0})
    zeros = zeros_of(model)
    assert names(model, mode_of(model, "slide+", zeros=zeros)) == ["rod.y", "rod.dy"]


@pytest.mark.parametrize("name", ENGINES)
def test_a_pendulum_does_not_drift_off_its_joint(name: str) -> None:
    joint = {"point": {"body": "rod", "at": [0, -1]}, "to": [0, 0]}
    start = ROD | {"start": {"x": "sin(0.3)", "y": "cos(0.3)", "angle": -0.3}}
    model = scene(
        parameters={"m": 2, "I": 0.3}, gravity=9.81, bodies={"rod": start}, joints={"pivot": joint}
    )
    trace = Simulator(model, engine(name)).run(until=100.0)
    (arc,) = trace.arcs
    x, y, angle, dx, dy, rate = arc.coefficients[:, :, 0].T
    assert np.abs(x + np.sin(angle)).max() < 1e-15
    assert np.abs(y - np.cos(angle)).max() < 1e-15
    assert np.abs(dx + np.cos(angle) * rate).max() < 1e-14
    assert np.abs(dy + np.sin(angle) * rate).max() < 1e-14


def test_feet_do_not_drift_off_the_slope() -> None:
    model = shipped("compass_walker")
    trace = Simulator(model, engine("taylor")).run(until=20.0)
    gaps = [model.observables[f"foot_{which}.gap"] for which in ("one", "two")]
    tape = model.tape(gaps)
    pinned = 0
    for arc in trace.arcs:
        for contact, state in enumerate(arc.mode):
            if state == PIN and "pin" not in arc.mode[:contact]:
                states = arc.coefficients[:, :, 0]
                found = tape.table(states, trace.values, np.zeros(len(states)))
                # Positions are up to 14: eight times their round-off in the last step.
                pinned += 1
                assert np.abs(found[:, contact] - found[0, contact]).max() < 8e-15
    assert pinned > 20
