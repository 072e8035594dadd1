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
from typing import Literal

import numpy as np

from contacts.kernels import SMALLEST, power_of_two
from contacts.lemke import FOUND, RAY, SPENT, enumerate_bases, lemke, on_support, row_residual
from statechart.arrays import Array, Bools

# A solution is taken when no row misses by more than this of its own terms.
_RESIDUAL = 1e-9
# Unknowns that are not this much larger than what rounding of the data changes are zero.
_NOISES = 100.0
_ENUMERATED = 16
_ENUMERATED_LAST = 12
_PROXIMAL_STEPS, _SETTLED = 12, 1e-9


class LcpStatus(enum.Enum):
    """How the solution of a complementarity problem ended."""

    SOLVED = "solved, and verified by its residual"
    RAY = "no solution found: every attempt ended on a secondary ray"
    UNVERIFIED = "a candidate was found, but its residual is too large"
    ITERATIONS = "the pivots allowed were spent"


@dataclass(frozen=True, eq=False)
class LcpSolution:
    """What was found.

    Attributes
    ----------
    z, w : (n,) array
        The unknowns and ``w = M z + q``; of the best candidate unless `status` is SOLVED.
    status : LcpStatus
    residual : float
        The largest violation of a row relative to the row's terms ``|M| z + |q|``; `z` itself is
        not negative. Scaling rows or columns does not change it.
    way : str
        The attempt that found it.
    """

    z: Array
    w: Array
    status: LcpStatus
    residual: float
    way: str


def solve_lcp(
    matrix: Array, vector: Array, *, method: Literal["auto", "lemke", "enumeration"] = "auto"
) -> LcpSolution:
    """Solve ``0 <= z``, ``w = M z + q >= 0``, ``z w = 0``.

    Parameters
    ----------
    matrix : (n, n) array
    vector : (n,) array
    method : {"auto", "lemke", "enumeration"}
        Enumeration visits all 2^n sets of positive unknowns; ``auto`` comes to it last, and only
        where n is small.

    Returns
    -------
    LcpSolution
        Look at its status: an answer that is not SOLVED is no answer.

    Raises
    ------
    ValueError
        For shapes that do not fit, numbers that are not finite, or n too large to enumerate.
    """
    matrix, vector = _checked(matrix, vector)
    if method == "enumeration":
        return _enumerated(matrix, vector)
    best: LcpSolution | None = None
    outcomes = []
    for way, outcome, basis in _attempts(matrix, vector):
        outcomes.append(outcome)
        if outcome != FOUND:
            continue
        found = _judge(matrix, vector, basis, way)
        if found.status is LcpStatus.SOLVED:
            return found
        if best is None or found.residual < best.residual:
            best = found
    if method == "auto" and len(vector) <= _ENUMERATED_LAST:
        found = _enumerated(matrix, vector)
        if found.status is LcpStatus.SOLVED:
            return found
    if best is not None:
        return best
    status = LcpStatus.ITERATIONS if SPENT in outcomes else LcpStatus.RAY
    zero = np.zeros(len(vector))
    return LcpSolution(zero, vector.copy(), status, row_residual(matrix, vector, zero), "")


def enumerate_lcp(matrix: Array, vector: Array) -> tuple[LcpSolution, ...]:
    """Return all basic solutions: one per distinct z, each verified.

    Parameters
    ----------
    matrix : (n, n) array
    vector : (n,) array
        n up to 16.

    Raises
    ------
    ValueError
        See `solve_lcp`.
    """
    matrix, vector = _checked(matrix, vector)
    if len(vector) > _ENUMERATED:
        raise ValueError(f"at most {_ENUMERATED} unknowns can be enumerated, not {len(vector)}")
    size = len(vector)
    rows, columns = _row_column_scales(matrix)
    bases = enumerate_bases(rows[:, None] * matrix * columns, rows * vector, _RESIDUAL)
    found: list[LcpSolution] = []
    for mask in bases:
        basis = np.array([mask >> i & 1 for i in range(size)], dtype=np.bool_)
        solution = _judge(matrix, vector, basis, "enumeration")
        if solution.status is not LcpStatus.SOLVED:
            continue
        z = solution.z
        if not any(np.allclose(z, one.z, rtol=1e-8, atol=1e-12 * z.max()) for one in found):
            found.append(solution)
    return tuple(found)


