"""Syntax trees of formulas: nodes, functions, evaluation in floats."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from statechart.errors import FormulaError
from statechart.formulas.hints import meant
from statechart.kernels.tolerant_floor import tolerant_floor


@dataclass(frozen=True, slots=True)
class Number:
    """A finite literal."""

    value: int | float
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Constant:
    """`pi` or `inf`."""

    name: str
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Name:
    """A name of a quantity, possibly dotted."""

    name: str
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Unary:
    """``+`` or ``-`` of an operand."""

    operator: str
    operand: Node
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Binary:
    """``+ - * / **`` of two operands."""

    operator: str
    left: Node
    right: Node
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Call:
    """A call of a function of `FUNCTIONS`."""

    function: str
    arguments: tuple[Node, ...]
    offset: int = field(default=0, compare=False)
    # Offsets of its opening parenthesis, commas and closing parenthesis.
    marks: tuple[int, ...] = field(default=(), compare=False)


Node = Number | Constant | Name | Unary | Binary | Call


@dataclass(frozen=True, slots=True)
class Function:
    """A function: number of arguments, evaluation in floats, SymPy constructor."""

    least: int
    most: int | None
    evaluate: Callable[..., float]
    build: Callable[..., Any]


def _symbolic(name: str) -> Callable[..., Any]:
    """Return a constructor of SymPy or `formulas.writer`, imported when called: it takes 0.4 s."""

    def build(*arguments: Any) -> Any:
        import sympy

        from statechart.formulas import writer

        return getattr(writer if name in ("Max", "Min", "Whole") else sympy, name)(*arguments)

    return build


def _mod(x: Any, y: Any) -> Any:
    import sympy

    return sympy.nan if y.is_zero else x - y * _FLOOR(x / y)


_SAME_NAMES = (
    *("sqrt", "exp", "log", "sin", "cos", "tan"),
    *("asin", "acos", "atan", "sinh", "cosh", "tanh"),
)

_MIN, _MAX, _FLOOR, _SQRT = map(_symbolic, ("Min", "Max", "Whole", "sqrt"))

FUNCTIONS: Mapping[str, Function] = {
    **{name: Function(1, 1, getattr(math, name), _symbolic(name)) for name in _SAME_NAMES},
    "abs": Function(1, 1, abs, _symbolic("Abs")),
    "sign": Function(1, 1, lambda x: float((x > 0) - (x < 0)), _symbolic("sign")),
    "min": Function(2, None, min, _MIN),
    "max": Function(2, None, max, _MAX),
    "sat": Function(3, 3, lambda x, a, b: min(max(x, a), b), lambda x, a, b: _MIN(_MAX(x, a), b)),
    "hypot": Function(2, 2, math.hypot, lambda x, y: _SQRT(x**2 + y**2)),
    "atan2": Function(2, 2, math.atan2, _symbolic("atan2")),
    "floor": Function(1, 1, tolerant_floor, _FLOOR),
    "mod": Function(2, 2, lambda x, y: x - y * tolerant_floor(x / y), _mod),
}

CONSTANTS: Mapping[str, float] = {"pi": math.pi, "inf": math.inf}

JUMPS = frozenset({"floor", "mod"})
"""Functions for constants, evaluated before a run; models may declare these names."""

RESERVED = frozenset(FUNCTIONS) - JUMPS - {"sat"} | frozenset(CONSTANTS)
"""Names that cannot be declared."""

WORDS = frozenset(("and", "or", "not", "in"))
"""Keywords of relations, which cannot be declared."""


@dataclass(frozen=True, slots=True)
class Source:
    """The text being parsed, for positions of errors."""

    text: str

    @property
    def named(self) -> str:
        """Its name in errors."""
        shown = self.text if len(self.text) <= 80 else self.text[:77] + "..."
        return f"formula {shown!r}"

    def fail(self, message: str, offset: int = 0, advice: str = "", name: str = "") -> NoReturn:
        """Raise a `FormulaError` that points `offset` characters into the text."""
        raise FormulaError(
            f"{self.named}: {message}", advice=advice, offset=offset, name=name, text=self.text
        )


def children(node: Node) -> tuple[Node, ...]:
    """Return the children of `node`, left to right."""
    match node:
        case Unary():
            return (node.operand,)
        case Binary():
            return (node.left, node.right)
        case Call():
            return node.arguments
    return ()


def names_in(node: Node) -> Iterator[Name]:
    """Yield every name in `node`, left to right."""
    return (part for part in nodes(node) if isinstance(part, Name))


def calls_in(node: Node, functions: Collection[str] = FUNCTIONS) -> Iterator[Call]:
    """Yield every call of one of `functions` in `node`, left to right."""
    calls = (part for part in nodes(node) if isinstance(part, Call))
    return (call for call in calls if call.function in functions)


def nodes(node: Node) -> Iterator[Node]:
    """Yield `node` and its descendants, left to right."""
    pending = [node]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(reversed(children(node)))


def is_constant(node: Node) -> bool:
    """Return whether a formula has no names."""
    return next(names_in(node), None) is None


def evaluate(node: Node, values: Mapping[str, float], source: Source) -> float:
    """Evaluate in IEEE floats; infinity is a value, undefined results raise `FormulaError`."""
    match node:
        case Number():
            return float(node.value)
        case Constant():
            return CONSTANTS[node.name]
        case Name():
            if node.name not in values:
                undeclared(node, values, source)
            value = float(values[node.name])
            if math.isnan(value):
                source.fail(f"{node.name} is not a number", node.offset)
            return value
    arguments = [evaluate(child, values, source) for child in children(node)]
    try:
        match node:
            case Unary():
                result = -arguments[0] if node.operator == "-" else arguments[0]
            case Call():
                result = FUNCTIONS[node.function].evaluate(*arguments)
            case Binary():
                result = _OPERATORS[node.operator](*arguments)
    except ZeroDivisionError:
        source.fail("division by zero", node.offset)
    except OverflowError:
        result = math.inf
    except ValueError:
        result = math.nan
    if math.isnan(result):
        shown = ", ".join(f"{argument:g}" for argument in arguments)
        what = node.function if isinstance(node, Call) else repr(getattr(node, "operator", ""))
        source.fail(f"{what} has no value at {shown}", node.offset)
    if math.isinf(result) and all(map(math.isfinite, arguments)):
        source.fail("the value is too large for a float", node.offset)
    return result


def _checked_power(base: float, exponent: float) -> float:
    if base == 0 and exponent < 0:
        raise ZeroDivisionError
    return math.pow(base, exponent)


_OPERATORS: Mapping[str, Callable[[float, float], float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "**": _checked_power,
}  # fmt: skip


def undeclared(node: Name, known: Iterable[str], source: Source) -> NoReturn:
    """Raise the error for a name that is not in `known`."""
    advice = meant(node.name, known, FUNCTIONS, CONSTANTS)
    source.fail(f"unknown name {node.name!r}", node.offset, advice)
