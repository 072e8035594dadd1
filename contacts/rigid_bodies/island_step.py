"""The impulses of a step, island by island: impacts at once or in turn, and joints that close."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from contacts.collision_detection.active_contacts import (
    RESISTS,
    ROLLS,
    ActiveContacts,
    has_two_coefficients,
    rolling_share,
)
from contacts.collision_detection.body_numbers import KINETIC, BodyNumbers
from contacts.collision_detection.joints import bent_on
from contacts.collision_detection.midpoint import Midpoint, push_link
from contacts.rigid_bodies.workspace import Workspace
from contacts.solvers.contact_rows import (
    HELD,
    PAIR,
    ContactRows,
    add,
    along,
    complete,
    joint_work,
    moved,
    scale_of_sum,
    slope,
)
from contacts.solvers.impact_sequence import in_turn
from contacts.solvers.impulse_coupling import root
from contacts.solvers.island_impulses import island_impulses
from contacts.solvers.step_impulses import (
    ONE,
    TWO,
    Island,
    allowed_beside,
    change_friction,
    forces_beside_impacts,
    order_matters,
)
from contacts.time_stepping.chunk import (
    AMBIGUOUS,
    CALMED,
    CONTACTS,
    ITERATIONS,
    LIVELY,
    RESIDUAL,
    SLOW,
    UNENDED,
    WORK,
)
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put, put_rows
from statechart.kernels.jit import kernel

PLASTIC, CAPPED, SEQUENTIAL = range(3)
"""Codes of `contacts.scene.parts.Simultaneous`."""


# Contacts that are next to each other are of the same body: where they are solved so many apart
# impulses get through an island in a tenth fewer sweeps, and none waits for the one before.
_STRIDE = 5


@kernel
def find_islands(
    bodies: Ints, count: int, free: int, firsts: Ints, parents: Ints, begins: Ints, order: Ints
) -> None:
    """Write which contacts belong together, by a counting sort.

    Parameters
    ----------
    bodies : (m, 2) array of int
        Which bodies touch, -1 for a surface.
    count : int
        Contacts, of those that there is place for.
    free : int, firsts : (l,) array of int
        Free bodies, and which of those behind them share coordinates; see `LinkNumbers`.
    parents : (b,) array of int
        Is overwritten.
    begins : (b + 1,), order : (m,)
        Island i has the contacts ``order[begins[i] : begins[i + 1]]``.
    """
    for b in range(len(parents)):
        parents[b] = b
        begins[b] = 0
    begins[len(parents)] = 0
    for i in range(len(firsts)):
        parents[free + i] = free + firsts[i]
    for i in range(count):
        if bodies[i, 1] >= 0:
            one = root(parents, bodies[i, 0])
            parents[one] = root(parents, bodies[i, 1])
    for i in range(count):
        begins[root(parents, bodies[i, 0]) + 1] += 1
    for b in range(len(parents)):
        begins[b + 1] += begins[b]
    for i in range(count - 1, -1, -1):
        island = root(parents, bodies[i, 0]) + 1
        begins[island] -= 1
        order[begins[island]] = i
    for b in range(len(parents)):
        begins[b] = begins[b + 1]
    begins[len(parents)] = count


@kernel
def spread(members: Ints, spare: Ints) -> None:
    """Put the contacts of an island in the order in which they are solved, in place."""
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
def island_rows(numbers: BodyNumbers, members: Ints, work: Workspace) -> ContactRows:
    """Return contacts (m,) as rows of their own, in the rates of the bodies that they move.

    The `local` numbers of bodies are written, and their `pads` where contacts move these: see
    `_add_pads`. Linked bodies have one number, that of the first block of their coordinates.
    """
    active, inverse, local, space = work.active, numbers.inverse, work.local, work.contacts
    count, moved, bodies, rows = len(members), 0, active.bodies, active.rows
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
                linked = moved
                moved += (numbers.links.size + 2) // 3
            if b >= free:
                local[b], b = linked, -1
            elif b >= 0 and local[b] < 0:
                local[b] = moved
                moved += 1
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
        moved = _add_pads(members, active, moved, work.pads, space)
    for a in range(count):
        for side in range(sides):
            if space.bodies[a, side] < 0:
                space.bodies[a, side] = moved
    contacts = ContactRows(
        space.bodies[:count], moved, space.rows[:count], space.columns[:count], space.own[:count],
        space.cones[:count], space.laws[:count], space.rates, space.spare,
        space.shared, space.padded,
    )  # fmt: skip
    complete(contacts)
    return contacts


@kernel
def _write_coordinates(
    numbers: BodyNumbers, mid: Midpoint, active: ActiveContacts, i: int, a: int, linked: int,
    space: ContactRows,
) -> None:  # fmt: skip
    """Write the rows and columns of contact i in coordinates as those of contact a of an island.

    `linked` is the number of the first block of these.
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
def _add_pads(
    members: Ints, active: ActiveContacts, moved: int, pads: Ints, space: ContactRows
) -> int:
    """Let contacts move pads, which have no part in the motion of bodies; return what now moves.

    A compliant contact moves its pad by its compliance. The rows of a disc that rolls move one pad
    against each other: so both are pressed only where their impulses are equal.
    """
    for i in members:
        if active.twins[i] != RESISTS and (active.yields[i] > 0.0 or active.twins[i] == ROLLS):
            pads[i] = moved
            moved += 1
    for a in range(len(members)):
        i, own = members[a], 0.0
        for d in range(2):
            for k in range(6, 9):
                space.rows[a, d, k] = space.columns[a, d, k] = 0.0
        twin = active.twins[i]
        space.bodies[a, 2] = -1
        if twin != 0 or active.yields[i] > 0.0:
            space.bodies[a, 2] = pads[i - 1 if twin == RESISTS else i]
        if twin != 0:
            for k in range(6):
                own += space.rows[a, 0, k] * space.columns[a, 0, k]
            sign = 1.0 if twin == ROLLS else -1.0
            space.rows[a, 0, 6], space.columns[a, 0, 6] = sign, sign * own
        if active.yields[i] > 0.0:
            space.rows[a, 0, 7], space.columns[a, 0, 7] = 1.0, active.yields[i]
    return moved


