"""Joints of bodies with shapes, to each other and to the world, as rows of a step.

A joint holds at the midpoints of steps: the velocities after a step close the joint at the next
detection, rotation included. No stabilisation follows, so nothing drifts: Verlet's scheme with
constraints, SHAKE (Ryckaert, Ciccotti and Berendsen 1977).

A joint closed at the start of a step h is open by ``h^2 w^2 r/8`` at its midpoint (arm r, angular
velocity w). It keeps this offset, in the first step and where the step size changes: closing it in
one step would take an eighth of the centripetal force.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.active_contacts import ActiveContacts, restore_impulses
from contacts.collision_detection.body_numbers import (
    ALONG_Y,
    BOTH,
    GREATEST,
    LEAST,
    ROD,
    ROPE,
    TURN,
    BodyNumbers,
    JointNumbers,
    WarmStart,
    first_joint_key,
)
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.surfaces import to_world
from contacts.solvers.contact_rows import GUIDED, HELD
from contacts.time_stepping.chunk import HIT, LASTING, SLOW, TIME_MARGIN, contact_role
from statechart.arrays import Array
from statechart.kernels.jit import kernel

# Round-off of joint points.
_ANGLE_ROUND_OFF = 2.0**-50
# Relative difference of step sizes up to which they are the same.
_SAME = 1e-9


OFF = 1e300
"""Bias with which a row that is off, or far from its bound, never presses."""


@kernel
def is_bound(holds: int) -> bool:
    """Return whether a row is a one-sided bound."""
    return holds in (ROPE, LEAST, GREATEST)


@kernel
def _nonlinear_displacement(x: float, y: float, across: bool, turn: float) -> float:
    """Return the displacement of an arm's end in a turn beyond the linear term."""
    c, s = math.cos(turn) - 1.0, math.sin(turn) - turn
    return s * x + c * y if across else c * x - s * y


@kernel
def _joint_ends(
    joints: JointNumbers, j: int, mid: Midpoint, moving: int, h: float, arms: Array, motion: Array
) -> None:
    """Write the arms (2, 2) of a joint, and the relative motion (5, 2) of its ends.

    Rows of the `motion`: difference of the ends; their velocities before the step and without
    impulses; the velocity by which rotation moves them beyond the linear term; sizes of the terms.
    """
    for side in range(2):
        b, sign = joints.bodies[j, side], 1.0 - 2.0 * side
        x, y = to_world(mid.poses[b], joints.points[j, side, 0], joints.points[j, side, 1])
        rx, ry = x - mid.poses[b, 0], y - mid.poses[b, 1]
        arms[side, 0], arms[side, 1] = rx, ry
        motion[0, 0] += sign * x
        motion[0, 1] += sign * y
        for k, rates in ((1, mid.old_rates), (2, mid.free_rates)):
            motion[k, 0] += sign * (rates[b, 0] - rates[b, 2] * ry)
            motion[k, 1] += sign * (rates[b, 1] + rates[b, 2] * rx)
        # The next turn of a led body is known.
        turn = h * (mid.old_rates if b < moving else mid.free_rates)[b, 2]
        for d in range(2):
            motion[3, d] += sign * _nonlinear_displacement(rx, ry, d == 1, turn) / h
        motion[4, 0] += abs(x) + abs(rx) + abs(ry)
        motion[4, 1] += abs(y) + abs(rx) + abs(ry)


@kernel
def _write_direction(
    arms: Array, motion: Array, ux: float, uy: float, m: int, d: int, active: ActiveContacts
) -> None:
    """Write row d of contact m: the velocity of a joint's ends along a direction."""
    for side in range(2):
        at, sign = 3 * side, 1.0 - 2.0 * side
        row = active.rows[m, d]
        row[at], row[at + 1] = sign * ux, sign * uy
        row[at + 2] = sign * (arms[side, 0] * uy - arms[side, 1] * ux)
    active.before[m, d] = ux * motion[1, 0] + uy * motion[1, 1]
    active.free[m, d] = ux * motion[2, 0] + uy * motion[2, 1]


