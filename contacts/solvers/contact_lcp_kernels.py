"""The contact problem of one time step, compiled once: guessed from the last step, else Lemke.

Every solution is judged by its residual; what is not solved here is left to
`contacts.solvers.lcp`, which tries more ways.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from contacts.solvers.lemke import FOUND, lemke, on_support
from statechart.arrays import Array, Bools
from statechart.kernels.jit import kernel

STEEPEST = 2.0**-12
"""No cone's edge is steeper: its normal part, of 1, counts as at least this."""

UNKNOWNS = 4
"""Of a contact: normal impulse, tangential one to either side, slip speed."""

RESIDUAL = 1e-8
"""A solution is taken when no row misses by more than this of its terms."""

LOOSEST = 1e-6
"""What is allowed where contacts are so nearly redundant that no way comes closer."""

# Unknowns below this part of the largest of their kind are rounding.
_ROUNDING = 1e-13
# A guess is improved so many times before Lemke's algorithm starts from nothing.
_GUESSES = 8
# What makes bases regular, relative to scaled rows; and how often.
_DELTA, _PROXIMAL_STEPS = 2.0**-16, 12


@kernel
def problem(delassus: Array, free: Array, cones: Array, slides: Array) -> tuple[Array, Array]:
    """Return (M, q) of planar contacts with friction (Stewart and Trinkle 1996).

    Friction enters by the unit edge of its cone, so that mu = 0 and large mu are ordinary numbers;
    at mu = inf a tangential impulse without a normal one would hold no contact closed, so that
    cones end at `STEEPEST`. A contact without friction, and one that slips, keeps its four
    unknowns, with rows that hold by themselves.

    Parameters
    ----------
    delassus : (2 c, 2 c) array
        Velocities of the contacts (normal, tangential, normal, ...) per unit impulses.
    free : (c, 2) array
        What these velocities would be without impulses; the normal ones plus e times the speed
        of approach where contacts rebound.
    cones : (c, 2) array
        ``(cone_n, cone_t)``, with ``mu = cone_t / cone_n``.
    slides : (c,) array
        For accelerations and forces: -1 or 1 where the contact slips already, in that direction,
        and its only unknown is the force along the edge against it; 0 elsewhere.
    """
    count = len(cones)
    matrix = np.zeros((UNKNOWNS * count, UNKNOWNS * count))
    vector = np.zeros(UNKNOWNS * count)
    rough = (cones[:, 1] > 0.0) & (slides == 0.0)
    for i in range(count):
        a = UNKNOWNS * i
        vector[a] = free[i, 0]
        for k in range(count):
            b = UNKNOWNS * k
            normal, tangential = delassus[2 * i, 2 * k], delassus[2 * i, 2 * k + 1]
            along, across = delassus[2 * i + 1, 2 * k], delassus[2 * i + 1, 2 * k + 1]
            if slides[k] != 0.0:
                normal = normal * cones[k, 0] - tangential * slides[k] * cones[k, 1]
                along = along * cones[k, 0] - across * slides[k] * cones[k, 1]
            matrix[a, b] = normal
            if rough[k]:
                matrix[a, b + 1], matrix[a, b + 2] = tangential, -tangential
            if rough[i]:
                matrix[a + 1, b], matrix[a + 2, b] = along, -along
            if rough[i] and rough[k]:
                matrix[a + 1, b + 1], matrix[a + 1, b + 2] = across, -across
                matrix[a + 2, b + 1], matrix[a + 2, b + 2] = -across, across
        if rough[i]:
            vector[a + 1], vector[a + 2] = free[i, 1], -free[i, 1]
            matrix[a + 1, a + 3] = matrix[a + 2, a + 3] = 1.0
            matrix[a + 3, a] = cones[i, 1]
            matrix[a + 3, a + 1] = matrix[a + 3, a + 2] = -max(cones[i, 0], STEEPEST)
        else:
            matrix[a + 1, a + 1] = matrix[a + 2, a + 2] = matrix[a + 3, a + 3] = 1.0
    return matrix, vector


