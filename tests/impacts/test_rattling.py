"""A bar that rattles on two feet comes to rest on them: impacts in turn end."""

from __future__ import annotations

import functools

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from runs import ENGINES
from strategies import examples

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

BAR = """\
kind: scene
name: rattling_bar
parameters: {m: 0.999, I: 0.101, l: 0.3, d: 0.1, e: 0.4, mu: 0.766, slope: -0.0643, v: 0.3, w: -0.5}
gravity: 9.81
bodies:
  bar:
    mass: m
    inertia: I
    start: {x: -d*sin(slope), y: d*cos(slope) + l, angle: slope, dx: v, dangle: w}
surfaces: {ground: {incline: slope}}
contacts:
  p: {point: {body: bar, at: [-l, -d]}, surface: ground, friction: mu, restitution: e}
  q: {point: {body: bar, at: [l, -d]}, surface: ground, friction: mu, restitution: e}
stop: {time: 3}
settings: {max_jumps: 2000}
"""

REPORTED = """\
kind: scene
name: reported
gravity: 9.81
bodies:
  b:
    mass: .999
    inertia: .101
    start: {x: -.378, y: .704, dx: .805, angle: -.029, dangle: -.552}
surfaces: {s: {line: [[-.5, .1], [.4, .042]]}}
contacts:
  p: {point: {body: b, at: [-.3, -.1]}, surface: s, friction: .766, restitution: .4}
  q: {point: {body: b, at: [.3, -.1]}, surface: s, friction: .766, restitution: .4}
stop: {time: 2}
settings: {max_jumps: 600}
"""


@functools.cache
def runner(text: str, engine: str) -> Runner:
    return Runner(read_text(text), engine=engine)


def assert_energy_never_grows(trace) -> None:
    for jump in trace.jumps:
        before, after = jump.energy
        # Gaps that are closed within their tolerance are lifted by it.
        lifted = 10.0 * trace.tolerances["gap"] * 9.81
        assert after <= before + lifted + 1e-12 * abs(before)


@pytest.mark.parametrize("engine", ENGINES)
def test_alternating_impacts_below_the_gap_tolerance_end(engine: str) -> None:
    trace = runner(REPORTED, engine).run(throw=False).trace
    assert trace.outcome.name == "HORIZON"
    assert trace.jumps[-1].target == ("pin", "pin")
    assert trace.jumps[-1].t == pytest.approx(0.9539806, abs=1e-5)
    assert_energy_never_grows(trace)


# A slope whose products lose their digits.
FLAT = {"slope": 2.0**-1023, "inertia": 0.02, "half": 0.36, "depth": 0.085, "e": 0.085, "mu": 0.5}


@pytest.mark.parametrize("engine", ENGINES)
@examples(8)
@example(v=0.0, w=0.085, **FLAT)
@given(
    inertia=st.floats(0.02, 0.4),
    half=st.floats(0.1, 0.6),
    depth=st.floats(0.02, 0.3),
    e=st.floats(0.0, 0.8),
    mu=st.floats(0.5, 2.0),
    slope=st.floats(-0.3, 0.3),
    v=st.floats(-1.0, 1.0),
    w=st.floats(-2.0, 2.0),
)
def test_a_bar_comes_to_rest_on_its_feet(
    engine: str, inertia, half, depth, e, mu, slope, v, w
) -> None:
    given_ = {"I": inertia, "l": half, "d": depth, "e": e, "mu": mu}
    result = runner(BAR, engine).run({**given_, "slope": slope, "v": v, "w": w}, throw=False)
    trace = result.trace
    assert trace.outcome.name == "HORIZON", trace.message
    assert_energy_never_grows(trace)
    # A short and high one may fall over.
    if trace.modes[-1] == ("pin", "pin"):
        assert abs(trace.final[3:]).max() <= 1e-9
