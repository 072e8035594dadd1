"""Mode enumeration: solves every combination of contact modes and tests its inequalities."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.dependence import independent_rows
from contacts.solvers.saddle_point import (
    CONTRADICTORY,
    REDUNDANT,
    SINGULAR,
    SOLVED,
    UNDETERMINED,
    saddle_workspace,
    solve_in,
)
from contacts.states import (
    FREE,
    LOCKED,
    PIN,
    SLIDE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    SLIP_MINUS,
    SLIP_PLUS,
)
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers, copy_rows
from statechart.kernels.jit import kernel

INTO, PULLS, OUTSIDE, AGAINST, BEYOND, NEGATIVE = range(6)
# Relative acceleration error at which a dependent constraint is contradicted.
_CONTRADICTED = 1e-9


@kernel
def dot(a: Array, b: Array) -> float:
    """Return the scalar product."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@kernel
def _direction(code: int) -> float:
    if code in (SLIDE_PLUS, SLIP_PLUS):
        return 1.0
    return -1.0 if code in (SLIDE_MINUS, SLIP_MINUS) else 0.0


@kernel
def is_coupling(code: int) -> bool:
    """Return whether a mode is that of a coupling that is not open."""
    return code in (LOCKED, SLIP_PLUS, SLIP_MINUS)


@kernel
def choose_edges(cones: Array, code: Ints, edges: Array) -> None:
    """Write the unit edge (c, 2) of each contact's cone in its mode, of `cones` (c, 6)."""
    for c in range(len(code)):
        at = 2 if code[c] == SLIDE_PLUS else 4 if code[c] == SLIDE_MINUS else 0
        edges[c, 0], edges[c, 1] = cones[c, at], cones[c, at + 1]


@kernel
def _update_worst(verdict: Array, amount: float, contact: int, which: int, number: float) -> None:
    if amount > verdict[0]:
        verdict[0], verdict[1], verdict[2], verdict[3] = amount, contact, which, number


@kernel
def _judge_accelerations(
    verdict: Array, accelerations: Array, jacobians: Array, biases: Array, code: Ints,
    closed: Bools, still: Bools, scale: float,
) -> None:  # fmt: skip
    for c in range(len(code)):
        sign = _direction(code[c])
        if code[c] == FREE and closed[c]:
            apart = biases[c, 0] + dot(jacobians[c, 0], accelerations)
            _update_worst(verdict, -apart / scale, c, INTO, apart)
        elif sign != 0.0 and still[c]:
            along = sign * (biases[c, 1] + dot(jacobians[c, 1], accelerations))
            _update_worst(verdict, -along / scale, c, AGAINST, along)


@kernel
def judge_forces(verdict: Array, forces: Array, cones: Array, code: Ints, scale: float) -> None:
    """Find the most violated force inequality of a combination; see `solve_modes`."""
    for c in range(len(code)):
        V, H = forces[c, 0], forces[c, 1]
        cone_n, cone_t = cones[c, 0], cones[c, 1]
        if code[c] == PIN:
            _update_worst(verdict, -V / scale, c, PULLS, V)
            if cone_n > 0.0:
                _update_worst(verdict, (cone_n * abs(H) - cone_t * V) / scale, c, OUTSIDE, abs(H))
        elif code[c] == LOCKED:
            _update_worst(verdict, (abs(H) - V) / scale, c, BEYOND, abs(H))
        elif is_coupling(code[c]):
            _update_worst(verdict, -V / scale, c, NEGATIVE, V)
        elif code[c] != FREE:
            edge = cone_n * V - _direction(code[c]) * cone_t * H
            _update_worst(verdict, -edge / scale, c, PULLS, V)


@kernel
def write_limits(forces: Array, cones: Array, carriers: Ints, code: Ints) -> None:
    """Write the limits of couplings, and the torques of those that slip (see `solve_modes`)."""
    for c in range(len(code)):
        if is_coupling(code[c]):
            limit = cones[c, 0] if code[c] == LOCKED else cones[c, 1]
            if carriers[c] >= 0:
                limit *= forces[carriers[c], 0]
            forces[c, 0] = limit
            if code[c] != LOCKED:
                forces[c, 1] = -_direction(code[c]) * limit


