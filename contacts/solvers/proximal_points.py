"""The proximal point method for contact impulses (Rockafellar 1976), by semismooth Newton steps.

Each problem is solved with impulses held to a centre by a compliance, which makes it well
conditioned: nearly half of the impulses in a heap are not determined by the motion, and where
bodies wedge the equations of a status (open, sticks, slides) have no solution at all. Newton's
steps give every contact its new status at once (Alart and Curnier 1991) and settle in a few. Then
the centre moves to the solution, and the compliance falls. Unknowns of the linear equations are
the rates of the bodies, of which there are fewer than contacts: impulses follow from the velocity
that a contact misses, over its compliance.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    HELD,
    ContactRows,
    contact_velocity,
    moved,
    rates_of,
    residual,
    scale,
    slope,
)
from contacts.solvers.sparse_blocks import Equations, equations_of, factored, solved
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import kernel

OPEN, STICKS, SLIDES = range(3)
"""The status of a contact."""

VERIFIED = 1e-10
"""Residual of impulses that are taken as they are. What is to be solved to it is solved until
round-off ends the fall of the residual: what rests does not creep."""

# The compliance, of a contact's own: at first, at least, at most; by how much it falls where steps
# settle, and grows where they do not.
_FIRST, _LEAST, _LARGEST = 1e-2, 1e-8, 1.0
_FALLS, _GROWS = 0.5, 4.0
# A centre that misses less than this part of what the one before did is worth another one; at the
# least compliance, which impulses begin at that nearly solve the problem, the first is the last.
_FURTHER = 0.9
# Compliance of a status that is refined, and how often at most: each leaves the larger of it, by
# how much own compliances are above those of all together, and of round-off over its square.
_REFINING, _REFINEMENTS = 1e-5, 32
# Newton's steps to a centre; centres at the least compliance that are no better, but for rounding;
# eliminations in all, and times contacts: half a second.
_SETTLING, _IDLE, _MOST, _MOST_TIMES = 10, 4, 3000, 2_000_000
# Changes of status, and how many of them the shift may grow after.
_CHANGES, _TURNS = 160, 40
# What of a contact is about to end.
_ONE, _OTHER = 0, 1


@kernel
def _add(
    contacts: ContactRows, i: int, d: int, share: float, edge: float, one: int, other: int,
    block: Array,
) -> None:  # fmt: skip
    """Add to a block what the rates of one body do to another's through an impulse of a contact."""
    columns, rows = contacts.columns[i], contacts.rows[i, d]
    for r in range(3):
        column = share * (columns[d, 3 * one + r] + edge * columns[1, 3 * one + r])
        for c in range(3):
            block[3 * r + c] += column * rows[3 * other + c]


@kernel
def eliminated(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array
) -> bool:
    """Eliminate the equations of a status; False where a pivot fails.

    Parameters
    ----------
    contacts : ContactRows
    equations : Equations
    compliance : float
        Of each contact, in parts of its own.
    status : (m,) array of int, edges : (m,)
        Of what slides, tangential by normal impulse.
    """
    diagonal, after, before = equations.diagonal, equations.after, equations.before
    for p in range(len(diagonal)):
        for k in range(9):
            diagonal[p, k] = 1.0 if k % 4 == 0 else 0.0
    for at in range(len(after)):
        for k in range(9):
            after[at, k] = before[at, k] = 0.0
    ends, entries = equations.ends, equations.entries
    for i in range(len(status)):
        if status[i] == OPEN:
            continue
        edge = edges[i] if status[i] == SLIDES else 0.0
        for d in range(2 if status[i] == STICKS else 1):
            share = 1.0 / (compliance * contacts.own[i, d])
            for one in range(ends.shape[1]):
                if ends[i, one] >= 0:
                    _add(contacts, i, d, share, edge, one, one, diagonal[ends[i, one]])
                for other in range(one):
                    at, first = entries[i, one, other], ends[i, one] < ends[i, other]
                    if at >= 0:
                        _add(
                            contacts, i, d, share, edge, one, other,
                            after[at] if first else before[at],
                        )  # fmt: skip
                        _add(
                            contacts, i, d, share, edge, other, one,
                            before[at] if first else after[at],
                        )  # fmt: skip
    return factored(equations)


