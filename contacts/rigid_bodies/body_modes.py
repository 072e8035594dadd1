"""Modes of bodies with shapes where they change, from the acceleration complementarity problem.

The method is that of `contacts.time_stepping.settling`, for free bodies that touch only straight
surfaces and faces of polygons that are fixed or in prescribed motion. The gap acceleration is
``J (M^-1 f - a) - w^2 r n + W^2 R n - 2 W v_t`` at a corner, or the centre of a rolling disc, with
the arms r from the centre of mass and R from the centre of the surface, which moves with
acceleration a and angular velocity W. All other bodies have the modes of their impulses.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.active_contacts import ActiveContacts
from contacts.collision_detection.body_numbers import KINETIC, BodyNumbers, WarmStart, split_key
from contacts.collision_detection.midpoint import Midpoint
from contacts.collision_detection.surfaces import LINE, PLATE, to_frame, to_world
from contacts.collision_detection.time_of_impact import carrier_of
from contacts.rigid_bodies.workspace import Workspace
from contacts.states import FREE, PIN, SLIDE
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.settling import (
    ALIKE,
    LEFT,
    clear_first_order_zeros,
    end_slips,
    mode_of_acceleration,
    solve_accelerations,
)
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

# Sine of the angle below which a normal is that of the plate's face, not of its end.
_PARALLEL = 1e-9

# Values of `WarmStart.modes[b, 1]`: the body settles; it does since an impact, whose impulses are
# wrong by the order of the forces; it also falls within the gap at which it landed.
SETTLES, LANDED, HOVERS = 1, 2, 3


@kernel
def unsettle_bodies(warm: WarmStart, k: int, chunk: Chunk) -> bool:
    """Mark bodies whose mode changes in step k as settling; return whether any settles."""
    any_settles = False
    for b in range(len(warm.modes)):
        code = chunk.modes[k, b] = chunk.codes[k, b]
        if chunk.struck[k, b]:
            warm.modes[b, 1] = max(warm.modes[b, 1], LANDED)
        elif warm.modes[b, 0] != code:
            warm.modes[b, 1] = max(warm.modes[b, 1], SETTLES)
        any_settles = any_settles or warm.modes[b, 1] != 0
    return any_settles


@kernel
def _turn(x: float, y: float, angle: float) -> tuple[float, float]:
    """Return a vector, turned by an angle."""
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


@kernel
def _is_straight(numbers: BodyNumbers, mid: Midpoint, key: int, normal: Array) -> bool:
    """Return whether a contact is on a straight surface, or on a face of a polygon."""
    pieces, surfaces = numbers.pieces, numbers.surfaces
    _, q = split_key(numbers, key)
    nx, ny = _turn(normal[0], normal[1], -mid.poses[carrier_of(numbers, q), 2])
    s = q - len(pieces.sizes)
    if s >= 0:
        a, b, c, d = surfaces.numbers[s]
        plate = surfaces.kinds[s] == PLATE and _is_normal(nx, ny, c - a, d - b)
        return plate or surfaces.kinds[s] == LINE
    last = pieces.firsts[q + 1] - 1
    for i in range(pieces.firsts[q], pieces.firsts[q + 1]):
        (x, y), (a, b) = pieces.vertices[i], pieces.vertices[last]
        if _is_normal(nx, ny, x - a, y - b):
            return True
        last = i
    return False


@kernel
def _is_normal(nx: float, ny: float, x: float, y: float) -> bool:
    """Return whether a normal is that of a face along (x, y)."""
    return abs(nx * x + ny * y) <= _PARALLEL * (abs(x) + abs(y))


@kernel
def _count_contacts(numbers: BodyNumbers, space: Workspace, count: int, counts: Ints) -> None:
    """Write the numbers of contacts of bodies (b,); -1 if accelerations do not give their mode."""
    active = space.active
    for b in range(len(counts)):
        counts[b] = 0
    for j in range(len(numbers.joints.kinds)):
        for b in numbers.joints.bodies[j]:
            if b < len(counts):
                counts[b] = -1
    for c in range(len(numbers.couplings.holds)):
        for b in numbers.couplings.bodies[c]:
            if 0 <= b < len(counts):
                counts[b] = -1
    for b in range(len(counts) - numbers.links.bodies, len(counts)):
        counts[b] = -1
    for i in range(count):
        b, other = active.bodies[i]
        # Compliance and rolling resistance are not part of the problem.
        rigid = active.compliances[i] == 0.0 and active.rolling_roles[i] == 0
        key, normal = active.keys[i, 0], active.rows[i, 0]
        alone = rigid and other < 0 and _is_straight(numbers, space.mid, key, normal)
        if other >= 0:
            counts[other] = -1
        if not alone:
            counts[b] = -1
        elif counts[b] >= 0:
            counts[b] += 1


@kernel
def _turning_acceleration(
    mid: Midpoint, rates: Array, b: int, c: int, direction: Array, arm: float, across: float
) -> float:
    """Return the acceleration by rotation of a corner of body b relative to body c (-1: world).

    ``(W^2 - w^2) r u + W^2 (x_b - x_c) u - 2 W v``, with the `arm` r u along the direction u, and
    the velocity v `across` it.
    """
    own, its = rates[b, 2], rates[c, 2]
    away = direction[0] * (mid.poses[b, 0] - mid.poses[c, 0])
    away += direction[1] * (mid.poses[b, 1] - mid.poses[c, 1])
    return (its * its - own * own) * arm + its * (its * away - 2.0 * across)


@kernel
def _write_accelerations(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, rates: Array, i: int, h: float,
    accelerations: Array, sizes: Array,
) -> None:  # fmt: skip
    """Write the accelerations (2,) of contact i without contact forces, and their sizes."""
    active, (p, q) = space.active, split_key(numbers, space.active.keys[i, 0])
    b, c, rows = active.bodies[i, 0], carrier_of(numbers, q), active.rows[i]
    radius, (normal, slip) = numbers.pieces.radii[p], warm.contacts[i, 4:6]
    for d in range(2):
        arm = radius - rows[1, 2] if d == 0 else rows[0, 2]
        across = slip - radius * (rates[b, 2] - rates[c, 2]) if d == 0 else -normal
        forced = (active.free[i, d] - active.before[i, d]) / h
        bias = _turning_acceleration(space.mid, rates, b, c, rows[d, :2], arm, across)
        accelerations[d], sizes[d] = forced + bias, abs(forced) + abs(bias)


@kernel
def _remember_landing(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, i: int, size: float, h: float
) -> None:
    """Remember the largest gap at which contact i lands, in the frame of its surface."""
    active, b = space.active, space.active.bodies[i, 0]
    above, landed = active.levels[i, 3], warm.landings[b]
    if not (active.hit[i] and warm.contacts[i, 4] <= LEFT * h * size and above > landed[0]):
        return
    p, q = split_key(numbers, active.keys[i, 0])
    pose, frame = space.mid.poses[b], space.mid.poses[carrier_of(numbers, q)]
    nx, ny = active.rows[i, 0, :2]
    along, across = numbers.pieces.radii[p] - active.rows[i, 1, 2], active.rows[i, 0, 2]
    x, y = pose[0] + along * nx + across * ny, pose[1] + along * ny - across * nx
    landed[0], landed[6] = above, carrier_of(numbers, q)
    landed[1], landed[2] = _turn(nx, ny, -frame[2])
    landed[4], landed[5] = to_frame(pose, x, y)
    x, y = to_frame(frame, x, y)
    landed[3] = landed[1] * x + landed[2] * y - above


@kernel
def _relative_velocity(
    mid: Midpoint, rates: Array, b: int, c: int, x: float, y: float
) -> tuple[float, float]:
    """Return the velocity of a point of body b relative to body c (-1: world)."""
    pose, frame = mid.poses[b], mid.poses[c]
    u = rates[b, 0] - rates[b, 2] * (y - pose[1]) - rates[c, 0] + rates[c, 2] * (y - frame[1])
    v = rates[b, 1] + rates[b, 2] * (x - pose[0]) - rates[c, 1] - rates[c, 2] * (x - frame[0])
    return u, v


@kernel
def _hovers(warm: WarmStart, mid: Midpoint, rates: Array, b: int, h: float, alone: bool) -> bool:
    """Return whether a corner falls within the gap at which it landed.

    Unless `alone`, the body is pressed elsewhere: a corner that steps explain is then closed.
    """
    above, nx, ny, zero, u, v, carrier = warm.landings[b]
    c = int(carrier)
    x, y = to_world(mid.poses[b], u, v)
    u, v = to_frame(mid.poses[c], x, y)
    gap, normal = nx * u + ny * v - zero, np.empty(2)
    nx, ny = _turn(nx, ny, mid.poses[c, 2])
    normal[0], normal[1] = nx, ny
    u, v = _relative_velocity(mid, mid.free_rates, b, c, x, y)
    du, dv = _relative_velocity(mid, mid.old_rates, b, c, x, y)
    forced = (nx * (u - du) + ny * (v - dv)) / h
    u, v = _relative_velocity(mid, rates, b, c, x, y)
    along = nx * (x - mid.poses[b, 0]) + ny * (y - mid.poses[b, 1])
    bias = _turning_acceleration(mid, rates, b, c, normal, along, ny * u - nx * v)
    speed_error = LEFT * h * (abs(forced) + abs(bias))
    falls = above > 0.0 and forced + bias <= 0.0 and nx * u + ny * v <= speed_error
    near = LEFT * h * speed_error
    return falls and gap <= above + near and (alone or gap > near)


@kernel
def _is_explained(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, rates: Array, count: int, b: int,
    h: float,
) -> bool:  # fmt: skip
    """Return whether the fall within its landing gap explains all impacts of body b."""
    active, free, sizes = space.active, np.zeros(2), np.zeros(2)
    for i in range(count):
        if active.bodies[i, 0] == b and active.hit[i] and space.pressed[i, 0] > 0.0:
            _write_accelerations(numbers, warm, space, rates, i, h, free, sizes)
            fall = math.sqrt(2.0 * sizes[0] * warm.landings[b, 0])
            if -active.before[i, 0] > fall + LEFT * h * sizes[0]:
                return False
    return True


@kernel
def settle_bodies(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, rates: Array, count: int, k: int,
    chunk: Chunk,
) -> None:  # fmt: skip
    """Write the modes of settling bodies in step k, with `count` contacts, after rates (b, 3).

    Changes `warm`, `space.local` and step k of the chunk.
    """
    counts = space.local[: len(warm.modes)]
    _count_contacts(numbers, space, count, counts)
    for b in range(len(counts)):
        if warm.modes[b, 1] == 0:
            continue
        hovers = warm.modes[b, 1] == HOVERS
        warm.modes[b, 1] = min(warm.modes[b, 1], LANDED)
        if counts[b] < 0:
            continue
        if hovers and chunk.struck[k, b]:
            chunk.struck[k, b] = not _is_explained(numbers, warm, space, rates, count, b, chunk.h)
        mode = FREE
        if counts[b] > 0:
            mode = _body_mode(numbers, warm, space, rates, count, b, k, chunk)
        lands = warm.modes[b, 0] != FREE and not chunk.struck[k, b]
        alone = mode == FREE or chunk.codes[k, b] == FREE
        if lands and _hovers(warm, space.mid, rates, b, chunk.h, alone):
            mode = warm.modes[b, 0] if mode == FREE else mode
            warm.modes[b, 1] = HOVERS
        chunk.modes[k, b] = mode


@kernel
def finish_settling(warm: WarmStart, k: int, chunk: Chunk) -> None:
    """End the settling of bodies whose impulses in step k agree with the modes shown."""
    for b in range(len(warm.modes)):
        mode = warm.modes[b, 0] = chunk.modes[k, b]
        hovers = warm.modes[b, 1] == HOVERS
        if mode == chunk.codes[k, b] and not chunk.struck[k, b] and not hovers:
            warm.modes[b, 1] = 0
            warm.landings[b, 0] = 0.0


@kernel
def _write_cone(
    numbers: BodyNumbers, active: ActiveContacts, i: int, direction: float, cone: Array
) -> None:
    """Write the friction cone of contact i that slips, or rests (0)."""
    law, at = numbers.materials[active.laws[i]], 0 if direction == 0.0 else KINETIC
    cone[0], cone[1] = law[at], law[at + 1]


@kernel
def _combine_modes(accelerations: Array, slips: Array, slides: Array, cones: Array) -> int:
    """Return the mode of a body whose contacts have these accelerations (m, 2)."""
    mode = FREE
    for a in range(len(slips)):
        one = mode_of_acceleration(accelerations[a], slips[a], slides[a] == 0.0, cones[a], False)
        if one == PIN:
            return PIN
        if one != FREE:
            mode = SLIDE
    return mode


@kernel
def _body_mode(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, rates: Array, count: int, b: int,
    k: int, chunk: Chunk,
) -> int:  # fmt: skip
    """Return the mode of body b with `space.local` contacts."""
    active, h, shown, m = space.active, chunk.h, warm.modes[b, 0], 0
    most = space.local[b]
    which = np.empty(most, np.int64)
    free, sizes, accelerations = np.zeros((most, 2)), np.zeros((most, 2)), np.zeros((most, 2))
    cones, slips, slides = np.zeros((most, 2)), np.zeros(most), np.zeros(most)
    for i in range(count):
        if active.bodies[i, 0] != b:
            continue
        presses = space.pressed[i, 0] > 0.0
        _write_accelerations(numbers, warm, space, rates, i, h, free[m], sizes[m])
        rate, rate_error = warm.contacts[i, 4], LEFT * h * sizes[m, 0]
        above = 0.0 if active.hit[i] else active.levels[i, 3]
        near = above <= LEFT * h * rate_error and rate <= rate_error
        if presses:
            _remember_landing(numbers, warm, space, i, sizes[m, 0], h)
        # Forces of other contacts alone may press it: nothing then tells how near it is.
        pressed_on = presses and not active.hit[i]
        closed = presses or (shown != FREE and not active.hit[i])
        if not (pressed_on or (near and closed)):
            continue
        which[m] = i
        _write_cone(numbers, active, i, 0.0, cones[m])
        slip = warm.contacts[i, 5] + active.bias[i, 1]
        slips[m] = slip
        if abs(slip) > space.known[i] and cones[m, 1] > 0.0:
            mu = cones[m, 1] / cones[m, 0]
            rate_error = LEFT * h * (sizes[m, 1] + mu * sizes[m, 0])
            goes_on = shown == SLIDE and slip * active.before[i, 1] > 0.0
            # With two coefficients the active friction shows whether a slip has begun.
            begins = active.slip_directions[i] != 0
            if shown == FREE or goes_on or begins or abs(slip) > rate_error:
                slides[m] = 1.0 if slip > 0.0 else -1.0
        _write_cone(numbers, active, i, slides[m], cones[m])
        m += 1
    if m == 0:
        return FREE
    delassus = np.zeros((2 * m, 2 * m))
    for a in range(m):
        for d in range(2):
            for c in range(m):
                for e in range(2):
                    for j in range(3):
                        row = active.rows[which[a], d, j] * numbers.inverse[b, j]
                        delassus[2 * a + d, 2 * c + e] += row * active.rows[which[c], e, j]
    per_speed = ALIKE * h / max(warm.last_step[1], h * sizes[:m].max())
    sums, against = np.empty((m, 2)), np.zeros(m, np.bool_)
    problem = delassus, free[:m], cones[:m]
    terms, forced, directions = sizes[:m], accelerations[:m], slides[:m]
    solved, _ = solve_accelerations(*problem, directions, terms, forced, sums)
    if solved and end_slips(slips[:m], forced, against, terms, h, directions):
        for a in range(m):
            _write_cone(numbers, active, which[a], directions[a], cones[a])
        solved, _ = solve_accelerations(*problem, directions, terms, forced, sums)
    if not solved:
        return chunk.codes[k, b]
    mode = _combine_modes(forced, slips[:m], slides, cones)
    if warm.modes[b, 1] == LANDED or mode != chunk.codes[k, b]:
        for a in range(m):
            clear_first_order_zeros(forced[a], sums[a], per_speed)
        mode = _combine_modes(forced, slips[:m], slides, cones)
    return mode
