"""Impulses of an island in a time step, with restitution and stabilisation that add no energy.

The contact solver is called again with weaker requirements if it finds no impulses, or if their
work exceeds that of the scheme. Impulses are always returned, with their residual.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    CHANGE,
    LEAST,
    SAVED,
    ContactRows,
    friction_coefficient,
    is_compliant,
    returned_work,
    row_velocity,
    write_velocity_change,
    zero_rates,
)
from contacts.solvers.contact_solver import solve_rows
from statechart.arrays import Array, Bools
from statechart.kernels.copies import copy_rows
from statechart.kernels.jit import kernel

# Iterations for the largest stabilisation whose work is within the bound; and the relative excess
# that then counts as round-off.
_NEARER, _AT_BOUND = 3, 1e-12
# A residual of round-off, where the tolerance is smaller: these impulses satisfy the laws.
_GOOD = 1e-8
# Relative round-off of work, per sum of its terms.
_WORK_ROUNDING = 64.0 * 2.0**-52


@kernel
def _impulse_work(before: Array, free: Array, impulses: Array, velocity_changes: Array) -> float:
    """Return ``p . (u- + u+) / 2``, the work of impulses with these velocity changes."""
    # Sums and products of whole arrays take seconds to compile.
    work = 0.0
    for i in range(len(impulses)):
        for d in range(2):
            work += impulses[i, d] * (before[i, d] + free[i, d] + velocity_changes[i, d])
    return 0.5 * work


@kernel
def _velocity_scale(before: Array, free: Array, impulses: Array) -> float:
    """Return the sum of the absolute terms of the work."""
    begin = end = 0.0
    for i in range(len(impulses)):
        for d in range(2):
            begin += abs(impulses[i, d] * before[i, d])
            end += abs(impulses[i, d] * free[i, d])
    return begin + end


@kernel
def parabola_root(begin: float, end: float, curvature: float) -> tuple[float, float]:
    """Return (1 - s, s) for the largest s in [0, 1] at which a parabola is not above zero.

    Each is computed from its nearer end: impulses may differ by decades.
    """
    slope = end - begin - curvature
    root = math.sqrt(max(slope * slope - 4.0 * curvature * begin, 0.0))
    share = (root - slope) / (2.0 * curvature) if slope < 0.0 else -2.0 * begin / (slope + root)
    rest = 2.0 * end / (2.0 * curvature + slope + root)
    return min(max(rest, 0.0), 1.0), min(max(share, 0.0), 1.0)


@kernel
def work_bounded_factor(
    impulses: Array, before: Array, free: Array, velocity_changes: Array, bound: float
) -> float:
    """Return the largest factor s <= 1 for which the work of s p is within a bound >= 0."""
    none = np.zeros((len(impulses), 2))
    return energy_bounded_impulses(before, free, none, impulses, none, velocity_changes, bound)[1]


@kernel
def energy_bounded_impulses(
    before: Array, free: Array, plastic: Array, elastic: Array, moved_plastic: Array,
    moved_elastic: Array, bound: float,
) -> tuple[Array, float]:  # fmt: skip
    """Return p = plastic + s (elastic - plastic) that adds no energy, and the largest such s <= 1.

    The work ``p . (u- + u+) / 2`` of a step is a convex function of s; it must not exceed that of
    the plastic impulses, or a bound >= 0. `before`, `free`: contact velocities before the step, and
    after it without impulses; `moved_plastic`, `moved_elastic`: velocity changes W p; all (m, 2).
    """
    begin = _impulse_work(before, free, plastic, moved_plastic)
    end = _impulse_work(before, free, elastic, moved_elastic)
    limit = max(begin, bound) + _WORK_ROUNDING * _velocity_scale(before, free, elastic)
    if end <= limit:
        return elastic, 1.0
    curvature, chosen = 0.0, np.empty((len(elastic), 2))
    for i in range(len(elastic)):
        for d in range(2):
            further = elastic[i, d] - plastic[i, d]
            curvature += further * (moved_elastic[i, d] - moved_plastic[i, d])
    _, share = parabola_root(begin - limit, end - limit, 0.5 * curvature)
    for i in range(len(elastic)):
        for d in range(2):
            chosen[i, d] = plastic[i, d] + share * (elastic[i, d] - plastic[i, d])
    return chosen, share


@kernel
def _write_changes(contacts: ContactRows, impulses: Array, changes: Array) -> Array:
    """Write, and return, the velocity changes W p (m, 2)."""
    rates = zero_rates(contacts, 0)
    write_velocity_change(contacts, impulses, rates)
    for i in range(len(impulses)):
        for d in range(2):
            changes[i, d] = row_velocity(contacts, i, d, rates)
    return changes


@kernel
def _velocities(contacts: ContactRows, impulses: Array) -> Array:
    # A new array: others stand in the workspace.
    return _write_changes(contacts, impulses, np.empty((len(impulses), 2)))


@kernel
def work_share(
    contacts: ContactRows, impulses: Array, before: Array, free: Array, bound: float
) -> float:
    """Return the factor of impulses whose work is within a bound; see `work_bounded_factor`."""
    changes = _write_changes(contacts, impulses, contacts.spare[CHANGE, : len(impulses)])
    return work_bounded_factor(impulses, before, free, changes, bound)


@kernel
def _solve_restitution(
    contacts: ContactRows, before: Array, free: Array, wanted: Array, rebounds: Bools,
    impulses: Array, tolerance: float, at_rest: bool, use_lemke: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Solve for impulses with restitution that adds no energy; see `island_impulses`."""
    q, any_rebound = contacts.spare[LEAST, : len(impulses)], False
    for i in range(len(impulses)):
        q[i, 0], q[i, 1] = free[i, 0] + wanted[i, 0], free[i, 1] + wanted[i, 1]
        any_rebound = any_rebound or rebounds[i]
    if not any_rebound:
        error, iterations = solve_rows(contacts, q, impulses, tolerance, at_rest, use_lemke)
        return error, iterations, False
    enough, plastic = max(tolerance, _GOOD), impulses.copy()
    error, iterations = solve_rows(contacts, q, impulses, tolerance, at_rest, False)
    for i in range(len(impulses)):
        if rebounds[i]:
            q[i, 0] = free[i, 0]
    changes = _velocities(contacts, impulses)
    if error <= enough and work_bounded_factor(impulses, before, free, changes, 0.0) >= 1.0:
        return error, iterations, False
    # Plastic impulses bound the energy that restitution may return.
    plastic_error, further = solve_rows(contacts, q, plastic, tolerance, False, use_lemke)
    if error > enough and plastic_error < error:
        copy_rows(plastic, impulses)
        return plastic_error, iterations + further, True
    chosen, share = energy_bounded_impulses(
        before, free, plastic, impulses, _velocities(contacts, plastic), changes, 0.0
    )
    copy_rows(chosen, impulses)
    return error if share == 1.0 else max(error, plastic_error), iterations + further, False


