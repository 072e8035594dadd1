"""Declarations of states, transitions and regions, common to all kinds of documents."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, Literal, Self

from pydantic import StrictBool, model_validator

from statechart.documents import fields
from statechart.documents.documented import declare
from statechart.documents.outputs import Event, EventText, check_event, parse_events
from statechart.errors import DeclarationProblem, Loc, undeclared
from statechart.formulas.formula import parse
from statechart.formulas.tree import names_in

SEVERAL_SOURCES = "write one transition for each, or one from a state that holds them"
_OUTSIDE = "transitions: [{name: go, from: STATE, to: STATE, on: EVENT}] beside `states`"


class Transition(fields.Part):
    """A transition between states of a region, with its trigger and updates."""

    OTHER_WORDS: ClassVar = {
        "when if cond condition": "guard",
        "event trigger": "on: REGION.EVENT, or guard: RELATION",
        "reset reinit action actions assign do effect set": "updates: {VARIABLE: FORMULA}",
        "at timeout delay": "after",
        "priority": "the transitions in their order: of those that are due the first is taken",
        "send raise emit broadcast": (
            "in another region on: REGION.NAME; the name of a transition is its event"
        ),
        "source": "from",
        "target": "to",
        "type": "internal: true",
    }

    name: fields.NameText = declare(
        "Name of the event; outputs and triggers refer to it.", "thrust"
    )
    source: str = declare("State that the transition leaves.", "compression", alias="from")
    target: str | None = declare(
        "State that it enters; without one, no state is left and only the updates are made.",
        "extension",
        default=None,
        alias="to",
    )
    guard: fields.RelationText | None = declare(
        "Relation; the transition fires when it becomes true. Beside `on` it must hold at the "
        "event, beside `after` the transition fires once the time is over and it holds.",
        "leg.dlength >= 0",
        default=None,
    )
    on: EventText | None = declare(
        "Event of another region at which the transition fires, or STATE.done of a state that "
        "holds `from`.",
        "foot.touchdown",
        default=None,
    )
    after: fields.FormulaText | None = declare(
        "Time after entering the source at which the transition fires.",
        0.2,
        unit="time",
        default=None,
    )
    every: fields.FormulaText | None = declare(
        "Period after entering the source with which the transition fires.",
        "T",
        unit="time",
        default=None,
    )
    internal: StrictBool = declare(
        "Keeps the source, which holds the target, active: it is neither exited nor entered.",
        True,
        default=False,
    )
    updates: dict[str, fields.FiniteConstantText] = declare(
        "New values of variables, as formulas of the values before.",
        {"v": "-k*v"},
        unit="that of the variable",
        default={},
    )

    @property
    def events(self) -> tuple[Event, ...]:
        """The events of other regions in `on`."""
        return parse_events(self.on) if self.on is not None and not self.on_zeno else ()

    @property
    def on_zeno(self) -> bool:
        """True if the accumulation of jumps out of the state fires it."""
        return self.on == "zeno"

    @property
    def period(self) -> fields.FormulaText | None:
        """The delay or period of a timed transition, or None."""
        return self.after if self.after is not None else self.every

    @property
    def trigger(self) -> str:
        """The trigger as text."""
        if self.on_zeno:
            return "jumps accumulate"
        if self.on is not None:
            return f"on {self.on}" if self.guard is None else f"on {self.on} if {self.guard}"
        if self.period is None:
            return self.guard or ""
        over = f"{'after' if self.every is None else 'every'} {self.period}"
        return over if self.guard is None else f"{over} and {self.guard}"

    @model_validator(mode="before")
    @classmethod
    def _one_source(cls, value: Any) -> Any:
        """Explain spellings of other programs: lists of states, and guards that always hold."""
        if isinstance(value, Mapping):
            for key in ("from", "to"):
                if isinstance(value.get(key), list):
                    advice = SEVERAL_SOURCES if key == "from" else "write the state it enters"
                    raise DeclarationProblem("is one state, not a list", advice=advice, loc=(key,))
            if isinstance(value.get("guard"), bool):
                message = f"is a relation, not {str(value['guard']).lower()}"
                advice = "write x <= 0; time >= 0 always holds"
                raise DeclarationProblem(message, advice=advice, loc=("guard",))
        return value

    @model_validator(mode="after")
    def _one_trigger(self) -> Self:
        triggers = (self.on, self.after, self.every)
        count = sum(trigger is not None for trigger in triggers)
        if self.every is not None and self.guard is not None:
            raise DeclarationProblem(
                f"transition {self.name!r} has every and guard",
                advice="let another region tick: {name: tick, from: STATE, every: "
                f"{self.every}}}, and write here on: REGION.tick, guard: {self.guard}",
            )
        if count > 1 or (self.on_zeno if self.guard is not None else count == 0):
            raise DeclarationProblem(
                f"transition {self.name!r} needs one of guard, on, after, every",
                advice="write guard: x <= 0, on: region.event, after: DURATION or every: PERIOD; "
                "a guard may stand beside on and after",
            )
        return self


class BaseState(fields.Part):
    """A state with its substates: one of `states` is active with it, or one of each region.

    With `history` it is a pseudostate: a transition to it enters the siblings last active.
    """

    OTHER_WORDS: ClassVar = {
        "on after always": _OUTSIDE,
        "children substates": "states",
        "onentry on_enter enter en": "entry: {VARIABLE: FORMULA}",
        "onexit leave ex": "exit: {VARIABLE: FORMULA}",
        "do ode dynamics equation equations der": "flows: {VARIABLE: FORMULA}",
        "during du": "flows: {VARIABLE: FORMULA}, or a transition with every: PERIOD",
        "parallel type": "regions: {NAME: ...} in it, or final: true",
        "end terminal": "final: true",
    }

    initial: str | None = declare(
        "Inner state that is entered with the state.", "waiting", default=None
    )
    states: Mapping[str, BaseState] = declare(
        "States in it, of which one is active with it.", {"waiting": {}, "working": {}}, default={}
    )
    regions: Mapping[str, BaseRegion] = declare(
        "Regions in it, of each of which one state is active with it.",
        {"lamp": {"initial": "off", "states": {"off": {}, "on": {}}}},
        default={},
    )
    transitions: tuple[Transition, ...] = declare(
        "Transitions between the states in it.",
        [{"name": "begin", "from": "waiting", "to": "working", "after": 1}],
        default=(),
    )
    history: Literal["shallow", "deep"] | None = declare(
        "Makes the state a history: a transition to it enters the state that was "
        "last active beside it; shallow restores one level, deep all.",
        "shallow",
        default=None,
    )
    final: StrictBool = declare(
        "Marks a final state: entering it completes the state that holds it and raises the event "
        "STATE.done; a state with regions is complete once all of them are.",
        True,
        default=False,
    )
    entry: dict[str, fields.FiniteConstantText] = declare(
        "Values of variables when the state is entered.",
        {"count": "count + 1"},
        unit="that of the variable",
        default={},
    )
    exit: dict[str, fields.FiniteConstantText] = declare(
        "Values of variables when the state is left.",
        {"count": 0},
        unit="that of the variable",
        default={},
    )
    flows: dict[str, fields.FiniteText] = declare(
        "Time derivatives of variables; without one a variable is constant. An "
        "inner state may override them.",
        {"x": "v", "v": "-g"},
        unit="that of the variable, per time",
        default={},
    )


class BaseRegion(fields.Part):
    """States, exactly one of them active, and the transitions between them."""

    OTHER_WORDS: ClassVar = {
        "edges jumps": "transitions",
        "history": "states: {NAME: {history: deep}} beside regions",
        "modes locations": "states",
        "start": "initial",
        "parallel type": "regions: {NAME: ...} in a state",
    }

    initial: str = declare("State at the start.", "flight")
    states: Mapping[str, BaseState] = declare("Name to state.", {"flight": {}, "stance": {}})
    transitions: tuple[Transition, ...] = declare(
        "Transitions between its states.",
        [{"name": "land", "from": "flight", "to": "stance", "on": "foot.touchdown"}],
        default=(),
    )


Holder = BaseRegion | BaseState


def nested(holder: Holder, *loc: str | int) -> Iterator[tuple[str, Holder, Loc]]:
    """Yield names, states and places of the states in `holder`, outer before inner."""
    for name, state in holder.states.items():
        at = (*loc, "states", name)
        yield name, state, at
        yield from nested(state, *at)
    if isinstance(holder, BaseState):
        for name, region in holder.regions.items():
            at = (*loc, "regions", name)
            yield name, region, at
            yield from nested(region, *at)


def declared_transitions(holder: Holder, *loc: str | int) -> Iterator[tuple[Transition, Loc]]:
    """Yield the transitions of a region and its states, inner before outer."""
    for name, state in holder.states.items():
        yield from declared_transitions(state, *loc, "states", name)
    if isinstance(holder, BaseState):
        for name, region in holder.regions.items():
            yield from declared_transitions(region, *loc, "regions", name)
    for index, transition in enumerate(holder.transitions):
        yield transition, (*loc, "transitions", index)


def check_changes(
    holder: BaseRegion,
    *loc: str | int,
    variables: Collection[str],
    known: Collection[str],
    controls: Collection[str] = (),
    of: str = "",
) -> None:
    """Check that updates and flows change declared `variables` by formulas over `known`.

    Flows may use `controls`; `of` names the owner of the variables in messages. Raises
    `DeclarationProblem`.
    """
    changes: list[tuple[Mapping[str, fields.FiniteText], Loc]] = []
    for _, state, at in nested(holder, *loc):
        if isinstance(state, BaseState):
            changes += [(getattr(state, key), (*at, key)) for key in ("flows", "entry", "exit")]
    for transition, at in declared_transitions(holder, *loc):
        changes.append((transition.updates, (*at, "updates")))
    unset = "nothing sets parameters or time"
    if of:
        unset = "updates and flows change variables of their own region alone"
    for texts, at in changes:
        for variable, text in texts.items():
            if variable not in variables:
                rate = re.sub(r"^d(er\()?|[_.]?dot$|['()]", "", variable)
                if at[-1] == "flows" and rate in variables:
                    advice = f"write {rate}: a flow is its rate"
                elif variable in controls:
                    advice = (
                        "updates and flows change variables of their region; a state sets a "
                        f"control, sets: {{{variable}: 1}}"
                    )
                elif variable in known:
                    advice = f"{unset}; declare a variable of another name"
                else:
                    advice = undeclared(variable, variables)
                message = f"no variable {variable!r}{of}"
                raise DeclarationProblem(message, advice=advice, key=(*at, variable))
            names = {*known, *controls} if at[-1] == "flows" else known
            fields.check_names(parse(text), names, *at, variable)


def periods_in(holder: Holder, *loc: str | int) -> Iterator[tuple[Loc, fields.FormulaText]]:
    """Yield the places and texts of the delays and periods of transitions."""
    for transition, at in declared_transitions(holder, *loc):
        if transition.period is not None:
            yield (*at, "after" if transition.every is None else "every"), transition.period


PERIOD = "must be a finite time above 0, not {:g}"
PERIOD_ADVICE = "write a number, or a formula of parameters, such as 0.02"


def check_periods(
    regions: Mapping[str, BaseRegion],
    known: Collection[str],
    changing: Collection[str],
) -> None:
    """Check that delays and periods are formulas of parameters, of nothing `changing`."""
    for name, region in regions.items():
        for loc, period in periods_in(region, "regions", name):
            for node in names_in(parse(period).root):
                if node.name in changing:
                    message = f"{node.name!r} changes during a run, and a period is constant"
                    advice = "write a guard on a variable with the flow 1"
                    raise DeclarationProblem(message, advice=advice, loc=loc, offset=node.offset)
            fields.check_names(parse(period), known, *loc)


def period_checks(regions: Mapping[str, BaseRegion]) -> Iterator[fields.ValueCheck]:
    """Yield the checks that delays and periods are positive."""
    for name, region in regions.items():
        for loc, period in periods_in(region, "regions", name):
            yield fields.ValueCheck(parse(period).names, partial(_check_period, loc, period))


def _check_period(loc: Loc, period: fields.FormulaText, values: Mapping[str, float]) -> None:
    found = fields.value_of(period, values, *loc)
    if not 0.0 < found < float("inf"):
        raise DeclarationProblem(PERIOD.format(found), advice=PERIOD_ADVICE, loc=loc)


def check_listening(
    region: str,
    transitions: Sequence[tuple[Transition, Loc]],
    causes: Mapping[str, Collection[str]],
    states: Mapping[str, Collection[str]],
    *,
    alone: Collection[str] = (),
) -> None:
    """Check that transitions of a region wait for existing events of other regions.

    `alone` are further values of `on`; `causes` includes the states that raise `done`. Raises
    `DeclarationProblem`.
    """
    others = {name: found for name, found in causes.items() if name != region}
    for transition, at in transitions:
        loc = (*at, "on")
        if transition.on_zeno and "zeno" in alone:
            continue
        for event in parse_events(transition.on) if transition.on is not None else ():
            heard = {*alone}.union(*others.values())
            own = event.cause in {*causes.get(region, ())} - heard and event.region is None
            if event.cause == "done" and event.region in {*states.get(region, ())} - {*others}:
                message = f"{event.region!r} is never done: it holds no final state"
                advice = "write {final: true} for the last of its states"
                raise DeclarationProblem(message, advice=advice, loc=loc)
            if event.region == region or own:
                raise DeclarationProblem(
                    f"{region!r} waits for an event of its own",
                    advice=f"write guard: in({region}.STATE) for a state of it; `on` takes events "
                    "of other regions, and STATE.done",
                    loc=loc,
                )
            # A value of `alone` belongs to no region; no region has the name "".
            single = event.region is None and len(transition.events) == 1
            try:
                check_event(event, {**others, "": alone} if single else others, states, *loc)
            except DeclarationProblem as problem:
                problem.advice += (
                    "; a signal from outside is a transition of another region, "
                    "{name: go, from: STATE, after: 1}, heard as REGION.go"
                )
                raise
