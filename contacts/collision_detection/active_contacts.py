"""The contacts that take part in a step, as arrays of it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.body_numbers import Memory
from contacts.collision_detection.midpoint import Midpoint
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

# The cosine of the angle by which the normal of a contact that lasts turns in a step at most.
_LASTS = 0.95


class ActiveContacts(NamedTuple):
    """Contacts that take part in a step."""

    bodies: Ints  # (c, 2): which touch; -1: a surface, or a body that moves as prescribed.
    rows: Array  # (c, 2, 6): velocities, normal and tangential, per unit rates of the two.
    keys: Ints  # (c, 2): see `Memory`.
    # (c, 4): the level at which each is kept; how far above that it is, or, where it is struck,
    # above the other; slip that the impulses of the step before may have missed; how far it is
    # above the level at which it was kept.
    memory: Array
    materials: Array  # (c, 3): see `BodyNumbers`.
    # (c, 2): velocities before the step, and after it without impulses; what these may not fall
    # below, negated.
    before: Array
    free: Array
    wanted: Array
    pushes: Array  # (c, 2): impulses of the step before.
    hit: Bools  # (c,): who is struck.
    # (c, 2, 2): how far joints are left open in both directions, and by how much less with time.
    closing: Array

    @classmethod
    def allocate(cls, most: int) -> ActiveContacts:
        """Return place for so many contacts."""
        return cls(
            np.empty((most, 2), np.int64),
            np.zeros((most, 2, 6)),
            np.empty((most, 2), np.int64),
            np.empty((most, 4)),
            np.empty((most, 3)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty(most, np.bool_),
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
def take_motion_of(mid: Midpoint, c: int, found: Array, m: int, active: ActiveContacts) -> float:
    """Take the motion of a prescribed body from the velocities of a contact; return its pull."""
    nx, ny, x, y = found[0], found[1], found[2] - mid.places[c, 0], found[3] - mid.places[c, 1]
    for rates, velocities in ((mid.old, active.before), (mid.loose, active.free)):
        u, v = rates[c, 0] - rates[c, 2] * y, rates[c, 1] + rates[c, 2] * x
        velocities[m, 0] -= nx * u + ny * v
        velocities[m, 1] -= ny * u - nx * v
    u, v, turning = mid.loose[c] - mid.old[c]
    return math.hypot(u - turning * y, v + turning * x)


@kernel
def warm_start(
    memory: Memory, first: int, pair: int, feature: int, h: float, m: int, active: ActiveContacts
) -> tuple[float, bool, int]:
    """Write the impulses that a contact had in a step; return its level, if it lasts, its place.

    The place is that in the memory, -1 where it is new.
    """
    active.pushes[m, 0] = active.pushes[m, 1] = active.memory[m, 2] = 0.0
    level, lasting, at, place = 0.0, False, first, -1
    # Forces last, so that impulses go with the length of a step.
    longer = h / memory.past[0] if memory.past[0] > 0.0 else 1.0
    while at < memory.many[0] and memory.keys[at, 0] == pair:
        if memory.keys[at, 1] == feature:
            level, lasting, place = memory.contacts[at, 0], memory.contacts[at, 1] > 0.0, at
            active.pushes[m, 0] = longer * memory.contacts[at, 2]
            active.pushes[m, 1] = longer * memory.contacts[at, 3]
            active.memory[m, 2] = memory.contacts[at, 8]
        at += 1
    return level, lasting, place


@kernel
def turning_change(
    memory: Memory, place: int, m: int, active: ActiveContacts
) -> tuple[float, float]:
    """Return by how much the turning of bodies has changed the velocities of a contact.

    Since the last detection nothing acts on them. Contacts of other features with the same key are
    not compared: their normals differ.
    """
    last, rows, before = memory.contacts[place], active.rows, active.before
    if last[6] * rows[m, 0, 0] + last[7] * rows[m, 0, 1] < _LASTS:
        return 0.0, 0.0
    return before[m, 0] - last[4], before[m, 1] - last[5]
