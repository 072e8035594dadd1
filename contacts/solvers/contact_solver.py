"""The contact solver: the best impulses that are found for contacts that feel each other.

What rests is solved by its last impulses, once they are verified. Up to eight contacts are solved
by their status (Newton), to rounding, or by sweeps where little is asked for; more by some sweeps
and then proximal points, from the last impulses or from nothing; what no bodies share by sweeps,
their status and Lemke's algorithm in turn.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_lcp_kernels import impulses_by_lemke
from contacts.solvers.contact_rows import (
    LAW,
    TRIED,
    ContactRows,
    add,
    along,
    complete,
    measured,
    one_contact,
    rates_of,
    scale,
    slope,
    swept,
    without,
)
from contacts.solvers.proximal_newton import by_proximal_points
from contacts.solvers.status_newton import STEPS, by_status
from statechart.arrays import Array
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

# Impulses of the step before are taken as they are where they miss by no more than this: what
# rests does not creep.
_VERIFIED = 1e-10
# So many contacts are solved by their status at once; so many where they rest; so many there in a
# few steps; so many at all, where they are not of bodies; and by Lemke's algorithm.
_EXACT, _RESTS, _DENSE, _MANY, _LEMKE = 8, 24, 100, 1000, 64
_FEW_STEPS = 2
# Sweeps that cost less than to solve so few by their status, and halve what is missed: where they
# may do, they are tried.
_FEW_SWEEPS, _LOOSE = 8, 0.5**8
# Bodies that a contact of bodies moves; those of a dense problem move more, which are none.
_OF_BODIES = 2
# Sweeps of the trials, of which this one starts from nothing; what is sparse has so many.
_SWEEPS, _ANEW, _SPARSE = (64, 64, 256, 1024), 1, 2


@kernel
def solve_rows(
    contacts: ContactRows, least: Array, impulses: Array, allowed: float, rests: bool, last: bool
) -> tuple[float, int]:
    """Solve contacts from the impulses given; return the residual of the best, and iterations.

    Parameters
    ----------
    contacts : ContactRows
    least : (m, 2)
        Velocities without impulses, plus what may be missing of them.
    impulses : (m, 2)
        Of the step before; the best that are found, in place.
    allowed : float
        Residual (see `contacts.solvers.contact_rows.residual`) at which they are good enough;
        infinite: nobody asks for any, as where it is only looked who touches.
    rests : bool
        Whether nothing moves: then they are found as exactly as can be, for the steps to come.
    last : bool
        Whether nobody asks for less where they are not found: then Lemke's algorithm is tried, too.
    """
    count = len(impulses)
    parting, joined = True, False
    if not allowed < math.inf:
        impulses[:] = 0.0
        return 0.0, 0
    for i in range(count):
        held = slope(contacts.cones[i]) < 0.0
        parting, joined = parting and least[i, 0] >= 0.0 and not held, joined or held
    if parting:
        impulses[:] = 0.0
        return 0.0, 0
    size = scale(contacts, least)
    left = measured(contacts, least, size, impulses)
    if left <= _VERIFIED:
        return left, 0
    if count == 1:
        alone = one_contact(contacts.laws[0], least[0, 0], least[0, 1])
        impulses[0, 0], impulses[0, 1] = alone
        left = measured(contacts, least, size, impulses)
        if left <= _VERIFIED:
            return left, 1
    done, bodies = 0, contacts.bodies.shape[1] == _OF_BODIES
    sparse = bodies and count > _EXACT
    if count <= _EXACT and not rests and allowed >= _LOOSE:
        left, done = swept(contacts, least, size, left, impulses, allowed, _FEW_SWEEPS)
        if left <= allowed:
            return left, done
        left = measured(contacts, least, size, impulses)
    if count <= _EXACT or (rests and count <= _DENSE):
        most = STEPS if count <= _RESTS else _FEW_STEPS
        left, steps = by_status(contacts, least, size, left, impulses, _VERIFIED, most)
        done += steps
    if sparse and rests and left > _VERIFIED:
        left, steps = by_proximal_points(contacts, least, impulses, _VERIFIED)
        done += steps
    other, missed, known = contacts.spare[TRIED, :count], left, done == 0
    for trial in range(_SPARSE if sparse else len(_SWEEPS)):
        if left <= allowed:
            break
        # From elsewhere it may be near: impulses of the step before mislead where much changes.
        if trial == _ANEW:
            other[:] = 0.0
        else:
            put_rows(impulses, other)
        if not known:
            missed = measured(contacts, least, size, other)
        known = False
        missed, steps = swept(contacts, least, size, missed, other, allowed, _SWEEPS[trial])
        done += steps
        if missed > allowed and not sparse and count <= _MANY:
            missed = measured(contacts, least, size, other)
            missed, steps = by_status(contacts, least, size, missed, other, allowed, STEPS)
            done += steps
        if missed > allowed and bodies:
            missed, steps = by_proximal_points(contacts, least, other, allowed)
            done += steps
        if missed < left:
            left = missed
            put_rows(other, impulses)
        if last and left > allowed and trial == _ANEW and count <= _LEMKE and not joined:
            missed, steps = _by_lemke(contacts, least, allowed, bodies, other)
            done += steps
            if missed < left:
                left = missed
                put_rows(other, impulses)
    return left, done


@kernel
def dense_impulses(
    delassus: Array, least: Array, cones: Array, allowed: float
) -> tuple[float, Array]:
    """Return the residual of the best impulses of a dense problem, and these (m, 2)."""
    count = len(cones)
    threes = max((2 * count + 2) // 3, _OF_BODIES + 1)
    bodies = np.empty((count, threes), np.int64)
    rows, columns = np.zeros((count, 2, 3 * threes)), np.zeros((count, 2, 3 * threes))
    own, impulses = np.empty((count, 3)), np.zeros((count, 2))
    for i in range(count):
        for side in range(threes):
            bodies[i, side] = side
        for d in range(2):
            rows[i, d, 2 * i + d] = 1.0
            for k in range(2 * count):
                columns[i, d, k] = delassus[k, 2 * i + d]
    contacts = ContactRows(
        bodies, threes, rows, columns, own, cones, np.empty((count, LAW)),
        np.empty((3, 3 * threes + 3)), np.empty((7, count, 2)),
    )  # fmt: skip
    complete(contacts)
    left, _ = solve_rows(contacts, least, impulses, allowed, False, True)
    return left, impulses


@kernel
def _by_lemke(
    contacts: ContactRows, least: Array, allowed: float, bodies: bool, impulses: Array
) -> tuple[float, int]:
    """Improve impulses from those of the dense problem; return the residual, and iterations.

    Lemke's algorithm finds the status where masses differ by decades and no path from impulses
    nearby does; to rounding it is solved by that status. Where one cover ends in a ray by rounding,
    the other seldom does.
    """
    count = len(least)
    delassus, felt = np.empty((2 * count, 2 * count)), rates_of(contacts, 0)
    for b in range(2 * count):
        j = b // 2
        add(contacts, j, 1.0 - b % 2, 1.0 * (b % 2), felt)
        for a in range(2 * count):
            delassus[a, b] = along(contacts, a // 2, a % 2, felt)
        without(contacts, j, felt)
    left, done, size = math.inf, 0, scale(contacts, least)
    for by_sizes in range(2):
        if left <= allowed:
            break
        good, found = impulses_by_lemke(
            delassus, least, contacts.cones, np.zeros(len(least)), by_sizes == 1
        )
        if not good:
            continue
        missed = measured(contacts, least, size, found)
        missed, steps = by_status(contacts, least, size, missed, found, allowed, STEPS)
        done += steps
        if missed > allowed and bodies:
            missed, steps = by_proximal_points(contacts, least, found, allowed)
            done += steps
        if missed < left:
            left = missed
            put_rows(found, impulses)
    return left, done
