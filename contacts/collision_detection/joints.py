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
def _joint_rows(
    joints: JointNumbers, j: int, mid: Midpoint, paths: Array, h: float, keeps: bool, m: int,
    active: ActiveContacts,
) -> float:  # fmt: skip
    """Write the rows of a joint as contact m; return the second difference of its anchor over h.

    Velocities are relative to the path. `paths` (3, j, 2): the world anchors of all joints at the
    last detection, this one and the next; `keeps`: the joint stays as far open as it is.
    """
    places, old, loose = mid.poses, mid.old_rates, mid.free_rates
    rows, before, free = active.rows[m], active.before[m], active.free[m]
    wanted, open_by = active.bias[m], active.open_by[m]
    for d in range(2):
        before[d] = free[d] = wanted[d] = 0.0
        apart = size = 0.0
        for k in range(6):
            rows[d, k] = 0.0
        if d == 1 and joints.kinds[j] != BOTH:
            continue
        across = joints.kinds[j] == ALONG_Y or d == 1
        ux, uy = (0.0, 1.0) if across else (1.0, 0.0)
        for side in range(2):
            b, sign = joints.bodies[j, side], 1.0 - 2.0 * side
            if b < 0:
                axis = 1 if across else 0
                now = paths[1, joints.owners[j], axis]
                before[d] -= (now - paths[0, joints.owners[j], axis]) / h
                free[d] -= (paths[2, joints.owners[j], axis] - now) / h
                apart, size = apart - now, size + abs(now)
                continue
            x, y = to_world(places[b], joints.points[j, side, 0], joints.points[j, side, 1])
            rx, ry = x - places[b, 0], y - places[b, 1]
            at = 3 * side
            rows[d, at], rows[d, at + 1] = sign * ux, sign * uy
            rows[d, at + 2] = sign * (rx * uy - ry * ux)
            for k in range(3):
                before[d] += rows[d, at + k] * old[b, k]
                free[d] += rows[d, at + k] * loose[b, k]
            wanted[d] += sign * _nonlinear_displacement(rx, ry, across, h * old[b, 2]) / h
            apart += sign * (ux * x + uy * y)
            size += abs(ux * x + uy * y) + abs(rx) + abs(ry)
        # Redundant joints cannot close round-off.
        if not abs(apart) > _ANGLE_ROUND_OFF * size:
            open_by[d] = 0.0
            continue
        if keeps:
            open_by[d] = apart
        wanted[d] += (apart - open_by[d]) / h
    return _path_bend(paths, joints.owners[j]) / h


@kernel
def _path_bend(paths: Array, j: int) -> float:
    """Return the second difference of the path of joint j's anchor."""
    bend_x = paths[2, j, 0] - 2.0 * paths[1, j, 0] + paths[0, j, 0]
    bend_y = paths[2, j, 1] - 2.0 * paths[1, j, 1] + paths[0, j, 1]
    return math.hypot(bend_x, bend_y)


