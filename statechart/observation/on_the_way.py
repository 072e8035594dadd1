"""Outputs computed while a run is made, of pieces that nobody keeps: to the bits of the whole."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from statechart.arrays import Array
from statechart.automaton.events import happened
from statechart.automaton.trace import Arc, Jump, Trace
from statechart.documents.outputs import Moment, Value
from statechart.observation.observer import include
from statechart.observation.outputs import Outputs, OutputValue


class OnTheWay:
    """Computes outputs of one run; see `statechart.automaton.recording_policy.Watch`.

    Sums and extremes go on from piece to piece, in the order in which `Outputs.of` takes the arcs
    of a whole run.

    Parameters
    ----------
    outputs : Outputs
        What to compute.
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
        """Whether it looks at jumps and modes."""
        outputs = self._outputs
        during = any(output.during for output in outputs.integrals.values())
        return bool(outputs.at or outputs.counts or during)

    @property
    def motion(self) -> bool:
        """Whether it looks at what is between the start and the end."""
        outputs, programs = self._outputs, self._observer.programs
        if self.events or outputs.extremes or outputs.integrals:
            return True
        values = programs.expressions([*outputs.start.values(), *outputs.end.values()])
        # Of a step that holds an impulse others tell the forces.
        return bool(programs.needed(values))

    def add(self, piece: Trace) -> None:
        """Take the arcs and jumps since the last time."""
        regions = self._observer.automaton.regions
        for place, (_, events) in enumerate(self._outputs.counts):
            self._counted[place] += sum(
                any(happened(regions, jump, event) for event in events) for jump in piece.jumps
            )
        # Values at a jump may need what steps solved for on both sides of it.
        beside = replace(piece, arcs=(*self._last, *piece.arcs))
        for moment in self._moments:
            moment.add(beside)
        if not piece.arcs:
            return
        if self._start is None and self._outputs.start:
            self._start = self._at_start(piece)
        for formula, found in self._extremes.items():
            if not self._last:
                include(found, self._observer.initial(piece, (formula,)))
            self._observer.widened(piece, formula, found)
        if self._outputs.integrals:
            self._integrals = self._outputs.integrated(piece, self._integrals)
        self._last = (piece.arcs[-1],)

    def end(self, piece: Trace) -> Mapping[str, Any]:
        """Take the end of the run; return the outputs."""
        outputs, last = self._outputs, replace(piece, arcs=self._last)
        found: dict[str, OutputValue] = {}
        for (name, *_), moment in zip(outputs.at, self._moments, strict=True):
            found[name] = moment.end(last)
        found |= {name: n for (name, _), n in zip(outputs.counts, self._counted, strict=True)}
        for formula, extremes in self._extremes.items():
            if not self._last:
                include(extremes, self._observer.initial(piece, (formula,)))
            include(extremes, self._observer.final(last, (formula,)))
        for name, formula, which in outputs.extremes:
            found[name] = self._extremes[formula].item(which)
        if outputs.start:
            found |= zip(outputs.start, self._start or self._at_start(last), strict=True)
        if outputs.end:
            values = self._observer.final(last, list(outputs.end.values())).tolist()
            found |= zip(outputs.end, values, strict=True)
        found |= zip(outputs.integrals, self._integrals.tolist(), strict=True)
        return {name: found[name] for name in outputs.names}

    def _at_start(self, piece: Trace) -> list[float]:
        formulas = list(self._outputs.start.values())
        values: list[float] = self._observer.initial(piece, formulas).tolist()
        return values


class _AtMoment:
    """A value at some events, of which there are as many as are asked for."""

    def __init__(self, outputs: Outputs, output: Value, moment: Moment) -> None:
        self._outputs, self._output, self._moment = outputs, output, moment
        self._most = None if moment.when == "each" else moment.most or 1
        self._values: deque[float] = deque(maxlen=self._most)
        self._waiting: list[Jump] = []

    @property
    def _full(self) -> bool:
        return self._moment.when == "first" and len(self._values) == self._most

    def add(self, beside: Trace) -> None:
        """Take the jumps of a piece, with the arcs before and after them."""
        if not self._full:
            self._waiting += self._outputs.jumps(beside, self._moment.events)
        if self._waiting and beside.arcs:
            known = [jump for jump in self._waiting if jump.j < beside.arcs[-1].j]
            self._waiting = self._waiting[len(known) :]
            self._evaluate(beside, known)

    def end(self, beside: Trace) -> float | list[float] | None:
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
