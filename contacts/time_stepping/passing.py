"""Detection of contacts that pass a surface between two steps (tunnelling).

Steps evaluate gaps at midpoints, between which coordinates move in straight lines. A contact that
is open at both ends of a line and closed in between passed its surface; one that is deeper in
between than at the end landed elsewhere. An interval enclosure of the gap along the line decides,
however short the overlap.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Bools
from statechart.kernels.boxes import Steps, bind_tape, bound_third_derivatives, enclose
from statechart.kernels.jit import kernel
from statechart.kernels.resolution import jet_registers
from statechart.kernels.tapes import TapeCode

# Limits of bisection: boxes per line, and width relative to the line. The rest touches at most.
_BOXES, _NARROW = 256, 2.0**-32


@kernel
def find_passage(tape: TapeCode, lines: Steps, seen: Bools, near: float) -> tuple[int, int, float]:
    """Return (line, contact, part) of the first line whose open gap at the start is below its end.

    The tape has the gaps (c,), `lines` are m steps; contacts `seen` (m, c) are active at the start
    of a line; a depth up to `near` only touches. `part` is a lower bound of the closed part of the
    line; line and contact are -1 if there is none.
    """
    outputs, reads, coeffs = tape.outputs, tape.reads, lines.coeffs
    step_tape, regs = bind_tape(tape, lines, 1)
    jets = jet_registers(step_tape, regs)
    bounds, count = np.zeros(coeffs.shape[1]), outputs.shape[0]
    is_open, depths = np.empty(count, np.bool_), np.empty(count)
    lefts, rights = np.empty(64), np.empty(64)
    for line in range(coeffs.shape[0]):
        bound_third_derivatives(coeffs, line, reads, bounds)
        enclose(step_tape, line, bounds, 0.0, 0.0, 0, jets)
        for i in range(count):
            is_open[i] = not seen[line, i] and jets[outputs[i], 0] > 0.0
        enclose(step_tape, line, bounds, 1.0, 0.0, 0, jets)
        for i in range(count):
            depths[i] = min(jets[outputs[i], 0], 0.0) - near
        top, boxes = 1, 0
        lefts[0], rights[0] = 0.0, 1.0
        while top > 0 and boxes < _BOXES:
            top -= 1
            boxes += 1
            a, b = lefts[top], rights[top]
            m = 0.5 * (a + b)
            enclose(step_tape, line, bounds, m, 0.5 * (b - a), 0, jets)
            clear = True
            for i in range(count):
                clear = clear and not (is_open[i] and jets[outputs[i], 0] <= depths[i])
            if clear or b - a <= _NARROW:
                continue
            enclose(step_tape, line, bounds, m, 0.0, 0, jets)
            for i in range(count):
                if is_open[i] and jets[outputs[i], 1] < depths[i]:
                    return line, i, b - a
            lefts[top], rights[top] = m, b
            lefts[top + 1], rights[top + 1] = a, m
            top += 2
    return -1, -1, 0.0
