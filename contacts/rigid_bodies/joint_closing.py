"""Impulses that close the joints of an island at the next detection, as arms turn by them."""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.collision_detection.joints import bent_on
from contacts.rigid_bodies.workspace import Workspace
from contacts.solvers.contact_rows import HELD, ContactRows, add, joint_work, moved, scale_beside
from contacts.solvers.island_impulses import island_impulses
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import put, put_rows
from statechart.kernels.jit import kernel

# Fixed-point iterations that close joints; they end when the remaining work has not shrunk by this
# factor in so many. Joints stay open where that work, or the work of their impulses, is more than
# these parts of the kinetic energy.
_TRIALS, _SHRINKS, _IDLE, _OPEN, _MOST_WORK = 24, 0.9, 4, 1e-2, 0.1


@kernel
def _followed(
    numbers: BodyNumbers, space: Workspace, members: Ints, contacts: ContactRows, h: float,
    impulses: Array, sudden: Array, in_turn: bool, turns: Array,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Ask joints of an island to close as their arms turn now; return what would be left of that.

    `numbers`, `space`, `members`, `contacts`, `h`, `impulses`, `sudden`, `in_turn`: see
    `contacts.rigid_bodies.island_step.solve_islands`; `turns` (2, b): how far bodies turn in the
    step, as is asked by now, and to work with.

    Returns
    -------
    (float, float, float, float)
        How fast joints part at most, and arms go round; the work of joints on what parts, and the
        energy of motion before the step.
    """
    active, mid, joints = space.active, space.mid, numbers.joints
    pieces, changes = len(numbers.pieces.sizes), contacts.rates[0, : 3 * contacts.moving + 3]
    first, most, fastest = pieces * (pieces + len(numbers.surfaces.kinds)), 0.0, 0.0
    work = energy = 0.0
    moved(contacts, impulses, changes)
    for a in range(len(members)):
        if in_turn:
            add(contacts, a, sudden[a, 0], sudden[a, 1], changes)
    for b in range(len(numbers.sizes)):
        turns[1, b] = math.inf
    for a in range(len(members)):
        for side in range(2):
            b = active.bodies[members[a], side]
            # Once for each body.
            if b < 0 or turns[1, b] < math.inf:
                continue
            for d in range(3):
                rate = mid.loose[b, d] + changes[3 * contacts.bodies[a, side] + d]
                energy += 0.5 * mid.old[b, d] ** 2 / numbers.inverse[b, d]
                turns[1, b] = h * rate
    for a in range(len(members)):
        i = members[a]
        if not active.materials[i, 0] < 0.0:
            continue
        for d in range(2 if active.materials[i, 0] == HELD else 1):
            further = 0.0
            for side in range(2):
                b = active.bodies[i, side]
                if b >= 0:
                    bent, gone = bent_on(
                        joints, active.keys[i, 0] - first, d, mid.places, side, turns[1, b],
                        turns[0, b],
                    )  # fmt: skip
                    further, fastest = further + bent, max(fastest, gone / h)
            active.wanted[i, d] += further / h
            space.island[2, a, d] = active.wanted[i, d]
            most = max(most, abs(further) / h)
            work += abs(impulses[a, d] * further) / h
    for b in range(len(numbers.sizes)):
        if turns[1, b] < math.inf:
            turns[0, b] = turns[1, b]
    return most, fastest, work, energy


@kernel
def close_joints(
    numbers: BodyNumbers, space: Workspace, members: Ints, contacts: ContactRows, h: float,
    rebounds: Bools, sudden: Array, in_turn: bool, near: float, bound: float, allowed: float,
    missed: float, softened: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Find impulses that close the joints of an island at the next detection, by fixed points.

    How an arm is then turned follows from the impulses: SHAKE (Ryckaert, Ciccotti and Berendsen
    1977), whose energy stays within a bound, as it does not where arms turn as they did before.
    Where they go round in circles, as what may stick as well as slip does, those are taken that
    leave joints the least work.

    `numbers`, `space`, `members`, `contacts`, `h`, `rebounds`, `sudden`, `in_turn`, `allowed`: see
    `contacts.rigid_bodies.island_step.solve_islands`; `near`, `bound`, `missed`, `softened`: see
    `island_impulses`: what is asked of it, and what it gave.

    Returns
    -------
    (float, int, bool)
        As of `island_impulses`; of impulses that close none `Workspace.apart` tells, too.
    """
    size, done, least, energy, idle = len(members), 0, math.inf, 0.0, 0
    start, unforced, asked = space.island[0, :size], space.island[1, :size], space.island[2, :size]
    chosen, turns = space.island[3, :size], np.empty((2, len(numbers.sizes)))
    best, first, good, soft = np.empty((size, 2)), asked.copy(), missed, softened
    for b in range(len(numbers.sizes)):
        turns[0, b] = h * space.mid.old[b, 2]
    for _ in range(_TRIALS):
        left, fast, work, moving = _followed(
            numbers, space, members, contacts, h, chosen, sudden, in_turn, turns
        )
        given = joint_work(contacts, chosen, start, unforced)
        if given > bound + _MOST_WORK * moving:
            # Wedged joints close, too, with unbounded work.
            work = max(work, given)
        elif left <= allowed * max(fast, scale_beside(contacts, unforced, asked)):
            return missed, done, softened
        idle += 1
        if work < least:
            idle = 0 if work < _SHRINKS * least else idle
            least, energy, good, soft = work, moving, missed, softened
            put_rows(chosen, best)
        if missed > near or idle == _IDLE:
            break
        missed, further, softened = island_impulses(
            contacts, start, unforced, asked, rebounds, chosen, near, bound, True
        )
        done += further
    put_rows(best, chosen)
    if good > near or least <= _OPEN * energy:
        return good, done, soft
    space.apart[0] = max(space.apart[0], least / energy)
    if space.apart[1] == 0.0:
        # Wedged joints press without bound: arms turn as before, which does no work.
        put_rows(first, asked)
        for a in range(size):
            put(space.active.pushes[members[a]], chosen[a])
        good, further, soft = island_impulses(
            contacts, start, unforced, asked, rebounds, chosen, near, bound, False
        )
        done += further
    return good, done, soft
