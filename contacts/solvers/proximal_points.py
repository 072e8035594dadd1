"""Proximal point method for contact impulses (Rockafellar 1976), by semismooth Newton steps.

A compliance ties the impulses of each subproblem to a centre, which makes it well conditioned:
motion does not determine nearly half of the impulses in a heap, and where bodies wedge the
equations of a status (open, sticks, slides) have no solution. A Newton step updates the status of
all contacts at once (Alart and Curnier 1991); a few suffice. Then the centre moves to the solution,
and the compliance falls. The unknowns of the linear equations are body rates, fewer than contacts:
the impulse of a contact is its velocity error over its compliance.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    HELD,
    ContactRows,
    contact_velocity,
    friction_coefficient,
    residual,
    velocity_scale,
    write_velocity_change,
    zero_rates,
)
from contacts.solvers.sparse_blocks import (
    Equations,
    allocate_equations,
    factor_blocks,
    solve_blocks,
)
from statechart.arrays import Array, Ints
from statechart.kernels.copies import copy_counts, copy_numbers, copy_rows
from statechart.kernels.jit import kernel

OPEN, STICKS, SLIDES = range(3)
"""Contact status."""

VERIFIED = 1e-10
"""Residual of solved impulses. At this tolerance iterations go on until round-off ends the fall of
the residual: bodies at rest do not creep."""

# Compliance relative to the diagonal of W: initial, smallest, largest; its factors after
# convergence and after failure.
_FIRST, _MIN_COMPLIANCE, _LARGEST = 1e-2, 1e-8, 1.0
_FALLS, _GROWS = 0.5, 4.0
# Residual ratio of successive centres below which another one pays, and below which the factored
# equations are kept for it; residual of round-off.
_FURTHER, _FAST, _EXACT = 0.9, 0.1, 1e-15
# Compliances and iteration limit of the refinement of a status. An iteration leaves the larger of
# compliance times own over joint compliances, and round-off over its square: the second one for
# pins that nearly imply each other (feet of a box that is level to 1e-3).
_REFINING, _LAST_REFINING, _REFINEMENTS = 1e-5, 1e-7, 32
# Velocity error of a refined status, relative to the fastest approach, that is round-off.
_REFINED = 1e-13
# Newton steps per centre; centres without progress at the smallest compliance; eliminations in all,
# and times contacts (half a second).
_SETTLING, _IDLE, _MAX_ITERATIONS, _MAX_PRODUCTS = 10, 4, 3000, 2_000_000
# Status changes along a path, and how many of them may increase the shift.
_CHANGES, _TURNS = 160, 40
# The two bounds of a status; see `_status_margin`.
_ONE, _OTHER = 0, 1


@kernel
def _add(
    contacts: ContactRows, i: int, d: int, share: float, edge: float, one: int, other: int,
    block: Array,
) -> None:  # fmt: skip
    """Add a contact's term of M^-1 J^T J / compliance between two of its bodies to a block."""
    columns, rows = contacts.columns[i], contacts.rows[i, d]
    for r in range(3):
        column = share * (columns[d, 3 * one + r] + edge * columns[1, 3 * one + r])
        for c in range(3):
            block[3 * r + c] += column * rows[3 * other + c]


