"""Whether guards and invariants hold between events, at times that no integrator used."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from statechart.arrays import Array
from statechart.automaton.regions import Margin, Mode
from statechart.automaton.trace import Arc, Role, Trace
from statechart.tabular import shortest
from statechart.testing.agreement import NUDGE
from statechart.testing.hybrid_time import ROUNDING
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
    subject : Subject
        The model.
    trace : Trace
        A run of it.

    Raises
    ------
    AssertionError
        Where it does not hold.
    """
    for arc, tau in dense(trace):
        mode = subject.mode(trace, arc)
        if mode.margins:
            _assert_margins(subject, trace, arc, tau, mode.margins, mode)


def assert_invariants(subject: Subject, trace: Trace) -> None:
    """Check that declared invariants hold, of states in these, on a grid of its own.

    Parameters
    ----------
    subject : Subject
        The model.
    trace : Trace
        A run of it.

    Raises
    ------
    AssertionError
        Where it does not hold.
    """
    for arc, tau in dense(trace):
        mode = subject.mode(trace, arc)
        margins = [
            margin
            for region, state in zip(subject.automaton.regions, arc.mode, strict=True)
            for margin in region.build(Role(state)).invariants
        ]
        margins += subject.automaton.invariants
        if margins:
            _assert_margins(subject, trace, arc, tau, margins, mode)


def _assert_margins(
    subject: Subject,
    trace: Trace,
    arc: Arc,
    tau: Array,
    margins: Sequence[Margin],
    mode: Mode,
) -> None:
    expressions = [margin.expression for margin in margins]
    states, times = arc.states(tau), arc.start.high + (arc.start.low + tau)
    values = subject.values(trace, expressions, states, times, mode)
    rounding = np.zeros(values.shape)
    sizes = [np.abs(a.coefficients[:, :, 0]).max(axis=0, initial=0.0) for a in trace.arcs]
    for i, size in enumerate(np.max(sizes, axis=0)):
        changed = states.copy()
        changed[:, i] *= 1.0 + NUDGE
        moved = subject.values(trace, expressions, changed, times, mode)
        rounding += np.abs(moved - values) * (max(trace.tolerance, ROUNDING) / NUDGE)
        # What a jump leaves of a variable carries the rounding of what it was before.
        changed[:, i] = states[:, i] + ROUNDING * size
        moved = subject.values(trace, expressions, changed, times, mode)
        rounding += np.nan_to_num(np.abs(moved - values), nan=0.0)
    allowed = rounding + [trace.tolerances.get(margin.kind, 0.0) for margin in margins]
    if not (values >= -allowed).all():
        m, k = np.unravel_index(int(np.argmin(values + allowed)), values.shape)
        raise AssertionError(
            f"{margins[int(k)].name} is {values[m, k]:.6g} at t = {shortest(times[m])} in "
            f"{subject.automaton.label(arc.mode)}"
        )
