"""Outputs that a model declares, accumulated over the arcs and jumps of a run, and their scales.

An error is relative to the largest value of its quantity. A quantity that is zero, or nearly, has
no such scale: its error is relative to a thousandth of the scale of its kind, for a force the
largest force of the run, for a length the farthest way that anything goes, for a speed the largest
speed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.regions import happened
from statechart.automaton.trace import Arc, Jump, Trace, visited_states
from statechart.documents.outputs import Event, Moment, Value
from statechart.documents.quantities import Dimension
from statechart.execution.compiled_loop import Batch
from statechart.observation.batch_outputs import BatchOutputs, OutputGroups, OutputValue
from statechart.observation.observer import FormulaLike, Observer, include
from statechart.observation.sampling import passed
from statechart.observation.zeno_tails import last_resolved


class Scales(NamedTuple):
    """Scales that errors of a run are relative to, and bounds of the round-off of zero."""

    # (n,): of the variables at the end; None where each is relative to its own largest value.
    variables: Array | None = None
    # Of outputs, in their form; counts have none.
    outputs: Mapping[str, OutputValue] = MappingProxyType({})
    zero_variables: Array | float = 0.0  # (n,): for the variables.
    zero_outputs: Mapping[str, float] = MappingProxyType({})  # For the outputs that have a kind.


NO_SCALES = Scales()
"""Each number is relative to itself."""


class Outputs(OutputGroups):
    """The declared outputs of a model, made ready once for many runs."""

    def of(self, trace: Trace) -> dict[str, OutputValue]:
        """Return the outputs of a run, in the order of the declaration.

        A value at an event that never happened is None, the count of it 0, the list empty. Raises
        `StatechartError` if a formula cannot be evaluated.
        """
        if trace.outputs is not None:
            return {name: trace.outputs[name] for name in self.names}
        batch = getattr(trace.arcs, "source", None)
        if isinstance(batch, Batch):
            found = self.batches.of_single(batch, trace.jumps)
            return {name: found[name] for name in self.names}
        accumulator = OutputAccumulator(self)
        accumulator.add(trace)
        return accumulator.end(trace)

    @cached_property
    def batches(self) -> BatchOutputs:
        """Computes the outputs of runs that compiled loops made."""
        return BatchOutputs(self)

    def endless(self, trace: Trace) -> frozenset[str]:
        """Return the outputs that count or list events of which a Zeno sequence has no end.

        How many of them a run resolves follows from its tolerance or step.
        """
        summed = last_resolved(trace)
        regions = self.observer.automaton.regions
        several = [(name, moment.events) for name, _, moment in self.at if moment.several]
        return frozenset(
            name
            for name, events in (*several, *self.counts)
            if any(happened(regions, jump, event) for jump in summed for event in events)
        )

    def scales(self, trace: Trace) -> Scales:
        """Return the scales of variables and outputs (see `RunScales`).

        The outputs' are in the form of `of`. A value has been as large as the largest magnitude of
        its formula where a step began, up to its moment: where a body comes back to zero, the value
        there is rounding.
        """
        run, found = RunScales(self.observer, trace), dict[str, OutputValue]()
        for name, output, moment in self.at:
            largest = self._largest(trace, output.value)
            chosen = {jump.j for jump in self._chosen(trace, moment)}
            sizes = [
                run.of(output.value, size)
                for jump, size in zip(trace.jumps, largest[1:-1].tolist(), strict=True)
                if jump.j in chosen
            ]
            found[name] = sizes if moment.several else sizes[0] if sizes else None
        for name, formula in self.end.items():
            last = abs(float(self.observer.final(trace, [formula])[0]))
            found[name] = run.of(formula, float(np.fmax(self._largest(trace, formula)[-1], last)))
        for name, formula, _ in self.extremes:
            found[name] = run.of(formula, float(self._largest(trace, formula)[-1]))
        for name, integral in self.integrals.items():
            size = float(self._largest(trace, integral.integral)[-1])
            found[name] = trace.t_end * run.of(integral.integral, size)
        formulas = {
            **{name: output.value for name, output, _ in self.at},
            **self.end,
            **{name: formula for name, formula, _ in self.extremes},
        }
        zeros = {name: run.zero(formula) for name, formula in formulas.items()}
        return Scales(run.variables, found, run.zeros, zeros)

    def _largest(self, trace: Trace, formula: str | int | float) -> NDArray[np.float64]:
        """Return the largest magnitude (m + 2,) of a formula at the start, up to jumps, in all."""
        values = [self.observer.initial(trace, [formula])]
        if trace.jumps:
            sides = [
                self.observer.at(trace, [formula], trace.jumps, before=before)[:, 0]
                for before in (True, False)
            ]
            values.append(np.fmax(*map(np.abs, sides)))
        magnitudes = np.abs(np.concatenate([*values, [0.0]]))
        if trace.arcs:
            along = self.observer.sample(trace, (str(formula),), per_step=1)
            np.fmax.at(magnitudes, along.j + 1, np.abs(along.columns[str(formula)]))
        magnitudes[~np.isfinite(magnitudes)] = 0.0
        return np.maximum.accumulate(magnitudes)

    def _chosen(self, trace: Trace, moment: Moment) -> list[Jump]:
        """Return the first, the last or each of the jumps that are one of a moment's events."""
        jumps = self.jumps(trace, moment.events)
        if moment.when == "each":
            return jumps
        most = moment.most or 1
        return jumps[:most] if moment.when == "first" else jumps[-most:]

    def jumps(self, trace: Trace, events: tuple[Event, ...]) -> list[Jump]:
        """Return the jumps that are one of `events`: by their cause, or by the state entered."""
        regions = self.observer.automaton.regions
        return [
            jump for jump in trace.jumps if any(happened(regions, jump, event) for event in events)
        ]


