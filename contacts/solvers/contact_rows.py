"""Contacts of bodies by the rows that they are felt in: impulses one contact at a time.

Nonsmooth Gauss-Seidel (Moreau 1988; Jean 1999): contact by contact the two impulses that solve its
law exactly, accelerated as a nonlinear conjugate gradient method (Silcowitz, Niebel and Erleben
2010). Nothing is assembled: a sweep costs the same for every contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.saddle_point import SMALLEST
from statechart.arrays import Array, Ints
from statechart.kernels.copies import put, put_rows
from statechart.kernels.jit import kernel

HELD, GUIDED = -1.0, -2.0
"""In the place of the first number of a cone: both directions of a row are held, whatever it takes;
its first one is."""

STEEPEST = 2.0**-12
"""No cone's edge is steeper: its normal part, of 1, counts as at least this."""

LAW = 9
"""Numbers that `law_of` writes."""

BEST, NOW, CHANGE, ALONG, LEAST, TRIAL, SAVED = range(7)
"""What solvers have in `ContactRows.spare`: the best impulses, those of a sweep or a step, by how
much they change, and how they went on; what is asked; impulses that are tried, and kept."""

PAIR = 2
"""Bodies that a contact of bodies moves. The block behind them is its pad, if there are pads."""

# What a contact's own impulses do to its velocity is known to this part.
_ROW_ROUND_OFF = 1e-13
# Of the fastest slip: an approach below this is what rounding leaves of rest, and what impulses are
# for is friction. Bodies of grams that walls press on fall past these by 1.6e-3 m/s in a step, and
# approach them at 4e-19: missing a thousandth of that is nothing.
_RESTING = 1e-7
# Changes that are the same in every sweep, as where bodies wedge, are so but for rounding.
_GROWN = 1.001


class ContactRows(NamedTuple):
    """Rows of contacts that are coupled through the bodies that they move."""

    # (m, s): which bodies a contact moves, of three rates each, that stand side by side.
    bodies: Ints
    moving: int  # How many bodies there are; what nothing moves has this number.
    # (m, 2, 3 s): its velocity, normal and tangential, per unit of these rates; and their change
    # per unit impulse along each.
    rows: Array
    columns: Array
    own: Array  # (m, 3): its compliances: normal, tangential, between the two.
    # (m, 2): ``(cone_n, cone_t)``, with ``mu = cone_t / cone_n``; of joints see `HELD`.
    cones: Array
    laws: Array  # (m, LAW): see `law_of`.
    # Where solvers work, who need arrays for every island: rates of what moves, and of what nothing
    # moves, how they went on, and before; see `BEST`.
    rates: Array  # shape (3, 3 b + 3)
    spare: Array  # shape (7, m, 2)
    # 1 where all contacts move the same blocks, of coordinates; 0 where each moves bodies of its
    # own. 1 where contacts of bodies may have pads.
    shared: int
    padded: int

    @classmethod
    def allocate(cls, most: int, bodies: int, padded: int = 0, shared: int = 0) -> ContactRows:
        """Return place for so many contacts of so many bodies, with pads if they are `padded`.

        Behind these all may move `shared` blocks of coordinates.
        """
        blocks, sides = bodies + padded * most + shared, PAIR + padded + shared
        return cls(
            np.empty((most, sides), np.int64),
            0,
            np.empty((most, 2, 3 * sides)),
            np.empty((most, 2, 3 * sides)),
            np.empty((most, 3)),
            np.empty((most, 2)),
            np.empty((most, LAW)),
            np.empty((3, 3 * blocks + 3)),
            np.empty((7, most, 2)),
            0,
            padded,
        )


BEGINS, ON_TRIAL = 2, 3
"""Ways of slips beside 1, -1 and 0, at rest: kinetic friction begins in the step (2 or -2); static
friction is asked to hold the slip as it was before the step."""


