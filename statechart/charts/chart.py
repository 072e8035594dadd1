"""A plain chart as declared: variables, and regions of states with flows and transitions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, Self

from pydantic import Field, model_validator

from statechart.charts.transitions import BaseRegion, BaseTransition, check_listening
from statechart.documents.declaration import TIME, Declaration
from statechart.documents.fields import (
    FiniteText,
    Label,
    NameText,
    Part,
    RelationText,
    check_names,
    value_of,
)
from statechart.documents.outputs import Event
from statechart.errors import DeclarationProblem, close_matches
from statechart.formulas.derivatives import PIECES, check_derived, check_smooth
from statechart.formulas.formula import parse, parse_relation


class State(Part):
    """One state of a region: how variables change in it, and what holds in it."""

    flows: dict[str, FiniteText] = Field(
        default={}, description="Variable to its time derivative; without one it is constant."
    )
    invariants: dict[Label, RelationText] = Field(
        default={}, description="Named relations that hold as long as the state is active."
    )


class Transition(BaseTransition):
    """A transition of a chart, and what it sets.

    ``on: zeno`` waits for no other region: it fires where jumps out of the state accumulate.
    """

    updates: dict[str, FiniteText] = Field(
        default={}, description="Variable to its new value, of the values before the jump."
    )

    @property
    def on_zeno(self) -> bool:
        """Whether the accumulation of jumps out of the state fires it."""
        return self.on == "zeno"

    @property
    def events(self) -> tuple[Event, ...]:
        """Those of other regions."""
        return () if self.on_zeno else super().events


class Region(BaseRegion):
    """States of which exactly one is active, and the transitions between them."""

    states: dict[NameText, State] = Field(min_length=1)
    transitions: tuple[Transition, ...] = ()


class Chart(Declaration):
    """A hybrid statechart without mechanics.

    Every region has exactly one active state; a variable changes by the flow that an active state
    gives it and is constant where none does. Formulas may use variables, parameters and `time`;
    initial values only parameters.
    """

    kind: Literal["chart"] = "chart"
    variables: dict[NameText, FiniteText] = Field(
        min_length=1, description="Variable to its initial value."
    )
    regions: dict[NameText, Region] = Field(min_length=1)

    def check_values(self, values: Mapping[str, float]) -> None:
        """Check the initial values, too."""
        super().check_values(values)
        for name, text in self.variables.items():
            value = value_of(text, values, "variables", name)
            if abs(value) == float("inf"):
                raise DeclarationProblem("must be finite", loc=("variables", name))

    @model_validator(mode="after")
    def _variables_have_values(self) -> Self:
        for name in self.variables:
            taken = "the time of the run" if name == TIME else "a parameter"
            if name == TIME or name in self.parameters:
                raise DeclarationProblem(
                    f"{name!r} is {taken}",
                    advice="choose another name",
                    loc=("variables", name),
                    key=True,
                )
        self.check_values(self.values())
        return self

    @model_validator(mode="after")
    def _formulas_use_declared_names(self) -> Self:
        names = {TIME, *self.parameters, *self.variables}
        for region, state, name, flow in self._flows():
            loc = ("regions", region, "states", state, "flows", name)
            self._check_variable(name, *loc)
            check_names(parse(flow), names, *loc)
            changing = {TIME, *self.variables}
            check_derived(parse(flow).root, changing, loc, order=1)
            check_smooth(flow, changing, loc=loc, lacks="derivative, or no value,", advice=PIECES)
        for region, declared in self.regions.items():
            for state, content in declared.states.items():
                for label, relation in content.invariants.items():
                    loc = ("regions", region, "states", state, "invariants", label)
                    check_names(parse_relation(relation), names, *loc)
            for index, transition in enumerate(declared.transitions):
                at = ("regions", region, "transitions", index)
                if transition.guard is not None:
                    check_names(parse_relation(transition.guard), names, *at, "guard")
                for name, update in transition.updates.items():
                    self._check_variable(name, *at, "updates", name)
                    check_names(parse(update), names, *at, "updates", name)
        states = {name: region.states for name, region in self.regions.items()}
        causes = {name: {t.name for t in r.transitions} for name, r in self.regions.items()}
        for name, declared in self.regions.items():
            check_listening(name, declared.transitions, causes, states, alone=("zeno",))
        self.check_uses(names, states, causes)
        return self

    @model_validator(mode="after")
    def _regions_do_not_contradict(self) -> Self:
        # Any state of one region can be active together with any state of another.
        owners: dict[str, tuple[str, str]] = {}
        for region, state, name, _ in self._flows():
            owner, in_state = owners.setdefault(name, (region, state))
            if owner != region:
                raise DeclarationProblem(
                    f"region {region!r} in state {state!r} and region {owner!r} in state "
                    f"{in_state!r} both give {name!r} a flow",
                    advice="let one region own the variable",
                    loc=("regions", region, "states", state, "flows", name),
                    key=True,
                )
        return self

    @model_validator(mode="after")
    def _ranges_hold_models(self) -> Self:
        self.check_ranges()
        return self

    def _flows(self) -> list[tuple[str, str, str, FiniteText]]:
        return [
            (region, state, name, flow)
            for region, declared in self.regions.items()
            for state, content in declared.states.items()
            for name, flow in content.flows.items()
        ]

    def _check_variable(self, name: str, *loc: str | int) -> None:
        if name not in self.variables:
            raise DeclarationProblem(
                f"no variable {name!r}",
                advice=close_matches(name, self.variables),
                loc=loc,
                key=True,
            )
