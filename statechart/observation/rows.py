"""Outputs of runs that loops have made, of one or of many at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statechart.arrays import Array
from statechart.automaton.events import happened
from statechart.automaton.trace import Jump, Key
from statechart.automaton.trace_store import RecordedEvent, event_of
from statechart.documents.outputs import Event
from statechart.execution.ahead import N_JUMPS, N_MODE
from statechart.execution.rows import EVENTS, EVENTS_END, FIRST_MODE, Batch
from statechart.kernels.jit import entry
from statechart.observation.grouped import Grouped
from statechart.observation.row_formulas import RowFormulas
from statechart.observation.row_values import (
    MADE,
    NO,
    OWN,
    TARGET,
    UNSETTLED,
    YES,
    Told,
    Values,
    Wanted,
    row_values,
)

_Made = Callable[[int, int], Jump]
"""From a row and the number of jumps before it to one of its jumps."""

_NOWHERE = np.empty(0)


class RowOutputs:
    """The outputs of a model, of batches of rows.

    Parameters
    ----------
    outputs : Grouped
    """

    def __init__(self, outputs: Grouped) -> None:
        self._outputs, self._formulas = outputs, RowFormulas(outputs)
        self._regions = outputs.observer.automaton.regions
        self._known: dict[tuple[frozenset[int], int], tuple[Wanted, Told]] = {}
        self._entry: Callable[..., tuple[int, int]] | None = None

    def of(self, batch: Batch, made: _Made) -> tuple[dict[str, Array], dict[str, list[Array]]]:
        """Return the outputs of rows: numbers (m,), and lists, a row of each.

        A value at an event that never happened is not a number.
        """
        outputs, values = self._outputs, self.values(batch, made)
        numbers: dict[str, Array] = {}
        lists: dict[str, list[Array]] = {}
        for (name, _, moment), listed, tally in zip(
            outputs.at, values.listed, values.tally, strict=True
        ):
            if moment.several:
                ends = np.cumsum(tally)
                lists[name] = np.split(listed[: ends[-1]], ends[:-1])
            else:
                numbers[name] = np.full(len(tally), np.nan)
                numbers[name][tally > 0] = listed[: tally.sum()]
        for (name, _), counted in zip(outputs.counts, values.counted, strict=True):
            numbers[name] = counted.astype(float)
        for group, table in (
            (outputs.start, values.start),
            (outputs.end, values.end),
            (outputs.integrals, values.integrals),
        ):
            numbers |= zip(group, table.T, strict=True)
        for name, formula, which in outputs.extremes:
            numbers[name] = values.extremes[self.place(formula), :, which]
        return numbers, lists

    def _compute(self, *arguments: Any) -> tuple[int, int]:
        if self._entry is None:
            self._entry = entry(row_values, *arguments)
        return self._entry(*arguments)

    def place(self, formula: str | int | float) -> int:
        """Return where the extremes of a formula stand among those of others."""
        return self._formulas.extremes.index(formula)

    def values(self, batch: Batch, made: _Made) -> Values:
        """Return the outputs of rows as arrays; see `of`."""
        outputs, found = self._outputs, batch.found
        m, regions = len(found.ends), len(self._regions)
        key = batch.zeros, len(batch.kinds)
        if key not in self._known:
            nothing = np.zeros((0, len(self._formulas.waits)), np.uint8)
            self._known[key] = self._formulas.wanted(batch), Told(np.zeros(0, np.int64), nothing)
        wanted, told = self._known[key]
        # A stop, which is no jump of a loop, is one more.
        events = sum(found.place[:, N_JUMPS].tolist()) + m
        values = Values(
            np.empty((events, len(self._formulas.waits)), np.uint8),
            np.empty((len(outputs.at), events)),
            np.empty((len(outputs.at), m), np.int64),
            np.empty((len(outputs.counts), m), np.int64),
            np.empty((m, len(outputs.start))),
            np.empty((m, len(outputs.end))),
            np.empty((m, len(outputs.integrals))),
            np.empty((len(self._formulas.extremes), m, 2)),
        )
        decided = False
        while True:
            number, code = self._compute(wanted, told, batch.block, found, regions, decided, values)
            if number == MADE:
                return values
            if number == UNSETTLED:
                self._settle(batch, made, values)
                decided = True
            else:
                told = self._learned(batch, told, number, code)
                self._known[key] = wanted, told

    def _learned(self, batch: Batch, told: Told, number: int, code: int) -> Told:
        """Return which events are waited for, those like the one of a number among them."""
        found = batch.found
        ends = np.cumsum(found.spans[:, EVENTS_END] - found.spans[:, EVENTS] + batch.stopped)
        row = int(np.searchsorted(ends, number, side="right"))
        place = int(found.spans[row, EVENTS_END] - (ends[row] - batch.stopped[row]) + number)
        if place < found.spans[row, EVENTS_END]:
            surely, possibly = self._alike(batch, event_of(batch.block, place, 0, batch.kinds))
        else:
            key = batch.kinds[int(found.place[row, N_MODE])][0]
            surely = possibly = Jump(0.0, 0, "", "stop", key, key, _NOWHERE, _NOWHERE)
        verdicts = [
            OWN if self._waited(surely, wait) != self._waited(possibly, wait)
            else YES if self._waited(surely, wait) else NO
            for wait in self._formulas.waits
        ]  # fmt: skip
        at = int(np.searchsorted(told.codes, code))
        rows = np.insert(told.verdicts, at, np.array(verdicts, np.uint8), axis=0)
        return Told(np.insert(told.codes, at, code), rows)

    def _alike(self, batch: Batch, event: RecordedEvent) -> tuple[Jump, Jump]:
        """Return a jump like an event, with those impulses that it has surely, and possibly."""
        region, cause = batch.modes.about(event)
        hit = [region] if event.struck >= 0 and (event.normal or event.tangential) else []
        every = [one.name for one in self._regions] if event.group else hit
        surely, possibly = (
            Jump(
                0.0, 0, region, cause, event.source, event.target, _NOWHERE, _NOWHERE,
                impulse=dict.fromkeys(struck, (1.0, 0.0)),
            )
            for struck in (hit, every)
        )  # fmt: skip
        return surely, possibly

    def _settle(self, batch: Batch, made: _Made, values: Values) -> None:
        """Decide of events that are each one's own whether they are waited for."""
        number = 0
        for row, stopped in enumerate(batch.stopped.tolist()):
            begin, end = batch.found.spans[row, EVENTS : EVENTS_END + 1].tolist()
            for j in range(end - begin):
                for k in np.flatnonzero(values.happens[number] == OWN).tolist():
                    waited = self._waited(made(row, j), self._formulas.waits[k])
                    values.happens[number, k] = waited
                number += 1
            number += stopped

    def _waited(self, jump: Jump, wait: tuple[Event, ...]) -> bool:
        return any(happened(self._regions, jump, event) for event in wait)


def modes_of(batch: Batch) -> list[tuple[Key, ...]]:
    """Return the modes of each row, in order (see `Trace.modes`)."""
    keys = [kind[0] for kind in batch.kinds]
    sequences: dict[bytes, tuple[Key, ...]] = {}
    found = []
    targets = batch.block.events[:, TARGET]
    firsts = batch.found.ends[:, FIRST_MODE].tolist()
    spans = batch.found.spans[:, EVENTS : EVENTS_END + 1].tolist()
    for first, (begin, end) in zip(firsts, spans, strict=True):
        entered = targets[begin:end]
        code = bytes((first,)) + entered.tobytes() if first < 256 else entered.tobytes()
        known = sequences.get(code) if first < 256 else None
        if known is None:
            visited = [keys[first]]
            for kind in entered.tolist():
                if keys[kind] != visited[-1]:
                    visited.append(keys[kind])
            known = sequences[code] = tuple(visited)
        found.append(known)
    return found