def delassus(mass: Array, jacobians: Array, forces: Array) -> tuple[Array, Array]:
    """Return the matrix ``J M^-1 J^T`` (2 c, 2 c) and ``J M^-1 forces`` (c, 2).

    Where inertias vanish they are filled up: good enough to find modes, not to solve them.

    Parameters
    ----------
    mass : (m, m), jacobians : (c, 2, m), forces : (m,)
    """
    rows = jacobians.reshape(-1, len(mass))
    reach = np.abs(rows).max(axis=0)
    moved = reach > 0.0
    largest = (np.diag(mass)[moved] / reach[moved] ** 2).max()
    filled = mass + np.diag(np.where(moved, 1e-14 * largest * reach**2, 0.0))
    root = np.linalg.cholesky(filled)
    half, push = np.linalg.solve(root, rows.T), np.linalg.solve(root, forces)
    return half.T @ half, (half.T @ push).reshape(-1, 2)


def contact_problem(
    delassus: Array, free: Array, cones: Array, slides: Array | None = None
) -> tuple[Array, Array]:
    """Return (M, q) of planar contacts with friction.

    Per contact with friction the unknowns are the normal impulse, the tangential one to either
    side, and the slip speed; of contacts without friction the normal impulse alone. Friction
    enters by the unit edge of its cone, so that mu = 0 and large mu are ordinary numbers; at
    mu = inf a tangential impulse without a normal one would hold no contact closed, so that
    cones end at an angle of 2^-12 from the surface.

    Parameters
    ----------
    delassus : (2 c, 2 c) array
        Velocities of the contacts (normal, tangential, normal, ...) per unit impulses.
    free : (c, 2) array
        What these velocities would be without impulses; the normal ones plus e times the speed
        of approach where contacts rebound.
    cones : (c, 2) array
        ``(cone_n, cone_t)``, with ``mu = cone_t / cone_n``.
    slides : (c,) array, optional
        For accelerations and forces: -1 or 1 where the contact slips already, in that direction,
        and its only unknown is the force along the edge against it; 0 elsewhere.
    """
    if slides is None:
        slides = np.zeros(len(cones))
    kept: list[tuple[int, float]] = []
    borne: list[tuple[float, float]] = []
    for i, (cone_n, cone_t) in enumerate(cones):
        kept += [(2 * i, 1.0)]
        borne += [(1.0, 0.0) if slides[i] == 0.0 else (cone_n, -slides[i] * cone_t)]
        if cone_t > 0.0 and slides[i] == 0.0:
            kept += [(2 * i + 1, 1.0), (2 * i + 1, -1.0), (-1, 0.0)]
            borne += [(0.0, 1.0), (0.0, -1.0), (0.0, 0.0)]
    rows = np.array([row for row, _ in kept], dtype=np.int64)
    signs = np.array([sign for _, sign in kept])
    V, H = np.array(borne).T
    matrix = delassus[rows][:, rows - rows % 2] * V + delassus[rows][:, rows - rows % 2 + 1] * H
    matrix *= signs[:, None]
    vector = signs * free.ravel()[rows]
    at = 0
    for (cone_n, cone_t), slide in zip(cones, slides, strict=True):
        if cone_t > 0.0 and slide == 0.0:
            matrix[at + 1 : at + 3, at + 3] = 1.0
            matrix[at + 3, at] = cone_t
            matrix[at + 3, at + 1 : at + 3] = -max(cone_n, 2.0**-12)
            at += 3
        at += 1
    return matrix, vector


def contact_impulses(z: Array, cones: Array, slides: Array | None = None) -> Array:
    """Return the impulses (c, 2) of a solution of `contact_problem`."""
    impulses = np.zeros((len(cones), 2))
    if slides is None:
        slides = np.zeros(len(cones))
    at = 0
    for i, (cone_n, cone_t) in enumerate(cones):
        impulses[i, 0] = z[at]
        if slides[i] != 0.0:
            impulses[i] = cone_n * z[at], -slides[i] * cone_t * z[at]
        elif cone_t > 0.0:
            impulses[i, 1] = z[at + 1] - z[at + 2]
            at += 3
        at += 1
    return impulses