@kernel
def push(
    numbers: BodyNumbers, active: ActiveContacts, mid: Midpoint, rates: Array, i: int, d: int,
    amount: float,
) -> None:  # fmt: skip
    """Apply an impulse of contact i along d: `rates` (b, 3) are changed in place.

    Of linked bodies those of the coordinates are: see `contacts.collision_detection.midpoint`.
    """
    inverse, rows = numbers.inverse, active.rows
    free = len(inverse) - numbers.links.bodies
    for side in range(2):
        b, k = active.bodies[i, side], 3 * side
        if b >= free:
            x, y, turn = rows[i, d, k], rows[i, d, k + 1], rows[i, d, k + 2]
            push_link(numbers, mid, b, x * amount, y * amount, turn * amount, rates)
        elif b >= 0:
            rates[b, 0] += inverse[b, 0] * rows[i, d, k] * amount
            rates[b, 1] += inverse[b, 1] * rows[i, d, k + 1] * amount
            rates[b, 2] += inverse[b, 2] * rows[i, d, k + 2] * amount


# Relative accuracy of impulses: a stack of twelve under a body of 1e8 times their mass misses 1e-6
# in half of its steps, two bodies do so from 4e9 on, which is the rounding of one product.
_VELOCITY_ROUND_OFF = 64.0 * 2.0**-52
# Impulses that miss by a tenth of the fastest approach hold nothing apart.
_HOLDS_NOTHING = 0.1


@kernel
def note_worst(inverse: Array, bodies: Ints, members: Ints, missed: float, worst: Array) -> None:
    """Note an island if its masses differ by more than those of islands noted before.

    Parameters
    ----------
    inverse : (b, 3)
        See `contacts.collision_detection.body_numbers.BodyNumbers`.
    bodies : (c, 2) array of int
        Which touch, -1 for a surface.
    members : (m,) array of int
        The island's contacts.
    missed : float
        Residual of their impulses.
    worst : (4,)
        Ratio of masses, the lightest body, the heaviest, and the residual; in place.
    """
    light = heavy = -1
    for i in members:
        for side in range(2):
            b = bodies[i, side]
            if b >= 0 and (light < 0 or inverse[b, 0] > inverse[light, 0]):
                light = b
            if b >= 0 and (heavy < 0 or inverse[b, 0] < inverse[heavy, 0]):
                heavy = b
    ratio = inverse[light, 0] / inverse[heavy, 0]
    if ratio > worst[0]:
        worst[0], worst[1], worst[2], worst[3] = ratio, light, heavy, missed


