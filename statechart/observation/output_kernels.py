"""Kernel of the outputs of runs, from arrays of arcs and events.

Compiled loops write these arrays; `statechart.observation.outputs` writes them for other runs. A
call for a run of the toppling stick takes 15 us, a tenth of the run.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.trace_store import TraceBuffer
from statechart.engines.compiled_flow import tape_of
from statechart.execution.compiled_loop import (
    ARCS,
    ARCS_END,
    EVENTS,
    EVENTS_END,
    FIRST_MODE,
    HOW,
    N_MODE,
    STOPPED,
    T_HIGH,
    BatchResult,
)
from statechart.kernels.boxes import Steps
from statechart.kernels.extremes import update_extremes
from statechart.kernels.jit import kernel
from statechart.kernels.quadrature import EXACT, integrate_outputs
from statechart.kernels.tapes import TapeCode, tape_values

SOURCE, TARGET = 0, 1
"""Columns of the events of a buffer."""
TIME, NORMAL = 0, 4
"""Columns of their numbers."""


class OutputTapes(NamedTuple):
    """Formulas of the outputs for every kind of mode, as packed tapes.

    Tapes (k + 1, 9) are zero if a formula has no value in a kind, as in the last kind.
    """

    # (..,): see `statechart.execution.compiled_loop.Packed`.
    ints: Ints32
    floats: Array
    # Tapes of each formula at events, at the start and the end, and of those of extremes.
    events: Ints  # shape (a, k + 1, 9)
    start: Ints  # shape (s, k + 1, 9)
    end: Ints  # shape (f, k + 1, 9)
    extremes: Ints  # shape (x, k + 1, 9)
    passed: Ints  # Those of extremes in modes of zero duration, which have no forces.
    integrals: Ints  # (k + 1, 9): one tape for all of them
    columns: Ints  # (k + 1, i): integral to which each of its outputs is added
    waits: Ints  # (a, 2): set of events of each formula, whether evaluated before them


class OutputValues(NamedTuple):
    """Values of the formulas in m runs; integrals and extremes accumulate over calls."""

    listed: Array  # (a, e): values at events, run by run
    start: Array  # shape (m, s)
    end: Array  # shape (m, f)
    integrals: Array  # shape (m, i)
    extremes: Array  # (x, m, 2): minimum and maximum, NaN at first


@kernel
def _program(tapes: OutputTapes, tape: Ints) -> TapeCode:
    # Only the packed arrays are read, which both have.
    return tape_of(tapes, tape)  # type: ignore[arg-type]


@kernel
def _value(tapes: OutputTapes, tape: Ints, state: Array, parameters: Array, time: float) -> float:
    result = np.empty(1)
    result[0] = math.nan
    if tape[5] > 0:
        code, constants, outputs, _, _ = _program(tapes, tape)
        tape_values(code, constants, outputs, state, parameters, time, result)
    return float(result[0])


@kernel
def number_of_events(result: BatchResult, row: int) -> int:
    """Return the number of events of a run, including its stop, which is not in the buffer."""
    count = result.spans[row, EVENTS_END] - result.spans[row, EVENTS]
    return count + (1 if result.ends[row, HOW] == STOPPED else 0)


@kernel
def _list_values(
    tapes: OutputTapes,
    block: TraceBuffer,
    result: BatchResult,
    marks: NDArray[np.uint8],
    values: OutputValues,
) -> None:
    """Write the values of formulas at their events."""
    for i in range(tapes.waits.shape[0]):
        wait, side = tapes.waits[i, 0], 0 if tapes.waits[i, 1] else 1
        first, at = 0, 0
        for row in range(result.ends.shape[0]):
            begin, end = result.spans[row, EVENTS], result.spans[row, EVENTS_END]
            total = number_of_events(result, row)
            for k in range(total):
                if marks[first + k, wait] == 0:
                    continue
                event, kind = begin + k, result.place[row, N_MODE]
                state, time = result.final[row], result.clock[row, T_HIGH]
                if event < end:
                    kind = np.int64(block.events[event, SOURCE + side])
                    state, time = block.states[event, side], block.numbers[event, TIME]
                tape, parameters = tapes.events[i, kind], result.values[row]
                values.listed[i, at] = _value(tapes, tape, state, parameters, time)
                at += 1
            first += total


@kernel
def _times_of(block: TraceBuffer, arc: int) -> Array:
    at = block.places[arc, 0]
    return block.times[at : at + np.int64(block.arcs[arc, 2]) + 1]


@kernel
def _terms_of(block: TraceBuffer, arc: int, variables: int, terms: Array) -> Array:
    """Return the polynomials of an arc among those of all arcs."""
    steps, width = np.int64(block.arcs[arc, 2]), np.int64(block.arcs[arc, 3])
    place = block.places[arc, 1]
    return terms[place : place + steps * variables * width].reshape((steps, variables, width))


@kernel
def _include(extremes: Array, value: float) -> None:
    """Widen an interval (2,), NaN at first, to a value; NaN does not count."""
    if not value >= extremes[0] and value == value:
        extremes[0] = value
    if not value <= extremes[1] and value == value:
        extremes[1] = value


@kernel
def _include_arcs(
    tapes: OutputTapes,
    block: TraceBuffer,
    resolved: Array,
    result: BatchResult,
    row: int,
    values: OutputValues,
) -> None:
    """Add the arcs of a run to its integrals and extremes."""
    variables, parameters = result.final.shape[1], result.values[row]
    for arc in range(result.spans[row, ARCS], result.spans[row, ARCS_END]):
        kind, times = block.arcs[arc, 0], _times_of(block, arc)
        terms = _terms_of(block, arc, variables, resolved)
        tape = tapes.integrals[kind]
        if tape[5] > 0:
            steps = Steps(times, terms, parameters, block.starts[arc, 0])
            sums, _ = integrate_outputs(_program(tapes, tape), steps, 0.0, times[-1], EXACT)
            for i in range(sums.shape[1]):
                total = 0.0
                for step in range(sums.shape[0]):
                    total += sums[step, i]
                values.integrals[row, tapes.columns[kind, i]] += total
        for formula in range(tapes.extremes.shape[0]):
            tape = tapes.extremes[formula, kind]
            if tape[5] > 0:
                known = _terms_of(block, arc, variables, block.coefficients)
                steps = Steps(times, known, parameters, block.starts[arc, 0])
                extremes = values.extremes[formula, row]
                update_extremes(_program(tapes, tape), steps, terms, block.starts[arc, 1], extremes)


@kernel
def compute_outputs(
    tapes: OutputTapes,
    block: TraceBuffer,
    resolved: Array,
    result: BatchResult,
    marks: NDArray[np.uint8],
    values: OutputValues,
) -> None:
    """Evaluate the formulas of runs into `values`.

    `block` has arcs and events of the runs `result`; `resolved` are its coefficients with 0 for
    NaN, which adds nothing to integrals. `marks` (e, w + 1) are the sets that each event belongs
    to, run by run; the last column is true before a mode of zero duration.
    """
    _list_values(tapes, block, result, marks, values)
    first = 0
    for row in range(result.ends.shape[0]):
        parameters, started, last = (
            result.values[row], result.ends[row, FIRST_MODE], result.place[row, N_MODE]
        )  # fmt: skip
        initial, final, end = result.initial[row], result.final[row], result.clock[row, T_HIGH]
        for i in range(tapes.start.shape[0]):
            values.start[row, i] = _value(tapes, tapes.start[i, started], initial, parameters, 0.0)
        for i in range(tapes.end.shape[0]):
            values.end[row, i] = _value(tapes, tapes.end[i, last], final, parameters, end)
        for i in range(tapes.extremes.shape[0]):
            value = _value(tapes, tapes.extremes[i, started], initial, parameters, 0.0)
            _include(values.extremes[i, row], value)
        _include_arcs(tapes, block, resolved, result, row, values)
        begin = result.spans[row, EVENTS]
        for i in range(tapes.extremes.shape[0]):
            extremes = values.extremes[i, row]
            for event in range(begin, result.spans[row, EVENTS_END]):
                if marks[first + event - begin, -1]:
                    tape = tapes.passed[i, np.int64(block.events[event, TARGET])]
                    at, state = block.numbers[event, TIME], block.states[event, 1]
                    _include(extremes, _value(tapes, tape, state, parameters, at))
            _include(extremes, _value(tapes, tapes.extremes[i, last], final, parameters, end))
        first += number_of_events(result, row)