@kernel
def complete(contacts: ContactRows) -> None:
    """Write what a contact's own impulses do to its velocity, and how it is solved alone."""
    rows, columns, own = contacts.rows, contacts.columns, contacts.own
    for i in range(len(rows)):
        own[i, 0] = own[i, 1] = own[i, 2] = 0.0
        for k in range(rows.shape[2]):
            own[i, 0] += rows[i, 0, k] * columns[i, 0, k]
            own[i, 1] += rows[i, 1, k] * columns[i, 1, k]
            own[i, 2] += rows[i, 0, k] * columns[i, 1, k]
        law_of(own[i], slope(contacts.cones[i]), contacts.laws[i])


@kernel
def rows_of(contacts: ContactRows, chosen: Ints) -> ContactRows:
    """Return some of the contacts."""
    return ContactRows(
        contacts.bodies[chosen], contacts.moving, contacts.rows[chosen], contacts.columns[chosen],
        contacts.own[chosen], contacts.cones[chosen], contacts.laws[chosen], contacts.rates,
        contacts.spare, contacts.shared, contacts.padded,
    )  # fmt: skip


@kernel
def slope(cone: Array) -> float:
    """Return the coefficient of friction, which `STEEPEST` bounds; or `HELD`, or `GUIDED`."""
    if cone[0] < 0.0:
        return cone[0]
    return cone[1] / max(cone[0], STEEPEST)


@kernel
def overload(slip: float, own: float, normal: float, cone: Array) -> float:
    """Return the impulse that ends a slip, over the largest one of friction."""
    most = own * normal * cone[1]
    return abs(slip) * cone[0] / most if most > 0.0 else math.inf


@kernel
def rates_of(contacts: ContactRows, which: int) -> Array:
    """Return rates of all bodies, and of what nothing moves, of those to work with: none."""
    rates = contacts.rates[which, : 3 * contacts.moving + 3]
    for k in range(len(rates)):
        rates[k] = 0.0
    return rates


@kernel
def add(contacts: ContactRows, i: int, normal: float, tangential: float, rates: Array) -> None:
    """Add to the rates what an impulse of contact i does to them."""
    bodies, columns = contacts.bodies, contacts.columns
    for side in range(bodies.shape[1]):
        at, k = 3 * bodies[i, side], 3 * side
        rates[at] += columns[i, 0, k] * normal + columns[i, 1, k] * tangential
        rates[at + 1] += columns[i, 0, k + 1] * normal + columns[i, 1, k + 1] * tangential
        rates[at + 2] += columns[i, 0, k + 2] * normal + columns[i, 1, k + 2] * tangential


@kernel
def without(contacts: ContactRows, i: int, rates: Array) -> None:
    """Write that what contact i moves is at rest."""
    for side in range(contacts.bodies.shape[1]):
        for k in range(3):
            rates[3 * contacts.bodies[i, side] + k] = 0.0


@kernel
def along(contacts: ContactRows, i: int, d: int, rates: Array) -> float:
    """Return what rates are as a velocity of contact i, normal (0) or tangential (1)."""
    bodies, rows, total = contacts.bodies, contacts.rows, 0.0
    for side in range(bodies.shape[1]):
        at, k = 3 * bodies[i, side], 3 * side
        whole = rows[i, d, k] * rates[at] + rows[i, d, k + 1] * rates[at + 1]
        total += whole + rows[i, d, k + 2] * rates[at + 2]
    return total


@kernel
def contact_velocity(
    contacts: ContactRows, i: int, least: Array, rates: Array
) -> tuple[float, float]:
    """Return the velocity of contact i, normal and tangential."""
    bodies, rows = contacts.bodies, contacts.rows
    normal, slip = least[i, 0], least[i, 1]
    for side in range(bodies.shape[1]):
        at, k = 3 * bodies[i, side], 3 * side
        x, y, turn = rates[at], rates[at + 1], rates[at + 2]
        normal += rows[i, 0, k] * x + rows[i, 0, k + 1] * y + rows[i, 0, k + 2] * turn
        slip += rows[i, 1, k] * x + rows[i, 1, k + 1] * y + rows[i, 1, k + 2] * turn
    return normal, slip


@kernel
def moved(contacts: ContactRows, impulses: Array, rates: Array) -> None:
    """Write how impulses (m, 2) change the rates."""
    for k in range(len(rates)):
        rates[k] = 0.0
    for i in range(len(impulses)):
        if impulses[i, 0] != 0.0 or impulses[i, 1] != 0.0:
            add(contacts, i, impulses[i, 0], impulses[i, 1], rates)


