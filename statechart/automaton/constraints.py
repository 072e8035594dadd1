"""Algebraic constraints of a flow."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape
from statechart.kernels.tapes import largest_deviation


class Constraints(NamedTuple):
    """Constraint functions that a flow keeps at their targets."""

    tape: Tape  # outputs: the constraint functions
    targets: Array  # (k,)
    weights: Array  # (k,) inverse tolerances, 0 for inactive constraints
    # (state, absolute time) -> projected state; the same object if not improved
    project: Callable[[Array, float], Array]
    # Outputs below -max_depth show that a step jumped over an obstacle (a narrow bump).
    within: Tape | None = None
    max_depth: float = 0.0

    def off(self, state: Array, parameters: Array, time: float) -> float:
        """Return the largest residual of a state, in tolerances."""
        if not len(self.targets):
            return 0.0
        return largest_deviation(
            *self.tape.program, self.targets, self.weights, state, parameters, time
        )


NO_CONSTRAINTS = Constraints(
    compile_tape((), variables=(), parameters=(), time=sp.Symbol("t", real=True)),
    np.empty(0),
    np.empty(0),
    lambda state, _: state,
)
"""Constraints of an unconstrained flow."""
