"""Sequential impacts at one instant (Han and Gilmore 1993).

An impact acts between two bodies, or a body and a surface, at all their common contacts: by
Moreau's law, with joints held. The fastest approach is first.
"""

from __future__ import annotations

import numpy as np

from contacts.solvers.contact_rows import (
    PAIR,
    ContactRows,
    apply_impulse,
    contact_velocity,
    friction_coefficient,
    select_rows,
)
from contacts.solvers.island_impulses import island_impulses
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers
from statechart.kernels.jit import kernel

LONGEST_SEQUENCE = 10_000
"""Limit of rounds at an instant: a ball between the floor and one a thousand times as heavy needs
that many."""

ALIKE = 1e-9
"""Relative difference of approach velocities that are equal: such impacts are simultaneous, so that
the order of bodies decides nothing."""

# Relative round-off of velocities, to the fastest.
_IMPULSE_ROUND_OFF = 64.0 * 2.0**-52
# Remaining part of an approach above which impulses failed to stop it.
_STOPPED = 0.5


@kernel
def _participants(contacts: ContactRows, pairs: Ints, next_ones: Bools, first: int) -> Ints:
    """Return the contacts of an impact: those that share bodies and are hit with the first."""
    count = len(pairs)
    order, taken = np.empty(count, np.int64), np.zeros(count, np.bool_)
    order[0], taken[first], n_taken, at = first, True, 1, 0
    while at < n_taken:
        i = order[at]
        at += 1
        for k in range(count):
            shared = False
            for side in range(contacts.bodies.shape[1]):
                b, others = contacts.bodies[i, side], contacts.bodies[k]
                if b < contacts.moving and not (contacts.padded == 1 and side == PAIR):
                    for k_other in range(len(others)):
                        shared = shared or others[k_other] == b
            hit = (
                next_ones[k]
                or pairs[k] == pairs[i]
                or friction_coefficient(contacts.cones[k]) < 0.0
            )
            if shared and hit and not taken[k]:
                order[n_taken], taken[k] = k, True
                n_taken += 1
    return order[:n_taken]


@kernel
def _solve_impact(
    contacts: ContactRows, chosen: Ints, now: Array, restitution: Array, slow: Array,
    tolerance: float, impulses: Array, rates: Array,
) -> tuple[int, float]:  # fmt: skip
    """Carry out an impact (but for `now`), in place; return its iterations and its residual."""
    size = len(chosen)
    before, wanted = np.empty((size, 2)), np.zeros((size, 2))
    rebounds, pushes = np.zeros(size, np.bool_), np.zeros((size, 2))
    for a in range(size):
        i = chosen[a]
        copy_numbers(now[i], before[a])
        joint = friction_coefficient(contacts.cones[i]) < 0.0
        if not joint and -now[i, 0] > slow[i] and restitution[i] > 0.0:
            wanted[a, 0], rebounds[a] = restitution[i] * now[i, 0], True
    rows = select_rows(contacts, chosen)
    error, iterations, _ = island_impulses(
        rows, before, before, wanted, rebounds, pushes, tolerance, 0.0, False
    )
    for a in range(size):
        i = chosen[a]
        impulses[i, 0] += pushes[a, 0]
        impulses[i, 1] += pushes[a, 1]
        apply_impulse(contacts, i, pushes[a, 0], pushes[a, 1], rates)
    return iterations, error


@kernel
def sequential_impacts(
    contacts: ContactRows, pairs: Ints, now: Array, restitution: Array, slow: Array,
    tolerance: float, impulses: Array,
) -> tuple[int, float, float]:  # fmt: skip
    """Carry out impacts until nothing approaches; return iterations, residual, remaining approach.

    Equal approaches are next together, and are one impact if they share bodies. No impact adds
    energy.

    Parameters
    ----------
    contacts : ContactRows
        Including joints.
    pairs : (m,) array of int
        Contacts of the same two bodies have the same number.
    now : (m, 2)
        Contact velocities; overwritten by those after the impacts.
    restitution : (m,)
    slow : (m,)
        Approach velocities up to these are no impacts.
    tolerance : float
        Residual of impulses.
    impulses : (m, 2)
        Output: sums over all impacts.

    Returns
    -------
    iterations : int
    residual : float
        Largest of all impacts.
    remaining : float
        Fastest approach after `LONGEST_SEQUENCE` rounds, or after impulses that failed to stop it;
        zero if the impacts end.
    """
    count, iterations, worst = len(pairs), 0, 0.0
    rates, start, largest = np.zeros(3 * contacts.moving + 3), now.copy(), 0.0
    next_ones, done = np.empty(count, np.bool_), np.empty(count, np.bool_)
    impulses[:] = 0.0
    for turn in range(LONGEST_SEQUENCE + 1):
        fastest = remaining = 0.0
        for i in range(count):
            largest = max(largest, abs(now[i, 0]), abs(now[i, 1]))
        for i in range(count):
            done[i] = friction_coefficient(contacts.cones[i]) < 0.0 or (
                -now[i, 0] <= max(slow[i], _IMPULSE_ROUND_OFF * largest)
            )
            fastest = fastest if done[i] else max(fastest, -now[i, 0])
        if fastest == 0.0:
            break
        if turn == LONGEST_SEQUENCE:
            return iterations, worst, fastest
        for i in range(count):
            done[i] = done[i] or -now[i, 0] < (1.0 - ALIKE) * fastest
            next_ones[i] = not done[i]
        for first in range(count):
            if done[first]:
                continue
            chosen = _participants(contacts, pairs, next_ones, first)
            for i in chosen:
                done[i] = True
            steps, error = _solve_impact(
                contacts, chosen, now, restitution, slow, tolerance, impulses, rates
            )
            iterations, worst = iterations + steps, max(worst, error)
        for i in range(count):
            now[i, 0], now[i, 1] = contact_velocity(contacts, i, start, rates)
            remaining = max(remaining, -now[i, 0] if next_ones[i] else 0.0)
        if remaining > _STOPPED * fastest:
            return iterations, worst, remaining
    return iterations, worst, 0.0
