"""Taylor steps in one call: heyoka's compiled step, run from a compiled loop."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.engines.heyoka_step import call_step
from statechart.kernels.copies import put
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import horner
from statechart.kernels.reconstruction import Program, reconstruct_any

# So far off the rate may the slope at the end of a step be, in parts of the motion in it and for
# orders that do better: stiff springs at rest are by less in rounding.
STRAY = 1e-9
ORDERS = 1e2  # likewise in tolerances, for orders that do worse
# The motion counts as so much at least: below 1 heyoka's tolerance is absolute.
LEAST_MOTION = 1e-6
# Above this it is never rounding; below, what falls by less as a step is halved is: what a series
# leaves out falls with a power above its order.
_ROUGH, _ROUNDING = 1e-3, 0.25
# Where the rate itself ends no length of a step helps, and none is made.
HALVINGS = 40

Integrator = tuple[int, Array, Array, Array, Array, float, float]
"""heyoka's, its step linked: address, state (n,), parameters (p,), clock (2,) with the time since
the integration began and its rounding, series (n, d + 1), tolerance, longest step."""


@kernel
def stray(row: Array, h: float, series: Array, offs: Array, reaches: Array) -> float:
    """How far the slope at the end of a step is off the rate there, in parts of the motion.

    Infinite where the step is not finite.

    Writes how far it is of each variable (n,), and how large each is and moves in the step.
    """
    worst, size = 0.0, LEAST_MOTION
    for v in range(row.shape[0]):
        slope, reach = 0.0, abs(row[v, 0])
        for k in range(1, row.shape[1]):
            slope += k * row[v, k]
            reach += k * abs(row[v, k])
        off = abs(slope - h * series[v, 1])
        offs[v], reaches[v] = off, reach
        if not (off < math.inf and reach < math.inf):
            return math.inf
        worst, size = max(worst, off), max(size, reach)
    return worst / size


@kernel
def expand(series: Array, h: float, row: Array, powers: Array) -> None:
    """Write a series in time as a polynomial in s = time / h, and the powers (d + 1,) of h.

    Term by term without a look at any: so processors do many at once.
    """
    factor = 1.0
    for k in range(series.shape[1]):
        powers[k] = factor
        factor *= h
    for v in range(series.shape[0]):
        for k in range(series.shape[1]):
            # Nothing to a power beyond all floats is nothing.
            value = series[v, k] * powers[k]
            row[v, k] = 0.0 if series[v, k] == 0.0 else value


@kernel
def _finite(row: Array) -> bool:
    """Whether all terms of a step are."""
    bounded = True
    for v in range(row.shape[0]):
        for k in range(row.shape[1]):
            bounded = bounded and abs(row[v, k]) < math.inf
    return bounded


@kernel
def let_pass(clock: Array, h: float) -> None:
    """Let the time `h` pass (Knuth's two-sum)."""
    later = clock[0] + h
    passed = later - clock[0]
    clock[1] += (clock[0] - (later - passed)) + (h - passed)
    clock[0] = later


@kernel
def taylor_steps(
    integrator: Integrator,
    duration: float,
    count: int,
    first: int,
    times: Array,
    coeffs: Array,
    end: Array,
    follows: Program,
    start: float,
) -> tuple[int, int, float, float]:
    """Take up to `count` steps in `duration`, behind the `first` ones of an arc.

    Writes when they end to `times`, their polynomials in s = time / duration to `coeffs`, and
    the state at the end of the last finite one to `end`. The integrator's state is left where the
    last step ends, and its clock is advanced.

    The length of a step follows from the last two terms of its series, and where these are
    missing it says nothing: x' = 1 - x**4 has every fourth only, from x = 0. So the slope at the
    end of each step is compared with the rate there, with which the series of the next begins,
    and a step that strays is made again at half its length.

    What follows from other variables (`follows`) does so wherever a step begins, and at the end;
    `start` is when the flow begins.

    Returns
    -------
    taken, finite : int
        How many steps were made, and how many of them are finite.
    h, left : float
        Length of the last step, and what was left before it.
    """
    address, state, parameters, clock, series, tolerance, max_step = integrator
    n, allowed = series.shape[0], max(STRAY, ORDERS * tolerance)
    step, here, begun = np.empty(1), np.empty(n), np.empty(n)
    offs, reaches, powers = np.empty(n), np.empty(n), np.empty(series.shape[1])
    left, total, taken = duration, 0.0, 0
    longest, off, halvings, done, again = max_step, math.inf, 0, False, False
    h, since, rest, summed, length = 0.0, 0.0, 0.0, 0.0, left
    while True:
        reconstruct_any(follows, state, start + times[first + taken])
        put(state, here)
        step[0] = 0.0 if done else min(left, longest)
        call_step(address, state, parameters, clock, step, series)
        # The step before the one that is made again has been looked at.
        if taken > 0 and not again:
            last = first + taken - 1
            before, off = off, stray(coeffs[last], h, series, offs, reaches)
            falls = halvings == 0 or off > _ROUGH or off <= _ROUNDING * before
            if off > allowed and falls:
                halvings += 1
                longest, done, again = 0.5 * h, False, True
                taken -= 1
                total, left, clock[0], clock[1] = summed, length, since, rest
                put(begun, state)
                put(begun, end)
                if halvings > HALVINGS:
                    return taken, taken, 0.0, left
                continue
            longest, halvings = max_step, 0
        if done:
            return taken, taken, h, left
        h, again = step[0], False
        put(here, begun)
        expand(series, h, coeffs[first + taken], powers)
        bounded = _finite(coeffs[first + taken])
        taken += 1
        summed, length, since, rest = total, left, clock[0], clock[1]
        let_pass(clock, h)
        if not bounded:
            return taken, taken - 1, h, left
        total += h
        # Summed from the start of these steps, so that long arcs lose nothing.
        times[first + taken] = times[first] + total
        for v in range(n):
            end[v] = horner(coeffs, first + taken - 1, v, 1.0)
        if not times[first + taken] > times[first + taken - 1]:
            # On its way into a singularity, for ever.
            return taken, taken, 0.0, left
        # A step is cut to end at the duration exactly, and then its length is what was left.
        done = taken == count or h == left
        if not done:
            left -= h
