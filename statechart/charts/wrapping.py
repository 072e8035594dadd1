"""Wrapping: `mod` and `floor` of time along a run, by regions that count whole periods.

mod(a, b) = a - b n with n = floor(a/b), a variable of a region: a transition counts it up where a
reaches (n + 1) b, another down where a falls below n b.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel

from statechart.charts.transitions import Transition
from statechart.documents.declaration import Declaration
from statechart.documents.documented import leaves
from statechart.documents.fields import TIME, ValueCheck, replace_fields, value_of
from statechart.errors import DeclarationProblem, FormulaError, Loc
from statechart.formulas.formula import Formula, parse
from statechart.formulas.relation import Comparison, parse_relation
from statechart.formulas.tree import JUMPS, Call, calls_in, names_in

Document = TypeVar("Document", bound=Declaration)

WRAP_ADVICE = "write a number above 0, or a formula of parameters"
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
    """A counting region: its variable and transitions, the period and where it stands."""

    variable: str
    initial: str
    transitions: tuple[Transition, ...]
    period: str = ""
    loc: Loc = ()


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
            return replace_fields(value, **new) if new else value
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
    places = {wrap.key: loc for loc, _, wrap in reversed([*wraps_in(document)])}
    counts = {
        own: _count(own, *key)._replace(period=key[2], loc=places[key])
        for key, own in regions.items()
    }
    return document.model_construct(**fields), counts


def _count(region: str, function: str, value: str, period: str) -> Count:
    count, period = f"{region}.count", _factor(period)
    up, down = _EVENTS[function]
    above, below, first = f"{count} + 1", f"{count} - 1", f"floor({_factor(value)}/{period})"
    changes = bool((parse(value).names - {TIME}) | parse(period).names)
    if changes:
        # New parameters of a stream may pass many periods at once.
        above, below = f"max({above}, {first})", f"min({below}, {first})"
    steps = [(up, f"{value} >= ({count} + 1)*{period}", above)]
    if value != TIME or changes:
        steps.append((down, f"{value} < {count}*{period}", below))
    transitions = (
        Transition(**{"name": event, "from": STATE, "guard": guard, "updates": {count: to}})
        for event, guard, to in steps
    )
    return Count(count, f"floor({_factor(_at_start(value))}/{period})", tuple(transitions))


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


def wraps_in(document: Declaration) -> Iterator[tuple[Loc, str, Wrap]]:
    """Yield place, text and call of every `mod` and `floor` of time in a document."""
    for loc, text, _ in leaves(document):
        for wrap in periodic_calls(text) if isinstance(text, str) and loc != ("doc",) else ():
            yield loc, text, wrap


def check_wrapping(document: Declaration, still: Collection[Loc] = ()) -> None:
    """Check that `mod` and `floor` depend on time and parameters alone, in fields that may jump.

    `still` are prefixes of the places of formulas that may not jump. Raises `DeclarationProblem`.
    """
    for loc, text, wrap in wraps_in(document):
        _check_arguments(document, wrap, loc)
        if loc[0] in _NOT_WRAPPED or any(loc[: len(part)] == part for part in still):
            message = f"{wrap.call.function} jumps, and cannot stand in this field"
            advice = (
                "write it in paths of surfaces and led bodies, flows, forces, controls, "
                "guards, or enabled"
            )
            raise DeclarationProblem(message, advice=advice, loc=loc, offset=wrap.call.offset)
        _check_bound(text, loc)


def _check_bound(text: str, loc: Loc) -> None:
    """Check a relation of one comparison, of `mod` with a number or with its period.

    Parameters may change before a run, and other comparisons may hold for a span of time.
    """
    wraps = {wrap.call.offset: wrap for wrap in periodic_calls(text)}
    try:
        one = parse_relation(text).root if wraps else None
    except FormulaError:  # A formula, not a relation.
        return
    if not isinstance(one, Comparison) or one.operator in ("==", "!="):
        return
    below = one.operator in ("<", "<=")
    for side, bound, capped in ((one.left, one.right, below), (one.right, one.left, not below)):
        wrap = wraps.get(side.root.offset) if isinstance(side.root, Call) else None
        if wrap is None or wrap.call.function != "mod":
            continue
        period, advised = parse(wrap.period), f">= D with a number D below {wrap.period}"
        if capped:
            advised = "<= D with a number D above 0"
            missed = not bound.names and bound.value({}) <= 0.0
        else:
            numbers = not bound.names and not period.names
            missed = bound.root == period.root or (numbers and bound.value({}) >= period.value({}))
        if missed:
            call = text[wrap.call.offset : wrap.call.marks[-1] + 1]
            regular = f", or a transition with every: {wrap.period}" if wrap.value == TIME else ""
            message = (
                f"{call} is 0 for an instant and stays below {wrap.period}: the comparison holds "
                "for no span of time"
            )
            advice = f"write {call} {advised}{regular}"
            raise DeclarationProblem(message, advice=advice, loc=loc, offset=wrap.call.offset)


def _check_arguments(document: Declaration, wrap: Wrap, loc: Loc) -> None:
    call, function = wrap.call, wrap.call.function
    used = {name.name for name in names_in(call)}
    others = sorted(used - {TIME, *document.parameters})
    others += ["a formula that jumps"] if any(calls_in(call.arguments[0], JUMPS)) else []
    if others:
        message = f"{function} of {others[0]} is not periodic in time"
        advice = (
            f"write {function} of {TIME} and parameters, as in mod({TIME}, T); of what "
            "else changes, write a region whose transition to its own state counts"
        )
        raise DeclarationProblem(message, advice=advice, loc=loc, offset=call.offset)


def wrap_checks(document: Declaration) -> Iterator[ValueCheck]:
    """Yield the checks that the periods of `wraps_in` are positive."""
    for loc, _, wrap in wraps_in(document):
        yield ValueCheck(parse(wrap.period).names, partial(_check_wrap_period, loc, wrap))


def _check_wrap_period(loc: Loc, wrap: Wrap, values: Mapping[str, float]) -> None:
    if TIME in parse(wrap.period).names:
        problem = "changes"
    else:
        found = value_of(wrap.period, values, *loc)
        problem = "" if 0.0 < found < math.inf else f"is {found:g}"
    if problem:
        message = f"the period of {wrap.call.function} {problem}"
        raise DeclarationProblem(message, advice=WRAP_ADVICE, loc=loc, offset=wrap.call.offset)