@kernel
def _write_rows(
    rows: Array, columns: Array, first: Ints, bearing: Ints, rank: int, matrix: Array,
) -> None:  # fmt: skip
    """Write the leading rows and columns of a saddle point, by their orders, beside the mass."""
    n = rows.shape[1]
    for k in range(rank):
        for i in range(n):
            matrix[i, n + k] = -columns[bearing[k], i]
            matrix[n + k, i] = rows[first[k], i]
        for i in range(rank):
            matrix[n + k, n + i] = 0.0


@kernel
def _contradicts(row: Array, constant: float, accelerations: Array, scale: float) -> bool:
    """Return whether accelerations contradict a dependent constraint."""
    terms, error = scale, -constant
    for i in range(len(row)):
        terms += abs(row[i] * accelerations[i])
        error += row[i] * accelerations[i]
    return abs(error) > _CONTRADICTED * terms


@kernel
def list_combinations(options: Ints, counts: Ints, total: int) -> Ints:
    """Return all combinations (total, c) of the first `counts` options (c, 5) of every contact."""
    codes = np.empty((total, len(counts)), np.int64)
    for k in range(total):
        remainder = k
        for c in range(len(counts)):
            codes[k, c] = options[c, remainder % counts[c]]
            remainder //= counts[c]
    return codes


class ModeEquations(NamedTuple):
    """Equations of motion and contacts of a state, the same in every mode.

    M a = f + J^T F, with the accelerations J a + b of the contacts along normal and tangent.
    """

    mass: Array  # (n, n)
    forces: Array  # (n,)
    jacobians: Array  # (c, 2, n): normal, tangential
    biases: Array  # (c, 2)
    # (c, 6): Unit edges of the cones at rest, in slide+ and in slide-; of a coupling first its
    # static and its kinetic limit, in the place of its normal force
    cones: Array
    # (c,): Contact whose normal force the limits of a coupling are multiples of; below 0: none
    carriers: Ints
    closed: Bools  # (c,): Whether the gap is closed
    at_rest: Bools  # (c,): Whether the slip is zero


class ModeSolutions(NamedTuple):
    """Buffers for the solutions of `solve_modes`."""

    status: Ints  # (k,)
    accelerations: Array  # (k, n)
    # (k, c, 2): If the forces are not determined but the accelerations are (REDUNDANT), one choice
    # of those that explain the motion, which need not be in their cones
    forces: Array
    # (k, 4): The inequality violated most: relative violation (<= 0: none), contact, kind (INTO,
    # PULLS, OUTSIDE, ...), value. REDUNDANT modes are judged by their motion alone
    verdicts: Array


