"""Friction contacts as a linear complementarity problem, and impulses from its solution."""

from __future__ import annotations

import numpy as np

from contacts.solvers.contact_lcp_kernels import UNKNOWNS, impulses_of, problem
from statechart.arrays import Array, Bools


def delassus(mass: Array, jacobians: Array, forces: Array) -> tuple[Array, Array]:
    """Return the matrix ``J M^-1 J^T`` (2 c, 2 c) and ``J M^-1 forces`` (c, 2).

    Where inertias vanish they are filled up: good enough to find modes, not to solve them.
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
    """Return (M, q) of `contact_lcp_kernels.problem` in the unknowns that count."""
    slides = np.zeros(len(cones)) if slides is None else slides
    matrix, vector = problem(delassus, free, cones, slides)
    used = _used(cones, slides)
    return matrix[np.ix_(used, used)], vector[used]


def four_unknowns(z: Array, cones: Array, slides: Array | None = None) -> Array:
    """Return a solution of `contact_problem` with all unknowns (4 c,) of every contact."""
    whole = np.zeros(UNKNOWNS * len(cones))
    whole[_used(cones, np.zeros(len(cones)) if slides is None else slides)] = z
    return whole


def contact_impulses(z: Array, cones: Array, slides: Array | None = None) -> Array:
    """Return the impulses (c, 2) of a solution of `contact_problem`."""
    impulses = impulses_of(four_unknowns(z, cones, slides))
    if slides is not None:
        slips = slides != 0.0
        edges = cones[slips] * np.stack([np.ones(slips.sum()), -slides[slips]], axis=1)
        impulses[slips] = edges * impulses[slips, :1]
    return impulses


def _used(cones: Array, slides: Array) -> Bools:
    """Return which of the unknowns (4 c,) are no more than rows that hold by themselves."""
    used = np.repeat((cones[:, 1] > 0.0) & (slides == 0.0), UNKNOWNS)
    used[::UNKNOWNS] = True
    return used