def _checked(matrix: Array, vector: Array) -> tuple[Array, Array]:
    matrix = np.ascontiguousarray(matrix, dtype=np.float64)
    vector = np.ascontiguousarray(vector, dtype=np.float64)
    if vector.ndim != 1 or matrix.shape != (len(vector), len(vector)):
        raise ValueError(f"M {matrix.shape} and q {vector.shape} do not fit: (n, n) and (n,)")
    if not (np.isfinite(matrix).all() and np.isfinite(vector).all()):
        raise ValueError("M and q must be finite")
    return matrix, vector


def _enumerated(matrix: Array, vector: Array) -> LcpSolution:
    found = enumerate_lcp(matrix, vector)
    if found:
        return min(found, key=lambda solution: solution.residual)
    zero = np.zeros(len(vector))
    residual = row_residual(matrix, vector, zero)
    return LcpSolution(zero, vector, LcpStatus.RAY, residual, "enumeration")


def _judge(matrix: Array, vector: Array, basis: Bools, way: str) -> LcpSolution:
    """Solve for the basic unknowns from the data, and judge what comes out."""
    z = _determined(matrix, vector, basis)
    residual = row_residual(matrix, vector, z)
    status = LcpStatus.SOLVED if residual <= _RESIDUAL else LcpStatus.UNVERIFIED
    return LcpSolution(z, matrix @ z + vector, status, residual, way)


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


def _attempts(matrix: Array, vector: Array) -> Iterator[tuple[str, int, Bools]]:
    """Yield (way, outcome, basic ones of z), the most promising way first."""
    size = len(vector)
    limit = 50 + 20 * size
    # The same factor on row and column keeps copositivity, on which Lemke's guarantee rests.
    both = _symmetric_scales(matrix)
    rows, columns = _row_column_scales(matrix)
    spread = 0.5 + np.modf(np.arange(1, size + 1) * 0.6180339887498949)[0]
    for name, left, right in (("symmetric", both, both), ("row and column", rows, columns)):
        scaled = left[:, None] * matrix * right
        q = left * vector
        q *= power_of_two(np.abs(q).max(initial=0.0))
        for covering, cover in (
            ("ones", np.ones(size)),
            ("spread", spread),
            ("right side", np.abs(q) + 2.0**-10),
        ):
            outcome, _, basis = lemke(scaled, q, cover, limit)
            yield f"{name} scaling, covering by {covering}", outcome, basis
        outcome, basis = _proximal(scaled, q, limit)
        yield f"{name} scaling, proximal", outcome, basis


def _proximal(matrix: Array, vector: Array, limit: int) -> tuple[int, Bools]:
    """Solve with delta (z - z_before) added to w, until it adds nothing."""
    size = len(vector)
    delta = 2.0**-16
    regular = matrix + delta * np.eye(size)
    z = np.zeros(size)
    for _ in range(_PROXIMAL_STEPS):
        outcome, new, basis = lemke(regular, vector - delta * z, np.ones(size), limit)
        if outcome != FOUND:
            return outcome, basis
        if np.abs(new - z).max() <= _SETTLED * np.abs(new).max():
            return FOUND, basis
        z = new
    # Where there is no solution, z grows for ever.
    return RAY, basis


def _symmetric_scales(matrix: Array) -> Array:
    diagonal = np.diag(matrix)
    sizes = np.where(diagonal > 0.0, diagonal, 1.0)
    # Half the exponent, whole: the product is a power of two near 1 / the diagonal.
    return np.ldexp(1.0, -np.round(0.5 * np.log2(sizes)).astype(np.int64))


def _row_column_scales(matrix: Array) -> tuple[Array, Array]:
    sizes = np.abs(matrix)
    rows, columns = np.ones(len(matrix)), np.ones(len(matrix))
    for _ in range(4):
        for scales, axis in ((rows, 1), (columns, 0)):
            largest = (rows[:, None] * sizes * columns).max(axis=axis, initial=0.0)
            exponents = np.log2(np.where(largest >= SMALLEST, largest, 1.0))
            scales *= np.ldexp(1.0, -np.round(exponents).astype(np.int64))
    return rows, columns
