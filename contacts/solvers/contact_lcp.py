"""Friction contacts as a linear complementarity problem, and impulses from its solution."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array


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
