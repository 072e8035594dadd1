"""Joints of bodies with shapes, to each other and to places in the world, as rows of a step.

A joint holds at the midpoints of steps: the velocities after a step take its two points onto each
other at the next detection, their turning counted in. Nothing is pushed back afterwards, so that
nothing drifts; what is held so is Verlet's scheme with constraints (Ryckaert, Ciccotti and
Berendsen 1977).
"""

from __future__ import annotations

import math

from contacts.collision_detection.active_contacts import ActiveContacts, warm_start
from contacts.collision_detection.body_numbers import (
    ALONG_Y,
    BOTH,
    BodyNumbers,
    JointNumbers,
    Memory,
)
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.surfaces import carried
from contacts.solvers.contact_rows import GUIDED, HELD
from statechart.arrays import Array
from statechart.kernels.jit import kernel

# Round-off of the ends of a joint.
_ANGLE_ROUND_OFF = 2.0**-50
# A step is shorter than the one before where it is so beyond rounding.
_SHORTER = 1.0 - 1e-9


@kernel
def _bent(x: float, y: float, across: bool, turn: float) -> float:
    """Return how far the end of an arm goes in a step beyond what the rate of its turning says."""
    c, s = math.cos(turn) - 1.0, math.sin(turn) - turn
    return s * x + c * y if across else c * x - s * y


@kernel
def _joint_rows(
    joints: JointNumbers, j: int, mid: Midpoint, paths: Array, h: float, past: float, m: int,
    active: ActiveContacts,
) -> float:  # fmt: skip
    """Write the rows of a joint as contact m; return by how much its place's path bends in a step.

    Velocities are relative to the path. `paths` (3, j, 2) is where the places of all joints in the
    world were at the last detection, are, and are next; `h` and `past` are the lengths of this step
    and of the one before.
    """
    places, old, loose = mid.places, mid.old, mid.loose
    rows, before, free = active.rows[m], active.before[m], active.free[m]
    wanted, closing = active.wanted[m], active.closing[m]
    for d in range(2):
        before[d] = free[d] = wanted[d] = 0.0
        apart = size = 0.0
        for k in range(6):
            rows[d, k] = 0.0
        if d == 1 and joints.holds[j] != BOTH:
            continue
        across = joints.holds[j] == ALONG_Y or d == 1
        ux, uy = (0.0, 1.0) if across else (1.0, 0.0)
        for side in range(2):
            b, sign = joints.bodies[j, side], 1.0 - 2.0 * side
            if b < 0:
                axis = 1 if across else 0
                now = paths[1, j, axis]
                before[d] -= (now - paths[0, j, axis]) / h
                free[d] -= (paths[2, j, axis] - now) / h
                apart, size = apart - now, size + abs(now)
                continue
            x, y = carried(places[b], joints.at[j, side, 0], joints.at[j, side, 1])
            rx, ry = x - places[b, 0], y - places[b, 1]
            at = 3 * side
            rows[d, at], rows[d, at + 1] = sign * ux, sign * uy
            rows[d, at + 2] = sign * (rx * uy - ry * ux)
            for k in range(3):
                before[d] += rows[d, at + k] * old[b, k]
                free[d] += rows[d, at + k] * loose[b, k]
            wanted[d] += sign * _bent(rx, ry, across, h * old[b, 2]) / h
            apart += sign * (ux * x + uy * y)
            size += abs(ux * x + uy * y) + abs(rx) + abs(ry)
        # Joints that others imply cannot close what rounding opens.
        if not abs(apart) > _ANGLE_ROUND_OFF * size:
            closing[0, d] = 0.0
            continue
        # Between detections arms are open by what they bend, as they are where a step is taken in
        # parts: closed in the first of these, that would throw what they bear.
        if h < _SHORTER * past:
            closing[0, d], closing[1, d] = apart, apart / past
        closed = h * closing[1, d]
        closing[0, d] = closing[0, d] - closed if abs(closing[0, d]) > abs(closed) else 0.0
        wanted[d] += (apart - closing[0, d]) / h
    bend_x = paths[2, j, 0] - 2.0 * paths[1, j, 0] + paths[0, j, 0]
    bend_y = paths[2, j, 1] - 2.0 * paths[1, j, 1] + paths[0, j, 1]
    return math.hypot(bend_x, bend_y) / h


@kernel
def add_joints(
    numbers: BodyNumbers, places: Array, memory: Memory, mid: Midpoint, h: float, count: int,
    active: ActiveContacts,
) -> int:  # fmt: skip
    """Append the joints to the contacts of a step; return how many there are in all.

    Parameters
    ----------
    numbers, memory, mid, h, active
        See `contacts.collision_detection.find_contacts`.
    places : (3, j, 2)
        Where what they hold points to is at this midpoint, the one before and the next.
    count : int
        Contacts.
    """
    joints, pieces = numbers.joints, len(numbers.pieces.sizes)
    first, at_old, m = pieces * (pieces + len(numbers.surfaces.kinds)), 0, count
    past = memory.past[0]
    for j in range(len(joints.holds)):
        b = joints.bodies[j, 0]
        active.bodies[m, 0], active.bodies[m, 1] = b, joints.bodies[j, 1]
        active.materials[m, 0] = HELD if joints.holds[j] == BOTH else GUIDED
        active.materials[m, 1] = active.materials[m, 2] = 0.0
        active.laws[m], active.ways[m] = -1, 0
        active.yields[m], active.twins[m] = 0.0, 0
        active.hit[m] = False
        while at_old < memory.many[0] and memory.keys[at_old, 0] < first + j:
            at_old += 1
        _, _, place = warm_start(memory, at_old, first + j, 0, h, m, active)
        for d in range(2):
            active.closing[m, 0, d] = memory.contacts[place, 4 + d] if place >= 0 else 0.0
            active.closing[m, 1, d] = memory.contacts[place, 6 + d] if place >= 0 else 0.0
        mid.pull[b] += _joint_rows(joints, j, mid, places, h, past, m, active)
        active.keys[m, 0], active.keys[m, 1] = first + j, 0
        active.memory[m, 0] = active.memory[m, 1] = 0.0
        m += 1
    return m


@kernel
def bent_on(
    joints: JointNumbers, j: int, d: int, places: Array, side: int, turn: float, than: float
) -> tuple[float, float]:
    """Return how much farther the end of a joint's arm goes along its row d in a step.

    Where its body turns by `turn` in that and not by `than`, beyond what the rate says; as the row
    counts it. And how far it goes round.
    """
    b = joints.bodies[j, side]
    x, y = carried(places[b], joints.at[j, side, 0], joints.at[j, side, 1])
    rx, ry = x - places[b, 0], y - places[b, 1]
    across = d == 1 or joints.holds[j] == ALONG_Y
    further = _bent(rx, ry, across, turn) - _bent(rx, ry, across, than)
    return (1.0 - 2.0 * side) * further, math.hypot(rx, ry) * abs(turn)


@kernel
def held(joints: JointNumbers, one: int, other: int) -> bool:
    """Return whether a joint holds two bodies together."""
    for j in range(len(joints.holds)):
        a, b = joints.bodies[j]
        if (a == one and b == other) or (a == other and b == one):
            return True
    return False