class OutputAccumulator:
    """Accumulates the outputs of one run over its pieces: a whole run is one, a stream many.

    Sums and extremes go on from piece to piece in the order of the arcs, so that the outputs do not
    depend on the pieces. Implements `statechart.automaton.time_stepper.OutputStream`.
    """

    def __init__(self, outputs: Outputs) -> None:
        self._outputs, self._observer = outputs, outputs.observer
        self._moments = [_AtMoment(outputs, output, moment) for _, output, moment in outputs.at]
        self._counted = [0] * len(outputs.counts)
        self._extremes = {formula: np.full(2, np.nan) for _, formula, _ in outputs.extremes}
        self._integrals: Array = np.zeros(len(outputs.integrals))
        self._start: list[float] | None = None
        self._last: tuple[Arc, ...] = ()

    @property
    def events(self) -> bool:
        """Whether it needs jumps, and the modes of arcs."""
        outputs = self._outputs
        during = any(output.during for output in outputs.integrals.values())
        return bool(outputs.at or outputs.counts or during)

    @property
    def motion(self) -> bool:
        """Whether it needs arcs and jumps between the start and the end."""
        outputs, programs = self._outputs, self._observer.programs
        if self.events or outputs.extremes or outputs.integrals:
            return True
        values = programs.expressions([*outputs.start.values(), *outputs.end.values()])
        # Forces of a step that holds an impulse are those of the steps beside it.
        return bool(programs.needed(values))

    def add(self, piece: Trace) -> None:
        """Take the arcs and jumps since the last call."""
        outputs, observer = self._outputs, self._observer
        for place, (_, events) in enumerate(outputs.counts):
            self._counted[place] += len(outputs.jumps(piece, events))
        # Values at a jump may need what steps solved for on both sides of it.
        beside = replace(piece, arcs=(*self._last, *piece.arcs)) if self._last else piece
        for moment in self._moments:
            moment.add(beside)
        if not piece.arcs:
            return
        if not self._last:
            self._begin(piece)
        jumps = passed(piece) if self._extremes else []
        for formula, found in self._extremes.items():
            observer.widened(piece, formula, found)
            if jumps:
                include(found, observer.at(piece, (formula,), jumps))
        if outputs.integrals:
            formulas = [output.integral for output in outputs.integrals.values()]
            during = [output.during for output in outputs.integrals.values()]
            self._integrals = observer.integrals(piece, formulas, during, self._integrals)
        self._last = (piece.arcs[-1],)

    def end(self, piece: Trace) -> dict[str, OutputValue]:
        """Take the end of the run, with the whole run or no arcs; return the outputs."""
        outputs, observer = self._outputs, self._observer
        if not self._last:
            self._begin(piece)
            for formula, extremes in self._extremes.items():
                if jumps := passed(piece):
                    include(extremes, observer.at(piece, (formula,), jumps))
        last = piece if piece.arcs else replace(piece, arcs=self._last)
        found: dict[str, OutputValue] = {}
        for (name, *_), moment in zip(outputs.at, self._moments, strict=True):
            found[name] = moment.end(last)
        found |= {name: n for (name, _), n in zip(outputs.counts, self._counted, strict=True)}
        for formula, extremes in self._extremes.items():
            include(extremes, observer.final(last, (formula,)))
        for name, formula, which in outputs.extremes:
            found[name] = self._extremes[formula].item(which)
        found |= zip(outputs.start, self._start or (), strict=True)
        if outputs.end:
            values = observer.final(last, list(outputs.end.values())).tolist()
            found |= zip(outputs.end, values, strict=True)
        found |= zip(outputs.integrals, self._integrals.tolist(), strict=True)
        return {name: found[name] for name in outputs.names}

    def _begin(self, piece: Trace) -> None:
        """Take the values at the start."""
        outputs, observer = self._outputs, self._observer
        if outputs.start:
            self._start = observer.initial(piece, list(outputs.start.values())).tolist()
        for formula, found in self._extremes.items():
            include(found, observer.initial(piece, (formula,)))


