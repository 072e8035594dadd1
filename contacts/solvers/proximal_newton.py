"""Impulses of many contacts: proximal points, each by semismooth Newton on sparse equations.

Of contacts in a heap nearly half of the impulses are not determined by the motion, and where bodies
wedge the equations of a status have no solution at all. So each problem is solved with impulses
held to a centre by a compliance (the proximal point method, Rockafellar 1976), which makes it well
conditioned: Newton's steps, every contact taking its new status at once (Alart and Curnier 1991),
settle in a few. The centre then is what was found, and the compliance falls as long as they do;
where they go round in circles, the solution is followed from the last centre's, status by status
(`contacts.solvers.proximal_path`).
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    HELD,
    ContactRows,
    moved,
    rates_of,
    residual,
    scale,
    seen,
    slope,
)
from contacts.solvers.proximal_path import followed
from contacts.solvers.status_equations import (
    OPEN,
    SLIDES,
    STICKS,
    Equations,
    eliminated,
    equations_of,
    step,
)
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

# The compliance, of a contact's own: at first, at least, at most; by how much it falls where steps
# settle, and grows where they do not.
_FIRST, _LEAST, _LARGEST = 1e-2, 1e-8, 1.0
_FALLS, _GROWS = 0.5, 4.0
# Newton's steps to a centre; centres at the least compliance that are no better, but for rounding;
# eliminations in all, and times contacts: half a second.
_SETTLING, _IDLE, _MOST, _MOST_TIMES = 10, 4, 3000, 2_000_000


@kernel
def _find_status(
    contacts: ContactRows, least: Array, now: Array, centre: Array, compliance: float,
    rates: Array, status: Ints, edges: Array,
) -> bool:  # fmt: skip
    """Write the status of contacts by the natural map; False where it is as before."""
    different = False
    for i in range(len(now)):
        mu = slope(contacts.cones[i])
        if mu < 0.0:
            # What is guided slides without friction.
            status[i], edges[i] = STICKS if mu == HELD else SLIDES, 0.0
            continue
        normal, slip = seen(contacts, i, least, rates)
        wn, wt = contacts.own[i, 0], contacts.own[i, 1]
        press = wn * now[i, 0] - normal - compliance * wn * (now[i, 0] - centre[i, 0])
        shear = wt * now[i, 1] - slip - compliance * wt * (now[i, 1] - centre[i, 1])
        new, edge = SLIDES, math.copysign(mu, shear)
        if press <= 0.0:
            new = OPEN
        elif abs(shear) * wn < mu * wt * press:
            new = STICKS
        different = different or new != status[i] or (new == SLIDES and edge != edges[i])
        status[i], edges[i] = new, edge
    return different


@kernel
def _take_step(
    contacts: ContactRows, equations: Equations, least: Array, now: Array, centre: Array,
    compliance: float, rates: Array, status: Ints, edges: Array,
) -> None:  # fmt: skip
    """Bring impulses to where their status is exact, and their rates, in place."""
    for i in range(len(now)):
        normal, slip = seen(contacts, i, least, rates)
        away, aside = now[i, 0] - centre[i, 0], now[i, 1] - centre[i, 1]
        equations.right[i, 0] = -normal - compliance * contacts.own[i, 0] * away
        equations.right[i, 1] = -slip - compliance * contacts.own[i, 1] * aside
    step(contacts, equations, compliance, status, edges, now)
    moved(contacts, now, rates)


@kernel
def _settled(
    contacts: ContactRows, equations: Equations, least: Array, now: Array, centre: Array,
    compliance: float, rates: Array, status: Ints, edges: Array,
) -> tuple[bool, int]:  # fmt: skip
    """Take Newton's steps to a proximal point, in place; return if they settle, and how many."""
    for taken in range(_SETTLING + 1):
        changed = _find_status(contacts, least, now, centre, compliance, rates, status, edges)
        if taken > 0 and not changed:
            # A small compliance costs digits, which a second step gives back.
            _take_step(contacts, equations, least, now, centre, compliance, rates, status, edges)
            return True, taken
        if taken == _SETTLING or not eliminated(contacts, equations, compliance, status, edges):
            return False, taken + 1
        for i in range(len(now)):
            if status[i] == OPEN:
                now[i, 0] = now[i, 1] = 0.0
            elif status[i] == SLIDES:
                now[i, 1] = edges[i] * now[i, 0]
        moved(contacts, now, rates)
        _take_step(contacts, equations, least, now, centre, compliance, rates, status, edges)
    return False, _SETTLING


@kernel
def by_proximal_points(
    contacts: ContactRows, least: Array, impulses: Array, allowed: float
) -> tuple[float, int]:
    """Improve impulses of contacts of bodies; return the residual of the best, and eliminations."""
    count = len(impulses)
    rates = rates_of(contacts, 0)
    moved(contacts, impulses, rates)
    size = scale(contacts, least)
    lowest = residual(contacts, least, size, impulses, rates)
    equations = equations_of(contacts)
    now, centre, shift = impulses.copy(), impulses.copy(), np.zeros((count, 2))
    status, edges = np.full(count, -1), np.zeros(count)
    # Of the last centre that was found.
    known, known_edges, is_known = status.copy(), edges.copy(), False
    compliance, done, idle, most = _FIRST, 0, 0, min(_MOST, _MOST_TIMES // count)
    while done < most and lowest > allowed and idle < _IDLE:
        good, taken = _settled(
            contacts, equations, least, now, centre, compliance, rates, status, edges
        )
        done += taken
        if not good and is_known:
            put_rows(centre, now)
            status[:], edges[:] = known, known_edges
            good, taken = followed(
                contacts, equations, least, now, centre, shift, compliance, rates, status, edges
            )
            done += taken
        if good:
            moved(contacts, now, rates)
            left = residual(contacts, least, size, now, rates)
            idle += 1 if compliance == _LEAST else 0
            if left < lowest:
                lowest, idle = left, 0
                put_rows(now, impulses)
            for i in range(count):
                for d in range(2):
                    away = now[i, d] - centre[i, d]
                    shift[i, d] = compliance * contacts.own[i, d] * away
            put_rows(now, centre)
            known[:], known_edges[:], is_known = status, edges, True
            compliance = max(_FALLS * compliance, _LEAST)
        elif compliance >= _LARGEST:
            break
        else:
            compliance = min(_GROWS * compliance, _LARGEST)
            put_rows(centre, now)
            moved(contacts, now, rates)
    return lowest, done
