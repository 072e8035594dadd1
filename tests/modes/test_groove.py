"""A disc in a groove: four components of force, three equations, and forces on both edges."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES
from scipy.optimize import linprog

from contacts.solvers.smallest_forces import smallest_forces
from statechart import Runner
from statechart.arrays import Array
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

_RADIUS, _GRAVITY, _MASS, _FRICTION, _SLOPE = 0.05, 9.81, 2.0, 0.3, 0.7
_SCENE = """
kind: scene
name: groove
gravity: 9.81
parameters: {a: 0.7, b: 0.7, mu: 0.3, moment: 0, growth: 0, swing: 0, push: 0, height: 0}
bodies:
  disc:
    mass: 2
    inertia: 0.02
    start:
      x: (cos(b) - cos(a))*0.05/sin(a + b)
      y: (sin(a) + sin(b))*0.05/sin(a + b) + height
surfaces: {left: {incline: -a}, right: {incline: b}}
contacts:
  l: {point: {body: disc}, surface: left, radius: 0.05, friction: mu, restitution: 0}
  r: {point: {body: disc}, surface: right, radius: 0.05, friction: mu, restitution: 0}
forces:
  load: {body: disc, force: [push*time, 0], moment: moment + growth*time + swing*sin(9*time)}
stop: {time: 1}
outputs:
  Vl: {value: l.V}
  Hl: {value: l.H}
  Vr: {value: r.V}
  Hr: {value: r.H}
  slip: {value: time, at: first slip}
"""


def _forces(result: Result) -> list[float | None]:
    return [result.outputs[name] for name in ("Vl", "Hl", "Vr", "Hr")]


def _smallest(a: float, b: float, mu: float, push: float, moment: float) -> list[float]:
    """Return V and H of both contacts: smallest along the line of forces that balance the load."""
    reach = _reach(a, b)
    load = np.array([push, -_MASS * _GRAVITY, moment])
    columns = reach.reshape(4, 3).T
    particular = np.linalg.lstsq(columns, -load, rcond=None)[0]
    free = np.linalg.svd(columns)[2][3]
    # mu V - H and mu V + H of both contacts are c + s d >= 0.
    edges = np.array([[mu, -1, 0, 0], [mu, 1, 0, 0], [0, 0, mu, -1], [0, 0, mu, 1]])
    c, d = edges @ particular, edges @ free
    low = max((-c[d > 0] / d[d > 0]).tolist(), default=-math.inf)
    high = min((-c[d < 0] / d[d < 0]).tolist(), default=math.inf)
    assert low <= high
    wanted: list[float] = (particular + min(max(0.0, low), high) * free).tolist()
    return wanted


def _reach(a: float, b: float) -> Array:
    rows = []
    for angle in (-a, b):
        normal, tangent = (-math.sin(angle), math.cos(angle)), (math.cos(angle), math.sin(angle))
        # At the point -R n a force along the tangent has the moment R.
        rows.append([[*normal, 0.0], [*tangent, _RADIUS]])
    return np.array(rows)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("height", [0, 0.2])
def test_a_disc_rests_evenly_on_both_sides(engine: str, height: float) -> None:
    result = Runner(read_text(_SCENE), engine=engine).run({"height": height})
    assert result.trace.modes[-1] == ("pin", "pin")
    even = _MASS * _GRAVITY / 2 / (math.cos(_SLOPE) + _FRICTION * math.sin(_SLOPE))
    wanted = [even, -_FRICTION * even, even, _FRICTION * even]
    assert _forces(result) == pytest.approx(wanted, rel=1e-12)
    assert result.trace.certified
    assert [*result.warnings] == ["the forces of l, r are indeterminate: the smallest are shown"]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("growth", [1.0, -1.0])
def test_a_growing_moment_turns_the_disc_at_its_limit(engine: str, growth: float) -> None:
    result = Runner(read_text(_SCENE), engine=engine).run({"growth": growth})
    slides = "slide+" if growth > 0.0 else "slide-"
    assert result.trace.modes == (("pin", "pin"), (slides, slides))
    # Both forces are turned by atan(mu) from the normal, to the same side.
    mu = _FRICTION
    limit = _RADIUS * _MASS * _GRAVITY * mu / ((1.0 + mu * mu) * math.cos(_SLOPE))
    assert result.outputs["slip"] == pytest.approx(limit, rel=1e-9)


@pytest.mark.parametrize(
    ("values", "moment"),
    [
        ({"growth": 0.3}, 0.3),
        ({"swing": 0.1}, 0.1 * math.sin(9.0)),
        ({"push": 5.0}, 0.0),
        ({"push": -5.0, "growth": -0.1}, -0.1),
        ({"a": 1.1, "b": 0.4, "moment": 0.05, "growth": -0.1}, -0.05),
        # The cones all but contain the line between the contacts: the disc is held by a vice.
        ({"a": math.pi / 4, "b": 1.317, "mu": 0.573, "growth": 1.11, "moment": 0.016}, 1.126),
    ],
)
def test_a_disc_at_rest_has_the_smallest_forces(values: dict[str, float], moment: float) -> None:
    result = Runner(read_text(_SCENE), engine="taylor").run(values)
    assert result.trace.modes == (("pin", "pin"),)
    a, b, mu = (values.get(name, usual) for name, usual in (("a", 0.7), ("b", 0.7), ("mu", 0.3)))
    wanted = _smallest(a, b, mu, values.get("push", 0.0), moment)
    assert _forces(result) == pytest.approx(wanted, rel=1e-7)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("off", [0.0, 1e-15, 1e-13, -1e-12, 1e-10, 1e-3])
def test_smallest_forces_lie_on_the_edges_of_both_cones(seed: int, off: float) -> None:
    generator = np.random.default_rng(seed)
    a, b = generator.uniform(0.2, 1.4, 2)
    mu = generator.uniform(0.05, 0.9)
    reach = _reach(a, b)
    cone = np.array([1.0, mu, np.inf]) / math.hypot(1.0, mu)
    # On opposite edges forces are at an end of the range of forces that balance the load.
    sides = generator.choice([-1.0, 1.0]) * np.array([1.0, -1.0])
    along = np.stack([[cone[0], side * cone[1]] for side in sides])
    load = np.einsum("gd,gdn->n", along * generator.uniform(1, 2, (2, 1)), reach)
    load += off * generator.normal(size=3)
    edges = np.concatenate([cone[0] * r[:1] + s * cone[1] * r[1:] for r in reach for s in (1, -1)])
    room = linprog(np.zeros(4), A_eq=edges.T, b_eq=load)
    found, forces, _, violation = smallest_forces(
        np.array([cone, cone]), np.zeros(2), reach, load, 0.0
    )
    if off < 1e-3 or room.status == 0:
        assert found
        assert violation <= 1e-12
        assert np.einsum("gd,gdn->n", forces, reach) == pytest.approx(load, abs=1e-12)