@kernel
def yields(contacts: ContactRows, i: int) -> bool:
    """Return whether contact i is compliant: it moves a pad."""
    return contacts.padded == 1 and contacts.rows[i, 0, 7] != 0.0


@kernel
def joint_work(contacts: ContactRows, impulses: Array, before: Array, free: Array) -> float:
    """Return the work of joints and compliant contacts in a step, if they do any.

    Joints give what they took, as their arms turn; a spring gives back what it stored.
    """
    rates, work = rates_of(contacts, 0), 0.0
    moved(contacts, impulses, rates)
    for i in range(len(impulses)):
        if slope(contacts.cones[i]) < 0.0 or yields(contacts, i):
            for d in range(1 if yields(contacts, i) else 2):
                both = before[i, d] + free[i, d] + along(contacts, i, d, rates)
                work += 0.5 * impulses[i, d] * both
    return max(work, 0.0)


@kernel
def law_of(own: Array, mu: float, law: Array) -> None:
    """Write what `one_contact` needs to solve a contact's law, whatever its velocity."""
    wn, wt, wx = own
    det = wn * wt - wx * wx
    # Where both directions are one, nothing sticks.
    law[0] = mu if det > 0.0 or mu < 0.0 else 0.0
    law[1], law[2], law[3], law[4] = wt / det, wn / det, wx / det, wx / wn
    for at, edge in ((5, max(mu, 0.0)), (7, -max(mu, 0.0))):
        whole = wn + edge * wx
        law[at], law[at + 1] = 1.0 / (whole if whole > 0.0 else wn), edge


@kernel
def one_contact(law: Array, normal: float, slip: float) -> tuple[float, float]:
    """Return the impulses of a single contact whose velocities are these without any."""
    mu = law[0]
    if not (normal < 0.0 or mu < 0.0):
        return 0.0, 0.0
    pn, pt = law[3] * slip - law[1] * normal, law[3] * normal - law[2] * slip
    if mu == HELD or (pn > 0.0 and abs(pt) <= mu * pn):
        return pn, pt
    # Friction is against the slip that there would be without it (as mu grows from zero that
    # slows down, and comes to rest before the normal impulse that it makes is without bound).
    at = 7 if slip - law[4] * normal > 0.0 else 5
    pn = -normal * law[at]
    return pn, law[at + 1] * pn


@kernel
def _to_stop(cone: Array, normal: float, slip: float) -> float:
    """Return what impulses of a contact are for: its approach, or a part of its slip."""
    mu = slope(cone)
    if mu < 0.0:
        return max(abs(normal), abs(slip))
    return max(-normal, _RESTING * abs(slip) if mu > 0.0 else 0.0)


@kernel
def scale(contacts: ContactRows, least: Array) -> float:
    """Return what residuals are parts of: the fastest approach without impulses (m, 2).

    Or a ten-millionth of the fastest slip; of what is held what it moves at.
    """
    size = 0.0
    for i in range(len(least)):
        size = max(size, _to_stop(contacts.cones[i], least[i, 0], least[i, 1]))
    return size


@kernel
def scale_of_sum(contacts: ContactRows, free: Array, wanted: Array) -> float:
    """Return the `scale` of the sum of both."""
    size = 0.0
    for i in range(len(free)):
        normal, slip = free[i, 0] + wanted[i, 0], free[i, 1] + wanted[i, 1]
        size = max(size, _to_stop(contacts.cones[i], normal, slip))
    return size


