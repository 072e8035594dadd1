"""Small dense linear systems, compiled once: saddle points of a mass matrix and contact rows."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "AGAINST",
    "FREE",
    "INEXACT",
    "INTO",
    "OUTSIDE",
    "PIN",
    "PULLS",
    "SINGULAR",
    "SLIDE",
    "SLIDE_MINUS",
    "SLIDE_PLUS",
    "SOLVED",
    "saddle",
    "solve_modes",
]

Array = NDArray[np.float64]

FREE, PIN, SLIDE, SLIDE_PLUS, SLIDE_MINUS = range(5)
SOLVED, SINGULAR, INEXACT = range(3)
INTO, PULLS, OUTSIDE, AGAINST = range(4)

# What only kernels call needs nothing to be called by from Python, and compiles sooner without.
_kernel = njit(cache=True, no_cfunc_wrapper=True)
_inner = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)

# A solution whose residual stays above this, relative to its terms, is refused.
_RESIDUAL = 1e-8


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
    verdicts : (k, 4)
        Of the inequality broken most: by how much in the scales (<= 0: not at all), contact,
        which inequality (INTO, PULLS, OUTSIDE, AGAINST), its number.
    """
    count, contacts = codes.shape
    n = len(right)
    status = np.empty(count, np.int64)
    accelerations = np.zeros((count, n))
    forces = np.zeros((count, contacts, 2))
    verdicts = np.zeros((count, 4))
    for k in range(count):
        verdicts[k, 0] = -np.inf
        size = n
        for c in range(contacts):
            size += 2 * (codes[k, c] != FREE)
        matrix = np.zeros((size, size))
        b = np.zeros(size)
        for i in range(n):
            b[i] = right[i]
            for j in range(n):
                matrix[i, j] = mass[i, j]
        at = n
        for c in range(contacts):
            code = codes[k, c]
            if code == FREE:
                continue
            for i in range(n):
                matrix[i, at] = -jacobians[c, 0, i]
                matrix[i, at + 1] = -jacobians[c, 1, i]
                matrix[at, i] = jacobians[c, 0, i]
                if code == PIN:
                    matrix[at + 1, i] = jacobians[c, 1, i]
            b[at] = -biases[c, 0]
            if code == PIN:
                b[at + 1] = -biases[c, 1]
            else:
                matrix[at + 1, at] = _direction(code) * cones[c, 1]
                matrix[at + 1, at + 1] = cones[c, 0]
            at += 2
        status[k], x = _solve(matrix, b)
        if status[k] == SOLVED:
            for i in range(n):
                accelerations[k, i] = x[i]
            at = n
            for c in range(contacts):
                if codes[k, c] != FREE:
                    forces[k, c, 0], forces[k, c, 1] = x[at], x[at + 1]
                    at += 2
                code = codes[k, c]
                if code != FREE or closed[c]:
                    V, H = forces[k, c, 0], forces[k, c, 1]
                    cone_n, cone_t = cones[c, 0], cones[c, 1]
                    if code == FREE:
                        apart = biases[c, 0] + _dot(jacobians[c, 0], accelerations[k])
                        _worse(verdicts[k], -apart / acceleration_scale, c, INTO, apart)
                    elif code == PIN:
                        _worse(verdicts[k], -V / force_scale, c, PULLS, V)
                        outside = (cone_n * abs(H) - cone_t * V) / force_scale
                        if cone_n > 0.0:
                            _worse(verdicts[k], outside, c, OUTSIDE, abs(H))
                    else:
                        sign = _direction(code)
                        edge = cone_n * V - sign * cone_t * H
                        _worse(verdicts[k], -edge / force_scale, c, PULLS, V)
                        if sign != 0.0 and still[c]:
                            along = biases[c, 1] + _dot(jacobians[c, 1], accelerations[k])
                            along *= sign
                            _worse(verdicts[k], -along / acceleration_scale, c, AGAINST, along)
    return status, accelerations, forces, verdicts
