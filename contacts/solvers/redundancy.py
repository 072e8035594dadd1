"""Load sharing of redundant contacts: the smallest forces with the same resultant.

For a bar on two points or a table with four legs the motion is determined, the load sharing is not.
The smallest forces within the cones are taken, and flagged.
"""

from __future__ import annotations

import numpy as np

from contacts.solvers.dependence import independent_rows
from contacts.solvers.smallest_forces import smallest_forces
from contacts.states import FREE, LOCKED, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS, SLIP_MINUS, SLIP_PLUS
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers, indices
from statechart.kernels.jit import kernel


@kernel
def mode_columns(codes: Ints, cones: Array, jacobians: Array, left_out: int) -> tuple[Array, Ints]:
    """Return the generalised force directions of contacts (m, n), and their owners (m,)."""
    rows = np.empty((2 * len(codes), jacobians.shape[2]))
    owners = np.empty(2 * len(codes), np.int64)
    m = 0
    for i in range(len(codes)):
        if codes[i] == FREE or i == left_out or codes[i] == SLIP_PLUS or codes[i] == SLIP_MINUS:
            continue
        n, t = jacobians[i, 0], jacobians[i, 1]
        owners[m] = i
        if codes[i] == PIN:
            copy_numbers(n, rows[m])
            copy_numbers(t, rows[m + 1])
            owners[m + 1] = i
            m += 1
        elif codes[i] == SLIDE:
            copy_numbers(n, rows[m])
        elif codes[i] == LOCKED:
            copy_numbers(t, rows[m])
        else:
            edge = -cones[i, 1] if codes[i] == SLIDE_PLUS else cones[i, 1]
            for k in range(len(n)):
                rows[m, k] = cones[i, 0] * n[k] + edge * t[k]
        m += 1
    return rows[:m], owners[:m]


@kernel
def redundant_contacts(codes: Ints, cones: Array, jacobians: Array, rank: int, count: int) -> Bools:
    """Return the redundant contacts: those with directions that depend on other contacts.

    `rank` and `count` are those of the columns of all contacts; see `mode_columns`.
    """
    redundant = np.zeros(len(codes), np.bool_)
    for i in range(len(codes)):
        if codes[i] != FREE:
            without, _ = mode_columns(codes, cones, jacobians, i)
            redundant[i] = independent_rows(without)[0] > rank - (count - len(without))
    return redundant


@kernel
def shared_forces(
    codes: Ints, cones: Array, jacobians: Array, forces: Array
) -> tuple[Bools, Array]:
    """Return the redundant contacts, and the smallest equivalent forces.

    A locked coupling has its limit in place of the normal force.
    """
    rows, _ = mode_columns(codes, cones, jacobians, -1)
    rank, _, coordinates = independent_rows(rows)
    if rank == len(rows):
        return np.zeros(len(codes), np.bool_), forces
    shared = redundant_contacts(codes, cones, jacobians, rank, len(rows))
    which = indices(codes != FREE)
    sliding = np.zeros(len(which))
    edges = np.full((len(which), 3), np.inf)
    reach = np.empty((len(which), 2, rank))
    load = np.zeros(rank)
    for a in range(len(which)):
        i = which[a]
        edges[a, 0], edges[a, 1] = cones[i, 0], cones[i, 1]
        if codes[i] == SLIDE:
            # A slide without friction is one along the edge (1, 0).
            edges[a, 0], edges[a, 1] = 1.0, 0.0
        if codes[i] == LOCKED:
            edges[a, 2] = forces[i, 0]
        elif codes[i] != PIN:
            sliding[a] = -1.0 if codes[i] == SLIDE_MINUS else 1.0
        for d in range(2):
            for k in range(rank):
                reach[a, d, k] = jacobians[i, d, coordinates[k]]
                load[k] += reach[a, d, k] * forces[i, d]
    found, least, _, _ = smallest_forces(edges, sliding, reach, load, 0.0)
    if not found:
        return shared, forces
    result = forces.copy()
    for a in range(len(which)):
        result[which[a], 1] = least[a, 1]
        if codes[which[a]] != LOCKED:
            result[which[a], 0] = least[a, 0]
    return shared, result


def smallest_impulses(
    codes: Ints, jacobians: Array, cones: Array, impulses: Array
) -> tuple[Array, list[bool]]:
    """Return the smallest equivalent impulses in the cones, and which contacts are redundant.

    Redundant contacts are solved without the others: impulses may differ by decades.
    """
    shared, _ = shared_forces(codes, cones, jacobians, impulses)
    if not shared.any():
        return impulses, shared.tolist()
    result = impulses.copy()
    redundant = (
        codes[shared],
        cones[shared],
        np.ascontiguousarray(jacobians[shared]),
        impulses[shared],
    )
    result[shared] = shared_forces(*redundant)[1]
    return result, shared.tolist()
