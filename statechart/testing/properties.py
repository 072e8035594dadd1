"""Properties of every run of every automaton, for tests of models.

::

    from statechart.testing import Subject, generic

    subject = Subject(load("my_model.yaml"))        # compiled once
    case = subject.case({"k": 0.5})                 # runs are computed on demand
    for item in generic(subject):
        item.holds(case)                            # AssertionError or Undecidable

`parameters` is the Hypothesis strategy over the declared `ranges`. `contacts.testing` has
properties of contacts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from statechart.arrays import ROUND_OFF, Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Outcome, Role, Trace, sizes
from statechart.execution.execution import PASSED
from statechart.tabular import pluralise
from statechart.testing.agreement import Undecidable, assert_same
from statechart.testing.guards import GOLDEN, assert_invariants, assert_margins, assert_relations
from statechart.testing.subject import Case, Subject

# Relative projection of an initial state onto constraints.
_START = 1e-8


@dataclass(frozen=True)
class Property:
    """A property of all choices of the parameters.

    Attributes
    ----------
    name : str
        Description.
    holds : callable
        Case -> None; raises AssertionError if violated, `Undecidable` if that cannot be decided.
    skipped : str
        Reason why it does not apply to the model, or empty.
    """

    name: str
    holds: Callable[[Case], None]
    skipped: str = ""


def assert_ended(case: Case) -> None:
    """Check that every run reaches a declared end.

    Parameters
    ----------
    case : Case
        A choice of parameters and its runs.
    """
    for trace in case.traces.values():
        if not trace.outcome.succeeded:
            message = f"run ended: {trace.outcome.name} ({trace.engine}): {trace.message}"
            raise AssertionError(message)


def assert_start(case: Case) -> None:
    """Check that runs start in the declared state, up to projection onto constraints.

    Variables that `entry` of an initial state updates are not compared.

    Parameters
    ----------
    case : Case
        A choice of parameters and its runs.
    """
    for trace in case.traces.values():
        declared = case.subject.automaton.setup(case.parameters, trace.tolerance).initial
        projection = largest_projection(trace)
        size = np.abs(declared).max(initial=0.0)
        off = np.abs(trace.initial - declared)
        off[np.isin(trace.variables, [*_entry_updates(case.subject.automaton, trace)])] = 0.0
        worst = int(np.argmax(off))
        if off[worst] > _START * size + projection:
            name, start, wanted = (x[worst] for x in (trace.variables, trace.initial, declared))
            words = f"{name} starts at {start:.7g}, declared is {wanted:.7g}"
            raise AssertionError(f"{trace.engine}: {words} (difference {off[worst]:.2g})")


def _entry_updates(automaton: Automaton, trace: Trace) -> Iterator[str]:
    """Yield the variables that `entry` of an initial state updates."""
    for region, initial in zip(automaton.regions, trace.start_mode, strict=True):
        for state in region.active(initial):
            yield from region.nesting.entries.get(state, ())


def assert_engines_agree(case: Case) -> None:
    """Check that all engines agree in modes, times of events and states.

    Parameters
    ----------
    case : Case
        A choice of parameters and its runs.
    """
    first, *others = case.sound
    for other in others:
        loosened = partial(case.loosened, other.tolerance)
        assert_same(first, other, case.sensitivity, loosened=loosened)


def assert_prefix(case: Case) -> None:
    """Check causality: a shorter run is the beginning of the run.

    Parameters
    ----------
    case : Case
        A choice of parameters and its runs.
    """
    trace = case.sound[0]
    if not trace.arcs:
        raise Undecidable("nothing flows")
    until = GOLDEN * trace.t_end
    if trace.step is not None:
        _assert_same_steps(trace, case.shorter(trace.step * math.ceil(until / trace.step)))
        return
    arc = next(a for a in reversed(trace.arcs) if a.start.high <= until)
    state = arc.states(np.array([min(until - arc.start.high, arc.duration)]))[0]
    shorter = case.shorter(until)
    assert shorter.outcome is Outcome.HORIZON, f"run ended: {shorter.outcome.name}"
    assert_same(trace, shorter, case.sensitivity, until=(until, state))


def _assert_same_steps(trace: Trace, shorter: Trace) -> None:
    """Check that the steps of a run are bitwise the first of another."""
    for ours, theirs in zip(shorter.jumps, trace.jumps, strict=False):
        place = f"jump {ours.j} at t = {ours.t:.7g} ({ours.region} {ours.cause})"
        other = f"a longer run has {theirs.region} {theirs.cause} at t = {theirs.t:.7g}"
        same = (ours.t, ours.source, ours.target) == (theirs.t, theirs.source, theirs.target)
        assert same, f"{place}: {other}"
        assert (ours.after == theirs.after).all(), f"{place}: a longer run has another state"
    steps = [np.concatenate([arc.coefficients for arc in one.arcs]) for one in (shorter, trace)]
    same = np.all(steps[0] == steps[1][: len(steps[0])], axis=(1, 2))
    assert same.all(), f"step {int(np.argmin(same))} of {len(same)} is another in a longer run"


def each(check: Callable[[Subject, Trace], None]) -> Callable[[Case], None]:
    """Return a check of every run of a case."""

    def holds(case: Case) -> None:
        for trace in case.traces.values():
            try:
                check(case.subject, trace)
            except AssertionError as error:
                raise AssertionError(f"{trace.engine}: {error}") from None

    return holds


def generic(subject: Subject) -> tuple[Property, ...]:
    """Return the properties of every automaton.

    Parameters
    ----------
    subject : Subject
        The model.
    """
    states = [(region, state) for region in subject.automaton.regions for state in region.states]
    of_states = any(region.build(Role(state)).invariants for region, state in states)
    declared = of_states or subject.automaton.invariants
    undeclared = "" if declared else "no invariants are declared"
    alone = "; ".join(f"{name}: {reason}" for name, reason in subject.missing.items())
    stepped = ""
    if subject.step is not None:
        stepped = "time steps pass guards by up to a step, and build no equations of modes"
        alone = "its settings ask for the engine impulse"
    return (
        Property("runs come to their end", assert_ended),
        Property("runs start as declared", assert_start),
        Property("events are ordered in time", each(lambda _, trace: assert_ordered(trace))),
        Property("every jump is an edge", each(lambda one, run: assert_edges(one.automaton, run))),
        Property("arcs are continuous", each(lambda _, trace: assert_continuous(trace))),
        Property("no guard is passed", each(assert_margins), skipped=stepped),
        Property("declared invariants hold", each(assert_invariants), skipped=undeclared),
        Property("relations hold where modes say so", each(assert_relations), skipped=stepped),
        Property("engines agree", assert_engines_agree, skipped=alone),
        Property("a shorter run is the beginning of a longer one", assert_prefix),
    )


_CONTINUOUS = 100.0


def assert_ordered(trace: Trace) -> None:
    """Check that arcs and jumps are contiguous on hybrid time (t, j).

    Parameters
    ----------
    trace : Trace
        A run.
    """
    t, j = 0.0, 0
    # Sums of fixed steps have round-off, and runs with events pass the sign changes of forces.
    by_steps = trace.step is not None
    allowed = ROUND_OFF * trace.t_end if by_steps else PASSED * math.ulp(trace.t_end)
    points = sorted(
        [(arc.j, 1, arc.start.high, arc.end.high) for arc in trace.arcs]
        + [(jump.j, 2, jump.t, jump.t) for jump in trace.jumps],
        key=lambda point: point[:2],
    )
    for of, what, start, end in points:
        place = f"{('arc', 'jump')[what - 1]} at t = {start:.7g}, j = {of}"
        off = abs(start - t)
        assert off <= allowed, f"{place} does not begin where the run was, t = {t:.7g}"
        assert end >= start, f"{place} ends before it begins, at t = {end:.7g}"
        assert of == j, f"{place} comes after {pluralise(j, 'jump')}"
        t, j = end, of + (what == 2)
    words = f"the run ends {trace.t_end - t:.3g} after its parts, at t = {trace.t_end:.7g}"
    assert abs(t - trace.t_end) <= allowed, words


def assert_edges(automaton: Automaton, trace: Trace) -> None:
    """Check that every jump is an edge of the automaton, region by region.

    Parameters
    ----------
    automaton : Automaton
        Automaton of the model.
    trace : Trace
        A run of it.
    """
    mode = trace.start_mode
    for jump in trace.jumps:
        place = f"jump {jump.j} at t = {jump.t:.7g} ({jump.region} {jump.cause})"
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
        assert arc.mode == mode, f"the arc at t = {arc.start.high:.7g} shows {arc.mode}, not {mode}"


def assert_continuous(trace: Trace) -> None:
    """Check that states are continuous except at jumps.

    Parameters
    ----------
    trace : Trace
        A run.
    """
    error = ROUND_OFF if trace.step is not None else max(trace.tolerance, ROUND_OFF)
    allowed = _CONTINUOUS * error * sizes(trace) + largest_projection(trace)
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
        change = f"{trace.variables[variable]} changes by {off[step, variable]:.3g}"
        raise AssertionError(f"{change} without a jump in the arc from t = {t:.7g}")


def largest_projection(trace: Trace) -> float:
    """Return the largest relative projection of states onto constraints."""
    if trace.step is not None:
        return 0.0
    return trace.tolerances.get("gap", 0.0) + trace.tolerances.get("speed", 0.0)
