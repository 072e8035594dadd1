"""Taylor integration of a mode to its first event, compiled.

Each Taylor step is searched for events, and the slope at its end is compared with the rates there.
`flow_to_event` returns `UNRESOLVED` if a step has the wrong slope, a guard is undecided, the state
needs projection onto the constraints, or the workspace is full; `statechart.execution.flow` then
repeats the flow. A `ModeTable` holds the modes: tapes, kinds and tolerances of margins.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Bools, Ints32
from statechart.engines.engine import FIRST_CHUNK, GROWTH, LONGEST_CHUNK, MAX_DEFECT_BOXES, NEAR
from statechart.engines.event_location import BOXES
from statechart.engines.taylor_loop import (
    MAX_SLOPE_ERROR,
    SLOPE_ERROR_FACTOR,
    advance_clock,
    call_step,
    limit_step,
    scale_series,
    slope_error,
)
from statechart.kernels.boxes import Steps, StepTape
from statechart.kernels.copies import copy_numbers
from statechart.kernels.defect import find_defect, is_unresolved
from statechart.kernels.jit import kernel
from statechart.kernels.polynomials import cut_steps, horner
from statechart.kernels.reconstruction import (
    ReconstructionProgram,
    reconstruct_any,
    reconstruction_program,
)
from statechart.kernels.resolution import write_roughness
from statechart.kernels.roots import value_at
from statechart.kernels.search import CROSSING, NONE, is_step_clear, search, search_step
from statechart.kernels.search_workspace import (
    PreparedTape,
    SearchWorkspace,
    prepare_tape,
    search_workspace,
)
from statechart.kernels.tapes import TapeCode, largest_deviation, tape_values

PLAIN, GAP, SPEED, FORCE, HOLD, IMPLIED = range(6)
KINDS = ("plain", "gap", "speed", "force", "hold", "implied")
"""Kinds of margins, and their names in the same order."""

EVALUATION_ROUND_OFF = 8.0 * float(np.finfo(float).eps)
"""Relative round-off of a time, and of a formula relative to its terms."""
MIN_JUMP = 1e-9
"""A margin jumps below zero if it exceeds this part of its initial value just before."""

# Relative displacement of a variable; larger than its error.
_MIN_DISPLACEMENT = 1e-9

TAPE = 9
"""Columns per tape: start and number of operations, of constants, of outputs, of reads; n_fixed."""

(ADDRESS, PARS, MARGINS_AT, MARGINS, FIRST_STOP, LAWS_AT) = range(6)
PARAMETER_TAPE = 6
MARGIN_TAPE = PARAMETER_TAPE + TAPE
RATE_TAPE = MARGIN_TAPE + TAPE
DEPTH_TAPE = RATE_TAPE + TAPE
RECONSTRUCTION_TAPE = DEPTH_TAPE + TAPE
ANCHOR_TAPE = RECONSTRUCTION_TAPE + TAPE
RECONSTRUCTED_AT = ANCHOR_TAPE + TAPE
COLUMNS = RECONSTRUCTED_AT + 1
"""Columns of a mode in a `ModeTable`:

- `ADDRESS` of heyoka's step; `PARS`: number of its parameters, including the time
- `MARGINS_AT`: index in `ModeTable.ints` of (kind, index of its tolerance) per margin; `MARGINS`:
  number of margins; `FIRST_STOP`: index of the first stop condition
- `LAWS_AT`: index in `ModeTable.ints` of the data of the laws
- tapes of the step's parameters, of the margins followed by the rates, of the rates, of the
  penetrations, of the dependent variables, of the anchors of their reconstruction
