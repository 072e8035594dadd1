"""Impulses of contacts that feel each other: the best that are found, and how good they are.

What rests is solved by its last impulses, once they are verified. Up to eight contacts are solved
by their status (Newton), to rounding; more by some sweeps and then proximal points, from the last
impulses or from nothing; what no bodies share by sweeps, their status and Lemke's algorithm in
turn.
There always are impulses: where they miss the contact laws their residual tells by how much, and
they never add more energy than the scheme may.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_lcp_kernels import impulses_by_lemke
from contacts.solvers.contact_rows import (
    CHANGE,
    KEPT,
    LAW,
    LEAST,
    TRIED,
    ContactRows,
    add,
    along,
    complete,
    joint_work,
    measured,
    moved,
    one_contact,
    rates_of,
    scale,
    slope,
    swept,
    without,
)
from contacts.solvers.proximal_newton import by_proximal_points
from contacts.solvers.status_newton import STEPS, by_status
from contacts.solvers.step_impulses import capped, part_within
from statechart.arrays import Array, Bools
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import beside, kernel, late, part

# Impulses of the step before are taken as they are where they miss by no more than this: what
# rests does not creep.
_VERIFIED = 1e-10
# So many contacts are solved by their status at once; so many where they rest; so many there in a
# few steps; so many at all, where they are not of bodies; and by Lemke's algorithm.
_EXACT, _RESTS, _DENSE, _MANY, _LEMKE = 8, 24, 100, 1000, 64
_FEW_STEPS = 2
# How often the part of a push-out is looked for whose work is within the bound; what it then is
# above that, in parts of the impulses, is rounding, and taken from them.
_NEARER, _AT_BOUND = 3, 1e-12
# A residual that is rounding, where less is asked for: impulses with it are those of the laws.
_GOOD = 1e-8
# Bodies that a contact of bodies moves; those of a dense problem move more, which are none.
_OF_BODIES = 2
# Sweeps of the trials, of which this one starts from nothing; what is sparse has so many.
_SWEEPS, _ANEW, _SPARSE = (64, 64, 256, 1024), 1, 2


@beside
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
    if count <= _EXACT or (rests and count <= _DENSE):
        most = STEPS if count <= _RESTS else _FEW_STEPS
        left, done = by_status(contacts, least, size, left, impulses, _VERIFIED, most)
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
    """Return the residual of the best impulses of a dense problem, and these (m, 2).

    Parameters
    ----------
    delassus : (2 m, 2 m)
        Velocities of the contacts per unit impulses.
    least, cones : (m, 2)
    allowed : float
    """
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


@late
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
        good, found = impulses_by_lemke(delassus, least, contacts.cones, by_sizes == 1)
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


@part
def _changed(contacts: ContactRows, impulses: Array, changes: Array) -> Array:
    """Write, and return, how impulses change the velocities (m, 2) of the contacts."""
    rates = rates_of(contacts, 0)
    moved(contacts, impulses, rates)
    for i in range(len(impulses)):
        for d in range(2):
            changes[i, d] = along(contacts, i, d, rates)
    return changes


@part
def _velocities(contacts: ContactRows, impulses: Array) -> Array:
    """Return how impulses change the velocities (m, 2) of the contacts."""
    return _changed(contacts, impulses, np.empty((len(impulses), 2)))


@part
def _within(
    contacts: ContactRows, impulses: Array, before: Array, free: Array, bound: float
) -> float:
    """Return the part of impulses whose work is within a bound; see `part_within`."""
    changes = _changed(contacts, impulses, contacts.spare[CHANGE, : len(impulses)])
    return part_within(impulses, before, free, changes, bound)


@part
def _rebounding(
    contacts: ContactRows, before: Array, free: Array, wanted: Array, rebounds: Bools,
    impulses: Array, allowed: float, rests: bool, last: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Find impulses with restitution that adds no energy; see `island_impulses`."""
    least, some = contacts.spare[LEAST, : len(impulses)], False
    for i in range(len(impulses)):
        least[i, 0], least[i, 1] = free[i, 0] + wanted[i, 0], free[i, 1] + wanted[i, 1]
        some = some or rebounds[i]
    if not some:
        left, done = solve_rows(contacts, least, impulses, allowed, rests, last)
        return left, done, False
    good, plastic = max(allowed, _GOOD), impulses.copy()
    left, done = solve_rows(contacts, least, impulses, allowed, rests, False)
    for i in range(len(impulses)):
        if rebounds[i]:
            least[i, 0] = free[i, 0]
    changes = _velocities(contacts, impulses)
    if left <= good and part_within(impulses, before, free, changes, 0.0) >= 1.0:
        return left, done, False
    # Without it nobody knows how much energy restitution may give back.
    calm, further = solve_rows(contacts, least, plastic, allowed, False, last)
    if left > good and calm < left:
        put_rows(plastic, impulses)
        return calm, done + further, True
    chosen, share = capped(
        before, free, plastic, impulses, _velocities(contacts, plastic), changes, 0.0
    )
    put_rows(chosen, impulses)
    return left if share == 1.0 else max(left, calm), done + further, False


@part
def _pushed(contacts: ContactRows, wanted: Array, rebounds: Bools, i: int) -> bool:
    """Whether a contact is to be pushed out, or back along its surface."""
    asked = wanted[i, 0] < 0.0 or wanted[i, 1] != 0.0
    return asked and not rebounds[i] and not slope(contacts.cones[i]) < 0.0


