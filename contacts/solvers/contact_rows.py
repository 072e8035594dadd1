"""Contacts of bodies by the rows that they are felt in: impulses one contact at a time.

Nonsmooth Gauss-Seidel (Moreau 1988; Jean 1999): contact by contact the two impulses that solve its
law exactly, accelerated as a nonlinear conjugate gradient method (Silcowitz, Niebel and Erleben
2010). Nothing is assembled: a sweep costs the same for every contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_lcp_kernels import STEEPEST
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put_rows
from statechart.kernels.jit import late, part

HELD, GUIDED = -1.0, -2.0
"""In the place of the first number of a cone: both directions of a row are held, whatever it takes;
its first one is."""

# What a contact's own impulses do to its velocity is known to this part.
_ROUNDING = 1e-13
# The residual, which takes half a sweep, is looked at after so many.
_LOOKED = 8
# Changes that are the same in every sweep, as where bodies wedge, are so but for rounding.
_GROWN = 1.001


class ContactRows(NamedTuple):
    """Contacts that feel each other through what they move.

    Attributes
    ----------
    places : (m, w) array of int
        Which rates a contact moves.
    rows, columns : (m, 2, w)
        Its velocity, normal and tangential, per unit of these rates; and their change per unit
        impulse along each.
    own : (m, 3)
        Its compliances: normal, tangential, between the two.
    cones : (m, 2)
        ``(cone_n, cone_t)``, with ``mu = cone_t / cone_n``; of joints see `HELD`.
    """

    places: Ints
    rows: Array
    columns: Array
    own: Array
    cones: Array


@part
def own_compliances(rows: Array, columns: Array, own: Array) -> None:
    """Write what a contact's own impulses do to its velocity: see `ContactRows.own`."""
    for i in range(len(rows)):
        own[i, 0] = own[i, 1] = own[i, 2] = 0.0
        for k in range(rows.shape[2]):
            own[i, 0] += rows[i, 0, k] * columns[i, 0, k]
            own[i, 1] += rows[i, 1, k] * columns[i, 1, k]
            own[i, 2] += rows[i, 0, k] * columns[i, 1, k]


@part
def slope(cone: Array) -> float:
    """Return the coefficient of friction, which `STEEPEST` bounds; or `HELD`, or `GUIDED`."""
    if cone[0] < 0.0:
        return cone[0]
    return cone[1] / max(cone[0], STEEPEST)


@part
def rates_moved(contacts: ContactRows) -> int:
    """Return how many rates there are."""
    places, count = contacts.places, 0
    for i in range(places.shape[0]):
        for k in range(places.shape[1]):
            count = max(count, places[i, k] + 1)
    return count


@part
def add(contacts: ContactRows, i: int, normal: float, tangential: float, rates: Array) -> None:
    """Add to the rates what an impulse of contact i does to them."""
    places, columns = contacts.places, contacts.columns
    for k in range(places.shape[1]):
        rates[places[i, k]] += columns[i, 0, k] * normal + columns[i, 1, k] * tangential


@part
def seen(contacts: ContactRows, i: int, least: Array, rates: Array) -> tuple[float, float]:
    """Return the velocity of contact i, normal and tangential."""
    places, rows = contacts.places, contacts.rows
    normal, tangential = least[i, 0], least[i, 1]
    for k in range(places.shape[1]):
        rate = rates[places[i, k]]
        normal += rows[i, 0, k] * rate
        tangential += rows[i, 1, k] * rate
    return normal, tangential


@part
def moved(contacts: ContactRows, impulses: Array, rates: Array) -> None:
    """Write how impulses (m, 2) change the rates."""
    for k in range(len(rates)):
        rates[k] = 0.0
    for i in range(len(impulses)):
        if impulses[i, 0] != 0.0 or impulses[i, 1] != 0.0:
            add(contacts, i, impulses[i, 0], impulses[i, 1], rates)


@part
def one_contact(own: Array, mu: float, normal: float, slip: float) -> tuple[float, float]:
    """Return the impulses of a single contact whose velocities are these without any."""
    wn, wt, wx = own
    if mu < 0.0:
        if mu == GUIDED:
            return -normal / wn, 0.0
        det = wn * wt - wx * wx
        return (wx * slip - wt * normal) / det, (wx * normal - wn * slip) / det
    if not normal < 0.0:
        return 0.0, 0.0
    first = -normal / wn
    if mu == 0.0:
        return first, 0.0
    det = wn * wt - wx * wx
    if det > 0.0:
        pn, pt = (wx * slip - wt * normal) / det, (wx * normal - wn * slip) / det
        if abs(pt) <= mu * pn:
            return pn, pt
    # Friction is against the slip that there would be without it (as mu grows from zero that
    # slows down, and comes to rest before the normal impulse that it makes is without bound).
    edge = -mu if slip + wx * first > 0.0 else mu
    whole = wn + edge * wx
    pn = -normal / whole if whole > 0.0 else first
    return pn, edge * pn


