"""Powers of zero and nearly zero values, against an independent integration."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from runs import ENGINES
from scipy.integrate import quad, solve_ivp
from strategies import examples

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner, run

CHART = """\
kind: chart
name: flow
parameters: {{x0: 0, a: 1, b: 1, c: 1}}
variables: {{x: x0, y: 0}}
regions: {{r: {{initial: s, states: {{s: {{flows: {{x: '{x}', y: '{y}'}}}}}}, transitions: []}}}}
stop: {{time: 2}}
"""
SCENE = """\
kind: scene
name: flow
gravity: {gravity}
parameters: {{x0: 0, a: 1, b: 1, c: 1}}
bodies: {{p: {{mass: 2, {inertia} start: {{x: x0, {start}}}}}}}
stop: {{time: 1.5}}
"""
FORCE = SCENE + "forces: {{f: {{body: p, force: ['{force}', 0]}}}}\n"
HEIGHT = SCENE + (
    "surfaces: {{s: {{height: b*x**{p}}}}}\n"
    "contacts: {{k: {{point: {{body: p}}, surface: s, friction: 0, modes: [slide]}}}}\n"
)
PATH = SCENE + "joints: {{j: {{point: {{body: p, at: [0, 0.5]}}, to: ['{path}', 0.5]}}}}\n"

Numbers = dict[str, float]


def flow(p: int, q: int, n: Numbers) -> Callable[[float, np.ndarray], list[float]]:
    return lambda t, z: [n["a"] - n["b"] * z[0] ** p, n["c"] * t**q - z[0] ** q * z[1]]


def drag(p: int, q: int, n: Numbers) -> Callable[[float, np.ndarray], list[float]]:
    return lambda t, z: [z[2], z[3], (n["a"] * t**q - n["b"] * z[2] ** p) / 2, 0.0]


def spring(p: int, q: int, n: Numbers) -> Callable[[float, np.ndarray], list[float]]:
    return lambda t, z: [z[2], z[3], (n["c"] - n["b"] * z[0] ** p - z[2] ** q) / 2, 0.0]


def valley(p: int, q: int, n: Numbers) -> Callable[[float, np.ndarray], list[float]]:
    def rates(t: float, z: np.ndarray) -> list[float]:
        x, v, b = z[0], z[2], n["b"]
        slope, bend = b * p * x ** (p - 1), b * p * (p - 1) * x ** (p - 2)
        a = -slope * (9.81 + bend * v * v) / (1 + slope**2)
        return [v, slope * v, a, bend * v * v + slope * a]

    return rates


def hung(p: int, q: int, n: Numbers) -> Callable[[float, np.ndarray], list[float]]:
    # A pendulum of mass 2 and inertia 1, held 0.5 above its centre at x = a t**p + c t**q.
    def rates(t: float, z: np.ndarray) -> list[float]:
        pull = n["a"] * p * (p - 1) * t ** (p - 2) + n["c"] * q * (q - 1) * t ** (q - 2)
        turn = -2 * 0.5 * (9.81 * math.sin(z[2]) + pull * math.cos(z[2])) / (1 + 2 * 0.25)
        return [0.0, 0.0, z[5], 0.0, 0.0, turn]

    return rates


KINDS = {
    "flow": (CHART, flow, {"x": "a - b*x**{p}", "y": "c*time**{q} - x**{q}*y"}),
    "drag": (FORCE, drag, {"force": "a*time**{q} - b*p.dx**{p}"}),
    "spring": (FORCE, spring, {"force": "c - b*p.x**{p} - p.dx**{q}"}),
    "valley": (HEIGHT, valley, {"p": "{p}"}),
    "hung": (PATH, hung, {"path": "a*time**{p} + c*time**{q}"}),
}


@functools.cache
def runner(what: str, p: int, q: int, engine: str) -> Runner:
    text, _, holes = KINDS[what]
    filled = {name: hole.format(p=p, q=q) for name, hole in holes.items()}
    filled |= {"gravity": "9.81" if what in ("valley", "hung") else "0"}
    filled |= {"inertia": "inertia: 1," if what == "hung" else ""}
    start = f"y: b*x0**{p}, dx: a, dy: a*b*{p}*x0**{p - 1}" if what == "valley" else "y: 0"
    filled |= {"start": start}
    document = read_text(text.format(**filled))
    return Runner(document, engine=engine)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@examples(12)
@example(what="drag", p=5, q=2, x0=0.0, a=0.359375, b=0.3125, c=1.0)
@given(
    what=st.sampled_from(list(KINDS)),
    p=st.sampled_from([3, 4, 5]),
    q=st.sampled_from([2, 7]),
    x0=st.sampled_from([0.0, 1e-300, 1e-30, 1e-9, 1e-3, 0.1]),
    a=st.floats(0.1, 1.0),
    b=st.floats(0.1, 1.0),
    c=st.floats(0.1, 1.0),
)
def test_integer_powers_of_series_that_start_at_zero_are_exact(
    what: str, p: int, q: int, x0: float, a: float, b: float, c: float
) -> None:
    numbers = {"x0": 0.0 if what == "hung" else x0, "a": a, "b": b, "c": c}
    found = runner(what, p, q, "taylor").run(numbers, throw=False).trace
    assert found.outcome is Outcome.HORIZON
    assert found.certified
    expected = solve_ivp(
        KINDS[what][1](p, q, numbers),
        (0.0, found.t_end),
        found.initial,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        max_step=0.02,  # of a drag of order 5 from rest longer ones see nothing
    ).y[:, -1]
    if what == "hung":  # only its angle and its rate are integrated
        assert found.final[[2, 5]] == pytest.approx(expected[[2, 5]], abs=1e-9)
    else:
        assert found.final == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("power", [2, 3, 4, 6, 8, 12, 24, 64])
@pytest.mark.parametrize("start", [0.0, 1e-300, 1e-9])
def test_vanishing_last_terms_do_not_lengthen_steps(power: int, start: float) -> None:
    text = read_text(CHART.format(x=f"1 - x**{power}", y="0"))
    for engine in ENGINES:
        # By quadrature of dt = dx / (1 - x**n), as long as x is not near 1.
        x = run(text, engine=engine, parameters={"x0": start}, until=0.99).trace.final[0]
        time, _ = quad(lambda u: 1 / (1 - u**power), start, x, epsabs=1e-13, epsrel=1e-13)
        assert time == pytest.approx(0.99, abs=1e-10)
        # Beyond, 1 - x falls by exp(-n t) in the end, and faster before.
        later = run(text, engine=engine, parameters={"x0": start}).trace.final[0]
        assert -1e-11 < 1 - later <= (1 - x) * math.exp(-1.01 * (1 - x**power) / (1 - x)) + 1e-11


@pytest.mark.parametrize(("n", "x0"), [(2, 0.0), (4, 0.0), (3, 0.1), (4, 0.1), (7, -0.3)])
def test_a_valley_whose_exponent_is_a_parameter_is_crossed_at_zero(n: int, x0: float) -> None:
    scene = HEIGHT.format(gravity=9.81, inertia="", p="n", start="y: b*x0**n, dx: a, dy: d")
    runner = Runner(read_text(scene.replace("c: 1}", "c: 1, n: 4, d: 0}")))
    found = runner.run({"n": n, "x0": x0, "d": n * x0 ** (n - 1)}).trace
    assert found.certified
    assert found.engine.startswith("scipy")  # as a power by a parameter has no series at zero
    at = {"a": 1.0, "b": 1.0, "c": 1.0}
    expected = solve_ivp(
        valley(n, 0, at), (0.0, 1.5), found.initial, method="DOP853", rtol=1e-12, atol=1e-14
    ).y[:, -1]
    assert found.final == pytest.approx(expected, abs=1e-9)


def test_force_flat_at_period_ends_is_resolved() -> None:
    text = CHART.format(x="sin(2*pi*time)**22", y="0")
    x = run(read_text(text), engine="taylor", until=10.0).trace.final[0]
    assert x == pytest.approx(10 * math.comb(22, 11) / 2**22, rel=1e-12)


@pytest.mark.parametrize("rate", ["1 - x**1.5", "1 - x**(1/3)", "1 - hypot(x, y)", "1 - x**(3*b)"])
def test_singular_powers_use_scipy_with_a_warning(rate: str) -> None:
    text = CHART.format(x=rate, y="0")
    found = run(read_text(text))
    assert found.trace.engine.startswith("scipy")
    assert any("has no Taylor series at t = 0" in warning for warning in found.warnings)
    assert run(read_text(text), engine="taylor", throw=False).trace.outcome is Outcome.UNSUPPORTED


def test_a_rate_that_ends_at_zero_ends_the_run() -> None:
    text = CHART.format(x="-sqrt(x)", y="0")
    found = run(read_text(text), parameters={"x0": 0.25}, engine="taylor", throw=False).trace
    assert found.outcome is Outcome.STEP_FAILURE
    assert found.t_end == pytest.approx(1.0, abs=1e-12)
