"""The contact solver: one ladder for every contact problem.

1. Gauss-Seidel sweeps (`contacts.solvers.contact_rows.gauss_seidel`), warm-started;
2. proximal points by Newton's method (`contacts.solvers.proximal_points`), from their result; both
   again from zero if they fail, since a warm start misleads after large changes;
3. Lemke's algorithm (`contacts.solvers.lemke`), from zero, polished by proximal points.

The best impulses are returned with their residual. `benchmarks/contact_problems.py` replays every
method on recorded problems.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import (
    TRIAL,
    ContactRows,
    apply_impulse,
    clear_rates,
    friction_coefficient,
    gauss_seidel,
    impulse_residual,
    row_velocity,
    velocity_scale,
    zero_rates,
)
from contacts.solvers.lemke import impulses_by_lemke
from contacts.solvers.proximal_points import (
    VERIFIED,
    solve_by_last_status,
    solve_by_proximal_points,
)
from statechart.arrays import Array
from statechart.kernels.copies import copy_rows
from statechart.kernels.jit import kernel

# Residual up to which a body at rest keeps its warm start: the error accumulates over the steps to
# come, until it reaches `VERIFIED`.
_AT_REST = 1e-13
# Residual of a status solved to round-off: an open contact then approaches at most by the round-off
# of its gap over a step, and need not press.
_OPENS = 1e-8
# Contacts up to which all problems are solved to `VERIFIED`.
_SMALL = 8
# Sweeps before Newton's method: they find the status of most contacts.
_SWEEPS = 64
# Contacts up to which Lemke's algorithm is tried: its time grows at least with the cube.
_LEMKE = 64


@kernel
def solve_rows(
    contacts: ContactRows, q: Array, impulses: Array, tolerance: float, at_rest: bool,
    use_lemke: bool,
) -> tuple[float, int]:  # fmt: skip
    """Solve contacts, warm-started; return the residual of the best impulses, and iterations.

    Parameters
    ----------
    contacts : ContactRows
    q : (m, 2)
        Velocities without impulses, minus the required ones.
    impulses : (m, 2)
        Warm start; overwritten by the best impulses.
    tolerance : float
        Residual (see `contacts.solvers.contact_rows.residual`) at which iterations stop; infinite:
        impulses are zero, as for contact detection alone.
    at_rest : bool
        Nothing moves: solve to round-off, because errors accumulate over later steps.
    use_lemke : bool
        Try Lemke's algorithm if the others miss the tolerance.
    """
    count, idle, has_joints = len(impulses), True, False
    for i in range(count):
        joint = friction_coefficient(contacts.cones[i]) < 0.0
        idle, has_joints = idle and q[i, 0] >= 0.0 and not joint, has_joints or joint
    if idle or not tolerance < math.inf:
        impulses[:] = 0.0
        return 0.0, 0
    size = velocity_scale(contacts, q)
    best = impulse_residual(contacts, q, size, impulses)
    # Rows in coordinates all share the same blocks: Newton's equations are that small.
    dense = contacts.shared == 1
    # Rows in coordinates are solved in each step: a body at rest then has exactly zero velocity.
    if not dense and best <= (_AT_REST if at_rest else min(VERIFIED, tolerance)):
        return best, 0
    trial, iterations, pivots = contacts.spare[TRIAL, :count], 0, count <= _LEMKE and not has_joints
    goal = min(tolerance, VERIFIED) if at_rest or dense or count <= _SMALL else tolerance
    if dense:
        error, enough = math.inf, max(goal, min(tolerance, _OPENS))
        if count == 1:
            trial[:] = 0.0
            impulse_residual(contacts, q, size, trial)
            error, iterations = gauss_seidel(contacts, q, size, math.inf, trial, goal, 1)
        elif impulses[:, 0].max() > 0.0:
            copy_rows(impulses, trial)
            error, iterations = solve_by_last_status(contacts, q, trial)
        if error > enough and count > 1 and pivots:
            error, steps = _by_lemke(contacts, q, enough, trial)
            iterations, pivots = iterations + steps, False
        if error <= enough or error < best:
            best = error
            copy_rows(trial, impulses)
        if error <= enough:
            return error, iterations
    for anew in (False, True):
        if anew:
            trial[:] = 0.0
        else:
            copy_rows(impulses, trial)
        error = impulse_residual(contacts, q, size, trial) if anew or dense else best
        # Sweeps before Newton's method in a small problem save a tenth of a large heap, cost a
        # twentieth of dice, and choose other impulses where motion leaves them open; at rest the
        # status is known. The first sweep solves a single contact exactly.
        if anew or goal > VERIFIED or count == 1:
            error, steps = gauss_seidel(contacts, q, size, error, trial, goal, _SWEEPS)
            iterations += steps
        if error > goal or (at_rest and count > 1):
            error, steps = solve_by_proximal_points(contacts, q, size, error, trial, goal)
            iterations += steps
        if error < best:
            best = error
            copy_rows(trial, impulses)
        if best <= tolerance:
            return best, iterations
    if use_lemke and pivots:
        error, steps = _by_lemke(contacts, q, tolerance, trial)
        iterations += steps
        if error < best:
            best = error
            copy_rows(trial, impulses)
    return best, iterations


@kernel
def _by_lemke(
    contacts: ContactRows, q: Array, tolerance: float, impulses: Array
) -> tuple[float, int]:
    """Improve impulses by Lemke's algorithm on the dense problem; return residual and iterations.

    It finds the status where masses differ by decades and iterations from a warm start do not; that
    status is then solved to round-off. Two covering vectors are tried: if round-off ends one path
    in a ray, the other rarely ends so.
    """
    count = len(q)
    delassus, rates = np.empty((2 * count, 2 * count)), zero_rates(contacts, 0)
    for b in range(2 * count):
        j = b // 2
        apply_impulse(contacts, j, 1.0 - b % 2, 1.0 * (b % 2), rates)
        for a in range(2 * count):
            delassus[a, b] = row_velocity(contacts, a // 2, a % 2, rates)
        clear_rates(contacts, j, rates)
    best, iterations = math.inf, 0
    for by_sizes in range(2):
        if best <= tolerance:
            break
        good, candidate = impulses_by_lemke(
            delassus, q, contacts.cones, np.zeros(len(q)), by_sizes == 1
        )
        if not good:
            continue
        exact, error, steps = candidate.copy(), math.inf, 0
        if contacts.shared == 1:
            error, steps = solve_by_last_status(contacts, q, exact)
        if error <= tolerance:
            copy_rows(exact, candidate)
        else:
            size = velocity_scale(contacts, q)
            error = impulse_residual(contacts, q, size, candidate)
            error, more = solve_by_proximal_points(contacts, q, size, error, candidate, tolerance)
            steps += more
        iterations += steps
        if error < best:
            best = error
            copy_rows(candidate, impulses)
    return best, iterations
