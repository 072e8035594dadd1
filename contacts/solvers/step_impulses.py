"""Impulses of one time step: of impacts and of contacts that last, and which of them are forces."""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_lcp_kernels import (
    LOOSEST,
    ROUNDING,
    UNKNOWNS,
    impulses_of,
    pivots,
    problem,
    solve_contacts,
    step_residual,
)
from contacts.solvers.saddle_point import largest_size
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices, put
from statechart.kernels.jit import kernel

LONGEST_SEQUENCE = 10_000
"""So many impacts follow each other at an instant: a ball between the floor and one a thousand
times as heavy is hit so often."""

# Of the terms of a work: what it is known to.
_WORK_ROUNDING = 64.0 * 2.0**-52

AS_ASKED, SOFTENED, AS_GIVEN = range(3)
"""What is asked of the impulses of a step: that contacts part as they should; that none parts; and
nothing, where no impulses were found that do even that: the best ones are taken."""


@kernel
def _without_rounding(velocities: Array, size: float) -> None:
    """Set to zero what is rounding of velocities as large as `size`."""
    for i in range(len(velocities)):
        for d in range(2):
            if abs(velocities[i, d]) <= ROUNDING * size:
                velocities[i, d] = 0.0


@kernel
def _known(
    delassus: Array, free: Array, cones: Array, guess: Bools, limit: int, given: Array
) -> tuple[bool, Array, Bools]:
    """Return what `solve_contacts` does, where `given` holds no solution of the problem."""
    size = UNKNOWNS * len(cones)
    if len(given) >= size:
        # Whose solution is which, the residual tells.
        matrix, vector = problem(delassus, free, cones, np.zeros(len(cones)))
        for first in range(0, len(given) - size + 1, UNKNOWNS):
            z = given[first : first + size].copy()
            if step_residual(matrix, vector, z) <= LOOSEST:
                return True, z, z > 0.0
    return solve_contacts(delassus, free, cones, guess, limit)


@kernel
def solve_impacts(
    delassus: Array,
    groups: Ints,
    before: Array,
    free: Array,
    wanted: Array,
    cones: Array,
    rebounds: Bools,
    guess: Bools,
    given: Array,
    how: int,
) -> tuple[bool, Array, Bools, Array, Array]:
    """Return (solved, z, basis, impulses, least velocities) of the contacts of a step.

    Where it is not solved, the velocities are those of the problem that was not. Restitution that
    would add energy to a group of contacts is reduced in it. Where contacts oppose each other there
    need be no impulses that make all of them part as they should: `SOFTENED`, none is asked to
    part. Then rest is allowed, and there are some (Anitescu and Potra 1997). Where they are not
    found the impulses given are taken `AS_GIVEN`, but for what would add energy.

    Parameters
    ----------
    delassus : (2 m, 2 m)
    groups : (m,) array of int
        Labels; see `contacts.solvers.impulse_coupling`.
    before, free : (m, 2)
        Velocities before the step, and after it without impulses.
    wanted : (m, 2)
        What these may not fall below, negated.
    cones : (m, 2)
    rebounds : (m,) array of bool
        Whose `wanted` is that of restitution.
    guess : (4 m,) array of bool
    given : (k,)
        Solutions of problems that `solve_contacts` did not solve.
    how : int
        `AS_ASKED`, `SOFTENED` or `AS_GIVEN`.
    """
    limit = pivots(len(cones))
    least, size = free + wanted, 0.0
    soft = least.copy()
    for a in range(len(cones)):
        size = max(size, largest_size(free[a]), largest_size(before[a]))
        if how != AS_ASKED:
            soft[a, 0] = free[a, 0] + max(wanted[a, 0], 0.0)
        elif rebounds[a]:
            soft[a, 0] = free[a, 0]
    _without_rounding(least, size)
    _without_rounding(soft, size)
    if how == AS_GIVEN:
        best = impulses_of(given)
        share = part_within(best, before, free, moved_by(delassus, best), 0.0)
        return True, given, given > 0.0, share * best, soft
    if how == SOFTENED:
        good, z, basis = _known(delassus, soft, cones, guess, limit, given)
        return good, z, basis, impulses_of(z), soft
    good, z, basis = _known(delassus, least, cones, guess, limit, given)
    pushes = impulses_of(z)
    if good and rebounds.any():
        # Without it nobody knows how much energy restitution may give back.
        calm, plastic, _ = _known(delassus, soft, cones, guess, limit, given)
        if not calm:
            return False, z, basis, pushes, soft
        _cap(delassus, groups, before, free, rebounds, impulses_of(plastic), pushes)
    return good, z, basis, pushes, least


