"""Arcs and jumps of runs by steps, made when somebody looks at them."""

from __future__ import annotations

import numpy as np
import pytest

from contacts.time_stepping import stepper
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.lazy_arcs import Steps
from statechart.automaton.clock import Clock
from statechart.automaton.trace import Arc, Jump, Trace
from statechart.running.runner import Runner


def run(model: str = "granular_column", **values: float) -> Trace:
    """Return a run by steps."""
    settings = {} if model == "granular_column" else {"engine": "impulse", "step": 1e-3}
    return Runner(model, **settings).run(values, throw=False).trace


@pytest.mark.parametrize(
    ("model", "values"), [("granular_column", {"n": 12}), ("bouncing_ball", {})]
)
def test_arcs_meet_each_other_and_the_jumps_between_them(
    model: str, values: dict[str, float]
) -> None:
    """A jump is where the arc before it ends, and that after it begins."""
    trace = run(model, **values)
    arcs: dict[int, list[Arc]] = {}
    for arc in trace.arcs:
        arcs.setdefault(arc.j, []).append(arc)
    sizes = np.abs(np.array([[*jump.before, *jump.after] for jump in trace.jumps])).max()
    assert len(trace.jumps) > 10
    for jump in trace.jumps:
        for side, place, local in ((jump.before, jump.j, -1), (jump.after, jump.j + 1, 0)):
            if place in arcs:
                arc = arcs[place][local]
                there = arc.states(np.array([arc.duration if local else 0.0]))[0]
                assert np.abs(there - side).max() <= 1e-14 * sizes
                when = arc.end.high if local else arc.start.high
                assert when == pytest.approx(jump.t, rel=1e-15)


def test_large_arcs_are_recomputed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs with and without stored arcs are equal; stored arcs are computed once."""
    kept = run(n=12)
    assert kept.arcs[3] is kept.arcs[3]
    # Polynomials of the recorded steps would exceed the largest trace.
    monkeypatch.setattr(stepper, "LARGEST", 1000)
    passing = run(n=12)
    assert passing.arcs[3] is not passing.arcs[3]
    assert passing.at_hand() is passing
    assert len(passing.arcs) == len(kept.arcs)
    for one, other in zip(passing.arcs, kept.arcs, strict=True):
        assert (one.mode, one.start, one.j) == (other.mode, other.start, other.j)
        assert np.array_equal(one.coefficients, other.coefficients)
        assert np.array_equal(one.times, other.times)
    for jump, same in zip(passing.jumps, kept.jumps, strict=True):
        assert isinstance(jump, Jump)
        assert jump.energy == same.energy
        assert jump.impulse == same.impulse


def test_steps_of_a_chunk_that_ends_early_hold_their_own_memory() -> None:
    """Steps taken from a buffer for 500 do not keep the whole buffer alive."""
    chunk = Chunk.allocate(1e-3, np.zeros(12), (6, 6, 2, 0), 500).first(3)
    steps = Steps.of(chunk, 6, Clock())
    for rows in (steps.states, steps.solved, steps.impulses, steps.struck):
        owner = rows if rows.base is None else rows.base
        assert owner.nbytes <= 2 * rows.nbytes
