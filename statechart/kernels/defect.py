"""Defect of the polynomials of steps, sampled where functions are resolved."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.boxes import Steps, StepTape, bind_tape, prepare
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

# Slopes are sums of a series, whose terms are rounded more often than a rate is.
_SERIES = 64.0
_NEXT = 2.0**-20
# A box that is looked at no closer may miss this part of what is allowed in a step.
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
    """First box of the steps [first, last) whose polynomials may not follow the rates.

    The tape has the rates of all variables; a variable that is smaller counts as `floors` (n,).
    What is missed may move one by the part `allowed` of what it is and moves in a step; `budget` is
    the greatest number of boxes of a step. Returns the step (-1 if there is none), the place where
    the box ends, how far the polynomials are off the rates in it, as for `allowed` (infinite if
    that is not known), and the number of boxes looked at.
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
        prepare(coeffs, step, reads, bounds)
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
            off = _defect(step_tape, outputs, step, a, b, sizes, rounding, regs)
            if not (off <= allowed or known):
                known = True
                _round(step_tape, outputs, step, h, rounding, regs)
                off = _defect(step_tape, outputs, step, a, b, sizes, rounding, regs)
            if not off <= allowed:
                return step, b, off, boxes + looked
        boxes += looked
    return -1, 0.0, 0.0, boxes


@kernel
def _defect(
    step_tape: StepTape,
    outputs: Ints32,
    step: int,
    a: float,
    b: float,
    sizes: Array,
    rounding: Array,
    regs: Array,
) -> float:
    """Return the largest defect at places of a box, beyond round-off, relative to sizes."""
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
            # A rate without a value counts as infinitely far off.
            worst = max(worst, off / sizes[v] if off == off else INF)
    return worst


@kernel
def _round(
    step_tape: StepTape, outputs: Ints32, step: int, h: float, rounding: Array, regs: Array
) -> None:
    """Write the round-off of slopes; near the beginning of a step these are the rates."""
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
