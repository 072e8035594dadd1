"""Formulas evaluated along a run: samples, values at jumps, integrals, extremes.

A formula over an automaton's observables may use what a mode solves for (contact forces, say);
it is then compiled once for every mode that it is evaluated in. An observer outlives the runs of
its simulator, so that the next run finds its programs ready.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.clock import decimals
from statechart.automaton.dense_output import integrals
from statechart.automaton.regions import Margin, Mode, whole_margins
from statechart.automaton.trace import Arc, Jump, Key, Role, Roles, Trace
from statechart.execution.simulator import Simulator
from statechart.execution.time_stepping import SteppingSimulator
from statechart.formulas.formula import parse
from statechart.formulas.linear import Singular
from statechart.formulas.tape import Tape, contiguous
from statechart.formulas.writer import compile_tape
from statechart.kernels.boxes import Steps
from statechart.kernels.extremes import widen
from statechart.observation.sampling import (
    Endpoint,
    Points,
    Samples,
    Where,
    along,
    at_endpoints,
    at_times,
    end_of,
    passed,
    places_in,
    roles_at,
    seen,
    side_of,
    start_of,
    subdivided,
    wanted,
)


def include(found: Array, values: Array) -> None:
    """Let an interval (2,), not numbers at first, hold values, too; what is none does not count."""
    found[0] = np.fmin.reduce(values, axis=None, initial=found[0])
    found[1] = np.fmax.reduce(values, axis=None, initial=found[1])


class Observer:
    """Evaluates formulas along the traces of a simulator.

    A formula over what a mode solves for has no value (not a number) in a mode of zero duration
    whose equations are singular.
    """

    def __init__(self, simulator: Simulator | SteppingSimulator) -> None:
        self.simulator = simulator
        self.programs = Programs(simulator.automaton)

    @property
    def automaton(self) -> Automaton:
        """The automaton whose observables formulas are over."""
        return self.simulator.automaton

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The observables that change along a run: variables first, no parameter, no time."""
        automaton = self.automaton
        constant, variables = {automaton.time, *automaton.parameters}, {*automaton.names}
        others = [
            name
            for name, expression in automaton.observables.items()
            if expression not in constant and name not in variables
        ]
        return (*automaton.names, *others)

    def sample(
        self,
        trace: Trace,
        formulas: Sequence[str] | None = None,
        *,
        per_step: float = 8,
        times: ArrayLike | None = None,
    ) -> Samples:
        """Evaluate along a run, at times or at `per_step` places of every step.

        Raises `FormulaError` if a formula cannot be evaluated, `ValueError` if the times are
        outside the run or not in order.
        """
        trace.require_motion()
        formulas = self.names if formulas is None else tuple(formulas)
        expressions = tuple(self.programs.expression(formula) for formula in formulas)
        if times is None:
            arcs = list(trace.arcs)
            local = subdivided(arcs, per_step)
        else:
            arcs, local = at_times(trace, np.asarray(times, dtype=float))
        if arcs:
            points = along(arcs, local)
            counts = [len(tau) for tau in local]
            held, jumped = [arc.mode for arc in arcs], [arc.j for arc in arcs]
        else:  # nothing flowed: the run is its last state
            rows = 1 if times is None else np.size(times)
            points = self._instants(trace, [end_of(trace)] * rows)
            counts, held, jumped = [rows], [trace.final_mode], [len(trace.jumps)]
        modes = tuple(dict.fromkeys(held))
        places = {key: place for place, key in enumerate(modes)}
        table = self._table(trace, expressions, points)
        shown = points.times
        if times is None and trace.step is not None:
            shown = decimals(shown)
        return Samples(
            shown,
            np.repeat(np.array(jumped, dtype=np.int64), counts),
            np.repeat(np.array([places[key] for key in held], dtype=np.intp), counts),
            modes,
            {name: table[:, k] for k, name in enumerate(formulas)},
        )

    def initial(self, trace: Trace, formulas: Sequence[FormulaLike]) -> Array:
        """Return the values (f,) of formulas at the start, before any jump."""
        return self._values(trace, formulas, [start_of(trace)])[0]

    def final(self, trace: Trace, formulas: Sequence[FormulaLike]) -> Array:
        """Return the values (f,) of formulas at the end, after all jumps."""
        return self._values(trace, formulas, [end_of(trace)])[0]

    def at(
        self,
        trace: Trace,
        formulas: Sequence[FormulaLike],
        jumps: Sequence[Jump],
        *,
        before: bool = False,
    ) -> Array:
        """Return the values (m, f) of formulas at jumps."""
        return self._values(trace, formulas, [side_of(jump, before) for jump in jumps])

    def _values(
        self, trace: Trace, formulas: Sequence[FormulaLike], instants: Sequence[Endpoint]
    ) -> Array:
        expressions = self.programs.expressions(formulas)
        return self._table(trace, expressions, self._instants(trace, instants))

    def _instants(self, trace: Trace, instants: Sequence[Endpoint]) -> Points:
        return at_endpoints(trace, instants, len(self.programs.solved))

    def margins(self, trace: Trace, jumps: Sequence[Jump]) -> list[dict[str, float]]:
        """Return the margins of the flow that each of the jumps ended, just before it.

        None where a mode that was passed in no time has singular equations.
        """
        found: list[dict[str, float]] = [{} for _ in jumps]
        left: dict[tuple[Key, Roles], list[int]] = {}
        for place, jump in enumerate(jumps):
            stepped = trace.step is not None
            roles = () if stepped else roles_at(trace, jump.j, jump.source, ends=True)
            left.setdefault((jump.source, roles), []).append(place)
        for flow, places in left.items():
            margins, rows = self._margins_left(trace, *flow, [jumps[place] for place in places])
            for place, row in zip(places, rows.tolist(), strict=True):
                found[place] = {m.name: v for m, v in zip(margins, row, strict=True)}
        return found

    def _margins_left(
        self, trace: Trace, key: Key, roles: Roles, jumps: Sequence[Jump]
    ) -> tuple[tuple[Margin, ...], Array]:
        """Return the margins of a flow, and their values before the jumps that ended it."""
        if trace.step is not None:  # no mode was built
            states = zip(self.automaton.recorded_regions(key), key, strict=True)
            margins = whole_margins(m for r, state in states for m in r.build(Role(state)).margins)
            return margins, self.at(trace, [m.expression for m in margins], jumps, before=True)
        mode = self._modes(trace)(roles)
        margins = () if mode is None else whole_margins(mode.margins)
        points = self._instants(trace, [side_of(jump, True) for jump in jumps])
        tape = self.programs.tape(tuple(m.expression for m in margins), mode)
        return margins, tape.table(points.states, trace.values, points.times)

    def integrals(
        self,
        trace: Trace,
        formulas: Sequence[FormulaLike],
        during: Sequence[Mapping[str, str]] | None = None,
        total: Array | None = None,
    ) -> Array:
        """Return the integrals (f,) of formulas over time."""
        trace.require_motion()
        expressions = self.programs.expressions(formulas)
        where = wanted(during) if during else ((),) * len(expressions)
        total = np.zeros(len(expressions)) if total is None else total
        for arc, places, tape, coefficients, _ in self._pieces(trace, expressions, where):
            start, end = arc.start.high, arc.duration
            found, _ = integrals(tape, arc.times, coefficients, trace.values, start, 0.0, end)
            total[places] += found
        return total

    def _pieces(
        self, trace: Trace, expressions: tuple[sp.Expr, ...], where: tuple[Where, ...]
    ) -> Iterator[tuple[Arc, list[int], Tape, Array, Array]]:
        """Yield, an arc each, which expressions count there, their tape, what it is over.

        Twice: where a force is not known, in a step with an impact between two others, it adds
        nothing to an integral, and has no value.
        """
        modes = None
        for arc in trace.arcs:
            active = self.programs.active(arc.mode, where, expressions)
            if not active.places:
                continue
            if active.needed and arc.solved is not None:
                known = np.pad(arc.coefficients, ((0, 0), (0, arc.solved.shape[1]), (0, 0)))
                resolved, variables = known.copy(), len(trace.variables)
                known[:, variables:, 0] = arc.solved
                resolved[:, variables:, 0] = np.nan_to_num(arc.solved)
                tape = self.programs.tape(active.expressions, None, known=True)
                yield arc, active.places, tape, resolved, known
                continue
            mode = None
            if active.needed:
                modes = modes or self._modes(trace)
                mode = modes(arc.roles)
            tape = self.programs.tape(seen(active.expressions, mode), mode)
            yield arc, active.places, tape, arc.coefficients, arc.coefficients

    def extremes(
        self, trace: Trace, formula: FormulaLike | Callable[[Key], sp.Expr]
    ) -> tuple[float, float]:
        """Return the least and the greatest value of a formula, perhaps of the mode, over a run.

        Modes of no duration belong to it, its start and its end. Places where the formula is
        undefined do not count; both are not a number if it is everywhere.
        """
        found, jumps = np.full(2, np.nan), passed(trace)
        flowed = (arc.mode for arc in trace.arcs)
        jumped = (jump.target for jump in jumps)
        modes: dict[FormulaLike, set[Key]] = {}
        for key in dict.fromkeys([trace.start_mode, *flowed, *jumped, trace.final_mode]):
            # An expression, too, can be called.
            own = formula if isinstance(formula, str | int | float | sp.Expr) else formula(key)
            modes.setdefault(own, set()).add(key)
        for expression, keys in modes.items():
            if expression in (sp.oo, -sp.oo):
                include(found, np.array([float(expression)]))
                continue
            if trace.start_mode in keys:
                include(found, self.initial(trace, (expression,)))
            arcs = trace.arcs
            if len(modes) > 1:
                arcs = tuple(arc for arc in arcs if arc.mode in keys)
            self.widened(replace(trace, arcs=arcs), expression, found)
            if entered := [jump for jump in jumps if jump.target in keys]:
                include(found, self.at(trace, (expression,), entered))
            if trace.final_mode in keys:
                include(found, self.final(trace, (expression,)))
        return found.item(0), found.item(1)

    def widened(self, trace: Trace, formula: FormulaLike, found: Array) -> None:
        """Let an interval (2,) hold the values of a formula over all arcs, too."""
        trace.require_motion()
        expressions = (self.programs.expression(formula),)
        for arc, _, tape, resolved, coefficients in self._pieces(trace, expressions, ((),)):
            high, low = arc.start
            steps = Steps(arc.times, contiguous(coefficients), trace.values, high)
            widen(tape.parts, steps, contiguous(resolved), low, found)

    def _table(self, trace: Trace, expressions: tuple[sp.Expr, ...], points: Points) -> Array:
        """Return the values (m, f) of expressions, one call of a kernel per flow."""
        values = trace.values
        if not self.programs.needed(expressions):
            return self.programs.tape(expressions, None).table(points.states, values, points.times)
        if (unknowns := points.unknowns()) is not None:
            rows = np.hstack([points.states, unknowns])
            return self.programs.tape(expressions, None, known=True).table(
                rows, values, points.times
            )
        result = np.full((len(points.times), len(expressions)), np.nan)
        owners: dict[Roles, list[NDArray[np.intp]]] = {}
        start = 0
        for roles, end in zip(points.roles(), points.ends, strict=True):
            owners.setdefault(roles, []).append(np.arange(start, end))
            start = end
        modes = self._modes(trace)
        for roles, parts in owners.items():
            mode = modes(roles)
            columns = [
                i
                for i, e in enumerate(expressions)
                if mode is not None or not self.programs.needed((e,))
            ]
            if columns:
                index = np.concatenate(parts)
                tape = self.programs.tape(seen([expressions[i] for i in columns], mode), mode)
                found = tape.table(points.states[index], values, points.times[index])
                result[np.ix_(index, np.array(columns))] = found
        return result

    def _modes(self, trace: Trace) -> Callable[[Roles], Mode | None]:
        """Return the look-up roles -> solved mode; None where its equations have no solution."""
        assert isinstance(self.simulator, Simulator)  # steps have no equations of modes
        solved, zeros = self.simulator.modes.mode, trace.zeros

        def look_up(roles: Roles) -> Mode | None:
            try:
                return solved(roles, zeros)
            except Singular:
                return None

        return look_up


