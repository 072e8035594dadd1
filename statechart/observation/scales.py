"""Scales of relative errors of a run.

The scale of a quantity is its largest value, but at least a thousandth of the scale of its
dimension: the largest force, the longest path, the largest velocity of the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import sympy as sp

from statechart.arrays import EPS, Array
from statechart.automaton.trace import Trace, visited_states
from statechart.documents.quantities import Dimension
from statechart.observation.observer import FormulaLike, Observer

OutputValue = float | int | list[float] | None
"""A number; a list for a value at `each` event; None if the event never happened."""


class Scales(NamedTuple):
    """Scales of relative errors, and bounds of the round-off of zero."""

    variables: Array | None = None  # (n,); None: each variable is relative to itself
    outputs: Mapping[str, OutputValue] = MappingProxyType({})  # in the form of outputs; no counts
    zero_variables: Array | float = 0.0  # (n,)
    zero_outputs: Mapping[str, float] = MappingProxyType({})


NO_SCALES = Scales()
"""Every value is relative to itself."""

_NEARLY_ZERO = 1e-3
"""Least scale of a quantity, relative to that of its dimension."""

_TRAVELLED: tuple[Dimension, ...] = ("length", "angle")
"""Dimensions with arbitrary origin, whose scale is the change."""

_TOLERANCES: Mapping[Dimension, str] = {"length": "gap", "length/time": "speed", "force": "force"}
"""Dimension -> the tolerance of a run below which it is zero."""


class RunScales:
    """The scales of one run.

    `variables` (n,) are the larger of their magnitudes and `_NEARLY_ZERO` times the scales of their
    dimensions; values below `zeros` (n,) are round-off.
    """

    def __init__(self, observer: Observer, trace: Trace) -> None:
        self._observer, self._trace = observer, trace
        automaton = observer.automaton
        model = automaton.declaration
        states = visited_states(trace)
        largest = np.abs(states).max(axis=0)
        spread = np.ptp(states, axis=0)
        self._kinds: dict[Dimension, float] = {}
        kinds = [model.quantity(name).dimension for name in automaton.names]
        for kind, size, change in zip(kinds, largest.tolist(), spread.tolist(), strict=True):
            sizes = change if kind in _TRAVELLED else size
            self._kinds[kind] = max(self._kinds.get(kind, 0.0), sizes)
        self._kinds[""] = 0.0  # unknown dimension
        self._leaves: dict[sp.Symbol, float] = {
            automaton.time: trace.t_end,
            **dict(zip(automaton.parameters, np.abs(trace.values).tolist(), strict=True)),
        }
        self._parameters = dict(zip(automaton.parameters, trace.values.tolist(), strict=True))
        scales = np.array([self._kinds[kind] for kind in kinds])
        self._leaves |= zip(automaton.variables, np.maximum(scales, largest).tolist(), strict=True)
        self.variables: Array = np.maximum(_NEARLY_ZERO * scales, largest)
        self.zeros: Array = np.array([self._zero(kind) for kind in kinds])

    def of(self, formula: FormulaLike, scale: float = 0.0) -> float:
        """Return the scale of a formula with largest magnitude `scale`.

        It is at least `_NEARLY_ZERO` times the scale of its terms, for differences near zero.
        """
        size = self._size(self._observer.programs.expression(formula))
        return max(scale, _NEARLY_ZERO * (size or 0.0))

    def zero(self, formula: FormulaLike) -> float:
        """Return the bound below which a formula is round-off."""
        return self._zero(self._kind(self._observer.programs.expression(formula)))

    def _zero(self, kind: Dimension) -> float:
        zero = self._trace.tolerances.get(_TOLERANCES.get(kind, ""), 0.0)
        if kind not in self._kinds or not self._trace.tolerance > EPS:
            return zero
        # Where all motion is below the tolerance, it is not zero down to round-off.
        least = zero * EPS / self._trace.tolerance
        return min(zero, max(least, _NEARLY_ZERO * self._kinds[kind]))

    def _kind(self, expression: sp.Expr) -> Dimension:
        """Return the dimension of a symbol, possibly with a sign."""
        for name, observable in self._observer.automaton.observables.items():
            if observable in (expression, -expression) and observable.is_Symbol:
                return self._observer.automaton.declaration.quantity(name).dimension
        return ""

    def _size(self, node: sp.Expr) -> float | None:
        """Return the size of an expression from those of its terms, or None."""
        if node.free_symbols <= self._parameters.keys():
            size = abs(float(node.xreplace(self._parameters)))
            return size if np.isfinite(size) else None
        if node.is_Symbol:
            return self._leaves.get(node) if node in self._leaves else self._unknown(node)
        if node.is_Pow and not node.exp.is_positive:
            return None
        parts = [self._size(argument) for argument in node.args]
        known = [part for part in parts if part is not None]
        if node.is_Add or isinstance(node, sp.Min | sp.Max):
            return max(known, default=None)
        if not parts or len(known) < len(parts):
            return None
        if node.is_Mul:
            return float(np.prod(known))
        if node.is_Pow:
            return float(known[0] ** known[1]) if node.exp.is_number else None
        if isinstance(node, sp.Abs):
            return known[0]
        if isinstance(node, sp.sin | sp.tan | sp.atan):
            return min(known[0], 1.0)
        return 1.0 if isinstance(node, sp.cos | sp.sign) else None

    def _unknown(self, symbol: sp.Symbol) -> float | None:
        """Return the scale of an unknown: the largest force for a force."""
        if self._kind(symbol) != "force":
            return None
        if "force" not in self._kinds:
            quantity = self._observer.automaton.declaration.quantity
            names = [n for n in self._observer.names if quantity(n).dimension == "force"]
            table = self._observer.sample(self._trace, names, per_step=1).columns
            known = (np.abs(column[np.isfinite(column)]) for column in table.values())
            self._kinds["force"] = max((float(one.max(initial=0.0)) for one in known), default=0.0)
        return self._kinds["force"]
