"""Impulses of an island in a step: friction that changes, impacts whose order decides, forces.

An island is a group of contacts that feel each other's impulses: through bodies of three rates
each, or through coordinates that all of them move.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import (
    BEGINS,
    LAW,
    ON_TRIAL,
    ContactRows,
    add,
    along,
    complete,
    law_of,
    overload,
    rates_of,
    rows_of,
    scale,
    slope,
    without,
)
from contacts.solvers.contact_solver import solve_rows
from contacts.solvers.island_impulses import island_impulses, work_share
from contacts.solvers.saddle_point import largest_size
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices, put
from statechart.kernels.jit import kernel

# Velocities and impulses below this part of the largest are round-off; and velocities that are
# sums, below this part of their terms.
_ROUNDING, SUM_ROUNDING = 1e-13, 1e-9
# Another impact that changes a velocity by less than this part of its own change is not felt: a
# body turns within a step.
_NEGLIGIBLE_CHANGE = 1e-3
# Forces beside impacts are found to this part of what falls in a step at least.
_NEAR = 1e-2

ONE, TWO, LIMIT = range(3)
"""Kinds of friction: one coefficient; one at rest and another in motion; two limits of a force,
which bears nothing at an instant."""


class Island(NamedTuple):
    """Contacts that feel each other's impulses, in the order of their rows."""

    members: Ints  # (m,): their numbers.
    # (m, 2): velocities before the step, and without impulses; what these may not fall below,
    # negated; the sum of both.
    start: Array
    unforced: Array
    wanted: Array
    least: Array
    # (m, 2): impulses; velocities under them, 0 for round-off; impulses of impacts in turn.
    chosen: Array
    after: Array
    sudden: Array
    # (m,): who asks for restitution; who is struck.
    rebounds: Bools
    hit: Bools
    # (m,): kind of the friction; way of the slip whose friction holds: 0 at rest, 1 or -1 as it was
    # before the step, `BEGINS` or -`BEGINS`, or `ON_TRIAL`.
    kinds: Ints
    ways: Ints
    frictions: Array  # (m, 3, 2): edges of the cone at rest, in slip+ and in slip-.


@kernel
def _write_friction(contacts: ContactRows, island: Island, a: int, way: int) -> None:
    """Write the friction of contact a that rests or slips this `way`."""
    island.ways[a], at = way, 0
    if way not in (0, ON_TRIAL):
        at = 1 if way > 0 else 2
    put(island.frictions[a, at], contacts.cones[a])
    law_of(contacts.own[a], slope(contacts.cones[a]), contacts.laws[a])


@kernel
def change_friction(contacts: ContactRows, island: Island, resting: float, struck: bool) -> bool:
    """Change the friction of contacts whose slip begins or turns; return whether there are.

    A slip that would turn in the step stops if static friction bears what would hold it over the
    whole step; in an impact kinetic friction stops or turns it. What static friction does not hold
    slips under kinetic friction: what slipped before the step first, then one by one the most
    overloaded, as each relieves the others. Each contact changes three times at most.

    Parameters
    ----------
    resting : float
        What slipped no faster before the step was at rest.
    struck : bool
        Whether a contact of the island is struck.
    """
    ways, first, most, way, changes = island.ways, -1, 0.0, 0, False
    for a in range(len(ways)):
        old, slip, normal = ways[a], island.after[a, 1], island.chosen[a, 0]
        judged = island.kinds[a] != ONE and abs(old) != BEGINS and normal > 0.0
        if not judged or slip == 0.0 or (abs(old) == 1 and slip * old > 0.0):
            continue
        turned = BEGINS if slip > 0.0 else -BEGINS
        if abs(old) == 1:
            changes = True
            if not struck:
                _write_friction(contacts, island, a, ON_TRIAL)
                island.wanted[a, 1] -= island.start[a, 1]
            else:
                _write_friction(contacts, island, a, turned if island.kinds[a] == TWO else 0)
            continue
        load = overload(slip, contacts.own[a, 1], normal, contacts.cones[a])
        if abs(island.start[a, 1]) > resting:
            load = math.inf
        if load > most:
            first, most, way = a, load, turned
    if changes:
        return True
    for a in range(len(ways)):
        if ways[a] == ON_TRIAL and first in (a, -1):
            ways[a], changes = 0, True
            island.wanted[a, 1] += island.start[a, 1]
    if first >= 0:
        _write_friction(contacts, island, first, way)
    return changes or first >= 0


