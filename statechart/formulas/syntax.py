"""Tokens and recursive-descent parser of formulas.

Parsing never executes the text. Length, number of nodes, nesting and powers are bounded, so that a
formula from an unknown file takes a bounded time. `statechart.formulas.formula` is the public side.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NoReturn

from statechart.formulas import tree
from statechart.formulas.hints import DELAY, TOKENS, TOO_FEW, character, meant, program

MAX_LENGTH = 2000
MAX_NODES = 500
MAX_DEPTH = 60
MAX_EXPONENT = 64

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*", re.ASCII)
"""A part of a dotted name."""

_TIME = re.compile(r"\(\s*(time|t)\b", re.ASCII)  # as the first argument of a function
_DATE = re.compile(r"[0-9]{4}-(0[1-9]|1[0-2])-(0[1-9]|[12][0-9]|3[01])([T ][0-9].*)?", re.ASCII)
"""A date, which is also a difference of integers."""

RELATIONS = ("<=", ">=", "<", ">")
_CLOSE = "write ) behind what it holds"

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


def _tokens(source: tree.Source) -> Iterator[_Token]:
    text, at = source.text, 0
    while True:
        match = _TOKEN.match(text, at)
        if match is None:
            offset = at + len(text[at:]) - len(text[at:].lstrip(" \t\r\n"))
            found = "||" if text.startswith("||", offset) else text[offset]
            otherwise = "a formula has numbers, names, + - * / **, parentheses and functions"
            message = f"unexpected character {text[offset]!r}"
            source.fail(message, offset, character(found, otherwise))
        kind = match.lastgroup or ""
        offset, at = match.start(kind), match.end()
        if kind == "number" and at < len(text) and (text[at].isalnum() or text[at] in "._"):
            advice = "write a product as 2*x, not 2x; numbers have no unit here"
            if match[kind] == "0" and re.match("[xXbBoO][0-9a-fA-F]", text[at:]):
                advice = "write a decimal number, as 16 for 0x10"
            elif text[at] == ".":
                advice = "a number has one point: 1.5"
            elif text.startswith("deg", at):
                advice = f"{TOKENS['deg']}; numbers have no unit here"
            source.fail(f"{match[kind]!r} runs into {text[at]!r}", at, character(text[at], advice))
        yield _Token(kind, match[kind], offset)
        if kind == "end":
            return


class Reader:
    """Recursive descent over the tokens of one formula or relation."""

    def __init__(self, source: tree.Source) -> None:
        if len(source.text) > MAX_LENGTH:
            advice = f"at most {MAX_LENGTH}; name its parts as parameters"
            source.fail(f"{len(source.text)} characters are too many", advice=advice)
        if date := _DATE.fullmatch(source.text.strip()):
            advice = f"if a difference is meant, write {date[0][:10].replace('-', ' - ')}"
            source.fail("this is a date, and times are numbers", advice=advice)
        self.source = source
        self._tokens = _tokens(source)
        self._nodes = 0
        self._depth = 0
        self.token = next(self._tokens)

    def advance(self) -> _Token:
        """Return the current token and advance."""
        token, self.token = self.token, next(self._tokens, self.token)
        return token

    def expect_end(self) -> None:
        """Check that the text ends here."""
        if self.token.kind != "end":
            self._unexpected()

    def sum(self) -> tree.Node:
        """Parse a formula as far as possible."""
        left = self._product()
        while self.token.text in ("+", "-"):
            left = self._binary(left, self._product)
        return left

    def _product(self) -> tree.Node:
        left = self._signed()
        while self.token.text in ("*", "/"):
            left = self._binary(left, self._signed)
        return left

    def _signed(self) -> tree.Node:
        # All nesting passes here, where its depth is counted; sums and products are loops.
        self._depth += 1
        if self._depth > MAX_DEPTH:
            self.source.fail("nested too deeply", self.token.offset, f"at most {MAX_DEPTH} levels")
        node: tree.Node
        if self.token.text in ("+", "-"):
            token = self.advance()
            node = self._checked(tree.Unary(token.text, self._signed(), token.offset))
        else:
            node = self._atom()
            if self.token.text == "**":
                node = self._binary(node, self._signed)
        self._depth -= 1
        return node

    def _binary(self, left: tree.Node, right: Callable[[], tree.Node]) -> tree.Node:
        token = self.advance()
        node = tree.Binary(token.text, left, right(), token.offset)
        if node.operator == "**" and tree.is_constant(node.right):
            exponent = self._constant(node.right)
            if abs(exponent) > MAX_EXPONENT:
                message = f"the exponent {exponent:g} is too large"
                self.source.fail(message, token.offset, f"at most {MAX_EXPONENT} in magnitude")
        return self._checked(node)

    def _atom(self) -> tree.Node:
        token = self.advance()
        if token.kind == "number":
            value = float(token.text)
            if not math.isfinite(value):
                advice = "write inf where infinity is meant"
                self.source.fail("the number is too large for a float", token.offset, advice)
            number = int(token.text) if token.text.isdigit() else value
            return self._checked(tree.Number(number, token.offset))
        if token.kind == "name":
            if self.token.text == "(":
                return self._call(token)
            if token.text in tree.CONSTANTS:
                return self._checked(tree.Constant(token.text, token.offset))
            if token.text in tree.WORDS:
                self.token = token
                self._unexpected()
            if token.text in tree.RESERVED:
                advice = f"write {token.text}(...)"
                self.source.fail(f"{token.text!r} is a function", token.offset, advice)
            return self._checked(tree.Name(token.text, token.offset))
        if token.text == "(":
            node = self.sum()
            self.close(token)
            return node
        if token.text in (")", ","):
            advice = "write a number or a name before it"
            self.source.fail(f"unexpected {token.text!r}", token.offset, advice)
        self.token = token
        return self._unexpected()

    def _call(self, name: _Token) -> tree.Node:
        if name.text not in tree.FUNCTIONS:
            advice = meant(name.text, tree.FUNCTIONS, tree.FUNCTIONS)
            if advice.startswith("known"):
                past = _TIME.match(self.source.text, self.token.offset)
                advice = DELAY if past else f"write a product as {name.text}*(...); {advice}"
            self.source.fail(f"unknown function {name.text!r}", name.offset, advice)
        opening = self.advance()
        arguments, marks = [self.sum()], [opening.offset]
        while self.token.text == ",":
            marks.append(self.advance().offset)
            arguments.append(self.sum())
        marks.append(self.token.offset)
        function = tree.FUNCTIONS[name.text]
        most = function.most
        # In a flow mapping YAML ends a value at its first comma.
        cut = self.token.kind == "end" and len(arguments) < function.least
        self.close(opening, "put a formula with a comma in quotes" if cut else _CLOSE)
        if len(arguments) < function.least or (most is not None and len(arguments) > most):
            wanted = f"{function.least}" if most is not None else f"at least {function.least}"
            problem = f"{name.text} takes {wanted}, not {len(arguments)}"
            self.source.fail(problem, name.offset, TOO_FEW.get(name.text, ""))
        return self._checked(tree.Call(name.text, tuple(arguments), name.offset, tuple(marks)))

    def close(self, opening: _Token, advice: str = _CLOSE) -> None:
        """Parse the parenthesis that closes `opening`."""
        if self.token.text != ")":
            if self.token.kind == "end":
                self.source.fail("this parenthesis is never closed", opening.offset, advice)
            self._unexpected()
        self.advance()

    def _checked(self, node: tree.Node) -> tree.Node:
        """Count `node`, and evaluate it if constant.

        A constant without a value is refused here and not during a run; a tower such as
        ``2**2**2**99`` overflows before SymPy's exact arithmetic sees it.
        """
        self._nodes += 1
        if self._nodes > MAX_NODES:
            advice = f"at most {MAX_NODES}; name parts as parameters"
            self.source.fail("too many terms", node.offset, advice)
        if not isinstance(node, tree.Number | tree.Constant | tree.Name) and tree.is_constant(node):
            self._constant(node)
        return node

    def _constant(self, node: tree.Node) -> float:
        return tree.evaluate(node, {}, self.source)

    def _unexpected(self) -> NoReturn:
        token = self.token
        advice = {
            **TOKENS,
            "name": "write a product as a*b; numbers have no unit here",
            "number": "write a product as a*b",
            "end": "write what follows the last sign",
        }
        message = "the formula ends early" if token.kind == "end" else f"unexpected {token.text!r}"
        key = "<" if token.text in RELATIONS else token.text
        if key == "=" and self.source.text[token.offset + 1 : token.offset + 2] in ("<", ">"):
            key = "=>"
        otherwise = advice.get(key) or advice.get(token.kind, "")
        self.source.fail(message, token.offset, program(self.source.text) or otherwise)
