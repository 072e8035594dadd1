"""The polynomials of steps: positions of the second degree, rates of the first.

That is what the midpoint rule's positions and velocities at the ends of a step amount to. A step
with impacts has them at one instant, and is two parts with the lasting forces on both sides.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Bools, Ints

TERMS = 3
"""Terms of the polynomial of a step."""


def smooth(left: Array, right: Array, h: Array | float, n: int) -> Array:
    """Return the coefficients (k, w, TERMS) of steps in which nothing strikes."""
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
    kept = slice(2 * n, None)
    middle = 0.5 * (left[:, kept] + right[:, kept])
    # Of the velocities as they were and will be, so that the ends of the step are exact.
    rates, (before, after) = right[:, n : 2 * n], lengths
    second = np.empty_like(right)
    second[:, :n] = right[:, :n] - after * (rates - 0.5 * after * acceleration)
    second[:, n : 2 * n] = rates - after * acceleration
    second[:, kept] = middle
    parts = []
    for begin, change, length in (
        (left, middle - left[:, kept], before),
        (second, -(middle - right[:, kept]), after),
    ):
        terms = np.zeros((*left.shape, TERMS))
        terms[:, :, 0] = begin
        terms[:, :n, 1] = length * begin[:, n : 2 * n]
        terms[:, :n, 2] = 0.5 * length**2 * acceleration
        terms[:, n : 2 * n, 1] = length * acceleration
        terms[:, kept, 1] = change
        parts.append(terms)
    return parts[0], parts[1]


class Pieces(NamedTuple):
    """The polynomials of consecutive steps: one of each, two of one with impacts."""

    terms: Array  # (p, w, TERMS): coefficients.
    places: Ints  # (k + 1,): where those of each step begin.

    @classmethod
    def of(
        cls, states: Array, acceleration: Array, h: Array | float, late: Array, hit: Bools, n: int
    ) -> Pieces:
        """Return those of steps.

        Parameters
        ----------
        states : (k + 1, w) array
            Where they begin and end.
        acceleration, n
            As of `struck`.
        h : float or (k, 1) array
            Their length.
        late : (k,) array
            How long after their middles something strikes.
        hit : (k,) array of bool
            In which of them something strikes.
        """
        left, right = states[:-1], states[1:]
        if not hit.any():
            return cls(smooth(left, right, h, n), np.arange(len(hit) + 1))
        places = np.concatenate([[0], np.cumsum(1 + hit)])
        at, lengths = places[:-1], np.broadcast_to(h, (len(hit), 1))
        before = 0.5 * lengths[hit] + late[hit, None]
        parts = struck(left[hit], right[hit], acceleration[hit], (before, lengths[hit] - before), n)
        found = np.concatenate([smooth(left[~hit], right[~hit], lengths[~hit], n), *parts])
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
