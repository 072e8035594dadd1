"""The polynomials of steps: positions of the second degree, rates of the first.

That is what the midpoint rule's positions and velocities at the ends of a step amount to. A step
with impacts has them at one instant, and is two parts with the lasting forces on both sides.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array

TERMS = 3
"""Terms of the polynomial of a step."""


def smooth(left: Array, right: Array, h: Array | float, n: int) -> Array:
    """Return the coefficients (k, w, TERMS) of steps in which nothing strikes.

    Parameters
    ----------
    left, right : (k, w) array
        States where they begin and end.
    h : float or (k, 1) array
        Their length.
    n : int
        How many coordinates there are; behind them and their rates stands what is remembered.
    """
    coefficients = np.zeros((*left.shape, TERMS))
    coefficients[:, :, 0] = left
    coefficients[:, :n, 1] = h * left[:, n : 2 * n]
    coefficients[:, n:, 1] = right[:, n:] - left[:, n:]
    coefficients[:, :n, 2] = 0.5 * h * coefficients[:, n : 2 * n, 1]
    return coefficients


def struck(
    left: Array, right: Array, acceleration: Array, lengths: tuple[Array, Array], n: int
) -> tuple[Array, Array]:
    """Return the coefficients (k, w, TERMS) of both parts of steps, before and after impacts.

    Parameters
    ----------
    left, right, n
        As of `smooth`.
    acceleration : (k, n) array
        Under what lasts.
    lengths : two (k, 1) arrays
        Of the parts.
    """
    middle = 0.5 * (left + right)[:, 2 * n :]
    # Of the velocities as they were and will be, so that the ends of the step are exact.
    halves = []
    for state, sign, h in ((left, 1.0, lengths[0]), (right, -1.0, lengths[1])):
        half = np.zeros((*left.shape, TERMS))
        rates = state[:, n : 2 * n]
        near = rates + sign * 0.5 * h * acceleration
        other = state[:, :n] + sign * h * near
        fast = rates + sign * h * acceleration
        begin = (state[:, :n], rates) if sign > 0.0 else (other, fast)
        half[:, :n, 0], half[:, n : 2 * n, 0] = begin
        half[:, :n, 1] = h * begin[1]
        half[:, :n, 2] = 0.5 * h**2 * acceleration
        half[:, n : 2 * n, 1] = h * acceleration
        half[:, 2 * n :, 0] = state[:, 2 * n :] if sign > 0.0 else middle
        half[:, 2 * n :, 1] = sign * (middle - state[:, 2 * n :])
        halves.append(half)
    return halves[0], halves[1]


def defined(rows: Array) -> Array:
    """Put in the place of what is not a number what the nearest row has, the later of two."""
    unknown = np.isnan(rows)
    if not unknown.any():
        return rows
    result = rows.copy()
    for column in np.flatnonzero(unknown.any(axis=0)).tolist():
        known = np.flatnonzero(~unknown[:, column])
        if not len(known):
            continue
        blank = np.flatnonzero(unknown[:, column])
        after = np.minimum(np.searchsorted(known, blank), len(known) - 1)
        before = np.maximum(after - 1, 0)
        later = np.abs(known[after] - blank) <= np.abs(known[before] - blank)
        result[blank, column] = rows[np.where(later, known[after], known[before]), column]
    return result
