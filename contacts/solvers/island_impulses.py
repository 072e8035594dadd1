"""Impulses of a step of an island: with restitution and pushing out that add no energy.

They are those of the contact solver, asked for less where there are none, or where their work is
more than the scheme's. There always are impulses: where they miss the contact laws their residual
tells by how much.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    CHANGE,
    LEAST,
    SAVED,
    ContactRows,
    along,
    joint_work,
    moved,
    rates_of,
    slope,
    yields,
)
from contacts.solvers.contact_solver import solve_rows
from statechart.arrays import Array, Bools
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

# How often the part of a push-out is looked for whose work is within the bound; what it then is
# above that, in parts of the impulses, is rounding, and taken from them.
_NEARER, _AT_BOUND = 3, 1e-12
# A residual that is rounding, where less is asked for: impulses with it are those of the laws.
_GOOD = 1e-8
# Work is known to this part of its terms.
_WORK_ROUNDING = 64.0 * 2.0**-52


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
def _changed(contacts: ContactRows, impulses: Array, changes: Array) -> Array:
    """Write, and return, how impulses change the velocities (m, 2) of the contacts."""
    rates = rates_of(contacts, 0)
    moved(contacts, impulses, rates)
    for i in range(len(impulses)):
        for d in range(2):
            changes[i, d] = along(contacts, i, d, rates)
    return changes


@kernel
def _velocities(contacts: ContactRows, impulses: Array) -> Array:
    """Return how impulses change the velocities (m, 2) of the contacts."""
    return _changed(contacts, impulses, np.empty((len(impulses), 2)))


@kernel
def work_share(
    contacts: ContactRows, impulses: Array, before: Array, free: Array, bound: float
) -> float:
    """Return the part of impulses whose work is within a bound; see `part_within`."""
    changes = _changed(contacts, impulses, contacts.spare[CHANGE, : len(impulses)])
    return part_within(impulses, before, free, changes, bound)


@kernel
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


@kernel
def _pushed(contacts: ContactRows, wanted: Array, rebounds: Bools, i: int) -> bool:
    """Return whether a contact needs a correction out of penetration or along its surface."""
    asked = wanted[i, 0] < 0.0 or wanted[i, 1] != 0.0
    return asked and not rebounds[i] and not slope(contacts.cones[i]) < 0.0


@kernel
def _calmer(contacts: ContactRows, wanted: Array, rebounds: Bools, joints: bool) -> Array:
    """Return what is wanted without pushing out, or without bringing `joints` back either."""
    result = wanted.copy()
    for i in range(len(wanted)):
        held = slope(contacts.cones[i]) < 0.0
        if (joints and held) or _pushed(contacts, wanted, rebounds, i):
            result[i, 0] = 0.0 if held else max(wanted[i, 0], 0.0)
            result[i, 1] = 0.0
    return result


@kernel
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
        within = work_share(contacts, chosen, before, free, bound)
        if within >= 1.0 - _AT_BOUND:
            put_rows(chosen, impulses)
            return missed, done, soft
        # With another status the work is not the same parabola.
        put_rows(chosen, full)
    return left, done, softened


@kernel
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
    count, pushed, joined, stores = len(impulses), False, False, False
    fastest = slowest = 0.0
    for i in range(count):
        slowest = max(slowest, abs(free[i, 0] - before[i, 0]))
        fastest = max(fastest, abs(before[i, 0]), abs(before[i, 1]))
        pushed = pushed or _pushed(contacts, wanted, rebounds, i)
        joined = joined or slope(contacts.cones[i]) < 0.0
        stores = stores or yields(contacts, i)
    other = contacts.spare[SAVED, :count]
    put_rows(impulses, other)
    left, done, softened = _rebounding(
        contacts, before, free, wanted, rebounds, impulses, allowed, fastest <= slowest, not pushed
    )
    if (stores or (joined and arms)) and left <= allowed:
        bound += joint_work(contacts, impulses, before, free)
    share = work_share(contacts, impulses, before, free, bound)
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
            share = work_share(contacts, impulses, before, free, bound)
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
            share = work_share(contacts, impulses, before, free, bound)
    if share < 1.0:
        for i in range(count):
            impulses[i, 0] *= share
            impulses[i, 1] *= share
    return left, done, softened
