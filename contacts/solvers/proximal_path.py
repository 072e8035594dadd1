"""The solution of contacts followed as what is asked of them changes, from status to status.

The parametric method of linear complementarity (Cottle, Pang and Stone 1992, 4.5; Lemke's algorithm
with the last solution in the place of its covering vector): velocities are shifted so that the
impulses at hand solve the contact laws exactly, and the shift is taken away. Impulses are linear in
it until a contact opens, closes, sticks or slides, which then has another status; the shift grows
again where that is the only way on.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import ContactRows, moved, seen, slope
from contacts.solvers.status_equations import OPEN, SLIDES, STICKS, Equations, eliminated, step
from statechart.arrays import Array, Ints
from statechart.kernels.jit import kernel

# Changes of status, and how many of them the shift may grow after.
_CHANGES, _TURNS = 160, 40
# What of a contact is about to end.
_FIRST, _SECOND = 0, 1


@kernel
def _kept(
    mu: float, status: int, edge: float, which: int, impulse: Array, normal: float, slip: float
) -> float:
    """Return what must not fall below zero while a contact keeps its status.

    Linear in impulse and velocity: of what is open the velocity; of what slides the normal impulse
    and the slip against friction; of what sticks how far it is from both edges.
    """
    if status == OPEN:
        return normal
    if status == STICKS:
        return mu * impulse[0] + (impulse[1] if which == _SECOND else -impulse[1])
    if which == _FIRST:
        return impulse[0]
    return -slip if edge > 0.0 else slip


@kernel
def _change(mu: float, status: Ints, edges: Array, i: int, which: int, slip: float) -> int:
    """Give a contact its next status, in place; return which of its bounds it then begins at."""
    if status[i] == OPEN:
        status[i], edges[i] = SLIDES, -mu if slip > 0.0 else mu
        return _FIRST
    if status[i] == STICKS:
        status[i], edges[i] = SLIDES, mu if which == _FIRST else -mu
        return _SECOND
    if which == _FIRST:
        status[i] = OPEN
        return _FIRST
    status[i] = STICKS
    return _FIRST if edges[i] > 0.0 else _SECOND


@kernel
def followed(
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
    left, way, turns, entered, begins = 1.0, -1.0, 0, -1, _FIRST
    for change in range(_CHANGES):
        if not eliminated(contacts, equations, compliance, status, edges):
            return False, change
        moved(contacts, now, rates)
        for i in range(count):
            normal, slip = seen(contacts, i, least, rates)
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
            normal, slip = seen(contacts, i, shift, felt)
            normal += compliance * own[i, 0] * along[i, 0]
            slip += compliance * own[i, 1] * along[i, 1]
            mu = slope(contacts.cones[i])
            opening = _kept(mu, status[i], edges[i], begins, along[i], normal, slip)
            way = 1.0 if opening > 0.0 else -1.0
            turns += 1 if way > 0.0 else 0
        first, which, nearest = -1, _FIRST, math.inf
        for i in range(count):
            mu = slope(contacts.cones[i])
            if mu < 0.0:
                continue
            normal, slip = seen(contacts, i, least, rates)
            normal += left * shift[i, 0] + compliance * own[i, 0] * (now[i, 0] - centre[i, 0])
            slip += left * shift[i, 1] + compliance * own[i, 1] * (now[i, 1] - centre[i, 1])
            to_normal, to_slip = seen(contacts, i, shift, felt)
            to_normal += compliance * own[i, 0] * along[i, 0]
            to_slip += compliance * own[i, 1] * along[i, 1]
            for k in range(1 if status[i] == OPEN or mu == 0.0 else 2):
                if i == entered and k == begins:
                    continue
                falls = -way * _kept(mu, status[i], edges[i], k, along[i], to_normal, to_slip)
                if falls > 0.0:
                    here = _kept(mu, status[i], edges[i], k, now[i], normal, slip)
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
        _, slip = seen(contacts, first, least, rates)
        slip += left * shift[first, 1]
        slip += compliance * own[first, 1] * (now[first, 1] - centre[first, 1])
        mu = slope(contacts.cones[first])
        begins, entered = _change(mu, status, edges, first, which, slip), first
    return False, _CHANGES