@kernel
def _write_points(
    joints: JointNumbers, j: int, arms: Array, motion: Array, h: float, keeps: bool, m: int,
    active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the rows of a joint of two points; if it `keeps`, it stays as far open as it is."""
    for d in range(2 if joints.kinds[j] == BOTH else 1):
        axis = 1 if d == 1 or joints.kinds[j] == ALONG_Y else 0
        _write_direction(arms, motion, 1.0 - axis, 1.0 * axis, m, d, active)
        active.bias[m, d] = motion[3, axis]
        apart = motion[0, axis]
        # Redundant joints cannot close round-off.
        if not abs(apart) > _ANGLE_ROUND_OFF * motion[4, axis]:
            active.open_by[m, d] = 0.0
            continue
        if keeps:
            active.open_by[m, d] = apart
        active.levels[m, 2 + d] = (apart - active.open_by[m, d]) / h
        active.bias[m, d] += active.levels[m, 2 + d]


@kernel
def _distance_row(
    joints: JointNumbers, j: int, arms: Array, motion: Array, h: float, m: int,
    active: ActiveContacts,
) -> tuple[float, float]:  # fmt: skip
    """Write the closing speed of a joint's ends as contact m; return the remaining distance.

    And the velocity by which it falls faster than linearly, as the ends circle and arms turn.
    """
    far = math.hypot(motion[0, 0], motion[0, 1])
    ux, uy = (motion[0, 0] / far, motion[0, 1] / far) if far > 0.0 else (1.0, 0.0)
    _write_direction(arms, motion, -ux, -uy, m, 0, active)
    around = ux * motion[1, 1] - uy * motion[1, 0]
    further = ux * motion[3, 0] + uy * motion[3, 1]
    further += 0.5 * h * around * around / far if far > 0.0 else 0.0
    return joints.sizes[j, 0] - far, further


@kernel
def _angle_row(
    joints: JointNumbers, j: int, mid: Midpoint, m: int, active: ActiveContacts
) -> float:
    """Write the rate of a relative angle as contact m; return the angle minus its bound."""
    sign, angle = -1.0 if joints.kinds[j] == GREATEST else 1.0, 0.0
    for side in range(2):
        b, way = joints.bodies[j, side], sign * (1.0 - 2.0 * side)
        active.rows[m, 0, 3 * side + 2] = way
        angle += way * mid.poses[b, 2]
        active.before[m, 0] += way * mid.old_rates[b, 2]
        active.free[m, 0] += way * mid.free_rates[b, 2]
    return angle - sign * joints.sizes[j, 0]


@kernel
def _write_bounded_bias(
    gap: float, bend: float, lasting: bool, level: float, h: float, e: float, fall: float, m: int,
    active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the bias of a one-sided row: it is struck as contacts are.

    `bend`: velocity by which the gap falls beyond the linear term, half of the change of its rate
    by rotation; `e`: restitution; `fall`: velocity change by gravity in a step.
    """
    nearing = -active.before[m, 0]
    slow = SLOW * max(abs(active.free[m, 0] - active.before[m, 0]), fall, 2.0 * abs(bend))
    closing, reached = h * (slow - active.free[m, 0] + bend), (0.5 + TIME_MARGIN) * h * nearing
    role, level, above = contact_role(gap, level, lasting, nearing, slow, closing, reached, 0.0)
    active.levels[m, 0], active.levels[m, 1] = level, max(above, 0.0)
    active.levels[m, 3] = above
    active.hit[m] = role == HIT
    active.bias[m, 0] = OFF
    if role == LASTING:
        active.bias[m, 0] = above / h - bend
    elif role == HIT:
        active.bias[m, 0] = -max(e * nearing, bend)
    if not lasting:
        active.pushes[m, 0] = 0.0


@kernel
def _turn_per_fall(numbers: BodyNumbers, j: int) -> float:
    """Return the largest angular velocity per velocity of free fall that a hinge gives.

    That of a pendulum with radius of gyration k is at most ``1/(2 k)``.
    """
    total = 0.0
    for b in numbers.joints.bodies[j]:
        if b < len(numbers.inverse) and numbers.inverse[b, 0] > 0.0:
            total += 0.5 * math.sqrt(numbers.inverse[b, 2] / numbers.inverse[b, 0])
    return total


@kernel
def _write_rows(
    numbers: BodyNumbers, j: int, mid: Midpoint, warm: WarmStart, place: int, h: float, m: int,
    active: ActiveContacts,
) -> None:  # fmt: skip
    """Write the rows of a joint as contact m; its entry of the warm start is at `place`, or -1."""
    joints, bend = numbers.joints, 0.0
    keeps = place < 0 or abs(h - warm.last_step[0]) > _SAME * h
    for d in range(2):
        active.before[m, d] = active.free[m, d] = active.bias[m, d] = 0.0
        active.open_by[m, d] = warm.contacts[place, 4 + d] if place >= 0 else 0.0
        for k in range(6):
            active.rows[m, d, k] = 0.0
    holds = joints.kinds[j]
    if holds >= TURN:
        gap = _angle_row(joints, j, mid, m, active)
    else:
        arms, motion = np.empty((2, 2)), np.zeros((5, 2))
        _joint_ends(joints, j, mid, len(numbers.inverse), h, arms, motion)
        if holds < ROD:
            _write_points(joints, j, arms, motion, h, keeps, m, active)
            return
        gap, bend = _distance_row(joints, j, arms, motion, h, m, active)
    if holds in (ROD, TURN):
        if keeps:
            active.open_by[m, 0] = gap
        active.levels[m, 2] = (gap - active.open_by[m, 0]) / h
        active.bias[m, 0] = active.levels[m, 2] - bend
        return
    lasting = place >= 0 and warm.contacts[place, 1] == 1.0
    level = warm.contacts[place, 0] if place >= 0 else 0.0
    if lasting and keeps:
        level = gap
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    if holds >= TURN:
        fall *= _turn_per_fall(numbers, j)
    _write_bounded_bias(gap, bend, lasting, level, h, joints.sizes[j, 1], fall, m, active)


@kernel
def add_joints(
    numbers: BodyNumbers, warm: WarmStart, mid: Midpoint, h: float, count: int,
    active: ActiveContacts,
) -> int:  # fmt: skip
    """Append the joints to the contacts of a step; return the number of rows.

    For the parameters see `contacts.collision_detection.find_contacts`.
    """
    joints, first, at_old, m = numbers.joints, first_joint_key(numbers), 0, count
    for j in range(len(joints.kinds)):
        b, other = joints.bodies[j]
        active.bodies[m, 0] = b
        active.bodies[m, 1] = other if other < len(numbers.inverse) else -1
        on, bounds = joints.on[joints.owners[j]], is_bound(joints.kinds[j])
        active.materials[m, 0] = HELD if joints.kinds[j] == BOTH else GUIDED
        active.materials[m, 1] = active.materials[m, 2] = 0.0
        if bounds or not on:
            active.materials[m, 0], active.materials[m, 2] = 1.0, joints.sizes[j, 1]
        active.laws[m], active.slip_directions[m] = -1, 0
        active.compliances[m], active.rolling_roles[m] = 0.0, 0
        active.hit[m] = False
        while at_old < warm.n_contacts[0] and warm.keys[at_old, 0] < first + j:
            at_old += 1
        _, _, place = restore_impulses(warm, at_old, first + j, 0, h, m, active)
        if place >= 0 and warm.contacts[place, 9] == 0.0:
            # It was off then.
            place = -1
        active.landings[m] = 1.0 if place < 0 else 0.0
        for d in range(4):
            active.levels[m, d] = 0.0
        _write_rows(numbers, j, mid, warm, place, h, m, active)
        if on and active.bodies[m, 1] < 0:
            before, after = mid.old_rates[other], mid.free_rates[other]
            u, v, turn = after - before
            x, y = to_world(mid.poses[other], joints.points[j, 1, 0], joints.points[j, 1, 1])
            x, y = x - mid.poses[other, 0], y - mid.poses[other, 1]
            mid.force_speed[b] += math.hypot(u - turn * y, v + turn * x)
        if not on:
            active.hit[m] = False
            for d in range(2):
                active.bias[m, d] = OFF
                active.pushes[m, d] = 0.0
        active.keys[m, 0], active.keys[m, 1] = first + j, 0
        m += 1
    return m


@kernel
def arm_bend(
    joints: JointNumbers, j: int, d: int, places: Array, side: int, turn: float, than: float
) -> tuple[float, float]:
    """Return how much farther a joint arm's end goes along row d if its body turns by `turn`.

    Relative to a turn `than`, beyond the linear term, with the row's sign; and its arc length.
    """
    if joints.kinds[j] >= ROD:
        return 0.0, 0.0
    b = joints.bodies[j, side]
    x, y = to_world(places[b], joints.points[j, side, 0], joints.points[j, side, 1])
    rx, ry = x - places[b, 0], y - places[b, 1]
    across = d == 1 or joints.kinds[j] == ALONG_Y
    further = _nonlinear_displacement(rx, ry, across, turn) - _nonlinear_displacement(
        rx, ry, across, than
    )
    return (1.0 - 2.0 * side) * further, math.hypot(rx, ry) * abs(turn)


@kernel
def joint_forces(numbers: BodyNumbers) -> int:
    """Return the number of joint forces: both limits of an angle share one torque."""
    count, holds = 0, numbers.joints.kinds
    for j in range(len(holds)):
        count += 2 if holds[j] in (BOTH, ROPE) else 1
        if holds[j] == GREATEST:
            count -= 1
    return count


@kernel
def is_joined(joints: JointNumbers, one: int, other: int) -> bool:
    """Return whether a joint other than a rope connects two bodies, which then do not collide."""
    for j in range(len(joints.kinds)):
        a, b = joints.bodies[j]
        if joints.kinds[j] == ROPE:
            continue
        if joints.passes[joints.owners[j]] and not joints.on[joints.owners[j]]:
            continue
        if (a == one and b == other) or (a == other and b == one):
            return True
    return False
