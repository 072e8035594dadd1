"""Interval enclosure of a tape's outputs over a span of time, the state held fixed."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.intervals import INF
from statechart.kernels.jets import run_jets
from statechart.kernels.jit import seldom


@seldom
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
    for r in range(base):
        if r == n:
            low, high = 0.0, end
        else:
            low = (
                state[r]
                if r < n
                else parameters[r - n - 1]
                if r <= n + p
                else constants[r - n - 1 - p]
            )
            high = low
        if not high - low < INF:
            low, high = -INF, INF
        jets[r, 0], jets[r, 1] = low, high
    run_jets(code, 0, code.shape[0], base, jets, 0)
    for i in range(outputs.shape[0]):
        ranges[i, 0], ranges[i, 1] = jets[outputs[i], 0], jets[outputs[i], 1]
