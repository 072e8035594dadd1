"""Defect p' - f(p) of the polynomials of steps, sampled where the rates f are resolved."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.boxes import Steps, StepTape, bind_tape, bound_third_derivatives
from statechart.kernels.intervals import INF
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import slopes_at, write_sizes
from statechart.kernels.resolution import (
    NARROW,
    PLACES,
    bound_box,
    bound_box_tightly,
    evaluate_at_places,
    jet_registers,
)
from statechart.kernels.tapes import TapeCode

# A slope is the sum of a series, and has more round-off than a rate.
_SERIES = 64.0
_NEXT = 2.0**-20
# Part of the allowed defect that a box may miss without further bisection.
_SHARE = 1.0 / 64.0


@kernel
def is_unresolved(outputs: Ints32, jets: Array, time: float, allowed: float, sizes: Array) -> bool:
    """Return whether unresolved parts of the rates may move a variable farther than `allowed`."""
    rough = False
    for v in range(sizes.shape[0]):
        rough = rough or not time * jets[outputs[v], 2] <= _SHARE * allowed * sizes[v]
    return rough


@kernel
def find_defect(
    tape: TapeCode, steps: Steps, first: int, last: int, floors: Array, allowed: float, budget: int
) -> tuple[int, float, float, int]:
    """Find the first box of the steps [first, last) whose polynomials may violate the rates.

    The tape has the rates of all variables. Defects are relative to the size and motion of a
    variable in a step, at least `floors` (n,); `allowed` is their bound, `budget` the largest
    number of boxes per step. Returns the step (-1 if there is none), the end of the box, its
    relative defect (infinite if unknown), and the number of boxes.
    """
    outputs, reads, times, coeffs = tape.outputs, tape.reads, steps.times, steps.coeffs
    n = coeffs.shape[1]
    step_tape, regs = bind_tape(tape, steps, PLACES.shape[0])
    jets = jet_registers(step_tape, regs)
    bounds, sizes, rounding = np.zeros(n), np.empty(n), np.empty(n)
    lefts, rights = np.empty(64), np.empty(64)
    boxes = 0
    for step in range(first, last):
        h = times[step + 1] - times[step]
        if not h > 0.0:
            continue
        bound_third_derivatives(coeffs, step, reads, bounds)
        write_sizes(coeffs, step, floors, sizes)
        top, looked, known = 1, 0, False
        rounding[:] = 0.0
        lefts[0], rights[0] = 0.0, 1.0
        while top > 0:
            top -= 1
            a, b = lefts[top], rights[top]
            m, looked = 0.5 * (a + b), looked + 1
            bound_box(step_tape, step, bounds, a, b, jets)
            rough = is_unresolved(outputs, jets, h * (b - a), allowed, sizes)
            if rough:
                bound_box_tightly(step_tape, step, bounds, a, b, jets)
                rough = is_unresolved(outputs, jets, h * (b - a), allowed, sizes)
            if rough:
                if b - a <= NARROW:
                    continue
                if looked >= budget:
                    return step, b, INF, boxes + looked
                lefts[top], rights[top] = m, b
                lefts[top + 1], rights[top + 1] = a, m
                top += 2
                continue
            off = _sampled_defect(step_tape, outputs, step, a, b, sizes, rounding, regs)
            if not (off <= allowed or known):
                known = True
                _estimate_round_off(step_tape, outputs, step, h, rounding, regs)
                off = _sampled_defect(step_tape, outputs, step, a, b, sizes, rounding, regs)
            if not off <= allowed:
                return step, b, off, boxes + looked
        boxes += looked
    return -1, 0.0, 0.0, boxes


@kernel
def _sampled_defect(
    step_tape: StepTape,
    outputs: Ints32,
    step: int,
    a: float,
    b: float,
    sizes: Array,
    rounding: Array,
    regs: Array,
) -> float:
    """Return the largest sampled defect of a box, minus round-off, relative to sizes."""
    times, coeffs, worst = step_tape[5], step_tape[6], 0.0
    h = times[step + 1] - times[step]
    evaluate_at_places(step_tape, step, a, b, PLACES, regs)
    w = b - a
    places = a + PLACES[0] * w, a + PLACES[1] * w, a + PLACES[2] * w
    for v in range(coeffs.shape[1]):
        slopes = slopes_at(coeffs, step, v, places)
        for j in range(PLACES.shape[0]):
            off = abs(slopes[j] - h * regs[outputs[v], j])
            if off <= rounding[v]:
                continue
            # An undefined rate is an infinite defect.
            worst = max(worst, off / sizes[v] if off == off else INF)
    return worst


@kernel
def _estimate_round_off(
    step_tape: StepTape, outputs: Ints32, step: int, h: float, rounding: Array, regs: Array
) -> None:
    """Write the round-off of slopes, from the start of a step, where they are the rates."""
    coeffs = step_tape[6]
    evaluate_at_places(step_tape, step, 0.0, _NEXT, PLACES, regs)
    for v in range(coeffs.shape[1]):
        rounding[v] = 0.0
        for j in range(PLACES.shape[0]):
            s = _NEXT * PLACES[j]
            slope = coeffs[step, v, 1] + (
                2.0 * s * coeffs[step, v, 2] if len(coeffs[0, 0]) > 2 else 0.0
            )
            off = abs(slope - h * regs[outputs[v], j])
            rounding[v] = max(rounding[v], _SERIES * off if off == off else 0.0)
