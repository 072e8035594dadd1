"""What contacts bear in a time step: modes, paradoxes, and forces that can stand in for others."""

from __future__ import annotations

import numpy as np

from contacts.solvers.saddle_point import independent
from contacts.solvers.smallest_forces import springs
from contacts.states import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

# Velocities below this part of what they are sums of are zero.
_ROUNDING = 1e-9


@kernel
def borne_mode(impulse: Array, slip: float, sliding: bool, cone: Array, directed: bool) -> int:
    """Return the number of the mode of a contact that bears an impulse.

    Parameters
    ----------
    impulse : (2,)
    slip : float
        After the step.
    sliding : bool
        Whether it slips under friction.
    cone : (2,)
    directed : bool
        Whether its slides have a direction, whatever the friction.
    """
    if cone[1] == 0.0 and not directed:
        return SLIDE
    if cone[1] == 0.0:
        sliding = slip != 0.0
    if not sliding:
        return PIN
    if slip != 0.0:
        return SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS
    return SLIDE_PLUS if impulse[1] < 0.0 else SLIDE_MINUS


@kernel
def resting(compliance: Array, least: Array, impulses: Array, a: int) -> tuple[bool, float]:
    """Whether contact `a` stays closed without an impulse; and its slip, 0 where that is rounding.

    Parameters
    ----------
    compliance : (2 m, 2 m), least : (m, 2), impulses : (m, 2)
        Of the step's contact problem.
    a : int
    """
    after, terms = least[a].copy(), np.abs(least[a])
    for d in range(2):
        for b in range(len(impulses)):
            for e in range(2):
                term = compliance[2 * a + d, 2 * b + e] * impulses[b, e]
                after[d] += term
                terms[d] += abs(term)
    slip = after[1] if abs(after[1]) > _ROUNDING * terms[1] else 0.0
    return abs(after[0]) <= _ROUNDING * terms[0], slip


@kernel
def jammed(compliance: Array, least: Array, slip: float, cone: Array) -> bool:
    """Whether friction presses a sliding contact into its surface (Painleve's paradox).

    Then no finite force keeps it there, and the impulse of the step is one at an instant.

    Parameters
    ----------
    compliance : (2, 2)
        Velocities of the contact per unit impulses on it.
    least : (2,)
        Its velocities without impulses.
    slip : float
        Before the step.
    cone : (2,)
    """
    if slip == 0.0 or not least[0] < 0.0:
        return False
    against = -cone[1] if slip > 0.0 else cone[1]
    return bool(compliance[0, 0] * cone[0] + compliance[0, 1] * against <= 0.0)


@kernel
def _columns(codes: Ints, cones: Array, jacobians: Array, left_out: int) -> Array:
    """Return what the forces of contacts in their modes do to the coordinates, one row each."""
    size = jacobians.shape[2]
    rows = np.empty((2 * len(codes), size))
    m = 0
    for i in range(len(codes)):
        if codes[i] == FREE or i == left_out:
            continue
        n, t = jacobians[i]
        if codes[i] == PIN:
            rows[m], rows[m + 1] = n, t
            m += 2
        elif codes[i] == SLIDE:
            rows[m] = n
            m += 1
        else:
            edge = -cones[i, 1] if codes[i] == SLIDE_PLUS else cones[i, 1]
            rows[m] = cones[i, 0] * n + edge * t
            m += 1
    return rows[:m]


@kernel
def shared_forces(
    codes: Ints, cones: Array, jacobians: Array, forces: Array
) -> tuple[Bools, Array]:
    """Return which contacts can stand in for others, and the smallest forces that act alike.

    Parameters
    ----------
    codes : (c,) array of int
        Modes.
    cones : (c, 2), jacobians : (c, 2, n), forces : (c, 2)
    """
    count = len(codes)
    shared = np.zeros(count, np.bool_)
    rows = _columns(codes, cones, jacobians, -1)
    rank, _, coordinates = independent(rows)
    if rank == len(rows):
        return shared, forces
    for i in range(count):
        if codes[i] != FREE:
            without = _columns(codes, cones, jacobians, i)
            own = len(rows) - len(without)
            shared[i] = independent(without)[0] > rank - own
    which = np.nonzero(codes != FREE)[0]
    sliding = np.zeros(len(which))
    edges = np.empty((len(which), 2))
    reach = np.empty((len(which), 2, rank))
    load = np.zeros(rank)
    for a in range(len(which)):
        i = which[a]
        edges[a] = cones[i]
        if codes[i] == SLIDE:
            # A slide without friction is one along the edge (1, 0).
            edges[a, 0], edges[a, 1] = 1.0, 0.0
        if codes[i] != PIN:
            sliding[a] = -1.0 if codes[i] == SLIDE_MINUS else 1.0
        for d in range(2):
            for k in range(rank):
                reach[a, d, k] = jacobians[i, d, coordinates[k]]
                load[k] += reach[a, d, k] * forces[i, d]
    found, least, _, _ = springs(edges, sliding, reach, load, 0.0)
    if not found:
        return shared, forces
    result = forces.copy()
    for a in range(len(which)):
        result[which[a]] = least[a]
    return shared, result
