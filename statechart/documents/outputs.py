"""Declarations of outputs, events and moments."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    AfterValidator,
    Discriminator,
    StrictBool,
    Tag,
    field_validator,
    model_validator,
)

from statechart.documents.documented import declare
from statechart.documents.fields import FiniteText, Part, check_names
from statechart.documents.hints import OTHER_EVENTS
from statechart.errors import DeclarationProblem, close_matches, owner_or_matches
from statechart.formulas.formula import parse

_EVENT = re.compile(r"(?:([A-Za-z_]\w*)\.)?([A-Za-z_]\w*[+-]?)", re.ASCII)
_SAMPLE_COUNT = re.compile(r"([0-9]{1,9})\s+")


@dataclass(frozen=True, slots=True)
class Event:
    """A cause of jumps of one region or (None) of any, or the entry into a state."""

    region: str | None
    cause: str


@dataclass(frozen=True, slots=True)
class Moment:
    """The time of an output: `start`, `end`, or at the `first`, `last` or `each` of events.

    `most` limits the number of first or last events.
    """

    when: str
    events: tuple[Event, ...] = ()
    most: int | None = None

    @property
    def several(self) -> bool:
        """True if the output is a list."""
        return self.when == "each" or self.most is not None


def parse_events(text: str) -> tuple[Event, ...]:
    """Parse events such as ``tip.slip or tip.reverse``; raise `DeclarationProblem`."""
    events = []
    for part in text.split(" or "):
        match = _EVENT.fullmatch(part.strip())
        if match is None:
            advice = (
                "write a cause, or region.cause or region.state as in tip.slip, tip.pin; several "
                "with 'or' between them"
            )
            if part.startswith("done.state."):
                advice = f"write {part.rpartition('.')[2]}.done"
            raise DeclarationProblem(f"{part!r} is not an event", advice=advice)
        events.append(Event(match[1], match[2]))
    return tuple(events)


def _parse_moment(text: str) -> Moment:
    match text.split(maxsplit=1):
        case ["start" | "end" as when]:
            return Moment(when)
        case ["first" | "last" | "each" as when, events]:
            most = _SAMPLE_COUNT.match(events)
            if most is None:
                return Moment(when, parse_events(events))
            if when != "each" and int(most[1]) > 0:
                return Moment(when, parse_events(events[most.end() :]), int(most[1]))
    event = text if re.fullmatch(r"[\w.]+", text) else "CAUSE"
    advice = f"write first {event}, last {event}, each {event}, first 10 {event}, start or end"
    raise DeclarationProblem(f"{text!r} is not a moment", advice=advice)


def _that(parse: Callable[[str], object]) -> AfterValidator:
    """Return a validator of text that `parse` accepts."""

    def check(text: str) -> str:
        parse(text)
        return text

    return AfterValidator(check)


EventText = Annotated[str, _that(parse_events)]
"""An event, or several joined by `or`."""


class Value(Part):
    """A formula at a moment of the run; a list of its values at `each` event, or at some."""

    OTHER_WORDS: ClassVar = {
        "when": "at",
        "unit units": "units: {NAME: m}, beside outputs",
        "every times sample": "--samples after `run`, for a table over time",
    }

    value: FiniteText = declare(
        "Formula of variables, observables and parameters.",
        "abs(stick.angle)",
        unit="that of the formula",
    )
    at: Annotated[str, _that(_parse_moment)] = declare(
        "Time: start, end, first EVENT, last EVENT, each EVENT, first 10 EVENT or last 10 EVENT. "
        "An event is a cause such as slip, a cause of one contact such as tip.slip, or a state "
        "that is entered such as tip.pin; join several by or.",
        "first tip.slip",
        default="end",
    )
    before: StrictBool = declare(
        "Evaluate just before the jump instead of just after it.", True, default=False
    )

    @field_validator("at", mode="before")
    @classmethod
    def _no_time(cls, at: Any) -> Any:
        number = isinstance(at, int | float) and not isinstance(at, bool)
        if number and abs(at) < math.inf:  # math.isfinite fails for integers beyond floats
            raise DeclarationProblem(
                f"a moment is start, end or an event, not {at}",
                advice=f"in a region write {{name: tick, from: STATE, after: {at}}}, "
                "and here at: first REGION.tick",
            )
        return at

    @property
    def moment(self) -> Moment:
        """The moment of evaluation."""
        return _parse_moment(self.at)

    @model_validator(mode="after")
    def _before_needs_a_jump(self) -> Self:
        if self.before and not self.moment.events:
            raise DeclarationProblem(f"there is no jump at {self.at!r}", loc=("before",))
        return self


class Integral(Part):
    """A formula integrated over time, or over the time that regions spend in given states."""

    integral: FiniteText = declare(
        "Formula that is integrated over time.",
        "abs(tip.slip)",
        unit="that of the formula; of the integral, it times time",
    )
    during: dict[str, str] = declare(
        "Region and its state during which to integrate; the whole run by default.",
        {"tip": "slide"},
        default={},
    )


class Count(Part):
    """The number of times that an event happened."""

    count: EventText = declare("Event to count, or several joined by or.", "tip.touchdown")

    @property
    def events(self) -> tuple[Event, ...]:
        """The counted events."""
        return parse_events(self.count)


_WHOLE_RUN = dict.fromkeys(
    ("at", "before", "during"),
    "the formula alone, as an extreme is over the whole run; a value has at, an integral during",
)


class Minimum(Part):
    """The least value of a formula over the run."""

    OTHER_WORDS: ClassVar = _WHOLE_RUN

    minimum: FiniteText = declare(
        "Formula whose least value is reported.", "stick.y", unit="that of the formula"
    )


class Maximum(Part):
    """The greatest value of a formula over the run."""

    OTHER_WORDS: ClassVar = _WHOLE_RUN

    maximum: FiniteText = declare(
        "Formula whose greatest value is reported.", "tip.V", unit="that of the formula"
    )


def _which_output(value: Any) -> str | None:
    for model in (Value, Integral, Count, Minimum, Maximum):
        word = model.__name__.lower()
        if isinstance(value, model) or (isinstance(value, Mapping) and word in value):
            return f"{word} output"
    return None


Output = Annotated[
    Annotated[Value, Tag("value output")]
    | Annotated[Integral, Tag("integral output")]
    | Annotated[Count, Tag("count output")]
    | Annotated[Minimum, Tag("minimum output")]
    | Annotated[Maximum, Tag("maximum output")],
    Discriminator(
        _which_output,
        custom_error_type="output",
        custom_error_message="an output has one of the keys value, integral, count, minimum, "
        "maximum",
    ),
]
"""A reported quantity; its key is its kind."""


def formula_of(output: Output) -> FiniteText | None:
    """Return the formula of an output; a count has none."""
    formula: FiniteText | None = getattr(output, type(output).__name__.lower())
    return None if isinstance(output, Count) else formula


def check_output(
    output: Output,
    names: Collection[str],
    states: Mapping[str, Collection[str]],
    causes: Mapping[str, Collection[str]],
    *loc: str,
) -> None:
    """Raise `DeclarationProblem` at the first unknown name, state or event of an output."""
    if (formula := formula_of(output)) is not None:
        check_names(parse(formula), names, *loc, type(output).__name__.lower())
    if isinstance(output, Integral):
        for region, state in output.during.items():
            check_member("region", region, states, *loc, "during", region)
            check_member("state", state, states[region], *loc, "during", region)
    key, events = "at", output.moment.events if isinstance(output, Value) else ()
    if isinstance(output, Count):
        key, events = "count", output.events
    for event in events:
        # `stop` belongs to no region.
        if event != Event(None, "stop"):
            check_event(event, causes, states, *loc, key)


def check_event(
    event: Event,
    causes: Mapping[str, Collection[str]],
    states: Mapping[str, Collection[str]],
    *loc: str | int,
) -> None:
    """Raise `DeclarationProblem` if an event does not exist."""
    every = {name: {*found, *states.get(name, ())} for name, found in causes.items()}
    own = causes.values() if event.region is None else [every.get(event.region, ())]
    known = set[str]().union(*own)
    if event.cause not in known and (meant := OTHER_EVENTS.get(event.cause.lower())) in known:
        owner = "" if event.region is None else f"{event.region}."
        advice = f"write {owner}{meant}"
        raise DeclarationProblem(f"no cause or state {event.cause!r}", advice=advice, loc=loc)
    if event.region is None:
        check_member("cause or state", event.cause, known, *loc)
    elif event.cause not in known:
        known_region = event.region in every
        raise DeclarationProblem(
            f"no cause or state {event.cause!r}" if known_region else f"no region {event.region!r}",
            advice=owner_or_matches(event.region, event.cause, every),
            loc=loc,
        )


def check_member(what: str, name: str, known: Collection[str], *loc: str | int) -> None:
    """Raise `DeclarationProblem` if a name is not among the known ones."""
    if name not in known:
        raise DeclarationProblem(f"no {what} {name!r}", advice=close_matches(name, known), loc=loc)
