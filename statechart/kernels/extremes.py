"""Minimum and maximum of a tape along the polynomials of steps."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.kernels.boxes import Steps
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import sample_states
from statechart.kernels.quadrature import EXACT, integrate_outputs
from statechart.kernels.tapes import TapeCode, tape_table

# Number of grid points per piece, before refinement.
_GRID = 16
# Each round divides the bracket by 8; after 9 it is 1e-8 of a step, where a smooth extreme
# differs from its neighbourhood by 1e-16.
_ROUNDS, _DIVISIONS = 9, 16


@kernel
def values_along(tape: TapeCode, steps: Steps, low: float, tau: Array, values: Array) -> None:
    """Write the values (m,) of a tape's one output at local times (m,)."""
    states, clock = sample_states(steps.coeffs, steps.times, tau), np.empty(tau.shape[0])
    for i in range(tau.shape[0]):
        clock[i] = steps.start + (low + tau[i])
    code, constants, outputs, _, n_fixed = tape
    found = tape_table(code, constants, outputs, n_fixed, states, steps.parameters, clock)
    for i in range(tau.shape[0]):
        values[i] = found[i, 0]


@kernel
def update_extremes(
    tape: TapeCode, steps: Steps, resolved: Array, low: float, extremes: Array
) -> None:
    """Update minimum and maximum (2,) of the tape's one output by its values along an arc.

    `resolved` (k, n, d + 1): the polynomials of the steps with 0 for undefined variables; they
    determine the pieces in which the output is resolved. `low`: low part of the arc's start time,
    beyond `steps.start`. Undefined values are ignored; `extremes` are NaN before the first value.
    """
    times = steps.times
    known = Steps(times, resolved, steps.parameters, steps.start)
    _, ends = integrate_outputs(tape, known, 0.0, times[-1], EXACT)
    pieces, begin = ends.shape[0], 0.0
    tau = np.zeros(_GRID * pieces + 1)
    for k in range(pieces):
        for i in range(_GRID):
            tau[_GRID * k + i] = begin + (ends[k] - begin) * (i / _GRID)
        begin = ends[k]
    tau[-1] = begin
    grid, near, fine = np.empty(tau.shape[0]), np.empty(_DIVISIONS + 1), np.empty(_DIVISIONS + 1)
    values_along(tape, steps, low, tau, grid)
    last = tau.shape[0] - 1
    for which in range(2):
        sign = 1.0 - 2.0 * which
        best = sign * extremes[which]
        for i in range(last + 1):
            if not sign * grid[i] >= best and grid[i] == grid[i]:
                best = sign * grid[i]
        for i in range(last + 1):
            # Between grid points a smooth function falls below them by at most about its second
            # difference: only points that may hide a lower value are refined.
            k = min(max(i, 1), last - 1)
            here = sign * grid[i]
            if last < 2 or not here - abs(grid[k - 1] - 2.0 * grid[k] + grid[k + 1]) < best:
                continue
            if i > 0 and not here <= sign * grid[i - 1]:
                continue
            if i < last and not here <= sign * grid[i + 1]:
                continue
            left, right = tau[max(i - 1, 0)], tau[min(i + 1, last)]
            for _ in range(_ROUNDS):
                for j in range(_DIVISIONS):
                    near[j] = left + j * ((right - left) / _DIVISIONS)
                near[_DIVISIONS] = right
                values_along(tape, steps, low, near, fine)
                at, least = -1, math.inf
                for j in range(_DIVISIONS + 1):
                    if sign * fine[j] < least:
                        at, least = j, sign * fine[j]
                if at < 0:
                    break
                best = min(best, least)
                left, right = near[max(at - 1, 0)], near[min(at + 1, _DIVISIONS)]
        extremes[which] = sign * best
