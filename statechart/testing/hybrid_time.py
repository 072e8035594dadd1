"""Checks that a trace is a run on hybrid time (t, j): in order, by edges, continuous between."""

from __future__ import annotations

import numpy as np

from statechart.arrays import ROUND_OFF, Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.tabular import several, shortest

_CONTINUOUS = 100.0


def assert_ordered(trace: Trace) -> None:
    """Check that arcs and jumps follow one another on hybrid time (t, j)."""
    t, j = 0.0, 0
    # Steps of one length add up to it with their roundings.
    allowed = ROUND_OFF * trace.t_end if trace.step is not None else 0.0
    points = sorted(
        [(arc.j, 1, arc.start.high, arc.end.high) for arc in trace.arcs]
        + [(jump.j, 2, jump.t, jump.t) for jump in trace.jumps],
        key=lambda point: point[:2],
    )
    for of, what, start, end in points:
        place = f"{('arc', 'jump')[what - 1]} at t = {shortest(start)}, j = {of}"
        off = abs(start - t)
        assert off <= allowed, f"{place} does not begin where the run was, t = {shortest(t)}"
        assert end >= start, f"{place} ends before it begins, at t = {shortest(end)}"
        assert of == j, f"{place} comes after {several(j, 'jump')}"
        t, j = end, of + (what == 2)
    assert abs(t - trace.t_end) <= allowed, (
        f"the run ends at t = {shortest(trace.t_end)}, its parts at {shortest(t)}"
    )


def assert_edges(automaton: Automaton, trace: Trace) -> None:
    """Check that every jump is an edge of the automaton, region by region."""
    mode = trace.start_mode
    for jump in trace.jumps:
        place = f"jump {jump.j} at t = {shortest(jump.t)} ({jump.region} {jump.cause})"
        assert jump.source == mode, f"{place} leaves {jump.source}, but the mode was {mode}"
        mode = jump.target
        for region, before, after in zip(automaton.regions, jump.source, mode, strict=True):
            edges = {(e.source, e.target, e.cause) for e in region.edges}
            if region.name == jump.region:
                known = (before, after, jump.cause) in edges
            else:
                known = before == after or any(e[:2] == (before, after) for e in edges)
            assert known, f"{place}: {region.name} has no such edge from {before} to {after}"
    assert mode == trace.final_mode, f"the run ends in {trace.final_mode}, its jumps in {mode}"
    for arc in trace.arcs:
        mode = trace.jumps[arc.j - 1].target if arc.j else trace.start_mode
        assert arc.mode == mode, (
            f"the arc at t = {shortest(arc.start.high)} shows {arc.mode}, not {mode}"
        )


def assert_continuous(trace: Trace) -> None:
    """Check that states change only by jumps, and that steps of an arc join."""
    visited = [arc.coefficients[:, :, 0] for arc in trace.arcs]
    sizes = np.abs(np.concatenate([*visited, trace.initial[None], trace.final[None]])).max(axis=0)
    error = ROUND_OFF if trace.step is not None else max(trace.tolerance, ROUND_OFF)
    allowed = _CONTINUOUS * error * sizes + projected(trace)
    state, j = trace.initial, 0
    for arc in trace.arcs:
        state = _through(trace, state, j, arc.j, allowed)
        j = arc.j
        starts, ends = arc.coefficients[:, :, 0], arc.coefficients.sum(axis=2)
        before = np.concatenate([state[None], ends[:-1]])
        _join(trace, before, starts, arc.start.high, allowed)
        state = ends[-1]
    state = _through(trace, state, j, len(trace.jumps), allowed)
    _join(trace, state[None], trace.final[None], trace.t_end, allowed)


def _through(trace: Trace, state: Array, first: int, last: int, allowed: Array) -> Array:
    for jump in trace.jumps[first:last]:
        _join(trace, state[None], jump.before[None], jump.t, allowed)
        state = jump.after
    return state


def _join(trace: Trace, before: Array, after: Array, t: float, allowed: Array) -> None:
    off = np.abs(after - before)
    if not (off <= allowed).all():
        step, variable = np.unravel_index(int(np.argmax(off / (allowed + 1e-300))), off.shape)
        raise AssertionError(
            f"{trace.variables[variable]} changes by {off[step, variable]:.3g} without a jump "
            f"in the arc from t = {shortest(t)}"
        )


def projected(trace: Trace) -> float:
    """Return how far states may be moved where they are brought back onto constraints."""
    if trace.step is not None:
        return 0.0
    return trace.tolerances.get("gap", 0.0) + trace.tolerances.get("speed", 0.0)
