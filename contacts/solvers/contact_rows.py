"""Contacts as rows on rigid bodies, and Gauss-Seidel sweeps over them.

Nonsmooth Gauss-Seidel (Moreau 1988; Jean 1999) solves the law of each contact exactly in turn,
accelerated as a nonlinear conjugate gradient method (Silcowitz, Niebel and Erleben 2010). The
Delassus matrix W is never assembled: a sweep costs the same for every contact.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.saddle_point import SMALLEST
from statechart.arrays import Array, Ints
from statechart.kernels.copies import copy_numbers, copy_rows
from statechart.kernels.jit import kernel

HELD, GUIDED = -1.0, -2.0
"""Markers in place of the first cone entry: both rows are bilateral (`HELD`), or the first one is
(`GUIDED`)."""

STEEPEST = 2.0**-12
"""Smallest normal component of a unit cone edge: it bounds the friction coefficient."""

LAW = 9
"""Numbers per contact that `write_law` writes."""

BEST, CURRENT, CHANGE, DIRECTION, LEAST, TRIAL, SAVED = range(7)
"""Slots of `ContactRows.spare`: best impulses, current ones, their change, search direction, right
side q, trial impulses, saved impulses."""

PAIR = 2
"""Bodies per contact. The third block is the contact's pad, if there are pads."""

PAD = 3 * PAIR + 1
"""Column of a compliant contact's pad along the normal, in `ContactRows.rows`."""

RESTING = 1e-6
"""Part of the speeds of bodies in contact below which an approach is no scale of residuals: of that
`contacts.solvers.proximal_points.VERIFIED` is the round-off of the speeds."""

# Round-off margin for "changes grow": wedged bodies change equally in every sweep.
_GROWN = 1.001


class ContactRows(NamedTuple):
    """Contact rows, coupled through the bodies that they move."""

    # (m, s): bodies that a contact moves, three rates each, stored side by side.
    bodies: Ints
    moving: int  # Number of bodies, and index of the fixed world.
    # (m, 2, 3 s): J, normal and tangential row, and M^-1 J^T, on these rates.
    rows: Array
    columns: Array
    own: Array  # (m, 3): its diagonal block of W: W_nn, W_tt, W_nt.
    # (m, 2): ``(cone_n, cone_t)``, with ``mu = cone_t / cone_n``; joints: see `HELD`.
    cones: Array
    laws: Array  # (m, LAW): see `write_law`.
    # Solver workspace. Rates of the bodies and the world: current, search direction, previous.
    # Impulses: slots `BEST` to `SAVED`.
    rates: Array  # shape (3, 3 b + 3)
    spare: Array  # shape (7, m, 2)
    # 1 if all contacts move the same coordinate blocks; 0 if each moves bodies of its own. 1 if
    # contacts of bodies may have pads.
    shared: int
    padded: int
    floor: Array  # (1,): least `velocity_scale`.

    @classmethod
    def allocate(cls, most: int, bodies: int, padded: int = 0, shared: int = 0) -> ContactRows:
        """Allocate rows for so many contacts of so many bodies, with pads if they are `padded`.

        Then follow `shared` coordinate blocks that all contacts may move.
        """
        blocks, sides = bodies + padded * most + shared, PAIR + padded + shared
        return cls(
            np.empty((most, sides), np.int64), 0, np.empty((most, 2, 3 * sides)),
            np.empty((most, 2, 3 * sides)), np.empty((most, 3)), np.empty((most, 2)),
            np.empty((most, LAW)), np.empty((3, 3 * blocks + 3)), np.empty((7, most, 2)), 0, padded,
            np.zeros(1),
        )  # fmt: skip


BEGINS, ON_TRIAL = 2, 3
"""Friction directions besides 1, -1 and 0 (rest): kinetic friction begins in the step (2 or -2);
static friction tries to keep the slip of the step's start."""


