"""Evaluation of formulas along a run: samples, and values at jumps.

A formula with unknowns of a mode (such as contact forces) is compiled once per mode. Compiled
programs are cached over the runs of a simulator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
import sympy as sp
from numpy.typing import ArrayLike, NDArray

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.clock import decimals
from statechart.automaton.regions import Margin, Mode, shown_margins, with_coefficients
from statechart.automaton.trace import Jump, Key, Role, Roles, Trace
from statechart.execution.simulator import Simulator
from statechart.execution.time_stepping import SteppingSimulator
from statechart.formulas.formula import parse
from statechart.formulas.linear import Singular
from statechart.formulas.tape import Tape
from statechart.observation import sampling


class Observer:
    """Evaluates formulas along the traces of a simulator.

    A formula with unknowns is NaN in a mode of zero duration with singular equations.
    """

    def __init__(self, simulator: Simulator | SteppingSimulator) -> None:
        self.simulator = simulator
        self.programs = Programs(simulator.automaton)
        self.outputs: Any = None  # see `statechart.observation.outputs.outputs_of`

    @property
    def automaton(self) -> Automaton:
        """The automaton of the formulas."""
        return self.simulator.automaton

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The variables and further observables, without parameters and time."""
        automaton = self.automaton
        constant = {automaton.time, *automaton.parameters}
        changing = (name for name, e in automaton.observables.items() if e not in constant)
        return tuple(dict.fromkeys((*automaton.names, *changing)))

    def sample(
        self,
        trace: Trace,
        formulas: Sequence[str] | None = None,
        *,
        per_step: float = 8,
        times: ArrayLike | None = None,
    ) -> sampling.Samples:
        """Evaluate along a run, at sorted `times` or at `per_step` points of every step.

        Raises `FormulaError` if a formula cannot be evaluated, `ValueError` for wrong times.
        """
        trace.require_motion()
        formulas = self.names if formulas is None else tuple(formulas)
        expressions = tuple(self.programs.expression(formula) for formula in formulas)
        if times is None:
            arcs = list(trace.arcs)
            local = sampling.subdivide(arcs, per_step)
        else:
            arcs, local = sampling.at_times(trace, np.asarray(times, dtype=float))
        if arcs:
            points = sampling.sample_arcs(arcs, local)
            counts = [len(tau) for tau in local]
            modes_shown, jumped = [arc.mode for arc in arcs], [arc.j for arc in arcs]
        else:  # a run without flows is its last state
            rows = 1 if times is None else np.size(times)
            points = self._instants(trace, [sampling.end_of(trace)] * rows)
            counts, modes_shown, jumped = [rows], [trace.final_mode], [len(trace.jumps)]
        modes = tuple(dict.fromkeys(modes_shown))
        places = {key: place for place, key in enumerate(modes)}
        table = self._table(trace, expressions, points)
        shown = points.times
        if times is None and trace.step is not None:
            shown = decimals(shown)
        j = np.repeat(np.array(jumped, dtype=np.int64), counts)
        mode = np.repeat(np.array([places[key] for key in modes_shown], dtype=np.intp), counts)
        columns = {name: table[:, k] for k, name in enumerate(formulas)}
        return sampling.Samples(shown, j, mode, modes, columns)

    def initial(self, trace: Trace, formulas: Sequence[FormulaLike]) -> Array:
        """Return the values (f,) of formulas at the start, before any jump."""
        return self._values(trace, formulas, [sampling.start_of(trace)])[0]

    def final(self, trace: Trace, formulas: Sequence[FormulaLike]) -> Array:
        """Return the values (f,) of formulas at the end, after all jumps."""
        return self._values(trace, formulas, [sampling.end_of(trace)])[0]

    def at(
        self,
        trace: Trace,
        formulas: Sequence[FormulaLike],
        jumps: Sequence[Jump],
        *,
        before: bool = False,
    ) -> Array:
        """Return the values (m, f) of formulas at jumps."""
        return self._values(trace, formulas, [sampling.side_of(jump, before) for jump in jumps])

    def _values(
        self, trace: Trace, formulas: Sequence[FormulaLike], instants: Sequence[sampling.Endpoint]
    ) -> Array:
        expressions = self.programs.expressions(formulas)
        return self._table(trace, expressions, self._instants(trace, instants))

    def _instants(self, trace: Trace, instants: Sequence[sampling.Endpoint]) -> sampling.Points:
        return sampling.at_endpoints(trace, instants, len(self.programs.solved))

    def margins(self, trace: Trace, jumps: Sequence[Jump]) -> list[dict[str, float]]:
        """Return the margins of the source mode just before each jump.

        None for a mode of zero duration with singular equations.
        """
        tables: list[dict[str, float]] = [{} for _ in jumps]
        remaining: dict[tuple[Key, Roles], list[int]] = {}
        for place, jump in enumerate(jumps):
            stepped = trace.step is not None
            roles = () if stepped else sampling.roles_at(trace, jump.j, jump.source, ends=True)
            remaining.setdefault((jump.source, roles), []).append(place)
        for flow, places in remaining.items():
            ended = [jumps[place] for place in places]
            names, rows = self._margins_before_jumps(trace, *flow, ended)
            for place, row in zip(places, rows, strict=True):
                values, coefficients = np.split(row, 2)
                limited = ~np.isinf(coefficients)
                pairs = zip(names, values.tolist(), limited, strict=True)
                tables[place] = {name: value for name, value, shown in pairs if shown}
        return tables

    def _margins_before_jumps(
        self, trace: Trace, key: Key, roles: Roles, jumps: Sequence[Jump]
    ) -> tuple[tuple[str, ...], Array]:
        """Return names of a flow's margins, and rows before the jumps that ended it.

        A row has the values of the margins, then their coefficients.
        """
        if trace.step is not None:  # time stepping builds no modes
            states = zip(self.automaton.recorded_regions(key), key, strict=True)
            margins = shown_margins(m for r, state in states for m in r.build(Role(state)).margins)
            rows = self.at(trace, with_coefficients(margins), jumps, before=True)
        else:
            margins, tape = self.margins_of(trace, roles)
            before, times = [jump.before for jump in jumps], [jump.t for jump in jumps]
            rows = tape.table(before, trace.values, times)
        return tuple(m.name for m in margins), rows

    def margins_of(self, trace: Trace, roles: Roles) -> tuple[tuple[Margin, ...], Tape]:
        """Return the shown margins of a flow, and the tape of their values, then coefficients."""
        mode = self.modes_of(trace)(roles)
        margins = () if mode is None else shown_margins(mode.margins)
        return margins, self.programs.tape(with_coefficients(margins), mode)

    def _table(
        self, trace: Trace, expressions: tuple[sp.Expr, ...], points: sampling.Points
    ) -> Array:
        """Return the values (m, f) of expressions, with one kernel call per flow."""
        values = trace.values
        if not self.programs.needed(expressions):
            return self.programs.tape(expressions, None).table(points.states, values, points.times)
        if (unknowns := points.unknowns()) is not None:
            rows = np.hstack([points.states, unknowns])
            tape = self.programs.tape(expressions, None, known=True)
            return tape.table(rows, values, points.times)
        result = np.full((len(points.times), len(expressions)), np.nan)
        owners: dict[Roles, list[NDArray[np.intp]]] = {}
        start = 0
        for roles, end in zip(points.roles(), points.ends, strict=True):
            owners.setdefault(roles, []).append(np.arange(start, end))
            start = end
        modes = self.modes_of(trace)
        for roles, blocks in owners.items():
            mode, columns = modes(roles), [*range(len(expressions))]
            if mode is None:
                columns = [i for i in columns if not self.programs.needed((expressions[i],))]
            if columns:
                index = np.concatenate(blocks)
                shown = sampling.visible_expressions([expressions[i] for i in columns], mode)
                tape = self.programs.tape(shown, mode)
                found = tape.table(points.states[index], values, points.times[index])
                result[np.ix_(index, np.array(columns))] = found
        return result

    def modes_of(self, trace: Trace) -> Callable[[Roles], Mode | None]:
        """Return the function roles -> solved mode, or None if its equations are singular."""
        assert isinstance(self.simulator, Simulator)  # time stepping solves no modes
        solved, zeros = self.simulator.modes.mode, trace.zeros

        def mode_at(roles: Roles) -> Mode | None:
            try:
                return solved(roles, zeros)
            except Singular:
                return None

        return mode_at


