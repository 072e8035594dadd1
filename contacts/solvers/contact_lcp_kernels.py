"""The contact problem of one time step, compiled once: guessed from the last step, else Lemke.

Every solution is judged by its residual; what is not solved here is left to
`contacts.solvers.lcp`, which tries more ways.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.lemke import FOUND, lemke, on_support, row_residual
from statechart.arrays import Array, Bools
from statechart.kernels.copies import put
from statechart.kernels.jit import kernel

STEEPEST = 2.0**-12
"""No cone's edge is steeper: its normal part, of 1, counts as at least this."""

UNKNOWNS = 4
"""Of a contact: normal impulse, tangential one to either side, slip speed."""

RESIDUAL = 1e-8
"""A solution is taken when no row misses by more than this of its terms."""

LOOSEST = 1e-6
"""What is allowed where contacts are so nearly redundant that no way comes closer."""

ROUNDING = 1e-13
"""Unknowns below this part of the largest of their kind are rounding."""

# A guess is improved so many times before Lemke's algorithm starts from nothing.
_GUESSES = 8
# Pivots after which a tableau is made anew: of 98 problems of heaps that other ways left two covers
# solve 98, and 71 without that; and what a cover has of rows that miss nothing.
_ANEW, _COVERED = 2, 2.0**-10
# What makes bases regular, relative to scaled rows; and how often.
_DELTA, _PROXIMAL_STEPS = 2.0**-16, 12


@kernel
def problem(delassus: Array, free: Array, cones: Array, slides: Array) -> tuple[Array, Array]:
    """Return (M, q) of planar contacts with friction (Stewart and Trinkle 1996).

    Friction enters by the unit edge of its cone, so that mu = 0 and large mu are ordinary numbers;
    at mu = inf a tangential impulse without a normal one would hold no contact closed, so that
    cones end at `STEEPEST`. A contact without friction, and one that slips, keeps its four
    unknowns, with rows that hold by themselves.
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
    return row_residual(matrix, vector, z, UNKNOWNS, 1e-3 * ROUNDING / RESIDUAL)


@kernel
def _settled(z: Array) -> Array:
    """Return z without what is rounding: of impulses, and of slip speeds."""
    largest = np.zeros(2)
    for i in range(len(z)):
        kind = 1 if i % UNKNOWNS == 3 else 0
        largest[kind] = max(largest[kind], abs(z[i]))
    result = z.copy()
    for i in range(len(z)):
        if abs(z[i]) <= ROUNDING * largest[1 if i % UNKNOWNS == 3 else 0]:
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
def _by_lemke(matrix: Array, vector: Array, limit: int, z: Array) -> bool:
    """Solve by Lemke's algorithm; write z, zero where it finds none."""
    size = len(vector)
    right = vector / max(np.abs(vector).max(), 1e-300)
    outcome, _, basis = lemke(matrix, right, np.ones(size), limit, limit)
    z[:] = 0.0
    if outcome != FOUND:
        return False
    regular, found = on_support(matrix, vector, basis)
    put(np.maximum(_settled(found), 0.0), z)
    return regular


@kernel
def _proximal(matrix: Array, vector: Array, guess: Bools, limit: int, z: Array) -> bool:
    """Solve with delta (z - z_before) added to w, until it comes no closer (Rockafellar 1976).

    Contacts that stand in for each other make bases singular; with what is added none is. Along
    what does not matter z then moves by rounding for ever: that it solves is told by its residual.
    """
    size = len(vector)
    regular = matrix.copy()
    for i in range(size):
        regular[i, i] += _DELTA
    basis, best = guess, math.inf
    z[:] = 0.0
    for _ in range(_PROXIMAL_STEPS):
        moved = vector - _DELTA * z
        solved, _, new, found = _improved(regular, moved, basis)
        if solved:
            basis = found
        else:
            solved = _by_lemke(regular, moved, limit, new)
            basis = new > 0.0
        left = step_residual(matrix, vector, new) if solved else math.inf
        if left >= best or not solved:
            break
        put(new, z)
        best = left
        if best <= ROUNDING:
            break
    return best <= RESIDUAL


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
                solved = _by_lemke(scaled, right, limit, y)
            else:
                solved = _proximal(scaled, right, guess, limit, y)
            basis = y > 0.0
        if solved:
            z = scales * y
            if step_residual(matrix, vector, z) <= RESIDUAL:
                return True, z, basis
    return False, np.zeros(size), basis


@kernel
def impulses_by_lemke(
    delassus: Array, least: Array, cones: Array, slides: Array, by_scales: bool
) -> tuple[bool, Array]:
    """Return whether Lemke's algorithm finds impulses, and these (m, 2), from nothing.

    Its tableau is made anew every few pivots: bodies whose masses differ by decades leave nothing
    of it after some ten. Its path covers with what is missing, or with the scales.

    Parameters
    ----------
    delassus, least, cones, slides
        See `problem`, whose velocities are accelerations and whose impulses are forces where a
        contact slips already.
    by_scales : bool
    """
    matrix, vector = problem(delassus, least, cones, slides)
    scales, size = _scales(matrix), len(vector)
    for i in range(size):
        vector[i] *= scales[i]
        for j in range(size):
            matrix[i, j] *= scales[i] * scales[j]
    most = max(np.abs(vector).max(), 1e-300)
    vector /= most
    cover = scales / scales.max() if by_scales else np.abs(vector) + _COVERED
    outcome, z, _ = lemke(matrix, vector, cover, pivots(len(cones)), _ANEW)
    return outcome == FOUND, _along_edges(impulses_of(most * scales * z), cones, slides)


@kernel
def forces_near(
    delassus: Array, free: Array, cones: Array, slides: Array, guess: Bools
) -> tuple[bool, Array]:
    """Return whether forces (m, 2) are found, and these: the guess improved, else by Lemke.

    Parameters
    ----------
    delassus, free, cones, slides
        See `problem`.
    guess : (4 m,) array of bool
        Which unknowns may be positive. Of several solutions theirs is taken.
    """
    matrix, vector = problem(delassus, free, cones, slides)
    scales, size = _scales(matrix), len(vector)
    for i in range(size):
        vector[i] *= scales[i]
        for j in range(size):
            matrix[i, j] *= scales[i] * scales[j]
    solved, _, z, _ = _improved(matrix, vector, guess)
    if solved and step_residual(matrix, vector, z) <= RESIDUAL:
        return True, _along_edges(impulses_of(scales * z), cones, slides)
    solved, forces = impulses_by_lemke(delassus, free, cones, slides, False)
    if not solved:
        solved, forces = impulses_by_lemke(delassus, free, cones, slides, True)
    return solved, forces


@kernel
def _along_edges(impulses: Array, cones: Array, slides: Array) -> Array:
    """Return impulses (m, 2); of what slides they are those along its edge, in place."""
    for i in range(len(cones)):
        if slides[i] != 0.0:
            impulses[i, 1] = -slides[i] * cones[i, 1] * impulses[i, 0]
            impulses[i, 0] *= cones[i, 0]
    return impulses


@kernel
def pivots(contacts: int) -> int:
    """Return how many pivots are allowed."""
    return 50 + 20 * UNKNOWNS * contacts


@kernel
def impulses_of(z: Array) -> Array:
    """Return the impulses (m, 2) of a solution."""
    count = len(z) // UNKNOWNS
    impulses = np.empty((count, 2))
    for i in range(count):
        impulses[i, 0] = z[UNKNOWNS * i]
        impulses[i, 1] = z[UNKNOWNS * i + 1] - z[UNKNOWNS * i + 2]
    return impulses
