"""The compiled loop is bit-identical to single flows and instants."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import models
from contacts.event_driven.compiled_laws import CompiledSceneLaws
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text
from statechart.execution import compiled_loop
from statechart.running.runner import Runner

STICK = {
    "default": {},
    "point mass": {"I_G": 0.0, "mu": 0.3},
    "slippery": {"mu": 0.0, "theta0": 0.3},
    "rough": {"mu": float("inf")},
    "slow": {"theta0": 1e-6, "mu": 0.05},
    "lies nearly": {"theta0": 1.5, "mu": 0.7, "I_G": 0.01},
}
CASES = [
    *(("toppling_stick", values) for values in STICK.values()),
    ("stick_slip_block", {}),
    ("dragged_stick", {}),
    ("bouncing_ball", {"k": 0.7}),
    ("bouncing_ball", {"k": 0.3, "x0": 7.0}),
    ("bouncing_ball", {"k": 0.95}),
    ("bouncing_ball_hills", {}),
    ("double_contact_bar", {}),
    ("block_on_incline", {}),
    ("simplest_walker", {}),
    ("hopper", {}),
    ("newtons_cradle", {}),
    ("rimless_wheel", {}),
    ("compass_walker", {}),
    ("rocking_block", {}),
]


def traced(
    model: str, values: dict[str, float], worth: float, monkeypatch: pytest.MonkeyPatch
) -> Trace:
    monkeypatch.setattr(compiled_loop, "_WORTH_COMPILING", worth)
    runner = Runner(model)
    runner.run(values, throw=False)  # every mode is made known
    return runner.run(values, throw=False).trace


@pytest.mark.parametrize(("model", "values"), CASES)
def test_compiled_run_is_bit_identical(
    model: str, values: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Else it is taken at once where it lies compiled on disk.
    monkeypatch.setattr(CompiledSceneLaws, "compiled", lambda self: False)
    monkeypatch.setattr(CompiledSceneLaws, "ready", lambda self: False)
    made = traced(model, values, -1, monkeypatch)
    alone = traced(model, values, float("inf"), monkeypatch)
    assert_same(made, alone)


def assert_same(one: Trace, other: Trace) -> None:
    assert (one.outcome, one.message, one.t_end) == (other.outcome, other.message, other.t_end)
    assert (one.certified, one.warnings) == (other.certified, other.warnings)
    assert dict(one.evidence) == dict(other.evidence)
    assert {**one.counts, "python_instants": 0} == {**other.counts, "python_instants": 0}
    assert np.array_equal(one.final, other.final)
    assert len(one.arcs) == len(other.arcs)
    for here, there in zip(one.arcs, other.arcs, strict=True):
        assert (here.mode, here.roles, here.j) == (there.mode, there.roles, there.j)
        assert here.start == there.start
        assert np.array_equal(here.times, there.times)
        assert np.array_equal(here.coefficients, there.coefficients)
    for jump, same in zip(one.jumps, other.jumps, strict=True):
        assert (jump.t, jump.j, jump.region, jump.cause) == (
            same.t,
            same.j,
            same.region,
            same.cause,
        )
        assert (jump.source, jump.target, jump.fired) == (same.source, same.target, same.fired)
        assert (jump.energy, jump.skipped, jump.path) == (same.energy, same.skipped, same.path)
        assert np.array_equal(jump.before, same.before)
        assert np.array_equal(jump.after, same.after)
        assert dict(jump.impulse) == dict(same.impulse)
        assert dict(jump.considered) == dict(same.considered)


def test_low_bounces_stay_in_the_compiled_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = traced("bouncing_ball", {"k": 0.5}, -1, monkeypatch)
    # In Python: the last two bounces, their accumulation, and the end of the run.
    assert len(ball.jumps) > 20
    assert ball.counts["python_instants"] <= 4


def test_repeated_run_keeps_its_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_loop, "_WORTH_COMPILING", -1)
    lifted = (Path(models.__file__).parent / "bouncing_ball.yaml").read_text()
    runner = Runner(read_text(lifted.replace("gravity: g\n", "gravity: -9.81\n")))
    warnings = [runner.run(until=0.1).trace.warnings for _ in range(3)]
    assert "acts upwards" in warnings[0][0]
    assert warnings[0] == warnings[1] == warnings[2]


def test_jumps_and_their_list_have_a_readable_repr() -> None:
    trace = Runner("toppling_stick").run().trace
    assert repr(trace.jumps) == "<3 items, computed when read>"
    assert "'tip:slide-': 'taken'" in repr(trace.jumps[0])
