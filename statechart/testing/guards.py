"""Checks of guards and invariants between events, at times that no integrator used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.regions import Margin, whole_margins
from statechart.automaton.trace import Arc, Jump, Trace
from statechart.observation.flows import passed
from statechart.observation.observer import Observer
from statechart.testing.agreement import NUDGE
from statechart.testing.hybrid_time import ROUNDING
from statechart.testing.relation_truth import assert_invariant_relations, invariants_of
from statechart.testing.subject import Subject

GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
"""The ratio whose multiples come to no place twice."""
_PER_STEP = 9


def dense(trace: Trace) -> Iterator[tuple[Arc, Array]]:
    """Yield every arc with local times that no integrator used.

    The places in the steps are multiples of the golden ratio: never an end, never the same ones.

    Parameters
    ----------
    trace : Trace
        A run.

    Yields
    ------
    (Arc, (m,) array)
        Times are since the start of the arc, in the model's unit of time.
    """
    for arc in trace.arcs:
        steps = np.diff(arc.times)
        places = (np.arange(1, _PER_STEP * len(steps) + 1) * GOLDEN) % 1.0
        places = np.sort(places.reshape(len(steps), _PER_STEP), axis=1)
        yield arc, (arc.times[:-1, None] + places * steps[:, None]).ravel()


def assert_margins(subject: Subject, trace: Trace) -> None:
    """Check that no guard's margin is negative between events, on a grid of its own.

    Parameters
    ----------
    subject, trace : Subject, Trace
        The model, and a run of it.
    """
    moved = _moved(trace)
    for arc, tau in dense(trace):
        mode = subject.mode(trace, arc)
        if margins := whole_margins(mode.margins):
            _assert_margins(subject, trace, arc, tau, margins, moved)


def assert_invariants(subject: Subject, trace: Trace) -> None:
    """Check that declared invariants hold, of states in these: everywhere, peaks included.

    Of a run by steps they hold to what a variable changes by in a step.

    Parameters
    ----------
    subject, trace : Subject, Trace
        The model, and a run of it.
    """
    observer = subject.observers[trace.engine.split()[0]]
    moved = _moved(trace)
    for arc, tau in dense(trace):
        margins = _invariants(subject, arc)
        if not margins:
            continue
        allowed = _assert_margins(subject, trace, arc, tau, margins, moved)
        alone = replace(trace, arcs=(arc,))
        for margin, less in zip(margins, allowed, strict=True):
            found = np.full(2, np.nan)
            observer.widened(alone, margin.expression, found)
            if (least := found[0]) < -less:
                begins, ends = arc.start.high, arc.start.high + arc.duration
                raise AssertionError(
                    f"{margin.name} falls to {least:.6g} between t = {begins:.6g} and "
                    f"{ends:.6g} in {subject.automaton.label(arc.mode)}"
                )
    automaton = subject.automaton
    for invariant in automaton.invariants:
        for jump in {jump.j: jump for jump in (*trace.jumps[:1], *passed(trace))}.values():
            for before in (True, False):
                active = automaton.active(jump.source if before else jump.target)
                _assert_at(observer, trace, jump, invariant.margin(active), before=before)
    if trace.step is None:
        assert_invariant_relations(subject, trace)


def _invariants(subject: Subject, arc: Arc) -> list[Margin]:
    """Return the margins of the invariants of a mode, but for those that hold by its states."""
    automaton = subject.automaton
    active = automaton.active(arc.mode)
    margins = [one.margin(active) for one in invariants_of(automaton, arc.mode)]
    for margin in margins:
        if margin.expression == -sp.oo:
            raise AssertionError(
                f"{margin.name} does not hold from t = {arc.start.high:.6g} to "
                f"{arc.start.high + arc.duration:.6g} in {automaton.label(arc.mode)}"
            )
    return [margin for margin in margins if margin.expression != sp.oo]


def _assert_at(
    observer: Observer, trace: Trace, jump: Jump, margin: Margin, *, before: bool
) -> None:
    """Check an invariant of the run beside a jump, where it may be in a mode of no duration."""
    expression = margin.expression
    mode = observer.automaton.label(jump.source if before else jump.target)
    if expression == -sp.oo:
        raise AssertionError(f"{margin.name} does not hold at t = {jump.t:.6g} in {mode}")
    if expression == sp.oo:
        return
    value = observer.at(trace, (expression,), [jump], before=before).item()
    allowed = trace.tolerances.get(margin.kind, 0.0)
    state = jump.before if before else jump.after
    for i, size in enumerate(np.maximum(np.abs(jump.before), np.abs(jump.after)).tolist()):
        changed = state.copy()
        changed[i] += max(trace.tolerance, ROUNDING) * size
        moved = replace(jump, before=changed, after=changed)
        allowed += abs(observer.at(trace, (expression,), [moved], before=before).item() - value)
    if value < -allowed:
        raise AssertionError(f"{margin.name} is {value:.6g} at t = {jump.t:.6g} in {mode}")


def _assert_margins(
    subject: Subject,
    trace: Trace,
    arc: Arc,
    tau: Array,
    margins: Sequence[Margin],
    by: Array,
) -> Array:
    """Check margins at local times of an arc; return what each may be below zero there.

    `by`: see `_moved`.
    """
    expressions = [margin.expression for margin in margins]
    states = arc.states(tau)
    values = subject.solved(trace, arc, tau, expressions)
    rounding = np.zeros(values.shape)
    for i, change in enumerate(by.tolist()):
        changed = states.copy()
        if trace.step is None:
            changed[:, i] *= 1.0 + NUDGE
            moved = subject.solved(trace, arc, tau, expressions, changed)
            rounding += np.abs(moved - values) * (max(trace.tolerance, ROUNDING) / NUDGE)
        # What a jump leaves of a variable carries the rounding of what it was before.
        changed[:, i] = states[:, i] + change
        moved = subject.solved(trace, arc, tau, expressions, changed)
        rounding += np.nan_to_num(np.abs(moved - values), nan=0.0)
    allowed = rounding + [trace.tolerances.get(margin.kind, 0.0) for margin in margins]
    holds, known = values >= -allowed, arc.unknowns(tau)
    if known is not None:
        # Of steps with an impulse some forces have no value.
        holds |= np.isnan(values) & np.isnan(known).any(axis=1, keepdims=True)
    if not holds.all():
        short = np.where(holds, np.inf, values + allowed)
        m, k = np.unravel_index(int(np.argmin(short)), values.shape)
        raise AssertionError(
            f"{margins[int(k)].name} is {values[m, k]:.6g} at "
            f"t = {arc.start.high + (arc.start.low + tau[m]):.6g} in "
            f"{subject.automaton.label(arc.mode)}"
        )
    found: Array = allowed.max(axis=0, initial=0.0)
    return found


def _moved(trace: Trace) -> Array:
    """Return by how much variables (n,) may be off: rounding, and what a time step moves."""
    sizes, steps = np.zeros((2, len(trace.variables)))
    for arc in trace.arcs:
        sizes = np.fmax(sizes, np.abs(arc.coefficients[:, :, 0]).max(axis=0, initial=0.0))
        if trace.step is not None:
            moves = np.abs(np.diff(arc.states(arc.times), axis=0)).max(axis=0, initial=0.0)
            steps = np.maximum(steps, moves)
    return ROUNDING * sizes + steps
