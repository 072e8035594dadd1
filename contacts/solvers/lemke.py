"""Lemke's algorithm on a condensed tableau, compiled once, and bases solved one by one."""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.saddle_point import SOLVED, solve_refined
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices, put_rows
from statechart.kernels.jit import kernel

FOUND, RAY, SPENT = range(3)
# Of a pivot relative to the largest entry of its column: smaller ones are rounding.
_SMALLEST_PIVOT = 1e-11
# Ratios closer than this tie; the artificial variable leaves in ties that rounding has spread.
_TIE, _TIE_LAST = 1e-10, 1e-5
_CANCELLED = 1e-14


@kernel
def row_residual(
    matrix: Array, vector: Array, z: Array, kinds: int = 1, forgiven: float = 0.0
) -> float:
    """Return the largest violation of a row, relative to its terms.

    Parameters
    ----------
    matrix : (n, n), vector : (n,), z : (n,)
    kinds : int
        The last of so many rows is of another kind than the others (cones, and velocities).
    forgiven : float
        Terms below this part of the largest in rows of the kind are rounding, and do not count.
    """
    size = len(vector)
    w, terms, largest = np.empty(size), np.empty(size), np.zeros(2)
    for i in range(size):
        total, sizes = vector[i], abs(vector[i])
        for j in range(size):
            if z[j] != 0.0:
                term = matrix[i, j] * z[j]
                total += term
                sizes += abs(term)
        if not math.isfinite(total):
            return math.inf
        w[i], terms[i] = total, sizes
        kind = 1 if i % kinds == kinds - 1 else 0
        largest[kind] = max(largest[kind], sizes)
    worst = 0.0
    for i in range(size):
        missed = abs(w[i]) if z[i] > 0.0 else -w[i]
        floor = max(terms[i], forgiven * largest[1 if i % kinds == kinds - 1 else 0])
        if missed > worst * floor:
            worst = missed / floor
    return worst


@kernel
def on_support(matrix: Array, vector: Array, positive: Bools) -> tuple[bool, Array]:
    """Solve ``w = 0`` where z may be positive, z = 0 elsewhere."""
    which = indices(positive)
    count = len(which)
    z = np.zeros(len(vector))
    if count == 0:
        return True, z
    part = np.empty((count, count))
    right = np.empty(count)
    for a in range(count):
        right[a] = -vector[which[a]]
        for b in range(count):
            part[a, b] = matrix[which[a], which[b]]
    x = np.empty(count)
    if solve_refined(part, right, x) != SOLVED:
        return False, z
    for a in range(count):
        z[which[a]] = x[a]
    return True, z


@kernel
def enumerate_bases(matrix: Array, vector: Array, tolerance: float) -> list[int]:
    """Return the bases, bit i for z_i, that are solved by no z below -tolerance times the largest.

    Which of them solve the problem is left to judge.
    """
    size = len(vector)
    found = [0]
    found.clear()
    positive = np.zeros(size, np.bool_)
    for mask in range(1 << size):
        for i in range(size):
            positive[i] = (mask >> i) & 1 == 1
        solved, z = on_support(matrix, vector, positive)
        if not solved:
            continue
        least = largest = 0.0
        for i in range(size):
            least, largest = min(least, z[i]), max(largest, abs(z[i]))
        if least >= -tolerance * largest:
            found.append(mask)
    return found


