"""How far a state is off the constraints of a flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from statechart.compiled import kernel
from statechart.kernels.tapes import tape_values

__all__ = ["off_by"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@kernel
def off_by(
    code: Ints,
    constants: Floats,
    outputs: Ints,
    targets: Floats,
    weights: Floats,
    state: Floats,
    parameters: Floats,
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