@part
def _calmer(contacts: ContactRows, wanted: Array, rebounds: Bools, joints: bool) -> Array:
    """Return what is wanted without pushing out, or without bringing `joints` back either."""
    result = wanted.copy()
    for i in range(len(wanted)):
        held = slope(contacts.cones[i]) < 0.0
        if (joints and held) or _pushed(contacts, wanted, rebounds, i):
            result[i, 0] = 0.0 if held else max(wanted[i, 0], 0.0)
            result[i, 1] = 0.0
    return result


@late
def _pushed_in_part(
    contacts: ContactRows, before: Array, free: Array, calmer: Array, wanted: Array,
    rebounds: Bools, full: Array, impulses: Array, allowed: float, bound: float, left: float,
    softened: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Push out as far as the work of impulses is within the bound; see `island_impulses`.

    Parameters
    ----------
    full : (m, 2)
        Impulses that do what is `wanted`, and too much work; is overwritten.
    impulses : (m, 2)
        Those that do what is `calmer`; what is found, in place.
    left, softened
        Of these; of what is found they are returned, and iterations between them.
    """
    asked, done = wanted, 0
    for _ in range(_NEARER):
        chosen, share = capped(
            before, free, impulses, full, _velocities(contacts, impulses),
            _velocities(contacts, full), bound,
        )  # fmt: skip
        asked = calmer + share * (asked - calmer)
        missed, further, soft = _rebounding(
            contacts, before, free, asked, rebounds, chosen, allowed, False, False
        )
        done += further
        if missed > allowed:
            break
        within = _within(contacts, chosen, before, free, bound)
        if within >= 1.0 - _AT_BOUND:
            put_rows(chosen, impulses)
            return missed, done, soft
        # With another status the work is not the same parabola.
        put_rows(chosen, full)
    return left, done, softened


@beside
def island_impulses(
    contacts: ContactRows,
    before: Array,
    free: Array,
    wanted: Array,
    rebounds: Bools,
    impulses: Array,
    allowed: float,
    bound: float,
    arms: bool,
) -> tuple[float, int, bool]:
    """Find the impulses of a step; return their residual, iterations, and whether none rebounds.

    Restitution that would add energy is reduced. Where contacts oppose each other there need be no
    impulses that make all of them part as they should: then none is asked to part, for which there
    are some (Anitescu and Potra 1997).

    Parameters
    ----------
    contacts : ContactRows
    before, free : (m, 2)
        Velocities before the step, and after it without impulses.
    wanted : (m, 2)
        What these may not fall below, negated.
    rebounds : (m,) array of bool
        Whose `wanted` is that of restitution.
    impulses : (m, 2)
        Of the step before; what is found, in place.
    allowed : float
        Residual.
    bound : float
        The work that impulses may do on bodies in a step: ``h^2/8 f^T M^-1 f``.
    arms : bool
        Whether joints may do more, as their arms turn.
    """
    count, pushed, joined = len(impulses), False, False
    fastest = slowest = 0.0
    for i in range(count):
        slowest = max(slowest, abs(free[i, 0] - before[i, 0]))
        fastest = max(fastest, abs(before[i, 0]), abs(before[i, 1]))
        pushed = pushed or _pushed(contacts, wanted, rebounds, i)
        joined = joined or slope(contacts.cones[i]) < 0.0
    other = contacts.spare[KEPT, :count]
    put_rows(impulses, other)
    left, done, softened = _rebounding(
        contacts, before, free, wanted, rebounds, impulses, allowed, fastest <= slowest, not pushed
    )
    if joined and arms and left <= allowed:
        bound += joint_work(contacts, impulses, before, free)
    share = _within(contacts, impulses, before, free, bound)
    if pushed and (left > allowed or share < 1.0):
        # What is pushed out may be pushed against others, and gains energy; or wedges, for which
        # there are no impulses: those that were tried press without bound, and are no start.
        calmer = _calmer(contacts, wanted, rebounds, False)
        calm, further, soft = _rebounding(
            contacts, before, free, calmer, rebounds, other, allowed, False, True
        )
        done += further
        if calm <= max(left, allowed):
            if max(left, calm) <= allowed:
                calm, further, soft = _pushed_in_part(
                    contacts, before, free, calmer, wanted, rebounds, impulses, other, allowed,
                    bound, calm, soft,
                )  # fmt: skip
                done += further
            left, softened = calm, soft
            put_rows(other, impulses)
            share = _within(contacts, impulses, before, free, bound)
    if joined and left > allowed:
        # What sticks or is stuck between joints and others can do nothing but rest: no joint is
        # brought back there, or follows its arm as that turns.
        calmer = _calmer(contacts, wanted, rebounds, True)
        other[:] = 0.0
        calm, further, soft = _rebounding(
            contacts, before, free, calmer, rebounds, other, allowed, False, True
        )
        done += further
        if calm < left:
            left, softened = calm, soft
            put_rows(other, impulses)
            share = _within(contacts, impulses, before, free, bound)
    if share < 1.0:
        for i in range(count):
            impulses[i, 0] *= share
            impulses[i, 1] *= share
    return left, done, softened
