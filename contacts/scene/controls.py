"""Controllers: declared regions of a scene whose states set controls."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from typing import ClassVar, TypeVar

from pydantic import PrivateAttr

from contacts.scene.parts import used_names
from statechart.charts.flatten import FlatRegion, flatten
from statechart.charts.transitions import BaseRegion, BaseState, check_changes, nested
from statechart.charts.wrapping import STATE, Count
from statechart.documents.documented import declare
from statechart.documents.fields import (
    FiniteConstantText,
    FiniteText,
    FormulaText,
    NameText,
    ValueName,
    check_names,
    replace_fields,
)
from statechart.errors import DeclarationProblem, Loc, close_matches
from statechart.formulas.formula import Formula, parse

Value = TypeVar("Value")


class ControlState(BaseState):
    """One state of a controller, and the controls that it sets."""

    OTHER_WORDS: ClassVar = {
        **BaseState.OTHER_WORDS,
        "set controls control outputs output": "sets: {CONTROL: FORMULA}",
    }

    sets: dict[str, FormulaText] = declare(
        "Values of controls while the state is active; inner states may override them.",
        {"torque": "-k*leg.angle"},
        unit="that of the control",
        default={},
    )
    states: dict[NameText, ControlState] = declare(
        "States in it, of which one is active with it.",
        {"push": {"sets": {"torque": 1}}, "pull": {"sets": {"torque": -1}}},
        default={},
    )
    regions: dict[NameText, ControlRegion] = declare(
        "Regions in it, of each of which one state is active with it.",
        {"grip": {"initial": "open", "states": {"open": {}, "shut": {}}}},
        default={},
    )


class ControlRegion(BaseRegion):
    """States of which exactly one is active, and the transitions between them."""

    states: dict[NameText, ControlState] = declare(
        "Name to state.", {"hold": {}, "thrust": {"sets": {"push": 20}}}, min_length=1
    )


# Hints read annotations of fields, which are text as long as they name a later class.
ControlState.model_rebuild()


class Controller(ControlRegion):
    """A region of the scene beside its contacts: forces and coefficients jump with its state."""

    variables: dict[ValueName, FiniteConstantText] = declare(
        "Variables of the controller and their initial values.",
        {"seen": 0},
        unit="that of each",
        default={},
    )
    _count: Count | None = PrivateAttr(None)

    @property
    def count(self) -> Count | None:
        """The count of periods, or None."""
        return self._count

    @classmethod
    def counting(cls, count: Count) -> Controller:
        """Return the region that counts the periods of time in a formula."""
        states = {STATE: ControlState()}
        controller = cls(initial=STATE, states=states, transitions=count.transitions)
        controller._count = count
        # The name has a dot, which no declared variable has.
        return replace_fields(controller, variables={count.variable: count.initial})


@dataclass(frozen=True)
class Controls:
    """Controls of a scene, and the controllers that set them."""

    declared: Mapping[str, FormulaText]  # Control -> its value where no state sets it
    regions: Mapping[str, Controller]  # Name -> controller

    @cached_property
    def flat(self) -> Mapping[str, FlatRegion]:
        """The controllers as flat regions for the executor."""
        return {name: flatten(name, r, "regions", name) for name, r in self.regions.items()}

    @cached_property
    def owners(self) -> Mapping[str, str]:
        """Control -> the region whose states set it."""
        return {control: region for region, _, control, _, _ in self.sets()}

    @cached_property
    def order(self) -> tuple[str, ...]:
        """Controls in order of dependence.

        Raises `CycleError` if they depend on each other in a circle.
        """
        used = {control: used_names(self.texts(control)) for control in self.declared}
        uses = {control: [c for c in used if c in names] for control, names in used.items()}
        return tuple(TopologicalSorter(uses).static_order())

    @cached_property
    def controller_state(self) -> Mapping[str, FiniteText]:
        """Variables of regions and timers of transitions -> initial value."""
        values: dict[str, FiniteText] = {}
        for name, region in self.regions.items():
            values |= {**region.variables, **dict.fromkeys(self.flat[name].timers, 0)}
        return values

    @property
    def clocks(self) -> tuple[str, ...]:
        """Variables of `controller_state` that store instants of time."""
        return tuple(clock for region in self.flat.values() for clock in region.clocks)

    @property
    def timers(self) -> tuple[str, ...]:
        """Variables of `controller_state` that are timers of transitions."""
        return tuple(timer for region in self.flat.values() for timer in region.timers)

    @cached_property
    def flowing(self) -> Mapping[str, str]:
        """Variable of a region that some of its states let flow -> the region."""
        declared = self.declared_flows()
        return {v: region for region, v, _, _ in declared if v in self.regions[region].variables}

    def flows(self, region: str, state: str) -> dict[str, FiniteText]:
        """Return the flows of the variables of a region in one of its states."""
        flows = self.flat[region].flows(state)
        return {v: flows.get(v, 0) for v, owner in self.flowing.items() if owner == region}

    def states(self, region: str) -> Iterator[tuple[ControlState, Loc]]:
        """Yield the states of a region, nested ones included, and their places."""
        for _, state, at in nested(self.regions[region], "regions", region):
            if isinstance(state, ControlState):
                yield state, at

    @property
    def initial(self) -> Mapping[str, str]:
        """Region -> the state that it starts in."""
        return {name: region.initial for name, region in self.flat.items()}

    def values(self, region: str, state: str) -> dict[str, FormulaText]:
        """Return the values of a region's controls in one of its states, in their order."""
        sets: dict[str, FormulaText] = {}
        for content in self.flat[region].states[state]:
            sets |= content.sets if isinstance(content, ControlState) else {}
        own = (control for control in self.order if self.owners[control] == region)
        return {control: sets.get(control, self.declared[control]) for control in own}

    def region_of(self, text: FormulaText | None) -> str | None:
        """Return the region that sets the controls in a coefficient; None if there is none."""
        names = () if text is None else parse(text).names
        return next((region for control, region in self.owners.items() if control in names), None)

    def values_by_state(
        self,
        text: FormulaText,
        known: Mapping[str, Value],
        value: Callable[[Formula, Mapping[str, Value]], Value],
    ) -> Iterator[tuple[str, Mapping[str, Value]]]:
        """Yield the states of the region that sets a coefficient, and the values there."""
        region = self.region_of(text)
        if region is None:
            yield "", known
            return
        for state in self.flat[region].states:
            sets = self.values(region, state)
            used = parse(text).names.intersection(sets)
            yield state, {**known, **{name: value(parse(sets[name]), known) for name in used}}

    def check(self, known: Collection[str]) -> None:
        """Check that each control is set by one region, by formulas over `known` and controls."""
        owners: dict[str, tuple[str, str, Loc]] = {}
        names = {*known, *self.declared}
        for control, text in self.declared.items():
            check_names(parse(text), names, "controls", control)
        for region, state, control, text, loc in self.sets():
            if control not in self.declared:
                raise DeclarationProblem(
                    f"no control {control!r}",
                    advice=close_matches(control, self.declared)
                    if self.declared
                    else f"declare it: controls: {{{control}: 0}}",
                    key=loc,
                )
            check_names(parse(text), names, *loc)
            owner, in_state, first_loc = owners.setdefault(control, (region, state, loc))
            if owner != region:
                raise DeclarationProblem(
                    f"region {region!r} in state {state!r} and region {owner!r} in state "
                    f"{in_state!r} both set {control!r}, the other as {{see}}",
                    advice="let one region set it; give the other a control of its own",
                    key=loc,
                    see=first_loc,
                )
        for region, flat in self.flat.items():
            for verb, section in (("set", "sets"), ("give a flow to", "flows")):
                if shared := flat.shared(section):
                    name, one, other = shared
                    raise DeclarationProblem(
                        f"{one!r} and {other!r}, which may be active together, both {verb} "
                        f"{name!r}",
                        advice="let one of their regions do it",
                        key=("regions", region),
                    )
        for control in (name for name in self.declared if name not in owners):
            raise DeclarationProblem(
                f"no state sets {control!r}",
                advice="set it in a state of a region; else write its formula where it is used",
                key=("controls", control),
            )
        try:
            _ = self.order
        except CycleError as error:
            circle = " -> ".join(reversed(error.args[1]))
            raise DeclarationProblem(
                f"controls depend on each other in a circle: {circle}",
                key=("controls", error.args[1][0]),
            ) from None

    def check_controller_state(self, known: Collection[str]) -> None:
        """Check that regions change variables of their own, by formulas over `known`."""
        for name, region in self.regions.items():
            check_changes(
                region, "regions", name,
                variables=region.variables, known=known, controls=self.declared,
                of=f" of region {name!r}",
            )  # fmt: skip

    def check_coefficient(
        self, text: FormulaText, parameters: Collection[str], *loc: str | int
    ) -> None:
        """Check that a coefficient of a contact is constant in every state of one region."""
        # A control that no state sets is refused by `check`.
        names = parse(text).names
        used = [control for control in self.owners if control in names]
        regions = list(dict.fromkeys(self.owners[control] for control in used))
        if len(regions) > 1:
            raise DeclarationProblem(
                f"regions {' and '.join(map(repr, regions))} both set what it depends on "
                f"({', '.join(used)})",
                advice="let one region set it",
                loc=loc,
            )
        for control in used:
            if varying := used_names(self.texts(control)).difference(parameters):
                raise DeclarationProblem(
                    f"{control!r} depends on {', '.join(map(repr, sorted(varying)))}: a "
                    "coefficient of a contact is constant as long as a state lasts",
                    advice=f"set {control!r} to formulas of parameters only",
                    loc=loc,
                )

    def texts(self, control: str) -> list[FormulaText]:
        """Return all formulas that set a control."""
        return [self.declared[control], *self._set_texts.get(control, ())]

    @cached_property
    def _set_texts(self) -> Mapping[str, list[FormulaText]]:
        texts: dict[str, list[FormulaText]] = {}
        for _, _, control, text, _ in self.sets():
            texts.setdefault(control, []).append(text)
        return texts

    def sets(self) -> Iterator[tuple[str, str, str, FormulaText, Loc]]:
        """Yield region, state, control, value and its place for every control that a state sets."""
        for region in self.regions:
            for state, at in self.states(region):
                for control, text in state.sets.items():
                    yield region, str(at[-1]), control, text, (*at, "sets", control)

    def declared_flows(self) -> Iterator[tuple[str, str, FiniteText, Loc]]:
        """Yield region, variable, flow and its place for every flow of a state."""
        for region in self.regions:
            for state, at in self.states(region):
                for variable, text in state.flows.items():
                    yield region, variable, text, (*at, "flows", variable)
