"""Memory of searches, and tapes made ready in it to be evaluated along steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints, Ints32
from statechart.kernels.boxes import Along
from statechart.kernels.intervals import INF
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel
from statechart.kernels.needed import Needed, follow
from statechart.kernels.tapes import fill, run_tape

BOXES = 64
"""Boxes still to see, at most: halves of halves down to the narrowest."""

Ready = tuple[Along, Needed, Array, Array, Array, Array, Array, NDArray[np.uint8]]
"""A tape that is evaluated along steps, with what depends on parameters alone: see `Along`, and
`Needed`; bounds of third derivatives, registers, jets; evidence on the outputs; boxes still to see,
and the outputs that are undecided in them."""


class Memory(NamedTuple):
    """Memory to search in, for tapes of up to r registers, c operations and o outputs."""

    registers: Array  # shape (r, 1)
    jets: Array  # shape (r, 6)
    needs: Ints  # shape (r,)
    code: Ints32  # shape (c, 3)
    # See `statechart.kernels.needed`.
    variables: Ints32  # shape (n + 1,)
    kept: Ints  # shape (3,)
    bounds: Array  # (n,): of third derivatives.
    # On the outputs; boxes still to see, and what is undecided in them.
    evidence: Array  # shape (o + 1, 11)
    ends: Array  # shape (2, b)
    marks: NDArray[np.uint8]  # shape (b + 1, o)


@kernel
def room(registers: int, operations: int, outputs: int, variables: int) -> Memory:
    """Return memory to search in."""
    return Memory(
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
def ready_along(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    reads: Ints32,
    n_fixed: int,
    times: Array,
    coeffs: Array,
    parameters: Array,
    start: float,
    memory: Memory,
) -> Ready:
    """Evaluate what depends on parameters alone."""
    n, regs, jets = coeffs.shape[1], memory.registers, memory.jets
    base = n + 1 + parameters.shape[0] + constants.shape[0]
    fill(constants, parameters, n, regs)
    along = (code, base, n_fixed, code.shape[0], reads, times, coeffs, start)
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
        memory.bounds[v] = 0.0
    needs = memory.needs, memory.code, memory.variables, memory.kept
    follow(along, outputs, needs)
    return along, needs, memory.bounds, regs, jets, memory.evidence, memory.ends, memory.marks