@kernel
def assemble_and_factor(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array
) -> bool:
    """Assemble and factor the Newton equations of a status; False where a pivot fails.

    The compliance is relative to each contact's own; `edges` (m,): tangential over normal impulse
    of sliding contacts.
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
    return factor_blocks(equations)


@kernel
def add_newton_step(
    contacts: ContactRows, equations: Equations, compliance: float, status: Ints, edges: Array,
    impulses: Array,
) -> None:  # fmt: skip
    """Add to impulses (m, 2) the change that causes the velocity changes `Equations.right`.

    The equations have the factors of this compliance, status and edges (see `assemble_and_factor`).
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
    solve_blocks(equations)
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
    contacts: ContactRows, q: Array, begins: float, now: Array, centre: Array,
    compliance: float, rates: Array, status: Ints, edges: Array,
) -> bool:  # fmt: skip
    """Write the status of contacts by the natural map; return whether any changed.

    A contact without impulse begins to press above a velocity `begins`.
    """
    different = False
    for i in range(len(now)):
        mu = friction_coefficient(contacts.cones[i])
        if mu < 0.0:
            # A `GUIDED` joint slides without friction.
            status[i], edges[i] = STICKS if mu == HELD else SLIDES, 0.0
            continue
        normal, slip = contact_velocity(contacts, i, q, rates)
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
    contacts: ContactRows, equations: Equations, q: Array, now: Array, centre: Array,
    compliance: float, rates: Array, status: Ints, edges: Array,
) -> None:  # fmt: skip
    """Take a Newton step of a status, in place; update the rates."""
    for i in range(len(now)):
        normal, slip = contact_velocity(contacts, i, q, rates)
        away, aside = now[i, 0] - centre[i, 0], now[i, 1] - centre[i, 1]
        equations.right[i, 0] = -normal - compliance * contacts.own[i, 0] * away
        equations.right[i, 1] = -slip - compliance * contacts.own[i, 1] * aside
    add_newton_step(contacts, equations, compliance, status, edges, now)
    write_velocity_change(contacts, now, rates)


@kernel
def _iterate_newton(
    contacts: ContactRows, equations: Equations, q: Array, begins: float, now: Array,
    centre: Array, compliance: float, rates: Array, status: Ints, edges: Array, factored: bool,
) -> tuple[bool, int]:  # fmt: skip
    """Take Newton steps to a proximal point, in place; return convergence, and eliminations.

    `factored`: the equations hold for this compliance and status.
    """
    for taken in range(_SETTLING + 1):
        changed = _find_status(contacts, q, begins, now, centre, compliance, rates, status, edges)
        if not changed and (factored or taken > 0):
            # A small compliance costs digits, which a second step recovers.
            if taken == 0 or compliance < _REFINING:
                _take_step(contacts, equations, q, now, centre, compliance, rates, status, edges)
            return True, taken
        if taken == _SETTLING or not assemble_and_factor(
            contacts, equations, compliance, status, edges
        ):
            return False, taken + 1
        for i in range(len(now)):
            if status[i] == OPEN:
                now[i, 0] = now[i, 1] = 0.0
            elif status[i] == SLIDES:
                now[i, 1] = edges[i] * now[i, 0]
        write_velocity_change(contacts, now, rates)
        _take_step(contacts, equations, q, now, centre, compliance, rates, status, edges)
    return False, _SETTLING


