"""Modes of bodies with shapes where they change, from the acceleration complementarity problem.

The method is that of `contacts.time_stepping.settling`, for free bodies that touch only straight
surfaces at rest and faces of fixed polygons. The gap acceleration at a corner is
``J M^-1 f - w^2 r n``, with the arm r from the centre of mass to the corner, or to the centre of a
rolling disc. All other bodies have the modes of their impulses.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.active_contacts import ActiveContacts, velocity
from contacts.collision_detection.body_numbers import KINETIC, BodyNumbers, WarmStart, split_key
from contacts.collision_detection.surfaces import LINE, PLATE
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
def _is_straight(numbers: BodyNumbers, key: int, normal: Array) -> bool:
    """Return whether a contact is on a straight surface at rest, or a face of a fixed polygon."""
    pieces, surfaces = numbers.pieces, numbers.surfaces
    _, q = split_key(numbers, key)
    s = q - len(pieces.sizes)
    if s < 0:
        return _is_fixed_face(numbers, q, normal)
    if surfaces.carriers[s] >= 0:
        return False
    if surfaces.kinds[s] != PLATE:
        return surfaces.kinds[s] == LINE
    a, b, c, d = surfaces.numbers[s]
    return _is_normal(normal, c - a, d - b)


@kernel
def _is_normal(normal: Array, x: float, y: float) -> bool:
    """Return whether a normal is that of a face along (x, y)."""
    return abs(normal[0] * x + normal[1] * y) <= _PARALLEL * (abs(x) + abs(y))


@kernel
def _is_fixed_face(numbers: BodyNumbers, q: int, normal: Array) -> bool:
    """Return whether piece q is a polygon of a fixed body, and a normal that of a face."""
    pieces = numbers.pieces
    at = pieces.bodies[q] - (len(numbers.sizes) - len(numbers.fixed))
    if at < 0 or pieces.radii[q] > 0.0:
        return False
    c, s = math.cos(numbers.fixed[at, 2]), math.sin(numbers.fixed[at, 2])
    last = pieces.vertices[pieces.firsts[q + 1] - 1]
    for i in range(pieces.firsts[q], pieces.firsts[q + 1]):
        x, y = pieces.vertices[i, 0] - last[0], pieces.vertices[i, 1] - last[1]
        if _is_normal(normal, c * x - s * y, s * x + c * y):
            return True
        last = pieces.vertices[i]
    return False


@kernel
def _count_contacts(numbers: BodyNumbers, active: ActiveContacts, count: int, counts: Ints) -> None:
    """Write the numbers of contacts of bodies (b,); -1 if accelerations do not give their mode."""
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
        alone = rigid and other < 0 and _is_straight(numbers, active.keys[i, 0], active.rows[i, 0])
        if other >= 0:
            counts[other] = -1
        if not alone:
            counts[b] = -1
        elif counts[b] >= 0:
            counts[b] += 1


@kernel
def _write_accelerations(
    numbers: BodyNumbers, active: ActiveContacts, i: int, turning: float, h: float,
    accelerations: Array, sizes: Array,
) -> None:  # fmt: skip
    """Write the accelerations (2,) of contact i without contact forces, and their sizes."""
    p, _ = split_key(numbers, active.keys[i, 0])
    rows = active.rows[i]
    for d in range(2):
        arm = numbers.pieces.radii[p] - rows[1, 2] if d == 0 else rows[0, 2]
        forced, bias = (active.free[i, d] - active.before[i, d]) / h, -(turning**2) * arm
        accelerations[d], sizes[d] = forced + bias, abs(forced) + abs(bias)


@kernel
def _remember_landing(
    numbers: BodyNumbers, warm: WarmStart, space: Workspace, rates: Array, i: int, size: float,
    h: float,
) -> None:  # fmt: skip
    """Remember the largest gap at which contact i lands."""
    active, b = space.active, space.active.bodies[i, 0]
    above = active.levels[i, 3]
    stops = velocity(active.bodies, active.rows, rates, i, 0) <= LEFT * h * size
    landed = warm.landings[b]
    if not (active.hit[i] and stops and above > landed[0]):
        return
    p, _ = split_key(numbers, active.keys[i, 0])
    (nx, ny), x, y = active.rows[i, 0, :2], space.mid.poses[b, 0], space.mid.poses[b, 1]
    along, across = numbers.pieces.radii[p] - active.rows[i, 1, 2], active.rows[i, 0, 2]
    u, v = along * nx + across * ny, along * ny - across * nx
    c, s = math.cos(space.mid.poses[b, 2]), math.sin(space.mid.poses[b, 2])
    landed[0], landed[1], landed[2], landed[3] = above, nx, ny, nx * (x + u) + ny * (y + v) - above
    landed[4], landed[5] = c * u + s * v, c * v - s * u


@kernel
def _hovers(warm: WarmStart, space: Workspace, rates: Array, b: int, h: float, alone: bool) -> bool:
    """Return whether a corner falls within the gap at which it landed.

    Unless `alone`, the body is pressed elsewhere: a corner that steps explain is then closed.
    """
    above, nx, ny, zero, u, v = warm.landings[b]
    mid, turning = space.mid, rates[b, 2]
    x, y = mid.poses[b, 0], mid.poses[b, 1]
    c, s = math.cos(mid.poses[b, 2]), math.sin(mid.poses[b, 2])
    u, v = c * u - s * v, s * u + c * v
    along, across = nx * u + ny * v, ny * u - nx * v
    rate = nx * rates[b, 0] + ny * rates[b, 1] + turning * across
    forced = nx * (mid.free_rates[b, 0] - mid.old_rates[b, 0]) + ny * (
        mid.free_rates[b, 1] - mid.old_rates[b, 1]
    )
    forced = (forced + across * (mid.free_rates[b, 2] - mid.old_rates[b, 2])) / h
    bias = -(turning**2) * along
    speed_error = LEFT * h * (abs(forced) + abs(bias))
    gap = nx * (x + u) + ny * (y + v) - zero
    falls = above > 0.0 and forced + bias <= 0.0 and rate <= speed_error
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
            _write_accelerations(numbers, active, i, rates[b, 2], h, free, sizes)
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
    _count_contacts(numbers, space.active, count, counts)
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
        if lands and _hovers(warm, space, rates, b, chunk.h, alone):
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
        _write_accelerations(numbers, active, i, rates[b, 2], h, free[m], sizes[m])
        rate, rate_error = velocity(active.bodies, active.rows, rates, i, 0), LEFT * h * sizes[m, 0]
        above = 0.0 if active.hit[i] else active.levels[i, 3]
        near = above <= LEFT * h * rate_error and rate <= rate_error
        if presses:
            _remember_landing(numbers, warm, space, rates, i, sizes[m, 0], h)
        if not (near and (presses or (shown != FREE and not active.hit[i]))):
            continue
        which[m] = i
        _write_cone(numbers, active, i, 0.0, cones[m])
        slip = velocity(active.bodies, active.rows, rates, i, 1) + active.bias[i, 1]
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
