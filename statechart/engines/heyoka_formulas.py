"""Conversion of SymPy formulas to heyoka expressions."""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import heyoka as hy
import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.errors import StatechartError, Unsupported
from statechart.formulas.writer import join_exponentials

# No warnings on stdout about an unusable disk cache.
hy.set_logger_level_error()
# A process that opens heyoka's database of compiled equations sums the sizes of all its rows: 25 ms
# for 100 MB, and the default limit is 21 GB. A folder of our own leaves the user's limit alone.
with suppress(RuntimeError):  # a folder that cannot be written
    hy.llvm_state.set_diskcache_path(str(Path.home() / ".cache" / "statechart" / "heyoka"))
    hy.llvm_state.set_diskcache_limit(40_000_000)  # a hundred modes

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


_number = functools.lru_cache(1 << 12)(hy.expression)


class Converter:
    """SymPy to heyoka, one heyoka node per SymPy node.

    Subexpressions of parameters alone (`constants`) are evaluated once per flow and passed to
    heyoka as parameters after the time: as operations they would be expanded into series with one
    nonzero term. Products are split so that their varying part is shared.
    """

    def __init__(
        self, automaton: Automaton, definitions: Mapping[sp.Symbol, sp.Expr], *, folds: bool
    ) -> None:
        self._definitions, self._folds = definitions, folds
        self.known: dict[sp.Expr, Any] = {
            symbol: hy.expression(f"v{i}") for i, symbol in enumerate(automaton.variables)
        }
        self.constants: list[sp.Expr] = []
        # Base and exponent of powers without a Taylor series at base zero.
        self.singular: list[tuple[sp.Expr, sp.Expr]] = []
        self.timed = False
        self._parameters = frozenset(automaton.parameters)
        self._time = automaton.time
        self._moving: dict[sp.Expr, bool] = {}

    def __call__(self, expression: sp.Expr) -> Any:
        """Return the heyoka expression."""
        if expression.is_Number:  # A look-up would hash it, which takes longer.
            return _number(float(expression))
        found = self.known.get(expression)
        if found is None:
            convert = self._convert if self._moves(expression) else self._constant
            found = self.known[expression] = convert(expression)
        return found

    def rate(self, expression: sp.Expr) -> Any:
        """Return a rate, with its additive constant as a parameter.

        Modes whose rates differ in constants only (a heater on or off) then share a program.
        """
        while expression in self._definitions and expression not in self.known:
            expression = self._definitions[expression]
        if self._folds and expression.is_Add and self._moves(expression):
            number, remainder = expression.as_coeff_Add()
            if number != 0:
                self.constants.append(number)
                # Before the rest, which appends further constants.
                shift = hy.par[len(self.constants)]
                return self(remainder) + shift
        return self(expression)

    def _moves(self, node: sp.Expr) -> bool:
        """Return whether a formula varies during a flow."""
        if node.is_Number:
            return False
        depends = self._moving.get(node)
        if depends is None:
            if node.is_Symbol:
                definition = self._definitions.get(node)
                depends = (
                    node not in self._parameters if definition is None else self._moves(definition)
                )
            else:
                depends = any(self._moves(argument) for argument in node.args)
                depends = depends or not (self._folds or node.is_number)
            self._moving[node] = depends
        return depends

    def _constant(self, node: sp.Expr) -> Any:
        if node.is_number:
            return _number(float(node))
        self.constants.append(node)
        return hy.par[len(self.constants)]

    def _joined(self, operation: Callable[[Any, Any], Any], node: sp.Expr, operands: Any) -> Any:
        """Join the operands of a sum or product: varying ones first, then the constant."""
        moves = [not self._folds or self._moves(operand) for operand in operands]
        joined = [self(operand) for operand in itertools.compress(operands, moves)]
        constants = [operand for operand, varies in zip(operands, moves, strict=True) if not varies]
        if constants:
            joined.append(self(node.func(*constants) if len(constants) > 1 else constants[0]))
        return functools.reduce(operation, joined)

    def _convert(self, node: sp.Expr) -> Any:
        if node == self._time:
            # heyoka's time starts at zero in every arc, so that late arcs lose no digits.
            self.timed = True
            return hy.time + hy.par[0]
        if node in self._definitions:
            # Only parameters that occur in the rates, as heyoka requires.
            return self(self._definitions[node])
        if node.is_Symbol:
            raise StatechartError(f"the unknown {node} is used before it is determined")
        if node.is_Add:
            return self._joined(operator.add, node, node.args)
        if node.is_Mul:
            factors, exponent = join_exponentials(node.args)
            if exponent is None:
                return self._joined(operator.mul, node, factors)
            power = hy.exp(self(exponent))
            return self._joined(operator.mul, node, factors) * power if factors else power
        if node.is_Pow:
            return self._power(*node.args)
        if node.func is sp.Abs:
            # SymPy simplifies sqrt(x**2), which is analytic for x != 0; `abs` itself is refused.
            return self._power(node.args[0] ** 2, sp.S.Half)
        if node.func is sp.sign:
            return self(node.args[0]) / self(sp.Abs(node.args[0]))
        if node.func is sp.DiracDelta:
            # The derivative of sign where it exists.
            return hy.expression(0.0)
        function = _FUNCTIONS.get(node.func)
        if function is None:
            raise Unsupported(
                f"the Taylor engine cannot expand {node.func}() in a flow; use engine: scipy"
            )
        return function(*(self(argument) for argument in node.args))

    def _power(self, base: sp.Expr, exponent: sp.Expr) -> Any:
        if exponent.is_Integer:
            # heyoka's power series divides by the base, which may be zero.
            product = _product(self(base), abs(int(exponent)))
            return product if exponent > 0 else 1.0 / product
        if not base.is_number:
            self.singular.append((base, exponent))
        if exponent == sp.Rational(1, 2):
            return hy.sqrt(self(base))
        if exponent == sp.Rational(-1, 2):
            return 1.0 / hy.sqrt(self(base))
        if exponent.is_number:
            return self(base) ** float(exponent)
        return hy.exp(self(exponent) * hy.log(self(base)))


def _product(base: Any, exponent: int) -> Any:
    if exponent == 1:
        return base
    square = _product(base, exponent // 2) ** 2.0
    return square if exponent % 2 == 0 else square * base