@kernel
def _distance_row(
    joints: JointNumbers, j: int, mid: Midpoint, paths: Array, h: float, m: int,
    active: ActiveContacts,
) -> tuple[float, float]:  # fmt: skip
    """Write the closing speed of a joint's ends as contact m; return the remaining distance.

    And the velocity by which it falls faster than linearly, as the ends circle and arms turn.
    """
    ends, rates, bent, owner = np.zeros((2, 2)), np.zeros((3, 2)), np.zeros(2), joints.owners[j]
    arms = np.zeros((2, 2))
    for side in range(2):
        b, sign = joints.bodies[j, side], 1.0 - 2.0 * side
        if b < 0:
            for d in range(2):
                now = ends[side, d] = paths[1, owner, d]
                rates[0, d] -= (now - paths[0, owner, d]) / h
                rates[1, d] -= (paths[2, owner, d] - now) / h
            continue
        x, y = to_world(mid.poses[b], joints.points[j, side, 0], joints.points[j, side, 1])
        rx, ry = x - mid.poses[b, 0], y - mid.poses[b, 1]
        ends[side, 0], ends[side, 1], arms[side, 0], arms[side, 1] = x, y, rx, ry
        for k, bodies in ((0, mid.old_rates), (1, mid.free_rates)):
            rates[k, 0] += sign * (bodies[b, 0] - bodies[b, 2] * ry)
            rates[k, 1] += sign * (bodies[b, 1] + bodies[b, 2] * rx)
        bent[0] += sign * _nonlinear_displacement(rx, ry, False, h * mid.old_rates[b, 2]) / h
        bent[1] += sign * _nonlinear_displacement(rx, ry, True, h * mid.old_rates[b, 2]) / h
    far = math.hypot(ends[0, 0] - ends[1, 0], ends[0, 1] - ends[1, 1])
    ux, uy = 1.0, 0.0
    if far > 0.0:
        ux, uy = (ends[0, 0] - ends[1, 0]) / far, (ends[0, 1] - ends[1, 1]) / far
    for side in range(2):
        sign, at = 2.0 * side - 1.0, 3 * side
        if joints.bodies[j, side] >= 0:
            active.rows[m, 0, at], active.rows[m, 0, at + 1] = sign * ux, sign * uy
            turn = arms[side, 0] * uy - arms[side, 1] * ux
            active.rows[m, 0, at + 2] = sign * turn
    active.before[m, 0] = -(ux * rates[0, 0] + uy * rates[0, 1])
    active.free[m, 0] = -(ux * rates[1, 0] + uy * rates[1, 1])
    around = ux * rates[0, 1] - uy * rates[0, 0]
    further = ux * bent[0] + uy * bent[1]
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
        if b >= 0:
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

    `e`: restitution; `fall`: velocity change by gravity in a step.
    """
    nearing = -active.before[m, 0]
    slow = SLOW * max(abs(active.free[m, 0] - active.before[m, 0]), fall)
    closing, reached = h * (slow - active.free[m, 0] + bend), (0.5 + TIME_MARGIN) * h * nearing
    role, level, above = contact_role(gap, level, lasting, nearing, slow, closing, reached, 0.0)
    active.levels[m, 0], active.levels[m, 1] = level, max(above, 0.0)
    active.levels[m, 3] = above
    active.hit[m] = role == HIT
    active.bias[m, 0] = OFF
    if role == LASTING:
        active.bias[m, 0] = above / h - bend
    elif role == HIT:
        active.bias[m, 0] = -e * nearing
    if not lasting:
        active.pushes[m, 0] = 0.0


@kernel
def _write_scalar_row(
    joints: JointNumbers, j: int, mid: Midpoint, paths: Array, warm: WarmStart, place: int,
    h: float, keeps: bool, fall: float, m: int, active: ActiveContacts,
) -> float:  # fmt: skip
    """Write a distance or angle row as contact m; see `_joint_rows`."""
    holds, bend = joints.kinds[j], 0.0
    for d in range(2):
        active.before[m, d] = active.free[m, d] = active.bias[m, d] = 0.0
        for k in range(6):
            active.rows[m, d, k] = 0.0
    if holds in (ROD, ROPE):
        gap, bend = _distance_row(joints, j, mid, paths, h, m, active)
    else:
        gap = _angle_row(joints, j, mid, m, active)
    if holds in (ROD, TURN):
        if keeps:
            active.open_by[m, 0] = gap
        active.bias[m, 0] = (gap - active.open_by[m, 0]) / h - bend
    else:
        lasting = place >= 0 and warm.contacts[place, 1] == 1.0
        level = warm.contacts[place, 0] if place >= 0 else 0.0
        if lasting and keeps:
            level = gap
        _write_bounded_bias(gap, bend, lasting, level, h, joints.sizes[j, 1], fall, m, active)
    return _path_bend(paths, joints.owners[j]) / h


@kernel
def add_joints(
    numbers: BodyNumbers, places: Array, warm: WarmStart, mid: Midpoint, h: float, count: int,
    active: ActiveContacts,
) -> int:  # fmt: skip
    """Append the joints to the contacts of a step; return the number of rows.

    `places` (3, j, 2): world anchors at the previous midpoint, this one and the next; the other
    parameters are those of `contacts.collision_detection.find_contacts`.
    """
    joints, first, at_old, m = numbers.joints, first_joint_key(numbers), 0, count
    past, fall = warm.last_step[0], math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    for j in range(len(joints.kinds)):
        b = joints.bodies[j, 0]
        active.bodies[m, 0], active.bodies[m, 1] = b, joints.bodies[j, 1]
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
        keeps = place < 0 or abs(h - past) > _SAME * h
        for d in range(2):
            active.open_by[m, d] = warm.contacts[place, 4 + d] if place >= 0 else 0.0
        active.levels[m, 0] = active.levels[m, 1] = 0.0
        if joints.kinds[j] >= ROD:
            pull = _write_scalar_row(joints, j, mid, places, warm, place, h, keeps, fall, m, active)
        else:
            pull = _joint_rows(joints, j, mid, places, h, keeps, m, active)
        if on:
            mid.force_speed[b] += pull
        else:
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
