"""Algebraic constraints of a flow."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.trace import Roles
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape
from statechart.kernels.tapes import largest_deviation


class Constraints(NamedTuple):
    """Quantities that a flow keeps at their targets."""

    tape: Tape  # Outputs: the numbers.
    # (k,): of the outputs; a weight is one through the tolerance, 0 where a number is free.
    targets: Array
    weights: Array
    # From a state that is off and the absolute time to the nearest one that is not; the same object
    # where it cannot be brought nearer. Of bodies, with other values of the parameters, too.
    project: Callable[..., Array]
    # An output below minus `max_depth` along a step shows that the step passed over an obstacle of
    # the flow (a narrow bump under a sliding point); None where that cannot be.
    within: Tape | None = None
    max_depth: float = 0.0
    # From a state, the absolute time and the parameters of a flow as a role (none: those of the
    # run) to those that the flow needs from there; None where they never change.
    fixed: Callable[[Array, float, Roles], Roles] | None = None

    def off(self, state: Array, parameters: Array, time: float) -> float:
        """Return how far a state is off, in tolerances."""
        return largest_deviation(
            *self.tape.program, self.targets, self.weights, state, parameters, time
        )


NO_CONSTRAINTS = Constraints(
    compile_tape((), variables=(), parameters=(), time=sp.Symbol("t", real=True)),
    np.empty(0),
    np.empty(0),
    lambda state, _: state,
)
"""Constraints of a flow that its differential equation alone determines."""