@kernel
def write_diagonal_blocks(contacts: ContactRows) -> None:
    """Write the diagonal blocks of W, and the constants of the one-contact solution."""
    rows, columns, own = contacts.rows, contacts.columns, contacts.own
    for i in range(len(rows)):
        own[i, 0] = own[i, 1] = own[i, 2] = 0.0
        for k in range(rows.shape[2]):
            own[i, 0] += rows[i, 0, k] * columns[i, 0, k]
            own[i, 1] += rows[i, 1, k] * columns[i, 1, k]
            own[i, 2] += rows[i, 0, k] * columns[i, 1, k]
        write_law(own[i], friction_coefficient(contacts.cones[i]), contacts.laws[i])


@kernel
def select_rows(contacts: ContactRows, chosen: Ints) -> ContactRows:
    """Return the rows of the `chosen` contacts."""
    return ContactRows(
        contacts.bodies[chosen], contacts.moving, contacts.rows[chosen], contacts.columns[chosen],
        contacts.own[chosen], contacts.cones[chosen], contacts.laws[chosen], contacts.rates,
        contacts.spare, contacts.shared, contacts.padded, contacts.floor,
    )  # fmt: skip


@kernel
def friction_coefficient(cone: Array) -> float:
    """Return the coefficient of friction, bounded by `STEEPEST`; or `HELD`, or `GUIDED`."""
    if cone[0] < 0.0:
        return cone[0]
    return cone[1] / max(cone[0], STEEPEST)


@kernel
def overload(slip: float, own: float, normal: float, cone: Array) -> float:
    """Return the impulse that ends a slip, relative to the largest friction impulse."""
    most = own * normal * cone[1]
    return abs(slip) * cone[0] / most if most > 0.0 else math.inf


@kernel
def zero_rates(contacts: ContactRows, which: int) -> Array:
    """Return a buffer of rates of all bodies and the world, set to zero."""
    rates = contacts.rates[which, : 3 * contacts.moving + 3]
    for k in range(len(rates)):
        rates[k] = 0.0
    return rates


@kernel
def apply_impulse(
    contacts: ContactRows, i: int, normal: float, tangential: float, rates: Array
) -> None:
    """Add M^-1 J^T p of contact i to the rates."""
    bodies, columns = contacts.bodies, contacts.columns
    for side in range(bodies.shape[1]):
        at, k = 3 * bodies[i, side], 3 * side
        rates[at] += columns[i, 0, k] * normal + columns[i, 1, k] * tangential
        rates[at + 1] += columns[i, 0, k + 1] * normal + columns[i, 1, k + 1] * tangential
        rates[at + 2] += columns[i, 0, k + 2] * normal + columns[i, 1, k + 2] * tangential


@kernel
def clear_rates(contacts: ContactRows, i: int, rates: Array) -> None:
    """Set the rates of the bodies of contact i to zero."""
    for side in range(contacts.bodies.shape[1]):
        for k in range(3):
            rates[3 * contacts.bodies[i, side] + k] = 0.0


@kernel
def row_velocity(contacts: ContactRows, i: int, d: int, rates: Array) -> float:
    """Return the velocity J v of contact i, normal (d = 0) or tangential (d = 1)."""
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
def write_velocity_change(contacts: ContactRows, impulses: Array, rates: Array) -> None:
    """Write how impulses (m, 2) change the rates."""
    for k in range(len(rates)):
        rates[k] = 0.0
    for i in range(len(impulses)):
        if impulses[i, 0] != 0.0 or impulses[i, 1] != 0.0:
            apply_impulse(contacts, i, impulses[i, 0], impulses[i, 1], rates)


@kernel
def is_compliant(contacts: ContactRows, i: int) -> bool:
    """Return whether contact i is compliant: it moves a pad."""
    return contacts.padded == 1 and contacts.rows[i, 0, PAD] != 0.0


@kernel
def _row_work(
    contacts: ContactRows, i: int, d: int, impulses: Array, before: Array, free: Array, rates: Array
) -> float:
    """Return the work of an impulse along d in a step in which all impulses add `rates`."""
    both = before[i, d] + free[i, d] + row_velocity(contacts, i, d, rates)
    return 0.5 * impulses[i, d] * both


