"""Outputs of runs that compiled loops made, of one or of hundreds, in one compiled call.

Tapes of the formulas are evaluated on the arrays that the loop has left: no arc and no jump is made
of them. One call for a run of the toppling stick takes 15 us, a tenth of the run;
`OutputAccumulator` takes ten times as long, and gives the same numbers for runs of every kind.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.regions import happened
from statechart.automaton.trace import Jump, Key
from statechart.automaton.trace_store import TraceBuffer, event_of
from statechart.documents.outputs import Count, Event, Integral, Maximum, Minimum, Moment, Value
from statechart.engines.compiled_flow import TAPE, tape_of
from statechart.execution import compiled_loop as runs
from statechart.execution.compiled_loop import (
    ARCS,
    ARCS_END,
    EVENTS,
    EVENTS_END,
    Batch,
    BatchResult,
    Packed,
)
from statechart.execution.simulator import Simulator
from statechart.kernels.boxes import Steps
from statechart.kernels.extremes import widen
from statechart.kernels.jit import entry, kernel
from statechart.kernels.quadrature import integrate_outputs
from statechart.kernels.tapes import TapeCode, tape_values
from statechart.observation.observer import Observer
from statechart.observation.sampling import Where, seen, wanted

OutputValue = float | int | list[float] | None
"""A number; a list for a value at `each` event; None where the event never happened."""

_Formula = str | int | float

NO, YES, OWN = range(3)
"""Whether an output waits for an event; `OWN`: events like it differ in that."""

WAIT, MOST, BEFORE = range(3)
"""Columns of `BatchFormulas.moments`."""

# Columns of the events of a buffer, and of their numbers.
SOURCE, TARGET, STRUCK, GROUP = 0, 1, 4, 5
TIME, NORMAL = 0, 4

_Verdicts = dict[tuple[Any, ...], tuple[int, ...]]

_NOWHERE = np.empty(0)


class OutputGroups:
    """The declared outputs of a model, grouped by what they are computed from."""

    def __init__(self, observer: Observer, names: Collection[str] | None = None) -> None:
        self.observer = observer
        declared = observer.automaton.declaration.outputs
        if names is not None:
            declared = {name: output for name, output in declared.items() if name in names}
        self.names = tuple(declared)
        self.at: list[tuple[str, Value, Moment]] = []
        self.counts: list[tuple[str, tuple[Event, ...]]] = []
        self.extremes: list[tuple[str, _Formula, int]] = []
        # One call of a kernel for each of these groups.
        self.start: dict[str, _Formula] = {}
        self.end: dict[str, _Formula] = {}
        self.integrals: dict[str, Integral] = {}
        for name, output in declared.items():
            match output:
                case Value():
                    moment = output.moment
                    if moment.events:
                        self.at.append((name, output, moment))
                    else:
                        values = self.end if moment.when == "end" else self.start
                        values[name] = output.value
                case Integral():
                    self.integrals[name] = output
                case Count():
                    self.counts.append((name, output.events))
                case Minimum():
                    self.extremes.append((name, output.minimum, 0))
                case Maximum():
                    self.extremes.append((name, output.maximum, 1))


class BatchFormulas(NamedTuple):
    """Formulas of the outputs, for every kind of mode, as packed tapes."""

    # (..,): see `statechart.execution.compiled_loop.Packed`.
    ints: Ints32
    floats: Array
    # (k, 9): tapes of the formulas of a group, one for each kind of mode.
    start: Ints
    end: Ints
    integrals: Ints
    columns: Ints  # (k, f): integral to which each output of `integrals` is added.
    # Tapes of each output at events, and of each formula of an extreme.
    values: Ints  # shape (a, k, 9)
    extremes: Ints  # shape (x, k, 9)
    # (a, 3): of outputs at events: the wait, the number of events (the last ones if negative, all
    # if 0), and whether the state before the event counts.
    moments: Ints
    counts: Ints  # (c,): wait of each count.


class BatchValues(NamedTuple):
    """Values of the outputs of m runs."""

    # Values at events, run by run, and the number of values of each run.
    listed: Array  # shape (a, e)
    tally: Ints  # shape (a, m)
    counted: Ints  # shape (c, m)
    # of shape (m, ..) each
    start: Array
    end: Array
    integrals: Array
    extremes: Array  # shape (x, m, 2)


class BatchOutputs:
    """Computes the outputs of batches of runs."""

    def __init__(self, outputs: OutputGroups) -> None:
        assert isinstance(outputs.observer.simulator, Simulator)
        self._outputs, self._simulator = outputs, outputs.observer.simulator
        self._regions = outputs.observer.automaton.regions
        waits = [moment.events for _, _, moment in outputs.at]
        waits += [events for _, events in outputs.counts]
        self._waits = tuple(dict.fromkeys(waits))
        self._extremes = tuple(dict.fromkeys(formula for _, formula, _ in outputs.extremes))
        # By zero parameters and number of kinds: the formulas, and which waits events end.
        self._known: dict[tuple[frozenset[int], int], tuple[BatchFormulas, _Verdicts]] = {}
        self._kernel: Callable[..., None] | None = None

    def of(
        self, batch: Batch, made: Callable[[int, int], Jump]
    ) -> tuple[dict[str, Array], dict[str, list[Array]]]:
        """Return the outputs of a batch: numbers (m,), and lists, one for each run.

        A value at an event that never happened is not a number. `made` returns the jump of a run
        by the number of jumps before it.
        """
        outputs, values = self._outputs, self._values(batch, made)
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
        numbers |= zip(outputs.start, values.start.T, strict=True)
        numbers |= zip(outputs.end, values.end.T, strict=True)
        numbers |= zip(outputs.integrals, values.integrals.T, strict=True)
        for name, formula, which in outputs.extremes:
            numbers[name] = values.extremes[self._extremes.index(formula), :, which]
        return numbers, lists

    def of_single(self, batch: Batch, jumps: Sequence[Jump]) -> dict[str, OutputValue]:
        """Return the outputs of a batch of one run."""
        outputs, values = self._outputs, self._values(batch, lambda _, j: jumps[j])
        found: dict[str, OutputValue] = {}
        for (name, _, moment), listed, (count,) in zip(
            outputs.at, values.listed.tolist(), values.tally.tolist(), strict=True
        ):
            one = listed[0] if count else None
            found[name] = listed[:count] if moment.several else one
        for (name, _), (counted,) in zip(outputs.counts, values.counted.tolist(), strict=True):
            found[name] = counted
        found |= zip(outputs.start, values.start[0].tolist(), strict=True)
        found |= zip(outputs.end, values.end[0].tolist(), strict=True)
        found |= zip(outputs.integrals, values.integrals[0].tolist(), strict=True)
        for name, formula, which in outputs.extremes:
            found[name] = values.extremes.item(self._extremes.index(formula), 0, which)
        return found

    def _values(self, batch: Batch, made: Callable[[int, int], Jump]) -> BatchValues:
        outputs, found = self._outputs, batch.found
        key = batch.zeros, len(batch.kinds)
        if key not in self._known:
            self._known[key] = self._compiled(batch), {}
        formulas, verdicts = self._known[key]
        happens = self._events(batch, verdicts, made)
        m, events = len(found.ends), len(happens)
        values = BatchValues(
            np.empty((len(outputs.at), events)),
            np.empty((len(outputs.at), m), np.int64),
            np.empty((len(outputs.counts), m), np.int64),
            np.empty((m, len(outputs.start))),
            np.empty((m, len(outputs.end))),
            np.empty((m, len(outputs.integrals))),
            np.empty((len(self._extremes), m, 2)),
        )
        arguments = formulas, batch.block, found, happens, values
        if self._kernel is None:
            self._kernel = entry(batch_outputs, *arguments)
        self._kernel(*arguments)
        return values

    def _events(
        self, batch: Batch, verdicts: _Verdicts, made: Callable[[int, int], Jump]
    ) -> NDArray[np.uint8]:
        """Tell for every event of all runs (e, w), a stop being one, which waits it ends.

        Verdicts are kept by what decides them: modes, the region struck, and impulses.
        """
        block, found = batch.block, batch.found
        spans, ends = found.spans.tolist(), found.ends.tolist()
        happens: list[tuple[int, ...]] = []
        first, last = spans[0][EVENTS], spans[-1][EVENTS_END]
        rows, impulses = block.events[first:last].tolist(), block.numbers[first:last].tolist()
        for row, (span, end) in enumerate(zip(spans, ends, strict=True)):
            for place in range(span[EVENTS], span[EVENTS_END]):
                source, target, _, _, struck, group = rows[place - first]
                normal, tangential = impulses[place - first][NORMAL:]
                key = source, target, struck, group != 0, normal != 0.0 or tangential != 0.0
                verdict = verdicts.get(key)
                if verdict is None:
                    event = event_of(block, place, 0, batch.kinds)
                    region, cause = batch.modes.about(event)
                    hit = [region] if struck >= 0 and key[-1] else []
                    every = [one.name for one in self._regions] if group else hit
                    modes = event.source, event.target
                    verdict = verdicts[key] = self._verdict(region, cause, modes, hit, every)
                if OWN in verdict:
                    jump = made(row, place - span[EVENTS])
                    verdict = tuple([self._ends(jump, wait) for wait in self._waits])
                happens.append(verdict)
            if end[runs.HOW] == runs.STOPPED:
                kind = int(found.place[row, runs.N_MODE])
                stopped = verdicts.get((kind,))
                if stopped is None:
                    mode = batch.kinds[kind][0]
                    stopped = self._verdict("", "stop", (mode, mode), [], [])
                    verdicts[kind,] = stopped
                happens.append(stopped)
        return np.array(happens, np.uint8).reshape(len(happens), len(self._waits))

    def _verdict(
        self, region: str, cause: str, modes: tuple[Key, Key], hit: list[str], every: list[str]
    ) -> tuple[int, ...]:
        """Tell which waits an event ends that strikes regions `hit` surely, `every` possibly."""
        surely, possibly = (
            Jump(
                0.0, 0, region, cause, *modes, _NOWHERE, _NOWHERE,
                impulse=dict.fromkeys(struck, (1.0, 0.0)),
            )
            for struck in (hit, every)
        )  # fmt: skip
        pairs = [(self._ends(surely, wait), self._ends(possibly, wait)) for wait in self._waits]
        return tuple(sure if sure == possible else OWN for sure, possible in pairs)

    def _ends(self, jump: Jump, wait: tuple[Event, ...]) -> int:
        return YES if any(happened(self._regions, jump, event) for event in wait) else NO

    def _compiled(self, batch: Batch) -> BatchFormulas:
        """Return the formulas for the kinds of modes of a batch."""
        outputs, packed = self._outputs, Packed()
        everywhere = ((),)
        moments = [
            (self._waits.index(moment.events), _most(moment), output.before)
            for _, output, moment in outputs.at
        ]
        integrals = tuple([output.integral for output in outputs.integrals.values()])
        during = wanted([output.during for output in outputs.integrals.values()])

        def together(formulas: Sequence[_Formula]) -> Ints:
            return self._taped(packed, batch, tuple(formulas), everywhere * len(formulas))[0]

        def apart(formulas: Sequence[_Formula]) -> Ints:
            tapes = [together([formula]) for formula in formulas]
            return np.array(tapes, np.int64).reshape(len(tapes), len(batch.kinds), TAPE)

        start, end = together([*outputs.start.values()]), together([*outputs.end.values()])
        over, columns = self._taped(packed, batch, integrals, during)
        values, extremes = (
            apart([output.value for _, output, _ in outputs.at]),
            apart(self._extremes),
        )
        counts = [self._waits.index(events) for _, events in outputs.counts]
        return BatchFormulas(
            *packed.arrays(), start, end, over, columns, values, extremes,
            np.array(moments, np.int64).reshape(len(moments), 3), np.array(counts, np.int64),
        )  # fmt: skip

    def _taped(
        self,
        packed: Packed,
        batch: Batch,
        formulas: tuple[_Formula, ...],
        where: tuple[Where, ...],
    ) -> tuple[Ints, Ints]:
        """Add the tapes of formulas in every kind of mode; return these and their columns."""
        programs = self._outputs.observer.programs
        expressions = programs.expressions(formulas)
        tapes = np.zeros((len(batch.kinds), TAPE), np.int64)
        columns = np.zeros((len(batch.kinds), len(expressions)), np.int64)
        for place, kind in enumerate(batch.kinds):
            active = programs.active(kind[0], where, expressions)
            if not (active.places and batch.modes.knows(kind)):
                continue
            mode = self._simulator.compiled(kind[1], batch.zeros).mode if active.needed else None
            tapes[place] = packed.tape(programs.tape(seen(active.expressions, mode), mode))
            columns[place, : len(active.places)] = active.places
        return tapes, columns


def _most(moment: Moment) -> int:
    """Return the number of events chosen: the first ones, the last if negative, each if 0."""
    if moment.when == "each":
        return 0
    return (moment.most or 1) if moment.when == "first" else -(moment.most or 1)


@kernel
def _program(formulas: BatchFormulas, tape: Ints) -> TapeCode:
    # Only the packed arrays are read, which both have.
    return tape_of(formulas, tape)  # type: ignore[arg-type]


@kernel
def _evaluate(
    formulas: BatchFormulas, tape: Ints, state: Array, parameters: Array, time: float, result: Array
) -> None:
    if tape[5] > 0:
        code, constants, outputs, _, _ = _program(formulas, tape)
        tape_values(code, constants, outputs, state, parameters, time, result)


@kernel
def _number_of_events(found: BatchResult, row: int) -> int:
    """Return the number of events of a run; its stop, which stands in no buffer, is one."""
    count = found.spans[row, EVENTS_END] - found.spans[row, EVENTS]
    return count + (1 if found.ends[row, runs.HOW] == runs.STOPPED else 0)


@kernel
def _at_events(
    formulas: BatchFormulas,
    block: TraceBuffer,
    found: BatchResult,
    happens: NDArray[np.uint8],
    output: int,
    values: BatchValues,
) -> None:
    """Write the values of an output at its events."""
    wait, most, before = formulas.moments[output]
    first, at = 0, 0
    for row in range(found.ends.shape[0]):
        begin, end = found.spans[row, EVENTS], found.spans[row, EVENTS_END]
        total = _number_of_events(found, row)
        happening = 0
        for k in range(total):
            happening += happens[first + k, wait]
        skipped = max(happening + most, 0) if most < 0 else 0
        left = happening - skipped if most <= 0 else min(most, happening)
        values.tally[output, row] = left
        for k in range(total):
            if happens[first + k, wait] == 0:
                continue
            if skipped > 0:
                skipped -= 1
                continue
            if left == 0:
                break
            left -= 1
            event, kind = begin + k, found.place[row, runs.N_MODE]
            state, time = found.final[row], found.now[row, runs.T_HIGH]
            if event < end:
                kind = np.int64(block.events[event, SOURCE if before else TARGET])
                state, time = block.states[event, 0 if before else 1], block.numbers[event, TIME]
            result = values.listed[output, at : at + 1]
            result[0] = np.nan
            _evaluate(
                formulas, formulas.values[output, kind], state, found.values[row], time, result
            )
            at += 1
        first += total


@kernel
def _arc_of(block: TraceBuffer, arc: int, variables: int) -> tuple[Array, Array]:
    """Return the times and the coefficients of an arc."""
    steps, width = np.int64(block.arcs[arc, 2]), np.int64(block.arcs[arc, 3])
    at, place = block.places[arc, 0], block.places[arc, 1]
    terms = block.coefficients[place : place + steps * variables * width]
    return block.times[at : at + steps + 1], terms.reshape((steps, variables, width))


@kernel
def _integrate(
    formulas: BatchFormulas, block: TraceBuffer, found: BatchResult, totals: Array
) -> None:
    """Add up the integrals (m, f) along the arcs of runs."""
    totals[:] = 0.0
    for row in range(found.spans.shape[0]):
        for arc in range(found.spans[row, ARCS], found.spans[row, ARCS_END]):
            tape = formulas.integrals[block.arcs[arc, 0]]
            if tape[5] == 0:
                continue
            times, terms = _arc_of(block, arc, found.final.shape[1])
            steps = Steps(times, terms, found.values[row], block.starts[arc, 0])
            sums, _ = integrate_outputs(_program(formulas, tape), steps, 0.0, times[-1])
            for i in range(sums.shape[0]):
                totals[row, formulas.columns[block.arcs[arc, 0], i]] += sums[i]


@kernel
def _include(extremes: Array, value: Array) -> None:
    """Widen an interval (2,), not numbers at first, to a value (1,); make that not a number."""
    if not value[0] >= extremes[0] and value[0] == value[0]:
        extremes[0] = value[0]
    if not value[0] <= extremes[1] and value[0] == value[0]:
        extremes[1] = value[0]
    value[0] = math.nan


@kernel
def _widen_by_arcs(
    formulas: BatchFormulas,
    tapes: Ints,
    block: TraceBuffer,
    found: BatchResult,
    row: int,
    result: Array,
) -> None:
    for arc in range(found.spans[row, ARCS], found.spans[row, ARCS_END]):
        times, terms = _arc_of(block, arc, found.final.shape[1])
        steps = Steps(times, terms, found.values[row], block.starts[arc, 0])
        tape = _program(formulas, tapes[block.arcs[arc, 0]])
        widen(tape, steps, terms, block.starts[arc, 1], result)


@kernel
def _extremes(
    formulas: BatchFormulas, block: TraceBuffer, found: BatchResult, formula: int, result: Array
) -> None:
    """Write the least and the greatest value (m, 2) of a formula."""
    tapes, value = formulas.extremes[formula], np.full(1, math.nan)
    for row in range(found.spans.shape[0]):
        parameters, first = found.values[row], found.ends[row, runs.FIRST_MODE]
        last, time = found.place[row, runs.N_MODE], found.now[row, runs.T_HIGH]
        result[row] = math.nan
        _evaluate(formulas, tapes[first], found.initial[row], parameters, 0.0, value)
        _include(result[row], value)
        _widen_by_arcs(formulas, tapes, block, found, row, result[row])
        arc, begin = found.spans[row, ARCS], found.spans[row, EVENTS]
        for event in range(begin, found.spans[row, EVENTS_END]):
            while arc < found.spans[row, ARCS_END] and block.arcs[arc, 1] <= event - begin:
                arc += 1
            if arc < found.spans[row, ARCS_END] and block.arcs[arc, 1] == event - begin + 1:
                continue
            # A mode without duration follows the event.
            target, at = np.int64(block.events[event, TARGET]), block.numbers[event, TIME]
            _evaluate(formulas, tapes[target], block.states[event, 1], parameters, at, value)
            _include(result[row], value)
        _evaluate(formulas, tapes[last], found.final[row], parameters, time, value)
        _include(result[row], value)


@kernel(interpreted=False)
def batch_outputs(
    formulas: BatchFormulas,
    block: TraceBuffer,
    found: BatchResult,
    happens: NDArray[np.uint8],
    values: BatchValues,
) -> None:
    """Write the outputs of runs.

    Parameters
    ----------
    formulas : BatchFormulas
    block : TraceBuffer
        Holds the arcs and events of the runs.
    found : BatchResult
        The runs.
    happens : (e, w) array of uint8
        Which events, run by run, each wait ends.
    values : BatchValues
        To be filled.
    """
    for output in range(formulas.moments.shape[0]):
        _at_events(formulas, block, found, happens, output, values)
    for row in range(found.ends.shape[0]):
        parameters, last = found.values[row], found.place[row, runs.N_MODE]
        first, time = found.ends[row, runs.FIRST_MODE], found.now[row, runs.T_HIGH]
        start, end = formulas.start[first], formulas.end[last]
        _evaluate(formulas, start, found.initial[row], parameters, 0.0, values.start[row])
        _evaluate(formulas, end, found.final[row], parameters, time, values.end[row])
    for k in range(formulas.counts.shape[0]):
        event = 0
        for row in range(found.ends.shape[0]):
            values.counted[k, row] = 0
            for _ in range(_number_of_events(found, row)):
                values.counted[k, row] += happens[event, formulas.counts[k]]
                event += 1
    if formulas.columns.shape[1] > 0:
        _integrate(formulas, block, found, values.integrals)
    for formula in range(formulas.extremes.shape[0]):
        _extremes(formulas, block, found, formula, values.extremes[formula])


def modes_of(batch: Batch) -> list[tuple[Key, ...]]:
    """Return the modes of each run of a batch, in order (see `Trace.modes`)."""
    keys = [kind[0] for kind in batch.kinds]
    sequences: dict[tuple[int, bytes], tuple[Key, ...]] = {}
    found = []
    targets = batch.block.events[:, TARGET]
    firsts = batch.found.ends[:, runs.FIRST_MODE].tolist()
    spans = batch.found.spans[:, EVENTS : EVENTS_END + 1].tolist()
    for first, (begin, end) in zip(firsts, spans, strict=True):
        entered = targets[begin:end]
        code = first, entered.tobytes()
        known = sequences.get(code)
        if known is None:
            visited = [keys[first]]
            for kind in entered.tolist():
                if keys[kind] != visited[-1]:
                    visited.append(keys[kind])
            known = sequences[code] = tuple(visited)
        found.append(known)
    return found
