"""Roots of squares, which SymPy makes absolute values of, on both engines."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.running.result import Result
from statechart.running.runner import run

FALLING = """\
kind: scene
name: falling
gravity: {gravity}
coordinates: {{q: {{start: {start}}}}}
bodies: {{b: {{mass: 1, position: {position}}}}}
surfaces: {{base: {{circle: [0, 0], radius: 1{hollow}}}}}
contacts: {{c: {{point: {{body: b}}, surface: base, modes: [free, slide], friction: 0,
  restitution: 0}}}}
stop: {{time: 1}}
outputs: {{t: {{value: time, at: first c.touchdown}}, q: {{value: q}}}}
"""
CHART = """\
kind: chart
name: rooted
variables: {{x: {x0}, v: 0}}
stop: {{time: 2}}
regions: {{r: {{initial: on, states: {{on: {{flows: {{x: {dx}, v: "{flow}"}}}}}}}}}}
outputs: {{v: {{value: v}}}}
"""


def taylor(text: str) -> Result:
    result = run(read_text(text))
    assert result.trace.engine == "taylor"
    return result


@pytest.mark.parametrize(
    ("gravity", "start", "position", "hollow", "rest"),
    [
        ("9.81", 1.2, "[0, q]", "", 1.0),
        ("[-9.81, 0]", 1.2, "[q, 0]", "", 1.0),
        ("[0, 9.81]", -1.2, "[0, q]", "", -1.0),
        ("9.81", -1.2, "[0, -q]", "", -1.0),
        ("9.81", 0.6, "[0, 2*q]", "", 0.5),
        ("9.81", 0.2, "[0, q + 1]", "", 0.0),
        ("9.81", -0.8, "[0, q]", ", hollow: true", -1.0),
        ("9.81", -1.2, "[0, sqrt(q**2)]", "", -1.0),
        ("9.81", -1.2, "[0, 'hypot(q, 0)']", "", -1.0),
    ],
)
def test_a_body_on_an_axis_falls_on_a_circle(
    gravity: str, start: float, position: str, hollow: str, rest: float
) -> None:
    text = FALLING.format(gravity=gravity, start=start, position=position, hollow=hollow)
    for result in (taylor(text), run(read_text(text), engine="scipy")):
        assert result.outputs["t"] == pytest.approx(math.sqrt(0.4 / 9.81), rel=1e-10)
        assert result.outputs["q"] == pytest.approx(rest, abs=1e-12)


@pytest.mark.parametrize(
    ("flow", "integral"),
    [
        ("sqrt(x**2)", lambda x: x * abs(x) / 2),
        ("sqrt(x**2 + 0)", lambda x: x * abs(x) / 2),
        ("sqrt((3*x)**2)", lambda x: 3 * x * abs(x) / 2),
        ("hypot(x, 0)", lambda x: x * abs(x) / 2),
        ("(x**2)**(3/2)", lambda x: x**3 * abs(x) / 4),
        ("1/sqrt(x**2)", lambda x: math.copysign(math.log(abs(x)), x)),
        ("x/sqrt(x**2)", abs),
    ],
)
@pytest.mark.parametrize("x0", [1.0, -4.0])
def test_a_root_of_a_square_has_a_taylor_series_on_either_side(
    flow: str, integral: object, x0: float
) -> None:
    assert callable(integral)
    exact = integral(x0 + 2.0) - integral(x0)
    text = CHART.format(x0=x0, dx=1, flow=flow)
    assert taylor(text).outputs["v"] == pytest.approx(exact, rel=1e-13)
    assert run(read_text(text), engine="scipy").outputs["v"] == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_run_passes_the_zero_of_a_root(seed: int) -> None:
    # x = a + b t + c t**2 has up to two zeros.
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(-1, 1), rng.uniform(-2, 2), rng.uniform(-1, 1)
    poly = np.polynomial.Polynomial([a, b, c])
    marks = [0.0, *sorted(t.real for t in poly.roots() if t.imag == 0.0 and 0 < t.real < 2), 2.0]
    primitive = poly.integ()
    parts = [abs(primitive(end) - primitive(start)) for start, end in pairwise(marks)]
    text = CHART.format(x0=a, dx=f"{b} + {2 * c}*time", flow="sqrt(x**2)")
    for engine in ("auto", "scipy"):
        found = run(read_text(text), engine=engine).outputs["v"]
        assert found == pytest.approx(sum(parts), rel=1e-8)


def test_at_zero_taylor_names_the_root_without_a_series() -> None:
    result = run(read_text(CHART.format(x0=0, dx=1, flow="sqrt(x**2)")))
    assert result.trace.engine.startswith("scipy")
    assert "sqrt(x**2) has no Taylor series at t = 0" in result.trace.warnings[0]
    assert result.outputs["v"] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("height", ["sqrt(x**2)", "1 - sqrt((x - 1)**2 + 0)", "hypot(2*x, 0)"])
def test_a_surface_with_the_root_of_a_square_is_refused_as_one_with_abs(height: str) -> None:
    text = f"""\
kind: scene
name: valley
gravity: 9.81
bodies: {{b: {{mass: 1, start: {{x: -1, y: 2}}}}}}
surfaces: {{s: {{height: "{height}"}}}}
contacts: {{c: {{point: {{body: b}}, surface: s, friction: 0, modes: [free, slide],
  restitution: 0}}}}
stop: {{time: 1}}
"""
    with pytest.raises(DeclarationError, match=r":5:25: .*the root of a square of x has no slope"):
        run(read_text(text))
    smooth = text.replace(height, "sqrt(x**2 + 1)")
    assert run(read_text(smooth)).trace.outcome.succeeded


@pytest.mark.parametrize("root", ["sqrt(time)", "sqrt(abs(x))"])
def test_a_root_without_a_series_is_printed_as_documents_write_it(root: str) -> None:
    result = run(read_text(CHART.format(x0=0, dx=1, flow=root)))
    assert f"{root} has no Taylor series at t = 0" in result.trace.warnings[0]


PURSUIT = """
kind: chart
name: pursuit
variables: {x: 3, y: 1}
regions:
  r: {initial: s, states: {s: {flows: {x: "cos(atan2(-y, -x))", y: "sin(atan2(-y, -x))"}}}}
stop: {time: 10, conditions: {there: "hypot(x, y) <= 1e-3"}}
"""


def test_a_pursuit_ends_at_its_target_with_what_to_write() -> None:
    distance = 10.0**0.5
    stopped = run(read_text(PURSUIT)).trace
    assert stopped.t_end == pytest.approx(distance - 1e-3, abs=1e-12)
    endless = PURSUIT.replace(', conditions: {there: "hypot(x, y) <= 1e-3"}', "")
    trace = run(read_text(endless), throw=False).trace
    assert (trace.outcome.name, trace.t_end) == ("NON_FINITE", pytest.approx(distance))
    assert "1/sqrt(x**2 + y**2) grows without bound at t = 3.16228" in trace.message
