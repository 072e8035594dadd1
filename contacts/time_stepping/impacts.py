"""Moreau's law of impact in one state, beside the steps that apply it."""

from __future__ import annotations

import numpy as np

from contacts.solvers.contact_lcp_kernels import UNKNOWNS
from contacts.solvers.impulse_coupling import coupled_contacts
from contacts.solvers.step_impulses import solve_impacts
from statechart.arrays import Array

# Directions are one to within this part of the largest.
_DEPENDENT = 1e-9


def velocity_change(
    mass: Array, held: Array, pushes: Array, velocities: Array, cones: Array, restitution: Array
) -> Array | None:
    """Return what Moreau's law of impact adds to the rates (n,); None where it is not solved.

    Parameters
    ----------
    mass : (n, n) array
    held : (r, n) array
        Directions in which joints and pins hold.
    pushes : (m, 2, n) array
        Jacobians of what is struck.
    velocities : (m, 2) array
        Normal and tangential, before.
    cones : (m, 2) array
    restitution : (m,) array
    """
    n, m, r = len(mass), len(pushes), len(held)
    rows = pushes.reshape(2 * m, n)
    system = np.zeros((n + r, n + r))
    system[:n, :n], system[n:, :n], system[:n, n:] = mass, held, held.T
    right = np.vstack([rows.T, np.zeros((r, 2 * m))])
    moved = np.linalg.lstsq(system, right, rcond=_DEPENDENT)[0][:n]
    delassus = np.ascontiguousarray(rows @ moved)
    wanted = np.zeros((m, 2))
    wanted[:, 0] = restitution * np.minimum(velocities[:, 0], 0.0)
    groups = coupled_contacts(
        mass, held, pushes.reshape(m, 2 * n), np.arange(m), np.zeros(m, dtype=np.int64)
    )
    good, _, _, impulses, _ = solve_impacts(
        delassus, groups, velocities, velocities.copy(), wanted, cones,
        restitution > 0.0, np.zeros(UNKNOWNS * m, dtype=np.bool_), np.zeros(0), False,
    )  # fmt: skip
    change: Array = moved @ impulses.reshape(2 * m)
    return change if good and np.isfinite(change).all() else None
