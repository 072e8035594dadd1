"""The language of formulas: its syntax tree, its reader, its evaluation in floats.

Reading never runs the text. Length, number of nodes, nesting and powers are bounded, so that a
formula from an unknown file costs a bounded time. `statechart.formulas.formula` is the public side.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from statechart.errors import FormulaError, Position

MAX_LENGTH = 2000
MAX_NODES = 500
MAX_DEPTH = 60
MAX_EXPONENT = 64


@dataclass(frozen=True, slots=True)
class Number:
    """A literal, finite."""

    value: int | float
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Constant:
    """`pi` or `inf`."""

    name: str
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Name:
    """A declared quantity, dotted or not."""

    name: str
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Unary:
    """A sign, ``+`` or ``-``, and what it applies to."""

    operator: str
    operand: Node
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Binary:
    """One of ``+ - * / **`` between two operands."""

    operator: str
    left: Node
    right: Node
    offset: int = field(default=0, compare=False)


@dataclass(frozen=True, slots=True)
class Call:
    """A function of `FUNCTIONS` and its arguments."""

    function: str
    arguments: tuple[Node, ...]
    offset: int = field(default=0, compare=False)


Node = Number | Constant | Name | Unary | Binary | Call


@dataclass(frozen=True, slots=True)
class Function:
    """One function of the language: how many arguments, in floats, in SymPy."""

    least: int
    most: int | None
    evaluate: Callable[..., float]
    build: Callable[..., Any]


def _sign(x: float) -> float:
    return float((x > 0) - (x < 0))


def _sympy(name: str) -> Callable[..., Any]:
    """Return SymPy's constructor `name`, looked up when called: importing SymPy takes 0.4 s."""

    def build(*arguments: Any) -> Any:
        import sympy

        return getattr(sympy, name)(*arguments)

    return build


def _hypot(x: Any, y: Any) -> Any:
    import sympy

    return sympy.sqrt(x**2 + y**2)


_SAME_IN_MATH_AND_SYMPY = (
    *("sqrt", "exp", "log", "sin", "cos", "tan"),
    *("asin", "acos", "atan", "sinh", "cosh", "tanh"),
)

FUNCTIONS: Mapping[str, Function] = {
    **{name: Function(1, 1, getattr(math, name), _sympy(name)) for name in _SAME_IN_MATH_AND_SYMPY},
    "abs": Function(1, 1, abs, _sympy("Abs")),
    "sign": Function(1, 1, _sign, _sympy("sign")),
    "min": Function(2, None, min, _sympy("Min")),
    "max": Function(2, None, max, _sympy("Max")),
    "hypot": Function(2, 2, math.hypot, _hypot),
    "atan2": Function(2, 2, math.atan2, _sympy("atan2")),
}

CONSTANTS: Mapping[str, float] = {"pi": math.pi, "inf": math.inf}

RESERVED = frozenset(FUNCTIONS) | frozenset(CONSTANTS)
"""Names that mean something in every formula and so cannot be declared."""

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
"""One part of a name."""

RELATIONS = ("<=", ">=", "<", ">")

_TOKEN = re.compile(
    r"""[ \t\r\n]*(?:
        (?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)
      | (?P<name>[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*)
      | (?P<symbol>\*\*|<=|>=|==|!=|[-+*/(),<>=^])
      | (?P<end>\Z)
    )""",
    re.VERBOSE | re.ASCII,
)


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    offset: int


@dataclass(frozen=True, slots=True)
class Source:
    """The text being read and where it stands, to point into it."""

    text: str
    position: Position | None

    def fail(self, message: str, offset: int = 0, advice: str = "", name: str = "") -> NoReturn:
        """Raise a `FormulaError` that points `offset` characters into the text."""
        shown = self.text if len(self.text) <= 80 else self.text[:77] + "..."
        place = self.position.shifted(offset) if self.position else None
        raise FormulaError(
            f"formula {shown!r}: {message}",
            advice=advice,
            source=place.source if place else "",
            line=place.line if place else None,
            column=place.column if place else None,
            offset=offset,
            name=name,
            text=self.text,
        )