@kernel
def _is_stabilised(contacts: ContactRows, wanted: Array, rebounds: Bools, i: int) -> bool:
    """Return whether a contact needs stabilisation, out of penetration or along its surface."""
    biased = wanted[i, 0] < 0.0 or wanted[i, 1] != 0.0
    return biased and not rebounds[i] and not friction_coefficient(contacts.cones[i]) < 0.0


@kernel
def _unstabilised_bias(
    contacts: ContactRows, wanted: Array, rebounds: Bools, joints: bool
) -> Array:
    """Return the bias without contact stabilisation, or without that of `joints` too."""
    result = wanted.copy()
    for i in range(len(wanted)):
        joint = friction_coefficient(contacts.cones[i]) < 0.0
        if (joints and joint) or _is_stabilised(contacts, wanted, rebounds, i):
            result[i, 0] = 0.0 if joint else max(wanted[i, 0], 0.0)
            result[i, 1] = 0.0
    return result


@kernel
def _stabilise_partly(
    contacts: ContactRows, before: Array, free: Array, calmer: Array, wanted: Array,
    rebounds: Bools, full: Array, impulses: Array, tolerance: float, bound: float, error: float,
    softened: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Stabilise as far as the work of impulses is within the bound; see `island_impulses`.

    `full` (m, 2): impulses of the whole bias, with too much work; overwritten. `impulses` (m, 2):
    those of `calmer`, with `error` and `softened`; overwritten by the result, whose values are
    returned, with iterations between them.
    """
    bias, iterations = wanted, 0
    for _ in range(_NEARER):
        chosen, share = energy_bounded_impulses(
            before, free, impulses, full, _velocities(contacts, impulses),
            _velocities(contacts, full), bound,
        )  # fmt: skip
        bias = calmer + share * (bias - calmer)
        new_error, further, soft = _solve_restitution(
            contacts, before, free, bias, rebounds, chosen, tolerance, False, False
        )
        iterations += further
        if new_error > tolerance:
            break
        within = work_share(contacts, chosen, before, free, bound)
        if within >= 1.0 - _AT_BOUND:
            copy_rows(chosen, impulses)
            return new_error, iterations, soft
        # If the status changes, the work follows another parabola.
        copy_rows(chosen, full)
    return error, iterations, softened


@kernel
def island_impulses(
    contacts: ContactRows, before: Array, free: Array, wanted: Array, rebounds: Bools,
    impulses: Array, tolerance: float, bound: float, arms: bool,
) -> tuple[float, int, bool]:  # fmt: skip
    """Solve an island's step; return residual, iterations, and whether restitution was dropped.

    Restitution that would add energy is reduced. Opposed contacts can have no impulses that satisfy
    the restitution of all: then all are plastic, for which impulses exist (Anitescu and Potra
    1997).

    Parameters
    ----------
    contacts : ContactRows
    before, free : (m, 2)
        Velocities before the step, and after it without impulses.
    wanted : (m, 2)
        Bias: the lower bound of the velocities after the step, negated.
    rebounds : (m,) array of bool
        Whether that bias is restitution.
    impulses : (m, 2)
        Warm start; overwritten by the result.
    tolerance : float
        Residual.
    bound : float
        Allowed work of impulses in a step: ``h^2/8 f^T M^-1 f``.
    arms : bool
        Whether joints may do more work, because their lever arms turn.
    """
    count, pushed, joined, stores = len(impulses), False, False, False
    fastest = slowest = 0.0
    for i in range(count):
        slowest = max(slowest, abs(free[i, 0] - before[i, 0]))
        fastest = max(fastest, abs(before[i, 0]), abs(before[i, 1]))
        pushed = pushed or _is_stabilised(contacts, wanted, rebounds, i)
        joined = joined or friction_coefficient(contacts.cones[i]) < 0.0
        stores = stores or is_compliant(contacts, i)
    trial = contacts.spare[SAVED, :count]
    copy_rows(impulses, trial)
    at_rest = fastest <= slowest
    error, iterations, softened = _solve_restitution(
        contacts, before, free, wanted, rebounds, impulses, tolerance, at_rest, not pushed
    )
    if (stores or (joined and arms)) and error <= tolerance:
        bound += returned_work(contacts, impulses, before, free)
    share = work_share(contacts, impulses, before, free, bound)
    if pushed and (error > tolerance or share < 1.0):
        # Stabilisation may push bodies against others and gain energy, or wedge them: then no
        # impulses exist, and the tried ones diverge and are no warm start.
        calmer = _unstabilised_bias(contacts, wanted, rebounds, False)
        calm_error, further, soft = _solve_restitution(
            contacts, before, free, calmer, rebounds, trial, tolerance, False, True
        )
        iterations += further
        if calm_error <= max(error, tolerance):
            if max(error, calm_error) <= tolerance:
                calm_error, further, soft = _stabilise_partly(
                    contacts, before, free, calmer, wanted, rebounds, impulses, trial, tolerance,
                    bound, calm_error, soft,
                )  # fmt: skip
                iterations += further
            error, softened = calm_error, soft
            copy_rows(trial, impulses)
            share = work_share(contacts, impulses, before, free, bound)
    if joined and error > tolerance:
        # Bodies stuck between joints and contacts can only rest: joints get no stabilisation, and
        # do not follow their turning arms.
        calmer = _unstabilised_bias(contacts, wanted, rebounds, True)
        trial[:] = 0.0
        calm_error, further, soft = _solve_restitution(
            contacts, before, free, calmer, rebounds, trial, tolerance, False, True
        )
        iterations += further
        if calm_error < error:
            error, softened = calm_error, soft
            copy_rows(trial, impulses)
            share = work_share(contacts, impulses, before, free, bound)
    if share < 1.0:
        for i in range(count):
            impulses[i, 0] *= share
            impulses[i, 1] *= share
    return error, iterations, softened
