"""Delay of a run that leaves an unstable equilibrium.

A defect d = p' - f(p) along the motion shifts it in time by the integral of (d . f) / (f . f).
Near an equilibrium the rates f can be smaller than errors within the tolerance: the steps do not
resolve the motion, its growth comes late or early, and no later step can tell.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Arc
from statechart.formulas.tape import Tape

# A start is slow if the first rates would move no variable by this part of its range in the flow.
_SLOW = 1e-6
# Ranges below this part of the largest one are round-off.
_LEAST = 1e-6
# Errors are ordinary where the rates exceed this part of their maximum.
_LEAVES = 1e-2


def slow_start_warning(
    arc: Arc, rates: Callable[[], Tape], parameters: Array, tolerance: float
) -> tuple[str, ...]:
    """Return a warning if the first flow is shifted by more than sqrt(tolerance) of its duration.

    `rates` returns the tape of the rates of all variables. Rates that depend on time grow without
    an equilibrium, and are not examined.
    """
    spans = np.diff(arc.times)
    long = spans > 0.0
    steps, spans, begins = arc.coefficients[long], spans[long], arc.times[:-1][long]
    if not len(steps):
        return ()
    terms = np.arange(steps.shape[2])
    ranges = np.abs(steps.sum(axis=2) - steps[0, :, 0]).max(axis=0)
    ranges = np.maximum(ranges, _LEAST * ranges.max())
    first = np.abs(steps[0, :, 1:2].sum(axis=1)) * (arc.duration / spans[0])
    if not (first.any() and (first <= _SLOW * ranges).all()):
        return ()
    places, weights = np.polynomial.legendre.leggauss(len(terms))
    places, weights = 0.5 * (places + 1.0), 0.5 * weights
    times = arc.start.high + begins[:, None] + spans[:, None] * places
    powers = places[:, None] ** terms
    slopes = terms[1:] * powers[:, :-1]
    moving = steps.swapaxes(1, 2)
    states, tape = powers @ moving, rates()

    def scaled_rates(states: Array) -> Array:
        values = tape.table(states.reshape(-1, len(ranges)), parameters, times.ravel())
        return values.reshape(*times.shape, -1) / ranges

    at_start = scaled_rates(np.broadcast_to(steps[0, :, 0], states.shape))
    if (at_start != at_start[0, 0]).any():
        return ()
    flow = scaled_rates(states)
    defects = slopes @ moving[:, 1:] / (spans[:, None, None] * ranges) - flow
    squares = (flow**2).sum(axis=2)
    slow = squares.mean(axis=1) < _LEAVES**2 * squares.max()
    shifts = ((defects * flow).sum(axis=2) / squares @ weights * spans)[slow]
    late = float(np.abs(shifts).sum())
    if not late > math.sqrt(tolerance) * arc.duration:
        return ()
    return (
        f"the run leaves an unstable equilibrium, where its motion is smaller than the errors of "
        f"steps: times are off by about {late:.2g}; start farther away, or take a smaller "
        "tolerance",
    )