@kernel
def joint_work(contacts: ContactRows, impulses: Array, before: Array, free: Array) -> float:
    """Return the work of joints in a step: a joint returns work as its lever arm turns."""
    rates, work = zero_rates(contacts, 0), 0.0
    write_velocity_change(contacts, impulses, rates)
    for i in range(len(impulses)):
        if friction_coefficient(contacts.cones[i]) < 0.0:
            for d in range(2):
                work += _row_work(contacts, i, d, impulses, before, free, rates)
    return work


@kernel
def returned_work(contacts: ContactRows, impulses: Array, before: Array, free: Array) -> float:
    """Return the positive part of the work of joints and compliant contacts in a step.

    A compliant contact returns stored energy.
    """
    work = joint_work(contacts, impulses, before, free)
    rates = zero_rates(contacts, 0)
    write_velocity_change(contacts, impulses, rates)
    for i in range(len(impulses)):
        if is_compliant(contacts, i):
            work += _row_work(contacts, i, 0, impulses, before, free, rates)
    return max(work, 0.0)


@kernel
def write_law(own: Array, mu: float, law: Array) -> None:
    """Write the constants with which `one_contact` solves a contact's law for any velocity."""
    wn, wt, wx = own
    det = wn * wt - wx * wx
    # If W is singular, both rows are one direction, and nothing sticks.
    law[0] = mu if det > 0.0 or mu < 0.0 else 0.0
    law[1], law[2], law[3], law[4] = wt / det, wn / det, wx / det, wx / wn
    for at, edge in ((5, max(mu, 0.0)), (7, -max(mu, 0.0))):
        whole = wn + edge * wx
        law[at], law[at + 1] = 1.0 / (whole if whole > 0.0 else wn), edge


@kernel
def one_contact(law: Array, normal: float, slip: float) -> tuple[float, float]:
    """Return the impulses of a single contact with these velocities at zero impulse."""
    mu = law[0]
    if not (normal < 0.0 or mu < 0.0):
        return 0.0, 0.0
    pn, pt = law[3] * slip - law[1] * normal, law[3] * normal - law[2] * slip
    if mu == HELD or (pn > 0.0 and abs(pt) <= mu * pn):
        return pn, pt
    # Friction opposes the slip of the frictionless solution: as mu grows from zero the slip slows
    # down, and stops before the normal impulse becomes unbounded.
    at = 7 if slip - law[4] * normal > 0.0 else 5
    pn = -normal * law[at]
    return pn, law[at + 1] * pn


@kernel
def velocity_scale(contacts: ContactRows, q: Array) -> float:
    """Return the velocity that residuals are relative to: the fastest approach at zero impulses.

    At least `ContactRows.floor`; for joints their largest velocity. A compliant contact counts with
    the approach of its bodies, not with that of its pad, which is the depth over the step.
    """
    size = contacts.floor[0]
    for i in range(len(q)):
        mu = friction_coefficient(contacts.cones[i])
        if mu < 0.0:
            size = max(size, abs(q[i, 0]), abs(q[i, 1]))
        else:
            approach, own = -q[i, 0], contacts.own[i, 0]
            if is_compliant(contacts, i) and own > 0.0:
                approach *= 1.0 - contacts.rows[i, 0, PAD] * contacts.columns[i, 0, PAD] / own
            size = max(size, approach)
    return size


@kernel
def residual(contacts: ContactRows, q: Array, size: float, impulses: Array, rates: Array) -> float:
    """Return the natural-map residual of the contact laws, relative to `size`.

    The largest ``w |p - proj(p - u / w)|`` over contacts (complementarity, cone, maximal
    dissipation), written so that no velocity is lost beside a large impulse: where none satisfy the
    laws, as of wedged bodies, impulses grow without bound.
    """
    error, own, cones = 0.0, contacts.own, contacts.cones
    for i in range(len(impulses)):
        normal, slip = contact_velocity(contacts, i, q, rates)
        if not math.isfinite(normal + slip):
            return math.inf
        pn, pt = impulses[i]
        wn, wt = own[i, 0], own[i, 1]
        mu = friction_coefficient(cones[i])
        if mu < 0.0:
            error = max(error, abs(normal), abs(slip) if mu == HELD else 0.0)
            continue
        error, edge = max(error, abs(min(normal, wn * pn))), wt * mu * pn
        error = max(error, abs(min(max(slip, wt * pt - edge), wt * pt + edge)))
    # Denormal numbers have no digits: adjacent bodies can approach at 1e-320 m/s.
    if error < SMALLEST:
        return 0.0
    return error / size if size > 0.0 else math.inf


