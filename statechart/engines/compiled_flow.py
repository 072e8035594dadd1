"""A flow to its first event in compiled code, as long as no case needs `statechart.execution.flow`.

Chunks of Taylor steps are searched for events and compared with their rates. Where a step strays, a
guard cannot be decided, a state has to be brought back, or a flow is long, the flow is made again
by `statechart.execution.flow`. The modes stand in a table: tapes, kinds and tolerances of margins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Bools, Ints32
from statechart.engines.engine import FIRST_CHUNK, GROWTH, LONGEST_CHUNK, MAX_DEFECT_BOXES, NEAR
from statechart.engines.event_location import BOXES
from statechart.engines.taylor_loop import ORDERS, STRAY, call_step, expand, let_pass, stray
from statechart.kernels.boxes import Along, Steps
from statechart.kernels.copies import put
from statechart.kernels.defect import find_defect, is_unresolved
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import cut_steps, horner
from statechart.kernels.reconstruction import Program as Following
from statechart.kernels.reconstruction import reconstruct_any, reconstruction_program
from statechart.kernels.resolution import roughen
from statechart.kernels.roots import value_at
from statechart.kernels.search import CROSSING, NONE, clear_whole, search, search_step
from statechart.kernels.search_workspace import (
    PreparedTape,
    SearchWorkspace,
    prepare_tape,
    search_workspace,
)
from statechart.kernels.tapes import TapeCode, largest_deviation, tape_values

PLAIN, GAP, SPEED, FORCE, HOLD = range(5)
KINDS = ("plain", "gap", "speed", "force", "hold")
"""Kinds of margins: their numbers, and their names in that order."""

EVALUATED = 8.0 * float(np.finfo(float).eps)
"""Round-off of an instant, and of a formula in parts of its terms."""
JUMP = 1e-9
"""A margin that jumps below zero is above this part of its first value just before."""

# A part of a variable that is more than it is off by.
_SMALL = 1e-9

TAPE = 9
"""Columns of a tape in a table: begin and number of operations, constants, outputs, reads; n_fixed.
"""

(ADDRESS, PARS, MARGINS_AT, MARGINS, STOPS, LAWS_AT) = range(6)
FIXED = 6
WATCHED = FIXED + TAPE
RATES = WATCHED + TAPE
WITHIN = RATES + TAPE
RECONSTRUCTION = WITHIN + TAPE
ANCHORS = RECONSTRUCTION + TAPE
PLACES_AT = ANCHORS + TAPE
COLUMNS = PLACES_AT + 1
"""Columns of a mode in a table. Address of heyoka's step; how many parameters it takes, the time
among them; where the kinds of its margins are listed, each with the place of a tolerance of its
own, how many, and which is the first stop; where the laws list what they know of it; tapes of these
parameters, of the margins and the rates behind them, of the rates alone, of what is to stay above
the room, of what follows from other variables, of its anchors; where the places of what follows are
listed."""


class Program(NamedTuple):
    """The modes of an automaton for compiled loops."""

    ints: Ints32  # shape (..,)
    # (..,): codes, outputs and reads of tapes, and their constants, one behind the other.
    floats: Array
    modes: NDArray[np.int64]  # (m, `COLUMNS`): rows of zeros are modes that have not been compiled.


@kernel
def tape_of(program: Program, row: NDArray[np.int64]) -> TapeCode:
    """Return a tape of a table."""
    ints, floats = program.ints, program.floats
    return TapeCode(
        ints[row[0] : row[0] + 3 * row[1]].reshape((row[1], 3)),
        floats[row[2] : row[2] + row[3]],
        ints[row[4] : row[4] + row[5]],
        ints[row[6] : row[6] + row[7]],
        row[8],
    )


@kernel
def evaluate(
    program: Program,
    row: NDArray[np.int64],
    state: Array,
    parameters: Array,
    time: float,
    result: Array,
) -> None:
    """Write the first outputs of a tape, as many as there is room for."""
    code, constants, outputs, _, _ = tape_of(program, row)
    tape_values(code, constants, outputs[: result.shape[0]], state, parameters, time, result)


@kernel
def stands(
    program: Program, mode: int, parameters: Array, floors: Array, state: Array, time: float
) -> bool:
    """Return whether a flow may begin on the boundary of a stop condition, and is to be judged.

    See `statechart.execution.initial_stop_conditions`; `floors` (n,) are small for the variables,
    and exceed their errors.
    """
    row = program.modes[mode]
    first, margins = row[STOPS], row[MARGINS]
    if first == margins:
        return False
    code, constants, outputs, _, _ = tape_of(program, row[WATCHED : WATCHED + TAPE])
    stops, moved = outputs[first:margins], state.copy()
    values, others = np.empty(margins - first), np.empty(margins - first)
    reach = np.zeros(margins - first)
    tape_values(code, constants, stops, state, parameters, time, values)
    for v in range(state.shape[0]):
        moved[v] += max(floors[v], _SMALL * abs(state[v]))
        tape_values(code, constants, stops, moved, parameters, time, others)
        moved[v] = state[v]
        for i in range(reach.shape[0]):
            reach[i] += abs(others[i] - values[i])
    near = False
    for i in range(reach.shape[0]):
        near = near or not abs(values[i]) > reach[i]
    return near


class FlowWorkspace(NamedTuple):
    """Workspace of a flow: its steps, as in `statechart.engines.engine.Path`, and buffers."""

    # The steps, the first of which begins at time 0.
    times: Array  # shape (s + 1,)
    coefficients: Array  # shape (s, n, terms)
    # of shape (n,) each
    state: Array
    ended: Array
    pars: Array  # (p,): at least as many as any mode takes.
    clock: Array  # shape (2,)
    series: Array  # shape (n, terms)
    # Powers of the length of a step, and that length.
    powers: Array  # shape (terms,)
    length: Array  # shape (1,)
    # (n,): of a step, see `statechart.engines.taylor_loop.stray`.
    offs: Array
    sizes: Array
    unresolved: Bools  # (s,): steps.
    # (m,): of margins; at least as many as any mode has, likewise for what follows.
    tolerances: Array
    search: SearchWorkspace
    ranges: Array  # (r, 6): ranges over a step.


def flow_workspace(
    steps: int, terms: int, modes: NDArray[np.int64], variables: int, parameters: int
) -> FlowWorkspace:
    """Allocate the workspace of flows of so many steps, in modes as those of a `Program`."""
    _, operations, _, constants, _, outputs = modes[:, WATCHED : WATCHED + 6].max(axis=0).tolist()
    registers = variables + 1 + parameters + constants + operations
    return FlowWorkspace(
        np.zeros(steps + 1),
        np.empty((steps, variables, terms)),
        np.empty(variables),
        np.empty(variables),
        np.empty(modes[:, PARS].max()),
        np.zeros(2),
        np.empty((variables, terms)),
        np.empty(terms),
        np.empty(1),
        np.empty(variables),
        np.empty(variables),
        np.empty(steps, np.bool_),
        np.empty(modes[:, MARGINS].max()),
        SearchWorkspace(*search_workspace(registers, operations, outputs, variables)),
        np.empty((registers, 6)),
    )


class Watch(NamedTuple):
    """Numbers that the search of a flow needs, beside its margins."""

    parameters: Array  # shape (p,)
    kinds: Array  # (4,): tolerance of each kind of margin.
    bands: Array  # (b,): tolerances of single margins; -1 where that of the kind is the one.
    floors: Array  # (n,): what is smaller counts as so large.
    off: NDArray[np.int64]  # (9,): tape of the constraints.
    # (k,): of the constraints.
    targets: Array
    weights: Array
    max_depth: float  # Depth to which the outputs of `WITHIN` may fall below zero.
    # Tolerances of the engine, see `statechart.engines.engine.Pace`.
    tolerance: float
    max_step: float
    allowed: float


@kernel
def write_tolerances(
    program: Program, row: NDArray[np.int64], watch: Watch, tolerances: Array
) -> None:
    """Write the tolerance of every margin: its own, or that of its kind."""
    for i in range(row[MARGINS]):
        own = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        tolerances[i] = own if own >= 0.0 else watch.kinds[program.ints[row[MARGINS_AT] + 2 * i]]


@kernel
def first_tolerances(
    program: Program,
    row: NDArray[np.int64],
    watch: Watch,
    initial: Array,
    start: float,
    usual: Array,
    margins: Array,
    tolerances: Array,
) -> None:
    """Write the tolerances to search with first: see `statechart.execution.finding`.

    Also writes the margins at the start if one of them is plain.
    """
    plain = False
    for i in range(row[MARGINS]):
        tolerances[i] = usual[i]
        plain = plain or program.ints[row[MARGINS_AT] + 2 * i] == PLAIN
    if plain:
        evaluate(program, row[WATCHED : WATCHED + TAPE], initial, watch.parameters, start, margins)
        for i in range(row[MARGINS]):
            if program.ints[row[MARGINS_AT] + 2 * i] == PLAIN and margins[i] > usual[i]:
                tolerances[i] = 0.0


WHOLE, AT_EVENT, IN_VAIN = range(3)
"""Ends of a flow: the end of its duration, an event, or not in this way."""


@kernel
def _enter(
    program: Program,
    row: NDArray[np.int64],
    watch: Watch,
    workspace: FlowWorkspace,
    state: Array,
    now: float,
) -> None:
    """Let the integrator begin in a state."""
    workspace.clock[:] = 0.0
    put(state, workspace.state)
    if row[PARS] > 0:
        workspace.pars[0] = now
        fixed = row[FIXED : FIXED + TAPE]
        evaluate(program, fixed, state, watch.parameters, now, workspace.pars[1 : row[PARS]])


@kernel
def _reconstruction(
    program: Program, row: NDArray[np.int64], watch: Watch, state: Array, start: float
) -> Following:
    """Return the program that reconstructs dependent variables in a flow from a state."""
    anchored = row[ANCHORS : ANCHORS + TAPE]
    anchors = np.empty(anchored[5])
    evaluate(program, anchored, state, watch.parameters, start, anchors)
    code, constants, outputs, _, _ = tape_of(program, row[RECONSTRUCTION : RECONSTRUCTION + TAPE])
    places = program.ints[row[PLACES_AT] : row[PLACES_AT] + outputs.shape[0]]
    return reconstruction_program(
        code, constants, outputs, places, anchors, watch.parameters, state.shape[0]
    )


@kernel
def _level(ready: PreparedTape, registers: int, jets: Array) -> None:
    """Write ranges of what does not change along a flow: all their slopes are zero."""
    for r in range(registers):
        jets[r, 0], jets[r, 1] = ready[4][r, 0], ready[4][r, 1]
        jets[r, 2] = jets[r, 3] = jets[r, 4] = jets[r, 5] = 0.0


@kernel
def _off(program: Program, watch: Watch, state: Array, time: float) -> bool:
    """Return whether a state is so far off its constraints that it has to be projected."""
    code, constants, outputs, _, _ = tape_of(program, watch.off)
    return (
        largest_deviation(
            code, constants, outputs, watch.targets, watch.weights, state, watch.parameters, time
        )
        > NEAR
    )


@kernel
def flow_to_event(
    program: Program,
    mode: int,
    watch: Watch,
    workspace: FlowWorkspace,
    initial: Array,
    start: float,
    duration: float,
    horizon: float,
) -> tuple[int, int, int, int]:
    """Flow in a mode from `initial`; write the steps and, to `initial`, the state at their end.

    A step is searched when it has been made, and its slope at the end compared with the rates
    there, with which the series of the next begins. The flow begins at `start` and lasts `duration`
    at most; `horizon` is how far to look ahead at first. Returns a verdict, the margin that fell,
    the number of steps that stand in the memory, and the boxes looked at.
    """
    row = program.modes[mode]
    times, coeffs, ended = workspace.times, workspace.coefficients, workspace.ended
    state, clock, series = workspace.state, workspace.clock, workspace.series
    address = row[ADDRESS]
    tape = tape_of(program, row[WATCHED : WATCHED + TAPE])
    pars, h = workspace.pars[: row[PARS]], workspace.length
    margins, n = row[MARGINS], initial.shape[0]
    guards, rates = tape.outputs[:margins], tape.outputs[margins:]
    tolerances, powers, jets = workspace.tolerances, workspace.powers, workspace.ranges
    usual, begun = np.empty(margins), np.empty(margins)
    write_tolerances(program, row, watch, usual)
    first_tolerances(program, row, watch, initial, start, usual, begun, tolerances)
    made, boxes, pending, length = 0, 0, False, 0.0
    end = min(horizon, duration)
    chunk, chunk_end, base, total, left = FIRST_CHUNK, FIRST_CHUNK, 0.0, 0.0, end
    found = (NONE, -1, 0, 0.0, 0.0, 0.0, 0)
    follows = _reconstruction(program, row, watch, initial, start)
    reconstruct_any(follows, initial, start)
    ready = prepare_tape(tape, Steps(times, coeffs, watch.parameters, start), workspace.search)
    _level(ready, ready[0][1] + tape.code.shape[0], jets)
    _enter(program, row, watch, workspace, initial, start)
    while True:
        if chunk_end > coeffs.shape[0]:
            return IN_VAIN, -1, 0, boxes
        h[0] = min(left, watch.max_step)
        reconstruct_any(follows, state, start + times[made])
        call_step(address, state, pars, clock, h, series)
        if pending and _strays(ready[0], rates, watch, workspace, made - 1, length):
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
            if _strays(ready[0], rates, watch, workspace, made - 1, length):
                return IN_VAIN, -1, 0, boxes
            if found[0] != NONE or end == duration:
                break
            horizon *= GROWTH
            end = min(times[made] + horizon, duration)
            _enter(program, row, watch, workspace, ended, start + times[made])
            base, total, left, pending = times[made], 0.0, end - times[made], False
            chunk = min(chunk + chunk // 2, LONGEST_CHUNK)
            chunk_end = made + chunk
        elif made == chunk_end:
            chunk = min(chunk + chunk // 2, LONGEST_CHUNK)
            chunk_end += chunk
            base, total, left = times[made], 0.0, end - times[made]
    verdict, guard, step, place, at, crossed, _ = found
    if verdict not in (NONE, CROSSING) or _missed(
        program, row, watch, times, coeffs, start,
        workspace.unresolved[: made if verdict == NONE else step + 1],
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
    cut = crossed if kind in (FORCE, HOLD) else at
    count = cut_steps(times, coeffs, made, cut, initial)
    reconstruct_any(follows, initial, start + times[count])
    return AT_EVENT, guard, count, boxes


@kernel
def _strays(
    along: Along, rates: Ints32, watch: Watch, workspace: FlowWorkspace, step: int, length: float
) -> bool:
    """Return whether a step ends off its rates; note whether it may have been on its way."""
    offs, sizes = workspace.offs, workspace.sizes
    off = stray(workspace.coefficients[step], length, workspace.series, offs, sizes)
    if off > max(STRAY, ORDERS * watch.tolerance):
        return True
    followed = _follows_rates(along, rates, watch, offs, sizes, length, workspace.ranges)
    workspace.unresolved[step] = not followed
    return False


@kernel
def _rates_at_end(ready: PreparedTape, rates: Ints32, step: int, series: Array) -> None:
    """Write the rates where a step ends, as a series from there begins with them."""
    along, regs = ready[0], ready[3]
    value_at(along, step, rates[0], 1.0, regs)
    for v in range(rates.shape[0]):
        series[v, 1] = regs[rates[v], 0]


@kernel
def _follows_rates(
    along: Along,
    rates: Ints32,
    watch: Watch,
    offs: Array,
    reaches: Array,
    length: float,
    jets: Array,
) -> bool:
    """Return whether a step is known to follow its rates, by its end and its ranges.

    Where all rates are resolved on the whole of it, they are as smooth as it is long: what it
    leaves out grows towards its end, by a power above its order.
    """
    roughen(along, jets)
    followed = True
    for v in range(offs.shape[0]):
        reaches[v] = max(reaches[v], watch.floors[v])
        followed = followed and offs[v] <= watch.allowed * reaches[v]
    return followed and not is_unresolved(rates, jets, length, watch.allowed, reaches)


@kernel
def _missed(
    program: Program,
    row: NDArray[np.int64],
    watch: Watch,
    times: Array,
    coeffs: Array,
    start: float,
    doubtful: Bools,
) -> bool:
    """Return whether steps may have missed a bump of a surface or, the doubtful, their rates."""
    within = tape_of(program, row[WITHIN : WITHIN + TAPE])
    steps = Steps(times, coeffs, watch.parameters, start)
    if within.outputs.shape[0] > 0:
        rooms = np.full(within.outputs.shape[0], watch.max_depth)
        if search(within, rooms, steps, 0, doubtful.shape[0], BOXES)[0] != NONE:
            return True
    rates = tape_of(program, row[RATES : RATES + TAPE])
    first = 0
    while first < doubtful.shape[0]:
        last = first
        while last < doubtful.shape[0] and doubtful[last]:
            last += 1
        if last > first:
            found = find_defect(
                rates, steps, first, last, watch.floors, watch.allowed, MAX_DEFECT_BOXES
            )
            if found[0] >= 0:
                return True
        first = last + 1
    return False
