"""A plain chart on the executor: regions from flows and guards, and when transitions fire.

A transition fires at the instant its guard becomes true, and at once where its state is entered
with the guard true. On the guard's boundary, within the rounding of the state, the way the margin
goes in the entered state decides: a ball at x = 0 that rises does not bounce again on ``x <= 0``,
one that is about to fall does; where the margin stays at zero the relation itself decides, so that
``n >= 3`` fires at n = 3 and ``n > 3`` does not.

Transitions due at one instant are taken one after another, each judged by the state that those
before it left: regions in their order, in a region the first one declared. A transition that leads
back to its own state and changes nothing would fire for ever; it is the limit of shrinking jumps,
and the state's transition ``on: zeno``, if it has one, takes its place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from statechart.automaton import HELD, Automaton, Edge, Flow, Margin, Region, Setup, State
from statechart.chart import Chart, Transition
from statechart.chart import Region as DeclaredRegion
from statechart.declaration import TIME
from statechart.errors import DeclarationProblem, NonFinite, Zeno
from statechart.formula import Relation, parse, parse_relation
from statechart.parameters import Parameters
from statechart.tape import Tape, compile_tape
from statechart.trace import Clock, Jump, Key
from statechart.zeno import between

__all__ = ["ChartLaws", "automaton"]

Array = NDArray[np.float64]

# A value summed from terms is off by a few units in the last place of the largest of them.
_ROUNDING = 64.0 * float(np.finfo(float).eps)
# Terms that are all zero leave no rounding; a tolerance of zero would leave a margin that starts
# at zero and rises from there with slope zero undecided.
_UNDERFLOW = 1e-290


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
    return Automaton(
        name=chart.name,
        declaration=chart,
        names=tuple(chart.variables),
        variables=tuple(symbols.variables.values()),
        parameter_names=symbols.parameters.names,
        parameters=tuple(symbols.parameters.symbols.values()),
        time=symbols.time,
        unknowns=tuple(symbols.rates.values()),
        rates=tuple(symbols.rates.values()),
        equations=(),
        regions=tuple(_region(name, region, symbols) for name, region in chart.regions.items()),
        stops={
            label: Margin(label, parse_relation(text).margin(symbols.known))
            for label, text in chart.stop.conditions.items()
        },
        observables=symbols.known,
        laws=ChartLaws(chart, symbols),
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


def _region(name: str, declared: DeclaredRegion, symbols: _Symbols) -> Region:
    def build(state: str) -> State:
        if state == HELD:
            return State()
        content = declared.states[state]
        return State(
            tuple(
                symbols.rates[variable] - parse(flow).to_sympy(symbols.known)
                for variable, flow in content.flows.items()
            ),
            tuple(
                Margin(margin, relation.margin(symbols.known))
                for margin, relation, _ in _guards(name, declared, state)
            ),
            tuple(
                Margin(f"{name}.{label}", -parse_relation(text).margin(symbols.known))
                for label, text in content.invariants.items()
            ),
        )

    # The first state is where a region starts.
    states = sorted(declared.states, key=lambda state: state != declared.initial)
    return Region(name, tuple(states), build, tuple(map(_edge, declared.transitions)))


def _edge(transition: Transition) -> Edge:
    return Edge(
        transition.name,
        transition.source,
        transition.target,
        transition.guard or "jumps accumulate",
        ", ".join(f"{name} := {update}" for name, update in transition.updates.items()),
        on_zeno=transition.on == "zeno",
    )


def _guards(
    name: str, declared: DeclaredRegion, state: str
) -> list[tuple[str, Relation, Transition]]:
    """Return the guards out of `state`, with names for their margins that differ."""
    found = [
        (transition, parse_relation(transition.guard))
        for transition in declared.transitions
        if transition.source == state and transition.guard is not None
    ]
    names = [transition.name for transition, _ in found]
    return [
        (
            f"{name}.{transition.name}"
            + (f" to {transition.target}" if names.count(transition.name) > 1 else ""),
            relation,
            transition,
        )
        for transition, relation in found
    ]


@dataclass(frozen=True, eq=False)
class _Guard:
    """A guard of a mode: where it stands, and what it leads to."""

    place: int
    margin: str
    strict: bool
    transition: Transition


class _Watch:
    """The guards of one mode, evaluated together at an instant.

    Parameters
    ----------
    flow : Key
        The mode; regions that are held have no guards.
    """

    def __init__(self, chart: Chart, symbols: _Symbols, flow: Key) -> None:
        flows: dict[sp.Symbol, sp.Expr] = {}
        relations: list[Relation] = []
        guards: list[_Guard] = []
        for place, ((name, region), state) in enumerate(
            zip(chart.regions.items(), flow, strict=True)
        ):
            if state == HELD:
                continue
            for variable, text in region.states[state].flows.items():
                flows[symbols.variables[variable]] = parse(text).to_sympy(symbols.known)
            for margin, relation, transition in _guards(name, region, state):
                relations.append(relation)
                guards.append(_Guard(place, margin, relation.operator in "<>", transition))
        self.guards = tuple(guards)
        sizes = {v: sp.Symbol(f"size_{v}", real=True) for v in symbols.variables.values()}
        outputs: list[sp.Expr] = []
        for relation in relations:
            margin = relation.margin(symbols.known)
            first = _along(margin, flows, symbols.time)
            size = sum(
                (abs(_slope(margin, v)) * sizes[v] for v in sizes if v in margin.free_symbols),
                start=abs(relation.left.to_sympy(symbols.known))
                + abs(relation.right.to_sympy(symbols.known)),
            )
            outputs += [margin, first, _along(first, flows, symbols.time), size]
        self._tape = compile_tape(
            outputs,
            variables=(*symbols.variables.values(), *sizes.values()),
            parameters=tuple(symbols.parameters.symbols.values()),
            time=symbols.time,
        )

    def at(self, setup: Setup, state: Array, sizes: Array, time: float) -> Array:
        """Return (g, 4): margin, its first and second derivative in time, size of its terms."""
        found = self._tape.values(np.concatenate([state, sizes]), setup.values, time)
        return found.reshape(-1, 4)


def _slope(expression: sp.Expr, symbol: sp.Symbol) -> sp.Expr:
    """Differentiate; at the kinks of abs, sign, min and max by one side or their mean."""
    found = sp.diff(expression, symbol)
    return found.replace(sp.DiracDelta, lambda *_: sp.S.Zero).replace(
        sp.Heaviside, lambda x, *_: (1 + sp.sign(x)) / 2
    )


def _along(expression: sp.Expr, flows: Mapping[sp.Symbol, sp.Expr], time: sp.Symbol) -> sp.Expr:
    return sum(
        (_slope(expression, v) * flow for v, flow in flows.items() if v in expression.free_symbols),
        start=_slope(expression, time),
    )


class ChartLaws:
    """The laws of a chart (see `statechart.automaton.Laws`).

    Parameters
    ----------
    chart : Chart
        As declared.
    symbols : _Symbols
        Its variables, parameters and time.
    """

    def __init__(self, chart: Chart, symbols: _Symbols) -> None:
        self._chart = chart
        self._symbols = symbols
        self._regions = tuple(chart.regions)
        self._watches: dict[Key, _Watch] = {}
        self._updates: dict[int, Tape] = {}

    @cached_property
    def _zeno(self) -> tuple[Mapping[str, Transition], ...]:
        """Per region: state -> its transition on: zeno; the first declared of several."""
        return tuple(
            {t.source: t for t in reversed(region.transitions) if t.on == "zeno"}
            for region in self._chart.regions.values()
        )

    def setup(self, overrides: Mapping[str, float], relative: float) -> Setup:
        """Evaluate parameters and the initial state; guards get tolerances with every flow."""
        values, initial = self._symbols.parameters.values(overrides)
        for name, value in zip(self._chart.variables, initial, strict=True):
            if not np.isfinite(value):
                raise DeclarationProblem(
                    f"the initial value of {name!r} is not finite", loc=("variables", name)
                )
        return Setup(values, initial, {"plain": 0.0}, relative)

    def begin(self, setup: Setup) -> tuple[Flow, Array]:
        """Return the initial states; guards that are true there fire at once."""
        key = tuple(region.initial for region in self._chart.regions.values())
        flow = Flow(key, key, terms=setup.initial[:, None])
        return self._with_tolerances(setup, Clock(), flow, setup.initial), setup.initial

    def jump(
        self,
        setup: Setup,
        clock: Clock,
        j: int,
        flow: Flow,
        state: Array,
        fired: tuple[str, ...],
    ) -> tuple[Jump, Flow] | None:
        """Take the first transition that is due; see the module for which are."""
        if fired == ("zeno",):
            region = min(flow.held, key=lambda name: between(clock, flow.held[name]))
            place = self._regions.index(region)
            transition = self._zeno[place][flow.mode[place]]
        else:
            found = self._due(setup, clock, flow, state, fired)
            if found is None:
                return None
            place, transition = found
        after = self._updated(setup, clock, transition, state)
        if transition.source == transition.target and (after == state).all():
            limit = self._zeno[place].get(transition.source)
            if limit is not None:
                transition, after = limit, self._updated(setup, clock, limit, state)
        region = self._regions[place]
        target = (*flow.mode[:place], transition.target, *flow.mode[place + 1 :])
        held = {name: end for name, end in flow.held.items() if name != region}
        following = replace(
            flow,
            mode=target,
            flow=tuple(
                HELD if name in held else now
                for name, now in zip(self._regions, target, strict=True)
            ),
            held=held,
        )
        jump = Jump(clock.high, j, region, transition.name, flow.mode, target, state, after, fired)
        return jump, self._with_tolerances(setup, clock, following, after)

    def accumulate(
        self, setup: Setup, clock: Clock, flow: Flow, jumps: Sequence[Jump], rest: float
    ) -> tuple[Jump, Flow] | None:
        """Hold the region until the accumulation, where it says what follows then."""
        jump = jumps[-1]
        place = self._regions.index(jump.region)
        if jump.target[place] not in self._zeno[place]:
            if any(past.target[place] in self._zeno[place] for past in jumps):
                return None  # its jumps accumulate as well, and are recognised there
            raise Zeno(
                f"{jump.region}: '{jump.cause}' accumulates at "
                f"t = {clock.later(rest).high:.17g}; declare a transition 'on: zeno' "
                f"from '{jump.target[place]}'"
            )
        return replace(jump, skipped=rest), replace(
            flow,
            flow=(*flow.flow[:place], HELD, *flow.flow[place + 1 :]),
            held={**flow.held, jump.region: clock.later(rest)},
        )

    def projector(self, setup: Setup, flow: Key, start: float, anchor: Array) -> None:
        """Return nothing: a chart has no constraints."""

    def _due(
        self, setup: Setup, clock: Clock, flow: Flow, state: Array, fired: Sequence[str]
    ) -> tuple[int, Transition] | None:
        watch = self._watch(flow.flow)
        rows = watch.at(setup, state, _sizes(flow, state), clock.high)
        for guard, (margin, first, second, _) in zip(watch.guards, rows, strict=True):
            tolerance = flow.tolerances[guard.margin]
            if margin < -tolerance:
                return guard.place, guard.transition
            rate = first if first != 0.0 else second
            if guard.margin in fired:
                # What was found is a fall, or a touch too close to tell: then it must not rise.
                if not rate > 0.0:
                    return guard.place, guard.transition
            elif margin <= tolerance and (rate < 0.0 or (rate == 0.0 and not guard.strict)):
                return guard.place, guard.transition
        return None

    def _with_tolerances(self, setup: Setup, clock: Clock, flow: Flow, state: Array) -> Flow:
        watch = self._watch(flow.flow)
        rows = watch.at(setup, state, _sizes(flow, state), clock.high)
        if np.isnan(rows[:, 0]).any():
            place = int(np.flatnonzero(np.isnan(rows[:, 0]))[0])
            raise NonFinite(f"the guard of {watch.guards[place].margin} has no value")
        sizes = np.where(np.isfinite(rows[:, 3]), rows[:, 3], 0.0)
        return replace(
            flow,
            tolerances={
                guard.margin: max(_ROUNDING * float(size), _UNDERFLOW)
                for guard, size in zip(watch.guards, sizes, strict=True)
            },
        )

    def _watch(self, flow: Key) -> _Watch:
        found = self._watches.get(flow)
        if found is None:
            found = self._watches[flow] = _Watch(self._chart, self._symbols, flow)
        return found

    def _updated(self, setup: Setup, clock: Clock, transition: Transition, state: Array) -> Array:
        if not transition.updates:
            return state
        tape = self._updates.get(id(transition))
        if tape is None:
            known = self._symbols.known
            updates = transition.updates
            tape = self._updates[id(transition)] = compile_tape(
                [
                    parse(updates[name]).to_sympy(known) if name in updates else symbol
                    for name, symbol in self._symbols.variables.items()
                ],
                variables=tuple(self._symbols.variables.values()),
                parameters=tuple(self._symbols.parameters.symbols.values()),
                time=self._symbols.time,
            )
        after = tape.values(state, setup.values, clock.high)
        for name, value in zip(self._chart.variables, after, strict=True):
            if not np.isfinite(value):
                raise NonFinite(f"{transition.name} sets {name} to {value}")
        return after


def _sizes(flow: Flow, state: Array) -> Array:
    """Return the size of the terms that the state was summed from, or is itself."""
    sizes = flow.sizes
    return np.abs(state) if sizes is None else np.maximum(sizes, np.abs(state))
