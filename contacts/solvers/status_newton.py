"""Impulses from who is open, sticks and slides: semismooth Newton (Alart and Curnier 1991).

With the status of every contact given the laws are linear equations in one unknown for each that
slides and two for each that sticks; what comes out says where the status is another one. On the
way there impulses go no farther at a time than to where the first of them leaves its cone, as in an
active-set method: where bodies wedge, that one alone yields. Contacts that stand in for each other
make the equations singular: a small part of their diagonal is added, and what that misses is
corrected with the same factors (the proximal point method), so that impulses that the motion does
not determine stay near those before.
"""

from __future__ import annotations

import numpy as np

from contacts.solvers.contact_rows import (
    CHANGE,
    HELD,
    NOW,
    ContactRows,
    add,
    along,
    moved,
    one_contact,
    rates_of,
    residual,
    seen,
    slope,
    without,
)
from contacts.solvers.saddle_point import eliminated, substitute
from contacts.solvers.status_equations import OPEN, SLIDES, STICKS
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

# So many steps, and for each contact.
_STEPS, _STEPS_EACH = 12, 4
STEPS = 48
"""And at most."""
# Added to the diagonal of a compliance whose own entries are 1, until rounding is left. What
# the motion does not determine moves by rounding divided by this: so that it begins large.
_PROXIMAL, _CORRECTIONS = (1e-4, 1e-7, 1e-10), 6
# So much of what is missed a correction leaves at most, where all of them are to bring it to rest.
_SLOW = 1e-2
# Velocities below this part of the fastest are rounding, too.
_ROUNDING = 1e-15
# Velocities below this part of the approaches are rounding.
_REST = 1e-12
# What is as near as this to the edge of its cone slides.
_EDGE = 1e-9


@kernel
def _guess(
    contacts: ContactRows, least: Array, impulses: Array, rates: Array, status: Ints, edges: Array
) -> None:
    """Write the status of contacts, and the edges that impulses are on, from impulses."""
    for i in range(len(impulses)):
        pn, pt = impulses[i]
        mu = slope(contacts.cones[i])
        if mu < 0.0:
            # What is guided slides without friction.
            status[i], edges[i] = STICKS if mu == HELD else SLIDES, 0.0
            continue
        if not pn > 0.0:
            normal, slip = seen(contacts, i, least, rates)
            pn, pt = one_contact(contacts.laws[i], normal, slip)
        if not pn > 0.0:
            status[i] = OPEN
        elif abs(pt) < mu * pn * (1.0 - _EDGE):
            status[i] = STICKS
        else:
            status[i], edges[i] = SLIDES, mu if pt > 0.0 else -mu


@kernel
def _changed(
    contacts: ContactRows,
    least: Array,
    impulses: Array,
    rates: Array,
    status: Ints,
    edges: Array,
    rest: float,
) -> bool:
    """Write what the status is after a solution; False where it is as before."""
    different = False
    for i in range(len(impulses)):
        pn, pt = impulses[i]
        mu = slope(contacts.cones[i])
        if mu < 0.0:
            continue
        normal, slip = seen(contacts, i, least, rates)
        new = status[i]
        if new == OPEN:
            if normal < -rest:
                first, beside = one_contact(contacts.laws[i], normal, slip)
                new = STICKS if abs(beside) < mu * first else SLIDES
                edges[i] = mu if beside > 0.0 else -mu
        elif pn < 0.0:
            new = OPEN
        elif new == STICKS:
            if abs(pt) > mu * pn:
                new, edges[i] = SLIDES, mu if pt > 0.0 else -mu
        elif mu > 0.0 and edges[i] * slip > abs(edges[i]) * rest:
            new = STICKS
        different = different or new != status[i]
        status[i] = new
    return different