FormulaLike: TypeAlias = "str | int | float | sp.Expr"
"""Text over the names of observables, or an expression in the symbols of the automaton."""


class Programs:
    """Cache of compiled formulas; `solved` are the unknowns and controls of modes."""

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        self.solved = (*automaton.unknowns, *automaton.controls)
        given_symbols = (*automaton.variables, *automaton.parameters, automaton.time)
        self._given: frozenset[sp.Basic] = frozenset(given_symbols)
        self._parsed = cache(lambda text: parse(text).to_sympy(automaton.observables))
        self._tape, self.needed = cache(self._compiled), cache(self._needed)

    def expression(self, formula: FormulaLike) -> sp.Expr:
        """Return a formula in the symbols of the automaton; raise `FormulaError`."""
        return formula if isinstance(formula, sp.Expr) else self._parsed(formula)

    def expressions(self, formulas: Iterable[FormulaLike]) -> tuple[sp.Expr, ...]:
        """Return formulas in the symbols of the automaton."""
        return tuple([self.expression(formula) for formula in formulas])

    def _needed(self, expressions: tuple[sp.Expr, ...]) -> bool:
        return any(e.free_symbols - self._given for e in expressions)

    def tape(
        self, expressions: tuple[sp.Expr, ...], mode: Mode | None, *, known: bool = False
    ) -> Tape:
        """Return the tape of expressions in a mode, or independent of it.

        `known`: over states with unknowns and controls appended.
        """
        return self._tape(expressions, mode, known)

    def _compiled(self, expressions: tuple[sp.Expr, ...], mode: Mode | None, known: bool) -> Tape:
        return self._automaton.tape(expressions, mode, self.solved if known else ())
