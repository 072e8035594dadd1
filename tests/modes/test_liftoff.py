"""Lift-off: round-off jams nothing, and no force acts without a cause."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from runs import ENGINES, engine
from strategies import examples

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator
from statechart.running.runner import run

SCENE = """\
kind: scene
name: lift
gravity: -g
parameters: {a: 0, v: 1, g: 9.81, m: 1, k: 0.1, x: 0, y: 0, p0: 0, p1: 0, p2: 0,
             mu0: 1, mu1: 1, mu2: 1}
bodies: {b: {mass: m, INERTIA start: {x: x, y: y, dx: v*cos(a), dy: v*sin(a)}}}
surfaces: {s: {incline: a, through: [x, y]}}
contacts:
"""
CONTACT = (
    "  c{0}: {{point: {{body: b, at: [p{0}*cos(a), p{0}*sin(a)]}}, surface: s, friction: mu{0}, "
    "restitution: 0}}\n"
)


@cache
def scene(count: int, turns: bool) -> Scene:
    """Return a particle, or a body that turns, on an incline that gravity pulls it off."""
    text = SCENE.replace("INERTIA", "inertia: m*k," if turns else "")
    return validate(read_text(text + "".join(map(CONTACT.format, range(count)))), Scene)


@cache
def simulator(count: int, turns: bool, name: str) -> Simulator:
    return Simulator(automaton(scene(count, turns)), engine(name))


friction = st.one_of(
    st.just(math.inf), st.floats(0.05, 3.0), st.floats(0.0, 8.0).map(lambda p: 10**p)
)
place = st.sampled_from((0.0, 0.3, -0.2, 0.7))
parameters = st.fixed_dictionaries(
    {
        "a": st.floats(-1.5, 1.5),
        "v": st.one_of(st.sampled_from((-1.0, 1.0)), st.floats(-3.0, 3.0)),
        "m": st.sampled_from((1.0, 10.0, 0.3)),
        "k": st.floats(-3.0, 1.0).map(lambda p: 10**p),
        "x": st.sampled_from((0.0, 1.3)),
        "y": st.sampled_from((0.0, -0.7)),
        **{f"mu{i}": friction for i in range(3)},
        **{f"p{i}": place for i in range(3)},
    }
)


# Numbers so small that the power of two which brings them to size 1 overflows.
SUBNORMAL = {"a": 2.225073858507203e-309, "v": -1.0, "m": 1.0, "k": 1.0, "x": 0.0, "y": -0.7}
PINNED = {f"mu{i}": math.inf for i in range(3)} | {"p0": 0.0, "p1": 0.0, "p2": 0.3}


@examples(25)
@example(count=3, turns=False, name="taylor", given=SUBNORMAL | PINNED)
@given(
    count=st.integers(1, 3), turns=st.booleans(), name=st.sampled_from(ENGINES), given=parameters
)
def test_bodies_pulled_off_by_gravity_fly(
    count: int, turns: bool, name: str, given: dict[str, float]
) -> None:
    known = scene(count, turns).parameters
    built = simulator(count, turns, name)
    trace = built.run({k: v for k, v in given.items() if k in known}, until=1.0)
    a, v = given["a"], given["v"]
    assert trace.modes == (("free",) * count,)
    final = dict(zip(trace.variables, trace.final, strict=True))
    assert final["b.dx"] == pytest.approx(v * math.cos(a), abs=1e-12)
    assert final["b.dy"] == pytest.approx(v * math.sin(a) + 9.81, abs=1e-11)
    assert final["b.y"] == pytest.approx(given["y"] + v * math.sin(a) + 9.81 / 2, abs=1e-11)


TWO_RODS = """\
kind: scene
name: two_rods
gravity: 1
parameters: {phi: 0.6, omega: 3, v: -1, mu: 0.2}
bodies:
  A: {mass: 1, inertia: 1/3, start: {x: sin(phi), y: cos(phi), angle: -phi,
      dx: v + cos(phi)*omega, dy: -sin(phi)*omega, dangle: -omega}}
  B: {mass: 1, inertia: 1/3, start: {x: 5 + sin(phi), y: cos(phi), angle: -phi,
      dx: v + cos(phi)*omega, dy: -sin(phi)*omega, dangle: -omega}}
surfaces: {floor: {height: 0}}
contacts:
  a: {point: {body: A, at: [0, -1]}, surface: floor, friction: 2, restitution: 0}
  b: {point: {body: B, at: [0, -1]}, surface: floor, friction: mu, restitution: 0}
"""


@pytest.mark.parametrize("mu", [0.0, 0.2, 2.0])
def test_an_indeterminate_contact_is_free_whatever_another_body_does(mu: float) -> None:
    rods = Simulator(automaton(validate(read_text(TWO_RODS), Scene)), engine("scipy"))
    trace = rods.run({"mu": mu}, until=0.01)
    assert trace.start_mode == ("free", "free")
    assert any("indeterminate" in warning for warning in trace.warnings)


@pytest.mark.parametrize("a", [-0.84, 0.3])
@pytest.mark.parametrize("name", ENGINES)
def test_infinite_friction_stops_a_particle_that_is_pressed(name: str, a: float) -> None:
    given = {"a": a, "v": -1.0, "g": -9.81, "mu0": math.inf}
    trace = simulator(1, False, name).run(given, until=1.0)
    assert [jump.cause for jump in trace.jumps] == ["jam"]
    assert trace.final_mode == ("pin",)
    assert np.abs(trace.final).max() == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("mu", [0.3, math.inf])
@pytest.mark.parametrize("a", [-0.84, 0.3])
def test_time_steps_release_the_particle(a: float, mu: float) -> None:
    given = {"a": a, "v": -1.0, "mu0": 0.3, "mu1": mu}
    trace = run(scene(2, False), parameters=given, until=1.0, engine="impulse", step=0.01).trace
    assert trace.modes == (("free", "free"),)
    assert trace.final[3] == pytest.approx(9.81 - math.sin(a), abs=1e-9)
