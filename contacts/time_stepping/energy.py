"""The energy that the contacts of a time step add to the motion, where they should add none.

With velocities U- before a step and U+ after it, impulses P change the energy by P (U+ + U-)/2,
beside what surfaces do that move. Friction and restitution take energy. What keeps a contact on its
surface, while the surface or the body turns, gives in its second half what it took in its first; a
contact that lands where the surface turns by a radian within the step has taken nothing before. One
that is struck there is struck in a direction that is as far off: what it would add had it landed
counts for it as well.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints
from statechart.kernels.jit import part

MOST_ADDED = 0.1
"""A step adds at most this part of the energy that its contacts move with. Steps that follow a
surface by a tenth of a radian add a thousandth; those that do not follow it, multiples."""


@part
def energy_added(
    numbers: Array,
    rates: Array,
    rows: Ints,
    groups: Ints,
    work: Array,
    moving: Array,
    negligible: float,
) -> float:
    """Return the largest part of its own energy that contacts add to a group of them.

    Parameters
    ----------
    numbers : (k,) array
        Of the step's tape, beginning with the mass matrix (n, n).
    rates : (n,) array
        Before the step.
    rows : (m,) array of int
        Where the Jacobians of contacts are among the numbers.
    groups : (m,) array of int
        Equal for contacts that feel each other's impulses; below m.
    work : (m,) array
        P (U+ + U-) of contacts.
    moving : (m,) array
        Twice the energy that they move with at least.
    negligible : float
        Twice the energy that is none.
    """
    n, worst = len(rates), 0.0
    moved = np.empty(n, np.bool_)
    for group in range(len(groups)):
        gained, had, kinetic = 0.0, 0.0, 0.0
        moved[:] = False
        for a in range(len(rows)):
            if groups[a] != group:
                continue
            gained += work[a]
            had = max(had, moving[a])
            for j in range(n):
                hold = numbers[rows[a] + j] != 0.0 or numbers[rows[a] + n + j] != 0.0
                moved[j] = moved[j] or hold
        if gained <= 0.0:
            continue
        for i in range(n):
            if moved[i]:
                for j in range(n):
                    kinetic += rates[i] * numbers[n * i + j] * rates[j]
        worst = max(worst, gained / max(had, kinetic, negligible))
    return worst