@kernel
def solve_modes(
    equations: ModeEquations, codes: Ints, force_scale: float, acceleration_scale: float,
    tie: float, solutions: ModeSolutions,
) -> tuple[int, int]:  # fmt: skip
    """Solve every combination of contact modes, and test its inequalities.

    Parameters
    ----------
    equations : ModeEquations
    codes : (k, c) array of int
        FREE, PIN, SLIDE (its force along the normal), SLIDE_PLUS, SLIDE_MINUS; LOCKED, SLIP_PLUS,
        SLIP_MINUS of a coupling.
    force_scale, acceleration_scale : float
        Scales of violations.
    tie : float
        Violations up to this count as none.
    solutions : ModeSolutions
        Filled. A kernel that makes the arrays it returns takes 3 us for each of them.

    Returns
    -------
    redundant, agreeing : int
        Number of REDUNDANT combinations; index of the only one that is solved and not violated,
        -1 if there is none or several.
    """
    mass, right, jacobians, biases, cones, carriers, closed, at_rest = equations
    status, accelerations, forces, verdicts = solutions
    redundant, agreeing, consistent = 0, -1, 0
    count, contacts = codes.shape
    n = len(right)
    rows, columns = np.empty((2 * contacts, n)), np.empty((2 * contacts, n))
    constants, directions = np.empty(2 * contacts), np.empty((2 * contacts, 2))
    owners, in_order = np.empty(2 * contacts, np.int64), np.arange(2 * contacts)
    size, edges = n + 2 * contacts, np.empty((contacts, 2))
    matrix, memory = np.empty((size, size)), saddle_workspace(size)
    b, x = np.empty(size), np.empty(size)
    for k in range(count):
        code, verdict, force = codes[k], verdicts[k], forces[k]
        choose_edges(cones, code, edges)
        verdict[0], verdict[1], verdict[2], verdict[3] = -math.inf, 0.0, 0.0, 0.0
        for i in range(n):
            accelerations[k, i] = 0.0
        m = 0
        for c in range(contacts):
            force[c, 0] = force[c, 1] = 0.0
            first_row = 1 if code[c] == LOCKED else 0
            last_row = 0 if code[c] == FREE else 1
            if code[c] == PIN or code[c] == LOCKED:
                last_row = 2
            elif is_coupling(code[c]):
                last_row = 0
            for d in range(first_row, last_row):
                owners[m], constants[m] = c, -biases[c, d]
                if last_row == 2:
                    directions[m, 0], directions[m, 1] = 1 - d, d
                else:
                    directions[m, 0] = 1.0 if code[c] == SLIDE else edges[c, 0]
                    directions[m, 1] = -_direction(code[c]) * edges[c, 1]
                for i in range(n):
                    rows[m, i] = jacobians[c, d, i]
                    columns[m, i] = directions[m, 0] * jacobians[c, 0, i]
                    columns[m, i] += directions[m, 1] * jacobians[c, 1, i]
                for r in range(contacts):
                    if carriers[r] == c and is_coupling(code[r]) and code[r] != LOCKED:
                        by = -_direction(code[r]) * edges[r, 1] * directions[m, 0]
                        for i in range(n):
                            columns[m, i] += by * jacobians[r, 1, i]
                m += 1
        rank, first, bearing = m, in_order, in_order
        # The row of a contact is zero where joints hold it closed: only `FREE` is a mode then, and
        # joints bear all. A locked brake whose row is zero is redundant.
        if m > 1 or (m == 1 and code[owners[0]] == LOCKED):
            rank, row_order, _ = independent_rows(rows[:m])
            force_rank, order, _ = independent_rows(columns[:m])
            if rank != force_rank:
                status[k] = UNDETERMINED if force_rank > rank else SINGULAR
                continue
            if rank < m:
                first, bearing = row_order, order
        copy_rows(mass, matrix)
        _write_rows(rows, columns, first, bearing, rank, matrix)
        copy_numbers(right, b)
        for c in range(contacts):
            if is_coupling(code[c]) and code[c] != LOCKED and carriers[c] < 0:
                for i in range(n):
                    b[i] -= _direction(code[c]) * edges[c, 1] * jacobians[c, 1, i]
        for i in range(rank):
            b[n + i] = constants[first[i]]
        status[k] = solve_in(memory, matrix, b, x, n + rank)
        if status[k] != SOLVED:
            continue
        for i in range(n):
            accelerations[k, i] = x[i]
        for i in range(rank, m):
            if _contradicts(
                rows[first[i]], constants[first[i]], accelerations[k], acceleration_scale
            ):
                status[k] = CONTRADICTORY
        if status[k] != SOLVED:
            continue
        for i in range(rank):
            place = bearing[i]
            force[owners[place], 0] += x[n + i] * directions[place, 0]
            force[owners[place], 1] += x[n + i] * directions[place, 1]
        write_limits(force, edges, carriers, code)
        _judge_accelerations(
            verdict, accelerations[k], jacobians, biases, code, closed, at_rest, acceleration_scale
        )
        if rank == m:
            judge_forces(verdict, force, edges, code, force_scale)
        else:
            status[k] = REDUNDANT
            redundant += 1
        if verdict[0] <= tie:
            consistent += 1
            agreeing = k if consistent == 1 else -1
    return redundant, agreeing
