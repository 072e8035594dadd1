"""The polynomials of steps: positions of the second degree, rates of the first.

That is what the midpoint rule's positions and velocities at the ends of a step amount to. A step
with impacts has them in its middle, and is two halves with the lasting forces on both sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Bools, Ints

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
    left: Array, right: Array, acceleration: Array, h: Array | float, n: int
) -> tuple[Array, Array]:
    """Return the coefficients (k, w, TERMS) of both halves of steps with impacts in their middle.

    Parameters
    ----------
    left, right, h, n
        As of `smooth`.
    acceleration : (k, n) array
        Under what lasts.
    """
    middle = 0.5 * (left + right)[:, 2 * n :]
    # Of the velocities as they were and will be, so that the ends of the step are exact.
    halves = []
    for state, sign in ((left, 1.0), (right, -1.0)):
        half = np.zeros((*left.shape, TERMS))
        rates = state[:, n : 2 * n]
        near = rates + sign * 0.25 * h * acceleration
        other = state[:, :n] + sign * 0.5 * h * near
        fast = rates + sign * 0.5 * h * acceleration
        begin = (state[:, :n], rates) if sign > 0.0 else (other, fast)
        half[:, :n, 0], half[:, n : 2 * n, 0] = begin
        half[:, :n, 1] = 0.5 * h * begin[1]
        half[:, :n, 2] = 0.125 * h**2 * acceleration
        half[:, n : 2 * n, 1] = 0.5 * h * acceleration
        half[:, 2 * n :, 0] = state[:, 2 * n :] if sign > 0.0 else middle
        half[:, 2 * n :, 1] = sign * (middle - state[:, 2 * n :])
        halves.append(half)
    return halves[0], halves[1]


class Pieces(NamedTuple):
    """The polynomials of consecutive steps: one of each, two of one with impacts.

    Attributes
    ----------
    terms : (p, w, TERMS) array
        Coefficients.
    places : (k + 1,) array of int
        Where those of each step begin.
    """

    terms: Array
    places: Ints

    @classmethod
    def of(cls, states: Array, acceleration: Array, h: Array | float, hit: Bools, n: int) -> Pieces:
        """Return those of steps.

        Parameters
        ----------
        states : (k + 1, w) array
            Where they begin and end.
        acceleration, h, n
            As of `struck`.
        hit : (k,) array of bool
            In which of them something strikes.
        """
        left, right = states[:-1], states[1:]
        if not hit.any():
            return cls(smooth(left, right, h, n), np.arange(len(hit) + 1))
        places = np.concatenate([[0], np.cumsum(1 + hit)])
        at, lengths = places[:-1], np.broadcast_to(h, (len(hit), 1))
        halves = struck(left[hit], right[hit], acceleration[hit], lengths[hit], n)
        found = np.concatenate([smooth(left[~hit], right[~hit], lengths[~hit], n), *halves])
        # NumPy takes rows ten times as fast as it puts them.
        order = np.concatenate([at[~hit], at[hit], at[hit] + 1])
        return cls(found[np.argsort(order)], places)


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
