"""Wrapping: `mod` and `floor` of time along a run, by regions that count whole periods.

mod(a, b) = a - b n with n = floor(a/b), a variable of a region: a transition counts it up where a
reaches (n + 1) b, another down where a falls below n b.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from itertools import pairwise, product
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from statechart.charts.transitions import Transition
from statechart.documents.declaration import Declaration
from statechart.documents.documented import leaves
from statechart.documents.fields import TIME, value_of
from statechart.errors import DeclarationProblem, FormulaError, Loc
from statechart.formulas.formula import Formula, parse
from statechart.formulas.relation import Comparison, parse_relation
from statechart.formulas.tree import JUMPS, Call, calls_in, names_in

Document = TypeVar("Document", bound=Declaration)

STATE = "on"
"""The only state of a region that counts."""

_ATOM = re.compile(r"[\w.]+")
# Fields that are evaluated once, on the trace, or never.
_NOT_WRAPPED = frozenset(
    ("doc", "parameters", "ranges", "units", "outputs", "stop", "invariants", "settings")
)
_EVENTS = {"mod": ("wrap", "unwrap"), "floor": ("rise", "fall")}


class Wrap(NamedTuple):
    """A call of `mod` or `floor` whose first argument uses the time, in a text."""

    call: Call
    value: str
    period: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Function and arguments; equal calls share a count."""
        return self.call.function, self.value, self.period


class Count(NamedTuple):
    """A counting region: its variable and transitions."""

    variable: str
    initial: str
    transitions: tuple[Transition, ...]


def count_periods(document: Document) -> tuple[Document, Mapping[str, Count]]:
    """Return the document with counts in place of `mod` and `floor`, and the counting regions."""
    regions: dict[tuple[str, str, str], str] = {}
    taken: set[str] = set()
    for part in type(document).model_fields:
        names = getattr(document, part)
        taken |= names.keys() if isinstance(names, Mapping) else set()

    def name(wrap: Wrap) -> str:
        if wrap.key not in regions:
            function = wrap.call.function
            own, number = function, 1
            while own in taken:
                number += 1
                own = f"{function}{number}"
            taken.add(own)
            regions[wrap.key] = own
        return regions[wrap.key]

    def rewritten(value: Any) -> Any:
        if isinstance(value, str):
            for wrap in reversed(list(periodic_calls(value))):
                count, call = f"{name(wrap)}.count", wrap.call
                if call.function == "mod":
                    count = f"({wrap.value} - {_factor(wrap.period)}*{count})"
                value = value[: call.offset] + count + value[call.marks[-1] + 1 :]
            return value
        if isinstance(value, BaseModel):
            own = {field: getattr(value, field) for field in type(value).model_fields}
            new = {f: to for f, part in own.items() if (to := rewritten(part)) is not part}
            return value.model_copy(update=new) if new else value
        if isinstance(value, Mapping):
            to = {key: rewritten(part) for key, part in value.items()}
            return value if all(to[key] is value[key] for key in to) else to
        if isinstance(value, list | tuple):
            parts = [rewritten(part) for part in value]
            same = all(one is other for one, other in zip(parts, value, strict=True))
            return value if same else type(value)(parts)
        return value

    fields = {part: getattr(document, part) for part in type(document).model_fields}
    fields |= {part: rewritten(value) for part, value in fields.items() if part not in _NOT_WRAPPED}
    if not regions:
        return document, {}
    counts = {own: _count(own, *key) for key, own in regions.items()}
    return document.model_construct(**fields), counts


def _count(region: str, function: str, value: str, period: str) -> Count:
    count, period = f"{region}.count", _factor(period)
    up, down = _EVENTS[function]
    steps = [(up, f"{value} >= ({count} + 1)*{period}", f"{count} + 1")]
    if value != TIME:
        steps.append((down, f"{value} < {count}*{period}", f"{count} - 1"))
    return Count(
        count,
        f"floor({_factor(_at_start(value))}/{period})",
        tuple(
            Transition(**{"name": event, "from": STATE, "guard": guard, "updates": {count: to}})
            for event, guard, to in steps
        ),
    )


def _factor(text: str) -> str:
    return text if _ATOM.fullmatch(text) else f"({text})"


def _at_start(text: str) -> str:
    for name in reversed([*names_in(parse(text).root)]):
        if name.name == TIME:
            text = text[: name.offset] + "0" + text[name.offset + len(TIME) :]
    return text


