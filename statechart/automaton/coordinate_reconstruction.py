"""Dependent coordinates of a mode, reconstructed from its minimal coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array, Ints32
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.formulas.tape import Tape, contiguous
from statechart.formulas.writer import compile_tape
from statechart.kernels.reconstruction import Program, reconstruct, reconstruction_program


class Reconstruction(NamedTuple):
    """Reconstruction of the dependent coordinates in one flow."""

    program: Program

    def onto(self, state: Array, time: float) -> Array:
        """Return a state (n,) whose dependent coordinates follow from the others."""
        if not len(self.program[3]):
            return state
        moved = np.array(state)
        reconstruct(self.program, moved, time)
        return moved


@dataclass(frozen=True, eq=False)
class ModeReconstruction:
    """Reconstruction of the dependent coordinates in the flows of a mode."""

    # Outputs: the dependent coordinates; its variables are those of the automaton, then anchors.
    tape: Tape
    places: Ints32  # (k,): of the outputs among the variables.
    anchors: Tape  # Outputs: the anchors, of the state in which a flow begins.

    def begun(self, state: Array, parameters: Array, time: float) -> Reconstruction:
        """Return the reconstruction in a flow that begins in `state` (n,) at an absolute time."""
        anchors = self.anchors.at(contiguous(state), parameters, time)
        program = self.tape.program
        return Reconstruction(
            reconstruction_program(*program, self.places, anchors, parameters, len(state))
        )


def mode_reconstruction(automaton: Automaton, mode: Mode) -> ModeReconstruction:
    """Compile the reconstruction of the coordinates that a mode eliminates."""

    def tape(outputs: Sequence[sp.Expr], further: Sequence[sp.Symbol] = ()) -> Tape:
        return compile_tape(
            outputs,
            variables=(*automaton.variables, *further),
            parameters=automaton.parameters,
            time=automaton.time,
        )

    return ModeReconstruction(
        tape([*mode.eliminated.values()], [*mode.anchors]),
        np.array([*mode.eliminated], dtype=np.int32),
        tape([*mode.anchors.values()]),
    )
