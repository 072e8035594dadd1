"""Parameters of a run, compiled to a tape for sweeps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.errors import DeclarationProblem, close_matches
from statechart.formulas.formula import Constants, Formula, order_parameters, parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

_NO_VARIABLES = np.zeros(0)
_TIME = sp.Symbol("time", real=True)
# Input for `inf` in formulas, since constants of a tape are finite.
_INF = sp.Symbol("inf", real=True)


class Parameters:
    """Parameters as formulas of each other, and expressions of them.

    `derived` expressions are appended to the parameters; `further` ones are evaluated with them (an
    initial state). Parameters in `literals` are declared as numbers.
    """

    def __init__(
        self,
        formulas: Mapping[str, str | int | float],
        derived: Callable[[Mapping[str, sp.Symbol]], Mapping[str, sp.Expr]],
        further: Callable[[Mapping[str, sp.Symbol]], Sequence[sp.Expr]],
    ) -> None:
        self._formulas: dict[str, Formula] = {n: parse(f) for n, f in formulas.items()}
        # Neutral symbols, since SymPy interprets names such as I or beta.
        declared = {name: sp.Symbol(f"p{i}", real=True) for i, name in enumerate(self._formulas)}
        extra = derived(declared)
        self.symbols: dict[str, sp.Symbol] = dict(declared)
        for i, name in enumerate(extra):
            self.symbols[name] = sp.Symbol(f"d{i}", real=True)
        self.names, self.ordered = tuple(self.symbols), tuple(self.symbols.values())
        self._declared = tuple(declared)
        self._derived = tuple(extra.values())
        self._further = tuple(further(self.symbols))
        self._tapes = cache(self._tape)
        formulas_without_names = ((n, f) for n, f in self._formulas.items() if not f.names)
        self.literals = {name: formula.value({}) for name, formula in formulas_without_names}

    def values(self, overrides: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the parameters (derived ones last) and the further expressions.

        Raises `DeclarationProblem` if an override names no parameter or is not a number. Raises
        `FormulaError` if a formula has no value there.
        """
        for name, value in overrides.items():
            if name not in self._formulas:
                advice = close_matches(name, self._declared)
                raise DeclarationProblem(f"no parameter {name!r}", advice=advice)
            if value != value:
                raise DeclarationProblem(f"parameter {name!r} is not a number")
        tape, inputs = self.program(frozenset(overrides))
        values = {**self.literals, **overrides}
        numbers = np.array([*(values[name] for name in inputs), math.inf])
        outputs = tape.at(_NO_VARIABLES, numbers, 0.0)
        parameters, further = outputs[: len(self.names)], outputs[len(self.names) :]
        if math.isnan(outputs.min(initial=0.0)):
            # Evaluated one by one, to report the formula at fault.
            Constants(self._formulas).values(overrides)
        return parameters, further

    def program(self, overridden: frozenset[str]) -> tuple[Tape, tuple[str, ...]]:
        """Return the tape of `values` for these overrides, and its inputs, followed by infinity."""
        return self._tapes(overridden.difference(self.literals))

    def _tape(self, overridden: frozenset[str]) -> tuple[Tape, tuple[str, ...]]:
        inputs = tuple(n for n in self._declared if n in self.literals or n in overridden)
        definitions: list[tuple[sp.Symbol, sp.Expr]] = []
        known = {name: self.symbols[name] for name in self._declared}
        for name in order_parameters(self._formulas):
            if name not in inputs:
                definitions.append((self.symbols[name], self._formulas[name].to_sympy(known)))
        derived = self.names[len(self._declared) :]
        for name, expression in zip(derived, self._derived, strict=True):
            definitions.append((self.symbols[name], expression))
        finite = [(symbol, value.xreplace({sp.oo: _INF})) for symbol, value in definitions]
        tape = compile_tape(
            [*self.symbols.values(), *self._further], variables=(), time=_TIME,
            parameters=[*(self.symbols[name] for name in inputs), _INF], definitions=finite,
        )  # fmt: skip
        return tape, inputs