- `RECONSTRUCTED_AT`: index in `ModeTable.ints` of the indices of the dependent variables"""


class ModeTable(NamedTuple):
    """Modes of an automaton for the compiled loop."""

    ints: Ints32  # shape (..,)
    # (..,): concatenated codes, outputs and reads of tapes; in `floats` their constants.
    floats: Array
    modes: NDArray[np.int64]  # (m, `COLUMNS`): zeros for modes not compiled yet.


@kernel
def tape_of(program: ModeTable, row: NDArray[np.int64]) -> TapeCode:
    """Return the tape that `TAPE` columns of a `ModeTable` describe."""
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
    program: ModeTable,
    row: NDArray[np.int64],
    state: Array,
    parameters: Array,
    time: float,
    result: Array,
) -> None:
    """Write the first outputs of a tape to `result`, as many as it holds."""
    code, constants, outputs, _, _ = tape_of(program, row)
    tape_values(code, constants, outputs[: result.shape[0]], state, parameters, time, result)


@kernel
def is_on_stop_boundary(
    program: ModeTable, mode: int, parameters: Array, floors: Array, state: Array, time: float
) -> bool:
    """Return whether a flow may start on the boundary of a stop condition.

    `statechart.execution.initial_stop_conditions` then decides. `floors` (n,): displacements of the
    variables that are small, but larger than their errors.
    """
    row = program.modes[mode]
    first, margins = row[FIRST_STOP], row[MARGINS]
    if first == margins:
        return False
    code, constants, outputs, _, _ = tape_of(program, row[MARGIN_TAPE : MARGIN_TAPE + TAPE])
    stops, displaced = outputs[first:margins], state.copy()
    values, displaced_values = np.empty(margins - first), np.empty(margins - first)
    sensitivity = np.zeros(margins - first)
    tape_values(code, constants, stops, state, parameters, time, values)
    for v in range(state.shape[0]):
        displaced[v] += max(floors[v], _MIN_DISPLACEMENT * abs(state[v]))
        tape_values(code, constants, stops, displaced, parameters, time, displaced_values)
        displaced[v] = state[v]
        for i in range(sensitivity.shape[0]):
            sensitivity[i] += abs(displaced_values[i] - values[i])
    is_near = False
    for i in range(sensitivity.shape[0]):
        is_near = is_near or not abs(values[i]) > sensitivity[i]
    return is_near


class FlowWorkspace(NamedTuple):
    """Workspace of a flow: its steps (see `statechart.engines.engine.Path`), and buffers."""

    # Steps, from local time 0.
    times: Array  # shape (s + 1,)
    coefficients: Array  # shape (s, n, terms)
    # of shape (n,) each
    state: Array
    final_state: Array
    pars: Array  # (p,): parameters of heyoka's step.
    clock: Array  # shape (2,)
    series: Array  # shape (n, terms)
    # Powers of the step size, and the step size.
    powers: Array  # shape (terms,)
    length: Array  # shape (1,)
    # (n,): slope errors and motions of a step, see `statechart.engines.taylor_loop.slope_error`.
    slope_errors: Array
    motions: Array
    unresolved: Bools  # (s,): whether the rates of a step are unresolved.
    tolerances: Array  # (m,): tolerances of the margins.
    search: SearchWorkspace
    ranges: Array  # (r, 6): enclosures of the registers over a step.


def flow_workspace(
    steps: int, terms: int, modes: NDArray[np.int64], variables: int, parameters: int
) -> FlowWorkspace:
    """Allocate the workspace of flows of up to `steps` steps in the `modes` of a `ModeTable`."""
    _, operations, _, constants, _, outputs = (
        modes[:, MARGIN_TAPE : MARGIN_TAPE + 6].max(axis=0).tolist()
    )
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


class FlowInputs(NamedTuple):
    """Parameters, constraints and tolerances of a flow."""

    parameters: Array  # shape (p,)
    kinds: Array  # (5,): tolerance of each kind of margin.
    bands: Array  # (b,): tolerances of single margins; -1: see `kinds`.
    floors: Array  # (n,): lower bounds of the sizes of variables.
    constraints: NDArray[np.int64]  # (9,): tape of the constraints.
    # (k,): targets and weights of the constraints.
    targets: Array
    weights: Array
    max_depth: float  # Penetration that ends the flow.
    # Tolerances of the engine, see `statechart.engines.engine.Pace`.
    tolerance: float
    max_step: float
    allowed: float


@kernel
def write_tolerances(
    program: ModeTable, row: NDArray[np.int64], watch: FlowInputs, tolerances: Array
) -> None:
    """Write the tolerance of every margin: its own one, or the one of its kind."""
    for i in range(row[MARGINS]):
        own = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        tolerances[i] = own if own >= 0.0 else watch.kinds[program.ints[row[MARGINS_AT] + 2 * i]]


@kernel
def first_tolerances(
    program: ModeTable,
    row: NDArray[np.int64],
    watch: FlowInputs,
    initial: Array,
    start: float,
    final_tolerances: Array,
    margins: Array,
    tolerances: Array,
) -> None:
    """Write the tolerances of the first search: zero for plain margins that start above zero.

    See `statechart.execution.event_classification`. Writes initial margins if one is plain.
    """
    plain = False
    for i in range(row[MARGINS]):
        tolerances[i] = final_tolerances[i]
        plain = plain or program.ints[row[MARGINS_AT] + 2 * i] == PLAIN
    if plain:
        evaluate(
            program,
            row[MARGIN_TAPE : MARGIN_TAPE + TAPE],
            initial,
            watch.parameters,
            start,
            margins,
        )
        for i in range(row[MARGINS]):
            if program.ints[row[MARGINS_AT] + 2 * i] == PLAIN and margins[i] > final_tolerances[i]:
                tolerances[i] = 0.0


DURATION_ENDED, AT_EVENT, UNRESOLVED = range(3)
"""Results of a flow: it reaches its end time, or an event, or cannot be resolved by this loop."""


@kernel
def _start_integrator(
    program: ModeTable,
    row: NDArray[np.int64],
    watch: FlowInputs,
    workspace: FlowWorkspace,
    state: Array,
    time: float,
) -> None:
    """Reset the integrator to a state and time."""
    workspace.clock[:] = 0.0
    copy_numbers(state, workspace.state)
    if row[PARS] > 0:
        workspace.pars[0] = time
        fixed = row[PARAMETER_TAPE : PARAMETER_TAPE + TAPE]
        evaluate(program, fixed, state, watch.parameters, time, workspace.pars[1 : row[PARS]])


@kernel
def _reconstruction(
    program: ModeTable, row: NDArray[np.int64], watch: FlowInputs, state: Array, start: float
) -> ReconstructionProgram:
    """Return the program that reconstructs the dependent variables of a flow from a state."""
    anchor_tape = row[ANCHOR_TAPE : ANCHOR_TAPE + TAPE]
    anchors = np.empty(anchor_tape[5])
    evaluate(program, anchor_tape, state, watch.parameters, start, anchors)
    code, constants, outputs, _, _ = tape_of(
        program, row[RECONSTRUCTION_TAPE : RECONSTRUCTION_TAPE + TAPE]
    )
    places = program.ints[row[RECONSTRUCTED_AT] : row[RECONSTRUCTED_AT] + outputs.shape[0]]
    return reconstruction_program(
        code, constants, outputs, places, anchors, watch.parameters, state.shape[0]
    )


@kernel
def _write_constant_ranges(prepared: PreparedTape, registers: int, jets: Array) -> None:
    """Write the enclosures of registers that are constant along a flow: their slopes are zero."""
    for r in range(registers):
        jets[r, 0], jets[r, 1] = prepared[4][r, 0], prepared[4][r, 1]
        jets[r, 2] = jets[r, 3] = jets[r, 4] = jets[r, 5] = 0.0


@kernel
def _needs_projection(program: ModeTable, watch: FlowInputs, state: Array, time: float) -> bool:
    """Return whether the constraint violation of a state requires a projection."""
    code, constants, outputs, _, _ = tape_of(program, watch.constraints)
    return (
        largest_deviation(
            code, constants, outputs, watch.targets, watch.weights, state, watch.parameters, time
        )
        > NEAR
    )


@kernel
def flow_to_event(
    program: ModeTable,
    mode: int,
    watch: FlowInputs,
    workspace: FlowWorkspace,
    initial: Array,
    start: float,
    duration: float,
    horizon: float,
) -> tuple[int, int, int, int]:
    """Integrate a mode from the state `initial` to its first event; overwrite it by the last.

    Searches each step for events, and compares its final slope with the rates there, which are the
    first-order terms of the next step. The flow starts at time `start` and lasts at most
    `duration`; `horizon` is its first end. Returns the result (`DURATION_ENDED`, `AT_EVENT`,
    `UNRESOLVED`), the margin that fell (-1: none), and the numbers of steps and of searched boxes.
    """
    row = program.modes[mode]
    times, coeffs, final = workspace.times, workspace.coefficients, workspace.final_state
    state, clock, series = workspace.state, workspace.clock, workspace.series
    address = row[ADDRESS]
    tape = tape_of(program, row[MARGIN_TAPE : MARGIN_TAPE + TAPE])
    pars, h = workspace.pars[: row[PARS]], workspace.length
    margins, n = row[MARGINS], initial.shape[0]
    guards, rates = tape.outputs[:margins], tape.outputs[margins:]
    tolerances, powers, jets = workspace.tolerances, workspace.powers, workspace.ranges
    final_tolerances, initial_margins = np.empty(margins), np.empty(margins)
    write_tolerances(program, row, watch, final_tolerances)
    first_tolerances(
        program, row, watch, initial, start, final_tolerances, initial_margins, tolerances
    )
    n_steps, boxes, pending, length = 0, 0, False, 0.0
    end = min(horizon, duration)
    chunk, chunk_end, base, total, remaining = FIRST_CHUNK, FIRST_CHUNK, 0.0, 0.0, end
    found = (NONE, -1, 0, 0.0, 0.0, 0.0, 0)
    dependent = _reconstruction(program, row, watch, initial, start)
    reconstruct_any(dependent, initial, start)
    prepared = prepare_tape(tape, Steps(times, coeffs, watch.parameters, start), workspace.search)
    _write_constant_ranges(prepared, prepared[0][1] + tape.code.shape[0], jets)
    _start_integrator(program, row, watch, workspace, initial, start)
    while True:
        if chunk_end > coeffs.shape[0]:
            return UNRESOLVED, -1, 0, boxes
        h[0] = min(remaining, watch.max_step)
        reconstruct_any(dependent, state, start + times[n_steps])
        call_step(address, state, pars, clock, h, series)
        limit_step(series, h, state)
        if pending and _has_wrong_slope(prepared[0], rates, watch, workspace, n_steps - 1, length):
            return UNRESOLVED, -1, 0, boxes
        length = h[0]
        scale_series(series, length, coeffs[n_steps], powers)
        advance_clock(clock, length)
        total += length
        n_steps, pending = n_steps + 1, True
        last = length == remaining
        times[n_steps] = end if last else base + total
        if not times[n_steps] > times[n_steps - 1]:
            return UNRESOLVED, -1, 0, boxes
        remaining = 0.0 if last else remaining - length
        if last or n_steps == chunk_end:
            for v in range(n):
                final[v] = horner(coeffs, n_steps - 1, v, 1.0)
            reconstruct_any(dependent, final, start + times[n_steps])
            if _needs_projection(program, watch, final, start + times[n_steps]):
                return UNRESOLVED, -1, 0, boxes
        if is_step_clear(prepared, guards, tolerances, n_steps - 1, jets):
            boxes += 1
        else:
            found = search_step(prepared, guards, tolerances, n_steps - 1, BOXES)
            boxes += found[6]
        if last or found[0] != NONE:
            # No step follows, whose first-order terms would be the rates.
            _write_end_rates(prepared, rates, n_steps - 1, series)
            if _has_wrong_slope(prepared[0], rates, watch, workspace, n_steps - 1, length):
                return UNRESOLVED, -1, 0, boxes
            if found[0] != NONE or end == duration:
                break
            horizon *= GROWTH
            end = min(times[n_steps] + horizon, duration)
            _start_integrator(program, row, watch, workspace, final, start + times[n_steps])
            base, total, remaining, pending = times[n_steps], 0.0, end - times[n_steps], False
            chunk = min(chunk + chunk // 2, LONGEST_CHUNK)
            chunk_end = n_steps + chunk
        elif n_steps == chunk_end:
            chunk = min(chunk + chunk // 2, LONGEST_CHUNK)
            chunk_end += chunk
            base, total, remaining = times[n_steps], 0.0, end - times[n_steps]
    verdict, guard, step, place, at, crossed, _ = found
    if verdict not in (NONE, CROSSING) or _missed_event(
        program, row, watch, times, coeffs, start,
        workspace.unresolved[: n_steps if verdict == NONE else step + 1],
    ):  # fmt: skip
        return UNRESOLVED, -1, 0, boxes
    if verdict == NONE:
        copy_numbers(final, initial)
        return DURATION_ENDED, -1, n_steps, boxes
    kind = program.ints[row[MARGINS_AT] + 2 * guard]
    if kind == PLAIN:
        # A margin that starts at zero may not have fallen since.
        at_zero = abs(initial_margins[guard]) <= final_tolerances[guard]
        # An angle is positive up to its branch cut, where it jumps to a negative value.
        value = value_at(prepared[0], step, guards[guard], place, prepared[3])
        jumps = value > max(final_tolerances[guard], MIN_JUMP * abs(initial_margins[guard]))
        latest = max(at, crossed) * (1.0 + EVALUATION_ROUND_OFF)
        is_step_clear(prepared, guards, final_tolerances, n_steps - 1, jets)
        verdict, first, _, _, at, crossed, _ = search_step(
            prepared, guards, final_tolerances, n_steps - 1, BOXES
        )
        agrees = verdict == CROSSING and first == guard and at <= latest
        if at_zero or jumps or not agrees:
            return UNRESOLVED, -1, 0, boxes
    cut = crossed if kind in (FORCE, HOLD, IMPLIED) else at
    count = cut_steps(times, coeffs, n_steps, cut, initial)
    reconstruct_any(dependent, initial, start + times[count])
    return AT_EVENT, guard, count, boxes


@kernel
def _has_wrong_slope(
    step_tape: StepTape,
    rates: Ints32,
    watch: FlowInputs,
    workspace: FlowWorkspace,
    step: int,
    length: float,
) -> bool:
    """Return whether the final slope of a step is wrong; note whether its rates are unresolved."""
    errors, motions = workspace.slope_errors, workspace.motions
    error = slope_error(workspace.coefficients[step], length, workspace.series, errors, motions)
    if error > max(MAX_SLOPE_ERROR, SLOPE_ERROR_FACTOR * watch.tolerance):
        return True
    followed = _follows_rates(step_tape, rates, watch, errors, motions, length, workspace.ranges)
    workspace.unresolved[step] = not followed
    return False


@kernel
def _write_end_rates(prepared: PreparedTape, rates: Ints32, step: int, series: Array) -> None:
    """Write the rates at the end of a step to the first-order terms of a series."""
    step_tape, regs = prepared[0], prepared[3]
    value_at(step_tape, step, rates[0], 1.0, regs)
    for v in range(rates.shape[0]):
        series[v, 1] = regs[rates[v], 0]


@kernel
def _follows_rates(
    step_tape: StepTape,
    rates: Ints32,
    watch: FlowInputs,
    errors: Array,
    motions: Array,
    length: float,
    jets: Array,
) -> bool:
    """Return whether a step follows its rates: its final slope is right, its rates are resolved.

    If the rates are resolved over the step, the truncation error grows with a power of time above
    the order, and is largest at the end.
    """
    write_roughness(step_tape, jets)
    followed = True
    for v in range(errors.shape[0]):
        motions[v] = max(motions[v], watch.floors[v])
        followed = followed and errors[v] <= watch.allowed * motions[v]
    return followed and not is_unresolved(rates, jets, length, watch.allowed, motions)


@kernel
def _missed_event(
    program: ModeTable,
    row: NDArray[np.int64],
    watch: FlowInputs,
    times: Array,
    coeffs: Array,
    start: float,
    unresolved: Bools,
) -> bool:
    """Return whether steps penetrate a surface, or unresolved ones do not follow their rates."""
    depths = tape_of(program, row[DEPTH_TAPE : DEPTH_TAPE + TAPE])
    steps = Steps(times, coeffs, watch.parameters, start)
    if depths.outputs.shape[0] > 0:
        allowed_depths = np.full(depths.outputs.shape[0], watch.max_depth)
        if search(depths, allowed_depths, steps, 0, unresolved.shape[0], BOXES)[0] != NONE:
            return True
    rates = tape_of(program, row[RATE_TAPE : RATE_TAPE + TAPE])
    first = 0
    while first < unresolved.shape[0]:
        last = first
        while last < unresolved.shape[0] and unresolved[last]:
            last += 1
        if last > first:
            defect = find_defect(
                rates, steps, first, last, watch.floors, watch.allowed, MAX_DEFECT_BOXES
            )
            if defect[0] >= 0:
                return True
        first = last + 1
    return False