class _AtMoment:
    """Accumulates a value at some events, at most as many as are asked for."""

    def __init__(self, outputs: Outputs, output: Value, moment: Moment) -> None:
        self._outputs, self._output, self._moment = outputs, output, moment
        self._most = None if moment.when == "each" else moment.most or 1
        self._values: deque[float] = deque(maxlen=self._most)
        self._waiting: list[Jump] = []

    def add(self, beside: Trace) -> None:
        """Take the jumps of a piece, with the arcs before and after them."""
        full = self._moment.when == "first" and len(self._values) == self._most
        if not full:
            self._waiting += self._outputs.jumps(beside, self._moment.events)
        if self._waiting and beside.arcs:
            known = [jump for jump in self._waiting if jump.j < beside.arcs[-1].j]
            self._waiting = self._waiting[len(known) :]
            self._evaluate(beside, known)

    def end(self, beside: Trace) -> OutputValue:
        """Return the value, or those of several events."""
        self._evaluate(beside, self._waiting)
        values = list(self._values)
        if self._moment.several:
            return values
        return values[0] if values else None

    def _evaluate(self, beside: Trace, jumps: list[Jump]) -> None:
        if self._moment.when == "first" and self._most is not None:
            jumps = jumps[: self._most - len(self._values)]
        elif self._most is not None:
            jumps = jumps[-self._most :]
        if jumps:
            output = self._output
            table = self._outputs.observer.at(beside, [output.value], jumps, before=output.before)
            self._values.extend(table[:, 0].tolist())


def outputs(observer: Observer, trace: Trace) -> dict[str, OutputValue]:
    """Return the declared outputs of one run; see `Outputs.of`."""
    return Outputs(observer).of(trace)


_NEARLY_ZERO = 1e-3
"""Part of the scale of its kind below which a quantity is nearly zero."""

_TRAVELLED: tuple[Dimension, ...] = ("length", "angle")
"""Kinds whose zero is anywhere: their scale is how far they change."""

_TOLERANCES: Mapping[Dimension, str] = {
    "length": "gap",
    "length/time": "speed",
    "force": "force",
}
"""Kind -> the tolerance of a run below which it is zero."""