@kernel
def new_island(members: Ints, start: Array, unforced: Array, wanted: Array) -> Island:
    """Return an island that is solved from nothing, with one friction that holds everywhere."""
    m = len(members)
    return Island(
        members, start, unforced, wanted, np.empty((m, 2)), np.zeros((m, 2)), np.empty((m, 2)),
        np.zeros((m, 2)), np.zeros(m, np.bool_), np.zeros(m, np.bool_), np.zeros(m, np.int64),
        np.zeros(m, np.int64), np.empty((m, 3, 2)),
    )  # fmt: skip


@kernel
def order_matters(contacts: ContactRows, pairs: Ints, lively: Bools, impulses: Array) -> bool:
    """Return whether lively impacts of different pairs of bodies (m,) change each other."""
    rates = rates_of(contacts, 0)
    for a in range(len(pairs)):
        if not lively[a]:
            continue
        add(contacts, a, impulses[a, 0], impulses[a, 1], rates)
        for b in range(len(pairs)):
            if not lively[b] or pairs[a] == pairs[b]:
                continue
            for d in range(2 if slope(contacts.cones[b]) > 0.0 else 1):
                own = abs(contacts.own[b, d] * impulses[b, 0])
                if abs(along(contacts, b, d, rates)) > _NEGLIGIBLE_CHANGE * own:
                    return True
        without(contacts, a, rates)
    return False


@kernel
def allowed_beside(allowed: float, slow: float, fast: float) -> float:
    """Return a residual for what approaches slower than others in a step.

    It is found no nearer, as velocities, than the impulses of the step are.
    """
    return min(allowed * fast / slow, max(allowed, _NEAR)) if slow > 0.0 else allowed


@kernel
def forces_beside_impacts(
    contacts: ContactRows, hit: Bools, least: Array, impulses: Array, allowed: float, fast: float
) -> Array:
    """Return what of impulses is force: those without what is struck.

    Parameters
    ----------
    contacts : ContactRows
    hit : (m,) array of bool
    least : (m, 2)
        Velocities without impulses, plus what is missing of them.
    impulses : (m, 2)
        Where to start.
    allowed : float
        Residual.
    fast : float
        The `scale` of all contacts.
    """
    forces, others = np.zeros((len(hit), 2)), indices(~hit)
    if len(others) > 0:
        quiet, alone, left = rows_of(contacts, others), impulses[others], least[others]
        near = allowed_beside(allowed, scale(quiet, left), fast)
        solve_rows(quiet, left, alone, near, False, True)
        for a in range(len(others)):
            put(alone[a], forces[others[a]])
    return forces


@kernel
def coordinate_rows(jacobians: Array, columns: Array, pads: Array, cones: Array) -> ContactRows:
    """Return contacts that move the same coordinates as rows.

    Parameters
    ----------
    jacobians : (m, 2, n)
        Normal and tangential.
    columns : (2 m, s)
        Changes of all rates by unit impulses: of the coordinates the first n.
    pads : (m,)
        Compliance of what the normal row of a compliant contact or a coupling moves besides; 0:
        nothing.
    cones : (m, 2)
    """
    count, n = len(jacobians), jacobians.shape[2]
    soft = n
    for a in range(count):
        soft += 1 if pads[a] > 0.0 else 0
    threes, soft = (soft + 2) // 3, n
    contacts = ContactRows(
        np.empty((count, threes), np.int64), threes, np.zeros((count, 2, 3 * threes)),
        np.zeros((count, 2, 3 * threes)), np.empty((count, 3)), cones, np.empty((count, LAW)),
        np.empty((3, 3 * threes + 3)), np.empty((7, count, 2)), 1, 0,
    )  # fmt: skip
    for a in range(count):
        for side in range(threes):
            contacts.bodies[a, side] = side
        for d in range(2):
            for j in range(n):
                contacts.rows[a, d, j] = jacobians[a, d, j]
                contacts.columns[a, d, j] = columns[2 * a + d, j]
        if pads[a] > 0.0:
            contacts.rows[a, 0, soft], contacts.columns[a, 0, soft] = 1.0, pads[a]
            soft += 1
    complete(contacts)
    return contacts