@kernel
def step(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array,
    impulses: Array,
) -> None:  # fmt: skip
    """Add to impulses (m, 2) what changes the velocities as `Equations.right` asks.

    Parameters
    ----------
    contacts, compliance, status, edges
        Those of what was eliminated.
    equations : Equations
    impulses : (m, 2)
        Changed in place.
    """
    ends, rates, right = equations.ends, equations.rates, equations.right
    own, rows, columns = contacts.own, contacts.rows, contacts.columns
    for p in range(len(rates)):
        rates[p, 0] = rates[p, 1] = rates[p, 2] = 0.0
    for i in range(len(status)):
        if status[i] == OPEN:
            continue
        normal = right[i, 0] / (compliance * own[i, 0])
        tangential = edges[i] * normal
        if status[i] == STICKS:
            tangential = right[i, 1] / (compliance * own[i, 1])
        for side in range(ends.shape[1]):
            p = ends[i, side]
            if p >= 0:
                for k in range(3):
                    rates[p, k] += columns[i, 0, 3 * side + k] * normal
                    rates[p, k] += columns[i, 1, 3 * side + k] * tangential
    solved(equations)
    for i in range(len(status)):
        if status[i] == OPEN:
            continue
        normal, tangential = right[i]
        for side in range(ends.shape[1]):
            p = ends[i, side]
            if p >= 0:
                for k in range(3):
                    normal -= rows[i, 0, 3 * side + k] * rates[p, k]
                    tangential -= rows[i, 1, 3 * side + k] * rates[p, k]
        normal /= compliance * own[i, 0]
        impulses[i, 0] += normal
        if status[i] == STICKS:
            impulses[i, 1] += tangential / (compliance * own[i, 1])
        else:
            impulses[i, 1] += edges[i] * normal


@kernel
def _find_status(
    contacts: ContactRows, least: Array, begins: float, now: Array, centre: Array,
    compliance: float, rates: Array, status: Ints, edges: Array,
) -> bool:  # fmt: skip
    """Write the status of contacts by the natural map; False where it is as before.

    One without an impulse begins to press above a velocity `begins`.
    """
    different = False
    for i in range(len(now)):
        mu = slope(contacts.cones[i])
        if mu < 0.0:
            # What is guided slides without friction.
            status[i], edges[i] = STICKS if mu == HELD else SLIDES, 0.0
            continue
        normal, slip = contact_velocity(contacts, i, least, rates)
        wn, wt = contacts.own[i, 0], contacts.own[i, 1]
        press = wn * now[i, 0] - normal - compliance * wn * (now[i, 0] - centre[i, 0])
        shear = wt * now[i, 1] - slip - compliance * wt * (now[i, 1] - centre[i, 1])
        new, edge = SLIDES, math.copysign(mu, shear)
        if press <= (begins if now[i, 0] == 0.0 else 0.0):
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
        normal, slip = contact_velocity(contacts, i, least, rates)
        away, aside = now[i, 0] - centre[i, 0], now[i, 1] - centre[i, 1]
        equations.right[i, 0] = -normal - compliance * contacts.own[i, 0] * away
        equations.right[i, 1] = -slip - compliance * contacts.own[i, 1] * aside
    step(contacts, equations, compliance, status, edges, now)
    moved(contacts, now, rates)


@kernel
def _settled(
    contacts: ContactRows, equations: Equations, least: Array, begins: float, now: Array,
    centre: Array, compliance: float, rates: Array, status: Ints, edges: Array,
) -> tuple[bool, int]:  # fmt: skip
    """Take Newton's steps to a proximal point, in place; return if they settle, and how many."""
    for taken in range(_SETTLING + 1):
        changed = _find_status(
            contacts, least, begins, now, centre, compliance, rates, status, edges
        )
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
def _status_margin(
    mu: float, status: int, edge: float, which: int, impulse: Array, normal: float, slip: float
) -> float:
    """Return the margin that stays >= 0 while a contact keeps its status.

    Linear in impulse and velocity: of what is open the velocity; of what slides the normal impulse
    and the slip against friction; of what sticks how far it is from both edges.
    """
    if status == OPEN:
        return normal
    if status == STICKS:
        return mu * impulse[0] + (impulse[1] if which == _OTHER else -impulse[1])
    if which == _ONE:
        return impulse[0]
    return -slip if edge > 0.0 else slip


