"""States of a mode in minimal coordinates: what follows from the others is put where it belongs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array, Ints32
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.formulas.tape import Tape, contiguous
from statechart.formulas.writer import compile_tape
from statechart.kernels.lift import Program, following, lift


class Lift(NamedTuple):
    """What follows from other variables in a flow.

    Attributes
    ----------
    program : tuple
        See `statechart.kernels.lift`.
    """

    program: Program

    def onto(self, state: Array, time: float) -> Array:
        """Return a state (n,) whose dependent coordinates follow from the others."""
        if not len(self.program[3]):
            return state
        moved = np.array(state)
        lift(self.program, moved, time)
        return moved


@dataclass(frozen=True, eq=False)
class Lifting:
    """What follows from other variables in a mode.

    Attributes
    ----------
    tape : Tape
        Outputs: the variables that follow; its variables are those of the automaton, then anchors.
    places : (k,) array
        Of the outputs among the variables.
    anchors : Tape
        Outputs: the anchors, of the state in which a flow begins.
    """

    tape: Tape
    places: Ints32
    anchors: Tape

    def begun(self, state: Array, parameters: Array, time: float) -> Lift:
        """Return what follows in a flow that begins in `state` (n,) at an absolute time."""
        anchors = self.anchors.at(contiguous(state), parameters, time)
        return Lift(following(*self.tape.program, self.places, anchors, parameters, len(state)))


def lifting(automaton: Automaton, mode: Mode) -> Lifting:
    """Return what follows from other variables in a mode."""
    anchors: Mapping[sp.Symbol, sp.Expr] = mode.anchors

    def tape(outputs: Sequence[sp.Expr], further: Sequence[sp.Symbol] = ()) -> Tape:
        return compile_tape(
            outputs,
            variables=(*automaton.variables, *further),
            parameters=automaton.parameters,
            time=automaton.time,
        )

    return Lifting(
        tape(list(mode.eliminated.values()), tuple(anchors)),
        np.array(list(mode.eliminated), dtype=np.int32),
        tape(list(anchors.values())),
    )
