"""Small dense linear systems, compiled once: saddle points of a mass matrix and contact rows."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "AGAINST",
    "CONTRADICTORY",
    "FREE",
    "INEXACT",
    "INTO",
    "OFF",
    "OUTSIDE",
    "PIN",
    "PULLS",
    "REDUNDANT",
    "SINGULAR",
    "SLIDE",
    "SLIDE_MINUS",
    "SLIDE_PLUS",
    "SOLVED",
    "UNDETERMINED",
    "independent",
    "saddle",
    "solve_modes",
]

Array = NDArray[np.float64]

FREE, PIN, SLIDE, SLIDE_PLUS, SLIDE_MINUS, OFF = range(6)
SOLVED, SINGULAR, INEXACT, REDUNDANT, CONTRADICTORY, UNDETERMINED = range(6)
INTO, PULLS, OUTSIDE, AGAINST = range(4)

# What only kernels call needs nothing to be called by from Python, and compiles sooner without.
_kernel = njit(cache=True, no_cfunc_wrapper=True)
_inner = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)

# A solution whose residual stays above this, relative to its terms, is refused.
_RESIDUAL = 1e-8
# Rows this close to dependent are: elimination would give forces that are huge and cancel.
_DEPENDENT = 1e-10
# Constraints that others imply are contradicted when the accelerations miss them by this.
_CONTRADICTED = 1e-9


@_inner
def _power_of_two(size: float) -> float:
    if size > 0.0 and math.isfinite(size):
        return math.ldexp(1.0, 1 - math.frexp(size)[1])
    return 1.0


@_inner
def _largest(values: Array) -> float:
    largest = 0.0
    for value in values:
        largest = max(largest, abs(value))
    return largest


@_inner
def _solve(matrix: Array, right: Array) -> tuple[int, Array]:
    """Solve with equilibration by powers of two (exact), partial pivoting, two refinements."""
    size = len(right)
    column_scale = np.empty(size)
    row_scale = np.empty(size)
    scaled = matrix.copy()
    # Columns first: masses may span many decades.
    for k in range(size):
        column_scale[k] = _power_of_two(_largest(scaled[:, k]))
        for i in range(size):
            scaled[i, k] *= column_scale[k]
    b, order = np.empty(size), np.empty(size, np.int64)
    for i in range(size):
        row_scale[i] = _power_of_two(_largest(scaled[i, :]))
        for k in range(size):
            scaled[i, k] *= row_scale[i]
        b[i] = right[i] * row_scale[i]
        order[i] = i
    factors = scaled.copy()
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(factors[i, k]) > abs(factors[best, k]):
                best = i
        pivot = factors[best, k]
        if pivot == 0.0 or not math.isfinite(pivot):
            return SINGULAR, b
        if best != k:
            for c in range(size):
                factors[k, c], factors[best, c] = factors[best, c], factors[k, c]
            order[k], order[best] = order[best], order[k]
        for i in range(k + 1, size):
            factor = factors[i, k] / pivot
            factors[i, k] = factor
            if factor != 0.0:
                for c in range(k + 1, size):
                    factors[i, c] -= factor * factors[k, c]
    x, y = np.zeros(size), np.empty(size)
    residual = b.copy()
    for _ in range(3):
        for i in range(size):
            total = residual[order[i]]
            for c in range(i):
                total -= factors[i, c] * y[c]
            y[i] = total
        for i in range(size - 1, -1, -1):
            total = y[i]
            for c in range(i + 1, size):
                total -= factors[i, c] * y[c]
            y[i] = total / factors[i, i]
        for i in range(size):
            x[i] += y[i]
        for i in range(size):
            total = b[i]
            for c in range(size):
                total -= scaled[i, c] * x[c]
            residual[i] = total
    terms = y
    for i in range(size):
        terms[i] = abs(b[i])
        for c in range(size):
            terms[i] += abs(scaled[i, c] * x[c])
        if not math.isfinite(x[i]):
            return SINGULAR, b
    # A row whose own terms all vanish (V = 0 at mu = inf) is compared with the rounding of others.
    rounding = 1e-14 * _largest(terms)
    for i in range(size):
        if abs(residual[i]) > _RESIDUAL * terms[i] + rounding:
            return INEXACT, b
        x[i] *= column_scale[i]
    return SOLVED, x


@_kernel
def saddle(
    mass: Array, right: Array, rows: Array, columns: Array, constants: Array
) -> tuple[int, Array]:
    """Solve ``mass a - columns f = right``, ``rows (a, f) = constants`` for (a, f)."""
    n, m = len(right), len(constants)
    matrix = np.zeros((n + m, n + m))
    b = np.empty(n + m)
    for i in range(n):
        b[i] = right[i]
        for k in range(n):
            matrix[i, k] = mass[i, k]
        for k in range(m):
            matrix[i, n + k] = -columns[i, k]
    for i in range(m):
        b[n + i] = constants[i]
        for k in range(n + m):
            matrix[n + i, k] = rows[i, k]
    return _solve(matrix, b)


@_kernel
def independent(rows: Array) -> tuple[int, NDArray[np.int64], NDArray[np.int64]]:
    """Return the rank, and the orders of rows and columns: the first `rank` are independent.

    Elimination with complete pivoting, rows and then columns scaled by powers of two; the first
    of equal pivots is taken, so that rows that come earlier are kept.
    """
    count, size = rows.shape
    left = rows.copy()
    row_order, column_order = np.arange(count), np.arange(size)
    for i in range(count):
        scale = _power_of_two(_largest(left[i]))
        for k in range(size):
            left[i, k] *= scale
    for k in range(size):
        scale = _power_of_two(_largest(left[:, k]))
        for i in range(count):
            left[i, k] *= scale
    for r in range(min(count, size)):
        best, at, beside = 0.0, r, r
        for i in range(r, count):
            for k in range(r, size):
                # Pivots within a factor of two are as good as each other.
                if abs(left[i, k]) > 2.0 * best:
                    best, at, beside = abs(left[i, k]), i, k
        if not best > _DEPENDENT:
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


@_inner
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@_inner
def _direction(code: int) -> float:
    return 1.0 if code == SLIDE_PLUS else -1.0 if code == SLIDE_MINUS else 0.0


@_inner
def _worse(verdict: Array, amount: float, contact: int, which: int, number: float) -> None:
    if amount > verdict[0]:
        verdict[0], verdict[1], verdict[2], verdict[3] = amount, contact, which, number


@_inner
def _judge(
    verdict: Array,
    accelerations: Array,
    jacobians: Array,
    biases: Array,
    code: NDArray[np.int64],
    closed: NDArray[np.bool_],
    still: NDArray[np.bool_],
    scale: float,
) -> None:
    """Judge the motion of a combination."""
    for c in range(len(code)):
        sign = _direction(code[c])
        if code[c] == FREE and closed[c]:
            apart = biases[c, 0] + _dot(jacobians[c, 0], accelerations)
            _worse(verdict, -apart / scale, c, INTO, apart)
        elif sign != 0.0 and still[c]:
            along = sign * (biases[c, 1] + _dot(jacobians[c, 1], accelerations))
            _worse(verdict, -along / scale, c, AGAINST, along)


@_inner
def _judge_forces(
    verdict: Array, forces: Array, cones: Array, code: NDArray[np.int64], scale: float
) -> None:
    for c in range(len(code)):
        V, H = forces[c, 0], forces[c, 1]
        cone_n, cone_t = cones[c, 0], cones[c, 1]
        if code[c] == PIN:
            _worse(verdict, -V / scale, c, PULLS, V)
            if cone_n > 0.0:
                _worse(verdict, (cone_n * abs(H) - cone_t * V) / scale, c, OUTSIDE, abs(H))
        elif code[c] != FREE:
            edge = cone_n * V - _direction(code[c]) * cone_t * H
            _worse(verdict, -edge / scale, c, PULLS, V)


@_inner
def _accelerate(
    mass: Array,
    right: Array,
    rows: Array,
    constants: Array,
    columns: Array,
    first: NDArray[np.int64],
    bearing: NDArray[np.int64],
    count: int,
    rank: int,
    acceleration_scale: float,
    accelerations: Array,
    amounts: Array,
) -> int:
    """Solve with `rank` of `count` rows and columns, by their orders; all rows must then hold."""
    n = len(right)
    matrix = np.zeros((n + rank, n + rank))
    b = np.empty(n + rank)
    for i in range(n):
        b[i] = right[i]
        for k in range(n):
            matrix[i, k] = mass[i, k]
        for k in range(rank):
            matrix[i, n + k] = -columns[bearing[k], i]
            matrix[n + k, i] = rows[first[k], i]
    for k in range(rank):
        b[n + k] = constants[first[k]]
    status, x = _solve(matrix, b)
    if status != SOLVED:
        return status
    for i in range(n):
        accelerations[i] = x[i]
    for k in range(rank):
        amounts[k] = x[n + k]
    for k in range(rank, count):
        row = rows[first[k]]
        terms, missed = acceleration_scale, -constants[first[k]]
        for i in range(n):
            terms += abs(row[i] * x[i])
            missed += row[i] * x[i]
        if abs(missed) > _CONTRADICTED * terms:
            return CONTRADICTORY
    return SOLVED


@_kernel
def solve_modes(
    mass: Array,
    right: Array,
    jacobians: Array,
    biases: Array,
    cones: Array,
    codes: Array,
    closed: Array,
    still: Array,
    force_scale: float,
    acceleration_scale: float,
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Solve every combination of contact modes, and judge it by its own inequalities.

    Parameters
    ----------
    mass : (n, n), right : (n,)
    jacobians : (c, 2, n)
        Rows: normal, tangential.
    biases : (c, 2)
    cones : (c, 2)
        cone_n, cone_t.
    codes : (k, c) of int
        FREE, PIN, SLIDE, SLIDE_PLUS, SLIDE_MINUS.
    closed, still : (c,) of bool
        Whether the gap is closed; whether the slip is zero.
    force_scale, acceleration_scale : float
        For comparing violations.

    Returns
    -------
    status : (k,), accelerations : (k, n), forces : (k, c, 2)
        Where the forces are not determined but the accelerations are (REDUNDANT), the forces are
        one choice of those that explain the motion, and need not be in their cones.
    verdicts : (k, 4)
        Of the inequality broken most: by how much in the scales (<= 0: not at all), contact,
        which inequality (INTO, PULLS, OUTSIDE, AGAINST), its number. REDUNDANT ones are judged
        by their motion alone.
    """
    count, contacts = codes.shape
    n = len(right)
    status = np.empty(count, np.int64)
    accelerations = np.zeros((count, n))
    forces = np.zeros((count, contacts, 2))
    verdicts = np.zeros((count, 4))
    rows, columns = np.empty((2 * contacts, n)), np.empty((2 * contacts, n))
    constants, amounts = np.empty(2 * contacts), np.empty(2 * contacts)
    owners, directions = np.empty(2 * contacts, np.int64), np.empty((2 * contacts, 2))
    in_order = np.arange(2 * contacts)
    for k in range(count):
        verdicts[k, 0] = -np.inf
        code = codes[k]
        m = 0
        for c in range(contacts):
            for d in range(0 if code[c] == FREE else 2 if code[c] == PIN else 1):
                owners[m], constants[m] = c, -biases[c, d]
                if code[c] == PIN:
                    directions[m, 0], directions[m, 1] = 1 - d, d
                else:
                    directions[m, 0] = cones[c, 0]
                    directions[m, 1] = -_direction(code[c]) * cones[c, 1]
                for i in range(n):
                    rows[m, i] = jacobians[c, d, i]
                    columns[m, i] = directions[m, 0] * jacobians[c, 0, i]
                    columns[m, i] += directions[m, 1] * jacobians[c, 1, i]
                m += 1
        rank, first, bearing = m, in_order, in_order
        if m > 1:
            rank, row_order, _ = independent(rows[:m])
            reach, order, _ = independent(columns[:m])
            if rank != reach:
                status[k] = UNDETERMINED if reach > rank else SINGULAR
                continue
            if rank < m:
                first, bearing = row_order, order
        status[k] = _accelerate(
            mass,
            right,
            rows,
            constants,
            columns,
            first,
            bearing,
            m,
            rank,
            acceleration_scale,
            accelerations[k],
            amounts,
        )
        if status[k] == SOLVED:
            for i in range(rank):
                c = owners[bearing[i]]
                forces[k, c, 0] += amounts[i] * directions[bearing[i], 0]
                forces[k, c, 1] += amounts[i] * directions[bearing[i], 1]
            _judge(
                verdicts[k],
                accelerations[k],
                jacobians,
                biases,
                code,
                closed,
                still,
                acceleration_scale,
            )
            if rank == m:
                _judge_forces(verdicts[k], forces[k], cones, code, force_scale)
            else:
                status[k] = REDUNDANT
    return status, accelerations, forces, verdicts
