"""Formulas as heyoka's expressions."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any

import heyoka as hy
import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.errors import StatechartError, Unsupported
from statechart.formulas.writer import exponential_joined

_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    sp.sin: hy.sin,
    sp.cos: hy.cos,
    sp.tan: hy.tan,
    sp.exp: hy.exp,
    sp.log: hy.log,
    sp.asin: hy.asin,
    sp.acos: hy.acos,
    sp.atan: hy.atan,
    sp.atan2: hy.atan2,
    sp.sinh: hy.sinh,
    sp.cosh: hy.cosh,
    sp.tanh: hy.tanh,
    sp.sech: lambda x: 1.0 / hy.cosh(x),
}


class Converter:
    """SymPy to heyoka, one heyoka node per SymPy node, parameters renumbered as they are met."""

    def __init__(self, automaton: Automaton, definitions: Mapping[sp.Symbol, sp.Expr]) -> None:
        self._definitions = definitions
        self.known: dict[sp.Expr, Any] = {
            symbol: hy.expression(f"v{i}") for i, symbol in enumerate(automaton.variables)
        }
        self.used: list[int] = []
        self.singular: list[sp.Pow] = []  # powers without a series where their base is zero
        self.timed = False
        self._parameters = {symbol: i for i, symbol in enumerate(automaton.parameters)}
        self._time = automaton.time

    def __call__(self, expression: sp.Expr) -> Any:
        """Return an expression of heyoka's.

        Raises
        ------
        Unsupported
            If a function in it has no series.
        """
        found = self.known.get(expression)
        if found is None:
            found = self.known[expression] = self._convert(expression)
        return found

    def _convert(self, node: sp.Expr) -> Any:
        if node.is_Symbol:
            return self._symbol(node)
        if node.is_number:
            return hy.expression(float(node))
        if node.is_Add:
            return functools.reduce(operator.add, (self(a) for a in node.args))
        if node.is_Mul:
            factors, exponent = exponential_joined(node.args)
            parts = [self(a) for a in factors]
            if exponent is not None:
                parts.append(hy.exp(self(exponent)))
            return functools.reduce(operator.mul, parts)
        if node.is_Pow:
            return self._power(*node.args)
        if node.func is sp.Abs and not node.free_symbols - self._parameters.keys():
            # The length of a line by its parameters: a number of the run.
            return hy.sqrt(self(node.args[0]) ** 2.0)
        function = _FUNCTIONS.get(node.func)
        if function is None:
            raise Unsupported(
                f"the Taylor engine cannot expand {node.func}() in a flow; use engine: scipy"
            )
        return function(*(self(argument) for argument in node.args))

    def _symbol(self, node: sp.Symbol) -> Any:
        if node == self._time:
            # heyoka's time runs from zero in every arc, so that late arcs lose nothing.
            self.timed = True
            return hy.time + hy.par[0]
        if node in self._definitions:
            # Only those that the rates need: heyoka wants no parameter that it does not use.
            return self(self._definitions[node])
        index = self._parameters.get(node)
        if index is None:
            raise StatechartError(f"the unknown {node} is used before it is determined")
        if index not in self.used:
            self.used.append(index)
        return hy.par[self.used.index(index) + 1]

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> Any:
        if exponent.is_Integer:
            # heyoka's series of a power divides by the base, which may be zero.
            product = _product(self(base), abs(int(exponent)))
            return product if exponent > 0 else 1.0 / product
        if not base.is_number:
            self.singular.append(sp.Pow(base, exponent))
        if exponent == sp.Rational(1, 2):
            return hy.sqrt(self(base))
        if exponent == sp.Rational(-1, 2):
            return 1.0 / hy.sqrt(self(base))
        if exponent.is_number:
            return self(base) ** float(exponent)
        return hy.exp(self(exponent) * hy.log(self(base)))


def _product(base: Any, exponent: int) -> Any:
    """Return a whole power by repeated squaring."""
    if exponent == 1:
        return base
    square = _product(base, exponent // 2) ** 2.0
    return square if exponent % 2 == 0 else square * base
