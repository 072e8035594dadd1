"""Least and greatest value of a tape along the polynomials of steps."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.kernels.boxes import Steps
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import sample_states
from statechart.kernels.quadrature import integrate_outputs
from statechart.kernels.tapes import TapeCode, tape_table

# Grid on which extremes are looked for, in every piece of a step, before they are refined.
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
    """Bring the least and the greatest value up to date by those along an arc.

    Of one output, along the steps of an arc; `resolved` (k, n, d + 1) are its polynomials without
    what has no value: pieces are looked for there, nothing in one is narrower than it. `low` is the
    part of the arc's start that is too small for `steps.start`. `extremes` (2,) are not numbers
    where nothing had a value; what has none does not count.
    """
    times = steps.times
    known = Steps(times, resolved, steps.parameters, steps.start)
    _, ends = integrate_outputs(tape, known, 0.0, times[-1])
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
            # Between grid points a smooth function is below them by at most about its second
            # difference; only points that may hide a lower value are refined.
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
