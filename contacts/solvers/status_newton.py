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
    HELD,
    ContactRows,
    add,
    moved,
    one_contact,
    residual,
    seen,
    slope,
)
from contacts.solvers.saddle_point import eliminated, substitute
from contacts.solvers.sparse_blocks import Pattern, factored, no_pattern, pattern_of, solved
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import part

# So many steps, and for each contact; and at most.
_STEPS, _STEPS_EACH, _MOST = 12, 4, 48
# Added to the diagonal of a compliance whose own entries are 1.
_PROXIMAL, _CORRECTIONS = 1e-10, 4
# Velocities below this part of the approaches are rounding.
_REST = 1e-12
# What is as near as this to the edge of its cone slides.
_EDGE = 1e-9

_OPEN, _STICKS, _SLIDES = 0, 1, 2


@part
def _guess(
    contacts: ContactRows, least: Array, impulses: Array, rates: Array, status: Ints, edges: Array
) -> None:
    """Write the status of contacts, and the edges that impulses are on, from impulses."""
    for i in range(len(impulses)):
        pn, pt = impulses[i]
        mu = slope(contacts.cones[i])
        if mu < 0.0:
            # What is guided slides without friction.
            status[i], edges[i] = _STICKS if mu == HELD else _SLIDES, 0.0
            continue
        if not pn > 0.0:
            normal, slip = seen(contacts, i, least, rates)
            pn, pt = one_contact(contacts.own[i], mu, normal, slip)
        if not pn > 0.0:
            status[i] = _OPEN
        elif abs(pt) < mu * pn * (1.0 - _EDGE):
            status[i] = _STICKS
        else:
            status[i], edges[i] = _SLIDES, mu if pt > 0.0 else -mu


@part
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
        if new == _OPEN:
            if normal < -rest:
                first, beside = one_contact(contacts.own[i], mu, normal, slip)
                new = _STICKS if abs(beside) < mu * first else _SLIDES
                edges[i] = mu if beside > 0.0 else -mu
        elif pn < 0.0:
            new = _OPEN
        elif new == _STICKS:
            if abs(pt) > mu * pn:
                new, edges[i] = _SLIDES, mu if pt > 0.0 else -mu
        elif mu > 0.0 and edges[i] * slip > abs(edges[i]) * rest:
            new = _STICKS
        different = different or new != status[i]
        status[i] = new
    return different


@part
def _solve(
    contacts: ContactRows, least: Array, impulses: Array, rates: Array, status: Ints, edges: Array
) -> bool:
    """Solve the equations that a status makes; impulses and rates are changed in place."""
    count = 0
    for i in range(len(impulses)):
        count += status[i] if status[i] != _SLIDES else 1
        count += 1 if status[i] == _STICKS else 0
        if status[i] == _OPEN:
            impulses[i, 0] = impulses[i, 1] = 0.0
        elif status[i] == _SLIDES:
            impulses[i, 1] = edges[i] * impulses[i, 0]
    moved(contacts, impulses, rates)
    if count == 0:
        return True
    whose, which = np.empty(count, np.int64), np.empty(count, np.int64)
    at = 0
    for i in range(len(impulses)):
        for d in range(2 if status[i] == _STICKS else 1 if status[i] == _SLIDES else 0):
            whose[at], which[at] = i, d
            at += 1
    scales = np.empty(count)
    for a in range(count):
        scales[a] = 1.0 / np.sqrt(max(contacts.own[whose[a], which[a]], 1e-300))
    matrix, felt, width = np.empty((count, count)), np.zeros_like(rates), contacts.places.shape[1]
    for b in range(count):
        j = whose[b]
        slides = status[j] == _SLIDES
        normal = 1.0 if slides or which[b] == 0 else 0.0
        tangential = edges[j] if slides else 1.0 if which[b] == 1 else 0.0
        add(contacts, j, normal, tangential, felt)
        for a in range(count):
            i, total = whose[a], 0.0
            for k in range(width):
                total += contacts.rows[i, which[a], k] * felt[contacts.places[i, k]]
            matrix[a, b] = scales[a] * total * scales[b]
        for k in range(width):
            felt[contacts.places[j, k]] = 0.0
        matrix[b, b] += _PROXIMAL
    order, right, step = np.arange(count), np.empty(count), np.empty(count)
    if not eliminated(matrix, order):
        return False
    for _ in range(_CORRECTIONS):
        for a in range(count):
            normal, slip = seen(contacts, whose[a], least, rates)
            right[a] = -scales[a] * (normal if which[a] == 0 else slip)
        substitute(matrix, order, right, step)
        for a in range(count):
            i = whose[a]
            impulses[i, which[a]] += scales[a] * step[a]
            if status[i] == _SLIDES:
                impulses[i, 1] = edges[i] * impulses[i, 0]
        moved(contacts, impulses, rates)
    return True