@kernel
def _solve(
    contacts: ContactRows, least: Array, impulses: Array, rates: Array, status: Ints,
    edges: Array, rest: float,
) -> bool:  # fmt: skip
    """Solve the equations that a status makes; impulses and rates are changed in place."""
    count = 0
    for i in range(len(impulses)):
        count += status[i] if status[i] != SLIDES else 1
        count += 1 if status[i] == STICKS else 0
        if status[i] == OPEN:
            impulses[i, 0] = impulses[i, 1] = 0.0
        elif status[i] == SLIDES:
            impulses[i, 1] = edges[i] * impulses[i, 0]
    moved(contacts, impulses, rates)
    if count == 0:
        return True
    # Few arrays for many numbers: most islands are small, and an array costs what it holds.
    places, numbers, at = np.empty((3, count), np.int64), np.empty((3, count)), 0
    whose, which, order = places[0], places[1], places[2]
    scales, right, step = numbers[0], numbers[1], numbers[2]
    for i in range(len(impulses)):
        for d in range(2 if status[i] == STICKS else 1 if status[i] == SLIDES else 0):
            whose[at], which[at] = i, d
            at += 1
    for a in range(count):
        scales[a] = 1.0 / np.sqrt(max(contacts.own[whose[a], which[a]], 1e-300))
    matrix, felt = np.empty((count, count)), rates_of(contacts, 1)
    for b in range(count):
        j = whose[b]
        slides = status[j] == SLIDES
        normal = 1.0 if slides or which[b] == 0 else 0.0
        tangential = edges[j] if slides else 1.0 if which[b] == 1 else 0.0
        add(contacts, j, normal, tangential, felt)
        for a in range(count):
            matrix[a, b] = scales[a] * along(contacts, whose[a], which[a], felt) * scales[b]
        without(contacts, j, felt)
    factors = np.empty((count, count))
    for proximal in _PROXIMAL:
        put_rows(matrix, factors)
        for a in range(count):
            factors[a, a] += proximal
        for a in range(count):
            order[a] = a
        if not eliminated(factors, order):
            return False
        before = np.inf
        for _ in range(_CORRECTIONS):
            missed = 0.0
            for a in range(count):
                normal, slip = seen(contacts, whose[a], least, rates)
                wrong = normal if which[a] == 0 else slip
                right[a] = -scales[a] * wrong
                missed = max(missed, abs(wrong))
            if missed > max(_SLOW * before, rest):
                break
            before = missed
            substitute(factors, order, right, step)
            for a in range(count):
                i = whose[a]
                impulses[i, which[a]] += scales[a] * step[a]
                if status[i] == SLIDES:
                    impulses[i, 1] = edges[i] * impulses[i, 0]
            moved(contacts, impulses, rates)
            if missed <= rest:
                return True
    return True


@kernel
def _blocked(contacts: ContactRows, begin: Array, end: Array, status: Ints, edges: Array) -> bool:
    """Shorten a step, in place, to where the first contact leaves its cone; False if none does.

    That contact slides from there on, or opens.
    """
    share, first, opens = 1.0, -1, False
    for i in range(len(begin)):
        if status[i] == OPEN or slope(contacts.cones[i]) < 0.0:
            continue
        if end[i, 0] < 0.0:
            part_way = begin[i, 0] / (begin[i, 0] - end[i, 0])
            if part_way < share:
                share, first, opens = part_way, i, True
        if status[i] != STICKS:
            continue
        mu = slope(contacts.cones[i])
        for edge in (-mu, mu):
            sign = 1.0 if edge > 0.0 else -1.0
            here = max(edge * sign * begin[i, 0] - sign * begin[i, 1], 0.0)
            there = edge * sign * end[i, 0] - sign * end[i, 1]
            if there < 0.0 and here / (here - there) < share:
                share, first, opens = here / (here - there), i, False
                edges[i] = edge
    if first < 0:
        return False
    for i in range(len(begin)):
        for d in range(2):
            end[i, d] = begin[i, d] + share * (end[i, d] - begin[i, d])
    status[first] = OPEN if opens else SLIDES
    return True


@kernel
def by_status(
    contacts: ContactRows, least: Array, size: float, lowest: float, impulses: Array,
    allowed: float, most: int,
) -> tuple[float, int]:  # fmt: skip
    """Improve impulses by Newton's method; return the residual of the best ones, and the steps.

    Parameters
    ----------
    contacts, least, size, lowest, impulses
        See `contacts.solvers.contact_rows.swept`.
    allowed : float
        What is as near as this is taken, if its status is its own or not.
    most : int
        Steps, `STEPS` of which are of use.
    """
    count, rates = len(impulses), contacts.rates[0, : 3 * contacts.moving + 3]
    best, now, begin = impulses, contacts.spare[NOW, :count], contacts.spare[CHANGE, :count]
    put_rows(impulses, now)
    status, edges = np.zeros(count, np.int64), np.zeros(count)
    _guess(contacts, least, now, rates, status, edges)
    rest = _REST * size
    rounding = rest
    for i in range(len(least)):
        rounding = max(rounding, _ROUNDING * abs(least[i, 0]), _ROUNDING * abs(least[i, 1]))
    most = min(_STEPS + _STEPS_EACH * len(now), most)
    for step in range(most):
        put_rows(now, begin)
        if not _solve(contacts, least, now, rates, status, edges, rounding):
            return lowest, step + 1
        if _blocked(contacts, begin, now, status, edges):
            moved(contacts, now, rates)
            different = True
        else:
            different = _changed(contacts, least, now, rates, status, edges, rest)
        left = residual(contacts, least, size, now, rates)
        if left < lowest:
            lowest = left
            put_rows(now, best)
        if lowest <= allowed or not different:
            return lowest, step + 1
    return lowest, most