@kernel
def step_residual(matrix: Array, vector: Array, z: Array) -> float:
    """Return the largest violation of a row, relative to its terms.

    Terms that are rounding of those in other rows of the kind (velocities, cones) do not count.
    """
    size = len(vector)
    w, terms = np.empty(size), np.empty(size)
    largest = np.zeros(2)
    for i in range(size):
        total, sizes = vector[i], abs(vector[i])
        for j in range(size):
            if z[j] != 0.0:
                term = matrix[i, j] * z[j]
                total += term
                sizes += abs(term)
        if not math.isfinite(total):
            return math.inf
        w[i], terms[i] = total, sizes
        kind = 1 if i % UNKNOWNS == 3 else 0
        largest[kind] = max(largest[kind], sizes)
    worst = 0.0
    for i in range(size):
        missed = abs(w[i]) if z[i] > 0.0 else -w[i]
        kind = 1 if i % UNKNOWNS == 3 else 0
        floor = max(terms[i], 1e-3 * _ROUNDING / RESIDUAL * largest[kind])
        if missed > worst * floor:
            worst = missed / floor
    return worst


@kernel
def _settled(z: Array) -> Array:
    """Return z without what is rounding: of impulses, and of slip speeds."""
    largest = np.zeros(2)
    for i in range(len(z)):
        kind = 1 if i % UNKNOWNS == 3 else 0
        largest[kind] = max(largest[kind], abs(z[i]))
    result = z.copy()
    for i in range(len(z)):
        if abs(z[i]) <= _ROUNDING * largest[1 if i % UNKNOWNS == 3 else 0]:
            result[i] = 0.0
    return result


@kernel
def _scales(matrix: Array) -> Array:
    """Return powers of two that make what depends on units near 1: impulses, and slip speeds.

    The same factor on row and column keeps copositivity, on which Lemke's guarantee rests.
    """
    scales = np.ones(len(matrix))
    for i in range(len(matrix)):
        if matrix[i, i] > 0.0:
            scales[i] = math.ldexp(1.0, -round(0.5 * math.log2(matrix[i, i])))
        elif i % UNKNOWNS == 3:
            scales[i] = 1.0 / scales[i - 1]
    return scales


@kernel
def _improved(matrix: Array, vector: Array, guess: Bools) -> tuple[bool, bool, Array, Bools]:
    """Improve a basis until it solves the problem; return (solved, regular, z, basis)."""
    size = len(vector)
    basis = guess.copy()
    z = np.zeros(size)
    for _ in range(_GUESSES):
        regular, z = on_support(matrix, vector, basis)
        if not regular:
            return False, False, z, basis
        z = _settled(z)
        changed = False
        following = basis.copy()
        for i in range(size):
            if basis[i]:
                if z[i] < 0.0:
                    following[i] = False
                    changed = True
            else:
                w = vector[i]
                terms = abs(w)
                for j in range(size):
                    w += matrix[i, j] * z[j]
                    terms += abs(matrix[i, j] * z[j])
                if w < -RESIDUAL * terms:
                    following[i] = True
                    changed = True
        if not changed:
            return True, True, z, basis
        basis = following
    return False, True, z, basis


@kernel
def _by_lemke(matrix: Array, vector: Array, limit: int) -> tuple[bool, Array]:
    size = len(vector)
    right = vector / max(np.abs(vector).max(), 1e-300)
    outcome, _, basis = lemke(matrix, right, np.ones(size), limit)
    if outcome != FOUND:
        return False, np.zeros(size)
    regular, z = on_support(matrix, vector, basis)
    return regular, np.maximum(_settled(z), 0.0)


@kernel
def _proximal(matrix: Array, vector: Array, guess: Bools, limit: int) -> tuple[bool, Array]:
    """Solve with delta (z - z_before) added to w, until it comes no closer (Rockafellar 1976).

    Contacts that stand in for each other make bases singular; with what is added none is. Along
    what does not matter z then moves by rounding for ever: that it solves is told by its residual.
    """
    size = len(vector)
    regular = matrix.copy()
    for i in range(size):
        regular[i, i] += _DELTA
    z, basis, best = np.zeros(size), guess, math.inf
    for _ in range(_PROXIMAL_STEPS):
        moved = vector - _DELTA * z
        solved, _, new, found = _improved(regular, moved, basis)
        if solved:
            basis = found
        else:
            solved, new = _by_lemke(regular, moved, limit)
            basis = new > 0.0
        left = step_residual(matrix, vector, new) if solved else math.inf
        if left >= best or not solved:
            break
        z, best = new, left
        if best <= _ROUNDING:
            break
    return best <= RESIDUAL, z