@kernel
def _change(mu: float, status: Ints, edges: Array, i: int, which: int, slip: float) -> int:
    """Give a contact its next status, in place; return which of its bounds it then begins at."""
    if status[i] == OPEN:
        status[i], edges[i] = SLIDES, -mu if slip > 0.0 else mu
        return _ONE
    if status[i] == STICKS:
        status[i], edges[i] = SLIDES, mu if which == _ONE else -mu
        return _OTHER
    if which == _ONE:
        status[i] = OPEN
        return _ONE
    status[i] = STICKS
    return _ONE if edges[i] > 0.0 else _OTHER


@kernel
def follow_point(
    contacts: ContactRows, equations: Equations, least: Array, now: Array, centre: Array,
    shift: Array, compliance: float, rates: Array, status: Ints, edges: Array,
) -> tuple[bool, int]:  # fmt: skip
    """Follow a proximal point from the one before; return if it is reached, and eliminations.

    Parameters
    ----------
    contacts, equations, least
    now : (m, 2)
        Impulses, equal to the centre; those that are reached, in place.
    centre : (m, 2)
    shift : (m, 2)
        With it these solve the contact laws.
    compliance : float
        That holds to the centre.
    rates : (n,)
        Is overwritten.
    status, edges : (m,)
        Of these impulses; those of what is reached, in place.
    """
    count, own = len(now), contacts.own
    along, felt = np.empty((count, 2)), np.empty_like(rates)
    left, way, turns, entered, begins = 1.0, -1.0, 0, -1, _ONE
    for change in range(_CHANGES):
        if not eliminated(contacts, equations, compliance, status, edges):
            return False, change
        moved(contacts, now, rates)
        for i in range(count):
            normal, slip = contact_velocity(contacts, i, least, rates)
            away, aside = now[i, 0] - centre[i, 0], now[i, 1] - centre[i, 1]
            equations.right[i, 0] = -normal - left * shift[i, 0] - compliance * own[i, 0] * away
            equations.right[i, 1] = -slip - left * shift[i, 1] - compliance * own[i, 1] * aside
        # Against rounding.
        step(contacts, equations, compliance, status, edges, now)
        moved(contacts, now, rates)
        for i in range(count):
            along[i, 0] = along[i, 1] = 0.0
            equations.right[i, 0], equations.right[i, 1] = -shift[i, 0], -shift[i, 1]
        step(contacts, equations, compliance, status, edges, along)
        moved(contacts, along, felt)
        if entered >= 0:
            i = entered
            normal, slip = contact_velocity(contacts, i, shift, felt)
            normal += compliance * own[i, 0] * along[i, 0]
            slip += compliance * own[i, 1] * along[i, 1]
            mu = slope(contacts.cones[i])
            opening = _status_margin(mu, status[i], edges[i], begins, along[i], normal, slip)
            way = 1.0 if opening > 0.0 else -1.0
            turns += 1 if way > 0.0 else 0
        first, which, nearest = -1, _ONE, math.inf
        for i in range(count):
            mu = slope(contacts.cones[i])
            if mu < 0.0:
                continue
            normal, slip = contact_velocity(contacts, i, least, rates)
            normal += left * shift[i, 0] + compliance * own[i, 0] * (now[i, 0] - centre[i, 0])
            slip += left * shift[i, 1] + compliance * own[i, 1] * (now[i, 1] - centre[i, 1])
            to_normal, to_slip = contact_velocity(contacts, i, shift, felt)
            to_normal += compliance * own[i, 0] * along[i, 0]
            to_slip += compliance * own[i, 1] * along[i, 1]
            for k in range(1 if status[i] == OPEN or mu == 0.0 else 2):
                if i == entered and k == begins:
                    continue
                falls = -way * _status_margin(
                    mu, status[i], edges[i], k, along[i], to_normal, to_slip
                )
                if falls > 0.0:
                    here = _status_margin(mu, status[i], edges[i], k, now[i], normal, slip)
                    if max(here, 0.0) < nearest * falls:
                        first, which, nearest = i, k, max(here, 0.0) / falls
        reached = way < 0.0 and nearest >= left
        if not reached and (first < 0 or turns > _TURNS):
            return False, change + 1
        far = left if reached else nearest
        for i in range(count):
            for d in range(2):
                now[i, d] += way * far * along[i, d]
        if reached:
            return True, change + 1
        left += way * far
        moved(contacts, now, rates)
        _, slip = contact_velocity(contacts, first, least, rates)
        slip += left * shift[first, 1]
        slip += compliance * own[first, 1] * (now[first, 1] - centre[first, 1])
        mu = slope(contacts.cones[first])
        begins, entered = _change(mu, status, edges, first, which, slip), first
    return False, _CHANGES


