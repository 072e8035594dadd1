"""A flow to its first event in compiled code, as long as nothing in it is out of the ordinary.

What `statechart.execution.flow` does step by step, and to the same bits: chunks of Taylor steps,
each searched for events and held against its rates. Where a step strays, a guard cannot be decided,
a state has to be brought back, or a flow is long, it says so, and the flow is made again there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Bools, Ints32
from statechart.engines.engine import FIRST_CHUNK, GROWTH, LONGEST_CHUNK, LOOKS, NEAR, Pace
from statechart.engines.event_location import BOXES
from statechart.engines.heyoka_step import call_step
from statechart.engines.mode_table import (
    ADDRESS,
    ANCHORS,
    EVALUATED,
    FIXED,
    FORCE,
    JUMP,
    LIFT,
    MARGINS,
    MARGINS_AT,
    PARS,
    PLACES_AT,
    PLAIN,
    RATES,
    TAPE,
    WATCHED,
    WITHIN,
    Program,
    Scratch,
    Watch,
    evaluate,
    first_tolerances,
    tape_of,
    usual_tolerances,
)
from statechart.engines.taylor_loop import ORDERS, STRAY, expand, let_pass, stray
from statechart.kernels.boxes import Along, Steps
from statechart.kernels.copies import put
from statechart.kernels.defect import rough_in, unseen
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import cut_steps, horner
from statechart.kernels.reconstruction import Program as Following
from statechart.kernels.reconstruction import reconstruct_any, reconstruction_program
from statechart.kernels.resolution import roughen
from statechart.kernels.roots import value_at
from statechart.kernels.search import (
    CROSSING,
    NONE,
    clear_whole,
    search,
    search_step,
)
from statechart.kernels.search_memory import Ready, ready_along
from statechart.kernels.tapes import off_by

WHOLE, AT_EVENT, IN_VAIN = range(3)
"""How a flow ends: at the end of its duration, at an event, or not in this way."""


@kernel
def _enter(
    program: Program,
    row: NDArray[np.int64],
    watch: Watch,
    memory: Scratch,
    state: Array,
    now: float,
) -> None:
    """Let the integrator begin in a state."""
    memory.clock[:] = 0.0
    put(state, memory.state)
    if row[PARS] > 0:
        memory.pars[0] = now
        fixed = row[FIXED : FIXED + TAPE]
        evaluate(program, fixed, state, watch.parameters, now, memory.pars[1 : row[PARS]])


@kernel
def _following(
    program: Program, row: NDArray[np.int64], watch: Watch, state: Array, start: float
) -> Following:
    """Return what follows from other variables in a flow that begins in a state."""
    anchored = row[ANCHORS : ANCHORS + TAPE]
    anchors = np.empty(anchored[5])
    evaluate(program, anchored, state, watch.parameters, start, anchors)
    code, constants, outputs, _, _ = tape_of(program, row[LIFT : LIFT + TAPE])
    places = program.ints[row[PLACES_AT] : row[PLACES_AT] + outputs.shape[0]]
    return reconstruction_program(
        code, constants, outputs, places, anchors, watch.parameters, state.shape[0]
    )


@kernel
def _level(ready: Ready, registers: int, jets: Array) -> None:
    """Write ranges of what does not change along a flow: all their slopes are zero."""
    for r in range(registers):
        jets[r, 0], jets[r, 1] = ready[4][r, 0], ready[4][r, 1]
        jets[r, 2] = jets[r, 3] = jets[r, 4] = jets[r, 5] = 0.0


@kernel
def _off(program: Program, watch: Watch, state: Array, time: float) -> bool:
    """Whether a state is so far off its constraints that it has to be brought back."""
    code, constants, outputs, _, _ = tape_of(program, watch.off)
    return (
        off_by(
            code, constants, outputs, watch.targets, watch.weights, state, watch.parameters, time
        )
        > NEAR
    )


@kernel
def flow_to_event(
    program: Program,
    mode: int,
    pace: Pace,
    watch: Watch,
    memory: Scratch,
    initial: Array,
    start: float,
    duration: float,
    horizon: float,
) -> tuple[int, int, int, int]:
    """Flow in a mode from `initial`; write the steps and, to `initial`, the state at their end.

    A step is searched when it has been made, and its slope at the end compared with the rates
    there, with which the series of the next begins.

    Parameters
    ----------
    start : float
        When the flow begins.
    duration : float
        Longest flow.
    horizon : float
        How far to look ahead at first.

    Returns
    -------
    verdict : int
    margin : int
        That fell, at an event.
    count : int
        Steps that stand in the memory.
    boxes : int
        Looked at.
    """
    row = program.modes[mode]
    times, coeffs, ended = memory.times, memory.coefficients, memory.ended
    state, clock, series = memory.state, memory.clock, memory.series
    address = row[ADDRESS]
    tape = tape_of(program, row[WATCHED : WATCHED + TAPE])
    pars, h = memory.pars[: row[PARS]], memory.length
    margins, n = row[MARGINS], initial.shape[0]
    guards, rates = tape.outputs[:margins], tape.outputs[margins:]
    tolerances, powers, jets = memory.tolerances, memory.powers, memory.whole
    usual, begun = np.empty(margins), np.empty(margins)
    usual_tolerances(program, row, watch, usual)
    first_tolerances(program, row, watch, initial, start, usual, begun, tolerances)
    made, boxes, pending, length = 0, 0, False, 0.0
    end = min(horizon, duration)
    chunk, chunk_end, base, total, left = FIRST_CHUNK, FIRST_CHUNK, 0.0, 0.0, end
    found = (NONE, -1, 0, 0.0, 0.0, 0.0, 0)
    follows = _following(program, row, watch, initial, start)
    reconstruct_any(follows, initial, start)
    ready = ready_along(tape, Steps(times, coeffs, watch.parameters, start), memory.searched)
    _level(ready, ready[0][1] + tape.code.shape[0], jets)
    _enter(program, row, watch, memory, initial, start)
    while True:
        if chunk_end > coeffs.shape[0]:
            return IN_VAIN, -1, 0, boxes
        h[0] = min(left, pace.max_step)
        reconstruct_any(follows, state, start + times[made])
        call_step(address, state, pars, clock, h, series)
        if pending and _strays(ready[0], rates, watch, pace, memory, made - 1, length):
            return IN_VAIN, -1, 0, boxes
        length = h[0]
        expand(series, length, coeffs[made], powers)
        let_pass(clock, length)
        total += length
        made, pending = made + 1, True
        last = length == left
        times[made] = end if last else base + total
        if not times[made] > times[made - 1]:
            return IN_VAIN, -1, 0, boxes
        left = 0.0 if last else left - length
        if last or made == chunk_end:
            for v in range(n):
                ended[v] = horner(coeffs, made - 1, v, 1.0)
            reconstruct_any(follows, ended, start + times[made])
            if _off(program, watch, ended, start + times[made]):
                return IN_VAIN, -1, 0, boxes
        if clear_whole(ready, guards, tolerances, made - 1, jets):
            boxes += 1
        else:
            found = search_step(ready, guards, tolerances, made - 1, BOXES)
            boxes += found[6]
        if last or found[0] != NONE:
            # No step follows whose series would begin with the rates.
            _rates_at_end(ready, rates, made - 1, series)
            if _strays(ready[0], rates, watch, pace, memory, made - 1, length):
                return IN_VAIN, -1, 0, boxes
            if found[0] != NONE or end == duration:
                break
            horizon *= GROWTH
            end = min(times[made] + horizon, duration)
            _enter(program, row, watch, memory, ended, start + times[made])
            base, total, left, pending = times[made], 0.0, end - times[made], False
            chunk = min(chunk + chunk // 2, LONGEST_CHUNK)
            chunk_end = made + chunk
        elif made == chunk_end:
            chunk = min(chunk + chunk // 2, LONGEST_CHUNK)
            chunk_end += chunk
            base, total, left = times[made], 0.0, end - times[made]
    verdict, guard, step, place, at, crossed, _ = found
    if verdict not in (NONE, CROSSING) or _missed(
        program, row, pace, watch, times, coeffs, start,
        memory.doubtful[: made if verdict == NONE else step + 1],
    ):  # fmt: skip
        return IN_VAIN, -1, 0, boxes
    if verdict == NONE:
        put(ended, initial)
        return WHOLE, -1, made, boxes
    kind = program.ints[row[MARGINS_AT] + 2 * guard]
    if kind == PLAIN:
        # It begins at zero, and may not have fallen since.
        at_zero = abs(begun[guard]) <= usual[guard]
        # An angle is above zero up to its branch cut, and jumps below.
        value = value_at(ready[0], step, guards[guard], place, ready[3])
        jumps = value > max(usual[guard], JUMP * abs(begun[guard]))
        latest = max(at, crossed) * (1.0 + EVALUATED)
        clear_whole(ready, guards, usual, made - 1, jets)
        verdict, first, _, _, at, crossed, _ = search_step(ready, guards, usual, made - 1, BOXES)
        far = verdict == CROSSING and first == guard and at <= latest
        if at_zero or jumps or not far:
            return IN_VAIN, -1, 0, boxes
    cut = crossed if kind == FORCE else at
    count = cut_steps(times, coeffs, made, cut, initial)
    reconstruct_any(follows, initial, start + times[count])
    return AT_EVENT, guard, count, boxes


@kernel
def _strays(
    along: Along,
    rates: Ints32,
    watch: Watch,
    pace: Pace,
    memory: Scratch,
    step: int,
    length: float,
) -> bool:
    """Whether a step ends off its rates; note whether it may have been off them on its way."""
    offs, sizes = memory.offs, memory.sizes
    off = stray(memory.coefficients[step], length, memory.series, offs, sizes)
    if off > max(STRAY, ORDERS * pace.tolerance):
        return True
    followed = _followed(along, rates, watch, pace, offs, sizes, length, memory.whole)
    memory.doubtful[step] = not followed
    return False


@kernel
def _rates_at_end(ready: Ready, rates: Ints32, step: int, series: Array) -> None:
    """Write the rates where a step ends, as a series from there begins with them."""
    along, regs = ready[0], ready[3]
    value_at(along, step, rates[0], 1.0, regs)
    for v in range(rates.shape[0]):
        series[v, 1] = regs[rates[v], 0]


@kernel
def _followed(
    along: Along,
    rates: Ints32,
    watch: Watch,
    pace: Pace,
    offs: Array,
    reaches: Array,
    length: float,
    jets: Array,
) -> bool:
    """Whether a step is known to follow its rates, from where it ends and its ranges.

    Where all rates are resolved on the whole of it, they are as smooth as it is long: what it
    leaves out grows towards its end, by a power above its order.
    """
    roughen(along, jets)
    followed = True
    for v in range(offs.shape[0]):
        reaches[v] = max(reaches[v], watch.floors[v])
        followed = followed and offs[v] <= pace.allowed * reaches[v]
    return followed and not rough_in(rates, jets, length, pace.allowed, reaches)


@kernel
def _missed(
    program: Program,
    row: NDArray[np.int64],
    pace: Pace,
    watch: Watch,
    times: Array,
    coeffs: Array,
    start: float,
    doubtful: Bools,
) -> bool:
    """Whether steps may have missed something of their surfaces or, the doubtful, their rates."""
    within = tape_of(program, row[WITHIN : WITHIN + TAPE])
    steps = Steps(times, coeffs, watch.parameters, start)
    if within.outputs.shape[0] > 0:
        rooms = np.full(within.outputs.shape[0], watch.room)
        if search(within, rooms, steps, 0, doubtful.shape[0], BOXES)[0] != NONE:
            return True
    rates = tape_of(program, row[RATES : RATES + TAPE])
    first = 0
    while first < doubtful.shape[0]:
        last = first
        while last < doubtful.shape[0] and doubtful[last]:
            last += 1
        if last > first:
            found = unseen(rates, steps, first, last, watch.floors, pace.allowed, LOOKS)
            if found[0] >= 0:
                return True
        first = last + 1
    return False