@part
def residual(contacts: ContactRows, least: Array, impulses: Array, rates: Array) -> float:
    """Return how far impulses are from those of the contact laws, relative to the approaches.

    That is the natural map of each contact (complementarity, cone, maximal dissipation), as a
    velocity: how far ``P - u / w`` projected into the cone is from P; over the fastest approach
    that there would be without impulses.
    """
    missed = size = 0.0
    own, cones = contacts.own, contacts.cones
    for i in range(len(impulses)):
        normal, slip = seen(contacts, i, least, rates)
        if not math.isfinite(normal + slip):
            return math.inf
        pn, pt = impulses[i]
        wn, wt = own[i, 0], own[i, 1]
        mu = slope(cones[i])
        if mu < 0.0:
            missed = max(missed, abs(normal), abs(slip) if mu == HELD else 0.0)
            size = max(size, abs(least[i, 0]), abs(least[i, 1]))
            size = max(size, _ROUNDING * wn * abs(pn), _ROUNDING * wt * abs(pt))
            continue
        missed = max(missed, abs(wn * pn - max(wn * pn - normal, 0.0)))
        edge = wt * mu * pn
        missed = max(missed, abs(wt * pt - min(max(wt * pt - slip, -edge), edge)))
        size = max(size, -least[i, 0], _ROUNDING * wn * pn)
    if missed == 0.0:
        return 0.0
    return missed / size if size > 0.0 else math.inf


@part
def _sweep(
    contacts: ContactRows, least: Array, impulses: Array, rates: Array, change: Array
) -> float:
    """Solve contact by contact; write the changes, and return their square as an energy."""
    total = 0.0
    own, cones = contacts.own, contacts.cones
    for i in range(len(impulses)):
        normal, slip = seen(contacts, i, least, rates)
        before, beside = impulses[i]
        wn, wt, wx = own[i]
        pn, pt = one_contact(
            own[i], slope(cones[i]), normal - wn * before - wx * beside,
            slip - wx * before - wt * beside,
        )  # fmt: skip
        dn, dt = pn - before, pt - beside
        impulses[i, 0], impulses[i, 1] = pn, pt
        change[i, 0], change[i, 1] = dn, dt
        if dn != 0.0 or dt != 0.0:
            add(contacts, i, dn, dt, rates)
            total += wn * dn * dn + wt * dt * dt
    return total


@late
def swept(
    contacts: ContactRows, least: Array, impulses: Array, allowed: float, most: int, count: int
) -> tuple[float, int]:
    """Sweep until the residual is as allowed; return that of the best impulses, and all sweeps.

    Parameters
    ----------
    contacts : ContactRows
    least : (m, 2)
        Velocities without impulses, which these must make no less than zero.
    impulses : (m, 2)
        Where to start; the best ones, in place.
    allowed : float
        Residual.
    most : int
        Sweeps; `count` are done before.
    """
    rates = np.zeros(rates_moved(contacts))
    moved(contacts, impulses, rates)
    best, lowest = impulses.copy(), residual(contacts, least, impulses, rates)
    now, change = impulses.copy(), np.empty((len(impulses), 2))
    along, carried = np.zeros((len(impulses), 2)), np.zeros(len(rates))
    earlier = rates.copy()
    before = 0.0
    for sweep in range(most):
        if lowest <= allowed:
            break
        for k in range(len(rates)):
            earlier[k] = rates[k]
        energy = _sweep(contacts, least, now, rates, change)
        count += 1
        if energy == 0.0 or sweep % _LOOKED == _LOOKED - 1 or sweep == most - 1:
            left = residual(contacts, least, now, rates)
            if left < lowest:
                lowest = left
                put_rows(now, best)
            if energy == 0.0:
                break
        # Fletcher and Reeves, started anew where the changes grow.
        beta = min(energy / before, 1.0) if energy <= _GROWN * before else 0.0
        before = energy
        for k in range(len(rates)):
            step = rates[k] - earlier[k]
            rates[k] += beta * carried[k]
            carried[k] = beta * carried[k] + step
        for i in range(len(now)):
            for d in range(2):
                now[i, d] += beta * along[i, d]
                along[i, d] = beta * along[i, d] + change[i, d]
    put_rows(best, impulses)
    return lowest, count