def ratio_remarks(worst: Array, names: Sequence[str], allowed: float) -> tuple[str, ...]:
    """Return what is said of masses at which a tolerance cannot be met."""
    ratio, light, heavy, missed = worst.tolist()
    # Beside bodies of one mass it is the tolerance that is below rounding.
    if ratio * _VELOCITY_ROUND_OFF <= allowed or allowed < _VELOCITY_ROUND_OFF:
        return ()
    reached = max(ratio * _VELOCITY_ROUND_OFF, missed)
    looser = f", or an impulse_tolerance of {reached:.0e}" if reached < _HOLDS_NOTHING else ""
    return (
        f"bodies {names[int(light)]!r} and {names[int(heavy)]!r} are pressed together, and their "
        f"masses are 1 to {ratio:.2g}: round-off leaves a residual of {missed:.2g} of the fastest "
        f"approach, above impulse_tolerance, {allowed:g}. Take masses within 1 to "
        f"{allowed / _VELOCITY_ROUND_OFF:.0e}{looser}",
    )


@kernel
def _add_impacts(space: Workspace, island: Island) -> None:
    """Add the impulses of impacts in turn to those after them."""
    sudden, chosen = island.sudden, island.chosen
    for a in range(len(island.members)):
        i = island.members[a]
        # Contacts that are pressed together again do not rebound.
        rebounds = sudden[a, 0] > 0.0 >= chosen[a, 0]
        space.bounces[i] = rebounds and space.active.materials[i, 2] > 0.0
        for d in range(2):
            chosen[a, d] += sudden[a, d]


@kernel
def _pair(numbers: BodyNumbers, active: ActiveContacts, i: int) -> int:
    """Return a number of the two things that touch at a contact, whichever pieces of them do."""
    one, other = active.bodies[i]
    bodies, pieces = len(numbers.sizes), len(numbers.pieces.sizes)
    surfaces = len(numbers.surfaces.kinds)
    joint = active.keys[i, 0] - pieces * (pieces + surfaces)
    if joint >= 0:
        return int(-1 - joint)
    if other < 0:
        q = active.keys[i, 0] % (pieces + surfaces)
        other = numbers.pieces.bodies[q] if q < pieces else bodies + q - pieces
    return int(min(one, other) * (bodies + surfaces) + max(one, other))


@kernel
def _slow(numbers: BodyNumbers, active: ActiveContacts, i: int, h: float) -> float:
    """Return the approach velocity up to which a contact lasts, see `SLOW`."""
    fall = math.hypot(numbers.gravity[0], numbers.gravity[1]) * h
    return SLOW * max(fall, abs(active.free[i, 0] - active.before[i, 0]))


@kernel
def impacts_in_turn(
    numbers: BodyNumbers, active: ActiveContacts, contacts: ContactRows, island: Island, h: float,
    allowed: float,
) -> tuple[int, float, float]:  # fmt: skip
    """Carry out the impacts of an island one after another; see `in_turn` for what is returned.

    They are those of the instant in the middle of the step, at velocities halfway between those
    before and those that forces alone make: so they do work on the bodies as all impulses of a step
    do, and none that adds energy. What is hit in turn is struck in this step, also where it rested.
    The island keeps what is left to be solved by the step; where impacts do not end nothing is
    changed.
    """
    size = len(island.members)
    pairs, now = np.empty(size, np.int64), np.empty((size, 2))
    restitution, slow = np.empty(size), np.empty(size)
    for a in range(size):
        i = island.members[a]
        pairs[a] = _pair(numbers, active, i)
        restitution[a], slow[a] = active.materials[i, 2], _slow(numbers, active, i, h)
        if active.yields[i] > 0.0:
            slow[a] = math.inf
        for d in range(2):
            now[a, d] = 0.5 * (island.start[a, d] + island.unforced[a, d])
    done, missed, left = in_turn(contacts, pairs, now, restitution, slow, allowed, island.sudden)
    if left > 0.0:
        return done, 0.0, left
    for a in range(size):
        i = island.members[a]
        for d in range(2):
            changed = now[a, d] - 0.5 * (island.start[a, d] + island.unforced[a, d])
            island.start[a, d] += changed
            island.unforced[a, d] += changed
        if slope(contacts.cones[a]) < 0.0:
            continue
        island.hit[a] = island.hit[a] or island.sudden[a, 0] > 0.0
        island.rebounds[a] = False
        if island.hit[a]:
            for d in range(2):
                island.wanted[a, d] = active.wanted[i, d] = 0.0
    return done, missed, left