@kernel
def _pivot(table: Array, right: Array, r: int, c: int, feasible: bool) -> None:
    """Exchange the basic variable of row r with the nonbasic one of column c.

    Where what is basic is `feasible`, before and after, what is below zero is rounding.
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
        # Below zero is rounding, and so is what remains of two equal terms.
        if feasible and right[i] < _CANCELLED * terms:
            right[i] = 0.0


@kernel
def _exchanged(basic: Ints, nonbasic: Ints, column_of: Ints, r: int, c: int) -> int:
    """Note that row and column have exchanged their variables; return the one that left."""
    leaving, entering = basic[r], nonbasic[c]
    basic[r], nonbasic[c] = entering, leaving
    column_of[entering], column_of[leaving] = -1, c
    return leaving


@kernel
def _begin(
    matrix: Array, vector: Array, cover: Array, basic: Ints, nonbasic: Ints, column_of: Ints,
    table: Array, right: Array,
) -> None:  # fmt: skip
    """Write the tableau of no pivot."""
    size = len(vector)
    put_rows(matrix, table)
    for i in range(size):
        table[i, size], right[i] = cover[i], vector[i]
        basic[i], nonbasic[i], column_of[i], column_of[size + i] = i, size + i, -1, i
    nonbasic[size], column_of[2 * size] = 2 * size, size


@kernel
def _made_anew(
    matrix: Array, vector: Array, cover: Array, basic: Ints, nonbasic: Ints, column_of: Ints,
    table: Array, right: Array,
) -> None:  # fmt: skip
    """Write the tableau of a basis by the largest pivots, without the rounding of its path."""
    size = len(vector)
    into = np.zeros(2 * size + 1, np.bool_)
    for i in range(size):
        into[basic[i]] = True
    _begin(matrix, vector, cover, basic, nonbasic, column_of, table, right)
    while True:
        r = c = -1
        for i in range(size):
            if into[basic[i]]:
                continue
            for j in range(size + 1):
                if into[nonbasic[j]] and (r < 0 or abs(table[i, j]) > abs(table[r, c])):
                    r, c = i, j
        if r < 0 or table[r, c] == 0.0:
            break
        _pivot(table, right, r, c, False)
        _exchanged(basic, nonbasic, column_of, r, c)
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
def lemke(
    matrix: Array, vector: Array, cover: Array, limit: int, often: int
) -> tuple[int, Array, Bools]:
    """Return (outcome, z, basic ones of z).

    Variables are numbered w: 0 to n - 1, z: n to 2 n - 1, the artificial one: 2 n. Pivots add up
    their rounding: after each `often` of them the tableau is made anew; there are `limit` at most.
    """
    size = len(vector)
    z = np.zeros(size)
    basis = np.zeros(size, np.bool_)
    r = -1
    for i in range(size):
        if vector[i] < 0.0 and (r < 0 or vector[i] * cover[r] <= vector[r] * cover[i]):
            r = i
    if r < 0:
        return FOUND, z, basis
    table, right = np.empty((size, size + 1)), np.empty(size)
    basic, nonbasic = np.empty(size, np.int64), np.empty(size + 1, np.int64)
    column_of = np.empty(2 * size + 1, np.int64)
    _begin(matrix, vector, cover, basic, nonbasic, column_of, table, right)
    c = size
    for pivot in range(limit):
        _pivot(table, right, r, c, True)
        leaving = _exchanged(basic, nonbasic, column_of, r, c)
        if leaving == 2 * size:
            for i in range(size):
                if basic[i] >= size:
                    z[basic[i] - size] = right[i]
                    basis[basic[i] - size] = True
            return FOUND, z, basis
        if pivot % often == often - 1:
            _made_anew(matrix, vector, cover, basic, nonbasic, column_of, table, right)
        c = column_of[leaving - size if leaving >= size else leaving + size]
        smallest = -_SMALLEST_PIVOT * np.abs(table[:, c]).max()
        least = math.inf
        for i in range(size):
            if table[i, c] < smallest:
                least = min(least, -right[i] / table[i, c])
        if least == math.inf:
            return RAY, z, basis
        r = -1
        for i in range(size):
            if table[i, c] >= smallest:
                continue
            step = -right[i] / table[i, c]
            # The artificial variable leaves wherever it may: the residual says whether it might.
            if basic[i] == 2 * size and step <= least * (1.0 + _TIE_LAST):
                r = i
                break
            if step <= least * (1.0 + _TIE) and (
                r < 0 or _lexicographic(table, basic, column_of, c, i, r)
            ):
                r = i
    return SPENT, z, basis