@kernel
def _status_margin(
    mu: float, status: int, edge: float, which: int, impulse: Array, normal: float, slip: float
) -> float:
    """Return the margin that stays >= 0 while a contact keeps its status.

    Linear in impulse and velocity. Open: normal velocity; sliding: normal impulse, and slip against
    friction; sticking: distances to both cone edges.
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
    """Write a contact's next status; return at which of its bounds it enters."""
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
    contacts: ContactRows, equations: Equations, q: Array, now: Array, centre: Array,
    shift: Array, compliance: float, rates: Array, status: Ints, edges: Array,
) -> tuple[bool, int]:  # fmt: skip
    """Follow a proximal point by homotopy in `shift`; return whether it is reached, and pivots.

    Impulses `now` (m, 2), `status` and `edges` (m,) start at the centre, and are overwritten by the
    point's; with the velocities `shift` (m, 2) the centre solves the contact laws. `rates` is
    workspace.
    """
    count, own = len(now), contacts.own
    changes, change_rates = np.empty((count, 2)), np.empty_like(rates)
    fraction, way, turns, entered, begins = 1.0, -1.0, 0, -1, _ONE
    for change in range(_CHANGES):
        if not assemble_and_factor(contacts, equations, compliance, status, edges):
            return False, change
        write_velocity_change(contacts, now, rates)
        for i in range(count):
            normal, slip = contact_velocity(contacts, i, q, rates)
            away, aside = now[i, 0] - centre[i, 0], now[i, 1] - centre[i, 1]
            equations.right[i, 0] = -normal - fraction * shift[i, 0] - compliance * own[i, 0] * away
            equations.right[i, 1] = -slip - fraction * shift[i, 1] - compliance * own[i, 1] * aside
        # Correct round-off.
        add_newton_step(contacts, equations, compliance, status, edges, now)
        write_velocity_change(contacts, now, rates)
        for i in range(count):
            changes[i, 0] = changes[i, 1] = 0.0
            equations.right[i, 0], equations.right[i, 1] = -shift[i, 0], -shift[i, 1]
        add_newton_step(contacts, equations, compliance, status, edges, changes)
        write_velocity_change(contacts, changes, change_rates)
        if entered >= 0:
            i = entered
            normal, slip = contact_velocity(contacts, i, shift, change_rates)
            normal += compliance * own[i, 0] * changes[i, 0]
            slip += compliance * own[i, 1] * changes[i, 1]
            mu = friction_coefficient(contacts.cones[i])
            opening = _status_margin(mu, status[i], edges[i], begins, changes[i], normal, slip)
            way = 1.0 if opening > 0.0 else -1.0
            turns += 1 if way > 0.0 else 0
        first, which, nearest = -1, _ONE, math.inf
        for i in range(count):
            mu = friction_coefficient(contacts.cones[i])
            if mu < 0.0:
                continue
            normal, slip = contact_velocity(contacts, i, q, rates)
            normal += fraction * shift[i, 0] + compliance * own[i, 0] * (now[i, 0] - centre[i, 0])
            slip += fraction * shift[i, 1] + compliance * own[i, 1] * (now[i, 1] - centre[i, 1])
            to_normal, to_slip = contact_velocity(contacts, i, shift, change_rates)
            to_normal += compliance * own[i, 0] * changes[i, 0]
            to_slip += compliance * own[i, 1] * changes[i, 1]
            for k in range(1 if status[i] == OPEN or mu == 0.0 else 2):
                if i == entered and k == begins:
                    continue
                falls = -way * _status_margin(
                    mu, status[i], edges[i], k, changes[i], to_normal, to_slip
                )
                if falls > 0.0:
                    here = _status_margin(mu, status[i], edges[i], k, now[i], normal, slip)
                    if max(here, 0.0) < nearest * falls:
                        first, which, nearest = i, k, max(here, 0.0) / falls
        reached = way < 0.0 and nearest >= fraction
        if not reached and (first < 0 or turns > _TURNS):
            return False, change + 1
        length = fraction if reached else nearest
        for i in range(count):
            for d in range(2):
                now[i, d] += way * length * changes[i, d]
        if reached:
            return True, change + 1
        fraction += way * length
        write_velocity_change(contacts, now, rates)
        _, slip = contact_velocity(contacts, first, q, rates)
        slip += fraction * shift[first, 1]
        slip += compliance * own[first, 1] * (now[first, 1] - centre[first, 1])
        mu = friction_coefficient(contacts.cones[first])
        begins, entered = _change(mu, status, edges, first, which, slip), first
    return False, _CHANGES


