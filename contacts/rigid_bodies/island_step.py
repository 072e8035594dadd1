"""The impulses of a step, island by island."""

from __future__ import annotations

import numpy as np

from contacts.collision_detection.body_numbers import BodyNumbers
from contacts.rigid_bodies.islands import gathered, grouped, spread
from contacts.rigid_bodies.joint_closing import close_joints
from contacts.rigid_bodies.mass_ratios import note_worst
from contacts.rigid_bodies.order import CAPPED, PLASTIC, SEQUENTIAL, carried_out, is_ambiguous
from contacts.rigid_bodies.room import Room
from contacts.solvers.contact_rows import scale, scale_beside
from contacts.solvers.contact_solver import solve_rows
from contacts.solvers.island_impulses import island_impulses
from contacts.time_stepping.chunk import (
    AMBIGUOUS,
    CALMED,
    CONTACTS,
    ITERATIONS,
    LIVELY,
    RESIDUAL,
    UNENDED,
    WORK,
)
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put
from statechart.kernels.jit import beside, part

# Forces beside impacts are found to this part of what falls in a step at least.
_NEAR = 1e-2


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


@beside
def solved(
    numbers: BodyNumbers, law: int, forces: bool, h: float, room: Room, count: int, allowed: float,
    effort: Array,
) -> None:  # fmt: skip
    """Find the impulses of a step, island by island.

    Parameters
    ----------
    numbers, law, forces, allowed
        See `contacts.rigid_bodies.body_step.step_bodies`.
    h : float
        Length of the step.
    room : Room
        Its impulses are written, and where the next step starts to look for its own.
    count : int
        Contacts.
    effort : (e,)
        See `Chunk.efforts`.
    """
    touches, inverse, local, order = room.touches, numbers.inverse, room.local, room.order
    bodies, rows, materials = touches.bodies, touches.rows, touches.materials
    room.apart[0] = 0.0
    for j in range(len(effort)):
        effort[j] = 0.0
    effort[CONTACTS] = count
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
        rebounds, quiet, lively, touching = room.rebounds[:size], 0, False, 0
        for a in range(size):
            touching += 1 if materials[members[a], 0] >= 0.0 else 0
        for a in range(size):
            i = members[a]
            put(touches.before[i], start[a])
            put(touches.free[i], unforced[a])
            put(touches.pushes[i], chosen[a])
            rebounds[a] = touches.hit[i] and materials[i, 2] > 0.0
            if law == PLASTIC and touching > 1 and rebounds[a]:
                rebounds[a], touches.wanted[i, 0] = False, 0.0
            put(touches.wanted[i], asked[a])
            room.bounces[i] = rebounds[a]
            lively = lively or (rebounds[a] and materials[i, 2] >= LIVELY)
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
        if touching < size:
            missed, further, softened = close_joints(
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
            effort[AMBIGUOUS] = 1.0
        effort[UNENDED] = max(effort[UNENDED], left)
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
        effort[RESIDUAL] = max(effort[RESIDUAL], missed)
        effort[ITERATIONS] += done
        effort[CALMED] = max(effort[CALMED], 1.0 if softened else 0.0)
        effort[WORK] += done * size


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