FormulaLike: TypeAlias = "str | int | float | sp.Expr"
"""Text over the observables' names, or an expression in the automaton's own symbols."""


@dataclass(frozen=True, eq=False)
class Active:
    """Formulas that are integrated in one mode."""

    places: list[int]
    expressions: tuple[sp.Expr, ...]
    needed: bool


class Programs:
    """Compiles formulas, once each; `solved` are the symbols that a mode solves for, or sets."""

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        self._expressions: dict[str | int | float, sp.Expr] = {}
        self.solved = (*automaton.unknowns, *automaton.controls)
        given = (*automaton.variables, *automaton.parameters, automaton.time)
        self._given: frozenset[sp.Basic] = frozenset(given)
        self._needs: dict[tuple[sp.Expr, ...], bool] = {}
        self._tapes: dict[tuple[tuple[sp.Expr, ...], Mode | None, bool], Tape] = {}
        self._actives: dict[tuple[Key, tuple[Where, ...], tuple[sp.Expr, ...]], Active] = {}

    def expression(self, formula: FormulaLike) -> sp.Expr:
        """Return a formula in the automaton's symbols.

        Raises `FormulaError` if it cannot be read, or uses a name that is no observable.
        """
        if isinstance(formula, sp.Expr):
            return formula
        if formula not in self._expressions:
            self._expressions[formula] = parse(formula).to_sympy(self._automaton.observables)
        return self._expressions[formula]

    def expressions(self, formulas: Iterable[FormulaLike]) -> tuple[sp.Expr, ...]:
        """Return formulas in the automaton's symbols."""
        return tuple([self.expression(formula) for formula in formulas])

    def active(
        self, key: Key, where: tuple[Where, ...], expressions: tuple[sp.Expr, ...]
    ) -> Active:
        """Return what is integrated in the mode `key`."""
        known = self._actives.get((key, where, expressions))
        if known is not None:
            return known
        places = places_in(self._automaton.recorded_regions(key), key, where)
        chosen = tuple([expressions[i] for i in places])
        found = Active(places, chosen, self.needed(chosen))
        self._actives[key, where, expressions] = found
        return found

    def needed(self, expressions: tuple[sp.Expr, ...]) -> bool:
        """Tell whether the expressions use what a mode solves for."""
        found = self._needs.get(expressions)
        if found is None:
            found = any(e.free_symbols - self._given for e in expressions)
            self._needs[expressions] = found
        return found

    def tape(
        self, expressions: tuple[sp.Expr, ...], mode: Mode | None, *, known: bool = False
    ) -> Tape:
        """Return the program for expressions in a mode, or in any that they do not depend on.

        `known`: over states with the unknowns and controls appended.
        """
        key = (expressions, mode, known)
        tape = self._tapes.get(key)
        if tape is None:
            automaton = self._automaton
            tape = self._tapes[key] = compile_tape(
                expressions,
                variables=(*automaton.variables, *(self.solved if known else ())),
                parameters=automaton.parameters,
                time=automaton.time,
                definitions=mode.definitions if mode else (),
            )
        return tape