@kernel
def _cap(
    delassus: Array, groups: Ints, before: Array, free: Array, rebounds: Bools, rest: Array,
    pushes: Array,
) -> None:  # fmt: skip
    """Reduce impulses that rebound, in place, group by group: see `capped`."""
    full = pushes.copy()
    slower, faster = moved_by(delassus, rest), moved_by(delassus, full)
    for label in range(len(groups)):
        group = groups == label
        if (rebounds & group).any():
            own = indices(group)
            found, _ = capped(
                before[own], free[own], rest[own], full[own], slower[own], faster[own], 0.0
            )
            for a in range(len(own)):
                put(found[a], pushes[own[a]])


def smoothed(cones: Array) -> Array:
    """Return edges of cones (m, 2), without friction that is rounding of the normal impulses."""
    result = cones.copy()
    result[cones[:, 1] <= ROUNDING * cones[:, 0], 1] = 0.0
    return result


@kernel
def _work_at(before: Array, free: Array, impulses: Array, moved: Array) -> float:
    """Return the work of impulses that change the velocities of the contacts by `moved`."""
    # In the place of sums and products of whole arrays, which take seconds to compile.
    work = 0.0
    for i in range(len(impulses)):
        for d in range(2):
            work += impulses[i, d] * (before[i, d] + free[i, d] + moved[i, d])
    return 0.5 * work


@kernel
def _velocity_scale(before: Array, free: Array, impulses: Array) -> float:
    """Return the sizes of what the work of impulses is summed from."""
    begin = end = 0.0
    for i in range(len(impulses)):
        for d in range(2):
            begin += abs(impulses[i, d] * before[i, d])
            end += abs(impulses[i, d] * free[i, d])
    return begin + end


@kernel
def moved_by(delassus: Array, impulses: Array) -> Array:
    """Return the changes (m, 2) of the contacts' velocities under impulses (m, 2)."""
    flat = impulses.ravel()
    moved = np.zeros(len(flat))
    for i in range(len(flat)):
        for j in range(len(flat)):
            moved[i] += delassus[i, j] * flat[j]
    return moved.reshape(impulses.shape)


@kernel
def shares(begin: float, end: float, curvature: float) -> tuple[float, float]:
    """Return (1 - s, s) for the largest s, up to 1, at which a work is not above zero.

    Both are computed from the end they are near: impulses may differ by decades.
    """
    slope = end - begin - curvature
    root = math.sqrt(max(slope * slope - 4.0 * curvature * begin, 0.0))
    share = (root - slope) / (2.0 * curvature) if slope < 0.0 else -2.0 * begin / (slope + root)
    rest = 2.0 * end / (2.0 * curvature + slope + root)
    return min(max(rest, 0.0), 1.0), min(max(share, 0.0), 1.0)


@kernel
def part_within(impulses: Array, before: Array, free: Array, moved: Array, bound: float) -> float:
    """Return the largest part of impulses (m, 2), up to 1, whose work is within a bound.

    Parameters
    ----------
    impulses : (m, 2)
    before, free, moved : (m, 2)
        See `capped`.
    bound : float
        Not below zero.
    """
    curvature = 0.0
    for i in range(len(impulses)):
        for d in range(2):
            curvature += impulses[i, d] * moved[i, d]
    curvature *= 0.5
    end = _work_at(before, free, impulses, moved)
    limit = bound + _WORK_ROUNDING * _velocity_scale(before, free, impulses)
    return shares(-limit, end - limit, curvature)[1] if end > limit else 1.0


