"""Checks that stop conditions, invariants and outputs refer to what exists."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from statechart.documents.declaration import Declaration
from statechart.documents.fields import check_names, check_relation
from statechart.documents.outputs import (
    Count,
    Event,
    Integral,
    Maximum,
    Minimum,
    Output,
    Value,
    check_event,
    check_member,
)
from statechart.documents.quantities import BASES
from statechart.errors import DeclarationProblem, Findings, close_matches
from statechart.formulas.formula import parse


def check_uses(
    model: Declaration,
    names: Collection[str],
    states: Mapping[str, Collection[str]],
    causes: Mapping[str, Collection[str]],
    changing: Collection[str],
) -> None:
    """Check that stop conditions, invariants and outputs speak of things that exist.

    For the validators of the models of a kind, which know what exists: what formulas may use, the
    states and the causes of jumps of every region (`stop` need not be among them), and the names
    whose value some flow changes. Raises `DeclarationProblem` at the first that does not.
    """
    found = Findings()
    named = {*BASES, *names, *model.parameters, *model.outputs}
    for name in model.units:
        with found:
            if name not in named:
                raise DeclarationProblem(
                    f"nothing is called {name!r}",
                    advice=close_matches(name, named),
                    loc=("units", name),
                    key=True,
                )
    for label, relation in model.stop.conditions.items():
        with found:
            check_relation(relation, names, states, changing, "stop", "conditions", label)
    for label, relation in model.invariants.items():
        with found:
            check_relation(relation, names, states, changing, "invariants", label)
    for label, output in model.outputs.items():
        with found:
            _check_output(label, output, names, states, causes)
    found.check()


def _check_output(
    label: str,
    output: Output,
    names: Collection[str],
    states: Mapping[str, Collection[str]],
    causes: Mapping[str, Collection[str]],
) -> None:
    loc = ("outputs", label)
    match output:
        case Value():
            check_names(parse(output.value), names, *loc, "value")
            _check_events(output.moment.events, causes, states, *loc, "at")
        case Integral():
            check_names(parse(output.integral), names, *loc, "integral")
            for region, state in output.during.items():
                check_member("region", region, states, *loc, "during", region)
                check_member("state", state, states[region], *loc, "during", region)
        case Count():
            _check_events(output.events, causes, states, *loc, "count")
        case Minimum():
            check_names(parse(output.minimum), names, *loc, "minimum")
        case Maximum():
            check_names(parse(output.maximum), names, *loc, "maximum")


def _check_events(
    events: Sequence[Event],
    causes: Mapping[str, Collection[str]],
    states: Mapping[str, Collection[str]],
    *loc: str,
) -> None:
    for event in events:
        # Runs stop, not regions.
        if event != Event(None, "stop"):
            check_event(event, causes, states, *loc)
