"""Impulses of several contacts in rational arithmetic, where floating point finds none.

Floats are rational numbers, and so are the solutions of a complementarity problem of them: with
nothing rounded, ties are ties, and Lemke's path (see `contacts.solvers.lcp`) ends in a solution
wherever contacts at rest could hold. The tableau holds integers with one denominator (Edmonds 1967;
Bareiss, Math. Comp. 22 (1968)), so that no fraction need be reduced. A second for six contacts
whose inertias differ by 24 decades; nothing of the kind is met in scenes with ordinary numbers.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from contacts.states import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array

_Vector = list[Fraction]
_Matrix = list[_Vector]

# At mu = inf a tangential impulse without a normal one would hold no contact closed.
_FLATTEST = Fraction(1, 2**60)


def exact_impulses(
    mass: Array, jacobians: Array, start: Array, cones: Array
) -> tuple[NDArray[np.int64], Array, Array] | None:
    """Return modes (c,), change of the rates (m,) and impulses (c, 2); None: there are none.

    Parameters
    ----------
    mass : (m, m)
        Positive definite.
    jacobians : (c, 2, m), cones : (c, 2)
    start : (c, 2)
        Normal and tangential velocities without impulses; the normal ones plus e times the speed
        of approach where contacts rebound.
    """
    rows = [_fractions(row) for row in jacobians.reshape(-1, len(mass))]
    moved = _solve([_fractions(row) for row in mass], rows)
    if moved is None:
        return None
    contacts = [[_dot(row, column) for column in moved] for row in rows]
    free = [_fractions(row) for row in start]
    edges = [(max(Fraction(n), _FLATTEST), Fraction(t)) for n, t in cones.tolist()]
    # Per contact: normal impulse; with friction also the tangential one to either side, and slip.
    places, signs, owners = list[int](), list[int](), list[int]()
    for i, (_, edge_t) in enumerate(edges):
        places += [2 * i] if edge_t == 0 else [2 * i, 2 * i + 1, 2 * i + 1, -1]
        signs += [1] if edge_t == 0 else [1, 1, -1, 0]
        owners += [i] if edge_t == 0 else [i] * 4
    first = {i: k for k, i in reversed([*enumerate(owners)])}
    size = len(places)
    matrix = [
        [signs[a] * signs[b] * contacts[places[a]][places[b]] for b in range(size)]
        for a in range(size)
    ]
    vector = [s * free[i][place % 2] for s, i, place in zip(signs, owners, places, strict=True)]
    for i, (edge_n, edge_t) in enumerate(edges):
        if edge_t > 0:
            k = first[i]
            matrix[k + 1][k + 3] = matrix[k + 2][k + 3] = Fraction(1)
            matrix[k + 3][k : k + 3] = edge_t, -edge_n, -edge_n
    z = lemke_exact(matrix, vector)
    if z is None:
        return None
    borne: _Vector = []
    for i, (_, edge_t) in enumerate(edges):
        k = first[i]
        borne += [z[k], z[k + 1] - z[k + 2] if edge_t > 0 else Fraction(0)]
    change = [sum((p * c[d] for p, c in zip(borne, moved, strict=True)), Fraction(0))
              for d in range(len(mass))]  # fmt: skip
    code = []
    for i, (_, edge_t) in enumerate(edges):
        V, H = borne[2 * i : 2 * i + 2]
        slip = free[i][1] + _dot(rows[2 * i + 1], change)
        sliding = SLIDE if edge_t == 0 else SLIDE_PLUS if slip > 0 else SLIDE_MINUS
        code.append(FREE if V == 0 == H else PIN if slip == 0 and edge_t > 0 else sliding)
    impulses = np.array([float(p) for p in borne]).reshape(-1, 2)
    return np.array(code), np.array([float(v) for v in change]), impulses


def lemke_exact(matrix: _Matrix, vector: _Vector) -> _Vector | None:
    """Solve ``0 <= z``, ``w = M z + q >= 0``, ``z w = 0``; None: the path ends on a ray.

    Ties are broken lexicographically, so that the path does not cycle.

    Parameters
    ----------
    matrix : n lists of n, vector : list of n
    """
    size = len(vector)
    if min(vector, default=0) >= 0:
        return [Fraction(0)] * size
    # w - M z - z0 = q in integers; columns: w, z, z0, q.
    table: list[list[int]] = []
    for i, (row, right) in enumerate(zip(matrix, vector, strict=True)):
        scale = math.lcm(*(x.denominator for x in (*row, right)))
        unit = [int(k == i) for k in range(size)]
        table.append([*unit, *(int(-scale * x) for x in row), -scale, int(scale * right)])
    basic = [*range(size)]
    denominator, entering = 1, 2 * size
    # The first row to leave is the one that q + z0 makes positive last.
    r = min(range(size), key=lambda i: (Fraction(vector[i]), i))
    table[r] = [-x for x in table[r]]
    while True:
        pivot, denominator = table[r][entering], _pivot(table, r, entering, denominator)
        assert pivot == denominator
        leaving, basic[r] = basic[r], entering
        if leaving == 2 * size:
            z = [Fraction(0)] * size
            for i, k in enumerate(basic):
                if size <= k < 2 * size:
                    z[k - size] = Fraction(table[i][-1], denominator)
            return z
        entering = leaving + size if leaving < size else leaving - size
        rising = [i for i in range(size) if table[i][entering] > 0]
        if not rising:
            return None
        r = rising[0]
        for i in rising[1:]:
            if _before(table[i], table[r], entering, size):
                r = i


def _pivot(table: list[list[int]], r: int, c: int, denominator: int) -> int:
    pivot, row = table[r][c], table[r]
    for i, other in enumerate(table):
        if i != r:
            factor = other[c]
            table[i] = [
                (pivot * x - factor * y) // denominator for x, y in zip(other, row, strict=True)
            ]
    return pivot


def _before(one: list[int], other: list[int], c: int, size: int) -> bool:
    """Whether row `one` leaves first when q is perturbed by (eps, eps^2, ...)."""
    a, b = one[c], other[c]
    for k in (-1, *range(size)):
        left, right = one[k] * b, other[k] * a
        if left != right:
            return left < right
    return False


def _fractions(values: Array) -> _Vector:
    return [Fraction(x) for x in values.tolist()]


def _dot(one: _Vector, other: _Vector) -> Fraction:
    return sum((a * b for a, b in zip(one, other, strict=True) if a and b), Fraction(0))


def _solve(matrix: _Matrix, rights: _Matrix) -> _Matrix | None:
    """Solve for several right sides, each a list; None where the matrix is singular."""
    size = len(matrix)
    table = [[*row, *(right[i] for right in rights)] for i, row in enumerate(matrix)]
    for k in range(size):
        r = next((i for i in range(k, size) if table[i][k] != 0), None)
        if r is None:
            return None
        table[k], table[r] = table[r], table[k]
        table[k] = [x / table[k][k] for x in table[k]]
        for i in range(size):
            factor = table[i][k]
            if i != k and factor != 0:
                table[i] = [x - factor * y for x, y in zip(table[i], table[k], strict=True)]
    return [[row[size + j] for row in table] for j in range(len(rights))]
