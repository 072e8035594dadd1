"""Impulses of a step, island by island: simultaneous or sequential impacts, and joint closure."""

from __future__ import annotations

import math

import numpy as np

from contacts.collision_detection.active_contacts import (
    RESISTS,
    ROLLS,
    ActiveContacts,
    has_two_coefficients,
    rolling_share,
)
from contacts.collision_detection.body_numbers import (
    DAMPING,
    KINETIC,
    STIFFNESS,
    BodyNumbers,
    first_joint_key,
    split_key,
)
from contacts.collision_detection.broad_phase import sort_by_key
from contacts.collision_detection.couplings import COUPLED, KINETIC_LIMIT, STATIC, bound_in
from contacts.collision_detection.joints import arm_bend
from contacts.collision_detection.midpoint import Midpoint, apply_link_impulse
from contacts.rigid_bodies.workspace import Workspace
from contacts.solvers.contact_rows import (
    HELD,
    PAD,
    PAIR,
    RESTING,
    ContactRows,
    apply_impulse,
    friction_coefficient,
    joint_work,
    row_velocity,
    velocity_scale,
    write_diagonal_blocks,
    write_velocity_change,
)
from contacts.solvers.impact_sequence import sequential_impacts
from contacts.solvers.impulse_coupling import root
from contacts.solvers.island_impulses import island_impulses
from contacts.solvers.step_impulses import (
    LIMIT,
    LIVELY,
    ONE,
    TWO,
    Island,
    change_friction,
    forces_without_impacts,
    order_matters,
    rescale_tolerance,
)
from contacts.time_stepping.chunk import (
    AMBIGUOUS,
    CALMED,
    CONTACTS,
    ITERATIONS,
    RESIDUAL,
    SLOW,
    UNENDED,
    WORK,
    compliant_row,
)
from statechart.arrays import Array, Ints
from statechart.kernels.copies import copy_numbers, copy_rows
from statechart.kernels.jit import kernel

PLASTIC, CAPPED, SEQUENTIAL = range(3)
"""Codes of `contacts.scene.parts.Simultaneous`."""


# Stride of the solution order: adjacent contacts share a body; spreading them saves a tenth of the
# sweeps.
_STRIDE = 5


@kernel
def find_islands(
    bodies: Ints, count: int, free: int, firsts: Ints, parents: Ints, keys: Ints, begins: Ints,
    order: Ints,
) -> None:  # fmt: skip
    """Find the islands of coupled contacts (union-find).

    Island i has the contacts ``order[begins[i] : begins[i + 1]]``. Of the contacts `bodies` (m, 2;
    -1: a surface) `count` are used; there are `free` bodies, then linked ones with `firsts` (l,)
    (see `LinkNumbers`); `parents` (b,) and `keys` (m,) are buffers.
    """
    for b in range(len(parents)):
        parents[b] = b
    for i in range(len(firsts)):
        parents[free + i] = free + firsts[i]
    for i in range(count):
        if bodies[i, 1] >= 0:
            one = root(parents, bodies[i, 0])
            parents[one] = root(parents, bodies[i, 1])
    for i in range(count):
        keys[i] = root(parents, bodies[i, 0])
    sort_by_key(keys, count, begins, order)


@kernel
def distribute_members(members: Ints, spare: Ints) -> None:
    """Reorder the contacts of an island for the sweeps, in place."""
    count, at = len(members), 0
    if count <= _STRIDE:
        return
    for a in range(count):
        spare[a] = members[a]
    for first in range(_STRIDE):
        for a in range(first, count, _STRIDE):
            members[at] = spare[a]
            at += 1