@kernel
def write_velocities(contacts: ContactRows, least: Array, impulses: Array, after: Array) -> None:
    """Write the velocities (m, 2) in coordinates under impulses, 0 for round-off of their terms."""
    for a in range(len(least)):
        for d in range(2):
            after[a, d], terms = least[a, d], abs(least[a, d])
            for b in range(len(least)):
                for e in range(2):
                    term = 0.0
                    for k in range(contacts.rows.shape[2]):
                        term += contacts.rows[a, d, k] * contacts.columns[b, e, k]
                    term *= impulses[b, e]
                    after[a, d] += term
                    terms += abs(term)
            if abs(after[a, d]) <= SUM_ROUNDING * terms:
                after[a, d] = 0.0


@kernel
def coordinate_impulses(
    contacts: ContactRows, island: Island, allowed: float
) -> tuple[float, bool]:
    """Find impulses in coordinates, in place; return their residual, and whether none rebounds.

    Impulses that miss more than is allowed are reduced until they add no energy.
    """
    before, free, impulses, least = island.start, island.unforced, island.chosen, island.least
    size = 0.0
    for a in range(len(free)):
        size = max(size, largest_size(free[a]), largest_size(before[a]))
    for a in range(len(free)):
        for d in range(2):
            least[a, d] = free[a, d] + island.wanted[a, d]
            if abs(least[a, d]) <= _ROUNDING * size:
                least[a, d] = 0.0
    missed, _, softened = island_impulses(
        contacts, before, free, least - free, island.rebounds, impulses, allowed, math.inf, False
    )
    share = 1.0 if missed <= allowed else work_share(contacts, impulses, before, free, 0.0)
    for a in range(len(free)):
        # An impulse that changes a velocity by round-off is none.
        normal, tangential = share * impulses[a, 0], share * impulses[a, 1]
        normal = normal if contacts.own[a, 0] * normal > _ROUNDING * size else 0.0
        shears = contacts.own[a, 1] * abs(tangential) > _ROUNDING * size
        edge = slope(contacts.cones[a]) * normal
        impulses[a, 0] = normal
        impulses[a, 1] = min(max(tangential, -edge), edge) if shears else 0.0
    write_velocities(contacts, least, impulses, island.after)
    return missed, softened


def smoothed(cones: Array) -> Array:
    """Return edges of cones (m, 2), without friction that is rounding of the normal impulses."""
    result = cones.copy()
    result[cones[:, 1] <= _ROUNDING * cones[:, 0], 1] = 0.0
    return result


@kernel
def part_left(push: Array, force: Array, cone: Array) -> float:
    """Return the largest part of `force`, up to 1, without which `push` is still in its cone."""
    part = 1.0
    # Of what slides both are on the edge, but for rounding.
    rounding = _ROUNDING * (abs(push[0]) + abs(push[1]) + (abs(force[0]) + abs(force[1])))
    for side in (-1.0, 1.0):
        whole = max(cone[1] * push[0] + side * cone[0] * push[1], 0.0)
        taken = cone[1] * force[0] + side * cone[0] * force[1]
        if taken > whole + rounding:
            part = min(part, whole / taken)
    # Without friction both edges are one, and say nothing.
    whole = max(push[0], 0.0)
    if force[0] > whole + rounding:
        part = min(part, whole / force[0])
    return part


@kernel
def into_cone(impulse: Array, cone: Array) -> Array:
    """Return an impulse that is in its cone but for rounding, without that."""
    result = impulse.copy()
    result[0] = max(impulse[0], 0.0)
    if cone[0] > 0.0:
        edge = cone[1] / cone[0] * result[0]
        result[1] = min(max(impulse[1], -edge), edge)
    return result


@kernel
def is_sliding(cone: Array, impulse: Array, slip: float) -> bool:
    """Return whether a contact slips, and its impulse is on the edge of its cone.

    What rolls without a load slips by round-off of nothing.
    """
    return slip != 0.0 and abs(impulse[1]) >= (1.0 - SUM_ROUNDING) * slope(cone) * impulse[0]
