"""Polynomials of the steps of an arc: construction, evaluation, truncation."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.kernels.jit import kernel


@kernel
def horner(coeffs: Array, step: int, v: int, s: float) -> float:
    """Value of a variable at the place s of a step."""
    value = 0.0
    for k in range(coeffs.shape[2] - 1, -1, -1):
        value = value * s + coeffs[step, v, k]
    return value


@kernel
def values_at(coeffs: Array, step: int, v: int, places: Array, values: Array) -> None:
    """Write the values (m,) of a variable at places (m,) of a step.

    The inner loop runs over the places, so that it is vectorised; inlined with a constant number
    of places it would not be.
    """
    top, count = coeffs.shape[2] - 1, places.shape[0]
    term = coeffs[step, v, top]
    for j in range(count):
        values[j] = term
    for k in range(top - 1, -1, -1):
        term = coeffs[step, v, k]
        for j in range(count):
            values[j] = values[j] * places[j] + term


@kernel
def slopes_at(
    coeffs: Array, step: int, v: int, places: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Slopes of a variable at three places of a step, vectorised."""
    a, b, c = places
    e = f = g = 0.0
    for k in range(coeffs.shape[2] - 1, 0, -1):
        term = k * coeffs[step, v, k]
        e, f, g = e * a + term, f * b + term, g * c + term
    return e, f, g


@kernel
def write_sizes(coeffs: Array, step: int, floors: Array, sizes: Array) -> None:
    """Write the sizes (n,) of the variables and of their motion in a step, at least `floors`."""
    for v in range(coeffs.shape[1]):
        reach = abs(coeffs[step, v, 0])
        for k in range(1, coeffs.shape[2]):
            reach += k * abs(coeffs[step, v, k])
        sizes[v] = max(reach, floors[v])


@kernel
def local_time(times: Array, step: int, s: float) -> float:
    """Local time of the place s in a step; exact at both ends."""
    if s >= 1.0:
        return times[step + 1]
    return times[step] + s * (times[step + 1] - times[step])


@kernel
def append_steps(
    durations: Array, taken: int, first: int, times: Array, coeffs: Array, end: Array
) -> int:
    """Convert Taylor coefficients in time to s = time / duration, in place; write `times`.

    The steps follow the `first` ones. Returns the number of finite steps, up to `taken`, and
    writes the state at their end.
    """
    _, n, terms = coeffs.shape
    total, finite = 0.0, 0
    while finite < taken:
        step, duration, bounded = coeffs[first + finite], durations[finite], True
        for v in range(n):
            factor = 1.0
            for k in range(terms):
                step[v, k] *= factor
                factor *= duration
                bounded = bounded and abs(step[v, k]) < math.inf
        if not bounded:
            break
        # The sum starts at the first of these steps: less round-off in long arcs.
        total += duration
        finite += 1
        times[first + finite] = times[first] + total
    if finite > 0:
        for v in range(n):
            end[v] = horner(coeffs, first + finite - 1, v, 1.0)
    return finite


@kernel
def cut_steps(times: Array, coeffs: Array, count: int, end: float, state: Array) -> int:
    """End an arc of `count` steps at local time `end`, in place, and write the state there.

    Returns the number of remaining steps; without steps the state is unchanged.
    """
    while count > 0 and times[count - 1] >= end:
        count -= 1
    if count > 0:
        step = coeffs[count - 1]
        s = (end - times[count - 1]) / (times[count] - times[count - 1])
        times[count] = end
        for v in range(step.shape[0]):
            factor = 1.0
            for k in range(step.shape[1]):
                step[v, k] *= factor
                factor *= s
            state[v] = horner(coeffs, count - 1, v, 1.0)
    return count


@kernel
def sample_states(coeffs: Array, times: Array, tau: Array) -> Array:
    """States at local times; shape (m, n)."""
    last = coeffs.shape[0] - 1
    result = np.empty((tau.shape[0], coeffs.shape[1]))
    for j in range(tau.shape[0]):
        low, high = 0, last + 1
        while high - low > 1:
            step = (low + high) // 2
            if times[step] <= tau[j]:
                low = step
            else:
                high = step
        step = low
        span = times[step + 1] - times[step]
        s = (tau[j] - times[step]) / span if span > 0.0 else 0.0
        for v in range(coeffs.shape[1]):
            result[j, v] = horner(coeffs, step, v, s)
    return result


def term_sizes(times: Array, coeffs: Array) -> Array:
    """Terms of the variables in the last step of an arc, and their rates times its length.

    Shape (n, d + 2); (n, d + 1) without the rates if the arc lasts for no time.
    """
    # A last step below the round-off of time has no rate: use the one before.
    long = np.flatnonzero(np.diff(times))
    if not len(long):
        return coeffs[-1].copy()
    step = long[-1]
    with np.errstate(all="ignore"):
        rates = (np.arange(coeffs.shape[2]) * coeffs[step]).sum(axis=1)
        lengths = times[-1] / (times[step + 1] - times[step])
        return np.append(coeffs[-1], rates[:, None] * lengths, axis=1)
