"""Gauss quadrature of tapes along the polynomials of steps, in pieces that resolve them."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Bools, Ints32
from statechart.kernels.boxes import Steps, bind_tape, bound_third_derivatives
from statechart.kernels.copies import copy_numbers
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import local_time
from statechart.kernels.resolution import (
    NARROW,
    PLACES,
    bound_box,
    bound_step,
    evaluate_at_places,
    jet_registers,
    refine_roughness,
)
from statechart.kernels.tapes import TapeCode

EXACT = 1e-15
"""Relative tolerance of integrals and extremes, to the largest value."""
# Features below this multiple of a function's round-off are not resolved.
_ROUNDINGS = 8.0
# Far above the underflow margin of enclosures.
_NOTHING = 1e-280
# Largest number of pieces per step.
_MAX_PIECES = 1 << 14

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES = (_NODES + 1.0) / 2.0
_WEIGHTS = _WEIGHTS / 2.0


@kernel
def _is_unresolved(
    outputs: Ints32, jets: Array, width: float, undefined: Bools, largest: Array, rough: Array,
    tolerance: float,
) -> bool:  # fmt: skip
    """Return whether a piece is unresolved for some output; write the roughness of each."""
    missed = False
    for i in range(outputs.shape[0]):
        rough[i] = jets[outputs[i], 2]
        near = width * rough[i] <= tolerance * largest[i] + _NOTHING
        missed = missed or not (undefined[i] or near)
    return missed


@kernel
def integrate_outputs(
    tape: TapeCode, steps: Steps, t_from: float, t_to: float, tolerance: float
) -> tuple[Array, Array]:
    """Return the integrals (k, n_out) of each step within [t_from, t_to], and the ends of pieces.

    Times are local. Steps are halved until all outputs are resolved in each piece, to a `tolerance`
    relative to the largest value (`EXACT`: kinks down to round-off); pieces have 16 Gauss nodes.
    """
    outputs, reads, times, coeffs = tape.outputs, tape.reads, steps.times, steps.coeffs
    count = _NODES.shape[0]
    step_tape, regs = bind_tape(tape, steps, count)
    jets, bounds = jet_registers(step_tape, regs), np.zeros(coeffs.shape[1])
    result, sizes = np.zeros((coeffs.shape[0], outputs.shape[0])), np.zeros((3, outputs.shape[0]))
    largest, rough, noise = sizes[0], sizes[1], sizes[2]
    undefined = np.empty(outputs.shape[0], np.bool_)
    lefts, rights = np.empty(64), np.empty(64)
    ends, pieces = np.empty(2 * coeffs.shape[0] + 1), 0
    for step in range(coeffs.shape[0]):
        low, high = max(t_from, times[step]), min(t_to, times[step + 1])
        if not low < high:
            continue
        span = times[step + 1] - times[step]
        top, looked, prepared = 1, 0, False
        lefts[0], rights[0] = (low - times[step]) / span, (high - times[step]) / span
        while top > 0:
            top -= 1
            a, b = lefts[top], rights[top]
            looked += 1
            evaluate_at_places(step_tape, step, a, b, _NODES, regs)
            for i in range(outputs.shape[0]):
                undefined[i] = False
                for j in range(count):
                    value = abs(regs[outputs[i], j])
                    undefined[i] = undefined[i] or value != value
                    largest[i] = max(largest[i], value)
            whole = b - a == 1.0 and bound_step(step_tape, step, jets)
            halve = not whole or _is_unresolved(
                outputs, jets, b - a, undefined, largest, rough, tolerance
            )
            if halve:
                if not prepared:
                    bound_third_derivatives(coeffs, step, reads, bounds)
                    prepared = True
                bound_box(step_tape, step, bounds, a, b, jets)
                halve = _is_unresolved(outputs, jets, b - a, undefined, largest, rough, tolerance)
            if halve:
                # Roughness that is the same at single places, or within the round-off of values
                # there, is the round-off of a kink at zero.
                halve, rounded = False, np.empty(jets.shape[0])
                for j in range(2):
                    s = a + PLACES[j + 1] * (b - a)
                    bound_box(step_tape, step, bounds, s, s, jets)
                    for r in range(jets.shape[0]):
                        rounded[r] = max(jets[r, 1] - jets[r, 0], rounded[r] if j == 1 else 0.0)
                    for i in range(outputs.shape[0]):
                        here = jets[outputs[i], 2] + _ROUNDINGS * rounded[outputs[i]]
                        noise[i] = min(noise[i], here) if j == 1 else here
                bound_box(step_tape, step, bounds, a, b, jets)
                refine_roughness(step_tape, regs, count, rounded, jets)
                for i in range(outputs.shape[0]):
                    more = min(rough[i], jets[outputs[i], 2]) - noise[i]
                    missed = (b - a) * more if more > 0.0 else 0.0
                    halve = halve or not (
                        undefined[i] or missed <= tolerance * largest[i] + _NOTHING
                    )
            if halve and b - a > NARROW and looked < _MAX_PIECES:
                m = 0.5 * (a + b)
                lefts[top], rights[top] = m, b
                lefts[top + 1], rights[top + 1] = a, m
                top += 2
                continue
            for i in range(outputs.shape[0]):
                total = 0.0
                for j in range(count):
                    total += _WEIGHTS[j] * regs[outputs[i], j]
                result[step, i] += total * (b - a) * span
            if pieces == ends.shape[0]:
                longer = np.empty(2 * pieces)
                copy_numbers(ends, longer)
                ends = longer
            ends[pieces] = high if top == 0 else local_time(times, step, b)
            pieces += 1
    return result, ends[:pieces]
