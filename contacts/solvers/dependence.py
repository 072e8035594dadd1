"""Linear dependence of constraint rows, with one relative threshold for each purpose."""

from __future__ import annotations

import numpy as np

from contacts.solvers.saddle_point import SMALLEST, largest_in_column, largest_size, power_of_two
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

CANCELLING = 1e-10
"""For rows of a linear system: below it forces and accelerations are huge and cancel, and fewer
than 6 of 16 digits are left."""

USER_DIGITS = 1e-8
"""For rows at a user's configuration, which is known to the digits written. What they determine has
an error of 1e-16 / 1e-8."""

DEAD_POINT = 1e-5
"""For a motion under way, in the scene's scales: a linkage that passes a dead point closer leaves
its branch to round-off."""


@kernel
def independent_rows(rows: Array, threshold: float = CANCELLING) -> tuple[int, Ints, Ints]:
    """Return the rank, and the orders of rows and columns: the first `rank` are independent.

    Elimination with complete pivoting, rows and then columns scaled by powers of two; of equal
    pivots the first is taken, so that earlier rows are preferred.
    """
    count, size = rows.shape
    reduced = rows.copy()
    row_order, column_order = np.arange(count), np.arange(size)
    for i in range(count):
        scale = power_of_two(largest_size(reduced[i]))
        for k in range(size):
            reduced[i, k] *= scale
    for k in range(size):
        scale = power_of_two(largest_in_column(reduced, k))
        for i in range(count):
            reduced[i, k] *= scale
    for r in range(min(count, size)):
        best, at, column = 0.0, r, r
        for i in range(r, count):
            for k in range(r, size):
                # Pivots within a factor of two are equally good.
                if abs(reduced[i, k]) > 2.0 * best:
                    best, at, column = abs(reduced[i, k]), i, k
        if not best > threshold:
            return r, row_order, column_order
        if at != r:
            row_order[r], row_order[at] = row_order[at], row_order[r]
            for k in range(size):
                reduced[r, k], reduced[at, k] = reduced[at, k], reduced[r, k]
        if column != r:
            column_order[r], column_order[column] = column_order[column], column_order[r]
            for i in range(count):
                reduced[i, r], reduced[i, column] = reduced[i, column], reduced[i, r]
        for i in range(r + 1, count):
            factor = reduced[i, r] / reduced[r, r]
            for k in range(r, size):
                reduced[i, k] -= factor * reduced[r, k]
    return min(count, size), row_order, column_order


def column_scales(rows: Array) -> Array:
    """Return powers of two that scale the columns to size 1; 1 for zero and non-finite columns."""
    largest = np.abs(rows).max(axis=0, initial=0.0)
    largest[(largest < SMALLEST) | ~np.isfinite(largest)] = 1.0
    return np.ldexp(1.0, -np.frexp(largest)[1])


def dependent_rows(rows: Array) -> Bools:
    """Return which rows (m, n) depend on those before them; zero rows do."""
    dependent = np.zeros(len(rows), dtype=np.bool_)
    for i in range(len(rows)):
        earlier = np.flatnonzero(~dependent[: i + 1])
        dependent[i] = independent_rows(rows[earlier], USER_DIGITS)[0] < len(earlier)
    return dependent


def rank(sizes: Array, threshold: float = USER_DIGITS) -> int:
    """Return the number of singular values (largest first) above a relative threshold."""
    return int(np.count_nonzero(sizes > threshold * sizes[0]))


def null_space(rows: Array, threshold: float = USER_DIGITS) -> Array:
    """Return an orthonormal basis (n, k) of the null space of rows (m, n)."""
    if not rows.size:
        return np.eye(rows.shape[1])
    _, sizes, right = np.linalg.svd(rows)
    return right[rank(sizes, threshold) :].T


def least_squares(rows: Array, right: Array) -> tuple[Array, Array]:
    """Return the minimum-norm least-squares solution, and its residual ``right - rows x``."""
    scale = column_scales(rows)
    x = np.linalg.lstsq(rows * scale, right, rcond=USER_DIGITS)[0] * scale
    return x, right - rows @ x


def reduce_to_independent(rows: Array, right: Array) -> tuple[Array, Array]:
    """Return independent rows, and right-hand sides (m, ...), with the same solutions.

    Contradictory sides are replaced by their least-squares approximation.
    """
    scale = column_scales(rows)
    outer, sizes, inner = np.linalg.svd(rows * scale, full_matrices=False)
    count = rank(sizes)
    if count == len(rows):
        return rows, right
    return inner[:count] / scale, (outer[:, :count].T @ right) / sizes[:count, None]
