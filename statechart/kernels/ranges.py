"""Interval enclosure of a tape's outputs over a span of time, the state held fixed."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.intervals import INF
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import kernel


@kernel
def tape_ranges(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    state: Array,
    parameters: Array,
    end: float,
    ranges: Array,
) -> None:
    """Write the enclosures (n_out, 2) of the outputs over the times [0, end].

    Natural interval extension: bounds of outputs that name the time more than once may be wide,
    and are infinite where an output is undefined.
    """
    n, p = state.shape[0], parameters.shape[0]
    base = n + 1 + p + constants.shape[0]
    jets = np.zeros((base + code.shape[0], 6))
    for v in range(n):
        jets[v, 0] = jets[v, 1] = state[v]
    jets[n, 1] = end
    for k in range(p):
        jets[n + 1 + k, 0] = jets[n + 1 + k, 1] = parameters[k]
    for k in range(constants.shape[0]):
        jets[n + 1 + p + k, 0] = jets[n + 1 + p + k, 1] = constants[k]
    for r in range(base):
        if not jets[r, 1] - jets[r, 0] < INF:
            jets[r, 0], jets[r, 1] = -INF, INF
    run_jets(code, 0, code.shape[0], base, jets, 0)
    for i in range(outputs.shape[0]):
        ranges[i, 0], ranges[i, 1] = jets[outputs[i], 0], jets[outputs[i], 1]