@kernel
def by_last_status(contacts: ContactRows, least: Array, impulses: Array) -> tuple[float, int]:
    """Solve contacts with open ones kept open; return the residual, and eliminations.

    Impulses are found from nothing, in place: of those with the same motion the smallest. What is
    open stays so as long as that solves the problem: a box that just fits under a lid is else stuck
    between that and the floor, in impulses without cause.
    """
    count, rates, equations = len(impulses), rates_of(contacts, 0), equations_of(contacts)
    status, edges, taken = np.full(count, -1), np.zeros(count), 0
    moved(contacts, impulses, rates)
    while taken < _SETTLING and _find_status(
        contacts, least, math.inf, impulses, impulses, _REFINING, rates, status, edges
    ):
        if not eliminated(contacts, equations, _REFINING, status, edges):
            return math.inf, taken + 1
        impulses[:] = 0.0
        rates[:] = 0.0
        left = math.inf
        for _ in range(_REFINEMENTS):
            missed = 0.0
            for i in range(count):
                normal, slip = contact_velocity(contacts, i, least, rates)
                if status[i] != OPEN:
                    missed = max(missed, abs(normal), abs(slip) if status[i] == STICKS else 0.0)
            if not missed < _FALLS * left:
                break
            left = missed
            _take_step(
                contacts, equations, least, impulses, impulses, _REFINING, rates, status, edges
            )
        taken += 1
    return residual(contacts, least, scale(contacts, least), impulses, rates), taken


@kernel
def by_proximal_points(
    contacts: ContactRows, least: Array, impulses: Array, allowed: float
) -> tuple[float, int]:
    """Improve impulses of contacts of bodies; return the residual of the best, and eliminations.

    Where no more than `VERIFIED` is allowed, centres follow as long as each halves what is missed.
    """
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
    exact = falls = allowed <= VERIFIED
    # Near a solution the status is known, which a small compliance solves at once.
    compliance, done, idle = min(max(lowest, _LEAST), _FIRST) if exact else _FIRST, 0, 0
    most = min(_MOST, _MOST_TIMES // count)
    while done < most and idle < _IDLE and (lowest > allowed or falls):
        good, taken = _settled(
            contacts, equations, least, 0.0, now, centre, compliance, rates, status, edges
        )
        done += taken
        if not good and is_known:
            put_rows(centre, now)
            status[:], edges[:] = known, known_edges
            good, taken = follow_point(
                contacts, equations, least, now, centre, shift, compliance, rates, status, edges
            )
            done += taken
        if good:
            moved(contacts, now, rates)
            left = residual(contacts, least, size, now, rates)
            idle += 1 if compliance == _LEAST else 0
            falls = exact and compliance > _LEAST and left < _FURTHER * lowest
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
        elif compliance >= _LARGEST or lowest <= allowed:
            break
        else:
            compliance = min(_GROWS * compliance, _LARGEST)
            put_rows(centre, now)
            moved(contacts, now, rates)
    return lowest, done
