"""A plain chart on the executor: regions from flows and guards, updates, Zeno transitions.

When transitions fire: see `statechart.charts.firing`. A transition that leads back to its own state
and changes nothing would fire for ever; it is the limit of shrinking jumps, and the state's
transition
``on: zeno``, if it has one, takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.constraints import NO_CONSTRAINTS, Constraints
from statechart.automaton.course import Courses
from statechart.automaton.laws import HELD, Flow, Instant, Setup, moving_mode, roles_in
from statechart.automaton.regions import Edge, Margin, Region, State, stop_margins
from statechart.automaton.trace import Clock, Jump, Role, Roles, between
from statechart.charts.chart import Chart, Transition
from statechart.charts.chart import Region as DeclaredRegion
from statechart.charts.firing import (
    Guard,
    GuardWatch,
    Listening,
    considered,
    guard_margins,
    guards,
    size_of,
)
from statechart.documents.declaration import TIME
from statechart.errors import DeclarationProblem, NonFinite, Zeno
from statechart.formulas.formula import parse, parse_relation
from statechart.formulas.parameters import Parameters
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape

# A value summed from terms is off by a few units in the last place of the largest of them.
_ROUNDING = 64.0 * float(np.finfo(float).eps)


def automaton(chart: Chart) -> Automaton:
    """Compose the automaton of a chart; modes are built when a run enters them.

    Parameters
    ----------
    chart : Chart
        As declared.

    Returns
    -------
    Automaton
        The unknowns are one rate for each variable; a rate that no state sets is zero.
    """
    symbols = _Symbols(chart)
    regions = tuple(_region(name, region, symbols) for name, region in chart.regions.items())
    return Automaton(
        name=chart.name,
        declaration=chart,
        names=tuple(chart.variables),
        variables=tuple(symbols.variables.values()),
        parameter_names=symbols.parameters.names,
        parameters=symbols.parameters.ordered,
        time=symbols.time,
        unknowns=tuple(symbols.rates.values()),
        rates=tuple(symbols.rates.values()),
        equations=(),
        regions=regions,
        stops=stop_margins(chart.stop.conditions, symbols.known),
        observables=symbols.known,
        setup=symbols.setup,
        laws=ChartLaws(chart, symbols, regions),
        idle=True,
    )


class _Symbols:
    """Neutral symbols of a chart: SymPy gives names such as I or beta a meaning of its own."""

    def __init__(self, chart: Chart) -> None:
        self.variables = {
            name: sp.Symbol(f"v{i}", real=True) for i, name in enumerate(chart.variables)
        }
        self.rates = {name: sp.Symbol(f"r{i}", real=True) for i, name in enumerate(chart.variables)}
        self.time = sp.Symbol("t", real=True)
        self.parameters = Parameters(
            chart.parameters,
            lambda known: {},
            lambda known: [parse(text).to_sympy(known) for text in chart.variables.values()],
        )
        self.known: Mapping[str, sp.Symbol] = {
            **self.variables,
            **self.parameters.symbols,
            TIME: self.time,
        }

    def setup(self, overrides: Mapping[str, float], relative: float) -> Setup:
        """Evaluate parameters and the initial state; guards get tolerances with every flow."""
        values, initial = self.parameters.values(overrides)
        for name, value in zip(self.variables, initial, strict=True):
            if not np.isfinite(value):
                raise DeclarationProblem(
                    f"the initial value of {name!r} is not finite", loc=("variables", name)
                )
        return Setup(values, initial, {"plain": 0.0}, math.sqrt(relative))


def _region(name: str, declared: DeclaredRegion, symbols: _Symbols) -> Region:
    def build(role: Role) -> State:
        if role.state == HELD:
            return State()
        content = declared.states[role.state]
        return State(
            tuple(
                symbols.rates[variable] - parse(flow).to_sympy(symbols.known)
                for variable, flow in content.flows.items()
            ),
            guard_margins(name, declared, role.state, symbols.known),
            tuple(
                Margin(f"{name}.{label}", -parse_relation(text).margin(symbols.known))
                for label, text in content.invariants.items()
            ),
        )

    return Region(name, declared.ordered, build, tuple(map(_edge, declared.transitions)))


def _edge(transition: Transition) -> Edge:
    waited = "jumps accumulate" if transition.on_zeno else f"on {transition.on}"
    return Edge(
        transition.name,
        transition.source,
        transition.target,
        transition.guard or waited,
        ", ".join(f"{name} := {update}" for name, update in transition.updates.items()),
        on_zeno=transition.on_zeno,
    )


class ChartLaws:
    """The laws of a chart (see `statechart.automaton.laws.Laws`).

    Parameters
    ----------
    chart : Chart
        As declared.
    symbols : _Symbols
        Its variables, parameters and time.
    regions : sequence of Region
        Its regions, composed.
    """

    # What its transitions say is not compiled.
    ordinary = None

    def __init__(self, chart: Chart, symbols: _Symbols, regions: Sequence[Region]) -> None:
        self._chart = chart
        self._symbols = symbols
        self._regions = tuple(chart.regions)
        self._watches: dict[Roles, GuardWatch] = {}
        self._updates: dict[tuple[int, int], Tape] = {}
        self._courses = Courses(
            tuple(symbols.variables.values()),
            symbols.parameters.ordered,
            symbols.time,
        )
        self._considered = tuple(map(considered, regions))
        self._listening = Listening(regions, chart.regions)

    @cached_property
    def _zeno(self) -> tuple[Mapping[str, int], ...]:
        """Per region: state -> place of its transition on: zeno; the first of several."""
        return tuple(
            {t.source: i for i, t in reversed(list(enumerate(region.transitions))) if t.on_zeno}
            for region in self._chart.regions.values()
        )

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the initial states; guards that are true there fire at once."""
        key = tuple(region.initial for region in self._chart.regions.values())
        flow = Flow(key, roles_in(key), terms=setup.initial[:, None])
        return self._with_tolerances(setup, Clock(), flow, setup.initial), setup.initial

    def jump(self, at: Instant) -> tuple[Jump, Flow] | None:
        """Take the first transition that is due; see the module for which are."""
        setup, clock, _, flow, state, fired = at
        pending = flow.pending
        if fired == ("zeno",):
            name = min(flow.held, key=lambda name: between(clock, flow.held[name]))
            place = self._regions.index(name)
            index = self._zeno[place][flow.mode[place]]
        else:
            watch = self._watch(flow.roles)
            sizes = _summed(flow, state)

            def later(guard: Guard) -> float:
                return self._courses.sign(
                    setup, flow.roles, guard.margin, state, sizes, clock.high, _ROUNDING
                )

            rows = watch.at(setup, state, sizes, clock.high)
            guarded = watch.due(rows, flow.tolerances, fired, _ROUNDING, later)
            firing = self._listening.first(self._regions, flow.mode, pending, guarded)
            if firing is None:
                return None
            place, index, pending = firing.place, firing.transition, firing.pending
        name = self._regions[place]
        transitions = self._chart.regions[name].transitions
        sizes = _summed(flow, state)
        after, summed = self._updated(setup, clock, place, index, state, sizes)
        if transitions[index].source == transitions[index].target and (after == state).all():
            limit = self._zeno[place].get(transitions[index].source)
            if limit is not None:
                index = limit
                after, summed = self._updated(setup, clock, place, limit, state, sizes)
        taken = transitions[index]
        target = (*flow.mode[:place], taken.target, *flow.mode[place + 1 :])
        considered = self._considered[place][index]
        jump = at.jump(name, taken.name, target, after, considered=considered)
        held = {region: end for region, end in flow.held.items() if region != name}
        following = flow._replace(
            mode=target,
            roles=tuple(
                Role(HELD if region in held else now)
                for region, now in zip(self._regions, target, strict=True)
            ),
            held=held,
            summed=summed,
            pending=self._listening.heard(pending, jump),
        )
        return jump, self._with_tolerances(setup, clock, following, after)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Hold the region until the accumulation, where it says what follows then."""
        jump = jumps[-1]
        place = self._regions.index(jump.region)
        edge = (jump.cause, jump.source[place], jump.target[place])
        waiting = [
            t
            for t in self._chart.regions[jump.region].transitions
            if t.guard is None and not t.on_zeno
        ]
        if any((t.name, t.source, t.target) == edge for t in waiting):
            return None  # what it waits for accumulates, and is recognised there
        if jump.target[place] not in self._zeno[place]:
            if any(past.target[place] in self._zeno[place] for past in jumps):
                return None  # its jumps accumulate as well, and are recognised there
            raise Zeno(
                f"{jump.region}: '{jump.cause}' accumulates at "
                f"t = {clock.later(rest).high:.17g}; declare a transition 'on: zeno' "
                f"from '{jump.target[place]}'"
            )
        return replace(jump, skipped=rest), flow._replace(
            roles=(*flow.roles[:place], Role(HELD), *flow.roles[place + 1 :]),
            held={**flow.held, jump.region: clock.later(rest)},
        )

    def constraints(self, setup: Setup, roles: Roles, start: float, anchor: Array) -> Constraints:
        """Return nothing: a chart has no constraints."""
        return NO_CONSTRAINTS

    def feasibility(
        self, regions: Sequence[Region], setup: Setup, state: Array, time: float
    ) -> None:
        """Return None: every mode of a chart is possible somewhere."""

    def _with_tolerances(self, setup: Setup, clock: Clock, flow: Flow, state: Array) -> Flow:
        watch = self._watch(flow.roles)
        rows = watch.at(setup, state, _sizes(flow, state), clock.high)
        if np.isnan(rows[:, 0]).any():
            place = int(np.flatnonzero(np.isnan(rows[:, 0]))[0])
            raise NonFinite(f"the guard of {watch.guards[place].margin} has no value")
        return flow._replace(tolerances=watch.tolerances(rows, _ROUNDING))

    def _watch(self, roles: Roles) -> GuardWatch:
        """Return the guards of a mode; regions that are held have none."""
        if roles not in self._watches:
            known, variables = self._symbols.known, self._symbols.variables
            watched: list[Guard] = []
            rates: dict[sp.Symbol, sp.Expr] = {}
            for place, (state, (name, region)) in enumerate(
                zip(moving_mode(roles), self._chart.regions.items(), strict=True)
            ):
                if state == HELD:
                    continue
                for variable, text in region.states[state].flows.items():
                    rates[variables[variable]] = parse(text).to_sympy(known)
                watched += guards(place, name, region.transitions, state)
            self._watches[roles] = GuardWatch(
                watched,
                known,
                rates,
                inputs=tuple(variables.values()),
                parameters=self._symbols.parameters.ordered,
                time=self._symbols.time,
            )
        return self._watches[roles]

    def _updated(
        self, setup: Setup, clock: Clock, place: int, index: int, state: Array, sizes: Array
    ) -> tuple[Array, Array]:
        """Return the state after a transition, and the sizes of what it was summed from."""
        transition = self._chart.regions[self._regions[place]].transitions[index]
        if not transition.updates:
            return state, sizes
        tape = self._updates.get((place, index))
        if tape is None:
            known = self._symbols.known
            variables = tuple(self._symbols.variables.values())
            before = {v: sp.Symbol(f"size_{v}", real=True) for v in variables}
            values = [
                parse(transition.updates[name]).to_sympy(known)
                if name in transition.updates
                else symbol
                for name, symbol in self._symbols.variables.items()
            ]
            tape = self._updates[place, index] = compile_tape(
                [*values, *(size_of(value, before) for value in values)],
                variables=(*variables, *before.values()),
                parameters=self._symbols.parameters.ordered,
                time=self._symbols.time,
            )
        found = tape.values(np.concatenate([state, sizes]), setup.values, clock.high)
        after, summed = found[: len(state)], found[len(state) :]
        for name, value in zip(self._chart.variables, after, strict=True):
            if not np.isfinite(value):
                raise NonFinite(f"{transition.name} sets {name} to {value}")
        return after, np.where(np.isfinite(summed), summed, np.abs(after))


def _summed(flow: Flow, state: Array) -> Array:
    """Return the size of the terms that the state was summed from, or is itself."""
    sizes = flow.sizes if flow.summed is None else flow.summed
    return np.abs(state) if sizes is None else np.maximum(sizes, np.abs(state))


def _sizes(flow: Flow, state: Array) -> Array:
    """Return these sizes, or those before the jumps of this instant where they are larger.

    What is set to zero leaves it by what the time at hand can resolve.
    """
    sizes, found = flow.sizes, _summed(flow, state)
    return found if sizes is None else np.maximum(sizes, found)