@kernel
def solve_contacts(
    delassus: Array, free: Array, cones: Array, guess: Bools, limit: int
) -> tuple[bool, Array, Bools]:
    """Return (solved, z, basis) of the contacts' complementarity problem.

    The guess is improved; what that does not solve Lemke's algorithm does, or, where bases are
    singular, a sequence of regular problems. A solution is one by its residual.

    Parameters
    ----------
    delassus : (2 m, 2 m), free : (m, 2), cones : (m, 2)
        See `problem`.
    guess : (4 m,) array of bool
        Which unknowns may be positive, as of the step before.
    limit : int
        Pivots allowed.
    """
    size = UNKNOWNS * len(cones)
    z = np.zeros(size)
    parting = True
    for i in range(len(cones)):
        z[UNKNOWNS * i + 3] = abs(free[i, 1])
        parting = parting and free[i, 0] >= 0.0
    if parting:
        return True, z, np.zeros(size, np.bool_)
    matrix, vector = problem(delassus, free, cones, np.zeros(len(cones)))
    scales = _scales(matrix)
    scaled, right = np.empty((size, size)), scales * vector
    for i in range(size):
        for j in range(size):
            scaled[i, j] = scales[i] * matrix[i, j] * scales[j]
    solved, regular, y, basis = _improved(scaled, right, guess)
    for attempt in range(3):
        if attempt > 0:
            if (attempt == 1) == regular:
                solved, y = _by_lemke(scaled, right, limit)
            else:
                solved, y = _proximal(scaled, right, guess, limit)
            basis = y > 0.0
        if solved:
            z = scales * y
            if step_residual(matrix, vector, z) <= RESIDUAL:
                return True, z, basis
    return False, np.zeros(size), basis


@kernel
def _without_rounding(velocities: Array, size: float) -> None:
    """Set to zero what is rounding of velocities as large as `size`."""
    for i in range(len(velocities)):
        for d in range(2):
            if abs(velocities[i, d]) <= _ROUNDING * size:
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
def coupled_contacts(delassus: Array) -> NDArray[np.int64]:
    """Label the contacts (m,): those with one label feel each other's impulses."""
    m = len(delassus) // 2
    labels = np.arange(m)
    for i in range(m):
        for k in range(i):
            if (
                labels[i] != labels[k]
                and (delassus[2 * i : 2 * i + 2, 2 * k : 2 * k + 2] != 0).any()
            ):
                old, new = labels[i], labels[k]
                for a in range(m):
                    if labels[a] == old:
                        labels[a] = new
    return labels


@kernel
def solve_impacts(
    delassus: Array,
    groups: NDArray[np.int64],
    before: Array,
    free: Array,
    wanted: Array,
    cones: Array,
    rebounds: Bools,
    guess: Bools,
    given: Array,
    softened: bool,
) -> tuple[bool, Array, Bools, Array, Array]:
    """Return (solved, z, basis, impulses, least velocities) of the contacts of a step.

    Where it is not solved, the velocities are those of the problem that was not. Restitution that
    would add energy to a group of contacts is reduced in it. Where contacts oppose each other there
    need be no impulses that make all of them part as they should: `softened`, none is asked to
    part. Then rest is allowed, and there are some (Anitescu and Potra 1997).

    Parameters
    ----------
    delassus : (2 m, 2 m)
    groups : (m,) array of int
        Labels of `coupled_contacts`.
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
    softened : bool
    """
    limit = pivots(len(cones))
    least = free + wanted
    soft = least.copy()
    for a in range(len(cones)):
        if softened:
            soft[a, 0] = free[a, 0] + max(wanted[a, 0], 0.0)
        elif rebounds[a]:
            soft[a, 0] = free[a, 0]
    size = max(np.abs(free).max(), np.abs(before).max())
    _without_rounding(least, size)
    _without_rounding(soft, size)
    if softened:
        good, z, basis = _known(delassus, soft, cones, guess, limit, given)
        return good, z, basis, impulses_of(z), soft
    good, z, basis = _known(delassus, least, cones, guess, limit, given)
    pushes = impulses_of(z)
    if good and rebounds.any():
        # Without it nobody knows how much energy restitution may give back.
        calm, plastic, _ = _known(delassus, soft, cones, guess, limit, given)
        if not calm:
            return False, z, basis, pushes, soft
        rest, full = impulses_of(plastic), pushes.copy()
        slower, faster = moved_by(delassus, rest), moved_by(delassus, full)
        for label in range(len(cones)):
            group = groups == label
            if (rebounds & group).any():
                own = np.nonzero(group)[0]
                pushes[own], _ = capped(
                    before[own], free[own], rest[own], full[own], slower[own], faster[own]
                )
    return good, z, basis, pushes, least