@kernel
def capped(
    before: Array,
    free: Array,
    plastic: Array,
    elastic: Array,
    moved_plastic: Array,
    moved_elastic: Array,
    bound: float,
) -> tuple[Array, float]:
    """Return impulses between plastic and elastic, and the share of the way, that add no energy.

    The work of impulses on the bodies in a step is ``P (U+ + U-) / 2``, a convex function of the
    share; the largest share is taken at which it is not above that of the plastic ones, or a bound.

    Parameters
    ----------
    before, free : (m, 2)
        Velocities of the contacts before the step, and after it without impulses.
    plastic, elastic, moved_plastic, moved_elastic : (m, 2)
        Impulses, and how they change these velocities.
    bound : float
        Not below zero.
    """
    begin = _work_at(before, free, plastic, moved_plastic)
    end = _work_at(before, free, elastic, moved_elastic)
    limit = max(begin, bound) + _WORK_ROUNDING * _velocity_scale(before, free, elastic)
    if end <= limit:
        return elastic, 1.0
    curvature, chosen = 0.0, np.empty((len(elastic), 2))
    for i in range(len(elastic)):
        for d in range(2):
            further = elastic[i, d] - plastic[i, d]
            curvature += further * (moved_elastic[i, d] - moved_plastic[i, d])
    _, share = shares(begin - limit, end - limit, 0.5 * curvature)
    for i in range(len(elastic)):
        for d in range(2):
            chosen[i, d] = plastic[i, d] + share * (elastic[i, d] - plastic[i, d])
    return chosen, share


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
    rounding = ROUNDING * (abs(push[0]) + abs(push[1]) + (abs(force[0]) + abs(force[1])))
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
def steady_impulses(
    delassus: Array, least: Array, cones: Array, z: Array, pushes: Array, sudden: Bools
) -> tuple[Array, Bools]:
    """Return the impulses (m, 2) of a step that are forces, and who slides under them.

    They are those that there would be without the contacts that something strikes at an instant.
    """
    m = len(cones)
    if not sudden.any():
        return pushes, z[3::UNKNOWNS] > 0.0
    steady, slides = np.zeros((m, 2)), np.zeros(m, np.bool_)
    others = indices(~sudden)
    count = len(others)
    if count:
        felt = np.empty((2 * count, 2 * count))
        for i in range(2 * count):
            for k in range(2 * count):
                felt[i, k] = delassus[2 * others[i // 2] + i % 2, 2 * others[k // 2] + k % 2]
        nothing = np.zeros(UNKNOWNS * count, np.bool_)
        good, alone, _ = solve_contacts(felt, least[others], cones[others], nothing, pivots(count))
        if good:
            forces = impulses_of(alone)
            for a in range(count):
                put(forces[a], steady[others[a]])
                slides[others[a]] = alone[UNKNOWNS * a + 3] > 0.0
    return steady, slides


@kernel
def relieve(
    groups: Ints,
    cones: Array,
    z: Array,
    pushes: Array,
    sudden: Bools,
    steady: Array,
    slides: Bools,
) -> None:
    """Take from forces (m, 2), in place, what leaves no impulse of the impacts in its cone.

    An impact takes off a contact no more than what that bears; what feels none bears forces alone.
    """
    for a in range(len(cones)):
        if not of_group(sudden, groups, groups[a]):
            put(pushes[a], steady[a])
            slides[a] = z[UNKNOWNS * a + 3] > 0.0
        elif not sudden[a]:
            left = _part_left(pushes[a], steady[a], cones[a])
            steady[a, 0] *= left
            steady[a, 1] *= left
