"""Distance of a state from the constraints of a flow."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values


@kernel
def off_by(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    targets: Array,
    weights: Array,
    state: Array,
    parameters: Array,
    time: float,
) -> float:
    """Largest distance of an output from its target, weighted; those without a value count not."""
    numbers = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, state, parameters, time, numbers)
    off = 0.0
    for i in range(numbers.shape[0]):
        distance = weights[i] * abs(numbers[i] - targets[i])
        if distance > off:
            off = distance
    return off
