"""Formulas: parsed text, evaluated in floats or converted to SymPy.

A formula has numbers, names (`mu`, `tip.V`), ``+ - * / **``, parentheses, the functions in
`FUNCTIONS` and the constants `pi` and `inf`. SymPy's parser is not used: it executes Python code
in the text, and interprets names such as `I`, `S` or `beta`.
"""

from __future__ import annotations

import graphlib
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

from statechart.errors import FormulaError, close_matches
from statechart.formulas import tree
from statechart.formulas.hints import meant
from statechart.formulas.syntax import Reader

if TYPE_CHECKING:
    import sympy as sp


_MAX_CACHED = 4096  # parsed texts, more than the largest scene has
_EXACT = 2**53  # integers up to this are exact floats


def _build(node: tree.Node, symbols: Mapping[str, sp.Expr], source: tree.Source) -> sp.Expr:
    import sympy

    match node:
        case tree.Number():
            integer = isinstance(node.value, int)
            return sympy.Integer(node.value) if integer else sympy.Float(node.value)
        case tree.Constant():
            return sympy.pi if node.name == "pi" else sympy.oo
        case tree.Name():
            if node.name not in symbols:
                tree.undeclared(node, symbols, source)
            return symbols[node.name]
        case tree.Unary():
            operand = _build(node.operand, symbols, source)
            return -operand if node.operator == "-" else operand
        case tree.Call():
            arguments = [_build(child, symbols, source) for child in node.arguments]
            return tree.FUNCTIONS[node.function].build(*arguments)
    left = _build(node.left, symbols, source)
    right = _build(node.right, symbols, source)
    match node.operator:
        case "+":
            return sympy.Add(left, right)
        case "-":
            return sympy.Add(left, sympy.Mul(sympy.Integer(-1), right))
        case "*":
            return sympy.Mul(left, right)
        case "/":
            return sympy.Mul(left, sympy.Pow(right, sympy.Integer(-1)))
    if left.is_number and right.is_number:
        return _power_of_numbers(node, left, right, source)
    if right.is_Float and float(2 * right).is_integer():
        # Exact halves: x**2.0 is a product, x**1.5 has a root.
        right = sympy.Rational(right)
    return sympy.Pow(left, right)


def _power_of_numbers(
    node: tree.Binary, left: sp.Expr, right: sp.Expr, source: tree.Source
) -> sp.Expr:
    """Return a power of numbers in floats, since exact ones may fill the memory."""
    import sympy

    if not (left.is_extended_real and right.is_extended_real):
        source.fail("it has no real value", node.offset)
    base, exponent = float(left), float(right)
    names = tree.Name("a", node.offset), tree.Name("b", node.offset)
    power = tree.Binary("**", *names, node.offset)
    value = tree.evaluate(power, {"a": base, "b": exponent}, source)
    if left.is_Integer and right.is_Integer and exponent >= 0 and abs(value) <= _EXACT:
        return sympy.Integer(int(value))
    return sympy.Float(value) if math.isfinite(value) else sympy.oo * math.copysign(1, value)


def rewrite_overflow(expression: sp.Expr, formula: Formula) -> sp.Expr:
    """Return a real expression without quotients that overflow to inf/inf."""
    import sympy

    if expression.has(sympy.nan, sympy.zoo, sympy.I):
        tree.Source(formula.text).fail(
            "it has no real value", formula.root.offset, "look for a division by zero"
        )
    if expression.has(sympy.exp, sympy.cosh):
        return expression.replace(
            lambda part: bool(part.is_Pow and part.exp.is_Integer and part.exp.is_negative),
            _bounded_power,
        )
    return expression


def _bounded_power(power: sp.Expr) -> sp.Expr:
    """Rewrite powers of 1/(a + b exp(x)) and 1/cosh(x), whose derivatives overflow to inf/inf.

    For a, b > 0 the first is (1 - tanh((x + log(b/a))/2))/(2 a).
    """
    import sympy

    base, exponent = power.args
    if base.func is sympy.cosh:
        return sympy.sech(base.args[0]) ** -exponent
    number, rest = base.as_coeff_Add()
    factor, other = rest.as_coeff_Mul()
    if not (number.is_positive and factor.is_positive and other.func is sympy.exp):
        return power
    at = (other.args[0] + sympy.log(factor / number)) / 2
    return ((1 - sympy.tanh(at)) / (2 * number)) ** -exponent


