"""Stop conditions of a run by steps as programs: their margins, and the sizes of these."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.scene.controls import ControlState
from contacts.scene.scene import Scene
from statechart.arrays import Array, Bools
from statechart.automaton.course import size_of
from statechart.charts.transitions import nested
from statechart.formulas.formula import parse_relation
from statechart.formulas.tape import Tape


class StopTapes:
    """The stop conditions of a scene, on tape.

    Parameters
    ----------
    mechanics : Mechanics
    conditions : sequence of Expr
        Their margins.
    unknowns : sequence of Symbol
        What they may use that steps solve for.

    Attributes
    ----------
    margins : Tape
        Over variables and unknowns.
    """

    def __init__(
        self, mechanics: Mechanics, conditions: Sequence[sp.Expr], unknowns: Sequence[sp.Symbol]
    ) -> None:
        self._mechanics, self._conditions, self._unknowns = mechanics, conditions, unknowns
        self.margins: Tape = mechanics.whole_tape(conditions, unknowns=unknowns)

    @cached_property
    def _of_terms(self) -> Tape:
        """Sizes of the margins' terms, over inputs and the sizes of inputs."""
        mechanics = self._mechanics
        inputs = (*mechanics.variables, *mechanics.memory.values(), *self._unknowns)
        sizes = {symbol: sp.Symbol(f"size_{symbol}", real=True) for symbol in inputs}
        return mechanics.whole_tape(
            [size_of(condition, sizes) for condition in self._conditions],
            unknowns=(*self._unknowns, *sizes.values()),
        )

    def terms(self, rows: Array, sizes: Array, values: Array, times: Array) -> Array:
        """Return how large the terms of margins (k, s) are.

        Parameters
        ----------
        rows : (k, n) array
            Variables and unknowns.
        sizes : (n,) array
            How large these are.
        values : (p,) array
            Of the parameters.
        times : (k,) array
        """
        inputs = np.hstack([rows, np.broadcast_to(sizes, rows.shape)])
        return np.nan_to_num(self._of_terms.table(inputs, values, times))


def counting(scene: Scene) -> Bools:
    """Return which stop conditions hold on their boundary, too, where their relation counts it.

    Returns
    -------
    (2, s) array of bool
        Those that do where they stay there for a step; and at once, of what jumps alone change,
        so that no motion tells the way it goes.
    """
    flowing = {
        variable
        for name, region in scene.regions.items()
        for _, state, _ in nested(region, name)
        if isinstance(state, ControlState)
        for variable in state.flows
    }
    kept = {variable for region in scene.regions.values() for variable in region.variables}
    still = {*scene.parameters, *(kept - flowing)}
    relations = [parse_relation(text) for text in scene.stop.conditions.values()]
    stays = np.array([r.operator in ("<=", ">=") for r in relations], np.bool_)
    jumps = np.array([{*r.left.names, *r.right.names} <= still for r in relations], np.bool_)
    return np.stack([stays, stays & jumps])