@kernel
def residual(
    contacts: ContactRows, least: Array, size: float, impulses: Array, rates: Array
) -> float:
    """Return how far impulses are from those of the contact laws, in parts of their `scale`.

    That is the natural map of each contact (complementarity, cone, maximal dissipation), as a
    velocity: how far ``P - u / w`` projected into the cone is from P.
    """
    missed, own, cones = 0.0, contacts.own, contacts.cones
    for i in range(len(impulses)):
        normal, slip = contact_velocity(contacts, i, least, rates)
        if not math.isfinite(normal + slip):
            return math.inf
        pn, pt = impulses[i]
        wn, wt = own[i, 0], own[i, 1]
        mu = slope(cones[i])
        if mu < 0.0:
            missed = max(missed, abs(normal), abs(slip) if mu == HELD else 0.0)
            size = max(size, _ROW_ROUND_OFF * wn * abs(pn), _ROW_ROUND_OFF * wt * abs(pt))
            continue
        missed = max(missed, abs(wn * pn - max(wn * pn - normal, 0.0)))
        edge = wt * mu * pn
        missed = max(missed, abs(wt * pt - min(max(wt * pt - slip, -edge), edge)))
        size = max(size, _ROW_ROUND_OFF * wn * pn)
    # Below it nothing has digits: bodies beside each other approach at 1e-320 m/s.
    if missed < SMALLEST:
        return 0.0
    return missed / size if size > 0.0 else math.inf


@kernel
def measured(contacts: ContactRows, least: Array, size: float, impulses: Array) -> float:
    """Return the `residual` of impulses, whose rates the first of `ContactRows.rates` then are."""
    rates = rates_of(contacts, 0)
    moved(contacts, impulses, rates)
    return residual(contacts, least, size, impulses, rates)


@kernel
def _sweep(
    contacts: ContactRows, least: Array, impulses: Array, rates: Array, change: Array
) -> tuple[float, float]:
    """Solve contact by contact; write the changes, and return their square as an energy.

    And the largest change, as a velocity: that is what contacts missed when it was their turn.
    """
    total = most = 0.0
    own, laws = contacts.own, contacts.laws
    for i in range(len(impulses)):
        normal, slip = contact_velocity(contacts, i, least, rates)
        before, beside = impulses[i, 0], impulses[i, 1]
        wn, wt, wx = own[i, 0], own[i, 1], own[i, 2]
        pn, pt = one_contact(
            laws[i], normal - wn * before - wx * beside, slip - wx * before - wt * beside
        )
        dn, dt = pn - before, pt - beside
        impulses[i, 0], impulses[i, 1] = pn, pt
        change[i, 0], change[i, 1] = dn, dt
        if dn != 0.0 or dt != 0.0:
            add(contacts, i, dn, dt, rates)
            total += wn * dn * dn + wt * dt * dt
            most = max(most, wn * abs(dn), wt * abs(dt))
    return total, most


@kernel
def swept(
    contacts: ContactRows, least: Array, size: float, lowest: float, impulses: Array,
    allowed: float, most: int,
) -> tuple[float, int]:  # fmt: skip
    """Sweep until the residual is as allowed; return that of the best impulses, and the sweeps.

    Parameters
    ----------
    contacts : ContactRows
        Its rates are those of the impulses (see `measured`).
    least : (m, 2)
        Velocities without impulses, which these must make no less than zero.
    size, lowest : float
        Their `scale`, and the residual of the impulses.
    impulses : (m, 2)
        Where to start; the best ones, in place.
    allowed : float
        Residual.
    most : int
        Sweeps.
    """
    m, spare = len(impulses), contacts.spare
    best, now, change, along = spare[BEST, :m], spare[NOW, :m], spare[CHANGE, :m], spare[ALONG, :m]
    put_rows(impulses, best)
    put_rows(impulses, now)
    along[:] = 0.0
    rates, carried = contacts.rates[0, : 3 * contacts.moving + 3], rates_of(contacts, 1)
    earlier, before, count = contacts.rates[2, : len(rates)], 0.0, 0
    while count < most and lowest > allowed:
        put(rates, earlier)
        energy, missed = _sweep(contacts, least, now, rates, change)
        count += 1
        # The residual takes half a sweep: it is looked at where it may do.
        if energy == 0.0 or missed <= allowed * size or count == most:
            left = residual(contacts, least, size, now, rates)
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
        for i in range(m):
            for d in range(2):
                now[i, d] += beta * along[i, d]
                along[i, d] = beta * along[i, d] + change[i, d]
    put_rows(best, impulses)
    return lowest, count