@kernel
def solve_by_last_status(contacts: ContactRows, q: Array, impulses: Array) -> tuple[float, int]:
    """Solve contacts with open ones kept open; return the residual, and eliminations.

    Impulses start from zero, in place: the smallest of those with the same motion. Open contacts
    stay open if that solves the problem: otherwise a box that just fits under a lid would be wedged
    between lid and floor by impulses without cause.
    """
    count, rates, equations = len(impulses), zero_rates(contacts, 0), allocate_equations(contacts)
    status, edges, taken = np.full(count, -1), np.zeros(count), 0
    size, best = velocity_scale(contacts, q), np.zeros((count, 2))
    write_velocity_change(contacts, impulses, rates)
    while taken < _SETTLING and _find_status(
        contacts, q, math.inf, impulses, impulses, _REFINING, rates, status, edges
    ):
        if not assemble_and_factor(contacts, equations, _REFINING, status, edges):
            return math.inf, taken + 1
        impulses[:] = 0.0
        rates[:] = 0.0
        lowest, compliance = math.inf, _REFINING
        for _ in range(_REFINEMENTS):
            error = 0.0
            for i in range(count):
                normal, slip = contact_velocity(contacts, i, q, rates)
                if status[i] != OPEN:
                    error = max(error, abs(normal), abs(slip) if status[i] == STICKS else 0.0)
            if error < lowest:
                copy_rows(impulses, best)
            if not error < _FALLS * lowest:
                stops = compliance == _LAST_REFINING or error <= _REFINED * size
                compliance = _LAST_REFINING
                if stops or not assemble_and_factor(contacts, equations, compliance, status, edges):
                    break
            lowest = min(error, lowest)
            _take_step(contacts, equations, q, impulses, impulses, compliance, rates, status, edges)
        copy_rows(best, impulses)
        write_velocity_change(contacts, impulses, rates)
        taken += 1
    return residual(contacts, q, size, impulses, rates), taken


@kernel
def solve_by_proximal_points(
    contacts: ContactRows, q: Array, size: float, lowest: float, impulses: Array, tolerance: float
) -> tuple[float, int]:
    """Improve impulses by proximal points; return the residual of the best, and eliminations.

    `size`, `lowest`: velocity scale and residual of the `impulses`. At a tolerance of `VERIFIED` or
    less, centres go on as long as the residual falls.
    """
    count = len(impulses)
    rates = zero_rates(contacts, 0)
    write_velocity_change(contacts, impulses, rates)
    equations = allocate_equations(contacts)
    now, centre, shift = impulses.copy(), impulses.copy(), np.zeros((count, 2))
    status, edges = np.full(count, -1), np.zeros(count)
    # Status of the last centre.
    last_status, last_edges, has_last = status.copy(), edges.copy(), False
    exact = falls = tolerance <= VERIFIED
    # If the status is known, a small compliance solves it in one step.
    compliance = min(max(lowest, _MIN_COMPLIANCE), _REFINING) if exact else _FIRST
    # The compliance of the factored equations; whether no other than small ones were tried.
    factored, small = 0.0, exact
    iterations = idle = 0
    most = min(_MAX_ITERATIONS, _MAX_PRODUCTS // count)
    while iterations < most and idle < _IDLE and (lowest > tolerance or falls):
        converged, taken = _iterate_newton(
            contacts, equations, q, 0.0, now, centre, compliance, rates, status, edges,
            compliance == factored,
        )  # fmt: skip
        iterations += taken
        factored = compliance if converged else 0.0
        if not converged and has_last:
            copy_rows(centre, now)
            copy_counts(last_status, status)
            copy_numbers(last_edges, edges)
            converged, taken = follow_point(
                contacts, equations, q, now, centre, shift, compliance, rates, status, edges
            )
            iterations += taken
        if converged:
            write_velocity_change(contacts, now, rates)
            error = residual(contacts, q, size, now, rates)
            idle += 1 if compliance == _MIN_COMPLIANCE else 0
            falls = exact and _EXACT < error < _FURTHER * lowest
            fast = compliance <= _REFINING and error < _FAST * lowest
            if error < lowest:
                lowest, idle = error, 0
                copy_rows(now, impulses)
            for i in range(count):
                for d in range(2):
                    away = now[i, d] - centre[i, d]
                    shift[i, d] = compliance * contacts.own[i, d] * away
            copy_rows(now, centre)
            copy_counts(status, last_status)
            copy_numbers(edges, last_edges)
            has_last = True
            if small and not fast and lowest > tolerance:
                compliance, small = _FIRST, False
            elif not fast:
                compliance = max(_FALLS * compliance, _MIN_COMPLIANCE)
        elif compliance >= _LARGEST or lowest <= tolerance:
            break
        else:
            compliance = _FIRST if small else min(_GROWS * compliance, _LARGEST)
            small = False
            copy_rows(centre, now)
            write_velocity_change(contacts, now, rates)
    return lowest, iterations