@kernel
def _order_decides(
    numbers: BodyNumbers, active: ActiveContacts, contacts: ContactRows, island: Island, h: float
) -> bool:
    """Return whether impacts in turn would do something else than those at once.

    They are `LIVELY` contacts that bear more than in the step before, and than what would rest in
    two steps. `Island.sudden` is overwritten.
    """
    pairs, lively = np.empty_like(island.members), np.empty_like(island.hit)
    for a in range(len(pairs)):
        i = island.members[a]
        for d in range(2):
            island.sudden[a, d] = island.chosen[a, d] - active.pushes[i, d]
        pairs[a], sudden = _pair(numbers, active, i), contacts.own[a, 0] * island.sudden[a, 0]
        lively[a] = active.materials[i, 2] >= LIVELY and sudden > _slow(numbers, active, i, h)
    return order_matters(contacts, pairs, lively, island.sudden)


# Slips of islands whose impulses are exact are known to this part of the fastest approach.
_SLIP_ROUND_OFF = 1e-9
# Fixed-point iterations that close joints; they end when the remaining work has not shrunk by this
# factor in so many. Joints stay open where that work, or the work of their impulses, is more than
# these parts of the kinetic energy.
_TRIALS, _SHRINKS, _IDLE, _OPEN, _MOST_WORK = 24, 0.9, 4, 1e-2, 0.1


