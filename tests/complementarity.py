"""Every solution of a contact problem, by enumeration; and contact problems without bodies."""

from __future__ import annotations

import itertools

import numpy as np

from contacts.solvers.lemke import UNKNOWNS, complementarity_problem
from contacts.solvers.step_impulses import coordinate_rows, new_island


def lcp_of(delassus, free, cones):
    """Return (M, q) of contacts in the unknowns that count, and which of all these are."""
    matrix, vector = complementarity_problem(delassus, free, cones, np.zeros(len(cones)))
    used = np.repeat(cones[:, 1] > 0.0, UNKNOWNS)
    used[::UNKNOWNS] = True
    return matrix[np.ix_(used, used)], vector[used], used


def error(matrix, vector, z):
    """Return how far z is from a solution, per row relative to the row's terms."""
    w = matrix @ z + vector
    terms = np.abs(matrix) @ z + np.abs(vector) + 1e-300
    return float((np.where(z > 0.0, np.abs(w), -w) / terms).max(initial=0.0))


def every_solution(matrix, vector):
    """Return all basic solutions of ``0 <= z, w = M z + q >= 0, z w = 0``, one per distinct z."""
    found = []
    for chosen in itertools.product((False, True), repeat=len(vector)):
        basis = np.array(chosen, dtype=bool)
        z = np.zeros(len(vector))
        part = matrix[np.ix_(basis, basis)]
        if basis.any():
            if np.linalg.cond(part) > 1e12:
                continue
            z[basis] = np.linalg.solve(part, -vector[basis])
        z[np.abs(z) <= 1e-12 * np.abs(z).max(initial=0.0)] = 0.0
        alike = any(np.allclose(z, one, rtol=1e-8, atol=1e-12 * z.max()) for one in found)
        if (z >= 0.0).all() and error(matrix, vector, z) <= 1e-9 and not alike:
            found.append(z)
    return found


def every_impulses(delassus, free, cones):
    """Return the impulses (m, 2) of all basic solutions of contacts."""
    matrix, vector, used = lcp_of(delassus, free, cones)
    found = []
    for one in every_solution(matrix, vector):
        z = np.zeros(len(used))
        z[used] = one
        found.append(np.column_stack([z[::4], z[1::4] - z[2::4]]))
    return found


def impact_problem(delassus, before, free, wanted, cones, rebounds):
    """Return contacts that all feel each other, one coordinate to a velocity, and their island."""
    m = len(cones)
    jacobians = np.eye(2 * m).reshape(m, 2, 2 * m)
    columns = np.ascontiguousarray(delassus.T)
    island = new_island(np.arange(m), before, free, wanted)
    island.rebounds[:] = rebounds
    return coordinate_rows(jacobians, columns, np.zeros(m), cones), island
