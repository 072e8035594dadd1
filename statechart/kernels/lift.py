"""The variables that follow from the others, written into a state."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array, Ints32
from statechart.kernels.copies import put
from statechart.kernels.jit import part, seldom
from statechart.kernels.tapes import tape_values

Program = tuple[Ints32, Array, Ints32, Ints32, Array]
"""Code, constants and outputs of a tape; places (k,) of its outputs in a state (n,); the anchors
of the flow, which the tape reads behind the state."""


@seldom
def lift(program: Program, state: Array, parameters: Array, time: float) -> None:
    """Write what follows from the rest of `state` into it."""
    code, constants, outputs, places, anchors = program
    n = state.shape[0]
    inputs = np.empty(n + anchors.shape[0])
    put(state, inputs)
    for i in range(anchors.shape[0]):
        inputs[n + i] = anchors[i]
    values = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, inputs, parameters, time, values)
    for i in range(places.shape[0]):
        state[places[i]] = values[i]


@part
def lift_any(program: Program, state: Array, parameters: Array, time: float) -> None:
    """Do what `lift` does where something follows, and nothing where nothing does."""
    if program[3].shape[0] > 0:
        lift(program, state, parameters, time)