class RunScales:
    """The scales of one run.

    `variables` (n,) are their largest magnitudes, or the part `_NEARLY_ZERO` of their kinds' scales
    where that is more; below `zeros` (n,) they are zero but for round-off.
    """

    def __init__(self, observer: Observer, trace: Trace) -> None:
        self._observer, self._trace = observer, trace
        automaton = observer.automaton
        model = automaton.declaration
        states = visited_states(trace)
        largest = np.abs(states).max(axis=0)
        spread = np.ptp(states, axis=0)
        self._kinds: dict[Dimension, float] = {}
        kinds = [model.quantity(name).dimension for name in automaton.names]
        for kind, size, change in zip(kinds, largest.tolist(), spread.tolist(), strict=True):
            found = change if kind in _TRAVELLED else size
            self._kinds[kind] = max(self._kinds.get(kind, 0.0), found)
        self._kinds[""] = 0.0  # of quantities of unknown kinds each has a scale of its own
        self._leaves: dict[sp.Symbol, float] = {
            automaton.time: trace.t_end,
            **dict(zip(automaton.parameters, np.abs(trace.values).tolist(), strict=True)),
        }
        self._fixed = frozenset(automaton.parameters)
        scales = np.array([self._kinds[kind] for kind in kinds])
        self._leaves |= zip(automaton.variables, np.maximum(scales, largest).tolist(), strict=True)
        self.variables: Array = np.maximum(_NEARLY_ZERO * scales, largest)
        self.zeros: Array = np.array([self._zero(kind) for kind in kinds])

    def of(self, formula: FormulaLike, own: float = 0.0) -> float:
        """Return the scale of a formula that has been as large as `own`.

        The scale of its kind is that of its terms: a difference of equal lengths is nearly zero on
        the scale of lengths.
        """
        size = self._size(self._observer.programs.expression(formula))
        return max(own, _NEARLY_ZERO * (size or 0.0))

    def zero(self, formula: FormulaLike) -> float:
        """Return what a formula is below where it is zero but for round-off."""
        return self._zero(self._kind(self._observer.programs.expression(formula)))

    def _zero(self, kind: Dimension) -> float:
        return self._trace.tolerances.get(_TOLERANCES.get(kind, ""), 0.0)

    def _kind(self, expression: sp.Expr) -> Dimension:
        """Return the kind of an expression that is a symbol, perhaps with a sign."""
        for name, observable in self._observer.automaton.observables.items():
            if observable in (expression, -expression) and observable.is_Symbol:
                return self._observer.automaton.declaration.quantity(name).dimension
        return ""

    def _size(self, node: sp.Expr) -> float | None:
        """Return how large an expression gets, told from its terms; None where that is unknown."""
        if node.free_symbols <= self._fixed:
            found = abs(float(node.xreplace(self._leaves_fixed)))
            return found if np.isfinite(found) else None
        if node.is_Symbol:
            return self._leaves.get(node) if node in self._leaves else self._unknown(node)
        if node.is_Pow and not node.exp.is_positive:
            return None
        parts = [self._size(argument) for argument in node.args]
        known = [part for part in parts if part is not None]
        if node.is_Add or isinstance(node, sp.Min | sp.Max):
            return max(known, default=None)
        if not parts or len(known) < len(parts):
            return None
        if node.is_Mul:
            return float(np.prod(known))
        if node.is_Pow:
            return float(known[0] ** known[1]) if node.exp.is_number else None
        if isinstance(node, sp.Abs):
            return known[0]
        if isinstance(node, sp.sin | sp.tan | sp.atan):
            return min(known[0], 1.0)
        return 1.0 if isinstance(node, sp.cos | sp.sign) else None

    @property
    def _leaves_fixed(self) -> dict[sp.Symbol, float]:
        automaton = self._observer.automaton
        return dict(zip(automaton.parameters, self._trace.values.tolist(), strict=True))

    def _unknown(self, symbol: sp.Symbol) -> float | None:
        """Return the scale of what modes solve for: of a force that of forces."""
        if self._kind(symbol) != "force":
            return None
        if "force" not in self._kinds:
            names = self._forces()
            table = self._observer.sample(self._trace, names, per_step=1).columns
            known = (np.abs(column[np.isfinite(column)]) for column in table.values())
            self._kinds["force"] = max((float(one.max(initial=0.0)) for one in known), default=0.0)
        return self._kinds["force"]

    def _forces(self) -> tuple[str, ...]:
        quantity = self._observer.automaton.declaration.quantity
        return tuple(n for n in self._observer.names if quantity(n).dimension == "force")
