"""Islands of bodies that touch each other: which contacts they have, as rows of their own."""

from __future__ import annotations

from contacts.solvers.contact_rows import ContactRows, complete
from contacts.solvers.impulse_coupling import root
from statechart.arrays import Array, Ints
from statechart.kernels.jit import part

# Contacts that are next to each other are of the same body: where they are solved so many apart
# impulses get through an island in a tenth fewer sweeps, and none waits for the one before.
_STRIDE = 5


@part
def grouped(bodies: Ints, count: int, parents: Ints, begins: Ints, order: Ints) -> None:
    """Write which contacts belong together, by a counting sort.

    Parameters
    ----------
    bodies : (m, 2) array of int
        Which bodies touch, -1 for a surface.
    count : int
        Contacts, of those that there is place for.
    parents : (b,) array of int
        Is overwritten.
    begins : (b + 1,), order : (m,)
        Island i has the contacts ``order[begins[i] : begins[i + 1]]``.
    """
    for b in range(len(parents)):
        parents[b] = b
        begins[b] = 0
    begins[len(parents)] = 0
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


@part
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


@part
def gathered(
    members: Ints, bodies: Ints, rows: Array, inverse: Array, cones: Array, local: Ints,
    room: ContactRows,
) -> ContactRows:  # fmt: skip
    """Return contacts as rows of their own, in the rates of the bodies that they move.

    Parameters
    ----------
    members : (m,) array of int
    bodies : (c, 2), rows : (c, 2, 6)
        Of all contacts: which bodies touch; velocities, normal and tangential, per unit rates of
        the two.
    inverse : (b, 3)
        See `contacts.collision_detection.body_numbers.BodyNumbers`.
    cones : (c, 2)
    local : (b,) array of int
        Is overwritten.
    room : ContactRows
        Of as many contacts; where they are written.
    """
    count, moved = len(members), 0
    for i in members:
        for side in range(2):
            if bodies[i, side] >= 0:
                local[bodies[i, side]] = -1
    for a in range(count):
        i = members[a]
        for side in range(2):
            b = bodies[i, side]
            if b >= 0 and local[b] < 0:
                local[b] = moved
                moved += 1
            room.bodies[a, side] = local[b] if b >= 0 else -1
            for k in range(3 * side, 3 * side + 3):
                for d in range(2):
                    row = rows[i, d, k] if b >= 0 else 0.0
                    room.rows[a, d, k] = row
                    room.columns[a, d, k] = inverse[b, k - 3 * side] * row if b >= 0 else 0.0
        room.cones[a, 0], room.cones[a, 1] = cones[i, 0], cones[i, 1]
    for a in range(count):
        for side in range(2):
            if room.bodies[a, side] < 0:
                room.bodies[a, side] = moved
    contacts = ContactRows(
        room.bodies[:count], moved, room.rows[:count], room.columns[:count], room.own[:count],
        room.cones[:count], room.laws[:count], room.rates, room.spare,
    )  # fmt: skip
    complete(contacts)
    return contacts


@part
def push(
    bodies: Ints, rows: Array, inverse: Array, rates: Array, i: int, d: int, amount: float
) -> None:
    """Apply an impulse of contact i along d: `rates` (b, 3) are changed in place."""
    for side in range(2):
        b, k = bodies[i, side], 3 * side
        if b >= 0:
            rates[b, 0] += inverse[b, 0] * rows[i, d, k] * amount
            rates[b, 1] += inverse[b, 1] * rows[i, d, k + 1] * amount
            rates[b, 2] += inverse[b, 2] * rows[i, d, k + 2] * amount