@kernel
def impulse_residual(contacts: ContactRows, q: Array, size: float, impulses: Array) -> float:
    """Return the `residual` of impulses; `ContactRows.rates` are then theirs."""
    rates = zero_rates(contacts, 0)
    write_velocity_change(contacts, impulses, rates)
    return residual(contacts, q, size, impulses, rates)


@kernel
def _sweep(
    contacts: ContactRows, q: Array, impulses: Array, rates: Array, change: Array
) -> tuple[float, float]:
    """Solve contact by contact, writing the changes; return ``sum w dp^2`` and ``max w |dp|``."""
    total = most = 0.0
    own, laws = contacts.own, contacts.laws
    for i in range(len(impulses)):
        normal, slip = contact_velocity(contacts, i, q, rates)
        before, tangential = impulses[i, 0], impulses[i, 1]
        wn, wt, wx = own[i, 0], own[i, 1], own[i, 2]
        pn, pt = one_contact(
            laws[i], normal - wn * before - wx * tangential, slip - wx * before - wt * tangential
        )
        dn, dt = pn - before, pt - tangential
        impulses[i, 0], impulses[i, 1] = pn, pt
        change[i, 0], change[i, 1] = dn, dt
        if dn != 0.0 or dt != 0.0:
            apply_impulse(contacts, i, dn, dt, rates)
            total += wn * dn * dn + wt * dt * dt
            most = max(most, wn * abs(dn), wt * abs(dt))
    return total, most


@kernel
def gauss_seidel(
    contacts: ContactRows, q: Array, size: float, lowest: float, impulses: Array,
    tolerance: float, most: int,
) -> tuple[float, int]:  # fmt: skip
    """Sweep until the residual is within the tolerance; return the best residual, and sweeps.

    Nonlinear conjugate gradients with restarts. `ContactRows.rates` are those of the `impulses`
    (see `impulse_residual`); `size`: their `velocity_scale`; `lowest`: their residual; `q` (m, 2):
    velocities without impulses, minus the required ones.
    """
    m, spare = len(impulses), contacts.spare
    best, current = spare[BEST, :m], spare[CURRENT, :m]
    change, direction = spare[CHANGE, :m], spare[DIRECTION, :m]
    copy_rows(impulses, best)
    copy_rows(impulses, current)
    direction[:] = 0.0
    # One loop over all numbers is vectorised.
    numbers, changes = current.reshape(2 * m), change.reshape(2 * m)
    directions = direction.reshape(2 * m)
    rates, direction_rates = contacts.rates[0, : 3 * contacts.moving + 3], zero_rates(contacts, 1)
    last_rates, last_energy, count = contacts.rates[2, : len(rates)], 0.0, 0
    while count < most and lowest > tolerance:
        copy_numbers(rates, last_rates)
        energy, largest = _sweep(contacts, q, current, rates, change)
        count += 1
        # The residual costs half a sweep: evaluate it only when the tolerance may be met.
        if energy == 0.0 or largest <= tolerance * size or count == most:
            error = residual(contacts, q, size, current, rates)
            if error < lowest:
                lowest = error
                copy_rows(current, best)
            if energy == 0.0:
                break
        # Fletcher-Reeves, restarted where the changes grow.
        beta = min(energy / last_energy, 1.0) if energy <= _GROWN * last_energy else 0.0
        last_energy = energy
        for k in range(len(rates)):
            step = rates[k] - last_rates[k]
            rates[k] += beta * direction_rates[k]
            direction_rates[k] = beta * direction_rates[k] + step
        for k in range(2 * m):
            numbers[k] += beta * directions[k]
            directions[k] = beta * directions[k] + changes[k]
    copy_rows(best, impulses)
    return lowest, count
