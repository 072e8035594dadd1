"""Friction contacts as a linear complementarity problem, and Lemke's algorithm.

Planar contacts in the form of Stewart and Trinkle (1996), whose matrix is copositive: Lemke's path
ends in a solution wherever contacts at rest could hold. The algorithm pivots a condensed tableau;
lexicographic ties (Cottle, Pang and Stone, The Linear Complementarity Problem, 4.4 and 4.9) prevent
cycles on redundant contacts.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import STEEPEST
from statechart.arrays import Array, Ints
from statechart.kernels.copies import copy_rows
from statechart.kernels.jit import kernel

FOUND, RAY, SPENT = range(3)

UNKNOWNS = 4
"""Unknowns of a contact: normal impulse, tangential impulse to either side, slip speed."""

# Smallest pivot relative to the largest entry of its column.
_SMALLEST_PIVOT = 1e-11
# Relative distance of tied ratios; larger for the artificial variable, whose ties round-off has
# spread.
_TIE, _TIE_LAST = 1e-10, 1e-5
_CANCELLED = 1e-14
# Pivots after which the tableau is refactorised, since they accumulate round-off: of 98 problems of
# heaps that other methods did not solve, two covers solve 98, and 71 without refactorisation.
# Pivots allowed.
_ANEW, _PIVOTS, _PIVOTS_EACH = 2, 50, 20
# Cover of feasible rows.
_COVERED = 2.0**-10
# Round-off of unknowns, relative to the largest of their kind.
_NEGLIGIBLE = 1e-13


@kernel
def complementarity_problem(
    delassus: Array, free: Array, cones: Array, slides: Array
) -> tuple[Array, Array]:
    """Return (M, q) of planar contacts with friction (Stewart and Trinkle 1996).

    Friction enters by the unit cone edge, so that mu = 0 and large mu are ordinary numbers; at mu =
    inf a tangential impulse without a normal one would be feasible, so that cones end at
    `STEEPEST`. A frictionless or slipping contact keeps its four unknowns, with trivial rows.
    """
    count = len(cones)
    matrix = np.zeros((UNKNOWNS * count, UNKNOWNS * count))
    vector = np.zeros(UNKNOWNS * count)
    rough = (cones[:, 1] > 0.0) & (slides == 0.0)
    for i in range(count):
        a = UNKNOWNS * i
        vector[a] = free[i, 0]
        for k in range(count):
            b = UNKNOWNS * k
            normal, tangential = delassus[2 * i, 2 * k], delassus[2 * i, 2 * k + 1]
            along, across = delassus[2 * i + 1, 2 * k], delassus[2 * i + 1, 2 * k + 1]
            if slides[k] != 0.0:
                normal = normal * cones[k, 0] - tangential * slides[k] * cones[k, 1]
                along = along * cones[k, 0] - across * slides[k] * cones[k, 1]
            matrix[a, b] = normal
            if rough[k]:
                matrix[a, b + 1], matrix[a, b + 2] = tangential, -tangential
            if rough[i]:
                matrix[a + 1, b], matrix[a + 2, b] = along, -along
            if rough[i] and rough[k]:
                matrix[a + 1, b + 1], matrix[a + 1, b + 2] = across, -across
                matrix[a + 2, b + 1], matrix[a + 2, b + 2] = -across, across
        if rough[i]:
            vector[a + 1], vector[a + 2] = free[i, 1], -free[i, 1]
            matrix[a + 1, a + 3] = matrix[a + 2, a + 3] = 1.0
            matrix[a + 3, a] = cones[i, 1]
            matrix[a + 3, a + 1] = matrix[a + 3, a + 2] = -max(cones[i, 0], STEEPEST)
        else:
            matrix[a + 1, a + 1] = matrix[a + 2, a + 2] = matrix[a + 3, a + 3] = 1.0
    return matrix, vector


@kernel
def _scales(matrix: Array) -> Array:
    """Return powers of two that scale impulses and slip speeds to about 1.

    The same factor on row and column preserves copositivity, on which Lemke's guarantee rests.
    """
    scales = np.ones(len(matrix))
    for i in range(len(matrix)):
        if matrix[i, i] > 0.0:
            scales[i] = math.ldexp(1.0, -round(0.5 * math.log2(matrix[i, i])))
        elif i % UNKNOWNS == 3:
            scales[i] = 1.0 / scales[i - 1]
    return scales


@kernel
def _pivot(table: Array, right: Array, r: int, c: int, feasible: bool) -> None:
    """Exchange the basic variable of row r with the nonbasic one of column c.

    If the basis is `feasible` before and after, negative values are round-off.
    """
    width = table.shape[1]
    inverse = 1.0 / table[r, c]
    for j in range(width):
        table[r, j] *= -inverse
    table[r, c] = inverse
    right[r] *= -inverse
    for i in range(len(right)):
        factor = table[i, c]
        if i == r or factor == 0.0:
            continue
        table[i, c] = 0.0
        for j in range(width):
            term = factor * table[r, j]
            total = table[i, j] + term
            table[i, j] = total if abs(total) > _CANCELLED * abs(term) else 0.0
        change = factor * right[r]
        terms = abs(right[i]) + abs(change)
        right[i] += change
        # Negative values, and the remainder of two equal terms, are round-off.
        if feasible and right[i] < _CANCELLED * terms:
            right[i] = 0.0


@kernel
def _exchange(basic: Ints, nonbasic: Ints, column_of: Ints, r: int, c: int) -> int:
    """Exchange the variables of row and column; return the leaving one."""
    leaving, entering = basic[r], nonbasic[c]
    basic[r], nonbasic[c] = entering, leaving
    column_of[entering], column_of[leaving] = -1, c
    return leaving


@kernel
def _write_initial_tableau(
    matrix: Array, vector: Array, cover: Array, basic: Ints, nonbasic: Ints, column_of: Ints,
    table: Array, right: Array,
) -> None:  # fmt: skip
    """Write the initial tableau."""
    size = len(vector)
    copy_rows(matrix, table)
    for i in range(size):
        table[i, size], right[i] = cover[i], vector[i]
        basic[i], nonbasic[i], column_of[i], column_of[size + i] = i, size + i, -1, i
    nonbasic[size], column_of[2 * size] = 2 * size, size


@kernel
def _refactorise(
    matrix: Array, vector: Array, cover: Array, basic: Ints, nonbasic: Ints, column_of: Ints,
    table: Array, right: Array,
) -> None:  # fmt: skip
    """Write the tableau of a basis by largest pivots, without the round-off of its path."""
    size = len(vector)
    in_basis = np.zeros(2 * size + 1, np.bool_)
    for i in range(size):
        in_basis[basic[i]] = True
    _write_initial_tableau(matrix, vector, cover, basic, nonbasic, column_of, table, right)
    while True:
        r = c = -1
        for i in range(size):
            if in_basis[basic[i]]:
                continue
            for j in range(size + 1):
                if in_basis[nonbasic[j]] and (r < 0 or abs(table[i, j]) > abs(table[r, c])):
                    r, c = i, j
        if r < 0 or table[r, c] == 0.0:
            break
        _pivot(table, right, r, c, False)
        _exchange(basic, nonbasic, column_of, r, c)
    for i in range(size):
        right[i] = max(right[i], 0.0)


@kernel
def _lexicographic(
    table: Array, basic: Ints, column_of: Ints, c: int, one: int, other: int
) -> bool:
    """Return whether row `one` precedes row `other` when q is perturbed by (eps, eps^2, ...)."""
    for k in range(len(basic)):
        column = column_of[k]
        if column >= 0:
            a, b = -table[one, column], -table[other, column]
        else:
            a = 1.0 if basic[one] == k else 0.0
            b = 1.0 if basic[other] == k else 0.0
        a, b = a / -table[one, c], b / -table[other, c]
        if abs(a - b) > _TIE * (abs(a) + abs(b)):
            return a < b
    return False


@kernel
def lemke(matrix: Array, vector: Array, cover: Array) -> tuple[int, Array]:
    """Return the outcome and z, with ``0 <= z, w = M z + q >= 0, z w = 0`` if it is `FOUND`.

    Variables: w: 0 to n - 1, z: n to 2 n - 1, the artificial one: 2 n.
    """
    size = len(vector)
    z = np.zeros(size)
    r = -1
    for i in range(size):
        if vector[i] < 0.0 and (r < 0 or vector[i] * cover[r] <= vector[r] * cover[i]):
            r = i
    if r < 0:
        return FOUND, z
    table, right = np.empty((size, size + 1)), np.empty(size)
    basic, nonbasic = np.empty(size, np.int64), np.empty(size + 1, np.int64)
    column_of = np.empty(2 * size + 1, np.int64)
    _write_initial_tableau(matrix, vector, cover, basic, nonbasic, column_of, table, right)
    c = size
    for pivot in range(_PIVOTS + _PIVOTS_EACH * size):
        _pivot(table, right, r, c, True)
        leaving = _exchange(basic, nonbasic, column_of, r, c)
        if leaving == 2 * size:
            for i in range(size):
                if basic[i] >= size:
                    z[basic[i] - size] = right[i]
            return FOUND, z
        if pivot % _ANEW == _ANEW - 1:
            _refactorise(matrix, vector, cover, basic, nonbasic, column_of, table, right)
        c = column_of[leaving - size if leaving >= size else leaving + size]
        smallest = -_SMALLEST_PIVOT * np.abs(table[:, c]).max()
        smallest_ratio = math.inf
        for i in range(size):
            if table[i, c] < smallest:
                smallest_ratio = min(smallest_ratio, -right[i] / table[i, c])
        if smallest_ratio == math.inf:
            return RAY, z
        r = -1
        for i in range(size):
            if table[i, c] >= smallest:
                continue
            step = -right[i] / table[i, c]
            # The artificial variable leaves at near ties: the residual verifies the result.
            if basic[i] == 2 * size and step <= smallest_ratio * (1.0 + _TIE_LAST):
                r = i
                break
            if step <= smallest_ratio * (1.0 + _TIE) and (
                r < 0 or _lexicographic(table, basic, column_of, c, i, r)
            ):
                r = i
    return SPENT, z


@kernel
def impulses_by_lemke(
    delassus: Array, free: Array, cones: Array, slides: Array, by_scales: bool
) -> tuple[bool, Array]:
    """Return whether Lemke's algorithm finds impulses, and these (m, 2).

    `free` (m, 2) are velocities without impulses, or accelerations without forces, for forces.
    `slides` (m,) is the sign of a persisting slip, whose force is on the opposing cone edge; 0:
    none. `by_scales` covers with row scales instead of infeasibilities: if round-off ends one path
    in a ray, the other rarely ends so.
    """
    matrix, vector = complementarity_problem(delassus, free, cones, slides)
    scales, size, count = _scales(matrix), len(vector), len(cones)
    cover, most, largest, largest_of_kind = np.empty(size), 1e-300, 0.0, np.zeros(2)
    for i in range(size):
        vector[i] *= scales[i]
        most, largest = max(most, abs(vector[i])), max(largest, scales[i])
        for j in range(size):
            matrix[i, j] *= scales[i] * scales[j]
    for i in range(size):
        vector[i] /= most
        cover[i] = scales[i] / largest if by_scales else abs(vector[i]) + _COVERED
    outcome, z = lemke(matrix, vector, cover)
    for i in range(size):
        kind = 1 if i % UNKNOWNS == UNKNOWNS - 1 else 0
        largest_of_kind[kind] = max(largest_of_kind[kind], z[i])
    for i in range(size):
        if z[i] <= _NEGLIGIBLE * largest_of_kind[1 if i % UNKNOWNS == UNKNOWNS - 1 else 0]:
            z[i] = 0.0
    impulses = np.empty((count, 2))
    for i in range(count):
        a = UNKNOWNS * i
        impulses[i, 0] = most * scales[a] * z[a]
        impulses[i, 1] = most * (scales[a + 1] * z[a + 1] - scales[a + 2] * z[a + 2])
        if slides[i] != 0.0:
            impulses[i, 1] = -slides[i] * cones[i, 1] * impulses[i, 0]
            impulses[i, 0] *= cones[i, 0]
    return outcome == FOUND, impulses


@kernel
def forces_by_lemke(
    delassus: Array, free: Array, cones: Array, slides: Array
) -> tuple[bool, Array]:
    """Return whether Lemke's algorithm finds forces (m, 2) by either cover, and these."""
    found, forces = impulses_by_lemke(delassus, free, cones, slides, False)
    if not found:
        found, forces = impulses_by_lemke(delassus, free, cones, slides, True)
    return found, forces


def delassus_matrix(mass: Array, jacobians: Array, forces: Array) -> tuple[Array, Array]:
    """Return ``J M^-1 J^T`` (2 c, 2 c) and ``J M^-1 forces`` (c, 2).

    Vanishing inertias are regularised: good enough to find modes, not to solve them.
    """
    rows = jacobians.reshape(-1, len(mass))
    reach = np.abs(rows).max(axis=0)
    responds = reach > 0.0
    largest = (np.diag(mass)[responds] / reach[responds] ** 2).max(initial=0.0)
    # A coordinate without inertia that moves no contact needs any.
    least = np.where(responds, 1e-14 * largest * reach**2, np.diag(mass) == 0.0)
    filled = mass + np.diag(least)
    root = np.linalg.cholesky(filled)
    half, push = np.linalg.solve(root, rows.T), np.linalg.solve(root, forces)
    return half.T @ half, (half.T @ push).reshape(-1, 2)
