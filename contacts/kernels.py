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

# A solution whose residual stays above this, relative to its terms, is refused.
_RESIDUAL = 1e-8


@njit(cache=True)
def _power_of_two(size: float) -> float:
    if size > 0.0 and math.isfinite(size):
        return math.ldexp(1.0, 1 - math.frexp(size)[1])
    return 1.0


@njit(cache=True)
def _solve(matrix: Array, right: Array) -> tuple[int, Array]:
    """Solve with equilibration by powers of two (exact), partial pivoting, two refinements."""
    size = len(right)
    column_scale = np.empty(size)
    row_scale = np.empty(size)
    scaled = matrix.copy()
    # Columns first: masses may span many decades.
    for k in range(size):
        column_scale[k] = _power_of_two(np.abs(scaled[:, k]).max())
        scaled[:, k] *= column_scale[k]
    for i in range(size):
        row_scale[i] = _power_of_two(np.abs(scaled[i]).max())
        scaled[i] *= row_scale[i]
    b = right * row_scale
    factors = scaled.copy()
    order = np.arange(size)
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
    x = np.zeros(size)
    residual = b.copy()
    for _ in range(3):
        y = np.empty(size)
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
        x += y
        for i in range(size):
            total = b[i]
            for c in range(size):
                total -= scaled[i, c] * x[c]
            residual[i] = total
    terms = np.abs(b)
    for i in range(size):
        for c in range(size):
            terms[i] += abs(scaled[i, c] * x[c])
        if not math.isfinite(x[i]):
            return SINGULAR, b
    # A row whose own terms all vanish (V = 0 at mu = inf) is compared with the rounding of others.
    rounding = 1e-14 * terms.max()
    for i in range(size):
        if abs(residual[i]) > _RESIDUAL * terms[i] + rounding:
            return INEXACT, b
    return SOLVED, x * column_scale


@njit(cache=True)
def saddle(
    mass: Array, right: Array, rows: Array, columns: Array, constants: Array
) -> tuple[int, Array]:
    """Solve ``mass a - columns f = right``, ``rows (a, f) = constants`` for (a, f)."""
    n, m = len(right), len(constants)
    matrix = np.zeros((n + m, n + m))
    matrix[:n, :n] = mass
    matrix[:n, n:] = -columns
    matrix[n:] = rows
    b = np.empty(n + m)
    b[:n] = right
    b[n:] = constants
    return _solve(matrix, b)


@njit(cache=True)
def _worse(verdict: Array, amount: float, contact: int, which: int, number: float) -> None:
    if amount > verdict[0]:
        verdict[0], verdict[1], verdict[2], verdict[3] = amount, contact, which, number


@njit(cache=True)
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
    verdicts[:, 0] = -np.inf
    for k in range(count):
        size = n
        for c in range(contacts):
            size += 2 * (codes[k, c] != FREE)
        matrix = np.zeros((size, size))
        b = np.zeros(size)
        matrix[:n, :n] = mass
        b[:n] = right
        at = n
        for c in range(contacts):
            code = codes[k, c]
            if code == FREE:
                continue
            for i in range(n):
                matrix[i, at] = -jacobians[c, 0, i]
                matrix[i, at + 1] = -jacobians[c, 1, i]
                matrix[at, i] = jacobians[c, 0, i]
            b[at] = -biases[c, 0]
            if code == PIN:
                matrix[at + 1, :n] = jacobians[c, 1]
                b[at + 1] = -biases[c, 1]
            else:
                sign = 1.0 if code == SLIDE_PLUS else -1.0 if code == SLIDE_MINUS else 0.0
                matrix[at + 1, at] = sign * cones[c, 1]
                matrix[at + 1, at + 1] = cones[c, 0]
            at += 2
        status[k], x = _solve(matrix, b)
        if status[k] == SOLVED:
            accelerations[k] = x[:n]
            at = n
            for c in range(contacts):
                if codes[k, c] != FREE:
                    forces[k, c] = x[at : at + 2]
                    at += 2
                code = codes[k, c]
                if code != FREE or closed[c]:
                    V, H = forces[k, c]
                    cone_n, cone_t = cones[c]
                    if code == FREE:
                        apart = biases[c, 0] + np.dot(jacobians[c, 0], accelerations[k])
                        _worse(verdicts[k], -apart / acceleration_scale, c, INTO, apart)
                    elif code == PIN:
                        _worse(verdicts[k], -V / force_scale, c, PULLS, V)
                        outside = (cone_n * abs(H) - cone_t * V) / force_scale
                        if cone_n > 0.0:
                            _worse(verdicts[k], outside, c, OUTSIDE, abs(H))
                    else:
                        sign = 1.0 if code == SLIDE_PLUS else -1.0 if code == SLIDE_MINUS else 0.0
                        edge = cone_n * V - sign * cone_t * H
                        _worse(verdicts[k], -edge / force_scale, c, PULLS, V)
                        if sign != 0.0 and still[c]:
                            along = biases[c, 1] + np.dot(jacobians[c, 1], accelerations[k])
                            along *= sign
                            _worse(verdicts[k], -along / acceleration_scale, c, AGAINST, along)
    return status, accelerations, forces, verdicts