@kernel
def impulses_of(z: Array) -> Array:
    """Return the impulses (m, 2) of a solution."""
    count = len(z) // UNKNOWNS
    impulses = np.empty((count, 2))
    for i in range(count):
        impulses[i, 0] = z[UNKNOWNS * i]
        impulses[i, 1] = z[UNKNOWNS * i + 1] - z[UNKNOWNS * i + 2]
    return impulses


def smoothed(cones: Array) -> Array:
    """Return edges of cones (m, 2), without friction that is rounding of the normal impulses."""
    result = cones.copy()
    result[cones[:, 1] <= _ROUNDING * cones[:, 0], 1] = 0.0
    return result


@kernel
def _work_at(before: Array, free: Array, impulses: Array, moved: Array) -> float:
    """Return the work of impulses that change the velocities of the contacts by `moved`."""
    return 0.5 * (impulses * (before + free + moved)).sum()


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

    Parameters
    ----------
    begin, end : float
        The work at s = 0, not above zero, and at s = 1, above zero.
    curvature : float
        Half its second derivative by s, not below zero but for rounding.
    """
    slope = end - begin - curvature
    root = math.sqrt(max(slope * slope - 4.0 * curvature * begin, 0.0))
    share = (root - slope) / (2.0 * curvature) if slope < 0.0 else -2.0 * begin / (slope + root)
    rest = 2.0 * end / (2.0 * curvature + slope + root)
    return min(max(rest, 0.0), 1.0), min(max(share, 0.0), 1.0)


@kernel
def capped(
    before: Array,
    free: Array,
    plastic: Array,
    elastic: Array,
    moved_plastic: Array,
    moved_elastic: Array,
) -> tuple[Array, float]:
    """Return impulses between plastic and elastic, and the share of the way, that add no energy.

    The work of impulses on the bodies in a step is ``P (U+ + U-) / 2``, a convex function of the
    share; the largest share is taken at which it is not above that of the plastic ones, or zero.

    Parameters
    ----------
    before, free : (m, 2)
        Velocities of the contacts before the step, and after it without impulses.
    plastic, elastic, moved_plastic, moved_elastic : (m, 2)
        Impulses, and how they change these velocities.
    """
    begin = _work_at(before, free, plastic, moved_plastic)
    end = _work_at(before, free, elastic, moved_elastic)
    sizes = np.abs(elastic * before).sum() + np.abs(elastic * free).sum()
    limit = max(begin, 0.0) + 64.0 * 2.0**-52 * sizes
    if end <= limit:
        return elastic, 1.0
    further = elastic - plastic
    curvature = 0.5 * (further * (moved_elastic - moved_plastic)).sum()
    _, share = shares(begin - limit, end - limit, curvature)
    return plastic + share * further, share


@kernel
def _part_left(push: Array, force: Array, cone: Array) -> float:
    """Return the largest part of `force`, up to 1, without which `push` is still in its cone."""
    part = 1.0
    # Of what slides both are on the edge, but for rounding.
    rounding = _ROUNDING * (np.abs(push).sum() + np.abs(force).sum())
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
    others = np.nonzero(~sudden)[0]
    if len(others):
        both = np.empty(2 * len(others), np.int64)
        both[::2], both[1::2] = 2 * others, 2 * others + 1
        nothing = np.zeros(UNKNOWNS * len(others), np.bool_)
        good, alone, _ = solve_contacts(
            delassus[both][:, both], least[others], cones[others], nothing, pivots(len(others))
        )
        if good:
            steady[others] = impulses_of(alone)
            slides[others] = alone[3::UNKNOWNS] > 0.0
    return steady, slides


@kernel
def relieve(
    groups: NDArray[np.int64],
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
        if not (sudden & (groups == groups[a])).any():
            steady[a], slides[a] = pushes[a], z[UNKNOWNS * a + 3] > 0.0
        elif not sudden[a]:
            steady[a] *= _part_left(pushes[a], steady[a], cones[a])


@kernel
def pivots(contacts: int) -> int:
    """Return how many pivots are allowed."""
    return 50 + 20 * UNKNOWNS * contacts