@dataclass(frozen=True)
class Formula:
    """A parsed formula; created by `parse`."""

    text: str
    root: tree.Node

    @cached_property
    def names(self) -> frozenset[str]:
        """The names in it."""
        return frozenset(name.name for name in tree.names_in(self.root))

    @property
    def names_infinity(self) -> bool:
        """True if the constant `inf` occurs in it."""
        return any(
            isinstance(node, tree.Constant) and node.name == "inf" for node in tree.nodes(self.root)
        )

    def require(self, known: Collection[str]) -> None:
        """Raise `FormulaError` at the first name not in `known`, with similar names."""
        for name in tree.names_in(self.root):
            if name.name not in known:
                tree.undeclared(name, known, self._source)

    def to_sympy(self, symbols: Mapping[str, sp.Expr]) -> sp.Expr:
        """Return the SymPy expression.

        Integers and their quotients are exact, decimals are doubles, powers of two numbers are
        computed in floats. Raises `FormulaError` if a name is missing from `symbols`, or the
        expression has no real value.
        """
        return rewrite_overflow(_build(self.root, symbols, self._source), self)

    def value(self, values: Mapping[str, float]) -> float:
        """Evaluate in IEEE floats.

        Raises `FormulaError` if a name is missing, or a part is undefined or overflows.
        """
        return tree.evaluate(self.root, values, self._source)

    @property
    def _source(self) -> tree.Source:
        return tree.Source(self.text)


def parse(text: str | int | float) -> Formula:
    """Parse a formula; results are cached.

    Fields of models store the text, and are parsed when used. Raises `FormulaError` if the text is
    no formula, too large, or has a constant part without a value.
    """
    if isinstance(text, bool) or not isinstance(text, str | int | float):
        tree.Source(str(text)).fail("not a number and not a formula")
    return _read(text if isinstance(text, str) else _number_text(text))


def evaluator(values: Mapping[str, float]) -> Callable[[str | int | float], float]:
    """Return a function from the text of a formula to its value for these values of names."""
    return lambda text: parse(text).value(values)


@lru_cache(_MAX_CACHED)
def _read(text: str) -> Formula:
    reader = Reader(tree.Source(text))
    root = reader.sum()
    reader.expect_end()
    return Formula(text, root)


def power_of_ten(value: int) -> str:
    """Return the power of ten below an integer that no float holds, with its sign."""
    return f"{'-' * (value < 0)}1e{math.floor(math.log10(abs(value)))}"


def _number_text(value: int | float) -> str:
    try:
        as_float = float(value)
    except OverflowError:
        tree.Source(power_of_ten(int(value))).fail("the number is too large for a float")
    if math.isnan(as_float):
        tree.Source("nan").fail("a finite number or inf was expected")
    return str(value) if isinstance(value, int) else repr(as_float)


def order_parameters(
    formulas: Mapping[str, Formula], known_names: Collection[str] = ()
) -> tuple[str, ...]:
    """Return the names in topological order of their formulas.

    Raises `FormulaError` if a name is not a parameter, or for a dependency cycle.
    """
    for name, formula in formulas.items():
        for used in tree.names_in(formula.root):
            if used.name not in formulas and used.name not in known_names:
                advice = meant(used.name, formulas, tree.FUNCTIONS, tree.CONSTANTS)
                message = f"unknown name {used.name!r}"
                formula._source.fail(message, used.offset, advice, name=name)
    uses = {n: sorted(formula.names.difference(known_names)) for n, formula in formulas.items()}
    try:
        return tuple(graphlib.TopologicalSorter(uses).static_order())
    except graphlib.CycleError as error:
        # graphlib lists each node before those that use it.
        cycle = list(reversed(error.args[1]))
        message = f"parameters need each other: {' -> '.join(cycle)}"
        advice = "give one of them a value of its own"
        formulas[cycle[0]]._source.fail(message, advice=advice, name=cycle[0])


class Constants:
    """Parameters as formulas of each other, in order of evaluation."""

    def __init__(self, formulas: Mapping[str, Formula]) -> None:
        self.formulas = formulas
        self._orders: dict[frozenset[str], tuple[str, ...]] = {}

    def values(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Return the value of every parameter.

        Raises `FormulaError` if an override names no parameter, or a formula has no value.
        """
        for name in overrides:
            if name not in self.formulas:
                advice = close_matches(name, self.formulas)
                raise FormulaError(f"unknown parameter {name!r}", advice=advice, name=name)
        known_names = frozenset(overrides)
        if known_names not in self._orders:
            left = {n: f for n, f in self.formulas.items() if n not in known_names}
            self._orders[known_names] = order_parameters(left, known_names)
        values = {name: parse(value).value({}) for name, value in overrides.items()}
        self.update(values, self._orders[known_names])
        return {name: values[name] for name in self.formulas}

    def update(self, values: dict[str, float], names: Iterable[str]) -> None:
        """Evaluate parameters in the given order, from the values of those before."""
        for name in names:
            try:
                values[name] = self.formulas[name].value(values)
            except FormulaError as error:
                error.name = name
                raise
