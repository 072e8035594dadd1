"""The impulses of a step, island by island, and where steps work."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.collisions.islands import gathered, grouped, spread
from contacts.collisions.mass_ratios import note_worst
from contacts.collisions.order import CAPPED, PLASTIC, SEQUENTIAL, carried_out, is_ambiguous
from contacts.detection.body_numbers import BodyNumbers, Memory
from contacts.detection.broad_phase import Grid
from contacts.detection.joints import bent_on
from contacts.detection.look import Look
from contacts.detection.touches import Touches
from contacts.solvers.contact_rows import (
    HELD,
    ContactRows,
    add,
    joint_work,
    moved,
    scale,
    scale_beside,
)
from contacts.solvers.island_impulses import island_impulses, solve_rows
from contacts.time_stepping.chunk import LIVELY
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import put, put_rows
from statechart.kernels.jit import beside, late, part

# Forces beside impacts are found to this part of what falls in a step at least.
_NEAR = 1e-2
# So often impulses are found that close joints as their arms turn by them, as long as the work that
# they leave falls by this part in so many; where that is this part of the energy of motion they do
# not close. Nor do they by impulses of joints whose work is that part.
_MOST_WORK = 0.1
_TRIALS, _SHRINKS, _IDLE, _OPEN = 24, 0.9, 4, 1e-2


class Room(NamedTuple):
    """Where steps work; of it `worst` alone lasts.

    Attributes
    ----------
    look : Look
    touches : Touches
    grid : Grid
    pressed : (c, 2), steady : (c, 2)
        Impulses of the step, and those of them that are forces.
    bounces : (c,) array of int
        1: restitution is asked for.
    known : (c,)
        Slip that the impulses of the island may have missed.
    contacts : ContactRows
        Those of an island.
    island : (5, c, 2)
        Their velocities before the step and without impulses, what is wanted, and impulses; and
        those of impacts in turn.
    rebounds : (c,) array of bool
        Which of them do.
    parents, local : (b,) array of int, begins : (b + 1,), order, spare : (c,)
        See `contacts.collisions.islands`.
    borne : (b,)
        The largest impulse that presses a body.
    worst : (4,)
        What lasts: of all islands whose impulses missed what was allowed, that with the largest
        ratio of masses: this ratio, its lightest and its heaviest body, the residual.
    earlier : Memory
        What was remembered before the last step.
    apart : (2,)
        The part of the energy of motion that joints add in a step, for which no impulses were
        found that close them; and 1 where it can be taken in parts.
    """

    look: Look
    touches: Touches
    grid: Grid
    pressed: Array
    steady: Array
    bounces: Ints
    known: Array
    contacts: ContactRows
    island: Array
    rebounds: Bools
    parents: Ints
    local: Ints
    begins: Ints
    order: Ints
    spare: Ints
    borne: Array
    worst: Array
    earlier: Memory
    apart: Array

    @classmethod
    def of(cls, numbers: BodyNumbers, memory: Memory) -> Room:
        """Return room for as many contacts as are remembered."""
        count, most = len(numbers.sizes), len(memory.keys)
        return cls(
            Look.room(numbers),
            Touches.room(most),
            Grid.room(len(numbers.pieces.sizes), most),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty(most, np.int64),
            np.empty(most),
            ContactRows.room(most, count),
            np.empty((5, most, 2)),
            np.empty(most, np.bool_),
            np.empty(count, np.int64),
            np.empty(count, np.int64),
            np.empty(count + 1, np.int64),
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty(count),
            np.zeros(4),
            memory.copy(),
            np.zeros(2),
        )


@part
def _near(allowed: float, slow: float, fast: float) -> float:
    """Return a residual for what approaches slower than others in a step.

    It is found no nearer, as velocities, than the impulses of the step are.
    """
    return min(allowed * fast / slow, max(allowed, _NEAR)) if slow > 0.0 else allowed


@part
def _with_impacts(room: Room, members: Ints, sudden: Array, chosen: Array) -> int:
    """Add the impulses of impacts in turn to those after them; return how many are not struck."""
    touches, quiet = room.touches, 0
    for a in range(len(members)):
        i = members[a]
        # What is pressed together again does not rebound.
        rebounds = sudden[a, 0] > 0.0 >= chosen[a, 0]
        room.bounces[i] = rebounds and touches.materials[i, 2] > 0.0
        quiet += 0 if touches.hit[i] else 1
        for d in range(2):
            chosen[a, d] += sudden[a, d]
    return quiet


@late
def _followed(
    numbers: BodyNumbers, room: Room, members: Ints, contacts: ContactRows, h: float,
    impulses: Array, sudden: Array, in_turn: bool, turns: Array,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Ask joints of an island to close as their arms turn now; return what would be left of that.

    Parameters
    ----------
    numbers, room, members, contacts, h, impulses, sudden, in_turn
        See `solved`.
    turns : (2, b)
        How far bodies turn in the step, as is asked by now, and to work with.

    Returns
    -------
    (float, float, float, float)
        How fast joints part at most, and arms go round; the work of joints on what parts, and the
        energy of motion before the step.
    """
    touches, look, joints = room.touches, room.look, numbers.joints
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
            b = touches.bodies[members[a], side]
            # Once for each body.
            if b < 0 or turns[1, b] < math.inf:
                continue
            for d in range(3):
                rate = look.loose[b, d] + changes[3 * contacts.bodies[a, side] + d]
                energy += 0.5 * look.old[b, d] ** 2 / numbers.inverse[b, d]
                turns[1, b] = h * rate
    for a in range(len(members)):
        i = members[a]
        if not touches.materials[i, 0] < 0.0:
            continue
        for d in range(2 if touches.materials[i, 0] == HELD else 1):
            further = 0.0
            for side in range(2):
                b = touches.bodies[i, side]
                if b >= 0:
                    bent, gone = bent_on(
                        joints, touches.keys[i, 0] - first, d, look.places, side, turns[1, b],
                        turns[0, b],
                    )  # fmt: skip
                    further, fastest = further + bent, max(fastest, gone / h)
            touches.wanted[i, d] += further / h
            room.island[2, a, d] = touches.wanted[i, d]
            most = max(most, abs(further) / h)
            work += abs(impulses[a, d] * further) / h
    for b in range(len(numbers.sizes)):
        if turns[1, b] < math.inf:
            turns[0, b] = turns[1, b]
    return most, fastest, work, energy


