"""Workspace of searches, and tapes prepared in it for evaluation along steps.

A search evaluates all outputs on a whole step, and only undecided ones on smaller boxes: the
operations of the others are then skipped.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.boxes import Steps, StepTape
from statechart.kernels.intervals import INF
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import POW, SKIP, TapeCode, run_tape, write_inputs

BOXES = 64
"""Largest number of pending boxes: the bisections down to the narrowest box."""

Needed = tuple[Ints, Ints32, Ints32, Ints]
"""For every register the set of outputs that need it; the selected operations and variables; the
selected set of outputs, the end of the operations, the number of variables."""

# Bits of a set; further outputs share the last bit.
_BITS = 62

PreparedTape = tuple[StepTape, Needed, Array, Array, Array, Array, Array, NDArray[np.uint8]]
"""A tape bound to steps, with evaluated functions of parameters: `StepTape`, `Needed`; bounds of
third derivatives, registers, jets; enclosures of the outputs (see `judge`); pending boxes, and the
outputs undecided in them."""


class SearchWorkspace(NamedTuple):
    """Workspace of a search, for tapes of up to r registers, c operations and o outputs."""

    registers: Array  # shape (r, 1)
    jets: Array  # shape (r, 6)
    needs: Ints  # shape (r,)
    code: Ints32  # shape (c, 3)
    # See `Needed`.
    variables: Ints32  # shape (n + 1,)
    selection: Ints  # shape (3,)
    bounds: Array  # (n,): bounds of third derivatives.
    # Enclosures of the outputs; pending boxes, and the undecided outputs of each.
    evidence: Array  # shape (o + 1, 11)
    ends: Array  # shape (2, b)
    marks: NDArray[np.uint8]  # shape (b + 1, o)


@kernel
def search_workspace(
    registers: int, operations: int, outputs: int, variables: int
) -> SearchWorkspace:
    """Allocate the workspace of a search."""
    return SearchWorkspace(
        np.empty((registers, 1)),
        np.empty((registers, 6)),
        np.empty(registers, np.int64),
        np.empty((operations, 3), np.int32),
        np.empty(variables + 1, np.int32),
        np.empty(3, np.int64),
        np.empty(variables),
        np.empty((outputs + 1, 11)),
        np.empty((2, BOXES)),
        np.empty((BOXES + 1, outputs), np.uint8),
    )


@kernel
def prepare_tape(tape: TapeCode, steps: Steps, workspace: SearchWorkspace) -> PreparedTape:
    """Evaluate the operations that depend on parameters alone."""
    code, constants, outputs, reads, n_fixed = tape
    times, coeffs, parameters, start = steps
    n, regs, jets = coeffs.shape[1], workspace.registers, workspace.jets
    base = n + 1 + parameters.shape[0] + constants.shape[0]
    write_inputs(constants, parameters, n, regs)
    step_tape = (code, base, n_fixed, code.shape[0], reads, times, coeffs, start)
    run_tape(code, 0, n_fixed, base, regs, 1)
    for r in range(base + code.shape[0]):
        for c in range(6):
            jets[r, c] = 0.0
    for r in range(n + 1, base):
        jets[r, 0] = jets[r, 1] = regs[r, 0]
        if not abs(regs[r, 0]) < INF:
            jets[r, 0], jets[r, 1] = -INF, INF
    run_jets(code, 0, n_fixed, base, jets, 2)
    for v in range(n):
        workspace.bounds[v] = 0.0
    needs = workspace.needs, workspace.code, workspace.variables, workspace.selection
    mark_needed(step_tape, outputs, needs)
    return (
        step_tape,
        needs,
        workspace.bounds,
        regs,
        jets,
        workspace.evidence,
        workspace.ends,
        workspace.marks,
    )


@kernel
def output_bit(output: int) -> int:
    """Return the set that contains one output."""
    return 1 << min(output, _BITS)


@kernel
def mark_needed(step_tape: StepTape, outputs: Ints32, needed: Needed) -> None:
    """Mark the registers that each output needs, over the operations that `step_tape` runs."""
    needs, chosen, _, selection = needed
    code, base, first, last = step_tape[:4]
    for r in range(base + code.shape[0]):
        needs[r] = 0
    for i in range(outputs.shape[0]):
        needs[outputs[i]] |= output_bit(i)
    for k in range(code.shape[0]):
        chosen[k, 0], chosen[k, 1], chosen[k, 2] = code[k, 0], code[k, 1], code[k, 2]
    for k in range(last - 1, first - 1, -1):
        needs[code[k, 1]] |= needs[base + k]
        if code[k, 0] <= POW:
            needs[code[k, 2]] |= needs[base + k]
    selection[0] = selection[1] = selection[2] = 0


@kernel
def select_outputs(needed: Needed, step_tape: StepTape, outputs: int) -> StepTape:
    """Return `step_tape` with only the operations and variables that a set of outputs needs."""
    needs, chosen, variables, selection = needed
    code, base, first, last, reads, times, coeffs, start = step_tape
    if selection[0] != outputs:
        end, count = first, 0
        for k in range(first, last):
            if needs[base + k] & outputs != 0:
                chosen[k, 0] = code[k, 0]
                end = k + 1
            else:
                chosen[k, 0] = SKIP
        for r in range(reads.shape[0]):
            if needs[reads[r]] & outputs != 0:
                variables[count] = reads[r]
                count += 1
        selection[0], selection[1], selection[2] = outputs, end, count
    return chosen, base, first, selection[1], variables[: selection[2]], times, coeffs, start
