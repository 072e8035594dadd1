"""Reconstruction of the dependent variables of a state from the independent ones."""

from __future__ import annotations

from statechart.arrays import Array, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import allocate_registers, run_tape

ReconstructionProgram = tuple[Ints32, int, Ints32, Ints32, int, Array]
"""Code of a tape, register of its first operation, its outputs; their indices (k,) in a state (n,);
register of the time; registers, with the constants of the flow filled in."""


@kernel
def reconstruction_program(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    places: Ints32,
    anchors: Array,
    parameters: Array,
    variables: int,
) -> ReconstructionProgram:
    """Return the program that reconstructs the dependent variables of a flow.

    `places` (k,): indices of the tape's outputs in a state with `variables` numbers; the inputs of
    the tape are the state and the `anchors` (a,) of the flow.
    """
    clock = variables + anchors.shape[0]
    base, registers = allocate_registers(code, constants, parameters, clock, 1)
    for i in range(anchors.shape[0]):
        registers[variables + i, 0] = anchors[i]
    return code, base, outputs, places, clock, registers


@kernel
def reconstruct(program: ReconstructionProgram, state: Array, time: float) -> None:
    """Write the dependent variables of `state`."""
    code, base, outputs, places, clock, registers = program
    for v in range(state.shape[0]):
        registers[v, 0] = state[v]
    registers[clock, 0] = time
    run_tape(code, 0, code.shape[0], base, registers, 1)
    for i in range(places.shape[0]):
        state[places[i]] = registers[outputs[i], 0]


@kernel
def reconstruct_any(program: ReconstructionProgram, state: Array, time: float) -> None:
    """Write the dependent variables of `state`, if there are any."""
    if program[3].shape[0] > 0:
        reconstruct(program, state, time)