def close_matches(name: str, known: Iterable[str]) -> str:
    """Return advice: the names in `known` that `name` may have meant, and all of them.

    Parameters
    ----------
    name : str
        What was written.
    known : iterable of str
        What could have been written.
    """
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=3)
    listed = ", ".join(names[:30]) + (", ..." if len(names) > 30 else "")
    meant = f"did you mean {' or '.join(repr(match) for match in close)}? " if close else ""
    return f"{meant}known: {listed or 'none'}"


def _tokens(source: Source) -> Iterator[_Token]:
    text, at = source.text, 0
    while True:
        match = _TOKEN.match(text, at)
        if match is None:
            offset = at + len(text[at:]) - len(text[at:].lstrip(" \t\r\n"))
            source.fail(
                f"unexpected character {text[offset]!r}",
                offset,
                "a formula has numbers, names, + - * / **, parentheses and functions",
            )
        kind = match.lastgroup or ""
        offset, at = match.start(kind), match.end()
        if kind == "number" and at < len(text) and (text[at].isalnum() or text[at] in "._"):
            source.fail(
                f"{match[kind]!r} runs into {text[at]!r}", at, "write a product as 2*x, not 2x"
            )
        yield _Token(kind, match[kind], offset)
        if kind == "end":
            return


class Reader:
    """Recursive descent over the tokens of one formula or relation."""

    def __init__(self, source: Source) -> None:
        if len(source.text) > MAX_LENGTH:
            source.fail(
                f"{len(source.text)} characters are too many",
                advice=f"at most {MAX_LENGTH}; name its parts as parameters",
            )
        self.source = source
        self._tokens = _tokens(source)
        self._nodes = 0
        self._depth = 0
        self.token = next(self._tokens)

    def advance(self) -> _Token:
        """Return the current token and go to the next."""
        token, self.token = self.token, next(self._tokens, self.token)
        return token

    def expect_end(self) -> None:
        """Check that nothing is left."""
        if self.token.kind != "end":
            self._unexpected()

    def sum(self) -> Node:
        """Read a whole formula, up to what cannot belong to it."""
        left = self._product()
        while self.token.text in ("+", "-"):
            left = self._binary(left, self._product)
        return left

    def _product(self) -> Node:
        left = self._signed()
        while self.token.text in ("*", "/"):
            left = self._binary(left, self._signed)
        return left

    def _signed(self) -> Node:
        # Every nesting passes here, so here its depth is counted. Long sums and products do not
        # nest: their trees lean left and are bounded by the number of nodes.
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self.source.fail("nested too deeply", self.token.offset, f"at most {MAX_DEPTH} levels")
        node: Node
        if self.token.text in ("+", "-"):
            token = self.advance()
            node = self._checked(Unary(token.text, self._signed(), token.offset))
        else:
            node = self._atom()
            if self.token.text == "**":
                node = self._binary(node, self._signed)
        self._depth -= 1
        return node

    def _binary(self, left: Node, right: Callable[[], Node]) -> Node:
        token = self.advance()
        node = Binary(token.text, left, right(), token.offset)
        if node.operator == "**" and _is_constant(node.right):
            exponent = self._constant(node.right)
            if abs(exponent) > MAX_EXPONENT:
                self.source.fail(
                    f"the exponent {exponent:g} is too large",
                    token.offset,
                    f"at most {MAX_EXPONENT} in magnitude",
                )
        return self._checked(node)

    def _atom(self) -> Node:
        token = self.advance()
        if token.kind == "number":
            value = _literal(token.text)
            if value is None:
                self.source.fail(
                    "the number is too large for a float",
                    token.offset,
                    "write inf where infinity is meant",
                )
            return self._checked(Number(value, token.offset))
        if token.kind == "name":
            if self.token.text == "(":
                return self._call(token)
            if token.text in CONSTANTS:
                return self._checked(Constant(token.text, token.offset))
            if token.text in FUNCTIONS:
                self.source.fail(
                    f"{token.text!r} is a function", token.offset, f"write {token.text}(...)"
                )
            return self._checked(Name(token.text, token.offset))
        if token.text == "(":
            node = self.sum()
            self._close(token)
            return node
        self.token = token
        return self._unexpected()

    def _call(self, name: _Token) -> Node:
        if name.text not in FUNCTIONS:
            self.source.fail(
                f"unknown function {name.text!r}",
                name.offset,
                close_matches(name.text, FUNCTIONS),
            )
        opening = self.advance()
        arguments = [self.sum()]
        while self.token.text == ",":
            self.advance()
            arguments.append(self.sum())
        self._close(opening)
        function = FUNCTIONS[name.text]
        most = function.most
        if len(arguments) < function.least or (most is not None and len(arguments) > most):
            wanted = f"{function.least}" if most is not None else f"at least {function.least}"
            self.source.fail(f"{name.text} takes {wanted}, not {len(arguments)}", name.offset)
        return self._checked(Call(name.text, tuple(arguments), name.offset))

    def _close(self, opening: _Token) -> None:
        if self.token.text != ")":
            if self.token.kind == "end":
                self.source.fail("this parenthesis is never closed", opening.offset)
            self._unexpected()
        self.advance()

    def _checked(self, node: Node) -> Node:
        """Count `node`; a constant that has no value is found here and not in the middle of a run.

        This also bounds what SymPy's exact arithmetic could be made to compute: a tower such as
        ``2**2**2**99`` overflows here.
        """
        self._nodes += 1
        if self._nodes > MAX_NODES:
            self.source.fail(
                "too many terms", node.offset, f"at most {MAX_NODES}; name parts as parameters"
            )
        if not isinstance(node, Number | Constant | Name) and _is_constant(node):
            self._constant(node)
        return node

    def _constant(self, node: Node) -> float:
        return evaluate(node, {}, self.source)

    def _unexpected(self) -> NoReturn:
        token = self.token
        advice = {
            "^": "write a power as **",
            "=": "a formula is a value, not an assignment",
            "==": "compare with <=, <, >= or >",
            "!=": "compare with <=, <, >= or >",
            "<": "a comparison stands only where a condition is expected, and once",
        }
        found = "the formula ends early" if token.kind == "end" else f"unexpected {token.text!r}"
        key = "<" if token.text in RELATIONS else token.text
        self.source.fail(found, token.offset, advice.get(key, ""))