@kernel
def island_rows(numbers: BodyNumbers, members: Ints, h: float, work: Workspace) -> ContactRows:
    """Return contacts (m,) as rows on the bodies that they move.

    Writes the `local` indices of bodies and `pads` (see `_add_pads`). Linked bodies share the index
    of the first block of their coordinates.
    """
    active, inverse, local, space = work.active, numbers.inverse, work.local, work.contacts
    count, n_moving, bodies, rows = len(members), 0, active.bodies, active.rows
    cones, sides = active.materials, space.bodies.shape[1]
    free, linked = len(inverse) - numbers.links.bodies, -1
    for i in members:
        for side in range(2):
            if bodies[i, side] >= 0:
                local[bodies[i, side]] = -1
    for a in range(count):
        i = members[a]
        for side in range(2):
            b = bodies[i, side]
            if b >= free and linked < 0:
                linked = n_moving
                n_moving += (numbers.links.size + 2) // 3
            if b >= free:
                local[b], b = linked, -1
            elif b >= 0 and local[b] < 0:
                local[b] = n_moving
                n_moving += 1
            space.bodies[a, side] = local[b] if b >= 0 else -1
            for k in range(3 * side, 3 * side + 3):
                for d in range(2):
                    row = rows[i, d, k] if b >= 0 else 0.0
                    space.rows[a, d, k] = row
                    space.columns[a, d, k] = inverse[b, k - 3 * side] * row if b >= 0 else 0.0
        space.cones[a, 0], space.cones[a, 1] = cones[i, 0], cones[i, 1]
    if free < len(inverse):
        for a in range(count):
            _write_coordinates(numbers, work.mid, active, members[a], a, linked, space)
    if space.padded == 1:
        _write_compliances(numbers, members, active, n_moving, h, space)
        n_moving = _add_pads(members, active, n_moving, work.pads, space)
    for a in range(count):
        for side in range(sides):
            if space.bodies[a, side] < 0:
                space.bodies[a, side] = n_moving
    contacts = ContactRows(
        space.bodies[:count], n_moving, space.rows[:count], space.columns[:count],
        space.own[:count], space.cones[:count], space.laws[:count], space.rates, space.spare,
        space.shared, space.padded, space.floor,
    )  # fmt: skip
    write_diagonal_blocks(contacts)
    space.floor[0] = _velocity_floor(active, work.mid.free_rates, members)
    return contacts


@kernel
def _velocity_floor(active: ActiveContacts, rates: Array, members: Ints) -> float:
    """Return the least velocity that residuals are relative to.

    It is what forces give a contact in the step, along a wall as well as towards the ground, or
    `RESTING` of the speeds of its bodies.
    """
    floor = 0.0
    for i in members:
        for d in range(2):
            # Joints count with their whole velocity, loads of couplings are none.
            counts = active.laws[i] >= 0 if d == 0 else active.materials[i, 1] > 0.0
            if not counts:
                continue
            speeds = abs(active.free[i, d])
            for side in range(2):
                b = active.bodies[i, side]
                for k in range(3 if b >= 0 else 0):
                    speeds += abs(active.rows[i, d, 3 * side + k] * rates[b, k])
            floor = max(floor, abs(active.free[i, d] - active.before[i, d]), RESTING * speeds)
    return floor


@kernel
def _write_coordinates(
    numbers: BodyNumbers, mid: Midpoint, active: ActiveContacts, i: int, a: int, linked: int,
    space: ContactRows,
) -> None:  # fmt: skip
    """Write contact i on linked bodies as rows and columns of contact a in coordinates.

    `linked` is the index of their first block.
    """
    size, first = numbers.links.size, PAIR + space.padded
    free, touches = len(numbers.inverse) - numbers.links.bodies, False
    rows, columns = space.rows[a], space.columns[a]
    for d in range(2):
        for k in range(3 * first, rows.shape[1]):
            rows[d, k] = columns[d, k] = 0.0
    for side in range(2):
        b = active.bodies[i, side]
        if b < free:
            continue
        touches = True
        for d in range(2):
            for j in range(size):
                for k in range(3):
                    part = active.rows[i, d, 3 * side + k] * mid.links.gradients[b - free, k, j]
                    rows[d, 3 * first + j] += part
    for d in range(2):
        for k in range(size):
            for j in range(size):
                columns[d, 3 * first + k] += mid.links.compliance[k, j] * rows[d, 3 * first + j]
    for block in range(first, space.bodies.shape[1]):
        space.bodies[a, block] = linked + block - first if touches else -1


