"""Compiled event loop of a scene over a batch of runs: setup, first mode, flows and jumps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import BLIND_GAP, CREEP, DRIFT
from contacts.dynamics.setup import (
    SHORT,
    TIE,
    SceneSetup,
    force_uncertainty,
    tolerated,
    write_tolerances,
)
from contacts.dynamics.setup_evaluation import (
    LOOK_AHEAD,
    Numbers,
    SceneNumbers,
    SetupRules,
    run_buffer,
    run_numbers,
    setup_rules,
)
from contacts.dynamics.snapshot import SCALARS
from contacts.dynamics.starting import starts_hovering
from contacts.event_driven.compiled_instants import (
    GOES_ON,
    RunState,
    conditions,
    hold_conditions,
    jump_instant,
    mode_row,
    switch_contacts,
)
from contacts.impacts.impact import MEANINGS
from contacts.modes.compiled_classification import InstantConstants, allowed, classify
from contacts.scene.parts import MOREAU
from contacts.states import FREE, OFF_CODE, PIN, STATES, superstates_of
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.trace_store import ARCS, EVENTS, TERMS, TIMES, TraceBuffer
from statechart.engines.compiled_flow import (
    DURATION_ENDED,
    FIRST_STOP,
    FORCE,
    GAP,
    KINDS,
    LAWS_AT,
    MARGIN_TAPE,
    MARGINS,
    MARGINS_AT,
    PLAIN,
    SPEED,
    TAPE,
    UNRESOLVED,
    FlowInputs,
    FlowWorkspace,
    ModeTable,
    evaluate,
    flow_to_event,
    is_on_stop_boundary,
)
from statechart.engines.taylor_loop import advance_clock
from statechart.execution import compiled_loop as runs
from statechart.execution.compiled_loop import LOOK_AHEAD as NEXT_LOOK
from statechart.execution.compiled_loop import BatchInputs, BatchResult, Loop
from statechart.execution.event_classification import AT_END
from statechart.execution.execution import FARTHEST
from statechart.execution.flow import LEAST
from statechart.kernels.accumulation import HIGH, WIDTH
from statechart.kernels.copies import copy_counts, copy_numbers
from statechart.kernels.jit import entry, kernel

# Numbers of a contact among the constraints: gap, its rate, slip, point.
_PER_CONTACT = 5
# Jumps at one instant.
MAX_JUMPS_AT_ONCE = 16
# Steps and boxes in one call, which takes some tens of milliseconds, so that it can be interrupted.
_MAX_STEPS, _MAX_BOXES = 4096, 65536
# Calls per run of a batch; a longer run is repeated alone.
_MAX_PAUSES = 64

INSTANTS = 3
"""Number of tapes for the jumps (snapshot, constraints, conditions), before those of the setup."""


class SceneConstants(NamedTuple):
    """Constants that all runs of a batch share."""

    tapes: NDArray[np.int64]  # (7, 9): of the jumps and of the setup.
    rules: SetupRules
    # (c, 3): indices of a contact's cone_n, cone_t, restitution among the values; constants where
    # the index is -1.
    places: Ints
    fixed: Array
    # (b,): index of each margin's tolerance among the bands of `Numbers`; -1 for none.
    sources: Ints
    starts: Bools  # (c, 10): whether a contact may start in the state of that code.
    # Tolerances of gaps and speeds, and uncertainty of forces, in the scene's scales.
    gap: float
    speed: float
    force_uncertainty: float
    numbers: Numbers  # Buffer: the numbers of a run.
    series: Array  # (c, ..): of the touchdowns of every contact.


@kernel
def _write_inputs(
    scene: SceneConstants, floor: float, watch: FlowInputs, instants: InstantConstants
) -> tuple[FlowInputs, InstantConstants]:
    """Return the watches of a run for its setup and tolerances `watch.kinds`.

    Their arrays are reused.
    """
    numbers = scene.numbers
    length, speed = numbers.scales[0], numbers.scales[1]
    acceleration, force = numbers.scales[2], numbers.scales[3]
    gap, slow, weak = watch.kinds[GAP], watch.kinds[SPEED], watch.kinds[FORCE]
    copy_numbers(numbers.values, watch.parameters)
    for i in range(scene.sources.shape[0]):
        source = scene.sources[i]
        watch.bands[i] = numbers.bands[source] if source >= 0 else -1.0
    for i in range(watch.floors.shape[0]):
        watch.floors[i] = max(LEAST * numbers.sizes[i], floor)
    copy_numbers(numbers.sizes, instants.sizes[:-1])
    instants.sizes[-1] = length / speed
    for c in range(scene.places.shape[0]):
        for k in range(3):
            place = scene.places[c, k]
            value = numbers.values[place] if place >= 0 else scene.fixed[c, k]
            if k < 2:
                instants.cones[c, k] = value
            else:
                instants.restitution[c] = value
    return FlowInputs(
        watch.parameters, watch.kinds, watch.bands, watch.floors, watch.constraints, watch.targets,
        watch.weights, max(BLIND_GAP * length, gap), watch.tolerance, watch.max_step, watch.allowed,
    ), InstantConstants(
        instants.numbers, instants.conditions, instants.nodes, instants.slots, instants.sizes,
        scene.gap, instants.allowed,
        instants.cones, instants.restitution, instants.meanings, instants.offsets,
        DRIFT * gap, CREEP * slow, gap, slow, TIE * weak / force, scene.force_uncertainty, force,
        acceleration, SHORT,
        scene.force_uncertainty * speed,
    )  # fmt: skip


@kernel
def _first_mode(
    program: ModeTable, scene: SceneConstants, watch: FlowInputs, instants: InstantConstants,
    scales: Array, state: Array, states: Ints,
) -> int:  # fmt: skip
    """Return the first mode; -1 if it is ambiguous or not compiled."""
    contacts = states.shape[0]
    numbers = np.empty(instants.numbers[5])
    evaluate(program, instants.numbers, state, watch.parameters, 0.0, numbers)
    states_at_rest, n = np.full(contacts, FREE), state.shape[0] // 2
    scalars = n * n + n + 1 + (2 * n + 2) * contacts
    if instants.nodes.shape[0] > 0:
        values, free = conditions(program, watch, instants, state, 0.0), states_at_rest.copy()
        if switch_contacts(instants, values, numbers, scalars, 0, free, states_at_rest) == -2:
            return -1
    if not classify(instants, numbers, n, False, states_at_rest, 0.0, states):
        return -1
    for c in range(contacts):
        gap, rate = numbers[scalars + SCALARS * c], numbers[scalars + SCALARS * c + 1]
        above = starts_hovering(gap, rate, instants.gap, scales[0], scales[1])
        if not scene.starts[c, states[c]] or (above and states[c] != OFF_CODE):
            return -1
    mode = mode_row(program, states)
    if mode >= 0 and is_on_stop_boundary(program, mode, watch.parameters, watch.floors, state, 0.0):
        return -1
    return mode


@kernel
def _end_outcome(
    program: ModeTable, reason: int, margin: int, mode: int, entered: Bools, watch: FlowInputs,
    state: Array, time: float,
) -> int:  # fmt: skip
    """Return the outcome of a run of the batch after its loop has ended.

    Events at the instant of a stop precede it. For events at the end of time see
    `statechart.execution.event_classification.closing`.
    """
    row = program.modes[mode]
    stopped = reason == runs.FELL and margin >= row[FIRST_STOP]
    if reason != runs.OVER and not stopped:
        return runs.UNUSUAL
    if not entered[mode]:
        return runs.ENDED
    margins, certified = np.empty(row[FIRST_STOP] if stopped else row[MARGINS]), False
    evaluate(program, row[MARGIN_TAPE : MARGIN_TAPE + TAPE], state, watch.parameters, time, margins)
    for i in range(margins.shape[0]):
        kind = program.ints[row[MARGINS_AT] + 2 * i]
        band = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        if stopped and not margins[i] > (band if band >= 0.0 else watch.kinds[kind]):
            return runs.UNUSUAL
        if kind == GAP and margins[i] <= AT_END * watch.kinds[GAP]:
            return runs.UNUSUAL
        if kind == SPEED and margins[i] <= watch.kinds[SPEED]:
            return runs.UNUSUAL
        certified = certified or (kind == PLAIN and band >= 0.0)
    if stopped:
        return runs.STOPPED
    return runs.CLOSING if certified else runs.ENDED


@kernel
def _zeros_differ(values: Array, zeros: Bools) -> bool:
    """Return whether the pattern of zero parameters differs from `zeros`."""
    differs = False
    for i in range(values.shape[0]):
        differs = differs or (values[i] == 0.0) != zeros[i]
    return differs


@kernel
def _record_arc(
    block: TraceBuffer, workspace: FlowWorkspace, mode: int, j: int, steps: int, high: float,
    low: float,
) -> None:  # fmt: skip
    """Append the steps of a flow to the block, without trailing terms that are all zero."""
    coeffs, used = workspace.coefficients, block.used
    n, width = coeffs.shape[1], coeffs.shape[2]
    zero = True
    while zero and width > 1:
        for i in range(steps):
            for v in range(n):
                zero = zero and coeffs[i, v, width - 1] == 0.0
        if zero:
            width -= 1
    arc, at, place = used[ARCS], used[TIMES], used[TERMS]
    block.arcs[arc, 0], block.arcs[arc, 1] = mode, j
    block.arcs[arc, 2], block.arcs[arc, 3] = steps, width
    block.places[arc, 0], block.places[arc, 1] = at, place
    block.starts[arc, 0], block.starts[arc, 1] = high, low
    for i in range(steps + 1):
        block.times[at + i] = workspace.times[i]
    for i in range(steps):
        for v in range(n):
            for k in range(width):
                block.coefficients[place + k] = coeffs[i, v, k]
            place += width
    used[ARCS], used[TIMES], used[TERMS] = arc + 1, at + steps + 1, place


@kernel
def _write_constraints(
    program: ModeTable,
    watch: FlowInputs,
    scene: InstantConstants,
    states: Ints,
    state: Array,
    time: float,
) -> None:
    """Write targets and weights of the constraints of a flow that begins in this state."""
    watch.weights[:] = 0.0
    pinned = False
    for c in range(states.shape[0]):
        at = _PER_CONTACT * c
        if states[c] != FREE and states[c] != OFF_CODE:
            watch.weights[at] = 1.0 / scene.gap
            watch.weights[at + 1] = 1.0 / scene.speed
        if states[c] == PIN:
            pinned = True
            watch.weights[at + 2] = 1.0 / scene.speed
            watch.weights[at + 3] = watch.weights[at + 4] = 1.0 / scene.gap
    if not pinned:
        return
    evaluate(program, watch.constraints, state, watch.parameters, time, watch.targets)
    for c in range(states.shape[0]):
        at = _PER_CONTACT * c
        for k in range(at, at + _PER_CONTACT):
            if states[c] != PIN or k < at + 3:
                watch.targets[k] = 0.0


@kernel
def _run(
    program: ModeTable, watch: FlowInputs, workspace: FlowWorkspace, scene: InstantConstants,
    block: TraceBuffer, run: RunState, entered: Bools,
) -> tuple[int, int, float]:  # fmt: skip
    """Flow and jump up to an ambiguous instant or the end.

    Updates `run` and `entered`. Returns the reason, the margin that fell or the series that
    accumulates, and the time to the accumulation.
    """
    clock, place, state, states = run.clock, run.place, run.state, run.states
    contacts = states.shape[0]
    max_steps = workspace.coefficients.shape[0]
    max_terms = workspace.coefficients.size
    first_step, first_box = place[runs.N_STEPS], place[runs.N_BOXES]
    decided_condition = 0  # The condition that fell without a jump
    while True:
        used = block.used
        if (
            used[ARCS] == block.arcs.shape[0]
            or used[EVENTS] + MAX_JUMPS_AT_ONCE + 1 > block.events.shape[0]
            or used[TIMES] + max_steps + 1 > block.times.shape[0]
            or used[TERMS] + max_terms > block.coefficients.shape[0]
        ):
            return runs.FULL, -1, 0.0
        if (
            place[runs.N_STEPS] - first_step > _MAX_STEPS
            or place[runs.N_BOXES] - first_box > _MAX_BOXES
        ):
            return runs.PAUSED, -1, 0.0
        mode = place[runs.N_MODE]
        high, low = clock[runs.T_HIGH], clock[runs.T_LOW]
        start = high
        duration = (clock[runs.T_END] - high) - low
        if duration <= 0.0:
            return runs.OVER, -1, 0.0
        entered[mode] = True
        at = program.modes[mode, LAWS_AT]
        for c in range(contacts):
            states[c] = program.ints[at + c]
        _write_constraints(program, watch, scene, states, state, high)
        if scene.nodes.shape[0] > 0:
            hold_conditions(program, watch, scene, state, high, decided_condition)
        decided_condition = 0
        verdict, margin, steps, boxes = flow_to_event(
            program, mode, watch, workspace, state, high, duration, clock[runs.T_HORIZON]
        )
        if verdict == UNRESOLVED:
            return runs.FLOW, -1, 0.0
        place[runs.N_STEPS] += steps
        place[runs.N_BOXES] += boxes
        if steps > 0:
            _record_arc(block, workspace, mode, place[runs.N_JUMPS], steps, high, low)
            elapsed = workspace.times[steps]
            advance_clock(clock, elapsed)
            if elapsed > 0.0:
                clock[runs.T_HORIZON] = NEXT_LOOK * max(
                    elapsed, clock[runs.T_HIGH] - clock[runs.T_SINCE]
                )
        if verdict == DURATION_ENDED:
            return runs.OVER, -1, 0.0
        high = clock[runs.T_HIGH]
        if margin >= program.modes[mode, FIRST_STOP]:
            return runs.FELL, margin, 0.0
        instants, fired = 0, program.ints[at + contacts + margin]
        while True:
            reason, row, remaining = jump_instant(
                program, watch, scene, block, run, margin, fired, high > start
            )
            if reason != GOES_ON:
                return reason, row, remaining
            if place[runs.N_RETRY] == 0:
                decided_condition = row
                break
            instants += 1
            margin = -1
            fired = fired if place[runs.N_RETRY] == 1 else 0
            if instants > MAX_JUMPS_AT_ONCE:
                return runs.FELL, -1, 0.0
        at_stop = is_on_stop_boundary(
            program, place[runs.N_MODE], watch.parameters, watch.floors, state, clock[runs.T_HIGH]
        )
        if at_stop:
            place[runs.N_RETRY] = 1
            return runs.FELL, -1, 0.0


@kernel(interpreted=False)
def run_batch(
    program: ModeTable, workspace: FlowWorkspace, scene: SceneConstants, first_watch: FlowInputs,
    first_instants: InstantConstants, batch: BatchInputs, block: TraceBuffer, result: BatchResult,
) -> int:  # fmt: skip
    """Start or resume the runs of a batch; return the number of runs that fit into the block.

    For program and workspace see `statechart.engines.compiled_flow`. `first_watch` and
    `first_instants` are buffers. If `batch.resumed`, `scene.numbers` and `first_watch.kinds`
    have the setup. The block takes arcs and events of all runs. Fills a row of `result` for each;
    a run that ends as `UNUSUAL` or `OTHER` leaves nothing else.
    """
    used, before, numbers = block.used, np.empty(4, np.int64), scene.numbers
    contacts = scene.places.shape[0]
    states, run_states = np.empty(contacts, np.int64), np.empty(contacts, np.int64)
    for row in range(batch.inputs.shape[0]):
        ends, clock, place = result.ends[row], result.clock[row], result.place[row]
        state = result.final[row]
        ends[runs.HOW] = runs.UNUSUAL
        copy_counts(used, before)
        if not batch.resumed:
            if not batch.until[row] >= 0.0 or not run_numbers(
                program, scene.tapes[INSTANTS:], scene.rules, batch.code, batch.constants,
                batch.outputs, batch.inputs[row], numbers,
            ):  # fmt: skip
                continue
            if _zeros_differ(numbers.values, batch.zeros):
                ends[runs.HOW] = runs.OTHER
                continue
            write_tolerances(scene.gap, scene.speed, numbers.scales, first_watch.kinds)
        watch, instants = _write_inputs(scene, batch.floor, first_watch, first_instants)
        if not batch.resumed:
            copy_numbers(numbers.initial, state)
            mode = _first_mode(program, scene, watch, instants, numbers.scales, state, states)
            if mode < 0:
                continue
            clock[runs.T_END] = batch.until[row]
            clock[runs.T_HORIZON] = min(
                LOOK_AHEAD * numbers.scales[0] / numbers.scales[1], FARTHEST
            )
            place[runs.N_MODE], place[runs.N_MOST] = mode, batch.most_jumps
            ends[runs.FIRST_MODE] = mode
            copy_numbers(numbers.values, result.values[row])
            copy_numbers(numbers.initial, result.initial[row])
            scene.series[:] = 0.0
            scene.series[:, HIGH] = math.nan
        pauses, run = 0, RunState(clock, place, state, scene.series, run_states)
        while True:
            ends[runs.REASON], ends[runs.MARGIN], clock[runs.T_REST] = _run(
                program, watch, workspace, instants, block, run, result.entered[row]
            )
            pauses += 1
            if ends[runs.REASON] != runs.PAUSED or pauses == _MAX_PAUSES or batch.single:
                break
        if ends[runs.REASON] == runs.FULL and row > 0:
            copy_counts(before, used)
            return row
        outcome = runs.HANDED
        if not batch.resumed:
            outcome = _end_outcome(
                program, ends[runs.REASON], ends[runs.MARGIN], place[runs.N_MODE],
                result.entered[row], watch, state, clock[runs.T_HIGH],
            )  # fmt: skip
        if batch.single and outcome in (runs.UNUSUAL, runs.CLOSING):
            outcome = runs.HANDED
        ends[runs.HOW] = outcome
        if outcome == runs.HANDED:
            # The parameters of the current flow.
            copy_numbers(watch.parameters, result.values[row])
        if outcome == runs.UNUSUAL:
            copy_counts(before, used)
            continue
        spans = result.spans[row]
        spans[0], spans[1] = before[ARCS], used[ARCS]
        spans[2], spans[3] = before[EVENTS], used[EVENTS]
    return batch.inputs.shape[0]


_Program = tuple[Ints32, Array, Ints32]


class SceneLoop:
    """Calls of the compiled loop of a scene (see `statechart.automaton.laws.CompiledLaws.call`).

    `relative` is the tolerance of the integration.
    """

    def __init__(self, numbers: SceneNumbers, loop: Loop, relative: float) -> None:
        self.loop, self.starts, self._setup = loop, numbers.compiled, numbers
        laws = numbers.contacts(np.zeros(len(numbers.parameters.names)))
        self._scene = _declared(numbers, loop, laws, relative)
        self._buffers = _buffers(numbers, loop, laws)
        self.series = self._scene.series
        # Parameters -> tape of the setup, indices of its inputs and of these, other inputs.
        self._inputs: dict[tuple[str, ...], tuple[_Program, list[tuple[int, int]], Array]] = {}
        self._entry: Callable[..., int] | None = None

    def inputs(self, names: tuple[str, ...], table: Array) -> tuple[Ints32, Array, Ints32, Array]:
        """Return the tape of the setup, and its inputs for rows (m, p) of parameter values."""
        if names not in self._inputs:
            tape, inputs = self._setup.parameters.program(frozenset(names))
            literals = self._setup.parameters.literals
            varied = [(i, names.index(name)) for i, name in enumerate(inputs) if name in names]
            fixed = np.array([*(literals.get(name, math.nan) for name in inputs), math.inf])
            self._inputs[names] = tape.program, varied, fixed
        program, varied, fixed = self._inputs[names]
        rows = np.tile(fixed, (len(table), 1))
        for place, column in varied:
            rows[:, place] = table[:, column]
        return (*program, rows)

    def start(self, batch: BatchInputs, block: TraceBuffer, result: BatchResult) -> int:
        """Start the runs of a batch; return how many fit into the block."""
        return self._call(self._scene, batch, block, result)

    def resume(
        self, setup: SceneSetup, floor: float, block: TraceBuffer, result: BatchResult,
        series: Array,
    ) -> None:  # fmt: skip
        """Resume a run."""
        numbers, (watch, _) = self._scene.numbers, self._buffers
        numbers.values[:], numbers.sizes[:] = result.values[0], setup.sizes
        numbers.scales[:] = setup.scales.numbers
        numbers.bands[:] = [setup.bands[name] for name in self._setup.stops]
        watch.kinds[:] = [setup.tolerances[kind] for kind in KINDS]
        scene = self._scene._replace(
            series=series, gap=setup.precision, force_uncertainty=setup.force_uncertainty
        )
        self._call(scene, _RESUMED._replace(floor=floor), block, result)

    def _call(
        self, scene: SceneConstants, batch: BatchInputs, block: TraceBuffer, result: BatchResult
    ) -> int:
        loop = self.loop
        arguments = loop.program, loop.workspace, scene, *self._buffers, batch, block, result
        if self._entry is None:
            self._entry = entry(run_batch, *arguments)
        return self._entry(*arguments)


_RESUMED = BatchInputs(
    np.empty((0, 3), np.int32), np.empty(0), np.empty(0, np.int32), np.empty((1, 0)), np.zeros(1),
    np.zeros(0, np.bool_), 0, 0.0, single=True, resumed=True,
)  # fmt: skip


def _starts(names: Sequence[str], declared: Mapping[str, str]) -> Bools:
    """Return a mask (c, 10) of the state codes in which a contact may start."""
    active = [(state, *superstates_of((state,)).values()) for state in STATES.values()]
    may = [[n not in declared or declared[n] in states for states in active] for n in names]
    return np.array(may, np.bool_).reshape(-1, len(STATES))


def _declared(
    numbers: SceneNumbers, loop: Loop, laws: Sequence[ContactLaw], relative: float
) -> SceneConstants:
    rules, stops = setup_rules(numbers), [*numbers.stops]
    return SceneConstants(
        loop.tapes, rules, *numbers.coefficients(),
        np.array([stops.index(m) if m in stops else -1 for m in loop.margins], np.int64),
        _starts([law.name for law in laws], numbers.scene.initial_modes),
        *tolerated(relative), force_uncertainty(relative),
        run_buffer(len(numbers.parameters.names), len(loop.workspace.state), rules),
        np.empty((max(len(laws), 4), WIDTH)),
    )  # fmt: skip


def _buffers(
    numbers: SceneNumbers, loop: Loop, laws: Sequence[ContactLaw]
) -> tuple[FlowInputs, InstantConstants]:
    variables, parameters = len(loop.workspace.state), len(numbers.parameters.names)
    contacts, count = len(laws), int(loop.tapes[1, 5])
    watch = FlowInputs(
        np.empty(parameters), np.empty(len(KINDS)), np.empty(len(loop.margins)),
        np.empty(variables), loop.tapes[1], np.zeros(count), np.zeros(count), 0.0, *loop.pace[:3],
    )  # fmt: skip
    meanings = [-1 if law.impact == MOREAU else MEANINGS[law.impact] for law in laws]
    instants = InstantConstants(
        loop.tapes[0], loop.tapes[2], numbers.conditions.nodes,
        numbers.conditions.slots(loop.margins), np.empty(variables + 1), 0.0,
        allowed([law.states for law in laws]), np.empty((contacts, 2)), np.empty(contacts),
        np.array(meanings, np.int64), numbers.gap_offsets, *[0.0] * 10,
    )  # fmt: skip
    return watch, instants
