"""Automaton of a chart: regions from flows and guards, resets from updates, Zeno transitions.

A self-transition that changes nothing would fire for ever. It is the limit of shrinking jumps: the
transition ``on: zeno`` of the state replaces it if there is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property, partial
from pathlib import Path

import numpy as np
import sympy as sp
from pydantic import ValidationError

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton, Component, Places
from statechart.automaton.clock import Clock, between
from statechart.automaton.components import Data, compose_components, split
from statechart.automaton.constraints import NO_CONSTRAINTS, Constraints
from statechart.automaton.laws import HELD, Flow, Instant, Setup, flow_sizes, moving_mode, roles_in
from statechart.automaton.margin_derivatives import MarginDerivatives, tape_with_sizes
from statechart.automaton.regions import Invariant, Region, State, active_in, stop_conditions
from statechart.automaton.switches import explicit_rates
from statechart.automaton.trace import Arc, Jump, Key, Role, Roles
from statechart.charts.chart import Chart
from statechart.charts.chart import State as DeclaredState
from statechart.charts.flatten import FlatRegion, FlatTransition, Updates
from statechart.charts.guard_watch import (
    EventQueues,
    Guard,
    GuardTruths,
    GuardWatch,
    check_updated,
    guard_claims,
    guard_margins,
    guards,
    guards_at_events,
    restart_periods,
    transition_outcomes,
    values_after,
)
from statechart.charts.transitions import period_checks
from statechart.charts.wrapping import wrap_checks
from statechart.documents.declaration import TIME
from statechart.documents.fields import FiniteText, check_all
from statechart.errors import DeclarationProblem, NonFinite, StatechartError, Unsupported, Zeno
from statechart.formulas.formula import parse
from statechart.formulas.parameters import Parameters
from statechart.formulas.tape import Tape


def automaton(chart: Chart) -> Automaton:
    """Compose the automaton of a chart; modes are built when a run enters them."""
    declared, chart = chart, chart.expanded
    symbols = _Symbols(chart, declared)
    regions = tuple(_region(name, region, symbols) for name, region in chart.flat.items())
    whole = chart is declared and not chart.switching
    return Automaton(
        name=chart.name,
        declaration=declared,
        names=tuple(symbols.variables),
        variables=tuple(symbols.variables.values()),
        parameter_names=symbols.parameters.names,
        parameters=symbols.parameters.ordered,
        time=symbols.time,
        unknowns=tuple(symbols.rates.values()),
        rates=tuple(symbols.rates.values()),
        equations=(),
        regions=regions,
        stops=stop_conditions(chart.stop.conditions, symbols.known),
        observables=symbols.known,
        setup=symbols.setup,
        laws=ChartLaws(chart, symbols, regions),
        idle=True,
        switching=chart.switching,
        components=cache(partial(components, chart, automaton)) if whole else tuple,
    )


class _Symbols:
    """Symbols with neutral names, since SymPy interprets names such as I or beta."""

    def __init__(self, chart: Chart, declared: Chart) -> None:
        self.chart, self.declared, timers = chart, declared, chart.clocks
        self.period_checks = (*wrap_checks(declared), *period_checks(declared.regions))
        starts = {**chart.variables, **dict.fromkeys(timers, 0)}
        self.variables = {name: sp.Symbol(f"v{i}", real=True) for i, name in enumerate(starts)}
        self.rates = {name: sp.Symbol(f"r{i}", real=True) for i, name in enumerate(starts)}
        self.timers = tuple(self.variables[timer] for timer in timers)
        self.time = sp.Symbol("t", real=True)
        self.parameters = Parameters(
            chart.parameters,
            lambda known: {},
            lambda known: [parse(text).to_sympy(known) for text in starts.values()],
        )
        symbols = {**self.variables, **self.parameters.symbols}
        self.known: Mapping[str, sp.Symbol] = {**symbols, TIME: self.time}
        self.flow = cache(lambda text: parse(text).to_sympy(self.known))

    def setup(self, overrides: Mapping[str, float], relative: float) -> Setup:
        """Evaluate parameters and the initial state; check that periods and start are finite."""
        values, initial = self.parameters.values(overrides)
        if overrides:
            check_all(self.period_checks, self.declared.values(overrides))
        for name, value in zip(self.variables, initial, strict=True):
            if not np.isfinite(value):
                message = f"the initial value of {name!r} is not finite"
                raise DeclarationProblem(message, loc=("variables", name))
        return Setup(values, initial, {"plain": 0.0}, math.sqrt(relative))


def _region(name: str, flat: FlatRegion, symbols: _Symbols) -> Region:
    @cache
    def state(state: str) -> State:
        if state == HELD:
            return State()
        rates = (symbols.rates[v] - symbols.flow(flow) for v, flow in flat.flows(state).items())
        contents = (c for c in flat.states[state] if isinstance(c, DeclaredState))
        named = (pair for content in contents for pair in content.invariants.items())
        invariants = (Invariant(f"{name}.{label}", text, symbols.known) for label, text in named)
        return State(tuple(rates), guard_margins(flat, state, symbols.known), tuple(invariants))

    def build(role: Role) -> State:
        return state(role.state)

    own = flat.ordered, build, flat.edges, flat.superstates
    return Region(name, *own, nesting=flat.nesting, claims=partial(guard_claims, flat))


class ChartLaws:
    """The laws of a chart (see `statechart.automaton.laws.Laws`)."""

    # Transitions of charts are not compiled.
    compiled_laws = None

    def __init__(self, chart: Chart, symbols: _Symbols, regions: Sequence[Region]) -> None:
        self._symbols = symbols
        self._regions = tuple(chart.regions)
        self._flat = chart.flat
        self._watches: dict[Roles, GuardWatch] = {}
        self._event_guards = cache(self._guards_at_events)
        self._condition = cache(lambda guard: guard.relation.condition(symbols.known))
        self._leaving = cache(self._guards_and_rates)
        self._updates: dict[tuple[tuple[tuple[str, FiniteText], ...], ...], Tape] = {}
        self._derivatives = MarginDerivatives(
            tuple(symbols.variables.values()), symbols.parameters.ordered, symbols.time
        )
        self._considered = tuple(map(transition_outcomes, regions))
        self._queues = EventQueues(regions, chart.flat)
        self._active = partial(active_in, regions)

    @cached_property
    def _zeno(self) -> tuple[Mapping[str, FlatTransition], ...]:
        return tuple(
            {t.source: t for t in reversed(region.transitions) if t.on_zeno}
            for region in self._flat.values()
        )

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the initial flow and state after the entry updates."""
        key = tuple(region.initial for region in self._flat.values())
        state, sizes = setup.initial, np.abs(setup.initial)
        for name, region in self._flat.items():
            state, sizes = self._updated(setup, Clock(), name, region.begins, state, sizes)
        flow = Flow(key, roles_in(key), terms=state[:, None])
        return self._with_tolerances(setup, Clock(), flow, state), state

    def jump(self, at: Instant) -> tuple[Jump | None, Flow] | None:
        """Take the first transition that is due (`statechart.charts.guard_watch`).

        If none is, the flow may go on with other certifying atoms.
        """
        setup, clock, _, flow, state, fired = at
        pending = flow.pending
        if fired == ("zeno",):
            name = min(flow.held, key=lambda name: between(clock, flow.held[name]))
            place = self._regions.index(name)
            taken = self._zeno[place][flow.mode[place]]
        else:
            watch = self._watch(setup, flow)
            sizes = flow_sizes(setup, flow, state)
            active = self._active(flow.mode)

            def holding() -> Collection[tuple[int, int]]:
                conditions = self._event_guards(flow.mode)
                found = conditions.at(setup, state, sizes, clock.high)
                return conditions.holding(found, setup.precision, active)

            truths = GuardTruths(watch, at, state, sizes, self._derivatives, active)
            firing = self._queues.first(flow.mode, pending, truths.due(), holding)
            if firing is None:
                return truths.continued()
            place, taken, pending, _ = firing
        name = self._regions[place]
        sizes = flow_sizes(setup, flow, state)
        after, summed = self._updated(setup, clock, taken.name, taken.blocks, state, sizes)
        if taken.source == taken.target and (after == state).all():
            limit = self._zeno[place].get(taken.source)
            if limit is not None:
                taken = limit
                after, summed = self._updated(setup, clock, taken.name, taken.blocks, state, sizes)
        target = (*flow.mode[:place], taken.target, *flow.mode[place + 1 :])
        considered = self._considered[place](taken)
        path = () if taken.guard is not None or taken.on_zeno else (taken.trigger,)
        jump = at.jump(name, taken.name, target, after, path=path, considered=considered)
        held = {region: end for region, end in flow.held.items() if region != name}
        states = zip(self._regions, target, strict=True)
        roles = tuple(Role(HELD if region in held else now) for region, now in states)
        pending = self._queues.pending_after(pending, jump)
        following = flow._replace(
            mode=target, roles=roles, held=held, summed=summed, pending=pending, signs=()
        )
        return jump, self._with_tolerances(setup, clock, following, after)

    def change(self, at: Instant, before: Setup) -> tuple[Jump | None, Flow]:
        """Return the flow at a change of parameters, which moves no constraints."""

        def updated(setup: Setup, name: str, blocks: tuple[Updates, ...], state: Array) -> Array:
            return self._updated(setup, at.clock, name, blocks, state, np.abs(state))[0]

        start = restart_periods(self._flat, updated, (before, at.setup), at.state)
        return None, at.flow._replace(start=start)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Hold the region until the accumulation point if it has a transition `on: zeno`."""
        jump = jumps[-1]
        place = self._regions.index(jump.region)
        edge = (jump.cause, jump.source[place], jump.target[place])
        transitions = self._flat[jump.region].transitions
        waiting = (t for t in transitions if t.guard is None and not t.on_zeno)
        if any((t.name, t.source, t.target) == edge for t in waiting):
            return None  # the events that it waits for accumulate in their own region
        if jump.target[place] not in self._zeno[place]:
            if any(past.target[place] in self._zeno[place] for past in jumps):
                return None  # the jumps into that state accumulate too
            what = f"'{jump.cause}' accumulates at t = {clock.later(rest).high:.6g}"
            advice = f"declare a transition 'on: zeno' from '{jump.target[place]}'"
            raise Zeno(f"{jump.region}: {what}; {advice}")
        return replace(jump, skipped=rest), flow._replace(
            roles=(*flow.roles[:place], Role(HELD), *flow.roles[place + 1 :]),
            held={**flow.held, jump.region: clock.later(rest)},
        )

    def constraints(self, setup: Setup, roles: Roles, start: float, anchor: Array) -> Constraints:
        """Return no constraints."""
        return NO_CONSTRAINTS

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> None:
        """Return None: every mode of a chart is feasible."""

    def remarks(self, setup: Setup, arcs: Sequence[Arc]) -> tuple[str, ...]:
        """Return no remarks."""
        return ()

    def _with_tolerances(self, setup: Setup, clock: Clock, flow: Flow, state: Array) -> Flow:
        watch = self._watch(setup, flow)
        sizes = flow_sizes(setup, flow, state)
        if flow.sizes is not None:
            # The round-off of the time moves a variable away from zero.
            sizes = np.maximum(sizes, flow.sizes)
        rows = watch.at(setup, state, sizes, clock.high)
        if (name := watch.valueless(rows)) is not None:
            raise NonFinite(f"the guard of {name} has no value")
        return flow._replace(tolerances=watch.tolerances(rows, setup.precision))

    def _watch(self, setup: Setup, flow: Flow) -> GuardWatch:
        """Return the guards of a mode; held regions have none."""
        roles = flow.moving
        if roles not in self._watches:
            watched: list[Guard] = []
            rates: dict[sp.Symbol, sp.Expr] = {}
            for place, state in enumerate(moving_mode(roles)):
                if state != HELD:
                    guards_out, flows = self._leaving(place, state)
                    watched += guards_out
                    rates |= flows
            if flow.signs and setup.modes is not None:
                variables = self._symbols.variables.values()
                own = zip(variables, explicit_rates(setup.modes(roles)), strict=True)
                rates = {v: rate for v, rate in own if v in rates}
            self._watches[roles] = self._watched(watched, rates)
        return self._watches[roles]

    def _guards_at_events(self, mode: Key) -> GuardWatch:
        regions = enumerate(zip(self._flat.values(), mode, strict=True))
        found = [g for k, (region, state) in regions for g in guards_at_events(k, region, state)]
        return self._watched(found, {})

    def _watched(self, guards: Sequence[Guard], rates: Mapping[sp.Symbol, sp.Expr]) -> GuardWatch:
        symbols = self._symbols
        return GuardWatch(
            guards, self._condition, rates, inputs=tuple(symbols.variables.values()),
            parameters=symbols.parameters.ordered, time=symbols.time, timers=symbols.timers,
        )  # fmt: skip

    def _guards_and_rates(
        self, place: int, state: str
    ) -> tuple[list[Guard], dict[sp.Symbol, sp.Expr]]:
        region = self._flat[self._regions[place]]
        symbols, flows = self._symbols, region.flows(state)
        rates = {symbols.variables[name]: symbols.flow(text) for name, text in flows.items()}
        return guards(place, region, state), rates

    def _updated(
        self,
        setup: Setup,
        clock: Clock,
        cause: str,
        blocks: tuple[Updates, ...],
        state: Array,
        sizes: Array,
    ) -> tuple[Array, Array]:
        """Return the state after updates, and the sizes of its terms."""
        if not blocks:
            return state, sizes
        key = tuple(tuple(block.items()) for block in blocks)
        tape = self._updates.get(key)
        if tape is None:
            symbols = self._symbols
            values = tuple(values_after(blocks, symbols.variables, symbols.known))
            own = tuple(symbols.variables.values()), symbols.parameters.ordered, symbols.time
            tape = self._updates[key] = tape_with_sizes(values, *own)
        found = tape.values(np.concatenate([state, sizes]), setup.values, clock.high)
        after, summed = found[: len(state)], found[len(state) :]
        check_updated(cause, self._symbols.variables, after)
        return after, np.where(np.isfinite(summed), summed, np.abs(after))


def components(chart: Chart, compose: Callable[[Chart], Automaton]) -> tuple[Component, ...]:
    """Return the independent components of a chart; none if it is connected."""
    data = chart.model_dump(by_alias=True, exclude_unset=True)
    schema = Path(__file__).with_name("schema.json")
    parts = split(data, ("variables", "regions"), ("regions",), schema)

    def composed(part: Data) -> Automaton:
        declared = Chart.model_validate(part)
        if not (declared.variables or any(region.timers for region in declared.flat.values())):
            raise Unsupported("a part without variables has no automaton of its own")
        return compose(declared)

    def form(part: Data) -> Data:
        return {**part, "variables": list(part.get("variables", ()))}

    try:
        return compose_components(parts, form, composed, lambda _: _restricted)
    except (StatechartError, ValidationError):
        return ()


def _restricted(whole: Setup, places: Places) -> Setup:
    values, initial = whole.values[places.parameters], whole.initial[places.variables]
    return replace(whole, values=values, initial=initial, modes=None)