@late
def _closed(
    numbers: BodyNumbers, room: Room, members: Ints, contacts: ContactRows, h: float,
    rebounds: Bools, sudden: Array, in_turn: bool, near: float, bound: float, allowed: float,
    missed: float, softened: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Find impulses that close the joints of an island at the next look, by fixed points.

    How an arm is then turned follows from the impulses: SHAKE (Ryckaert, Ciccotti and Berendsen
    1977), whose energy stays within a bound, as it does not where arms turn as they did before.
    Where they go round in circles, as what may stick as well as slip does, those are taken that
    leave joints the least work.

    Parameters
    ----------
    numbers, room, members, contacts, h, rebounds, sudden, in_turn, allowed
        See `solved`.
    near, bound, missed, softened
        See `island_impulses`.
    """
    size, done, least, energy, idle = len(members), 0, math.inf, 0.0, 0
    start, unforced, asked = room.island[0, :size], room.island[1, :size], room.island[2, :size]
    chosen, turns = room.island[3, :size], np.empty((2, len(numbers.sizes)))
    touches = room.touches
    best, first, good, soft = np.empty((size, 2)), asked.copy(), missed, softened
    for b in range(len(numbers.sizes)):
        turns[0, b] = h * room.look.old[b, 2]
    for _ in range(_TRIALS):
        left, fast, work, moving = _followed(
            numbers, room, members, contacts, h, chosen, sudden, in_turn, turns
        )
        given = joint_work(contacts, chosen, start, unforced)
        if given > bound + _MOST_WORK * moving:
            # What wedges closes them, too, by all the work that it likes.
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
    room.apart[0] = max(room.apart[0], least / energy)
    if room.apart[1] == 0.0:
        # What wedges presses without bound: arms turn as they did, and no work is done by that.
        put_rows(first, asked)
        for a in range(size):
            put(touches.pushes[members[a]], chosen[a])
        good, further, soft = island_impulses(
            contacts, start, unforced, asked, rebounds, chosen, near, bound, False
        )
        done += further
    return good, done, soft


@beside
def solved(
    numbers: BodyNumbers, law: int, forces: bool, h: float, room: Room, count: int, allowed: float,
    effort: Array,
) -> None:  # fmt: skip
    """Find the impulses of a step, island by island.

    Parameters
    ----------
    numbers, law, forces, allowed
        See `contacts.collisions.body_step.step_bodies`.
    h : float
        Length of the step.
    room : Room
        Its impulses are written, and where the next step starts to look for its own.
    count : int
        Contacts.
    effort : (6,)
        See `Chunk.efforts`.
    """
    touches, inverse, local, order = room.touches, numbers.inverse, room.local, room.order
    bodies, rows, materials = touches.bodies, touches.rows, touches.materials
    room.apart[0] = 0.0
    for j in range(len(effort)):
        effort[j] = 0.0
    effort[2] = count
    grouped(bodies, count, room.parents, room.begins, order)
    for island in range(len(numbers.sizes)):
        members = order[room.begins[island] : room.begins[island + 1]]
        size = len(members)
        if size == 0:
            continue
        spread(members, room.spare)
        contacts = gathered(members, bodies, rows, inverse, materials, local, room.contacts)
        start, unforced = room.island[0, :size], room.island[1, :size]
        asked, chosen = room.island[2, :size], room.island[3, :size]
        rebounds, quiet, lively, joined = room.rebounds[:size], 0, False, False
        for a in range(size):
            i = members[a]
            put(touches.before[i], start[a])
            put(touches.free[i], unforced[a])
            put(touches.pushes[i], chosen[a])
            rebounds[a] = touches.hit[i] and materials[i, 2] > 0.0
            if law == PLASTIC and size > 1 and rebounds[a]:
                rebounds[a], touches.wanted[i, 0] = False, 0.0
            put(touches.wanted[i], asked[a])
            room.bounces[i] = rebounds[a]
            lively = lively or (rebounds[a] and materials[i, 2] >= LIVELY)
            joined = joined or materials[i, 0] < 0.0
            quiet += 0 if touches.hit[i] else 1
        bound = 0.0
        for a in range(size):
            for side in range(2):
                b = bodies[members[a], side]
                # Once for each body.
                if b >= 0 and local[b] >= 0:
                    bound += 0.125 * room.look.pull[b] ** 2 / inverse[b, 0]
                    local[b] = -1
        in_turn = law == SEQUENTIAL and size > 1 and quiet < size
        sudden, near, turns, left = room.island[4, :size], allowed, 0, 0.0
        missed_turn, share = 0.0, 1.0
        fast = scale_beside(contacts, unforced, asked)
        if in_turn:
            turns, missed_turn, left = carried_out(
                numbers, touches, members, contacts, h, start, unforced, asked, rebounds, sudden,
                allowed,
            )  # fmt: skip
            slow = scale_beside(contacts, unforced, asked)
            in_turn, share, near = left == 0.0, slow / fast, _near(allowed, slow, fast)
        missed, done, softened = island_impulses(
            contacts, start, unforced, asked, rebounds, chosen, near, bound, True
        )
        if joined:
            missed, further, softened = _closed(
                numbers, room, members, contacts, h, rebounds, sudden, in_turn, near, bound,
                allowed, missed, softened,
            )  # fmt: skip
            done += further
        missed, done = max(share * missed, missed_turn), done + turns
        if missed > allowed:
            note_worst(numbers.inverse, touches.bodies, members, missed, room.worst)
        if in_turn:
            quiet = _with_impacts(room, members, sudden, chosen)
        if (
            lively
            and law == CAPPED
            and size > 1
            and is_ambiguous(numbers, touches, members, contacts, h, chosen, local)
        ):
            effort[4] = 1.0
        effort[5] = max(effort[5], left)
        for a in range(size):
            i = members[a]
            room.known[i] = max(missed, allowed) * fast
            put(chosen[a], room.pressed[i])
            put(chosen[a], room.steady[i])
            # What lasts is nearer to what it was than to what others' impacts made it bear.
            if quiet == size or touches.hit[i]:
                put(chosen[a], touches.pushes[i])
        if forces and quiet < size:
            _forces(numbers, room, members, quiet, allowed, fast)
        effort[0] = max(effort[0], missed)
        effort[1] += done
        effort[3] = max(effort[3], 1.0 if softened else 0.0)


@beside
def _forces(
    numbers: BodyNumbers, room: Room, members: Ints, quiet: int, allowed: float, fast: float
) -> None:
    """Write what is force of an island's impulses: those without what strikes.

    `quiet` of its contacts are not struck; `fast` is the `scale` of all.
    """
    touches = room.touches
    others, last = np.empty(quiet, np.int64), 0
    for i in members:
        room.steady[i, 0] = room.steady[i, 1] = 0.0
        if not touches.hit[i]:
            others[last] = i
            last += 1
    if quiet == 0:
        return
    alone, least = np.empty((quiet, 2)), np.empty((quiet, 2))
    for a in range(quiet):
        for d in range(2):
            least[a, d] = touches.free[others[a], d] + touches.wanted[others[a], d]
        put(touches.pushes[others[a]], alone[a])
    contacts = gathered(
        others, touches.bodies, touches.rows, numbers.inverse, touches.materials, room.local,
        room.contacts,
    )  # fmt: skip
    near = _near(allowed, scale(contacts, least), fast)
    solve_rows(contacts, least, alone, near, False, False)
    for a in range(quiet):
        put(alone[a], room.steady[others[a]])
