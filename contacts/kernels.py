"""Small dense linear systems, compiled once: saddle points of a mass matrix and contact rows."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from contacts.states import FREE, PIN, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array
from statechart.kernels.jit import kernel, part

SOLVED, SINGULAR, INEXACT, REDUNDANT, CONTRADICTORY, UNDETERMINED = range(6)
INTO, PULLS, OUTSIDE, AGAINST = range(4)

# A solution whose residual stays above this, relative to its terms, is refused.
_RESIDUAL = 1e-8
# Below it numbers lose digits, and the power of two that would bring them to size 1 overflows.
SMALLEST = 2.0**-1022
# Of a number: what it is known to.
_ROUNDING = 2.0**-52
# Rows this close to dependent are: elimination would give forces that are huge and cancel.
_DEPENDENT = 1e-10
# Constraints that others imply are contradicted when the accelerations miss them by this.
_CONTRADICTED = 1e-9


@kernel
def power_of_two(size: float) -> float:
    """Return the power of two (exact) whose product with a size is in [1, 2); 1 where none is."""
    if size >= SMALLEST and math.isfinite(size):
        return math.ldexp(1.0, 1 - math.frexp(size)[1])
    return 1.0


@part
def _largest(values: Array) -> float:
    largest = 0.0
    for value in values:
        largest = max(largest, abs(value))
    return largest


@part
def _solve(scaled: Array, b: Array, x: Array) -> int:
    """Solve ``scaled x = b`` with partial pivoting and two refinements.

    Matrix and right side are equilibrated in place, by powers of two (exact). A pivot that its own
    rounding could have made of zero is none: running error analysis (Wilkinson 1963), to the first
    order, of entries that are known to a rounding each.
    """
    size = len(b)
    column_scale, y, residual = np.empty(size), np.empty(size), np.empty(size)
    order = np.empty(size, np.int64)
    # Columns first: masses may span many decades.
    for k in range(size):
        largest = 0.0
        for i in range(size):
            largest = max(largest, abs(scaled[i, k]))
        scale = power_of_two(largest)
        for i in range(size):
            scaled[i, k] *= scale
        column_scale[k] = scale
    for i in range(size):
        largest = 0.0
        for k in range(size):
            largest = max(largest, abs(scaled[i, k]))
        scale = power_of_two(largest)
        for k in range(size):
            scaled[i, k] *= scale
        b[i] *= scale
        residual[i], order[i], x[i] = b[i], i, 0.0
    factors, errors = scaled.copy(), np.abs(scaled) * _ROUNDING
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(factors[i, k]) > abs(factors[best, k]):
                best = i
        pivot = factors[best, k]
        if abs(pivot) <= errors[best, k] or not math.isfinite(pivot):
            return SINGULAR
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
                    errors[i, c] += _ROUNDING * abs(product)
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
    terms, largest = y, 0.0
    for i in range(size):
        if not math.isfinite(x[i]):
            return SINGULAR
        terms[i] = abs(b[i])
        for c in range(size):
            terms[i] += abs(scaled[i, c] * x[c])
        largest = max(largest, terms[i])
    # A row whose own terms all vanish (V = 0 at mu = inf) is compared with the rounding of others.
    rounding = 1e-14 * largest
    for i in range(size):
        if abs(residual[i]) > _RESIDUAL * terms[i] + rounding:
            return INEXACT
        x[i] *= column_scale[i]
    return SOLVED


@kernel
def largest_sizes(numbers: Array, begins: NDArray[np.int64], largest: Array) -> None:
    """Write the largest finite absolute value of each group of numbers; 0 where it has none."""
    for group in range(len(largest)):
        size = 0.0
        for i in range(begins[group], begins[group + 1]):
            if size < abs(numbers[i]) < math.inf:
                size = abs(numbers[i])
        largest[group] = size


@kernel
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
    x = np.empty(n + m)
    return _solve(matrix, b, x), x


@kernel
def independent(rows: Array) -> tuple[int, NDArray[np.int64], NDArray[np.int64]]:
    """Return the rank, and the orders of rows and columns: the first `rank` are independent.

    Elimination with complete pivoting, rows and then columns scaled by powers of two; the first
    of equal pivots is taken, so that rows that come earlier are kept.
    """
    count, size = rows.shape
    left = rows.copy()
    row_order, column_order = np.arange(count), np.arange(size)
    for i in range(count):
        scale = power_of_two(_largest(left[i]))
        for k in range(size):
            left[i, k] *= scale
    for k in range(size):
        scale = power_of_two(_largest(left[:, k]))
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


@part
def _dot(a: Array, b: Array) -> float:
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@part
def _direction(code: int) -> float:
    return 1.0 if code == SLIDE_PLUS else -1.0 if code == SLIDE_MINUS else 0.0


@part
def _worse(verdict: Array, amount: float, contact: int, which: int, number: float) -> None:
    if amount > verdict[0]:
        verdict[0], verdict[1], verdict[2], verdict[3] = amount, contact, which, number


@part
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


@part
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


@part
def _assemble(
    mass: Array,
    right: Array,
    rows: Array,
    constants: Array,
    columns: Array,
    first: NDArray[np.int64],
    bearing: NDArray[np.int64],
    matrix: Array,
    b: Array,
) -> None:
    """Write the saddle point of the leading rows and columns, by their orders."""
    n, size = len(right), len(b)
    for i in range(n):
        b[i] = right[i]
        for k in range(n):
            matrix[i, k] = mass[i, k]
        for k in range(n, size):
            matrix[i, k] = -columns[bearing[k - n], i]
            matrix[k, i] = rows[first[k - n], i]
    for k in range(n, size):
        b[k] = constants[first[k - n]]


@part
def _misses(row: Array, constant: float, accelerations: Array, scale: float) -> bool:
    """Whether accelerations contradict a constraint that others imply."""
    terms, missed = scale, -constant
    for i in range(len(row)):
        terms += abs(row[i] * accelerations[i])
        missed += row[i] * accelerations[i]
    return abs(missed) > _CONTRADICTED * terms


@kernel
def solve_modes(
    mass: Array,
    right: Array,
    jacobians: Array,
    biases: Array,
    cones: Array,
    codes: NDArray[np.int64],
    closed: NDArray[np.bool_],
    still: NDArray[np.bool_],
    force_scale: float,
    acceleration_scale: float,
    status: NDArray[np.int64],
    accelerations: Array,
    forces: Array,
    verdicts: Array,
    tie: float,
) -> tuple[int, int]:
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
    status : (k,), accelerations : (k, n), forces : (k, c, 2)
        To be filled, as are the verdicts: a kernel that makes the arrays it returns takes 3 us
        for each of them. Where the forces are not determined but the accelerations are
        (REDUNDANT), the forces are one choice of those that explain the motion, and need not be
        in their cones.
    verdicts : (k, 4)
        Of the inequality broken most: by how much in the scales (<= 0: not at all), contact,
        which inequality (INTO, PULLS, OUTSIDE, AGAINST), its number. REDUNDANT ones are judged
        by their motion alone.
    tie : float
        Up to here a violation is none.

    Returns
    -------
    redundant, agreeing : int
        How many combinations are REDUNDANT; the place of the only one that is solved and not
        violated, -1 where there is none or several.
    """
    redundant, agreeing, found = 0, -1, 0
    count, contacts = codes.shape
    n = len(right)
    rows, columns = np.empty((2 * contacts, n)), np.empty((2 * contacts, n))
    constants, directions = np.empty(2 * contacts), np.empty((2 * contacts, 2))
    owners, in_order = np.empty(2 * contacts, np.int64), np.arange(2 * contacts)
    for k in range(count):
        code, verdict, force = codes[k], verdicts[k], forces[k]
        verdict[0], verdict[1], verdict[2], verdict[3] = -math.inf, 0.0, 0.0, 0.0
        for i in range(n):
            accelerations[k, i] = 0.0
        m = 0
        for c in range(contacts):
            force[c, 0] = force[c, 1] = 0.0
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
        size = n + rank
        matrix, b, x = np.zeros((size, size)), np.empty(size), np.empty(size)
        _assemble(mass, right, rows, constants, columns, first, bearing, matrix, b)
        status[k] = _solve(matrix, b, x)
        if status[k] != SOLVED:
            continue
        for i in range(n):
            accelerations[k, i] = x[i]
        for i in range(rank, m):
            if _misses(rows[first[i]], constants[first[i]], accelerations[k], acceleration_scale):
                status[k] = CONTRADICTORY
        if status[k] != SOLVED:
            continue
        for i in range(rank):
            place = bearing[i]
            force[owners[place], 0] += x[n + i] * directions[place, 0]
            force[owners[place], 1] += x[n + i] * directions[place, 1]
        _judge(
            verdict, accelerations[k], jacobians, biases, code, closed, still, acceleration_scale
        )
        if rank == m:
            _judge_forces(verdict, force, cones, code, force_scale)
        else:
            status[k] = REDUNDANT
            redundant += 1
        if verdict[0] <= tie:
            found += 1
            agreeing = k if found == 1 else -1
    return redundant, agreeing
