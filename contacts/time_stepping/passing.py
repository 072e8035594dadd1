"""Contacts that pass a surface between two steps.

Steps look at gaps at their midpoints, and between two of these every coordinate moves in a straight
line. A contact that is apart at both ends of such a line and not everywhere on it has been passed
over, and so has one that is deeper somewhere on it than at its end: that landed elsewhere. The
enclosure of its gap along the line tells, however narrow the place.
"""

from __future__ import annotations

import numpy as np

from statechart.arrays import Bools
from statechart.kernels.boxes import Steps, along_steps, enclose, prepare
from statechart.kernels.jit import kernel
from statechart.kernels.resolution import jet_registers
from statechart.kernels.tapes import TapeCode

# Boxes of a line; what they leave undecided touches at most.
_BOXES = 256
_NARROW = 2.0**-32  # of a line, likewise


@kernel
def passed(tape: TapeCode, lines: Steps, seen: Bools, near: float) -> tuple[int, int, float]:
    """First line on which a gap that is open where it begins is less than where it ends.

    Parameters
    ----------
    tape : TapeCode
        The gaps (c,).
    lines : Steps
        The lines (m) as steps.
    seen : (m, c) array of bool
        Contacts that take part in the motion where the line begins.
    near : float
        What is no deeper than this has touched.

    Returns
    -------
    line, contact : int
        -1 where there is none.
    part : float
        How long the contact is closed at least, in parts of the line.
    """
    outputs, reads, coeffs = tape.outputs, tape.reads, lines.coeffs
    along, regs = along_steps(tape, lines, 1)
    jets = jet_registers(along, regs)
    bounds, count = np.zeros(coeffs.shape[1]), outputs.shape[0]
    asked, depths = np.empty(count, np.bool_), np.empty(count)
    lefts, rights = np.empty(64), np.empty(64)
    for line in range(coeffs.shape[0]):
        prepare(coeffs, line, reads, bounds)
        enclose(along, line, bounds, 0.0, 0.0, 0, jets)
        for i in range(count):
            asked[i] = not seen[line, i] and jets[outputs[i], 0] > 0.0
        enclose(along, line, bounds, 1.0, 0.0, 0, jets)
        for i in range(count):
            depths[i] = min(jets[outputs[i], 0], 0.0) - near
        top, boxes = 1, 0
        lefts[0], rights[0] = 0.0, 1.0
        while top > 0 and boxes < _BOXES:
            top -= 1
            boxes += 1
            a, b = lefts[top], rights[top]
            m = 0.5 * (a + b)
            enclose(along, line, bounds, m, 0.5 * (b - a), 0, jets)
            clear = True
            for i in range(count):
                clear = clear and not (asked[i] and jets[outputs[i], 0] <= depths[i])
            if clear or b - a <= _NARROW:
                continue
            enclose(along, line, bounds, m, 0.0, 0, jets)
            for i in range(count):
                if asked[i] and jets[outputs[i], 1] < depths[i]:
                    return line, i, b - a
            lefts[top], rights[top] = m, b
            lefts[top + 1], rights[top + 1] = a, m
            top += 2
    return -1, -1, 0.0