def periodic_calls(text: str) -> Iterator[Wrap]:
    """Yield the calls of `mod` and `floor` of time in a formula or relation."""
    formulas: tuple[Formula, ...] = ()
    if any(function in text for function in JUMPS):
        with suppress(FormulaError):
            formulas = (parse(text),)
        if not formulas:
            with suppress(FormulaError):
                formulas = parse_relation(text).formulas
    for call in (call for formula in formulas for call in calls_in(formula.root, JUMPS)):
        if any(name.name == TIME for name in names_in(call.arguments[0])):
            parts = [text[a + 1 : b].strip() for a, b in pairwise(call.marks)]
            yield Wrap(call, *(*parts, "1")[:2])


def check_wrapping(
    document: Declaration, values: Mapping[str, float], still: Collection[Loc] = ()
) -> None:
    """Check that `mod` and `floor` depend on time and parameters alone, in fields that may jump.

    `still` are prefixes of the places of formulas that may not jump. Raises `DeclarationProblem`.
    """
    for loc, text, _ in leaves(document):
        for wrap in periodic_calls(text) if isinstance(text, str) and loc != ("doc",) else ():
            call = wrap.call
            _check(document, wrap, loc, values)
            if loc[0] in _NOT_WRAPPED or any(loc[: len(part)] == part for part in still):
                raise DeclarationProblem(
                    f"{call.function} jumps, and cannot stand in this field",
                    advice="write it in paths of surfaces and led bodies, flows, forces, controls, "
                    "guards, or enabled",
                    loc=loc,
                    offset=call.offset,
                )
        if loc[0] not in _NOT_WRAPPED and isinstance(text, str):
            _check_spans(text, loc, values)


def _check_spans(text: str, loc: Loc, values: Mapping[str, float]) -> None:
    """Check that a comparison of `mod` with a fixed bound holds for a span of time.

    A bound of other parameters than the period may leave no span: ``mod(time, T) < duty*T``.
    """
    wraps = {f"mod.at{wrap.call.offset}": wrap for wrap in periodic_calls(text)}
    shown = text
    for name, wrap in reversed(wraps.items()):
        shown = shown[: wrap.call.offset] + name + shown[wrap.call.marks[-1] + 1 :]
    try:
        comparisons = parse_relation(shown).inequalities if wraps else ()
    except FormulaError:  # A formula, not a relation.
        return
    for one, (own, wrap) in product(comparisons, wraps.items()):
        names = one.left.names | one.right.names
        if wrap.call.function != "mod" or own not in names:
            continue
        period = value_of(wrap.period, values, *loc)
        fixed = names - {own} <= parse(wrap.period).names
        if fixed and not _holds_between(one, own, period, values):
            call = text[wrap.call.offset : wrap.call.marks[-1] + 1]
            regular = f", or a transition with every: {wrap.period}" if wrap.value == TIME else ""
            raise DeclarationProblem(
                f"{call} is 0 for an instant and stays below {wrap.period}: the comparison holds "
                "for no span of time",
                advice=f"write {call} <= D with a number D above 0{regular}",
                loc=loc,
                offset=wrap.call.offset,
            )


def _holds_between(one: Comparison, name: str, period: float, values: Mapping[str, float]) -> bool:
    """Return whether a comparison holds for a span of values of `name` from 0 to `period`.

    True, too, where it is not linear.
    """
    sides = (one.left, one.right) if one.operator in ("<", "<=") else (one.right, one.left)
    first, middle, last = (
        sides[0].value({**values, name: part * period})
        - sides[1].value({**values, name: part * period})
        for part in (0.0, 0.5, 1.0)
    )
    straight = abs(first - 2.0 * middle + last) <= 1e-12 * max(abs(first), abs(last))
    return not straight or min(first, last) < 0.0 or (first == last == 0.0 and not one.strict)


def _check(document: Declaration, wrap: Wrap, loc: Loc, values: Mapping[str, float]) -> None:
    call, function = wrap.call, wrap.call.function
    used = {name.name for name in names_in(call)}
    others = sorted(used - {TIME, *document.parameters})
    others += ["a formula that jumps"] if any(calls_in(call.arguments[0], JUMPS)) else []
    if others:
        raise DeclarationProblem(
            f"{function} of {others[0]} is not periodic in time",
            advice=f"write {function} of {TIME} and parameters, as in mod({TIME}, T); of what "
            "else changes, write a region whose transition to its own state counts",
            loc=loc,
            offset=call.offset,
        )
    if TIME in parse(wrap.period).names:
        problem = "changes"
    else:
        found = value_of(wrap.period, values, *loc)
        problem = "" if 0.0 < found < math.inf else f"is {found:g}"
    if problem:
        raise DeclarationProblem(
            f"the period of {function} {problem}",
            advice="write a number above 0, or a formula of parameters",
            loc=loc,
            offset=call.offset,
        )