@kernel
def _follow_arms(
    numbers: BodyNumbers, space: Workspace, contacts: ContactRows, island: Island, h: float,
    with_impacts: bool, turns: Array,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Ask joints of an island to close as their arms turn now; return what would be left of that.

    `with_impacts`: whether bodies move by impacts in turn, too; `turns` (2, b): how far bodies turn
    in the step, as is asked by now, and to work with.

    Returns
    -------
    (float, float, float, float)
        How fast joints part at most, and arms go round; the work of joints on what parts, and the
        energy of motion before the step.
    """
    members, impulses = island.members, island.chosen
    active, mid, joints = space.active, space.mid, numbers.joints
    pieces, changes = len(numbers.pieces.sizes), contacts.rates[0, : 3 * contacts.moving + 3]
    first, most, fastest = pieces * (pieces + len(numbers.surfaces.kinds)), 0.0, 0.0
    work = energy = 0.0
    moved(contacts, impulses, changes)
    for a in range(len(members) if with_impacts else 0):
        add(contacts, a, island.sudden[a, 0], island.sudden[a, 1], changes)
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
            island.wanted[a, d] = active.wanted[i, d]
            most = max(most, abs(further) / h)
            work += abs(impulses[a, d] * further) / h
    for b in range(len(numbers.sizes)):
        if turns[1, b] < math.inf:
            turns[0, b] = turns[1, b]
    return most, fastest, work, energy


@kernel
def close_joints(
    numbers: BodyNumbers, space: Workspace, contacts: ContactRows, island: Island, h: float,
    with_impacts: bool, bounds: tuple[float, float, float], found: tuple[float, int, bool],
) -> tuple[float, int, bool]:  # fmt: skip
    """Find impulses that close the joints of an island at the next detection, by fixed points.

    How an arm is then turned follows from the impulses: SHAKE (Ryckaert, Ciccotti and Berendsen
    1977), whose energy stays within a bound, as it does not where arms turn as they did before.
    Where they go round in circles, as what may stick as well as slip does, those are taken that
    leave joints the least work.

    Parameters
    ----------
    with_impacts : bool
        See `_follow_arms`.
    bounds : (float, float, float)
        Residual of impulses that are good enough, the bound of their work (see `island_impulses`),
        and the residual of those of the whole step.
    found : (float, int, bool)
        What `island_impulses` returned for the impulses at hand; what is found is returned as that.
        Of impulses that close none `Workspace.apart` tells, too.
    """
    (near, bound, allowed), (missed, done, softened) = bounds, found
    least, energy, idle = math.inf, 0.0, 0
    start, unforced, asked, chosen = island.start, island.unforced, island.wanted, island.chosen
    turns, best, first = np.empty((2, len(numbers.sizes))), np.empty_like(chosen), asked.copy()
    good, soft = missed, softened
    for b in range(len(numbers.sizes)):
        turns[0, b] = h * space.mid.old[b, 2]
    for _ in range(_TRIALS):
        left, fast, work, moving = _follow_arms(
            numbers, space, contacts, island, h, with_impacts, turns
        )
        given = joint_work(contacts, chosen, start, unforced)
        if given > bound + _MOST_WORK * moving:
            # Wedged joints close, too, with unbounded work.
            work = max(work, given)
        elif left <= allowed * max(fast, scale_of_sum(contacts, unforced, asked)):
            return missed, done, softened
        idle += 1
        if work < least:
            idle = 0 if work < _SHRINKS * least else idle
            least, energy, good, soft = work, moving, missed, softened
            put_rows(chosen, best)
        if missed > near or idle == _IDLE:
            break
        missed, further, softened = island_impulses(
            contacts, start, unforced, asked, island.rebounds, chosen, near, bound, True
        )
        done += further
    put_rows(best, chosen)
    if good > near or least <= _OPEN * energy:
        return good, done, soft
    space.joint_energy[0] = max(space.joint_energy[0], least / energy)
    if space.joint_energy[1] == 0.0:
        # Wedged joints press without bound: arms turn as before, which does no work.
        put_rows(first, asked)
        for a in range(len(chosen)):
            put(space.active.pushes[island.members[a]], chosen[a])
        good, further, soft = island_impulses(
            contacts, start, unforced, asked, island.rebounds, chosen, near, bound, False
        )
        done += further
    return good, done, soft


@kernel
def _write_frictions(numbers: BodyNumbers, active: ActiveContacts, island: Island) -> bool:
    """Write the frictions of an island; return whether some differ at rest and in motion."""
    splits = False
    for a in range(len(island.members)):
        i = island.members[a]
        used, island.kinds[a], island.ways[a] = active.laws[i], ONE, active.ways[i]
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
    """Write the slips after the step; those up to `none` are what the impulses miss."""
    rates = contacts.rates[0, : 3 * contacts.moving + 3]
    moved(contacts, island.chosen, rates)
    for a in range(len(island.members)):
        slip = island.unforced[a, 1] + island.wanted[a, 1] + along(contacts, a, 1, rates)
        island.after[a, 1] = slip if abs(slip) > none else 0.0


@kernel
def solve_islands(
    numbers: BodyNumbers, law: int, forces: bool, h: float, space: Workspace, count: int,
    allowed: float, effort: Array,
) -> None:  # fmt: skip
    """Find the impulses of a step, island by island.

    Parameters
    ----------
    numbers, law, forces, allowed
        See `contacts.rigid_bodies.body_step.step_bodies`.
    h : float
        Length of the step.
    space : Workspace
        Its impulses are written, and where the next step starts to look for its own.
    count : int
        Contacts.
    effort : (e,)
        See `Chunk.efforts`.
    """
    active, inverse, local, order = space.active, numbers.inverse, space.local, space.order
    free = len(inverse) - numbers.links.bodies
    bodies, materials = active.bodies, active.materials
    space.joint_energy[0] = 0.0
    for j in range(len(effort)):
        effort[j] = 0.0
    effort[CONTACTS] = count
    find_islands(bodies, count, free, numbers.links.firsts, space.parents, space.begins, order)
    for island in range(len(numbers.sizes)):
        members = order[space.begins[island] : space.begins[island + 1]]
        size = len(members)
        if size == 0:
            continue
        spread(members, space.spare)
        contacts = island_rows(numbers, members, space)
        start, unforced = space.island[0, :size], space.island[1, :size]
        asked, chosen = space.island[2, :size], space.island[4, :size]
        rebounds, hit = space.flags[0, :size], space.flags[1, :size]
        together = Island(
            members, start, unforced, asked, space.island[3, :size], chosen,
            space.island[5, :size], space.island[6, :size], rebounds, hit, space.kinds[:size],
            space.ways[:size], space.frictions[:size],
        )  # fmt: skip
        quiet, lively, touching = True, False, 0
        splits = _write_frictions(numbers, active, together)
        for a in range(size):
            touching += 1 if materials[members[a], 0] >= 0.0 else 0
        for a in range(size):
            i = members[a]
            put(active.before[i], start[a])
            put(active.free[i], unforced[a])
            put(active.pushes[i], chosen[a])
            rebounds[a] = active.hit[i] and materials[i, 2] > 0.0
            if law == PLASTIC and touching > 1 and rebounds[a]:
                rebounds[a], active.wanted[i, 0] = False, 0.0
            put(active.wanted[i], asked[a])
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
                    bound += 0.125 * space.mid.pull[b] ** 2 / inverse[b, 0]
                    local[b] = -1
        for b in range(free, len(inverse)):
            if root(space.parents, b) == island:
                bound += 0.125 * space.mid.pull[b] ** 2 / inverse[b, 0]
        sequential = law == SEQUENTIAL and size > 1 and not quiet
        near, turns, left = allowed, 0, 0.0
        missed_turn, share = 0.0, 1.0
        fast = scale_of_sum(contacts, unforced, asked)
        if sequential:
            turns, missed_turn, left = impacts_in_turn(
                numbers, active, contacts, together, h, allowed
            )
            slow = scale_of_sum(contacts, unforced, asked)
            sequential, share = left == 0.0, slow / fast
            near = allowed_beside(allowed, slow, fast)
        missed, done, softened = island_impulses(
            contacts, start, unforced, asked, rebounds, chosen, near, bound, True
        )
        while splits:
            none = max(missed, _SLIP_ROUND_OFF) * fast
            _write_slips(contacts, together, none)
            if not change_friction(contacts, together, none, not quiet):
                break
            missed, further, softened = island_impulses(
                contacts, start, unforced, asked, rebounds, chosen, near, bound, True
            )
            done += further
        if touching < size:
            bounds, found = (near, bound, allowed), (missed, done, softened)
            missed, done, softened = close_joints(
                numbers, space, contacts, together, h, sequential, bounds, found
            )
        if splits:
            _write_slips(contacts, together, max(missed, _SLIP_ROUND_OFF) * fast)
        missed, done = max(share * missed, missed_turn), done + turns
        if missed > allowed:
            note_worst(numbers.inverse, active.bodies, members, missed, space.worst)
        if sequential:
            _add_impacts(space, together)
            quiet = not hit.any()
        if (
            lively
            and law == CAPPED
            and size > 1
            and _order_decides(numbers, active, contacts, together, h)
        ):
            effort[AMBIGUOUS] = 1.0
        effort[UNENDED] = max(effort[UNENDED], left)
        for a in range(size):
            i = members[a]
            space.known[i] = max(missed, allowed) * fast
            put(chosen[a], space.pressed[i])
            put(chosen[a], space.steady[i])
            active.hit[i] = hit[a]
            if splits:
                # Kinetic friction has ended slips of which nothing is left.
                active.ways[i] = together.ways[a] if together.after[a, 1] != 0.0 else 0
                active.materials[i, 0], active.materials[i, 1] = contacts.cones[a]
            # The last impulse of a lasting contact is a better guess than one beside impacts.
            if quiet or hit[a]:
                put(chosen[a], active.pushes[i])
        if forces and not quiet:
            least, pushes = active.free[members] + active.wanted[members], active.pushes[members]
            pushes = forces_beside_impacts(contacts, hit, least, pushes, allowed, fast)
            for a in range(size):
                put(pushes[a], space.steady[members[a]])
        effort[RESIDUAL] = max(effort[RESIDUAL], missed)
        effort[ITERATIONS] += done
        effort[CALMED] = max(effort[CALMED], 1.0 if softened else 0.0)
        effort[WORK] += done * size
