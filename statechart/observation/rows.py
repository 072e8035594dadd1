"""Outputs of many runs at once: what `statechart.observation.outputs` gives of each."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Bools, Ints
from statechart.automaton.events import happened
from statechart.automaton.recording import event_of
from statechart.automaton.trace import Jump, Key
from statechart.documents.outputs import Event, Moment
from statechart.execution.ahead import N_JUMPS, N_MODE, T_HIGH
from statechart.execution.rows import (
    EVENTS,
    EVENTS_END,
    FIRST_MODE,
    Batch,
    RowRunner,
)
from statechart.observation.outputs import Outputs
from statechart.observation.row_formulas import Points

# Columns of the events of a block.
_SOURCE, _TARGET, _STRUCK, _GROUP = 0, 1, 4, 5
# Columns of their numbers.
_TIME, _NORMAL, _TANGENTIAL = 0, 4, 5
_STOP = -1
"""As the place of an event in its block: a stop, which stands in none."""

_Zeros = frozenset[int]


class _Events(NamedTuple):
    """The events of all rows, in order, stops among them.

    Attributes
    ----------
    owners : (e,) array of int64
        The row of each.
    places : (e,) array of int64
        In the block; `_STOP` for a stop.
    alike : (e,) array of int
        Which of `examples` it is like, for all that outputs wait for.
    examples : (k,) array of int
        An event of each kind.
    """

    owners: Ints
    places: Ints
    alike: NDArray[np.intp]
    examples: NDArray[np.intp]


class RowOutputs:
    """Some outputs of a model, of batches of rows.

    Parameters
    ----------
    outputs : Outputs
        Those of a run.
    runner : RowRunner
        What makes the rows.
    """

    def __init__(self, outputs: Outputs, runner: RowRunner) -> None:
        self._outputs, self._runner = outputs, runner
        self._regions = outputs.observer.automaton.regions
        self._formulas = outputs.formulas
        self._verdicts: dict[tuple[_Zeros, tuple[int, ...], tuple[Event, ...]], bool | None] = {}

    def of(self, batch: Batch, table: Array) -> tuple[dict[str, Array], dict[str, list[Array]]]:
        """Return the outputs of rows: numbers (m,), and lists, a row of each.

        Parameters
        ----------
        batch : Batch
        table : (m, p) array
            Values of the parameters that vary.
        """
        outputs, found = self._outputs, batch.found
        m = len(found.ends)
        numbers: dict[str, Array] = {}
        lists: dict[str, list[Array]] = {}
        if outputs.at or outputs.counts:
            events = _events(batch)
            for name, output, moment in outputs.at:
                happens = self._happened(batch, events, moment.events, table)
                chosen = _chosen(events.owners, np.flatnonzero(happens), moment)
                points = _at(batch, events, chosen, output.before)
                values = self._formulas.values(batch, [output.value], points)[:, 0]
                if moment.several:
                    counts = np.bincount(points.owners, minlength=m)
                    lists[name] = np.split(values, np.cumsum(counts)[:-1])
                else:
                    numbers[name] = np.full(m, np.nan)
                    numbers[name][points.owners] = values
            for name, wait in outputs.counts:
                happens = self._happened(batch, events, wait, table)
                numbers[name] = np.bincount(events.owners[happens], minlength=m).astype(float)
        rows = np.arange(m)
        for group, points in (
            (outputs.start, Points(rows, found.ends[:, FIRST_MODE], np.zeros(m), found.initial)),
            (
                outputs.end,
                Points(rows, found.place[:, N_MODE], found.now[:, T_HIGH], found.final),
            ),
        ):
            if group:
                columns = self._formulas.values(batch, list(group.values()), points).T
                numbers |= zip(group, columns, strict=True)
        if outputs.integrals:
            numbers |= zip(
                outputs.integrals, self._formulas.integrals(batch, outputs.integrals).T, strict=True
            )
        for name, formula, which in outputs.extremes:
            numbers[name] = self._formulas.extremes(batch, formula)[:, which]
        return numbers, lists

    def _happened(
        self, batch: Batch, events: _Events, wait: tuple[Event, ...], table: Array
    ) -> Bools:
        """Tell which events (e,) are one of those that are waited for."""
        verdicts = [self._verdict(batch, events, k, wait) for k in events.examples.tolist()]
        known = np.array([verdict is not False for verdict in verdicts], dtype=bool)
        result = known[events.alike] if len(verdicts) else np.zeros(0, dtype=bool)
        open_ones = {k for k, verdict in enumerate(verdicts) if verdict is None}
        if open_ones:
            for event in np.flatnonzero(np.isin(events.alike, list(open_ones))).tolist():
                jump = self._jump(batch, events, event, table)
                result[event] = any(happened(self._regions, jump, one) for one in wait)
        return np.asarray(result)

    def _verdict(
        self, batch: Batch, events: _Events, example: int, wait: tuple[Event, ...]
    ) -> bool | None:
        """Tell whether events like one are waited for; None where that is each one's own."""
        place = int(events.places[example])
        code = _code(batch, int(events.owners[example]), place)
        key = batch.zeros, code, wait
        if key not in self._verdicts:
            jump, others = self._alike(batch, int(events.owners[example]), place)
            found = {any(happened(self._regions, one, e) for e in wait) for one in (jump, others)}
            self._verdicts[key] = None if len(found) > 1 else found.pop()
        return self._verdicts[key]

    def _alike(self, batch: Batch, row: int, place: int) -> tuple[Jump, Jump]:
        """Return a jump like an event, with those impulses that it has surely, and possibly."""
        block, nowhere = batch.block, np.empty(0)
        if place == _STOP:
            mode = batch.kinds[int(batch.found.place[row, N_MODE])][0]
            jump = Jump(0.0, 0, "", "stop", mode, mode, nowhere, nowhere)
            return jump, jump
        event = event_of(block, place, 0, batch.kinds)
        region, cause = batch.modes.about(event)
        hit = [region] if event.struck >= 0 and (event.normal or event.tangential) else []
        every = [one.name for one in self._regions] if event.group else hit
        jumps = [
            Jump(
                0.0, 0, region, cause, event.source, event.target, nowhere, nowhere,
                impulse=dict.fromkeys(struck, (1.0, 0.0)),
            )
            for struck in (hit, every)
        ]  # fmt: skip
        return jumps[0], jumps[1]

    def _jump(self, batch: Batch, events: _Events, event: int, table: Array) -> Jump:
        """Return the jump of an event itself."""
        row, place = int(events.owners[event]), int(events.places[event])
        setup = partial(self._runner.setup, table[row])
        j = place - int(batch.found.spans[row, EVENTS])
        return batch.modes.jump(setup, event_of(batch.block, place, j, batch.kinds))


