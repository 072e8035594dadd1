"""The outputs that a model declares, computed from a trace."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.events import happened
from statechart.automaton.trace import Jump, Trace
from statechart.documents.outputs import Event, Moment, Value
from statechart.execution.simulator import Batch
from statechart.observation.grouped import Grouped
from statechart.observation.observer import Observer
from statechart.observation.rows import RowOutputs
from statechart.observation.run_scales import RunScales
from statechart.observation.zeno_tails import last_resolved

OutputValue = float | int | list[float] | None
"""A number; a list for a value at `each` event; None where the event never happened."""


class Scales(NamedTuple):
    """What errors of a run are relative to, and below what its numbers are round-off of zero.

    Attributes
    ----------
    variables : (n,) array or None
        Of the variables at the end; None where each is relative to its own largest value.
    outputs : mapping
        Of outputs, in their form; counts have none.
    zero_variables : (n,) array or float
        For the variables.
    zero_outputs : mapping
        For the outputs that have a kind.
    """

    variables: Array | None = None
    outputs: Mapping[str, OutputValue] = MappingProxyType({})
    zero_variables: Array | float = 0.0
    zero_outputs: Mapping[str, float] = MappingProxyType({})


NO_SCALES = Scales()
"""Each number is relative to itself."""


class Outputs(Grouped):
    """The declared outputs of a model, made ready once for many runs."""

    def of(self, trace: Trace) -> dict[str, OutputValue]:
        """Return the outputs of a run, in the order of the declaration.

        A value at an event that never happened is None, the count of it 0, the list empty.

        Raises
        ------
        FormulaError, StatechartError
            If a formula cannot be evaluated.
        """
        if trace.outputs is not None:
            return {name: trace.outputs[name] for name in self.names}
        batch = getattr(trace.arcs, "source", None)
        if isinstance(batch, Batch):
            return self._of_row(batch, trace)
        observer = self.observer
        found: dict[str, OutputValue] = {}
        for name, output, moment in self.at:
            found[name] = self._at_jumps(trace, output, moment)
        for name, events in self.counts:
            found[name] = len(self.jumps(trace, events))
        for name, formula, which in self.extremes:
            found[name] = observer.extremes(trace, formula)[which]
        if self.start:
            values = observer.initial(trace, list(self.start.values())).tolist()
            found |= zip(self.start, values, strict=True)
        if self.end:
            values = observer.final(trace, list(self.end.values())).tolist()
            found |= zip(self.end, values, strict=True)
        if self.integrals:
            found |= zip(self.integrals, self.integrated(trace).tolist(), strict=True)
        return {name: found[name] for name in self.names}

    def integrated(self, trace: Trace, total: Array | None = None) -> Array:
        """Return the declared integrals (f,), beside the `total` of what precedes."""
        formulas = [output.integral for output in self.integrals.values()]
        during = [output.during for output in self.integrals.values()]
        return self.observer.integrals(trace, formulas, during, total)

    def _of_row(self, batch: Batch, trace: Trace) -> dict[str, OutputValue]:
        """Return the outputs of a run that a loop has made from its start to its end."""
        values = self.rows.values(batch, lambda _, j: trace.jumps[j])
        found: dict[str, OutputValue] = {}
        for (name, _, moment), listed, (count,) in zip(
            self.at, values.listed.tolist(), values.tally.tolist(), strict=True
        ):
            one = listed[0] if count else None
            found[name] = listed[:count] if moment.several else one
        found |= zip([name for name, _ in self.counts], values.counted[:, 0].tolist(), strict=True)
        for group, table in (
            (self.start, values.start),
            (self.end, values.end),
            (self.integrals, values.integrals),
        ):
            if group:
                found |= zip(group, table[0].tolist(), strict=True)
        for name, formula, which in self.extremes:
            found[name] = values.extremes.item(self.rows.place(formula), 0, which)
        return {name: found[name] for name in self.names}

    @cached_property
    def rows(self) -> RowOutputs:
        """What computes them of runs that loops have made from their start to their end."""
        return RowOutputs(self)

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

    def _at_jumps(self, trace: Trace, output: Value, moment: Moment) -> float | list[float] | None:
        jumps = self._chosen(trace, moment)
        if not jumps:
            return [] if moment.several else None
        table = self.observer.at(trace, [output.value], jumps, before=output.before)
        values: list[float] = table[:, 0].tolist()
        return values if moment.several else values[0]

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


def outputs(observer: Observer, trace: Trace) -> dict[str, OutputValue]:
    """Return the declared outputs of one run; see `Outputs.of`."""
    return Outputs(observer).of(trace)