@kernel
def _write_compliances(
    numbers: BodyNumbers, members: Ints, active: ActiveContacts, n_moving: int, h: float,
    space: ContactRows,
) -> None:  # fmt: skip
    """Write the normal rows of compliant contacts; see `compliant_row`.

    The response to all of them is bounded by the sum of their rows on every rate.
    """
    sums = space.rates[0]
    for k in range(3 * n_moving):
        sums[k] = 0.0
    for responds in (False, True):
        for a in range(len(members)):
            # Both rows of a rolling disc follow from the first, and count once.
            twin, own = active.rolling_roles[members[a]] == RESISTS, 0.0
            i = members[a] - 1 if twin else members[a]
            if active.laws[i] < 0 or active.compliances[i] == 0.0:
                continue
            for k in range(3 * space.bodies.shape[1]):
                b = space.bodies[a, k // 3] if k // 3 != PAIR else -1
                if b >= 0 and responds:
                    own += abs(space.columns[a, 0, k]) * sums[3 * b + k % 3]
                elif b >= 0 and not twin:
                    sums[3 * b + k % 3] += abs(space.rows[a, 0, k])
            if responds:
                law = numbers.materials[active.laws[i]]
                active.compliances[members[a]], active.bias[members[a], 0] = compliant_row(
                    law[STIFFNESS], law[DAMPING], own, active.levels[i, 3], active.before[i, 0], h,
                    max(h, numbers.step),
                )  # fmt: skip


@kernel
def _add_pads(
    members: Ints, active: ActiveContacts, n_moving: int, pads: Ints, space: ContactRows
) -> int:
    """Add pads, massless auxiliary bodies of contacts; return the number of moving bodies.

    A compliant contact moves its pad by its compliance. The two rows of a rolling disc press one
    pad from opposite sides, so that their normal impulses are equal.
    """
    for i in members:
        if active.rolling_roles[i] != RESISTS and (
            active.compliances[i] > 0.0 or active.rolling_roles[i] == ROLLS
        ):
            pads[i] = n_moving
            n_moving += 1
    for a in range(len(members)):
        i, own = members[a], 0.0
        for d in range(2):
            for k in range(6, 9):
                space.rows[a, d, k] = space.columns[a, d, k] = 0.0
        twin = active.rolling_roles[i]
        space.bodies[a, 2] = -1
        if twin != 0 or active.compliances[i] > 0.0:
            space.bodies[a, 2] = pads[i - 1 if twin == RESISTS else i]
        if twin != 0:
            for k in range(6):
                own += space.rows[a, 0, k] * space.columns[a, 0, k]
            sign = 1.0 if twin == ROLLS else -1.0
            space.rows[a, 0, 6], space.columns[a, 0, 6] = sign, sign * own
        if active.compliances[i] > 0.0:
            space.rows[a, 0, PAD], space.columns[a, 0, PAD] = 1.0, active.compliances[i]
    return n_moving


@kernel
def apply_row_impulse(
    numbers: BodyNumbers, active: ActiveContacts, mid: Midpoint, rates: Array, i: int, d: int,
    amount: float,
) -> None:  # fmt: skip
    """Apply an impulse of contact i along d to the rates (b, 3), in place.

    For linked bodies, those of the coordinates; see `contacts.collision_detection.midpoint`.
    """
    inverse, rows = numbers.inverse, active.rows
    free = len(inverse) - numbers.links.bodies
    for side in range(2):
        b, k = active.bodies[i, side], 3 * side
        if b >= free:
            x, y, turn = rows[i, d, k], rows[i, d, k + 1], rows[i, d, k + 2]
            apply_link_impulse(numbers, mid, b, x * amount, y * amount, turn * amount, rates)
        elif b >= 0:
            rates[b, 0] += inverse[b, 0] * rows[i, d, k] * amount
            rates[b, 1] += inverse[b, 1] * rows[i, d, k + 1] * amount
            rates[b, 2] += inverse[b, 2] * rows[i, d, k + 2] * amount


@kernel
def _add_impacts(space: Workspace, island: Island) -> None:
    """Add the impulses of sequential impacts to those after them."""
    sudden, chosen = island.impact_impulses, island.chosen
    for a in range(len(island.members)):
        i = island.members[a]
        # Contacts that are pressed together again do not rebound.
        rebounds = sudden[a, 0] > 0.0 >= chosen[a, 0]
        space.bounces[i] = rebounds and space.active.materials[i, 2] > 0.0
        for d in range(2):
            chosen[a, d] += sudden[a, d]


@kernel
def _pair_number(numbers: BodyNumbers, active: ActiveContacts, i: int) -> int:
    """Return a number of the two objects in contact, whichever of their pieces touch."""
    one, other = active.bodies[i]
    bodies, pieces = len(numbers.sizes), len(numbers.pieces.sizes)
    joint = active.keys[i, 0] - first_joint_key(numbers)
    if joint >= 0:
        return int(-1 - joint)
    if other < 0:
        _, q = split_key(numbers, active.keys[i, 0])
        other = numbers.pieces.bodies[q] if q < pieces else bodies + q - pieces
    return int(min(one, other) * (bodies + len(numbers.surfaces.kinds)) + max(one, other))


@kernel
def _slow(numbers: BodyNumbers, active: ActiveContacts, i: int, h: float) -> float:
    """Return the approach velocity up to which a contact lasts; see `SLOW`."""
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    return SLOW * max(fall, abs(active.free[i, 0] - active.before[i, 0]))


@kernel
def solve_sequential_impacts(
    numbers: BodyNumbers, active: ActiveContacts, contacts: ContactRows, island: Island, h: float,
    tolerance: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Carry out the impacts of an island sequentially; see `sequential_impacts` for the results.

    They happen at mid-step, at velocities halfway between those before the step and those under
    forces alone: their work is that of all impulses of a step, and adds no energy. Every contact
    that is hit counts as struck. The island keeps the remainder for the step; if the impacts do not
    end nothing changes.
    """
    size = len(island.members)
    pairs, now = np.empty(size, np.int64), np.empty((size, 2))
    restitution, slow = np.empty(size), np.empty(size)
    for a in range(size):
        i = island.members[a]
        pairs[a] = _pair_number(numbers, active, i)
        restitution[a], slow[a] = active.materials[i, 2], _slow(numbers, active, i, h)
        if active.compliances[i] > 0.0:
            slow[a] = math.inf
        for d in range(2):
            now[a, d] = 0.5 * (island.start[a, d] + island.unforced[a, d])
    iterations, residual, remaining = sequential_impacts(
        contacts, pairs, now, restitution, slow, tolerance, island.impact_impulses
    )
    if remaining > 0.0:
        return iterations, 0.0, remaining
    for a in range(size):
        i = island.members[a]
        for d in range(2):
            changed = now[a, d] - 0.5 * (island.start[a, d] + island.unforced[a, d])
            island.start[a, d] += changed
            island.unforced[a, d] += changed
        if friction_coefficient(contacts.cones[a]) < 0.0:
            continue
        island.hit[a] = island.hit[a] or island.impact_impulses[a, 0] > 0.0
        island.rebounds[a] = False
        if island.hit[a]:
            for d in range(2):
                island.bias[a, d] = active.bias[i, d] = 0.0
    return iterations, residual, remaining


@kernel
def _order_decides(
    numbers: BodyNumbers, active: ActiveContacts, contacts: ContactRows, island: Island, h: float
) -> bool:
    """Return whether sequential impacts would differ from simultaneous ones.

    Considers `LIVELY` contacts whose impulse exceeds that of the previous step, and that of rest
    over two steps. Overwrites `Island.impact_impulses`.
    """
    pairs, lively = np.empty_like(island.members), np.empty_like(island.hit)
    for a in range(len(pairs)):
        i = island.members[a]
        for d in range(2):
            island.impact_impulses[a, d] = island.chosen[a, d] - active.pushes[i, d]
        pairs[a] = _pair_number(numbers, active, i)
        sudden = contacts.own[a, 0] * island.impact_impulses[a, 0]
        lively[a] = active.materials[i, 2] >= LIVELY and sudden > _slow(numbers, active, i, h)
    return order_matters(contacts, pairs, lively, island.impact_impulses)


# Landing, relative to the velocity that forces give in a step, below which forces contain it.
_LANDS = 1e-3
# Relative round-off of slips, to the fastest approach.
_SLIP_ROUND_OFF = 1e-9
# Fixed-point iterations that close joints; they stop when the remaining work has not shrunk by this
# factor in so many. Joints stay open if that work, or that of their impulses, exceeds these parts
# of the kinetic energy.
_TRIALS, _SHRINKS, _IDLE, _OPEN, _MOST_WORK = 24, 0.9, 4, 1e-2, 0.1


@kernel
def _follow_arms(
    numbers: BodyNumbers, space: Workspace, contacts: ContactRows, island: Island, h: float,
    with_impacts: bool, turns: Array,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Update the bias of joints for the rotation of their arms.

    `with_impacts`: bodies also move by sequential impacts; `turns` (2, b): rotation in the step
    that the bias assumes, and a buffer. Returns the largest joint speed error, the largest arm
    speed, the work of joints on the error, and the kinetic energy before the step.
    """
    members, impulses = island.members, island.chosen
    active, mid, joints = space.active, space.mid, numbers.joints
    changes, first = contacts.rates[0, : 3 * contacts.moving + 3], first_joint_key(numbers)
    largest = fastest = 0.0
    work = energy = 0.0
    write_velocity_change(contacts, impulses, changes)
    for a in range(len(members) if with_impacts else 0):
        apply_impulse(
            contacts, a, island.impact_impulses[a, 0], island.impact_impulses[a, 1], changes
        )
    for b in range(len(numbers.sizes)):
        turns[1, b] = math.inf
    for a in range(len(members)):
        for side in range(2):
            b = active.bodies[members[a], side]
            # Once for each body.
            if b < 0 or turns[1, b] < math.inf:
                continue
            for d in range(3):
                rate = mid.free_rates[b, d] + changes[3 * contacts.bodies[a, side] + d]
                energy += 0.5 * mid.old_rates[b, d] ** 2 / numbers.inverse[b, d]
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
                    bent, gone = arm_bend(
                        joints, active.keys[i, 0] - first, d, mid.poses, side, turns[1, b],
                        turns[0, b],
                    )  # fmt: skip
                    further, fastest = further + bent, max(fastest, gone / h)
            active.bias[i, d] += further / h
            island.bias[a, d] = active.bias[i, d]
            largest = max(largest, abs(further) / h)
            work += abs(impulses[a, d] * further) / h
    for b in range(len(numbers.sizes)):
        if turns[1, b] < math.inf:
            turns[0, b] = turns[1, b]
    return largest, fastest, work, energy


@kernel
def _restore_pushes(active: ActiveContacts, island: Island) -> None:
    """Reset the impulses of an island to those of the previous step."""
    for a in range(len(island.members)):
        copy_numbers(active.pushes[island.members[a]], island.chosen[a])


@kernel
def _joint_closes(active: ActiveContacts, members: Ints) -> bool:
    """Return whether a joint of an island closes in this step, or the run begins."""
    closes = False
    for i in members:
        closes = closes or (active.materials[i, 0] < 0.0 and active.landings[i] == 1.0)
    return closes


@kernel
def close_joints(
    numbers: BodyNumbers, space: Workspace, contacts: ContactRows, island: Island, h: float,
    with_impacts: bool, bounds: tuple[float, float, float], result: tuple[float, int, bool],
) -> tuple[float, int, bool]:  # fmt: skip
    """Find impulses that close the joints of an island at the next detection (fixed points).

    The rotation of an arm depends on the impulses: SHAKE (Ryckaert, Ciccotti and Berendsen 1977),
    whose energy stays bounded, unlike with arms extrapolated from the start of the step. If
    iterations cycle, as between stick and slip, those with the least joint work are taken.

    Redundant joints contradict each other until the bias has the rotation after a closing. Opposed
    impulses of such iterations would remain: each one starts from those of the previous step.

    `with_impacts`: see `_follow_arms`; `bounds`: residual tolerance, bound of the work (see
    `island_impulses`), residual tolerance of the whole step; `result`: that of `island_impulses`
    for the present impulses. Returns the new result, and notes failures in
    `Workspace.joint_energy`.
    """
    (tolerance, bound, step_tolerance), (residual, iterations, softened) = bounds, result
    least_work, energy, idle = math.inf, 0.0, 0
    start, unforced, bias, chosen = island.start, island.unforced, island.bias, island.chosen
    turns, best, first = np.empty((2, len(numbers.sizes))), np.empty_like(chosen), bias.copy()
    best_residual, best_softened = residual, softened
    closes = _joint_closes(space.active, island.members)
    for b in range(len(numbers.sizes)):
        turns[0, b] = h * space.mid.old_rates[b, 2]
    for _ in range(_TRIALS):
        error, fast, work, moving = _follow_arms(
            numbers, space, contacts, island, h, with_impacts, turns
        )
        impulse_work = joint_work(contacts, chosen, start, unforced)
        if impulse_work > bound + _MOST_WORK * moving:
            # Wedged joints close with unbounded work.
            work = max(work, impulse_work)
        elif error <= step_tolerance * max(fast, velocity_scale(contacts, unforced + bias)):
            return residual, iterations, softened
        idle += 1
        if work < least_work:
            idle = 0 if work < _SHRINKS * least_work else idle
            least_work, energy, best_residual, best_softened = work, moving, residual, softened
            copy_rows(chosen, best)
        if residual > tolerance or idle == _IDLE:
            break
        if closes:
            _restore_pushes(space.active, island)
        residual, further, softened = island_impulses(
            contacts, start, unforced, bias, island.rebounds, chosen, tolerance, bound, True
        )
        iterations += further
    copy_rows(best, chosen)
    if best_residual > tolerance or least_work <= _OPEN * energy:
        return best_residual, iterations, best_softened
    space.joint_energy[0] = max(space.joint_energy[0], least_work / energy)
    if space.joint_energy[1] == 0.0:
        # Wedged joints press without bound: extrapolate arms from the step's start, without work.
        copy_rows(first, bias)
        _restore_pushes(space.active, island)
        best_residual, further, best_softened = island_impulses(
            contacts, start, unforced, bias, island.rebounds, chosen, tolerance, bound, False
        )
        iterations += further
    return best_residual, iterations, best_softened


@kernel
def _write_frictions(numbers: BodyNumbers, space: Workspace, island: Island) -> bool:
    """Write the frictions of an island; return whether any has two coefficients."""
    splits, active = False, space.active
    for a in range(len(island.members)):
        i = island.members[a]
        used, island.kinds[a] = active.laws[i], ONE
        island.slip_directions[a] = active.slip_directions[i]
        if used <= COUPLED and active.materials[i, 1] > 0.0:
            bounds = space.limits[COUPLED - used]
            if bounds[STATIC] != bounds[KINETIC_LIMIT]:
                splits, island.kinds[a] = True, LIMIT
            for way in range(3):
                island.frictions[a, way, 0] = 1.0
                island.frictions[a, way, 1] = bound_in(bounds, way)
        if used < 0 or not has_two_coefficients(numbers.materials[used]):
            continue
        splits, island.kinds[a] = True, TWO
        for way in range(3):
            at = 0 if way == 0 else KINETIC
            island.frictions[a, way, 0] = numbers.materials[used, at]
            island.frictions[a, way, 1] = rolling_share(active, i) * numbers.materials[used, at + 1]
    return splits


@kernel
def _write_slips(contacts: ContactRows, island: Island, none: float) -> None:
    """Write the slips after the step; those up to `none` are errors of the impulses."""
    rates = contacts.rates[0, : 3 * contacts.moving + 3]
    write_velocity_change(contacts, island.chosen, rates)
    for a in range(len(island.members)):
        slip = island.unforced[a, 1] + island.bias[a, 1] + row_velocity(contacts, a, 1, rates)
        island.after[a, 1] = slip if abs(slip) > none else 0.0


@kernel
def _remove_landings(active: ActiveContacts, members: Ints, impulses: Array, least: Array) -> bool:
    """Remove landings from the velocities `least` (m, 2) without impulses; return if there are any.

    Contacts that bear, and the ends of all joints if one closes, are then at rest: what is left is
    what forces and rotation give in the step. Gaps of joints, of the size of round-off or of the
    residual, are not closed: redundant joints would contradict each other.
    """
    lands, closes = False, _joint_closes(active, members)
    for a in range(len(members)):
        i = members[a]
        for d in range(2 if closes and active.materials[i, 0] < 0.0 else 0):
            closing = active.before[i, d] - active.bias[i, d] + 2.0 * active.levels[i, 2 + d]
            least[a, d] -= closing
            lands = lands or abs(closing) > _LANDS * abs(least[a, d])
        if (active.laws[i] < 0 and active.rolling_roles[i] != RESISTS) or impulses[a, 0] <= 0.0:
            continue
        least[a, 0] -= active.landings[i]
        lands = lands or abs(active.landings[i]) > _LANDS * abs(least[a, 0])
    return lands


@kernel
def solve_islands(
    numbers: BodyNumbers, law: int, forces: bool, h: float, space: Workspace, count: int,
    tolerance: float, effort: Array,
) -> None:  # fmt: skip
    """Solve the impulses of a step with `count` contacts, island by island.

    Writes impulses and the next warm start to `space`, and statistics `effort` (see `Chunk.stats`).
    For `law`, `forces` and `tolerance` see `contacts.rigid_bodies.body_step.StepOptions`.
    """
    active, inverse, local, order = space.active, numbers.inverse, space.local, space.order
    free = len(inverse) - numbers.links.bodies
    bodies, materials = active.bodies, active.materials
    space.joint_energy[0] = 0.0
    for j in range(len(effort)):
        effort[j] = 0.0
    effort[CONTACTS] = count
    firsts, parents = numbers.links.firsts, space.parents
    find_islands(bodies, count, free, firsts, parents, space.spare, space.begins, order)
    for island in range(len(numbers.sizes)):
        members = order[space.begins[island] : space.begins[island + 1]]
        size = len(members)
        if size == 0:
            continue
        distribute_members(members, space.spare)
        contacts = island_rows(numbers, members, h, space)
        start, unforced = space.island[0, :size], space.island[1, :size]
        bias, chosen = space.island[2, :size], space.island[4, :size]
        rebounds, hit = space.flags[0, :size], space.flags[1, :size]
        together = Island(
            members, start, unforced, bias, space.island[3, :size], chosen,
            space.island[5, :size], space.island[6, :size], rebounds, hit, space.kinds[:size],
            space.slip_directions[:size], space.frictions[:size],
        )  # fmt: skip
        quiet, lively, joined, rigid = True, False, False, 0
        splits = _write_frictions(numbers, space, together)
        for a in range(size):
            joint = materials[members[a], 0] < 0.0
            joined = joined or joint
            rigid += 0 if joint or active.compliances[members[a]] > 0.0 else 1
        for a in range(size):
            i = members[a]
            copy_numbers(active.before[i], start[a])
            copy_numbers(active.free[i], unforced[a])
            copy_numbers(active.pushes[i], chosen[a])
            rebounds[a] = active.hit[i] and materials[i, 2] > 0.0
            if law == PLASTIC and rigid > 1 and rebounds[a]:
                rebounds[a], active.bias[i, 0] = False, 0.0
            copy_numbers(active.bias[i], bias[a])
            space.bounces[i] = rebounds[a]
            lively = lively or (rebounds[a] and materials[i, 2] >= LIVELY)
            hit[a] = active.hit[i]
            quiet = quiet and not hit[a]
        bound = 0.0
        for a in range(size):
            for side in range(2):
                b = bodies[members[a], side]
                # Once for each body.
                if 0 <= b < free and local[b] >= 0:
                    bound += 0.125 * space.mid.force_speed[b] ** 2 / inverse[b, 0]
                    local[b] = -1
        for b in range(free, len(inverse)):
            if root(space.parents, b) == island:
                bound += 0.125 * space.mid.force_speed[b] ** 2 / inverse[b, 0]
        sequential = law == SEQUENTIAL and size > 1 and not quiet
        island_tolerance, impacts, remaining = tolerance, 0, 0.0
        impact_residual, share = 0.0, 1.0
        fast = velocity_scale(contacts, unforced + bias)
        if sequential:
            impacts, impact_residual, remaining = solve_sequential_impacts(
                numbers, active, contacts, together, h, tolerance
            )
            slow = velocity_scale(contacts, unforced + bias)
            sequential, share = remaining == 0.0, slow / fast
            island_tolerance = rescale_tolerance(tolerance, slow, fast)
        residual, iterations, softened = island_impulses(
            contacts, start, unforced, bias, rebounds, chosen, island_tolerance, bound, True
        )
        while splits:
            none = max(residual, _SLIP_ROUND_OFF) * fast
            _write_slips(contacts, together, none)
            if not change_friction(contacts, together, none, not quiet):
                break
            residual, further, softened = island_impulses(
                contacts, start, unforced, bias, rebounds, chosen, island_tolerance, bound, True
            )
            iterations += further
        if joined:
            bounds, result = (island_tolerance, bound, tolerance), (residual, iterations, softened)
            residual, iterations, softened = close_joints(
                numbers, space, contacts, together, h, sequential, bounds, result
            )
        if splits:
            _write_slips(contacts, together, max(residual, _SLIP_ROUND_OFF) * fast)
        residual, iterations = max(share * residual, impact_residual), iterations + impacts
        if sequential:
            _add_impacts(space, together)
            quiet = not hit.any()
        lively = lively and law == CAPPED and size > 1
        if lively and _order_decides(numbers, active, contacts, together, h):
            effort[AMBIGUOUS] = 1.0
        effort[UNENDED] = max(effort[UNENDED], remaining)
        for a in range(size):
            i = members[a]
            space.known[i] = max(residual, tolerance) * fast
            copy_numbers(chosen[a], space.pressed[i])
            copy_numbers(chosen[a], space.steady[i])
            active.hit[i] = hit[a]
            if splits:
                # A slip without remainder has ended under kinetic friction.
                active.slip_directions[i] = (
                    together.slip_directions[a] if together.after[a, 1] != 0.0 else 0
                )
                active.materials[i, 0], active.materials[i, 1] = contacts.cones[a]
            # The previous impulse of a lasting contact is a better warm start than one during
            # impacts.
            if quiet or hit[a]:
                copy_numbers(chosen[a], active.pushes[i])
        if forces and (joined or not quiet):
            least, pushes = active.free[members] + active.bias[members], active.pushes[members]
            lands = joined and _remove_landings(active, members, chosen, least)
            if _joint_closes(active, members):
                # Redundant joints would keep a part of the impulses that stop them.
                pushes = np.zeros_like(pushes)
            if lands or not quiet:
                pushes = forces_without_impacts(contacts, hit, least, pushes, tolerance, fast)
                for a in range(size):
                    copy_numbers(pushes[a], space.steady[members[a]])
        effort[RESIDUAL] = max(effort[RESIDUAL], residual)
        effort[ITERATIONS] += iterations
        effort[CALMED] = max(effort[CALMED], 1.0 if softened else 0.0)
        effort[WORK] += iterations * size
