"""Runs that cannot be computed or kept end in time, with a sentence; extreme numbers too."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np
import pytest

from statechart.automaton import trace, trace_store
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.engines import engine
from statechart.errors import DeclarationError
from statechart.execution import compiled_loop, livelock
from statechart.execution import flow as advance
from statechart.running.runner import Runner, run

CHART = """\
kind: chart
name: flow
parameters: {{x0: 1, w: 1}}
variables: {{x: x0}}
regions: {{r: {{initial: s, states: {{s: {{flows: {{x: '{x}'}}}}}}, transitions: []}}}}
stop: {{time: 2}}
"""
BALL = """\
kind: scene
name: ball
gravity: g
parameters: {x0: 0, y0: 1, v: 0, g: 9.81, m: 1}
bodies: {b: {mass: m, start: {x: x0, y: y0, dx: v}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, restitution: 0.5}}
stop: {time: 2}
"""


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (trace, engine):
        monkeypatch.setattr(module, "LARGEST", 2**20)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "LSODA"])
@pytest.mark.parametrize("x0", [5e-324, 1e-310, 1e-300, 1e-200])
def test_starts_near_the_least_float_are_integrated(method: str, x0: float) -> None:
    made = run(
        read_text(CHART.format(x="x")), engine="scipy", method=method, parameters={"x0": x0}
    ).trace
    assert made.outcome is Outcome.HORIZON
    assert made.final[0] == pytest.approx(math.exp(2) * x0, rel=1e-2, abs=1e-290)


@pytest.mark.parametrize("name", ["taylor", "scipy"])
@pytest.mark.parametrize("height", [5e-324, 1e-310, 1e-300, 1e-200, 1e-99])
def test_a_ball_dropped_from_a_tiny_height_comes_to_rest(name: str, height: float) -> None:
    made = run(read_text(BALL), engine=name, parameters={"y0": height}).trace
    assert made.outcome is Outcome.HORIZON
    assert abs(made.final[1]) <= max(height, 1e-20)
    assert made.final_mode == ("pin",)


@pytest.mark.parametrize("name", ["x0", "y0", "v", "g"])
@pytest.mark.parametrize("value", [1e101, 1e200, 1e308])
@pytest.mark.parametrize("settings", [{"engine": "scipy"}, {"engine": "impulse", "step": 1e-3}])
def test_numbers_whose_squares_are_no_floats_are_refused(
    name: str, value: float, settings: dict[str, object]
) -> None:
    with pytest.raises(DeclarationError, match="take larger units"):
        run(read_text(BALL), parameters={name: value}, **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("mass", [1e-280, 1e-100, 1e100, 1e300])
def test_the_motion_of_a_ball_is_independent_of_its_mass(mass: float) -> None:
    made = run(read_text(BALL), parameters={"m": mass}).trace
    assert made.outcome is Outcome.HORIZON
    assert made.final == pytest.approx(run(read_text(BALL)).trace.final, abs=1e-12)


@pytest.mark.parametrize("mass", [1e-320, 1e-281, 1e301])
def test_a_mass_whose_energy_is_no_float_is_refused(mass: float) -> None:
    with pytest.raises(DeclarationError, match=r"must be between 1e-280 and 1e\+300"):
        run(read_text(BALL), parameters={"m": mass})


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("model", "until", "settings"),
    [
        ("woodpecker", 1e308, {}),
        ("woodpecker", 100.0, {}),
    ],
)
def test_a_trace_that_grows_too_large_ends_the_run(
    model: str, until: float, settings: dict[str, str]
) -> None:
    made = Runner(model, **settings).run(until=until, throw=False).trace  # type: ignore[arg-type]
    assert made.outcome is Outcome.TOO_LONG
    assert "end the run" in made.message
    assert 0.0 < made.t_end < until
    size = sum(arc.coefficients.nbytes for arc in made.arcs)
    assert size < 2 * 2**20


def test_a_trace_larger_than_memory_is_stored_on_disk(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    runner = Runner("stick_slip_block", engine="taylor")
    kept = runner.run(until=200.0).trace
    monkeypatch.setattr(trace_store, "IN_MEMORY", 2**10)
    monkeypatch.setattr(trace_store, "_ARCS", 40)
    spilled = Runner("stick_slip_block", engine="taylor").run(until=200.0).trace
    assert len(spilled.arcs) == len(kept.arcs) > 50
    assert _mapped(spilled.arcs[30].coefficients)
    for here, there in zip(kept.arcs, spilled.arcs, strict=True):
        assert (here.mode, here.start, here.j) == (there.mode, there.start, there.j)
        assert np.array_equal(here.coefficients, there.coefficients)
    for one, other in zip(kept.jumps, spilled.jumps, strict=True):
        assert (one.t, one.cause, one.fired) == (other.t, other.cause, other.fired)
        assert np.array_equal(one.after, other.after)


def test_a_trace_of_many_blocks_takes_few_files(monkeypatch: pytest.MonkeyPatch) -> None:
    resource = pytest.importorskip("resource")
    opened = len(os.listdir("/dev/fd"))
    most = resource.getrlimit(resource.RLIMIT_NOFILE)
    kept = Runner("stick_slip_block", engine="taylor").run(until=2000.0).trace
    monkeypatch.setattr(trace_store, "IN_MEMORY", 2**18)
    monkeypatch.setattr(trace_store, "_TERMS", 2**11)
    # The steps of a flow fit into the buffer.
    monkeypatch.setattr(compiled_loop, "_MAX_COEFFICIENTS", 2**9)
    runner = Runner("stick_slip_block", engine="taylor")
    resource.setrlimit(resource.RLIMIT_NOFILE, (opened + 60, most[1]))
    try:
        spilled = runner.run(until=2000.0).trace
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, most)
    assert spilled.outcome is kept.outcome
    assert _mapped(spilled.arcs[0].coefficients)
    for here, there in zip(kept.arcs, spilled.arcs, strict=True):
        assert np.array_equal(here.coefficients, there.coefficients)


def _mapped(array: Any) -> bool:
    """Return whether an array is mapped from a file."""
    while isinstance(array, np.ndarray) and not isinstance(array, np.memmap):
        array = array.base
    return isinstance(array, np.memmap)


@pytest.mark.parametrize("name", ["taylor", "scipy"])
def test_single_mode_of_too_many_steps_ends_as_too_long(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(engine, "LARGEST", 2**15)
    made = run(read_text(CHART.format(x="cos(w*time)")), engine=name, until=1e7, throw=False).trace
    assert made.outcome is Outcome.TOO_LONG
    assert 0.0 < made.t_end < 1e7


@pytest.mark.parametrize("w", [1e100, 1e300])
def test_steps_far_too_short_for_the_run_end_it(w: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advance, "_PACE_STEPS", 200)
    text = read_text(CHART.format(x="cos(w*time)"))
    made = run(text, engine="scipy", parameters={"w": w}, throw=False).trace
    assert made.outcome is Outcome.TOO_LONG
    assert "200 steps advanced" in made.message


def test_too_many_steady_jumps_are_reported_early(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = read_text(
        "kind: chart\nname: clock\nvariables: {x: 0}\nstop: {time: 1}\n"
        "regions:\n  r:\n    initial: s\n    states: {s: {flows: {x: 1}}}\n"
        "    transitions: [{name: tick, from: s, to: s, guard: 'x >= 1', updates: {x: 0}}]\n"
    )
    for until, steady in ((1e9, 4096), (1e300, 256)):  # the first is the shipped number
        if steady != livelock.STEADY:
            monkeypatch.setattr(livelock, "STEADY", steady)
        trace = run(clock, until=until, throw=False).trace
        assert trace.outcome is Outcome.TOO_LONG
        assert f"{steady} jumps took" in trace.message
        assert len(trace.jumps) == steady
    assert run(clock, until=300.5).trace.outcome is Outcome.HORIZON


def test_too_many_steps_are_reported_early() -> None:
    settings = {"engine": "impulse", "step": 1e-3}
    trace = run(read_text(BALL), until=1e300, throw=False, **settings).trace  # type: ignore[arg-type]
    assert trace.outcome is Outcome.TOO_LONG
    assert "take longer steps" in trace.message
    assert 2**15 <= trace.counts["steps"] < 2**16


def test_steady_jumps_go_on_where_a_condition_may_end_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(livelock, "STEADY", 256)
    clock = read_text(
        "kind: chart\nname: clock\nvariables: {x: 0, n: 0}\n"
        "stop: {time: 1e9, conditions: {enough: n >= 300}}\n"
        "regions:\n  r:\n    initial: s\n    states: {s: {flows: {x: 1}}}\n"
        "    transitions:\n"
        "      - {name: tick, from: s, to: s, guard: 'x >= 1', updates: {x: 0, n: n + 1}}\n"
    )
    assert run(clock).trace.outcome is Outcome.STOPPED
