"""Impulses of a step of coordinates, and which of them are forces.

Contacts that feel each other's impulses are an island whose rows are in the coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import LAW, ContactRows, complete, slope
from contacts.solvers.contact_solver import solve_rows
from contacts.solvers.island_impulses import island_impulses, work_share
from contacts.solvers.saddle_point import largest_size
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices, put
from statechart.kernels.jit import kernel

# Velocities and impulses below this part of the largest are round-off; and velocities that are
# sums, below this part of their terms.
_ROUNDING, SUM_ROUNDING = 1e-13, 1e-9


class ContactProblem(NamedTuple):
    """Contacts that take part in a step, by the coordinates that they move."""

    which: Ints  # (m,): numbers of the contacts.
    jacobians: Array  # (m, 2, n): normal and tangential.
    # Changes of all rates, and of the contacts' velocities, by unit impulses.
    columns: Array  # (2 m, s): of the coordinates the first n.
    delassus: Array  # shape (2 m, 2 m)
    groups: Ints  # (m,): equal for those that feel each other's impulses.
    # (m,): direction of the slip whose friction is in `cones`; 0: that at rest; or `ON_TRIAL`.
    directions: Ints
    # (m, 2): edges of cones; velocities before the step, and after it without impulses; what these
    # may not fall below, negated.
    cones: Array
    before: Array
    free: Array
    wanted: Array
    # (m,): who asks for restitution; whose impulse is one at an instant.
    rebounds: Bools
    sudden: Bools
    yields: Bools  # (m,): who is compliant.
    # (m,): whose normal row moves something of its own: `delassus` has it beyond the coordinates.
    apart: Bools


@kernel
def coordinate_rows(problem: ContactProblem, which: Ints) -> ContactRows:
    """Return the rows of the contacts `which`: all of them move the same coordinates.

    The normal row of a compliant contact or of a coupling moves one of its own, too.
    """
    count, n = len(which), problem.jacobians.shape[2]
    soft = n
    for i in which:
        soft += 1 if problem.apart[i] else 0
    threes, soft = (soft + 2) // 3, n
    bodies, cones = np.empty((count, threes), np.int64), np.empty((count, 2))
    rows, columns = np.zeros((count, 2, 3 * threes)), np.zeros((count, 2, 3 * threes))
    for a in range(count):
        i = which[a]
        put(problem.cones[i], cones[a])
        for side in range(threes):
            bodies[a, side] = side
        for d in range(2):
            for j in range(n):
                rows[a, d, j] = problem.jacobians[i, d, j]
                columns[a, d, j] = problem.columns[2 * i + d, j]
        if problem.apart[i]:
            rows[a, 0, soft], columns[a, 0, soft] = 1.0, problem.delassus[2 * i, 2 * i]
            for j in range(n):
                columns[a, 0, soft] -= rows[a, 0, j] * columns[a, 0, j]
            soft += 1
    contacts = ContactRows(
        bodies, threes, rows, columns, np.empty((count, 3)), cones, np.empty((count, LAW)),
        np.empty((3, 3 * threes + 3)), np.empty((7, count, 2)), 1, 0,
    )  # fmt: skip
    complete(contacts)
    return contacts


@kernel
def _without_rounding(velocities: Array, size: float) -> None:
    """Set to zero what is rounding of velocities as large as `size`."""
    for i in range(len(velocities)):
        for d in range(2):
            if abs(velocities[i, d]) <= _ROUNDING * size:
                velocities[i, d] = 0.0


@kernel
def solve_impacts(
    problem: ContactProblem, start: Array, allowed: float
) -> tuple[float, bool, Array, Array]:
    """Return the residual of impulses, whether none rebounds in a group, the impulses, and `least`.

    Parameters
    ----------
    problem : ContactProblem
    start : (m, 2)
        Impulses of the step before.
    allowed : float
        Residual. Impulses that miss more are reduced until they add no energy.

    Returns
    -------
    residual : float
    softened : bool
    impulses : (m, 2)
    least : (m, 2)
        Velocities without impulses, plus what is missing of them, without round-off.
    """
    groups, free, before = problem.groups, problem.free, problem.before
    impulses, least, size = start.copy(), free + problem.wanted, 0.0
    for a in range(len(groups)):
        size = max(size, largest_size(free[a]), largest_size(before[a]))
    _without_rounding(least, size)
    missed, softened = 0.0, False
    for label in range(len(groups)):
        which = indices(groups == label)
        if len(which) == 0:
            continue
        contacts, rebounds = coordinate_rows(problem, which), problem.rebounds
        chosen, was, alone, wanted = impulses, before, free, least - free
        if len(which) < len(groups):
            chosen, was, alone = impulses[which], before[which], free[which]
            wanted, rebounds = wanted[which], rebounds[which]
        left, _, soft = island_impulses(
            contacts, was, alone, wanted, rebounds, chosen, allowed, math.inf, False
        )
        share = 1.0 if left <= allowed else work_share(contacts, chosen, was, alone, 0.0)
        missed, softened = max(missed, left), softened or soft
        for a in range(len(which)):
            # An impulse that changes a velocity by round-off is none.
            normal, tangential = share * chosen[a, 0], share * chosen[a, 1]
            normal = normal if contacts.own[a, 0] * normal > _ROUNDING * size else 0.0
            shears = contacts.own[a, 1] * abs(tangential) > _ROUNDING * size
            edge = slope(contacts.cones[a]) * normal
            impulses[which[a], 0] = normal
            impulses[which[a], 1] = min(max(tangential, -edge), edge) if shears else 0.0
    return missed, softened, impulses, least


def smoothed(cones: Array) -> Array:
    """Return edges of cones (m, 2), without friction that is rounding of the normal impulses."""
    result = cones.copy()
    result[cones[:, 1] <= _ROUNDING * cones[:, 0], 1] = 0.0
    return result


@kernel
def of_group(chosen: Bools, groups: Ints, label: int) -> bool:
    """Return whether one of the chosen contacts (m,) belongs to a group."""
    found = False
    for a in range(len(groups)):
        found = found or (chosen[a] and groups[a] == label)
    return found


@kernel
def _part_left(push: Array, force: Array, cone: Array) -> float:
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
def velocity_after(delassus: Array, least: Array, impulses: Array, a: int, d: int) -> float:
    """Return the velocity of contact `a` along its normal (0) or tangent (1), 0 for round-off."""
    after, terms = least[a, d], abs(least[a, d])
    for b in range(len(impulses)):
        for e in range(2):
            term = delassus[2 * a + d, 2 * b + e] * impulses[b, e]
            after += term
            terms += abs(term)
    return after if abs(after) > SUM_ROUNDING * terms else 0.0


@kernel
def is_sliding(problem: ContactProblem, least: Array, impulses: Array, a: int) -> bool:
    """Return whether contact `a` slips, and its impulse is on the edge of its cone.

    What rolls without a load slips by round-off of nothing.
    """
    edge = slope(problem.cones[a]) * impulses[a, 0]
    on_edge = abs(impulses[a, 1]) >= (1.0 - SUM_ROUNDING) * edge
    return on_edge and velocity_after(problem.delassus, least, impulses, a, 1) != 0.0


@kernel
def steady_impulses(
    problem: ContactProblem, least: Array, pushes: Array, allowed: float
) -> tuple[Array, Bools]:
    """Return the impulses (m, 2) of a step that are forces, and which contacts slide under them.

    They are those that there would be without the contacts that something strikes at an instant.
    An impact takes off a contact no more than what that bears; what feels none bears forces alone.
    """
    m, groups, sudden = len(pushes), problem.groups, problem.sudden
    steady, slides = np.zeros((m, 2)), np.zeros(m, np.bool_)
    others = indices(~sudden)
    if len(others) == m:
        for a in range(m):
            put(pushes[a], steady[a])
    elif len(others) > 0:
        forces = pushes[others]
        solve_rows(coordinate_rows(problem, others), least[others], forces, allowed, False, True)
        for a in range(len(others)):
            put(forces[a], steady[others[a]])
    for a in others:
        if of_group(sudden, groups, groups[a]):
            slides[a] = is_sliding(problem, least, steady, a)
            left = _part_left(pushes[a], steady[a], problem.cones[a])
            steady[a, 0] *= left
            steady[a, 1] *= left
        else:
            put(pushes[a], steady[a])
            slides[a] = is_sliding(problem, least, pushes, a)
    return steady, slides
