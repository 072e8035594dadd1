"""Linear complementarity: 0 <= z, w = M z + q >= 0, z w = 0, solved and verified.

Lemke's algorithm on a condensed tableau, ties broken lexicographically (Cottle, Pang and Stone,
The Linear Complementarity Problem, 4.4 and 4.9), so that it cannot cycle on redundant contacts. It
ends in the set of positive unknowns; these are solved for once more from the data themselves, and
the answer is judged by its residual. Where that fails, other ways through the same problem are
tried. Contact problems are in the form of Stewart and Trinkle (1996), whose matrix is copositive:
Lemke's path then ends in a solution wherever contacts at rest could hold.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from contacts.solvers.lemke import (
    FOUND,
    SPENT,
    enumerate_bases,
    lemke,
    on_support,
    row_residual,
)
from contacts.solvers.saddle_point import SMALLEST, power_of_two
from statechart.arrays import Array, Bools

# A solution is taken when no row misses by more than this of its own terms.
_RESIDUAL = 1e-9
# Unknowns that are not this much larger than what rounding of the data changes are zero.
_NOISES = 100.0
_ENUMERATED = 16
_ENUMERATED_LAST = 12
# Multiples of an irrational number, without their whole part, are spread evenly and never tie.
_RATIOS = (0.6180339887498949, 2.0**0.5, 3.0**0.5, 7.0**0.5)


class LcpStatus(enum.Enum):
    """Outcome of the solution of a complementarity problem."""

    SOLVED = "solved, and verified by its residual"
    RAY = "no solution found: every attempt ended on a secondary ray"
    UNVERIFIED = "a candidate was found, but its residual is too large"
    ITERATIONS = "the pivots allowed were spent"


@dataclass(frozen=True, eq=False)
class LcpSolution:
    """Solution of a complementarity problem."""

    z: Array  # (n,): the unknowns; of the best candidate unless `status` is SOLVED.
    status: LcpStatus
    # The largest violation of a row relative to the row's terms ``|M| z + |q|``; `z` itself is not
    # negative. Scaling rows or columns does not change it.
    residual: float


def solve_lcp(matrix: Array, vector: Array) -> LcpSolution:
    """Solve ``0 <= z``, ``w = M z + q >= 0``, ``z w = 0``.

    Where Lemke's algorithm finds nothing and n is small, all 2^n sets of positive unknowns are
    visited.

    Raises
    ------
    ValueError
        For shapes that do not fit, and numbers that are not finite.
    """
    matrix, vector = _checked(matrix, vector)
    best: LcpSolution | None = None
    outcomes = []
    for outcome, basis in _attempts(matrix, vector):
        outcomes.append(outcome)
        if outcome != FOUND:
            continue
        found = _judge(matrix, vector, basis)
        if found.status is LcpStatus.SOLVED:
            return found
        if best is None or found.residual < best.residual:
            best = found
    if len(vector) <= _ENUMERATED_LAST:
        every = enumerate_lcp(matrix, vector)
        if every:
            return min(every, key=lambda solution: solution.residual)
    if best is not None:
        return best
    status = LcpStatus.ITERATIONS if SPENT in outcomes else LcpStatus.RAY
    zero = np.zeros(len(vector))
    return LcpSolution(zero, status, row_residual(matrix, vector, zero))


def enumerate_lcp(matrix: Array, vector: Array) -> tuple[LcpSolution, ...]:
    """Return all basic solutions: one per distinct z, each verified.

    Raises
    ------
    ValueError
        See `solve_lcp`.
    """
    matrix, vector = _checked(matrix, vector)
    if len(vector) > _ENUMERATED:
        raise ValueError(f"at most {_ENUMERATED} unknowns can be enumerated, not {len(vector)}")
    size = len(vector)
    rows, columns = _scales(matrix)
    bases = enumerate_bases(rows[:, None] * matrix * columns, rows * vector, _RESIDUAL)
    found: list[LcpSolution] = []
    for mask in bases:
        basis = np.array([mask >> i & 1 for i in range(size)], dtype=np.bool_)
        solution = _judge(matrix, vector, basis)
        if solution.status is not LcpStatus.SOLVED:
            continue
        z = solution.z
        if not any(np.allclose(z, one.z, rtol=1e-8, atol=1e-12 * z.max()) for one in found):
            found.append(solution)
    return tuple(found)


def _checked(matrix: Array, vector: Array) -> tuple[Array, Array]:
    matrix = np.ascontiguousarray(matrix, dtype=np.float64)
    vector = np.ascontiguousarray(vector, dtype=np.float64)
    if vector.ndim != 1 or matrix.shape != (len(vector), len(vector)):
        raise ValueError(f"M {matrix.shape} and q {vector.shape} do not fit: (n, n) and (n,)")
    if not (np.isfinite(matrix).all() and np.isfinite(vector).all()):
        raise ValueError("M and q must be finite")
    return matrix, vector


def _judge(matrix: Array, vector: Array, basis: Bools) -> LcpSolution:
    """Solve for the basic unknowns from the data, and judge what comes out."""
    z = _determined(matrix, vector, basis)
    residual = row_residual(matrix, vector, z)
    status = LcpStatus.SOLVED if residual <= _RESIDUAL else LcpStatus.UNVERIFIED
    return LcpSolution(z, status, residual)


def _determined(matrix: Array, vector: Array, basis: Bools) -> Array:
    """Return the basic unknowns, zero where rounding alone makes them what they are.

    In a degenerate problem (a contact that just touches) unknowns of the basis are zero; as
    1e-17 they would be compared with terms that are rounding themselves. In a basis that is
    singular but for rounding they are 1e16, cancel, and look right. What rounding is, the answers
    to data that differ by rounding tell.
    """
    solved, z = on_support(matrix, vector, basis)
    noise = np.zeros(len(z))
    generator = np.random.default_rng(0)
    for _ in range(2):
        shaken = matrix * (1.0 + 4e-16 * generator.choice([-1.0, 1.0], matrix.shape))
        moved = vector * (1.0 + 4e-16 * generator.choice([-1.0, 1.0], vector.shape))
        also, other = on_support(shaken, moved, basis)
        solved &= also
        noise = np.maximum(noise, np.abs(other - z))
    return np.where(z > _NOISES * noise, z, 0.0) if solved else np.zeros(len(z))


def _attempts(matrix: Array, vector: Array) -> Iterator[tuple[int, Bools]]:
    """Yield (outcome, basic ones of z), the most promising way first."""
    size = len(vector)
    limit = 50 + 20 * size
    # The path is that of the problem as given, under a positive cover of its own: what holds for
    # a copositive matrix holds whatever rows and columns are scaled by.
    rows, columns = _scales(matrix)
    scaled = rows[:, None] * matrix * columns
    q = rows * vector
    q *= power_of_two(np.abs(q).max(initial=0.0))
    covers = [0.5 + np.modf(np.arange(1, size + 1) * ratio)[0] for ratio in _RATIOS]
    for cover in (np.ones(size), covers[0], np.abs(q) + 2.0**-10, *covers[1:]):
        outcome, _, basis = lemke(scaled, q, cover, limit, limit)
        yield outcome, basis


def _scales(matrix: Array) -> tuple[Array, Array]:
    """Return powers of two (exact) that bring rows and columns to size 1."""
    sizes = np.abs(matrix)
    rows, columns = np.ones(len(matrix)), np.ones(len(matrix))
    for _ in range(4):
        for scales, axis in ((rows, 1), (columns, 0)):
            largest = (rows[:, None] * sizes * columns).max(axis=axis, initial=0.0)
            exponents = np.log2(np.where(largest >= SMALLEST, largest, 1.0))
            scales *= np.ldexp(1.0, -np.round(exponents).astype(np.int64))
    return rows, columns
