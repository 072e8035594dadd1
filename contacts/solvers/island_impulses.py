"""Impulses of a step of an island: with restitution and pushing out that add no energy.

They are those of the contact solver, asked for less where there are none, or where their work is
more than the scheme's. There always are impulses: where they miss the contact laws their residual
tells by how much.
"""

from __future__ import annotations

import numpy as np

from contacts.solvers.contact_rows import (
    CHANGE,
    KEPT,
    LEAST,
    ContactRows,
    along,
    joint_work,
    moved,
    rates_of,
    slope,
    yields,
)
from contacts.solvers.contact_solver import solve_rows
from contacts.solvers.step_impulses import capped, part_within
from statechart.arrays import Array, Bools
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

# How often the part of a push-out is looked for whose work is within the bound; what it then is
# above that, in parts of the impulses, is rounding, and taken from them.
_NEARER, _AT_BOUND = 3, 1e-12
# A residual that is rounding, where less is asked for: impulses with it are those of the laws.
_GOOD = 1e-8


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
def _within(
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
        within = _within(contacts, chosen, before, free, bound)
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
    other = contacts.spare[KEPT, :count]
    put_rows(impulses, other)
    left, done, softened = _rebounding(
        contacts, before, free, wanted, rebounds, impulses, allowed, fastest <= slowest, not pushed
    )
    if (stores or (joined and arms)) and left <= allowed:
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
