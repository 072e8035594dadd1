"""Small dense linear systems: saddle points of a mass matrix and contact rows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

SOLVED, SINGULAR, INEXACT, REDUNDANT, CONTRADICTORY, UNDETERMINED = range(6)

# Largest accepted residual, relative to its terms.
_RESIDUAL = 1e-8
# Smallest normal number: below it digits are lost, and the scaling power of two overflows.
SMALLEST = 2.0**-1022
_UNIT_ROUND_OFF = 2.0**-52


@kernel
def power_of_two(size: float) -> float:
    """Return the power of two that scales a size into [1, 2); 1 for zero and non-finite sizes."""
    if size >= SMALLEST and math.isfinite(size):
        return math.ldexp(1.0, 1 - math.frexp(size)[1])
    return 1.0


@kernel
def largest_size(values: Array) -> float:
    """Return the largest absolute value."""
    largest = 0.0
    for value in values:
        largest = max(largest, abs(value))
    return largest


@kernel
def largest_in_column(matrix: Array, k: int) -> float:
    """Return the largest absolute value in a column."""
    largest = 0.0
    for i in range(matrix.shape[0]):
        largest = max(largest, abs(matrix[i, k]))
    return largest


class SaddleWorkspace(NamedTuple):
    """Workspace of systems of up to s unknowns."""

    # of shape (s, s) each
    factors: Array
    errors: Array
    # of shape (s,) each
    column_scale: Array
    y: Array
    residual: Array
    order: Ints  # shape (s,)


@kernel
def saddle_workspace(size: int) -> SaddleWorkspace:
    """Allocate the workspace of systems of up to `size` unknowns."""
    return SaddleWorkspace(
        np.empty((size, size)), np.empty((size, size)), np.empty(size), np.empty(size),
        np.empty(size), np.empty(size, np.int64),
    )  # fmt: skip


@kernel
def _equilibrate(scaled: Array, b: Array, size: int, column_scale: Array) -> None:
    """Scale rows and columns to size 1, in place, by powers of two; write the column scales."""
    # Columns first: masses may span many decades.
    for k in range(size):
        scale = power_of_two(largest_in_column(scaled[:size], k))
        for i in range(size):
            scaled[i, k] *= scale
        column_scale[k] = scale
    for i in range(size):
        scale = power_of_two(largest_size(scaled[i, :size]))
        for k in range(size):
            scaled[i, k] *= scale
        b[i] *= scale


@kernel
def factorise(factors: Array, order: Ints, errors: Array) -> bool:
    """LU with partial pivoting, in place; False where no pivot is left.

    A pivot that round-off could have produced from zero counts as zero: first-order running error
    analysis (Wilkinson 1963), with entries known to a unit round-off.
    """
    size = len(order)
    for i in range(size):
        for k in range(size):
            errors[i, k] = abs(factors[i, k]) * _UNIT_ROUND_OFF
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(factors[i, k]) > abs(factors[best, k]):
                best = i
        pivot = factors[best, k]
        if abs(pivot) <= errors[best, k] or not math.isfinite(pivot):
            return False
        if best != k:
            for c in range(size):
                factors[k, c], factors[best, c] = factors[best, c], factors[k, c]
                errors[k, c], errors[best, c] = errors[best, c], errors[k, c]
            order[k], order[best] = order[best], order[k]
        for i in range(k + 1, size):
            factor = factors[i, k] / pivot
            unsure = (errors[i, k] + abs(factor) * errors[k, k]) / abs(pivot)
            factors[i, k] = factor
            if unsure != 0.0:
                for c in range(k + 1, size):
                    product = factor * factors[k, c]
                    factors[i, c] -= product
                    errors[i, c] += abs(factor) * errors[k, c] + unsure * abs(factors[k, c])
                    errors[i, c] += _UNIT_ROUND_OFF * abs(product)
    return True


@kernel
def substitute(factors: Array, order: Ints, right: Array, y: Array) -> None:
    """Solve with the factors, forwards and backwards."""
    size = len(order)
    for i in range(size):
        total = right[order[i]]
        for c in range(i):
            total -= factors[i, c] * y[c]
        y[i] = total
    for i in range(size - 1, -1, -1):
        total = y[i]
        for c in range(i + 1, size):
            total -= factors[i, c] * y[c]
        y[i] = total / factors[i, i]


@kernel
def solve_refined(scaled: Array, b: Array, x: Array) -> int:
    """Solve ``scaled x = b`` with partial pivoting and two refinements.

    Matrix and right side are equilibrated in place.
    """
    return solve_in(saddle_workspace(len(b)), scaled, b, x, len(b))


@kernel
def solve_in(memory: SaddleWorkspace, scaled: Array, b: Array, x: Array, size: int) -> int:
    """Solve the leading `size` unknowns of larger arrays; see `solve_refined`."""
    factors, errors, column_scale, y, residual, orders = memory
    order = orders[:size]
    _equilibrate(scaled, b, size, column_scale)
    for i in range(size):
        order[i], residual[i], x[i] = i, b[i], 0.0
        for k in range(size):
            factors[i, k] = scaled[i, k]
    if not factorise(factors, order, errors):
        return SINGULAR
    for _ in range(3):
        substitute(factors, order, residual, y)
        for i in range(size):
            x[i] += y[i]
        for i in range(size):
            total = b[i]
            for c in range(size):
                total -= scaled[i, c] * x[c]
            residual[i] = total
    terms, largest = y, 0.0
    for i in range(size):
        if not math.isfinite(x[i]):
            return SINGULAR
        terms[i] = abs(b[i])
        for c in range(size):
            terms[i] += abs(scaled[i, c] * x[c])
        largest = max(largest, terms[i])
    # A row whose own terms vanish (V = 0 at mu = inf) is compared with the round-off of others.
    rounding = 1e-14 * largest + SMALLEST
    for i in range(size):
        if abs(residual[i]) > _RESIDUAL * terms[i] + rounding:
            return INEXACT
        x[i] *= column_scale[i]
    return SOLVED


@kernel
def saddle(
    mass: Array, right: Array, rows: Array, columns: Array, constants: Array
) -> tuple[int, Array]:
    """Solve ``mass a - columns^T f = right``, ``rows a = constants`` for (a, f)."""
    n, m = len(right), len(constants)
    matrix = np.zeros((n + m, n + m))
    b = np.empty(n + m)
    for i in range(n):
        b[i] = right[i]
        for k in range(n):
            matrix[i, k] = mass[i, k]
        for k in range(m):
            matrix[i, n + k] = -columns[k, i]
    for i in range(m):
        b[n + i] = constants[i]
        for k in range(n):
            matrix[n + i, k] = rows[i, k]
    x = np.empty(n + m)
    return solve_refined(matrix, b, x), x
