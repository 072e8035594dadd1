"""The active contacts of a step, as arrays of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import (
    KINETIC,
    ROLLING,
    BodyNumbers,
    WarmStart,
)
from contacts.collision_detection.midpoint import Midpoint
from contacts.solvers.contact_rows import ON_TRIAL
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

# Cosine of the largest turn of a lasting contact's normal in a step.
_LASTS = 0.95
ROLLS, RESISTS = 1, 2
"""A disc with rolling resistance has two rows that share its load in halves: one with the contact's
friction, one with the resisting torque. Twice the coefficients apply to half the load."""


class ActiveContacts(NamedTuple):
    """Contacts that act in a step."""

    bodies: Ints  # (c, 2): the two bodies; -1: a surface, or a body in prescribed motion.
    rows: Array  # (c, 2, 6): Jacobian rows, normal and tangential, on the rates of the two.
    keys: Ints  # (c, 2): see `WarmStart`.
    # (c, 4): target gap; excess of the gap over it or, in an impact, over the other; slip error of
    # the previous impulses; excess over the previous target gap, of a compliant one the gap at the
    # start of the step; the last two of a joint: velocities that close its gaps.
    levels: Array
    laws: Ints  # (c,): row of `BodyNumbers.materials`; -1: a joint.
    materials: Array  # (c, 3): current cone edge (2), restitution.
    # (c,): slip direction, 1 or -1, of kinetic friction; 0, `BEGINS` or `ON_TRIAL`.
    slip_directions: Ints
    # (c, 2): velocities before the step, and after it without impulses; bias (required velocities,
    # negated).
    before: Array
    free: Array
    bias: Array
    # (c,): normal velocity that is not of the forces of the step: that of a landing, and its
    # correction; 1 for a joint that closes in this step, else 0.
    landings: Array
    pushes: Array  # (c, 2): impulses of the previous step.
    hit: Bools  # (c,): whether there is an impact.
    # (c,): compliance of a compliant contact in a step; 0 if rigid.
    compliances: Array
    # (c,): `ROLLS` for a contact with rolling resistance, `RESISTS` for the row after it.
    rolling_roles: Ints
    open_by: Array  # (c, 2): offset of a joint's points at the midpoints, in both directions.

    @classmethod
    def allocate(cls, most: int) -> ActiveContacts:
        """Allocate arrays for so many contacts."""
        return cls(
            np.empty((most, 2), np.int64), np.zeros((most, 2, 6)), np.empty((most, 2), np.int64),
            np.empty((most, 4)), np.empty(most, np.int64), np.empty((most, 3)),
            np.empty(most, np.int64), np.empty((most, 2)), np.empty((most, 2)), np.empty((most, 2)),
            np.zeros(most), np.empty((most, 2)), np.empty(most, np.bool_), np.zeros(most),
            np.zeros(most, np.int64), np.empty((most, 2)),
        )  # fmt: skip


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
    mid: Midpoint, b: int, c: int, point: Array, m: int, active: ActiveContacts
) -> None:
    """Write the Jacobian rows of a contact point, and its velocities."""
    bodies, rows, centres = active.bodies, active.rows, mid.poses
    nx, ny, x, y = point[0], point[1], point[2], point[3]
    bodies[m, 0], bodies[m, 1] = b, c
    for d in range(2):
        ux, uy = (nx, ny) if d == 0 else (ny, -nx)
        rx, ry = x - centres[b, 0], y - centres[b, 1]
        rows[m, d, 0], rows[m, d, 1], rows[m, d, 2] = ux, uy, rx * uy - ry * ux
        if c >= 0:
            rx, ry = x - centres[c, 0], y - centres[c, 1]
            rows[m, d, 3], rows[m, d, 4], rows[m, d, 5] = -ux, -uy, -(rx * uy - ry * ux)
        active.before[m, d] = velocity(bodies, rows, mid.old_rates, m, d)
        active.free[m, d] = velocity(bodies, rows, mid.free_rates, m, d)


@kernel
def remove_body_motion(
    mid: Midpoint, c: int, point: Array, m: int, active: ActiveContacts
) -> float:
    """Subtract a prescribed body's motion from a contact's velocities; return its speed change."""
    nx, ny, x, y = point[0], point[1], point[2] - mid.poses[c, 0], point[3] - mid.poses[c, 1]
    for rates, velocities in ((mid.old_rates, active.before), (mid.free_rates, active.free)):
        u, v = rates[c, 0] - rates[c, 2] * y, rates[c, 1] + rates[c, 2] * x
        velocities[m, 0] -= nx * u + ny * v
        velocities[m, 1] -= ny * u - nx * v
    u, v, turning = mid.free_rates[c] - mid.old_rates[c]
    return math.hypot(u - turning * y, v + turning * x)


@kernel
def restore_impulses(
    warm: WarmStart, first: int, pair: int, feature: int, h: float, m: int, active: ActiveContacts
) -> tuple[float, bool, int]:
    """Write the warm-start impulses of a contact; return target gap, whether it lasts, its place.

    The place is its index in the warm start, -1 for a new contact.
    """
    active.pushes[m, 0] = active.pushes[m, 1] = active.levels[m, 2] = 0.0
    level, lasting, at, place = 0.0, False, first, -1
    # Forces persist: impulses scale with the step size.
    longer = h / warm.last_step[0] if warm.last_step[0] > 0.0 else 1.0
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
    """Return whether static and kinetic friction differ."""
    return law[0] != law[KINETIC] or law[1] != law[KINETIC + 1]


@kernel
def rolling_share(active: ActiveContacts, i: int) -> float:
    """Return the load of a contact relative to that of its row."""
    return 2.0 if active.rolling_roles[i] == ROLLS else 1.0


@kernel
def write_friction(numbers: BodyNumbers, i: int, way: int, active: ActiveContacts) -> None:
    """Write the cone of a contact at rest (0) or slipping this `way`."""
    law, at = numbers.materials[active.laws[i]], 0 if way in (0, ON_TRIAL) else KINETIC
    active.slip_directions[i] = way
    active.materials[i, 0] = law[at]
    active.materials[i, 1] = law[at + 1] * rolling_share(active, i)


@kernel
def write_compliant(
    gap: float, near: float, h: float, shift: float, m: int, active: ActiveContacts
) -> bool:
    """Write contact m as a compliant one, whose row its island writes; return whether it is active.

    A contact that would end closed by more than `near` is active, too: a stiff spring would throw
    it out in the next step.
    """
    start = gap - 0.5 * h * active.before[m, 0]
    active.compliances[m], active.levels[m, 3], active.bias[m, 1] = 1.0, start, shift
    return min(start, gap, start + h * active.free[m, 0] + near) <= 0.0


@kernel
def write_resistance(
    numbers: BodyNumbers, warm: WarmStart, at_old: int, turns: tuple[float, float], h: float,
    m: int, active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the rolling resistance of contact m - 1 as contact m.

    `turns`: prescribed angular velocity of the other side, before and after the step.
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
    active.bias[m, 0], active.bias[m, 1] = active.bias[i, 0], 0.0
    active.landings[m] = active.landings[i]
    active.before[m, 1], active.free[m, 1] = -length * turns[0], -length * turns[1]
    active.hit[m], active.compliances[m], active.rolling_roles[m] = (
        active.hit[i],
        active.compliances[i],
        RESISTS,
    )
    active.laws[m], active.slip_directions[m] = -1, 0
    # The torque is at most `length` times the whole load, which is twice that of this row.
    active.materials[m, 0], active.materials[m, 1] = 1.0, 2.0
    active.materials[m, 2] = active.materials[i, 2]


@kernel
def turning_change(
    warm: WarmStart, place: int, m: int, active: ActiveContacts
) -> tuple[float, float]:
    """Return the change of a contact's velocities by rotation since the last detection.

    No force acts in between. Features that share a key but not the normal are not compared.
    """
    last, rows, before = warm.contacts[place], active.rows, active.before
    if last[6] * rows[m, 0, 0] + last[7] * rows[m, 0, 1] < _LASTS:
        return 0.0, 0.0
    return before[m, 0] - last[4], before[m, 1] - last[5]
