"""Order of simultaneous impacts of bodies with shapes, and whether it matters."""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.active_contacts import ActiveContacts
from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.solvers.contact_rows import ContactRows, slope
from contacts.solvers.impact_sequence import in_turn
from contacts.time_stepping.chunk import LIVELY, SLOW
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.jit import kernel

PLASTIC, CAPPED, SEQUENTIAL = range(3)
"""What is hit together does, as `contacts.scene.parts.Simultaneous` names it."""


@kernel
def _pair(numbers: BodyNumbers, active: ActiveContacts, i: int) -> int:
    """Return a number of the two things that touch at a contact, whichever pieces of them do."""
    one, other = active.bodies[i]
    bodies, pieces = len(numbers.sizes), len(numbers.pieces.sizes)
    if other >= 0:
        return int(min(one, other) * bodies + max(one, other))
    surfaces = len(numbers.surfaces.kinds)
    return int((bodies + one) * (bodies + surfaces) + active.keys[i, 0] % (pieces + surfaces))


@kernel
def _slow(numbers: BodyNumbers, active: ActiveContacts, i: int, h: float) -> float:
    """Return up to which approach a contact lasts: see `contacts.time_stepping.chunk.SLOW`."""
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    return SLOW * max(fall, abs(active.free[i, 0] - active.before[i, 0]))


@kernel
def impacts_in_turn(
    numbers: BodyNumbers, active: ActiveContacts, members: Ints, contacts: ContactRows, h: float,
    start: Array, unforced: Array, asked: Array, rebounds: Bools, sudden: Array, allowed: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Carry out the impacts of an island one after another; see `in_turn` for what is returned.

    They are those of the instant in the middle of the step, at velocities halfway between those
    before and those that forces alone make: so they do work on the bodies as all impulses of a step
    do, and none that adds energy. What is hit in turn is struck in this step, also where it rested.
    Where they do not end nothing is changed.

    Parameters
    ----------
    members : (m,) array of int
        The island's contacts.
    contacts : ContactRows
        The same.
    h : float
        Length of the step.
    start, unforced, asked, rebounds
        See `island_impulses`; what is left to be solved by the step, in place.
    sudden : (m, 2)
        Impulses, to be written.
    allowed : float
        Residual of impulses that are good enough.
    """
    size = len(members)
    pairs, now = np.empty(size, np.int64), np.empty((size, 2))
    restitution, slow = np.empty(size), np.empty(size)
    for a in range(size):
        i = members[a]
        pairs[a] = _pair(numbers, active, i)
        restitution[a], slow[a] = active.materials[i, 2], _slow(numbers, active, i, h)
        for d in range(2):
            now[a, d] = 0.5 * (start[a, d] + unforced[a, d])
    done, missed, left = in_turn(contacts, pairs, now, restitution, slow, allowed, sudden)
    if left > 0.0:
        return done, 0.0, left
    for a in range(size):
        i = members[a]
        for d in range(2):
            changed = now[a, d] - 0.5 * (start[a, d] + unforced[a, d])
            start[a, d] += changed
            unforced[a, d] += changed
        if slope(contacts.cones[a]) < 0.0:
            continue
        active.hit[i] = active.hit[i] or sudden[a, 0] > 0.0
        rebounds[a] = False
        if active.hit[i]:
            asked[a, 0] = asked[a, 1] = active.wanted[i, 0] = active.wanted[i, 1] = 0.0
    return done, missed, left


@kernel
def order_matters(bodies: Ints, pairs: Ints, lively: Bools, struck: Ints) -> bool:
    """Return whether a body is struck at once at several of the things that it touches."""
    for a in range(len(pairs)):
        for side in range(2):
            if bodies[a, side] >= 0:
                struck[bodies[a, side]] = -1
    for a in range(len(pairs)):
        if not lively[a]:
            continue
        for side in range(2):
            b = bodies[a, side]
            if b >= 0 and struck[b] >= 0 and struck[b] != pairs[a]:
                return True
            if b >= 0:
                struck[b] = pairs[a]
    return False


@kernel
def is_ambiguous(
    numbers: BodyNumbers, active: ActiveContacts, members: Ints, contacts: ContactRows, h: float,
    impulses: Array, struck: Ints,
) -> bool:  # fmt: skip
    """Whether impacts in turn would do something else than those at once.

    It is so where a body is struck at two of those that it touches, and both are `LIVELY`:
    where it bears more than in the step before, and than what would rest in two steps.

    Parameters
    ----------
    numbers, active, members, contacts, h
        See `impacts_in_turn`.
    impulses : (m, 2)
        Of the step.
    struck : (b,) array of int
        Is overwritten.
    """
    size = len(members)
    bodies, pairs = np.empty((size, 2), np.int64), np.empty(size, np.int64)
    lively = np.empty(size, np.bool_)
    for a in range(size):
        i = members[a]
        sudden = contacts.own[a, 0] * (impulses[a, 0] - active.pushes[i, 0])
        lively[a] = active.materials[i, 2] >= LIVELY and sudden > _slow(numbers, active, i, h)
        bodies[a, 0], bodies[a, 1] = active.bodies[i, 0], active.bodies[i, 1]
        pairs[a] = _pair(numbers, active, i)
    return order_matters(bodies, pairs, lively, struck)