def modes_of(batch: Batch) -> list[tuple[Key, ...]]:
    """Return the modes of each row, in order (see `Trace.modes`)."""
    keys = [kind[0] for kind in batch.kinds]
    sequences: dict[bytes, tuple[Key, ...]] = {}
    found = []
    targets = batch.block.events[:, _TARGET]
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


def _events(batch: Batch) -> _Events:
    found, stopped = batch.found, np.flatnonzero(batch.stopped)
    begins, counts = found.spans[:, EVENTS], found.place[:, N_JUMPS]
    owners = np.repeat(np.arange(len(begins)), counts)
    places = np.arange(len(owners)) + np.repeat(begins - np.cumsum(counts) + counts, counts)
    codes = _codes(batch, places)
    owners, places = np.append(owners, stopped), np.append(places, np.full(len(stopped), _STOP))
    # A stop is like others in its mode.
    codes = np.append(codes, -1 - found.place[stopped, N_MODE])
    order = np.argsort(owners, kind="stable")
    _, examples, alike = np.unique(codes[order], return_index=True, return_inverse=True)
    return _Events(owners[order], places[order], alike.ravel(), examples)


def _codes(batch: Batch, places: Ints) -> Ints:
    """Return a number for each event that is that of others like it."""
    events, numbers = batch.block.events[places].astype(np.int64), batch.block.numbers[places]
    hit = (numbers[:, _NORMAL] != 0.0) | (numbers[:, _TANGENTIAL] != 0.0)
    kinds, struck = len(batch.kinds), len(batch.kinds[0][0]) + 1
    pairs = events[:, _SOURCE] * kinds + events[:, _TARGET]
    code = (pairs * struck + events[:, _STRUCK] + 1) * 4 + 2 * (events[:, _GROUP] != 0) + hit
    return np.asarray(code)


def _code(batch: Batch, row: int, place: int) -> tuple[int, ...]:
    """Return the same of one event, whatever other kinds there are."""
    if place == _STOP:
        return (_STOP, int(batch.found.place[row, N_MODE]))
    source, target, _, _, struck, group = batch.block.events[place].tolist()
    normal, tangential = batch.block.numbers[place, _NORMAL:].tolist()
    return source, target, struck, group != 0, normal != 0.0 or tangential != 0.0


def _chosen(owners: Ints, happens: NDArray[np.intp], moment: Moment) -> NDArray[np.intp]:
    """Return the first, the last or each of the events of every row that happen."""
    if moment.when == "each" or not happens.size:
        return happens
    mine = owners[happens]
    _, begins, counts = np.unique(mine, return_index=True, return_counts=True)
    rank = np.arange(len(mine)) - np.repeat(begins, counts)
    if moment.when == "last":
        rank = np.repeat(counts, counts) - 1 - rank
    return happens[rank < (moment.most or 1)]


def _at(batch: Batch, events: _Events, chosen: NDArray[np.intp], before: bool) -> Points:
    """Return the points just before events, or just after them."""
    block, found = batch.block, batch.found
    owners, places = events.owners[chosen], events.places[chosen]
    stops = places == _STOP
    side = _SOURCE if before else _TARGET
    kinds = block.events[places, side].astype(np.int64)
    times, states = block.numbers[places, _TIME], block.states[places, 0 if before else 1]
    kinds[stops] = found.place[owners[stops], N_MODE]
    times[stops] = found.now[owners[stops], T_HIGH]
    states[stops] = found.final[owners[stops]]
    return Points(owners, kinds, times, states)
