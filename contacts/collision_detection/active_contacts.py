"""The contacts that take part in a step, as arrays of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import (
    DAMPING,
    KINETIC,
    ROLLING,
    STIFFNESS,
    BodyNumbers,
    WarmStart,
)
from contacts.collision_detection.midpoint import Midpoint
from contacts.solvers.contact_rows import ON_TRIAL
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

# The cosine of the angle by which the normal of a contact that lasts turns in a step at most.
_LASTS = 0.95
ROLLS, RESISTS = 1, 2
"""A disc rolls on two rows that share its load in halves: friction of the one is that of the
contact, of the other the couple of rolling resistance. Twice the coefficients are of half a load.
"""


class ActiveContacts(NamedTuple):
    """Contacts that take part in a step."""

    bodies: Ints  # (c, 2): which touch; -1: a surface, or a body that moves as prescribed.
    rows: Array  # (c, 2, 6): velocities, normal and tangential, per unit rates of the two.
    keys: Ints  # (c, 2): see `WarmStart`.
    # (c, 4): the level at which each is kept; how far above that it is, or, where it is struck,
    # above the other; slip that the impulses of the step before may have missed; how far it is
    # above the level at which it was kept.
    levels: Array
    laws: Ints  # (c,): which of `BodyNumbers.materials`; -1: a joint.
    materials: Array  # (c, 3): edge of the cone that holds now (2), restitution.
    # (c,): slip before, 1 or -1, where kinetic friction holds; `BEGINS` or `ON_TRIAL`.
    ways: Ints
    # (c, 2): velocities before the step, and after it without impulses; what these may not fall
    # below, negated.
    before: Array
    free: Array
    wanted: Array
    pushes: Array  # (c, 2): impulses of the step before.
    hit: Bools  # (c,): who is struck.
    # (c,): velocity per impulse of a compliant contact in a step; 0 of a rigid one.
    yields: Array
    # (c,): `ROLLS` of a contact with rolling resistance, `RESISTS` of the row of that behind it.
    twins: Ints
    # (c, 2, 2): how far joints are left open in both directions, and by how much less with time.
    closing: Array

    @classmethod
    def allocate(cls, most: int) -> ActiveContacts:
        """Allocate arrays for so many contacts."""
        return cls(
            np.empty((most, 2), np.int64),
            np.zeros((most, 2, 6)),
            np.empty((most, 2), np.int64),
            np.empty((most, 4)),
            np.empty(most, np.int64),
            np.empty((most, 3)),
            np.empty(most, np.int64),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty(most, np.bool_),
            np.zeros(most),
            np.zeros(most, np.int64),
            np.empty((most, 2, 2)),
        )


@kernel
def velocity(bodies: Ints, rows: Array, rates: Array, i: int, d: int) -> float:
    """Return the velocity of contact i along d (0: normal, 1: tangential)."""
    total = 0.0
    for side in range(2):
        b, k = bodies[i, side], 3 * side
        if b >= 0:
            total += rows[i, d, k] * rates[b, 0]
            total += rows[i, d, k + 1] * rates[b, 1]
            total += rows[i, d, k + 2] * rates[b, 2]
    return total


@kernel
def write_contact(
    mid: Midpoint, b: int, c: int, found: Array, m: int, active: ActiveContacts
) -> None:
    """Write the rows of a point of contact, and its velocities."""
    bodies, rows, centres = active.bodies, active.rows, mid.places
    nx, ny, x, y = found[0], found[1], found[2], found[3]
    bodies[m, 0], bodies[m, 1] = b, c
    for d in range(2):
        ux, uy = (nx, ny) if d == 0 else (ny, -nx)
        rx, ry = x - centres[b, 0], y - centres[b, 1]
        rows[m, d, 0], rows[m, d, 1], rows[m, d, 2] = ux, uy, rx * uy - ry * ux
        if c >= 0:
            rx, ry = x - centres[c, 0], y - centres[c, 1]
            rows[m, d, 3], rows[m, d, 4], rows[m, d, 5] = -ux, -uy, -(rx * uy - ry * ux)
        active.before[m, d] = velocity(bodies, rows, mid.old, m, d)
        active.free[m, d] = velocity(bodies, rows, mid.loose, m, d)


@kernel
def remove_body_motion(
    mid: Midpoint, c: int, found: Array, m: int, active: ActiveContacts
) -> float:
    """Take the motion of a prescribed body from the velocities of a contact; return its pull."""
    nx, ny, x, y = found[0], found[1], found[2] - mid.places[c, 0], found[3] - mid.places[c, 1]
    for rates, velocities in ((mid.old, active.before), (mid.loose, active.free)):
        u, v = rates[c, 0] - rates[c, 2] * y, rates[c, 1] + rates[c, 2] * x
        velocities[m, 0] -= nx * u + ny * v
        velocities[m, 1] -= ny * u - nx * v
    u, v, turning = mid.loose[c] - mid.old[c]
    return math.hypot(u - turning * y, v + turning * x)


@kernel
def restore_impulses(
    warm: WarmStart, first: int, pair: int, feature: int, h: float, m: int, active: ActiveContacts
) -> tuple[float, bool, int]:
    """Write the impulses that a contact had in a step; return its level, if it lasts, its place.

    The place is that in the memory, -1 where it is new.
    """
    active.pushes[m, 0] = active.pushes[m, 1] = active.levels[m, 2] = 0.0
    level, lasting, at, place = 0.0, False, first, -1
    # Forces last, so that impulses go with the length of a step.
    longer = h / warm.past[0] if warm.past[0] > 0.0 else 1.0
    while at < warm.n_contacts[0] and warm.keys[at, 0] == pair:
        if warm.keys[at, 1] == feature:
            level, lasting, place = warm.contacts[at, 0], warm.contacts[at, 1] > 0.0, at
            active.pushes[m, 0] = longer * warm.contacts[at, 2]
            active.pushes[m, 1] = longer * warm.contacts[at, 3]
            active.levels[m, 2] = warm.contacts[at, 8]
        at += 1
    return level, lasting, place


@kernel
def has_two_coefficients(law: Array) -> bool:
    """Return whether friction is larger at rest than in motion."""
    return law[0] != law[KINETIC] or law[1] != law[KINETIC + 1]


@kernel
def rolling_share(active: ActiveContacts, i: int) -> float:
    """Return the load of a contact, in parts of that of its row."""
    return 2.0 if active.twins[i] == ROLLS else 1.0


@kernel
def write_friction(numbers: BodyNumbers, i: int, way: int, active: ActiveContacts) -> None:
    """Write the cone of a contact that rests (0) or slips this `way`."""
    law, at = numbers.materials[active.laws[i]], 0 if way in (0, ON_TRIAL) else KINETIC
    active.ways[i] = way
    active.materials[i, 0] = law[at]
    active.materials[i, 1] = law[at + 1] * rolling_share(active, i)


@kernel
def write_compliance(
    law: Array, gap: float, h: float, shift: float, m: int, active: ActiveContacts
) -> bool:
    """Write the compliance of contact m in a step; return whether it takes part.

    Implicit Euler: the impulse is h times the force at the gap at the start plus h times the
    velocity at the end, never below 0. It takes energy from steps longer than a contact lasts.
    What would end inside takes part, too: a stiff spring would throw it out in the next step.
    """
    start = gap - 0.5 * h * active.before[m, 0]
    softness = h * law[STIFFNESS] + law[DAMPING]
    active.yields[m] = 1.0 / (h * softness)
    active.wanted[m, 0], active.wanted[m, 1] = law[STIFFNESS] * start / softness, shift
    return min(start, gap, start + h * active.free[m, 0]) <= 0.0


@kernel
def write_resistance(
    numbers: BodyNumbers, warm: WarmStart, at_old: int, turns: tuple[float, float], h: float,
    m: int, active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the row of the rolling resistance of the contact before m as contact m.

    `turns`: rate at which what the body touches turns as prescribed, before and after the step.
    """
    i, length = m - 1, numbers.materials[active.laws[m - 1], ROLLING]
    pair, feature = active.keys[i, 0], -1 - active.keys[i, 1]
    restore_impulses(warm, at_old, pair, feature, h, m, active)
    if active.hit[i] or active.pushes[i, 0] == 0.0:
        active.pushes[m, 0] = active.pushes[m, 1] = 0.0
    active.keys[m, 0], active.keys[m, 1] = pair, feature
    for side in range(2):
        active.bodies[m, side] = active.bodies[i, side]
        turn = length * (1.0 - 2.0 * side) if active.bodies[i, side] >= 0 else 0.0
        for k in range(3 * side, 3 * side + 3):
            active.rows[m, 0, k], active.rows[m, 1, k] = active.rows[i, 0, k], 0.0
        active.rows[m, 1, 3 * side + 2] = turn
    for k in range(4):
        active.levels[m, k] = active.levels[i, k]
    active.before[m, 0], active.free[m, 0] = active.before[i, 0], active.free[i, 0]
    active.wanted[m, 0], active.wanted[m, 1] = active.wanted[i, 0], 0.0
    active.before[m, 1], active.free[m, 1] = -length * turns[0], -length * turns[1]
    active.hit[m], active.yields[m], active.twins[m] = active.hit[i], active.yields[i], RESISTS
    active.laws[m], active.ways[m] = -1, 0
    # The couple is at most `length` times the whole load, which is twice that of this row.
    active.materials[m, 0], active.materials[m, 1] = 1.0, 2.0
    active.materials[m, 2] = active.materials[i, 2]


@kernel
def turning_change(
    warm: WarmStart, place: int, m: int, active: ActiveContacts
) -> tuple[float, float]:
    """Return by how much the turning of bodies has changed the velocities of a contact.

    Since the last detection nothing acts on them. Contacts of other features with the same key are
    not compared: their normals differ.
    """
    last, rows, before = warm.contacts[place], active.rows, active.before
    if last[6] * rows[m, 0, 0] + last[7] * rows[m, 0, 1] < _LASTS:
        return 0.0, 0.0
    return before[m, 0] - last[4], before[m, 1] - last[5]
