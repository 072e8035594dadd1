"""Declared outputs, accumulated over the arcs and jumps of runs.

Formulas are compiled to tapes for every kind of mode. One kernel (`output_kernels`) evaluates them
on the arrays of a compiled loop, for one run or hundreds. Arcs and jumps of other runs are packed
into such arrays, piece by piece. `OutputAccumulator` adds up the pieces of either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from itertools import accumulate, pairwise
from operator import add
from typing import Any, TypeAlias, TypeGuard

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from statechart.arrays import Array, Ints
from statechart.automaton.regions import Mode, has_happened
from statechart.automaton.trace import Arc, Jump, Key, Trace
from statechart.automaton.trace_store import Kind, TraceBuffer, trace_buffer
from statechart.documents.outputs import Count, Event, Integral, Maximum, Minimum, Moment, Value
from statechart.engines.compiled_flow import TAPE
from statechart.execution import compiled_loop as loop
from statechart.execution.compiled_loop import Batch, BatchResult, Packed
from statechart.execution.simulator import Simulator
from statechart.kernels.jit import entry, is_ready
from statechart.observation.alignment import last_resolved
from statechart.observation.observer import FormulaLike, Observer
from statechart.observation.output_kernels import (
    NORMAL,
    SOURCE,
    TARGET,
    TIME,
    OutputTapes,
    OutputValues,
    compute_outputs,
)
from statechart.observation.sampling import (
    Endpoint,
    Where,
    at_endpoints,
    end_of,
    instantaneous_modes,
    places_in,
    side_of,
    start_of,
    visible_expressions,
)
from statechart.observation.scales import OutputValue, RunScales, Scales

Formula: TypeAlias = "FormulaLike | Callable[[Key], FormulaLike | None]"
"""A formula, or a function of the mode; None where undefined."""
_Marks = NDArray[np.uint8]


class Outputs:
    """The declared outputs of a model, compiled for many runs."""

    def __init__(
        self,
        observer: Observer,
        names: Collection[str] | None = None,
        watched: Sequence[Formula] = (),
    ) -> None:
        self.observer = observer
        declared = observer.automaton.declaration.outputs
        if names is not None:
            declared = {name: output for name, output in declared.items() if name in names}
        self.names = tuple(declared)
        values = [(n, one, one.moment) for n, one in declared.items() if isinstance(one, Value)]
        self.at = [one for one in values if one[2].events]
        ends = [(name, one.value, moment.when) for name, one, moment in values if not moment.events]
        self.start = {name: formula for name, formula, when in ends if when != "end"}
        self.end = {name: formula for name, formula, when in ends if when == "end"}
        self.integrals = {n: one for n, one in declared.items() if isinstance(one, Integral)}
        self.counts = [(n, one.events) for n, one in declared.items() if isinstance(one, Count)]
        self.extremes = [(n, o.minimum, 0) for n, o in declared.items() if isinstance(o, Minimum)]
        self.extremes += [(n, o.maximum, 1) for n, o in declared.items() if isinstance(o, Maximum)]
        self.watched = (*dict.fromkeys(formula for _, formula, _ in self.extremes), *watched)
        waits = [moment.events for _, _, moment in self.at]
        self._waits = tuple(dict.fromkeys([*waits, *(events for _, events in self.counts)]))
        # The sets of events of values and of counts, and the column of modes of zero duration.
        self.value_waits = [self._waits.index(events) for events in waits]
        self.count_waits = [self._waits.index(events) for _, events in self.counts]
        self.passed = len(self._waits)
        # Data of a jump that determine its marks -> marks.
        self._marked: dict[tuple[Any, ...], tuple[int, ...]] = {}
        # By zero parameters: kinds of modes, and tapes (also by number of kinds).
        self.numbers: dict[frozenset[int], dict[Kind, int]] = {}
        self._verdicts: dict[frozenset[int], dict[tuple[Any, ...], tuple[int, ...]]] = {}
        self._tapes: dict[tuple[bool, frozenset[int], int], OutputTapes] = {}
        self._entry: Callable[..., None] | None = None

    @cached_property
    def needs_modes(self) -> bool:
        """True if formulas use unknowns (accelerations or forces)."""
        programs, formulas = self.observer.programs, [output.value for _, output, _ in self.at]
        formulas += [*self.start.values(), *self.end.values()]
        formulas += [output.integral for output in self.integrals.values()]
        watched = [one for one in self.watched if not _by_mode(one)]
        expressions = programs.expressions([*formulas, *watched])
        return len(watched) < len(self.watched) or programs.needed(expressions)

    def of(self, trace: Trace) -> dict[str, OutputValue]:
        """Return the outputs of a run, in the order of the declaration.

        For an event that never happened, values are None, counts 0, lists empty. Raises
        `StatechartError` if a formula cannot be evaluated.
        """
        if trace.outputs is not None:
            return {name: trace.outputs[name] for name in self.names}
        batch = getattr(trace.arcs, "source", None)
        if isinstance(batch, Batch):
            result = self.of_batch(batch, lambda _, j: trace.jumps[j])
            return {name: result[name][0] for name in self.names}
        accumulator = OutputAccumulator(self)
        if accumulator.motion:
            trace.require_motion()
        accumulator.take(trace, trace.arcs, trace.jumps, ended=True)
        return accumulator.result

    def of_batch(
        self, batch: Batch, jump_of: Callable[[int, int], Jump]
    ) -> dict[str, list[OutputValue]]:
        """Return the outputs of a batch, as lists over the runs.

        `jump_of` returns the jump of a run by the number of jumps before it.
        """
        simulator = self.observer.simulator
        assert isinstance(simulator, Simulator)

        def mode(kind: Kind) -> Mode | None:
            known = kind in batch.modes.compiled
            return simulator.modes.compiled(kind[1], batch.zeros).mode if known else None

        tapes = self.tapes(batch.zeros, batch.kinds, mode)
        accumulator = OutputAccumulator(self, len(batch.rows))
        marks = self._marks(batch, jump_of)
        accumulator.accumulate(tapes, batch.block, batch.block.coefficients, batch.result, marks)
        return accumulator.by_run

    def compute(self, *arguments: Any) -> None:
        """Call the kernel; see `entry`."""
        if self._entry is None and is_ready(compute_outputs):
            self._entry = entry(compute_outputs, *arguments)
        (self._entry or compute_outputs)(*arguments)

    def marks_of(self, jump: Jump) -> tuple[int, ...]:
        """Return 1 for each set of events that a jump belongs to, else 0."""
        key = jump.region, jump.cause, jump.source, jump.target, *jump.impulse
        marks = self._marked.get(key)
        if marks is None:
            happened = partial(has_happened, self.observer.automaton.regions, jump)
            marks = tuple([int(any(map(happened, wait))) for wait in self._waits])
            self._marked[key] = marks
        return marks

    def _marks(self, batch: Batch, jump_of: Callable[[int, int], Jump]) -> _Marks:
        """Return the marks of all events of all runs, including stops; see `compute_outputs`.

        Marks are cached by the modes, the regions with impulses, and their causes.
        """
        block, found = batch.block, batch.result
        verdicts = self._verdicts.setdefault(batch.zeros, {})
        spans, ends = found.spans.tolist(), found.ends.tolist()
        marks: list[tuple[int, ...]] = []
        first, last = spans[0][loop.EVENTS], spans[-1][loop.EVENTS_END]
        events, numbers = block.events[first:last].tolist(), block.numbers[first:last].tolist()
        for row, (span, end) in enumerate(zip(spans, ends, strict=True)):
            flows = slice(span[loop.ARCS], span[loop.ARCS_END])
            flowed = {*block.arcs[flows, 1].tolist()} if self.watched else ()
            own = slice(span[loop.EVENTS] - first, span[loop.EVENTS_END] - first)
            for j, (event, number) in enumerate(zip(events[own], numbers[own], strict=True)):
                source, target, _, *codes = event
                key = source, target, *codes, any(number[NORMAL:])
                if key not in verdicts:
                    verdicts[key] = self.marks_of(jump_of(row, j))
                marks.append((*verdicts[key], j + 1 not in flowed))
            if end[loop.HOW] == loop.STOPPED:
                kind = int(found.place[row, loop.N_MODE])
                if (kind,) not in verdicts:
                    mode, state = batch.kinds[kind][0], found.final[row]
                    stop = Jump(0.0, 0, "", "stop", mode, mode, state, state)
                    verdicts[kind,] = self.marks_of(stop)
                marks.append((*verdicts[kind,], 0))
        return np.array(marks, np.uint8).reshape(len(marks), self.passed + 1)

    def tapes(
        self,
        zeros: frozenset[int],
        kinds: Sequence[Kind],
        mode_of: Callable[[Kind], Mode | None],
        solved: bool | None = None,
    ) -> OutputTapes:
        """Return the cached tapes of kinds of modes; see `_taped`. `solved`: None for batches."""
        key = solved is None, zeros, len(kinds)
        if key not in self._tapes:
            self._tapes[key] = self._taped(kinds, mode_of, solved=bool(solved))
        return self._tapes[key]

    def _taped(
        self, kinds: Sequence[Kind], mode_of: Callable[[Kind], Mode | None], *, solved: bool = False
    ) -> OutputTapes:
        """Return the tapes of the formulas for kinds of modes.

        `mode_of` returns the solved mode of a kind, or None; with `solved` the unknowns are stored
        after the variables.
        """
        packed, programs = Packed(), self.observer.programs

        def tapes(formulas: Sequence[Formula], where: tuple[Where, ...]) -> tuple[Ints, Ints, Ints]:
            made, unforced = np.zeros((2, len(kinds) + 1, TAPE), np.int64)
            columns = np.zeros((len(kinds) + 1, len(formulas)), np.int64)
            for place, kind in enumerate(kinds):
                own = [one(kind[0]) if _by_mode(one) else one for one in formulas]
                if None in own:
                    continue
                regions = self.observer.automaton.recorded_regions(kind[0])
                active = places_in(regions, kind[0], where)
                chosen = programs.expressions([one for i in active if (one := own[i]) is not None])
                needed = programs.needed(chosen)
                mode = mode_of(kind) if needed and not solved else None
                if active and (mode is not None or solved or not needed):
                    chosen = visible_expressions(chosen, mode)
                    made[place] = packed.tape(programs.tape(chosen, mode, known=solved))
                    unforced[place] = 0 if needed else made[place]
                    columns[place, : len(active)] = active
            return made, unforced, columns

        def separate_tapes(formulas: Sequence[Formula]) -> Ints:
            found = [tapes([formula], ((),))[:2] for formula in formulas]
            shape = len(found), 2, len(kinds) + 1, TAPE
            return np.ascontiguousarray(np.array(found, np.int64).reshape(shape).swapaxes(0, 1))

        at = separate_tapes([output.value for _, output, _ in self.at])[0]
        start, end = (separate_tapes([*ends.values()])[0] for ends in (self.start, self.end))
        watched, passed = separate_tapes(self.watched)
        integrals = [output.integral for output in self.integrals.values()]
        during = [tuple(output.during.items()) for output in self.integrals.values()]
        made, _, columns = tapes(integrals, tuple(during))
        waits = [(self._waits.index(moment.events), output.before) for _, output, moment in self.at]
        return OutputTapes(
            *packed.arrays(),
            at, start, end, watched, passed, made, columns,
            np.array(waits, np.int64).reshape(len(waits), 2),
        )  # fmt: skip

    def truncated(self, trace: Trace) -> dict[str, tuple[int, ...]]:
        """Return the outputs that count or list events of Zeno sequences, with their cuts.

        The number of resolved events of a sequence depends on tolerance or step. Cuts are the
        numbers of listed values up to the last resolved event of each sequence.
        """
        last = sorted(jump.j for jump in last_resolved(trace))
        moments = [(name, moment) for name, _, moment in self.at if moment.several]
        moments += [(name, Moment("each", events)) for name, events in self.counts]
        found = dict[str, tuple[int, ...]]()
        for name, moment in moments if last else ():
            happened = [jump.j for jump in self._happened(trace, moment.events)]
            if not set(last).isdisjoint(happened):
                listed = happened[_selected_events(moment)]
                # A sequence of bounces in turn may end at an event that is not listed.
                found[name] = tuple(np.searchsorted(listed, last, side="right").tolist())
        return found

    def scales(self, trace: Trace) -> Scales:
        """Return the scales of variables and outputs (see `RunScales`).

        Scales of outputs are in the form of `of`. The scale of a value is the largest magnitude of
        its formula at starts of steps up to its moment, since a return to zero is round-off.
        """
        run, found = RunScales(self.observer, trace), dict[str, OutputValue]()
        formulas = {name: output.value for name, output, _ in self.at}
        for name, output, moment in self.at:
            largest = self._largest(trace, output.value)
            jumps = self._happened(trace, moment.events)[_selected_events(moment)]
            sizes = [run.of(output.value, largest.item(jump.j + 1)) for jump in jumps]
            found[name] = sizes if moment.several else sizes[0] if sizes else None
        whole = {**self.end, **{name: formula for name, formula, _ in self.extremes}}
        integrals = {name: output.integral for name, output in self.integrals.items()}
        for name, formula in {**whole, **integrals}.items():
            size = run.of(formula, self._largest(trace, formula).item(-1))
            found[name] = trace.t_end * size if name in integrals else size
        zeros = {name: run.zero(formula) for name, formula in {**formulas, **whole}.items()}
        return Scales(run.variables, found, run.zeros, zeros)

    def _largest(self, trace: Trace, formula: str | int | float) -> NDArray[np.float64]:
        """Return the largest magnitude (m + 2,) of a formula: at the start, up to jumps, total."""
        values = [self.observer.initial(trace, [formula])]
        if trace.jumps:
            sides = [
                self.observer.at(trace, [formula], trace.jumps, before=before)[:, 0]
                for before in (True, False)
            ]
            values.append(np.fmax(*map(np.abs, sides)))
        magnitudes = np.abs(np.concatenate([*values, [0.0]]))
        if trace.arcs:
            sampled = self.observer.sample(trace, (str(formula),), per_step=1)
            np.fmax.at(magnitudes, sampled.j + 1, np.abs(sampled.columns[str(formula)]))
        magnitudes[~np.isfinite(magnitudes)] = 0.0
        return np.maximum.accumulate(magnitudes)

    def _happened(self, trace: Trace, events: tuple[Event, ...]) -> list[Jump]:
        """Return the jumps at which one of these events happened."""
        place = self._waits.index(events)
        return [jump for jump in trace.jumps if self.marks_of(jump)[place]]


class OutputAccumulator:
    """Accumulates the outputs of runs over pieces; pieces change them by round-off alone.

    A whole run is one piece, and so are the runs of a batch. Pieces of one run are traces, as
    `statechart.automaton.time_stepper.OutputStream` gets them.
    """

    def __init__(self, outputs: Outputs, runs: int = 1, *, started: bool = False) -> None:
        self._outputs, self._observer, self._runs = outputs, outputs.observer, runs
        self._listed: list[list[list[float]]] = [[[] for _ in range(runs)] for _ in outputs.at]
        self._counted = [[0] * runs for _ in outputs.counts]
        self._start = np.empty((runs, len(outputs.start)))
        self._end = np.empty((runs, len(outputs.end)))
        self._integrals = np.zeros((runs, len(outputs.integrals)))
        self.extremes = np.full((len(outputs.watched), runs, 2), math.nan)
        self.started = started
        self._last: tuple[Arc, ...] = ()
        self._waiting: list[Jump] = []

    def accumulate(
        self,
        tapes: OutputTapes,
        block: TraceBuffer,
        resolved: Array,
        result: BatchResult,
        marks: _Marks,
    ) -> None:
        """Process arcs and events of all runs; see `compute_outputs`."""
        outputs, count = self._outputs, self._runs
        listed = np.empty((len(outputs.at), len(marks)))
        start = np.empty_like(self._start) if self.started else self._start
        values = OutputValues(listed, start, self._end, self._integrals, self.extremes)
        outputs.compute(tapes, block, resolved, result, marks, values)
        self.started = True
        totals = [
            span[loop.EVENTS_END] - span[loop.EVENTS] + (end[loop.HOW] == loop.STOPPED)
            for span, end in zip(result.spans.tolist(), result.ends.tolist(), strict=True)
        ]
        owners = np.repeat(np.arange(count), totals)
        tallies = [np.bincount(owners[one > 0], minlength=count).tolist() for one in marks.T[:-1]]
        for place, wait in enumerate(outputs.count_waits):
            self._counted[place] = [*map(add, self._counted[place], tallies[wait])]
        for place, column in enumerate(listed.tolist()):
            known, chosen = self._listed[place], _selected_events(outputs.at[place][2])
            ends = pairwise(accumulate(tallies[outputs.value_waits[place]], initial=0))
            self._listed[place] = [
                (one + column[first:end])[chosen]
                for one, (first, end) in zip(known, ends, strict=True)
            ]

    @property
    def by_run(self) -> dict[str, list[OutputValue]]:
        """The outputs, as lists over the runs."""
        outputs, found = self._outputs, dict[str, Any]()
        for (name, _, moment), runs in zip(outputs.at, self._listed, strict=True):
            found[name] = [*runs] if moment.several else [run[0] if run else None for run in runs]
        found |= zip([name for name, _ in outputs.counts], self._counted, strict=True)
        found |= zip(outputs.start, self._start.T.tolist(), strict=True)
        found |= zip(outputs.end, self._end.T.tolist(), strict=True)
        found |= zip(outputs.integrals, self._integrals.T.tolist(), strict=True)
        for name, formula, which in outputs.extremes:
            found[name] = self.extremes[outputs.watched.index(formula), :, which].tolist()
        return found

    @property
    def events(self) -> bool:
        """True if the output needs jumps and the modes of arcs."""
        outputs = self._outputs
        during = any(output.during for output in outputs.integrals.values())
        return bool(outputs.at or outputs.counts or during)

    @property
    def motion(self) -> bool:
        """True if the output needs the arcs and jumps of the whole run."""
        outputs = self._outputs
        if self.events or outputs.extremes or outputs.integrals:
            return True
        # Forces of a step with an impulse are those of adjacent steps.
        return outputs.needs_modes

    def add(self, piece: Trace) -> None:
        """Process the arcs and jumps since the last call."""
        self._waiting += piece.jumps
        with_last = replace(piece, arcs=(*self._last, *piece.arcs)) if self._last else piece
        if with_last.arcs:
            # Values at a jump may need the unknowns of the steps on both sides.
            last = with_last.arcs[-1].j
            known = [jump for jump in self._waiting if jump.j < last]
            self._waiting = self._waiting[len(known) :]
            self.take(with_last, piece.arcs, known, ended=False)
            self._last = (with_last.arcs[-1],)

    def end(self, piece: Trace) -> dict[str, OutputValue]:
        """Process the end of the run, with the whole run or no arcs; return the outputs."""
        last = piece if piece.arcs else replace(piece, arcs=self._last)
        self.take(last, (), self._waiting, ended=True)
        return self.result

    @property
    def result(self) -> dict[str, OutputValue]:
        """The outputs, in the order of the declaration."""
        found = self.by_run
        return {name: found[name][0] for name in self._outputs.names}

    def take(
        self, trace: Trace, arcs: Sequence[Arc], jumps: Sequence[Jump], *, ended: bool
    ) -> None:
        """Process arcs and adjacent jumps of a trace, from the start of the run on."""
        outputs, width = self._outputs, len(self._observer.programs.solved)
        left = {jump.j for jump in instantaneous_modes(trace)} if outputs.watched else set[int]()
        every = [(*outputs.marks_of(jump), jump.j in left) for jump in jumps]
        marks = np.array(every, np.uint8).reshape(len(every), outputs.passed + 1)
        needed = marks[:, [*outputs.value_waits, outputs.passed]].any(axis=1)
        # Counts need no values.
        for counted, wait in zip(self._counted, outputs.count_waits, strict=True):
            counted[0] += int(np.count_nonzero(marks[~needed, wait]))
        jumps = [jumps[k] for k in np.flatnonzero(needed).tolist()]
        if not (outputs.integrals or outputs.watched):
            arcs = ()
        solved = outputs.needs_modes and trace.step is not None
        by_roles = outputs.needs_modes and not solved
        sides = [side_of(jump, before) for jump in jumps for before in (True, False)]
        instants: list[Endpoint] = [start_of(trace), *sides, end_of(trace)]
        points = at_endpoints(trace, instants, width)
        states, terms = points.states, [arc.coefficients for arc in arcs]
        if solved:
            unknowns = points.unknowns()
            assert unknowns is not None
            states = np.hstack([states, unknowns])
            terms = [np.pad(one, ((0, 0), (0, width), (0, 0))) for one in terms]
            for arc, one in zip(arcs, terms, strict=True):
                one[:, len(trace.variables) :, 0] = arc.solved
        numbers, variables = outputs.numbers.setdefault(trace.zeros, {}), states.shape[1]
        roles = points.roles() if by_roles else [()] * len(instants)
        kinds = [(arc.mode, arc.roles if by_roles else ()) for arc in arcs]
        kinds += [(one.mode, own) for one, own in zip(instants, roles, strict=True)]
        places = [numbers.setdefault(kind, len(numbers)) for kind in kinds]
        sizes = [(len(arc.times), one.size) for arc, one in zip(arcs, terms, strict=True)]
        (times, size), count = np.sum([(0, 0), *sizes], axis=0).tolist(), len(arcs)
        block = trace_buffer(variables, (count, times, size, len(jumps)))
        block.arcs[:, 0], places = places[:count], places[count:]
        block.arcs[:, 2:] = np.reshape([one.shape[::2] for one in terms], (count, 2))
        block.places[:] = np.cumsum([(0, 0), *sizes], axis=0)[:-1]
        block.starts[:] = np.reshape([arc.start for arc in arcs], (count, 2))
        np.concatenate([*(arc.times for arc in arcs), ()], out=block.times)
        np.concatenate([*map(np.ravel, terms), ()], out=block.coefficients)
        block.events[:, [SOURCE, TARGET]] = np.reshape(places[1:-1], (len(jumps), 2))
        block.numbers[:, TIME] = points.times[1:-1:2]
        block.states[:] = states[1:-1].reshape(block.states.shape)
        found = BatchResult.empty(1, len(trace.parameters), variables, 0)
        found.values[0], found.initial[0], found.final[0] = trace.values, states[0], states[-1]
        found.clock[0, loop.T_HIGH], found.spans[0] = trace.t_end, (0, len(arcs), 0, len(jumps))
        # The last kind has no formulas, so that other pieces add nothing.
        found.ends[0, loop.FIRST_MODE] = len(numbers) if self.started else places[0]
        found.place[0, loop.N_MODE] = places[-1] if ended else len(numbers)
        tapes = outputs.tapes(
            trace.zeros, [*numbers], lambda kind: self._observer.modes_of(trace)(kind[1]), solved
        )
        resolved = np.nan_to_num(block.coefficients) if solved else block.coefficients
        self.accumulate(tapes, block, resolved, found, marks[needed])


def _selected_events(moment: Moment) -> slice:
    """Return the selection of the events of a moment."""
    most = moment.most or 1
    slices = {"each": slice(None), "first": slice(most), "last": slice(-most, None)}
    return slices[moment.when]


def undefined_warnings(outputs: Mapping[str, OutputValue]) -> tuple[str, ...]:
    """Return a warning that names the outputs that are NaN."""
    listed = {name: one if isinstance(one, list) else [one] for name, one in outputs.items()}
    names = [n for n, values in listed.items() if any(v is not None and v != v for v in values)]
    why = "a formula has no value there, or steps do not resolve a force"
    return (f"nan in the outputs {', '.join(names)}: {why}",) if names else ()


def outputs_of(observer: Observer) -> Outputs:
    """Return the compiled outputs of the model of an observer."""
    if observer.outputs is None:
        observer.outputs = Outputs(observer)
    result: Outputs = observer.outputs
    return result


def extremes(observer: Observer, trace: Trace, formula: Formula) -> tuple[float, float]:
    """Return minimum and maximum of a formula over a run, including modes of zero duration.

    Undefined values do not count; both are NaN if it is undefined everywhere.
    """
    trace.require_motion()
    infinite: set[float] = set()

    def finite(key: Key) -> FormulaLike | None:
        assert _by_mode(formula)
        own = formula(key)
        return None if own in (sp.oo, -sp.oo) else own

    if _by_mode(formula):
        entered = (jump.target for jump in instantaneous_modes(trace))
        modes = {trace.start_mode, trace.final_mode, *entered, *(arc.mode for arc in trace.arcs)}
        infinite = {float(own) for own in map(formula, modes) if own in (sp.oo, -sp.oo)}
    watched = finite if _by_mode(formula) else formula
    accumulator = OutputAccumulator(Outputs(observer, (), [watched]))
    accumulator.take(trace, trace.arcs, trace.jumps, ended=True)
    result = [*infinite, *accumulator.extremes.ravel().tolist()]
    return np.fmin.reduce(result).item(), np.fmax.reduce(result).item()


def extremes_along(
    observer: Observer, trace: Trace, arc: Arc, formulas: Sequence[FormulaLike]
) -> Array:
    """Return minima and maxima (f, 2) of formulas along an arc."""
    accumulator = OutputAccumulator(Outputs(observer, (), formulas), started=True)
    accumulator.take(trace, [arc], (), ended=False)
    return accumulator.extremes[:, 0]


def _by_mode(formula: Formula) -> TypeGuard[Callable[[Key], FormulaLike | None]]:
    # SymPy expressions are callable too.
    return not isinstance(formula, str | int | float | sp.Expr)
