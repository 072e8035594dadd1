"""Declaration of a chart: variables, and regions of states with flows and transitions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import ClassVar, Literal, Self

from pydantic import model_validator

from statechart.charts import transitions
from statechart.charts.flatten import FlatRegion, causes_of, flatten, timer_dimension
from statechart.charts.wrapping import STATE, check_wrapping, count_periods, wrap_checks
from statechart.documents import fields
from statechart.documents.declaration import TIME, Declaration
from statechart.documents.documented import declare
from statechart.documents.quantities import Quantity
from statechart.errors import DeclarationProblem, Loc
from statechart.formulas.formula import parse


class State(transitions.BaseState):
    """A state of a region, with its flows and invariants."""

    OTHER_WORDS: ClassVar = {
        **transitions.BaseState.OTHER_WORDS,
        "sets": "entry: {u: 1}, with u among the variables; controls are of scenes",
        "invariant": "invariants: {NAME: RELATION}",
    }

    invariants: dict[fields.Label, fields.RelationText] = declare(
        "Named relations that hold as long as the state is active.",
        {"above ground": "x >= 0"},
        default={},
    )
    states: dict[fields.NameText, State] = declare(
        "States in it, of which one is active with it.",
        {"up": {"flows": {"x": "v"}}, "down": {}},
        default={},
    )
    regions: dict[fields.NameText, Region] = declare(
        "Regions in it, of each of which one state is active with it.",
        {"lamp": {"initial": "dark", "states": {"dark": {}, "lit": {}}}},
        default={},
    )


class Region(transitions.BaseRegion):
    """States of which exactly one is active, and the transitions between them."""

    states: dict[fields.NameText, State] = declare(
        "Name to state.", {"flight": {"flows": {"x": "v", "v": "-g"}}, "rest": {}}, min_length=1
    )


# Hints read annotations of fields, which are text as long as they name a later class.
State.model_rebuild()


class Chart(Declaration):
    """A hybrid statechart without mechanics.

    Every region has exactly one active state. A variable follows the flow of the active state that
    declares one, and is constant otherwise. Formulas may use variables, parameters and `time`,
    initial values only parameters.
    """

    OTHER_WORDS: ClassVar = {
        **Declaration.OTHER_WORDS,
        "datamodel data locals state vars": "variables: {x: 0}",
        "controls inputs": "variables: {u: 0}, and entry: {u: 1} in states",
        "clocks timers": "variables: {c: 0} with flows: {c: 1}, or after: T",
        "equations initial_equation": "variables: {x: 0}, and flows of states",
        "events": "a transition; its name is an event that other regions hear",
        "initial locations modes states transitions": (
            "regions: {NAME: {initial: ..., states: ...}}"
        ),
    }

    kind: Literal["chart"] = declare("Kind of the document.", "chart", default="chart")
    variables: dict[fields.ValueName, fields.FiniteConstantText] = declare(
        "Variable to its initial value.", {"x": "height", "v": 0}, unit="that of each", default={}
    )
    regions: dict[fields.NameText, Region] = declare(
        "Name to region: all are active at once.",
        {"ball": {"initial": "flight", "states": {"flight": {}, "rest": {}}}},
        min_length=1,
    )

    @property
    def expanded(self) -> Self:
        """The chart with the regions that count periods (`statechart.charts.wrapping`)."""
        chart, counts = count_periods(self)
        if not counts:
            return self
        own = {name: getattr(chart, name) for name in type(self).model_fields}
        variables = {count.variable: count.initial for count in counts.values()}
        regions = {
            name: Region(initial=STATE, states={STATE: State()}, transitions=count.transitions)
            for name, count in counts.items()
        }
        own["variables"] = {**chart.variables, **variables}
        return self.model_construct(**{**own, "regions": {**regions, **chart.regions}})

    @cached_property
    def flat(self) -> Mapping[str, FlatRegion]:
        """The flattened regions."""
        return {name: flatten(name, r, "regions", name) for name, r in self.regions.items()}

    @cached_property
    def switching(self) -> bool:
        """True if flows are nonsmooth: abs, sign, min, max or sat of a variable."""
        changing = {TIME, *self.variables}
        return any(fields.has_switch(flow, changing) for _, flow, _ in self._flows())

    @property
    def timers(self) -> frozenset[str]:
        """Clocks and counters of timed transitions; they are variables that nobody declared."""
        return frozenset(self.clocks)

    @property
    def clocks(self) -> tuple[str, ...]:
        """The `timers` in order; one of a chart that has no variables: engines need a state."""
        found = tuple(timer for region in self.flat.values() for timer in region.timers)
        return found or (() if self.variables else (f"{next(iter(self.regions))}.clock",))

    def stated(self, name: str) -> Quantity:
        """Return the quantity of a name, including clocks and counters."""
        dimension = timer_dimension(self.flat.values(), name)
        return Quantity(name, dimension) if dimension else super().stated(name)

    def value_checks(self) -> Iterator[fields.ValueCheck]:
        """Yield the checks of parameters, initial values and periods of transitions."""
        yield from super().value_checks()
        yield from wrap_checks(self)
        yield from transitions.period_checks(self.regions)
        for name, text in self.variables.items():
            yield fields.finite_check(text, "variables", name)

    @model_validator(mode="after")
    def _variables_have_values(self) -> Self:
        for name in self.variables:
            taken = "the time of the run" if name == TIME else "a parameter, {see}"
            if name == TIME or name in self.parameters:
                raise DeclarationProblem(
                    f"{name!r} is {taken}",
                    advice="choose another name",
                    key=("variables", name),
                    see=() if name == TIME else ("parameters", name),
                )
        check_wrapping(self)
        transitions.check_periods(self.regions, self.parameters, self.variables)
        self.check_values(self.values())
        return self

    @model_validator(mode="after")
    def _formulas_use_declared_names(self) -> Self:
        names = {TIME, *self.parameters, *self.variables}
        for region, declared in self.regions.items():
            transitions.check_changes(
                declared, "regions", region, variables=self.variables, known=names
            )
        for _, flow, loc in self._flows():
            changing = {TIME, *self.variables}
            fields.check_derived(parse(flow).root, changing, loc, order=1)
        whole = self.expanded
        states = {name: region.named for name, region in whole.flat.items()}
        changing = {TIME, *(name for name, _, _ in self._flows())}
        for state, at in self._states():
            for label, relation in state.invariants.items():
                fields.check_relation(relation, names, states, changing, *at, "invariants", label)
        for region, declared in self.regions.items():
            for transition, at in transitions.declared_transitions(declared, "regions", region):
                if transition.guard is not None:
                    fields.check_relation(transition.guard, names, states, changing, *at, "guard")
        causes = causes_of(whole.flat)
        for name, declared in self.regions.items():
            own = list(transitions.declared_transitions(declared, "regions", name))
            transitions.check_listening(name, own, causes, states, alone=("zeno",))
        further = self.timers | whole.variables.keys()
        self.check_uses(names | further, states, causes, changing)
        return self

    @model_validator(mode="after")
    def _regions_do_not_contradict(self) -> Self:
        # States of different regions can be active together.
        owners: dict[str, Loc] = {}
        for name, _, loc in self._flows():
            owner = owners.setdefault(name, loc)
            if owner[1] != loc[1]:
                message = (
                    f"region {loc[1]!r} in state {loc[-3]!r} and region {owner[1]!r} in state "
                    f"{owner[-3]!r} both give {name!r} a flow, the other as {{see}}"
                )
                advice = "let one region own the variable"
                raise DeclarationProblem(message, advice=advice, key=loc, see=owner)
        for region, flat in self.flat.items():
            if shared := flat.shared("flows"):
                name, one, other = shared
                raise DeclarationProblem(
                    f"{one!r} and {other!r}, which may be active together, both give {name!r} a "
                    "flow",
                    advice="let one region own the variable",
                    key=("regions", region),
                )
        return self

    @model_validator(mode="after")
    def _ranges_hold_models(self) -> Self:
        self.check_ranges()
        return self

    def _states(self) -> Iterator[tuple[State, Loc]]:
        for name, region in self.regions.items():
            for _, state, at in transitions.nested(region, "regions", name):
                if isinstance(state, State):
                    yield state, at

    def _flows(self) -> Iterator[tuple[str, fields.FiniteText, Loc]]:
        for state, at in self._states():
            for name, flow in state.flows.items():
                yield name, flow, (*at, "flows", name)
