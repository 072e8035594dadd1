"""Outputs of many runs in one compiled call: at their events and ends, along their arcs."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints, Ints32
from statechart.automaton.trace_store import TraceBuffer
from statechart.execution.ahead import N_MODE, T_HIGH
from statechart.execution.rows import (
    ARCS,
    ARCS_END,
    EVENTS,
    EVENTS_END,
    FIRST_MODE,
    HOW,
    STOPPED,
    Found,
)
from statechart.kernels.jit import kernel, part
from statechart.kernels.rows import extremes_rows, integrate_rows
from statechart.kernels.tapes import tape_values

NO, YES, OWN = range(3)
"""Whether an event is waited for; with `OWN` others like it may be, or not."""

MADE, UNSETTLED = -1, -2
"""What `row_values` returns beside the number of an event."""

WAIT, MOST, BEFORE = range(3)
"""Columns of `Wanted.moments`."""

# Columns of the events of a block, and of their numbers.
SOURCE, TARGET, STRUCK, GROUP = 0, 1, 4, 5
TIME, NORMAL, TANGENTIAL = 0, 4, 5


class Wanted(NamedTuple):
    """Outputs as arrays.

    Attributes
    ----------
    ints, floats : (..,) array
        Tapes, packed (see `statechart.execution.loops.Packed`).
    start, end, integrals : (k, 9) array of int64
        The tape of every kind of mode.
    columns : (k, f) array of int64
        Where each output of `integrals` is added.
    values : (a, k, 9), extremes : (x, k, 9) array of int64
        The tapes of each output at events, and of each formula whose extremes are wanted.
    moments : (a, 3) array of int64
        Of outputs at events: which wait, how many (the last ones below 0, all at 0), and whether
        before them.
    counts : (c,) array of int64
        The wait of each count.
    """

    ints: Ints32
    floats: Array
    start: Ints
    end: Ints
    integrals: Ints
    columns: Ints
    values: Ints
    extremes: Ints
    moments: Ints
    counts: Ints


class Told(NamedTuple):
    """Which events are waited for, by what they are like.

    Attributes
    ----------
    codes : (c,) array of int64
        In order; see `_code`.
    verdicts : (c, w) array of uint8
    """

    codes: Ints
    verdicts: NDArray[np.uint8]


class Values(NamedTuple):
    """Outputs of rows.

    Attributes
    ----------
    happens : (e, w) array of uint8
        Which events of all rows, in order, each wait is for.
    listed : (a, e), tally : (a, m) array
        Values at events, those of a row after those of the one before it; how many.
    counted : (c, m) array of int64
    start, end, integrals : (m, ..) array
    extremes : (x, m, 2) array
    """

    happens: NDArray[np.uint8]
    listed: Array
    tally: Ints
    counted: Ints
    start: Array
    end: Array
    integrals: Array
    extremes: Array


@part
def _code(block: TraceBuffer, event: int, kinds: int, regions: int) -> int:
    """Return a number for an event that is that of others like it, for all that outputs ask."""
    row, numbers = block.events[event], block.numbers[event]
    hit = numbers[NORMAL] != 0.0 or numbers[TANGENTIAL] != 0.0
    struck = np.int64(row[STRUCK]) + 1
    pair = np.int64(row[SOURCE]) * kinds + row[TARGET]
    alike = (pair * (regions + 1) + struck) * 4
    return alike + (2 if row[GROUP] != 0 else 0) + (1 if hit else 0)


@part
def _stopped(found: Found, row: int) -> int:
    return 1 if found.ends[row, HOW] == STOPPED else 0


@part
def _place_of(codes: Ints, code: int) -> int:
    """Return where a number stands among others, in order; -1 where it is none of them."""
    low, high = 0, codes.shape[0]
    while low < high:
        middle = (low + high) // 2
        if codes[middle] == code:
            return middle
        if codes[middle] < code:
            low = middle + 1
        else:
            high = middle
    return -1


@part
def _decide(
    told: Told, block: TraceBuffer, found: Found, regions: int, values: Values
) -> tuple[int, int]:
    """Tell which events are waited for; see `row_values` for what is returned."""
    kinds, count, settled = found.entered.shape[1], 0, True
    for row in range(found.ends.shape[0]):
        begin, end = found.spans[row, EVENTS], found.spans[row, EVENTS_END]
        for event in range(begin, end + _stopped(found, row)):
            # A stop, which stands in no block, is like others in its mode.
            code = -1 - found.place[row, N_MODE]
            if event < end:
                code = _code(block, event, kinds, regions)
            place = _place_of(told.codes, code)
            if place < 0:
                return count, code
            for k in range(values.happens.shape[1]):
                values.happens[count, k] = told.verdicts[place, k]
                settled = settled and told.verdicts[place, k] != OWN
            count += 1
    return (MADE if settled else UNSETTLED), 0


@part
def _evaluate(
    wanted: Wanted, tape: Ints, state: Array, parameters: Array, time: float, result: Array
) -> None:
    program = (wanted.ints, wanted.floats)
    if tape[5] == 0:
        return
    code = program[0][tape[0] : tape[0] + 3 * tape[1]].reshape((tape[1], 3))
    constants = program[1][tape[2] : tape[2] + tape[3]]
    outputs = program[0][tape[4] : tape[4] + tape[5]]
    tape_values(code, constants, outputs, state, parameters, time, result)


@part
def _at_events(
    wanted: Wanted, block: TraceBuffer, found: Found, output: int, values: Values
) -> None:
    """Write the values of an output at its events."""
    wait, most, before = wanted.moments[output]
    first, at = 0, 0
    for row in range(found.ends.shape[0]):
        begin, end = found.spans[row, EVENTS], found.spans[row, EVENTS_END]
        total = end - begin + _stopped(found, row)
        happening = 0
        for k in range(total):
            happening += values.happens[first + k, wait]
        skipped = max(happening + most, 0) if most < 0 else 0
        left = happening - skipped if most <= 0 else min(most, happening)
        values.tally[output, row] = left
        for k in range(total):
            if values.happens[first + k, wait] == 0:
                continue
            if skipped > 0:
                skipped -= 1
                continue
            if left == 0:
                break
            left -= 1
            event, kind = begin + k, found.place[row, N_MODE]
            state, time = found.final[row], found.now[row, T_HIGH]
            if event < end:
                kind = np.int64(block.events[event, SOURCE if before else TARGET])
                state, time = block.states[event, 0 if before else 1], block.numbers[event, TIME]
            result = values.listed[output, at : at + 1]
            result[0] = np.nan
            _evaluate(wanted, wanted.values[output, kind], state, found.values[row], time, result)
            at += 1
        first += total


@part
def _include(extremes: Array, value: Array) -> None:
    """Let an interval (2,), not numbers at first, hold a value (1,), too."""
    if not value[0] >= extremes[0] and value[0] == value[0]:
        extremes[0] = value[0]
    if not value[0] <= extremes[1] and value[0] == value[0]:
        extremes[1] = value[0]
    value[0] = math.nan


@part
def _extremes(
    wanted: Wanted, block: TraceBuffer, found: Found, formula: int, spans: Ints, result: Array
) -> None:
    """Write the least and the greatest value (m, 2) of a formula."""
    tapes, value = wanted.extremes[formula], np.full(1, math.nan)
    for row in range(spans.shape[0]):
        parameters, first = found.values[row], found.ends[row, FIRST_MODE]
        result[row] = math.nan
        _evaluate(wanted, tapes[first], found.initial[row], parameters, 0.0, value)
        _include(result[row], value)
    extremes_rows(
        wanted.ints, wanted.floats, tapes, block.arcs, block.places, block.starts, block.times,
        block.coefficients, spans, found.values, found.final.shape[1], result,
    )  # fmt: skip
    for row in range(spans.shape[0]):
        parameters, last, time = found.values[row], found.place[row, N_MODE], found.now[row, T_HIGH]
        arc, begin = spans[row, ARCS], spans[row, EVENTS]
        for event in range(begin, spans[row, EVENTS_END]):
            while arc < spans[row, ARCS_END] and block.arcs[arc, 1] <= event - begin:
                arc += 1
            if arc < spans[row, ARCS_END] and block.arcs[arc, 1] == event - begin + 1:
                continue
            # Nothing flowed after it.
            target, at = np.int64(block.events[event, TARGET]), block.numbers[event, TIME]
            _evaluate(wanted, tapes[target], block.states[event, 1], parameters, at, value)
            _include(result[row], value)
        _evaluate(wanted, tapes[last], found.final[row], parameters, time, value)
        _include(result[row], value)


@kernel
def row_values(
    wanted: Wanted, told: Told, block: TraceBuffer, found: Found, regions: int, decided: bool,
    values: Values,
) -> tuple[int, int]:  # fmt: skip
    """Compute the outputs of rows.

    Parameters
    ----------
    wanted : Wanted
    told : Told
    block : TraceBuffer
        Holds the arcs and events of the rows.
    found : Found
        The rows.
    regions : int
        Of the automaton.
    decided : bool
        Whether `values.happens` is known.
    values : Values
        To be filled.

    Returns
    -------
    number : int
        `MADE`; or else nothing was computed: `UNSETTLED` where some events are each one's own, or
        the number of an event, in all rows, that is like none that was told of.
    code : int
        Of that event.
    """
    number, code = MADE, 0
    if not decided:
        number, code = _decide(told, block, found, regions, values)
    if number != MADE:
        return number, code
    for output in range(wanted.moments.shape[0]):
        _at_events(wanted, block, found, output, values)
    for row in range(found.ends.shape[0]):
        parameters, last = found.values[row], found.place[row, N_MODE]
        first, time = found.ends[row, FIRST_MODE], found.now[row, T_HIGH]
        _evaluate(
            wanted, wanted.start[first], found.initial[row], parameters, 0.0, values.start[row]
        )
        _evaluate(wanted, wanted.end[last], found.final[row], parameters, time, values.end[row])
    for k in range(wanted.counts.shape[0]):
        event = 0
        for row in range(found.ends.shape[0]):
            total = found.spans[row, EVENTS_END] - found.spans[row, EVENTS] + _stopped(found, row)
            values.counted[k, row] = 0
            for _ in range(total):
                values.counted[k, row] += values.happens[event, wanted.counts[k]]
                event += 1
    spans = found.spans
    if wanted.columns.shape[1] > 0:
        values.integrals[:] = 0.0
        integrate_rows(
            wanted.ints, wanted.floats, wanted.integrals, wanted.columns, block.arcs, block.places,
            block.starts, block.times, block.coefficients, spans, found.values,
            found.final.shape[1], values.integrals,
        )  # fmt: skip
    for formula in range(wanted.extremes.shape[0]):
        _extremes(wanted, block, found, formula, spans, values.extremes[formula])
    return MADE, 0
