"""Stop conditions of a run by steps as programs: their margins, and the sizes of these."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.time_stepping.active_states import ActiveStates
from statechart.arrays import Array, Bools
from statechart.automaton.margin_derivatives import rounding_scale
from statechart.automaton.regions import Region, StopCondition
from statechart.formulas.tape import Tape


class StopTapes:
    """The stop conditions of a scene, on tape.

    Attributes
    ----------
    stops : tuple of StopCondition
    margins : Tape
        Those of the atoms, over variables and unknowns.
    counts : (2, a) array of bool
        Which atoms hold on their boundary, too, where they stay there for a step; and at once, of
        what jumps alone change, so that no motion tells the way it goes.
    active : ActiveStates
    """

    def __init__(
        self,
        mechanics: Mechanics,
        stops: Sequence[StopCondition],
        unknowns: Sequence[sp.Symbol],
        regions: Sequence[Region],
    ) -> None:
        self._mechanics, self._unknowns, self.stops = mechanics, unknowns, tuple(stops)
        atoms = [atom for stop in stops for atom in stop.condition.atoms]
        self._conditions = [atom.expression for atom in atoms]
        self.margins: Tape = mechanics.whole_tape(self._conditions, unknowns=unknowns)
        flowing = mechanics.scene.controlled.flowing
        still = {*mechanics.parameters.ordered}
        still |= {symbol for name, symbol in mechanics.memory.items() if name not in flowing}
        stays = np.array([not atom.strict for atom in atoms], np.bool_)
        jumps = np.array([atom.expression.free_symbols <= still for atom in atoms], np.bool_)
        self.counts: Bools = np.stack([stays, stays & jumps])
        self.active = ActiveStates(regions)

    @cached_property
    def _of_terms(self) -> Tape:
        """Sizes of the margins' terms, over inputs and the sizes of inputs."""
        mechanics = self._mechanics
        inputs = (*mechanics.variables, *mechanics.memory.values(), *self._unknowns)
        sizes = {symbol: sp.Symbol(f"size_{symbol}", real=True) for symbol in inputs}
        return mechanics.whole_tape(
            [rounding_scale(condition, sizes) for condition in self._conditions],
            unknowns=(*self._unknowns, *sizes.values()),
        )

    def terms(self, rows: Array, sizes: Array, values: Array, times: Array) -> Array:
        """Return how large the terms of margins (k, s) are."""
        inputs = np.hstack([rows, np.broadcast_to(sizes, rows.shape)])
        return np.nan_to_num(self._of_terms.table(inputs, values, times))
