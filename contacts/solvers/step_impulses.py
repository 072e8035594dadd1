"""Impulses of an island in a step: changes of friction, sequential impacts, forces.

An island is a group of contacts coupled through bodies of three rates each, or through shared
coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import (
    BEGINS,
    LAW,
    ON_TRIAL,
    RESTING,
    ContactRows,
    apply_impulse,
    clear_rates,
    friction_coefficient,
    overload,
    row_velocity,
    select_rows,
    velocity_scale,
    write_diagonal_blocks,
    write_law,
    zero_rates,
)
from contacts.solvers.contact_solver import solve_rows
from contacts.solvers.island_impulses import island_impulses, work_share
from contacts.solvers.saddle_point import largest_size
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers, indices
from statechart.kernels.jit import kernel

# Relative round-off: of velocities and impulses to the largest, of sums to their terms.
_ROUNDING, SUM_ROUNDING = 1e-13, 1e-9
# Smallest tolerance of forces during impacts, relative to the approach in the step.
_NEAR = 1e-2

LIVELY = 0.5
"""Restitution from which a warning says that simultaneous impacts differ from sequential ones: a
quarter of the approach energy returns. Below it the order rarely matters."""

NEGLIGIBLE_CHANGE = 1e-3
"""Change of a velocity by another impact, relative to its own change, that is no coupling: a body
turns within a step."""

ONE, TWO, LIMIT = range(3)
"""Friction laws: one coefficient; static and kinetic; two limits of a force, which bears nothing at
an instant."""


class Island(NamedTuple):
    """Coupled contacts, in the order of their rows."""

    members: Ints  # (m,): contact indices.
    # (m, 2): velocities before the step, and without impulses; bias (required velocities,
    # negated); the sum of the last two.
    start: Array
    unforced: Array
    bias: Array
    least: Array
    # (m, 2): impulses; velocities under them, without round-off; impulses of sequential impacts.
    chosen: Array
    after: Array
    impact_impulses: Array
    # (m,): contacts with restitution; contacts that are struck.
    rebounds: Bools
    hit: Bools
    # (m,): friction law; slip direction of the friction that acts: 0 at rest, 1 or -1 as before the
    # step, `BEGINS` or -`BEGINS`, or `ON_TRIAL`.
    kinds: Ints
    slip_directions: Ints
    frictions: Array  # (m, 3, 2): cone edges at rest, in slip+ and in slip-.


@kernel
def _write_friction(contacts: ContactRows, island: Island, a: int, way: int) -> None:
    """Write the friction of contact a for a slip direction."""
    island.slip_directions[a], at = way, 0
    if way not in (0, ON_TRIAL):
        at = 1 if way > 0 else 2
    copy_numbers(island.frictions[a, at], contacts.cones[a])
    write_law(contacts.own[a], friction_coefficient(contacts.cones[a]), contacts.laws[a])


@kernel
def change_friction(contacts: ContactRows, island: Island, resting: float, struck: bool) -> bool:
    """Switch the friction of contacts whose slip begins or reverses; return whether any switched.

    A slip that would reverse in the step stops if static friction can hold it over the whole step;
    in an impact (`struck`) kinetic friction stops or reverses it. A contact that static friction
    does not hold slips under kinetic friction: contacts that slipped before the step (faster than
    `resting`) first, then one at a time the most overloaded, because each relieves the others. It
    begins to slip after other contacts have stopped, which static friction then holds if it can. A
    contact switches three times at most.
    """
    ways, first, most, way, changes = island.slip_directions, -1, 0.0, 0, False
    for a in range(len(ways)):
        old, slip, normal = ways[a], island.after[a, 1], island.chosen[a, 0]
        may_switch = island.kinds[a] != ONE and abs(old) != BEGINS and normal > 0.0
        # The slip of a contact inside its cone is the residual of the impulses.
        slips = is_sliding(contacts.cones[a], island.chosen[a], slip)
        if not (may_switch and slips) or (abs(old) == 1 and slip * old > 0.0):
            continue
        turned = BEGINS if slip > 0.0 else -BEGINS
        if abs(old) == 1:
            changes = True
            if not struck:
                _write_friction(contacts, island, a, ON_TRIAL)
                island.bias[a, 1] -= island.start[a, 1]
            else:
                _write_friction(contacts, island, a, turned if island.kinds[a] == TWO else 0)
            continue
        load = overload(slip, contacts.own[a, 1], normal, contacts.cones[a])
        if abs(island.start[a, 1]) > resting:
            load = math.inf
        if load > most:
            first, most, way = a, load, turned
    if changes:
        return True
    for a in range(len(ways)):
        if ways[a] == ON_TRIAL and first in (a, -1):
            ways[a], changes = 0, True
            island.bias[a, 1] += island.start[a, 1]
    if first >= 0:
        for a in range(len(ways)):
            old, pushes, slip = ways[a], island.chosen[a], island.after[a, 1]
            stopped = abs(old) == 1 and not is_sliding(contacts.cones[a], pushes, slip)
            if stopped and not struck and island.kinds[a] != ONE and pushes[0] > 0.0:
                _write_friction(contacts, island, a, 0)
        _write_friction(contacts, island, first, way)
    return changes or first >= 0


@kernel
def new_island(members: Ints, start: Array, unforced: Array, wanted: Array) -> Island:
    """Return an island with zero velocities and one coefficient of friction everywhere."""
    m = len(members)
    return Island(
        members, start, unforced, wanted, np.empty((m, 2)), np.zeros((m, 2)), np.empty((m, 2)),
        np.zeros((m, 2)), np.zeros(m, np.bool_), np.zeros(m, np.bool_), np.zeros(m, np.int64),
        np.zeros(m, np.int64), np.empty((m, 3, 2)),
    )  # fmt: skip


@kernel
def order_matters(contacts: ContactRows, pairs: Ints, lively: Bools, impulses: Array) -> bool:
    """Return whether elastic impacts of different body pairs (m,) change each other."""
    rates = zero_rates(contacts, 0)
    for a in range(len(pairs)):
        if not lively[a]:
            continue
        apply_impulse(contacts, a, impulses[a, 0], impulses[a, 1], rates)
        for b in range(len(pairs)):
            if not lively[b] or pairs[a] == pairs[b]:
                continue
            for d in range(2 if friction_coefficient(contacts.cones[b]) > 0.0 else 1):
                own = abs(contacts.own[b, d] * impulses[b, 0])
                if abs(row_velocity(contacts, b, d, rates)) > NEGLIGIBLE_CHANGE * own:
                    return True
        clear_rates(contacts, a, rates)
    return False


@kernel
def rescale_tolerance(tolerance: float, slow: float, fast: float) -> float:
    """Return a residual relative to a slow approach that equals `tolerance` of a fast one."""
    return min(tolerance * fast / slow, max(tolerance, _NEAR)) if slow > 0.0 else tolerance


@kernel
def forces_without_impacts(
    contacts: ContactRows, hit: Bools, q: Array, impulses: Array, tolerance: float, fast: float
) -> Array:
    """Return the force part of the impulses (m, 2): a solution without the struck contacts.

    `q` (m, 2): velocities without impulses, minus the required ones; `impulses`: warm start;
    `fast`: the `velocity_scale` of all contacts.
    """
    forces, others = np.zeros((len(hit), 2)), indices(~hit)
    if len(others) > 0:
        quiet, alone, quiet_q = select_rows(contacts, others), impulses[others], q[others]
        near = rescale_tolerance(tolerance, velocity_scale(quiet, quiet_q), fast)
        solve_rows(quiet, quiet_q, alone, near, False, True)
        for a in range(len(others)):
            copy_numbers(alone[a], forces[others[a]])
    return forces


@kernel
def coordinate_rows(jacobians: Array, columns: Array, pads: Array, cones: Array) -> ContactRows:
    """Return contacts on shared coordinates as rows.

    Jacobians (m, 2, n); `columns` (2 m, s): M^-1 J^T, the first n entries those of coordinates;
    `pads` (m,): compliance of the pad of a compliant contact or coupling, 0 without; cones (m, 2).
    """
    count, n = len(jacobians), jacobians.shape[2]
    soft = n
    for a in range(count):
        soft += 1 if pads[a] > 0.0 else 0
    threes, soft = (soft + 2) // 3, n
    contacts = ContactRows(
        np.empty((count, threes), np.int64), threes, np.zeros((count, 2, 3 * threes)),
        np.zeros((count, 2, 3 * threes)), np.empty((count, 3)), cones, np.empty((count, LAW)),
        np.empty((3, 3 * threes + 3)), np.empty((7, count, 2)), 1, 0, np.zeros(1),
    )  # fmt: skip
    for a in range(count):
        for side in range(threes):
            contacts.bodies[a, side] = side
        for d in range(2):
            for j in range(n):
                contacts.rows[a, d, j] = jacobians[a, d, j]
                contacts.columns[a, d, j] = columns[2 * a + d, j]
        if pads[a] > 0.0:
            contacts.rows[a, 0, soft], contacts.columns[a, 0, soft] = 1.0, pads[a]
            soft += 1
    write_diagonal_blocks(contacts)
    return contacts


@kernel
def write_velocities(contacts: ContactRows, q: Array, impulses: Array, after: Array) -> None:
    """Write the contact velocities (m, 2) in coordinates under impulses, without round-off."""
    for a in range(len(q)):
        for d in range(2):
            after[a, d], terms = q[a, d], abs(q[a, d])
            for b in range(len(q)):
                for e in range(2):
                    term = 0.0
                    for k in range(contacts.rows.shape[2]):
                        term += contacts.rows[a, d, k] * contacts.columns[b, e, k]
                    term *= impulses[b, e]
                    after[a, d] += term
                    terms += abs(term)
            if abs(after[a, d]) <= SUM_ROUNDING * terms:
                after[a, d] = 0.0


@kernel
def coordinate_impulses(
    contacts: ContactRows, island: Island, tolerance: float
) -> tuple[float, bool]:
    """Solve for impulses in coordinates; return their residual, and whether restitution dropped.

    Inexact impulses are scaled down until they add no energy.
    """
    before, free, impulses, q = island.start, island.unforced, island.chosen, island.least
    size = 0.0
    for a in range(len(free)):
        size = max(size, largest_size(free[a]), largest_size(before[a]))
    contacts.floor[0] = RESTING * size
    for a in range(len(free)):
        for d in range(2):
            q[a, d] = free[a, d] + island.bias[a, d]
            if abs(q[a, d]) <= _ROUNDING * size:
                q[a, d] = 0.0
    error, _, softened = island_impulses(
        contacts, before, free, q - free, island.rebounds, impulses, tolerance, math.inf, False
    )
    share = 1.0 if error <= tolerance else work_share(contacts, impulses, before, free, 0.0)
    for a in range(len(free)):
        # An impulse whose velocity change is round-off is zero.
        normal, tangential = share * impulses[a, 0], share * impulses[a, 1]
        normal = normal if contacts.own[a, 0] * normal > _ROUNDING * size else 0.0
        shears = contacts.own[a, 1] * abs(tangential) > _ROUNDING * size
        edge = friction_coefficient(contacts.cones[a]) * normal
        impulses[a, 0] = normal
        impulses[a, 1] = min(max(tangential, -edge), edge) if shears else 0.0
    write_velocities(contacts, q, impulses, island.after)
    return error, softened


def drop_round_off_friction(cones: Array) -> Array:
    """Return cone edges (m, 2) without friction that is round-off of the normal impulse."""
    result = cones.copy()
    result[cones[:, 1] <= _ROUNDING * cones[:, 0], 1] = 0.0
    return result


@kernel
def removable_share(push: Array, force: Array, cone: Array) -> float:
    """Return the largest part s <= 1 of `force` for which ``push - s force`` stays in its cone."""
    part = 1.0
    # In sliding both are on the edge, up to round-off.
    rounding = _ROUNDING * (abs(push[0]) + abs(push[1]) + (abs(force[0]) + abs(force[1])))
    for side in (-1.0, 1.0):
        whole = max(cone[1] * push[0] + side * cone[0] * push[1], 0.0)
        removed = cone[1] * force[0] + side * cone[0] * force[1]
        if removed > whole + rounding:
            part = min(part, whole / removed)
    # Without friction both edges coincide and do not bound the normal impulse.
    whole = max(push[0], 0.0)
    if force[0] > whole + rounding:
        part = min(part, whole / force[0])
    return part


@kernel
def project_into_cone(impulse: Array, cone: Array) -> Array:
    """Return an impulse projected into its cone, which it misses by round-off."""
    result = impulse.copy()
    result[0] = max(impulse[0], 0.0)
    if cone[0] > 0.0:
        edge = cone[1] / cone[0] * result[0]
        result[1] = min(max(impulse[1], -edge), edge)
    return result


@kernel
def is_sliding(cone: Array, impulse: Array, slip: float) -> bool:
    """Return whether a contact slips with its impulse on the cone edge.

    An unloaded rolling contact slips by round-off.
    """
    return (
        slip != 0.0
        and abs(impulse[1]) >= (1.0 - SUM_ROUNDING) * friction_coefficient(cone) * impulse[0]
    )
