"""Relations: comparisons of formulas, and `in(REGION.STATE)`, joined by `and`, `or` and `not`.

The negation normal form has no `not`: the negation of ``a <= b`` is ``a > b``, that of an *and* is
an *or* of negations. ``a == b`` is ``a <= b and a >= b``, ``a != b`` is ``a < b or a > b``.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

from statechart.formulas.condition import (
    And,
    Atom,
    Condition,
    InState,
    Or,
    condition_of,
    fold,
    replaced,
)
from statechart.formulas.formula import Formula, rewrite_overflow
from statechart.formulas.hints import state_meant
from statechart.formulas.syntax import RELATIONS, Reader
from statechart.formulas.tree import Source

if TYPE_CHECKING:
    import sympy as sp

MAX_TERMS = 60
"""Limit of comparisons, negations and parentheses of a relation."""

_MAX_CACHED = 4096
_ORDERED = {"==": ("<=", ">="), "!=": ("<", ">")}
_COMPARISONS = (*RELATIONS, *_ORDERED)
_HOLDS: Mapping[str, Callable[[Any, Any], Any]] = {
    "<": operator.lt, "<=": operator.le, ">": operator.gt, ">=": operator.ge,
    "==": operator.eq, "!=": operator.ne,
}  # fmt: skip
_OPPOSITE = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
_TOKENS = re.compile(r"[()]|[<>=!]=?|[A-Za-z_][A-Za-z0-9_.]*|.", re.DOTALL | re.ASCII)
_AND = " and "
_OR = re.compile(r"\bor\b")
States = Mapping[tuple[str, str], "sp.Expr"]
"""(region, state) -> a number above 0 while the state is active, below 0 else."""

_NO_STATES: States = {}
_JOINTS = frozenset({"<", "<=", ">", ">=", "==", "!=", "=", "!", "and", "or", "not", "in"})


@dataclass(frozen=True)
class Comparison:
    """A comparison of two formulas."""

    # Both sides have the text of the relation, so that offsets point into it.
    left: Formula
    right: Formula
    operator: str  # one of ``< <= > >= == !=``
    offset: int
    text: str

    def holds(self, left: Any, right: Any) -> Any:
        """Evaluate for values of the sides: numbers, or arrays of one shape."""
        return _HOLDS[self.operator](left, right)

    def margin(self, symbols: Mapping[str, sp.Expr]) -> sp.Expr:
        """Return the margin; see `Relation.margin`."""
        left, right = self.left.to_sympy(symbols), self.right.to_sympy(symbols)
        margin = left - right if self.operator in ("<", "<=") else right - left
        return rewrite_overflow(margin, self.left)

    @property
    def strict(self) -> bool:
        """True if it is false for equal sides."""
        return self.operator in ("<", ">", "!=")


@dataclass(frozen=True)
class Negation:
    """``not`` of a term."""

    part: Term


Term = Comparison | InState | Negation | And | Or


@dataclass(frozen=True)
class Relation:
    """A parsed relation; created by `parse_relation`."""

    root: Term
    text: str

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """Its comparisons, from left to right."""
        return tuple(term for term in _terms(self.root) if isinstance(term, Comparison))

    @cached_property
    def members(self) -> tuple[InState, ...]:
        """Its terms `in(REGION.STATE)`, from left to right."""
        return tuple(term for term in _terms(self.root) if isinstance(term, InState))

    @cached_property
    def formulas(self) -> tuple[Formula, ...]:
        """The sides of its comparisons, from left to right."""
        return tuple(side for one in self.comparisons for side in (one.left, one.right))

    @cached_property
    def names(self) -> frozenset[str]:
        """The names in it."""
        return frozenset[str]().union(*(formula.names for formula in self.formulas))

    def require(self, known: Collection[str]) -> None:
        """Check that it uses only names in `known`; see `Formula.require`."""
        for formula in self.formulas:
            formula.require(known)

    def require_states(self, states: Mapping[str, Collection[str]]) -> None:
        """Raise `FormulaError` at the first unknown region or state in ``in(...)``."""
        source = Source(self.text)
        for member in self.members:
            if not states:
                advice = "`in` is for guards, stop conditions, invariants, and `enabled` of scenes "
                advice += "with controllers"
                source.fail("no state can be asked for here", member.offset, advice)
            region, state = member.region, member.state
            if state not in states.get(region, ()):
                own = f"region {region!r}"
                missing = f"{own} has no state {state!r}" if region in states else f"no {own}"
                source.fail(missing, member.offset, state_meant(region, state, states))

    def require_still(self, changing: Collection[str]) -> None:
        """Raise `FormulaError` at the first ``==`` or ``!=`` of names that vary along flows."""
        advice = "write >= if it rises to the value, <= if it falls"
        for one in self.comparisons:
            names = sorted((one.left.names | one.right.names).intersection(changing))
            if one.operator in _ORDERED and names:
                message = f"{one.operator} compares {names[0]!r}, which changes between events"
                Source(self.text).fail(message, one.offset, advice)

    def margin(self, symbols: Mapping[str, sp.Expr], states: States = _NO_STATES) -> sp.Expr:
        """Return the margin: positive while the relation is false, zero as it turns true.

        ``a - b`` for ``a <= b`` and ``a < b``, ``b - a`` for ``a >= b`` and ``a > b``, the maximum
        for *and*, the minimum for *or*. Raises `FormulaError` as `Formula.to_sympy`.
        """
        from statechart.formulas.writer import Max, Min

        if any((member.region, member.state) not in states for member in self.members):
            self.require_states({})
        return fold(
            _normal(self.root),
            lambda comparison: comparison.margin(symbols),
            lambda within: _within(within, states).expression,
            lambda parts: Max(*parts),
            lambda parts: Min(*parts),
        )

    def condition(self, symbols: Mapping[str, sp.Expr], states: States = _NO_STATES) -> Condition:
        """Return the relation as a Boolean tree over smooth atoms, without `min`, `max` and `abs`.

        Raises `FormulaError` as `Formula.to_sympy`, and if it has too many atoms.
        """
        tree = replaced(
            _normal(self.root),
            lambda comparison: Atom(comparison.margin(symbols), comparison.strict),
            lambda one: _within(one, states) if (one.region, one.state) in states else one,
        )
        return condition_of(tree, Source(self.text))


def _terms(term: Term) -> Iterator[Term]:
    """Yield a term and its descendants, left to right."""
    yield term
    if isinstance(term, Negation):
        yield from _terms(term.part)
    elif isinstance(term, And | Or):
        for part in term.parts:
            yield from _terms(part)


def _normal(term: Term, negated: bool = False) -> Any:
    """Return the negation normal form of a term, or of its negation."""
    if isinstance(term, Negation):
        return _normal(term.part, not negated)
    if isinstance(term, InState):
        return replace(term, holds=not negated)
    if isinstance(term, And | Or):
        kind = And if isinstance(term, And) is not negated else Or
        return kind(tuple(_normal(part, negated) for part in term.parts))
    sign = _OPPOSITE[term.operator] if negated else term.operator
    if sign in _ORDERED:
        kind = And if sign == "==" else Or
        return kind(tuple(replace(term, operator=part) for part in _ORDERED[sign]))
    return replace(term, operator=sign)


def _within(tree: InState, states: States) -> Atom:
    return Atom(states[tree.region, tree.state] * (-1 if tree.holds else 1), False)


@lru_cache(_MAX_CACHED)
def parse_relation(text: str) -> Relation:
    """Parse comparisons and `in(REGION.STATE)`, joined by `and`, `or`, `not`; see `parse`."""
    reader = _RelationReader(Source(text))
    root = reader.disjunction()
    reader.expect_end()
    return Relation(root, text)


def conjunction(texts: Sequence[str]) -> str:
    """Return the conjunction of relations."""
    if len(texts) == 1:
        return texts[0]
    return _AND.join(f"({text})" if _OR.search(text) else text for text in texts)


def place_in(texts: Sequence[str], offset: int) -> tuple[int, int]:
    """Return the index of the text, and the offset in it, for an offset in the conjunction."""
    for place, text in enumerate(texts):
        opened = int(len(texts) > 1 and _OR.search(text) is not None)
        width = len(text) + 2 * opened
        if offset <= width or place == len(texts) - 1:
            return place, max(offset - opened, 0)
        offset -= width + len(_AND)
    return 0, 0


class _RelationReader(Reader):
    """Recursive descent with precedence `or`, `and`, `not`, comparisons."""

    def __init__(self, source: Source) -> None:
        super().__init__(source)
        self._terms = 0

    def disjunction(self) -> Term:
        """Parse a whole relation."""
        return self._junction("or", Or, lambda: self._junction("and", And, self._term))

    def _junction(self, word: str, kind: type[And] | type[Or], part: Callable[[], Term]) -> Term:
        parts = [part()]
        while self.token.text == word:
            self.advance()
            parts.append(part())
        return parts[0] if len(parts) == 1 else kind(tuple(parts))

    def _term(self) -> Term:
        token, self._terms = self.token, self._terms + 1
        if self._terms > MAX_TERMS:
            self.source.fail("too many comparisons", token.offset, f"at most {MAX_TERMS}")
        if token.text == "not":
            self.advance()
            return Negation(self._term())
        if token.text == "in":
            return self._member()
        if token.text != "(" or not self._holds_relation():
            return self._comparison()
        self.advance()
        term = self.disjunction()
        self.close(token)
        if self.token.text in (*_COMPARISONS, "+", "-", "*", "/", "**"):
            self.source.fail("a relation is not a number", self.token.offset, "it is true or false")
        return term

    def _member(self) -> Term:
        token = self.advance()
        opening = self.advance()
        name = self.advance()
        region, dot, state = name.text.partition(".")
        if self.token.text in ("+", "-"):
            state += self.advance().text
        if opening.text != "(" or name.kind != "name" or not dot or self.token.text != ")":
            message = "`in` asks for a state of a region"
            self.source.fail(message, token.offset, "write in(REGION.STATE)")
        self.advance()
        return InState(region, state, offset=token.offset)

    def _comparison(self) -> Term:
        begin = self.token.offset
        left = self.sum()
        sign = self.token
        if sign.kind == "end" or sign.text in ("and", "or", ")"):
            written = self.source.text[begin : sign.offset].strip()
            state = written if re.fullmatch(r"\w+\.\w+", written) else "REGION.STATE"
            advice = f"write it as x <= 0, or in({state})"
            self.source.fail("a comparison is missing", sign.offset, advice)
        if sign.text not in _COMPARISONS:
            self.expect_end()
        self.advance()
        middle = self.token.offset
        right = self.sum()
        if self.token.text in _COMPARISONS:
            text = self.source.text
            first, second = text[begin : self.token.offset].strip(), text[middle:].strip()
            advice = f"write {first} and {second}"
            self.source.fail("a comparison has two sides", self.token.offset, advice)
        text = self.source.text
        own = text[begin : self.token.offset].strip()
        return Comparison(Formula(text, left), Formula(text, right), sign.text, sign.offset, own)

    def _holds_relation(self) -> bool:
        """Return whether the parenthesis that opens here contains a relation, not a formula."""
        depth = 0
        for match in _TOKENS.finditer(self.source.text, self.token.offset):
            token = match[0]
            depth += (token == "(") - (token == ")")
            if token in _JOINTS:
                return True
            if depth == 0:
                return False
        return False
