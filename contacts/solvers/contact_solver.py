"""The contact solver: one ladder for every contact problem.

1. Gauss-Seidel sweeps (`contacts.solvers.contact_rows.swept`), from the last impulses;
2. proximal points by Newton's method (`contacts.solvers.proximal_points`), from where these end;
   both anew from nothing where they miss, since the last impulses mislead where much changes;
3. Lemke's algorithm (`contacts.solvers.lemke`), from nothing, made exact by proximal points.

The best impulses that were found are returned with their residual. `benchmarks/contact_problems.py`
replays every method on recorded problems.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    TRIAL,
    ContactRows,
    add,
    along,
    measured,
    rates_of,
    scale,
    slope,
    swept,
    without,
)
from contacts.solvers.lemke import impulses_by_lemke
from contacts.solvers.proximal_points import VERIFIED, by_last_status, by_proximal_points
from statechart.arrays import Array
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

# Residual of the last impulses that are taken again where nothing moves: what they miss adds up
# over the steps to come, until it is as large as `VERIFIED`.
_AT_REST = 1e-13
# Residual of a status that is solved to round-off: what is open then approaches by the round-off of
# gaps over a step, and what would press against it has no cause.
_OPENS = 1e-8
# Contacts up to which all problems are solved to `VERIFIED`, which costs no more there.
_SMALL = 8
# Sweeps before Newton's method: they find the status of most contacts.
_SWEEPS = 64
# Contacts up to which Lemke's algorithm is tried: its time grows with their third power, or more.
_LEMKE = 64


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
    count, idle, joined = len(impulses), True, False
    for i in range(count):
        held = slope(contacts.cones[i]) < 0.0
        idle, joined = idle and least[i, 0] >= 0.0 and not held, joined or held
    if idle or not allowed < math.inf:
        impulses[:] = 0.0
        return 0.0, 0
    size = scale(contacts, least)
    left = measured(contacts, least, size, impulses)
    # All contacts of coordinates move the same, so that Newton's equations are as small as that.
    same = contacts.shared == 1
    # Of coordinates they are solved anew at each step: what rests has no velocity at all.
    if not same and left <= (_AT_REST if rests else VERIFIED):
        return left, 0
    other, done, pivots = contacts.spare[TRIAL, :count], 0, count <= _LEMKE and not joined
    goal = min(allowed, VERIFIED) if rests or same or count <= _SMALL else allowed
    if same:
        missed, found = math.inf, max(goal, min(allowed, _OPENS))
        if count == 1:
            other[:] = 0.0
            measured(contacts, least, size, other)
            missed, done = swept(contacts, least, size, math.inf, other, goal, 1)
        elif impulses[:, 0].max() > 0.0:
            put_rows(impulses, other)
            missed, done = by_last_status(contacts, least, other)
        if missed > found and count > 1 and pivots:
            missed, steps = _by_lemke(contacts, least, found, other)
            done, pivots = done + steps, False
        if missed <= found or missed < left:
            left = missed
            put_rows(other, impulses)
        if missed <= found:
            return missed, done
    for anew in (False, True):
        if anew:
            other[:] = 0.0
        else:
            put_rows(impulses, other)
        missed = measured(contacts, least, size, other)
        # A small problem costs Newton's method no more than sweeps, and what rests has its status.
        # The first sweep solves a contact alone.
        if anew or goal > VERIFIED or count == 1:
            missed, steps = swept(contacts, least, size, missed, other, goal, _SWEEPS)
            done += steps
        if missed > goal or rests:
            missed, steps = by_proximal_points(contacts, least, other, goal)
            done += steps
        if missed < left:
            left = missed
            put_rows(other, impulses)
        if left <= allowed:
            return left, done
    if last and pivots:
        missed, steps = _by_lemke(contacts, least, allowed, other)
        done += steps
        if missed < left:
            left = missed
            put_rows(other, impulses)
    return left, done


@kernel
def _by_lemke(
    contacts: ContactRows, least: Array, allowed: float, impulses: Array
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
    left, done = math.inf, 0
    for by_sizes in range(2):
        if left <= allowed:
            break
        good, found = impulses_by_lemke(
            delassus, least, contacts.cones, np.zeros(len(least)), by_sizes == 1
        )
        if not good:
            continue
        exact, missed, steps = found.copy(), math.inf, 0
        if contacts.shared == 1:
            missed, steps = by_last_status(contacts, least, exact)
        if missed <= allowed:
            put_rows(exact, found)
        else:
            missed, more = by_proximal_points(contacts, least, found, allowed)
            steps += more
        done += steps
        if missed < left:
            left = missed
            put_rows(found, impulses)
    return left, done