def _literal(text: str) -> int | float | None:
    """Return the number written, or None where it is beyond the floats."""
    if not math.isfinite(value := float(text)):
        return None
    return int(text) if text.isdigit() else value


def children(node: Node) -> tuple[Node, ...]:
    """Return what stands right below `node`, left to right."""
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


def nodes(node: Node) -> Iterator[Node]:
    """Yield `node` and all below it, left to right."""
    pending = [node]
    while pending:
        node = pending.pop()
        yield node
        pending.extend(reversed(children(node)))


def _is_constant(node: Node) -> bool:
    return next(names_in(node), None) is None


def evaluate(node: Node, values: Mapping[str, float], source: Source) -> float:
    """Evaluate in IEEE floats; infinity is an ordinary value, everything undefined an error."""
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
        result = _apply(node, arguments)
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


def _apply(node: Node, arguments: list[float]) -> float:
    match node:
        case Unary():
            return -arguments[0] if node.operator == "-" else arguments[0]
        case Call():
            return FUNCTIONS[node.function].evaluate(*arguments)
        case Binary():
            left, right = arguments
            match node.operator:
                case "+":
                    return left + right
                case "-":
                    return left - right
                case "*":
                    return left * right
                case "/":
                    return left / right
            if left == 0 and right < 0:
                raise ZeroDivisionError
            return math.pow(left, right)
    raise TypeError(node)


def undeclared(node: Name, known: Iterable[str], source: Source) -> NoReturn:
    """Raise the error for a name that is not in `known`."""
    source.fail(f"unknown name {node.name!r}", node.offset, close_matches(node.name, known))
