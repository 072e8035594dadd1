"""Runs of a scene, one after another in one compiled call: numbers, first mode, loop."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.gates import conditions_at
from contacts.dynamics.setup_evaluation import Numbers, Rules, run_numbers
from contacts.dynamics.snapshot import SCALARS
from contacts.dynamics.starting import hovers
from contacts.event_driven.hit import SceneWatch, classified
from contacts.event_driven.run_compiled import row_of, run_compiled
from contacts.event_driven.switching import switched
from contacts.states import FREE, OFF_CODE
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.trace_store import ARCS, EVENTS, TraceBuffer
from statechart.engines.engine import Pace
from statechart.engines.flow_watch import GAP, PLAIN, SPEED, Watch
from statechart.engines.mode_table import (
    MARGINS,
    MARGINS_AT,
    STOPS,
    TAPE,
    WATCHED,
    Program,
    Scratch,
    stands,
    tape_of,
)
from statechart.execution.batch import (
    CLOSING,
    ENDED,
    FIRST_MODE,
    HANDED,
    HOW,
    MARGIN,
    OTHER,
    REASON,
    STOPPED,
    UNUSUAL,
    BatchInputs,
    BatchResult,
)
from statechart.execution.compiled_loop import (
    FELL,
    FULL,
    N_MODE,
    N_MOST,
    OVER,
    PAUSED,
    T_END,
    T_HIGH,
    T_HORIZON,
    T_REST,
)
from statechart.execution.execution import FARTHEST
from statechart.execution.finding import AT_END
from statechart.execution.flow import LEAST
from statechart.kernels.accumulation import HIGH, WIDTH
from statechart.kernels.copies import put
from statechart.kernels.jit import kernel, part
from statechart.kernels.tapes import tape_values

# What a longer run takes is not worth a row.
_PAUSES = 64

INSTANTS = 3
"""So many tapes, those of the instants, stand before those of the numbers: the scene's numbers,
its constraints, its conditions."""


class SceneBatch(NamedTuple):
    """Constants that all runs of a batch share."""

    tapes: NDArray[np.int64]  # (7, 9): of the instants and of the numbers.
    rules: Rules
    # (c, 3): where a contact's cone_n, cone_t, restitution are found among the values; what they
    # are where that is -1.
    places: Ints
    fixed: Array
    # (b,): place of the own tolerance of each margin among the bands of `Numbers`; -1 for none.
    sources: Ints
    # See `SceneWatch`.
    allowed: Bools
    meanings: Ints
    starts: Bools  # (c, 6): whether a contact may start in the state of that code.
    # Tolerances, in the scene's scales.
    gap: float
    speed: float
    force: float
    # Likewise; see `SceneWatch`, `Watch.room` and `Setup.horizon`.
    near: float
    creep: float
    unseen: float
    tie: float
    doubtful: float
    short: float
    ahead: float


@part
def _watches(
    scene: SceneBatch, numbers: Numbers, floor: float, watch: Watch, instants: SceneWatch
) -> tuple[Watch, SceneWatch]:
    """Return what a run is watched for, by its numbers; their arrays are filled again."""
    length, speed = numbers.scales[0], numbers.scales[1]
    acceleration, force = numbers.scales[2], numbers.scales[3]
    rounding = numbers.scales[4]
    gap = max(scene.gap * length, rounding)
    slow, weak = scene.speed * speed, scene.force * force
    put(numbers.values, watch.parameters)
    watch.kinds[0], watch.kinds[1], watch.kinds[2], watch.kinds[3] = 0.0, gap, slow, weak
    for i in range(scene.sources.shape[0]):
        source = scene.sources[i]
        watch.bands[i] = numbers.bands[source] if source >= 0 else -1.0
    for i in range(watch.floors.shape[0]):
        watch.floors[i] = max(LEAST * numbers.sizes[i], floor)
    put(numbers.sizes, instants.sizes[:-1])
    instants.sizes[-1] = length / speed
    for c in range(scene.places.shape[0]):
        for k in range(3):
            place = scene.places[c, k]
            value = numbers.values[place] if place >= 0 else scene.fixed[c, k]
            if k < 2:
                instants.cones[c, k] = value
            else:
                instants.restitution[c] = value
    return Watch(
        watch.parameters, watch.kinds, watch.bands, watch.floors, watch.off, watch.targets,
        watch.weights, max(scene.unseen * length, gap),
    ), SceneWatch(
        instants.numbers, instants.conditions, instants.nodes, instants.slots, instants.sizes,
        instants.relative, instants.allowed,
        instants.cones, instants.restitution, instants.meanings, instants.offsets, scene.near * gap,
        scene.creep * slow, gap, slow, scene.tie * weak / force, scene.doubtful, force,
        acceleration, scene.short, scene.doubtful * speed,
    )  # fmt: skip


@part
def _start(
    program: Program,
    scene: SceneBatch,
    watch: Watch,
    instants: SceneWatch,
    scales: Array,
    state: Array,
    taken: Ints,
) -> int:
    """Return the first mode; -1 where that takes more than the state, or is not compiled."""
    contacts = taken.shape[0]
    code, constants, outputs, _, _ = tape_of(program, instants.numbers)
    numbers = np.empty(outputs.shape[0])
    tape_values(code, constants, outputs, state, watch.parameters, 0.0, numbers)
    kept, lowest, n = np.full(contacts, FREE), np.zeros(contacts), state.shape[0] // 2
    first = n * n + n + 1 + (2 * n + 2) * contacts
    if instants.nodes.shape[0] > 0:
        code, constants, outputs, _, _ = tape_of(program, instants.conditions)
        values = conditions_at(
            code,
            constants,
            outputs,
            instants.sizes,
            instants.relative,
            state,
            watch.parameters,
            0.0,
        )
        if switched(instants, values, numbers, first, 0, np.full(contacts, FREE), kept) == -2:
            return -1
    if not classified(instants, numbers, n, False, kept, lowest, taken):
        return -1
    for c in range(contacts):
        gap, rate = numbers[first + SCALARS * c], numbers[first + SCALARS * c + 1]
        above = hovers(gap, rate, instants.gap, scales[0], scales[1])
        if not scene.starts[c, taken[c]] or (above and taken[c] != OFF_CODE):
            return -1
    mode = row_of(program, taken)
    if mode >= 0 and stands(program, mode, watch.parameters, watch.floors, state, 0.0):
        return -1
    return mode


@part
def _closing(program: Program, mode: int, watch: Watch, state: Array, time: float) -> int:
    """Return how a run ends whose time is over, see `statechart.execution.finding.closing`."""
    row = program.modes[mode]
    code, constants, outputs, _, _ = tape_of(program, row[WATCHED : WATCHED + TAPE])
    margins, judged = np.empty(row[MARGINS]), False
    tape_values(code, constants, outputs[: row[MARGINS]], state, watch.parameters, time, margins)
    for i in range(margins.shape[0]):
        kind = program.ints[row[MARGINS_AT] + 2 * i]
        own = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        if kind == GAP and margins[i] <= AT_END * watch.kinds[GAP]:
            return UNUSUAL
        if kind == SPEED and margins[i] <= watch.kinds[SPEED]:
            return UNUSUAL
        judged = judged or (kind == PLAIN and own >= 0.0)
    return CLOSING if judged else ENDED


@part
def _alone(program: Program, mode: int, watch: Watch, state: Array, time: float) -> bool:
    """Whether nothing but a stop happens at an instant: what else does comes first."""
    row = program.modes[mode]
    code, constants, outputs, _, _ = tape_of(program, row[WATCHED : WATCHED + TAPE])
    margins = np.empty(row[STOPS])
    tape_values(code, constants, outputs[: row[STOPS]], state, watch.parameters, time, margins)
    for i in range(margins.shape[0]):
        own = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        kind = program.ints[row[MARGINS_AT] + 2 * i]
        if not margins[i] > (own if own >= 0.0 else watch.kinds[kind]):
            return False
    return True


@part
def _end(
    program: Program, reason: int, margin: int, place: Ints, been: Bools, watch: Watch,
    state: Array, time: float,
) -> int:  # fmt: skip
    """Return how a row ends that its loop has left."""
    mode = place[N_MODE]
    if reason == FELL and margin >= program.modes[mode, STOPS]:
        return STOPPED if _alone(program, mode, watch, state, time) else UNUSUAL
    if reason != OVER:
        return UNUSUAL
    return _closing(program, mode, watch, state, time) if been[mode] else ENDED


@part
def put_ints(source: Ints, target: Ints) -> None:
    """Copy whole numbers (n,)."""
    for i in range(len(source)):
        target[i] = source[i]


@part
def _other(values: Array, zeros: Bools) -> bool:
    """Whether other parameters are zero than these."""
    other = False
    for i in range(values.shape[0]):
        other = other or (values[i] == 0.0) != zeros[i]
    return other


@kernel
def run_batch(
    program: Program,
    pace: Pace,
    memory: Scratch,
    scene: SceneBatch,
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    rows: BatchInputs,
    numbers: Numbers,
    first_watch: Watch,
    first_instants: SceneWatch,
    series: Array,
    block: TraceBuffer,
    found: BatchResult,
) -> int:
    """Make runs from their numbers to their ends; return how many were made before it was full.

    Parameters
    ----------
    program, pace, memory
        See `statechart.engines.mode_table`.
    scene : SceneBatch
    code, constants, outputs
        Tape of the parameters.
    rows : BatchInputs
    numbers, first_watch, first_instants, series
        Memory.
    block : TraceBuffer
        Takes arcs and events of all rows.
    found : BatchResult
        To be filled, a row for each; a row that ends as `UNUSUAL` or `OTHER` leaves nothing else.
    """
    used = block.used
    state, taken = np.empty(numbers.initial.shape[0]), np.empty(scene.places.shape[0], np.int64)
    before = np.empty(4, np.int64)
    for row in range(rows.inputs.shape[0]):
        ends, now, place = found.ends[row], found.now[row], found.place[row]
        ends[HOW] = UNUSUAL
        put_ints(used, before)
        if not rows.until[row] >= 0.0 or not run_numbers(
            program, scene.tapes[INSTANTS:], scene.rules, code, constants, outputs,
            rows.inputs[row], numbers,
        ):  # fmt: skip
            continue
        if _other(numbers.values, rows.zeros):
            ends[HOW] = OTHER
            continue
        watch, instants = _watches(scene, numbers, rows.floor, first_watch, first_instants)
        put(numbers.initial, state)
        mode = _start(program, scene, watch, instants, numbers.scales, state, taken)
        if mode < 0:
            continue
        now[:] = 0.0
        place[:] = 0
        now[T_END] = rows.until[row]
        now[T_HORIZON] = min(scene.ahead * numbers.scales[0] / numbers.scales[1], FARTHEST)
        place[N_MODE], place[N_MOST] = mode, rows.most_jumps
        for i in range(series.shape[0]):
            for k in range(WIDTH):
                series[i, k] = 0.0
            series[i, HIGH] = math.nan
        pauses = 0
        while True:
            reason, margin, now[T_REST] = run_compiled(
                program, pace, watch, memory, instants, block, now, place, state, series,
                found.entered[row],
            )  # fmt: skip
            pauses += 1
            if reason != PAUSED or pauses == _PAUSES or rows.alone:
                break
        if reason == FULL and row > 0:
            put_ints(before, used)
            return row
        how = _end(program, reason, margin, place, found.entered[row], watch, state, now[T_HIGH])
        if rows.alone and how in (UNUSUAL, CLOSING):
            how = HANDED
        if how == UNUSUAL:
            put_ints(before, used)
            continue
        ends[HOW], ends[REASON], ends[MARGIN], ends[FIRST_MODE] = how, reason, margin, mode
        spans = found.spans[row]
        spans[0], spans[1] = before[ARCS], used[ARCS]
        spans[2], spans[3] = before[EVENTS], used[EVENTS]
        put(numbers.values, found.values[row])
        put(numbers.initial, found.initial[row])
        put(state, found.final[row])
    return rows.inputs.shape[0]