@part
def _solve_sparse(
    contacts: ContactRows, pattern: Pattern, least: Array, impulses: Array, rates: Array,
    status: Ints, edges: Array,
) -> bool:  # fmt: skip
    """Solve the equations that a status makes, as `_solve` does, by a sparse elimination.

    What a contact has no unknown for is an unknown of its own, zero.
    """
    count = len(impulses)
    diagonal, after, before = pattern.diagonal.copy(), pattern.after.copy(), pattern.before.copy()
    scales = np.empty((count, 2))
    for i in range(count):
        scales[i, 0] = 1.0 / np.sqrt(max(contacts.own[i, 0], 1e-300))
        scales[i, 1] = 1.0 / np.sqrt(max(contacts.own[i, 1], 1e-300))
        if status[i] == _OPEN:
            impulses[i, 0] = impulses[i, 1] = 0.0
        elif status[i] == _SLIDES:
            impulses[i, 1] = edges[i] * impulses[i, 0]
    moved(contacts, impulses, rates)
    for p in range(count):
        i = pattern.order[p]
        _as_status(diagonal[p], i, i, status, edges, scales)
        for k in range(2):
            diagonal[p, 3 * k] += _PROXIMAL if _has(status, i, k) else 1.0
        for at in range(pattern.begins[p], pattern.begins[p + 1]):
            j = pattern.others[at]
            _as_status(after[at], i, j, status, edges, scales)
            _as_status(before[at], j, i, status, edges, scales)
    if not factored(pattern, diagonal, after, before, np.empty(count, np.int64)):
        return False
    right = np.empty((count, 2))
    for _ in range(_CORRECTIONS):
        for i in range(count):
            normal, slip = seen(contacts, i, least, rates)
            right[i, 0] = -scales[i, 0] * normal if _has(status, i, 0) else 0.0
            right[i, 1] = -scales[i, 1] * slip if _has(status, i, 1) else 0.0
        solved(pattern, diagonal, after, before, right)
        for i in range(count):
            if _has(status, i, 0):
                impulses[i, 0] += scales[i, 0] * right[i, 0]
            if _has(status, i, 1):
                impulses[i, 1] += scales[i, 1] * right[i, 1]
            elif status[i] == _SLIDES:
                impulses[i, 1] = edges[i] * impulses[i, 0]
        moved(contacts, impulses, rates)
    return True


@part
def _has(status: Ints, i: int, k: int) -> bool:
    """Whether a contact has an unknown along its normal (0) or its tangent (1)."""
    return status[i] == _STICKS or (k == 0 and status[i] == _SLIDES)


@part
def _as_status(block: Array, i: int, j: int, status: Ints, edges: Array, scales: Array) -> None:
    """Make velocities of contact i per unit impulses of j those of their unknowns, scaled."""
    if status[j] == _SLIDES:
        block[0] += edges[j] * block[1]
        block[2] += edges[j] * block[3]
    for a in range(2):
        for b in range(2):
            have = _has(status, i, a) and _has(status, j, b)
            block[2 * a + b] = scales[i, a] * block[2 * a + b] * scales[j, b] if have else 0.0


@part
def _blocked(contacts: ContactRows, begin: Array, end: Array, status: Ints, edges: Array) -> bool:
    """Shorten a step, in place, to where the first contact leaves its cone; False if none does.

    That contact slides from there on, or opens.
    """
    share, first, opens = 1.0, -1, False
    for i in range(len(begin)):
        if status[i] == _OPEN or slope(contacts.cones[i]) < 0.0:
            continue
        if end[i, 0] < 0.0:
            part_way = begin[i, 0] / (begin[i, 0] - end[i, 0])
            if part_way < share:
                share, first, opens = part_way, i, True
        if status[i] != _STICKS:
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
    status[first] = _OPEN if opens else _SLIDES
    return True


@part
def by_status(
    contacts: ContactRows, least: Array, impulses: Array, allowed: float, sparse: bool
) -> tuple[float, int]:
    """Improve impulses by Newton's method; return the residual of the best ones, and the steps.

    Parameters
    ----------
    contacts : ContactRows
    least, impulses : (m, 2)
        See `contacts.solvers.contact_rows.swept`.
    allowed : float
        What is as near as this is taken, if its status is its own or not.
    sparse : bool
        Whether they are contacts of bodies, and many.
    """
    rates = np.zeros(contacts.places.max() + 1)
    moved(contacts, impulses, rates)
    lowest = residual(contacts, least, impulses, rates)
    best, now = impulses, impulses.copy()
    status, edges = np.zeros(len(now), np.int64), np.zeros(len(now))
    _guess(contacts, least, now, rates, status, edges)
    size = 0.0
    for i in range(len(least)):
        held = slope(contacts.cones[i]) < 0.0
        size = max(size, abs(least[i, 0]) if held else -least[i, 0])
    begin = now.copy()
    most = min(_STEPS + _STEPS_EACH * len(now), _MOST)
    pattern = pattern_of(contacts) if sparse else no_pattern()
    for step in range(most):
        put_rows(now, begin)
        if sparse:
            good = _solve_sparse(contacts, pattern, least, now, rates, status, edges)
        else:
            good = _solve(contacts, least, now, rates, status, edges)
        if not good:
            return lowest, step + 1
        if _blocked(contacts, begin, now, status, edges):
            moved(contacts, now, rates)
            different = True
        else:
            different = _changed(contacts, least, now, rates, status, edges, _REST * size)
        left = residual(contacts, least, now, rates)
        if left < lowest:
            lowest = left
            put_rows(now, best)
        if lowest <= allowed or not different:
            return lowest, step + 1
    return lowest, most
