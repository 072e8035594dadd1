"""Tests of linear dependence of constraint rows, with one threshold for each purpose.

What is near is a pure number: a part of rows and columns that are brought to a size of 1.
"""

from __future__ import annotations

import numpy as np

from contacts.solvers.saddle_point import SMALLEST, largest_in_column, largest_size, power_of_two
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

CANCELLING = 1e-10
"""Of rows that are solved with: nearer, the forces and accelerations are huge and cancel, and of
the 16 digits of their terms less than 6 are left."""

USER_DIGITS = 1e-8
"""Of rows at a configuration that a user gives, and where it may be as far off as the digits
written: a part so small is none. What they determine has an error of 1e-16 / 1e-8."""

DEAD_POINT = 1e-5
"""Of a motion under way, in the scene's sizes: a linkage passes no nearer by a dead point without
leaving its way on to rounding."""


@kernel
def independent(rows: Array, near: float = CANCELLING) -> tuple[int, Ints, Ints]:
    """Return the rank, and the orders of rows and columns: the first `rank` are independent.

    Elimination with complete pivoting, rows and then columns scaled by powers of two; the first
    of equal pivots is taken, so that rows that come earlier are kept.
    """
    count, size = rows.shape
    left = rows.copy()
    row_order, column_order = np.arange(count), np.arange(size)
    for i in range(count):
        scale = power_of_two(largest_size(left[i]))
        for k in range(size):
            left[i, k] *= scale
    for k in range(size):
        scale = power_of_two(largest_in_column(left, k))
        for i in range(count):
            left[i, k] *= scale
    for r in range(min(count, size)):
        best, at, beside = 0.0, r, r
        for i in range(r, count):
            for k in range(r, size):
                # Pivots within a factor of two are as good as each other.
                if abs(left[i, k]) > 2.0 * best:
                    best, at, beside = abs(left[i, k]), i, k
        if not best > near:
            return r, row_order, column_order
        if at != r:
            row_order[r], row_order[at] = row_order[at], row_order[r]
            for k in range(size):
                left[r, k], left[at, k] = left[at, k], left[r, k]
        if beside != r:
            column_order[r], column_order[beside] = column_order[beside], column_order[r]
            for i in range(count):
                left[i, r], left[i, beside] = left[i, beside], left[i, r]
        for i in range(r + 1, count):
            factor = left[i, r] / left[r, r]
            for k in range(r, size):
                left[i, k] -= factor * left[r, k]
    return min(count, size), row_order, column_order


def column_scales(rows: Array) -> Array:
    """Return powers of two (exact) that bring the columns to size 1; 1 where none does."""
    largest = np.abs(rows).max(axis=0, initial=0.0)
    largest[(largest < SMALLEST) | ~np.isfinite(largest)] = 1.0
    return np.ldexp(1.0, -np.frexp(largest)[1])


def implied(rows: Array) -> Bools:
    """Return which rows (m, n) those before them imply; rows without entries among them."""
    found = np.zeros(len(rows), dtype=np.bool_)
    for i in range(len(rows)):
        kept = np.flatnonzero(~found[: i + 1])
        found[i] = independent(rows[kept], USER_DIGITS)[0] < len(kept)
    return found


def rank(sizes: Array) -> int:
    """Return how many singular values, the largest first, are of independent rows as given."""
    return int(np.count_nonzero(sizes > USER_DIGITS * sizes[0]))


def null_space(rows: Array) -> Array:
    """Return an orthonormal basis (n, k) of what the rows (m, n) do not see."""
    if not rows.size:
        return np.eye(rows.shape[1])
    _, sizes, right = np.linalg.svd(rows)
    return right[rank(sizes) :].T


def least(rows: Array, right: Array) -> tuple[Array, Array]:
    """Return the least x with the least ``right - rows x``, and that."""
    scale = column_scales(rows)
    x = np.linalg.lstsq(rows * scale, right, rcond=USER_DIGITS)[0] * scale
    return x, right - rows @ x


def well_posed(rows: Array, right: Array) -> tuple[Array, Array]:
    """Return independent rows, and right-hand sides (m, ...), with the same solutions.

    Where the sides contradict each other, the least-squares ones.
    """
    scale = column_scales(rows)
    outer, sizes, inner = np.linalg.svd(rows * scale, full_matrices=False)
    count = rank(sizes)
    if count == len(rows):
        return rows, right
    return inner[:count] / scale, (outer[:, :count].T @ right) / sizes[:count, None]
