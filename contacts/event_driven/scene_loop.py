"""The compiled loop of a scene over an array of runs: numbers, first mode, flows and instants."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.projection import BLIND_GAP, CREEP, DRIFT
from contacts.dynamics.setup import (
    FORCE_BAND,
    HOLD_PART,
    SHORT,
    TIE,
    SceneSetup,
    force_uncertainty,
    tolerated,
)
from contacts.dynamics.setup_evaluation import (
    LOOK_AHEAD,
    Numbers,
    Rules,
    SceneNumbers,
    run_buffer,
    run_numbers,
)
from contacts.dynamics.snapshot import SCALARS
from contacts.dynamics.starting import hovers
from contacts.event_driven.compiled_instants import (
    CAUSES,
    GOES_ON,
    RunState,
    SceneWatch,
    conditions,
    hold_conditions,
    instant,
    meaning,
    row_of,
    rules_of,
    switched,
)
from contacts.modes.classification import allowed, classify
from contacts.states import CODES, FREE, OFF, OFF_CODE, PIN, superstates_of
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.laws import Setup
from statechart.automaton.trace_store import ARCS, EVENTS, TERMS, TIMES, TraceBuffer
from statechart.engines.compiled_flow import (
    FORCE,
    GAP,
    HOLD,
    IN_VAIN,
    KINDS,
    LAWS_AT,
    MARGINS,
    MARGINS_AT,
    PLAIN,
    SPEED,
    STOPS,
    TAPE,
    WATCHED,
    WHOLE,
    FlowWorkspace,
    Program,
    Watch,
    evaluate,
    flow_to_event,
    stands,
)
from statechart.execution import compiled_loop as runs
from statechart.execution.compiled_loop import LOOK_AHEAD as NEXT_LOOK
from statechart.execution.compiled_loop import BatchInputs, BatchResult, Loop
from statechart.execution.execution import FARTHEST
from statechart.execution.finding import AT_END
from statechart.execution.flow import LEAST
from statechart.kernels.accumulation import HIGH, WIDTH
from statechart.kernels.copies import put, put_counts
from statechart.kernels.jit import entry, kernel

# Numbers of a contact among the constraints: gap, its rate, slip, point.
_PER_CONTACT = 5
# Jumps of an instant.
MOST_AT_ONCE = 16
# So many steps and boxes in one call, some tens of milliseconds.
_STEPS, _BOXES = 4096, 65536
# A run of more pauses is left to an execution of its own.
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
    starts: Bools  # (c, 6): whether a contact may start in the state of that code.
    # Tolerances of gaps and speeds, and what is near a bound, in the scene's scales.
    gap: float
    speed: float
    force_uncertainty: float
    numbers: Numbers  # Buffer: the numbers of a run.
    series: Array  # (7 c, ..): of its jumps, for every contact and cause.


@kernel
def _watches(
    scene: SceneBatch, floor: float, watch: Watch, instants: SceneWatch
) -> tuple[Watch, SceneWatch]:
    """Return what a run is watched for, by its numbers and its tolerances `watch.kinds`.

    Their arrays are filled again.
    """
    numbers = scene.numbers
    length, speed = numbers.scales[0], numbers.scales[1]
    acceleration, force = numbers.scales[2], numbers.scales[3]
    gap, slow, weak = watch.kinds[GAP], watch.kinds[SPEED], watch.kinds[FORCE]
    put(numbers.values, watch.parameters)
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
        watch.weights, max(BLIND_GAP * length, gap), watch.tolerance, watch.max_step, watch.allowed,
    ), SceneWatch(
        instants.numbers, instants.conditions, instants.nodes, instants.slots, instants.sizes,
        scene.gap, instants.allowed,
        instants.cones, instants.restitution, instants.meanings, instants.offsets,
        DRIFT * gap, CREEP * slow, gap, slow, TIE * weak / force, scene.force_uncertainty, force,
        acceleration, SHORT,
        scene.force_uncertainty * speed,
    )  # fmt: skip


@kernel
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
    numbers = np.empty(instants.numbers[5])
    evaluate(program, instants.numbers, state, watch.parameters, 0.0, numbers)
    kept, lowest, n = np.full(contacts, FREE), np.zeros(contacts), state.shape[0] // 2
    first = n * n + n + 1 + (2 * n + 2) * contacts
    if instants.nodes.shape[0] > 0:
        values = conditions(program, watch, instants, state, 0.0)
        if switched(instants, values, numbers, first, 0, np.full(contacts, FREE), kept) == -2:
            return -1
    if not classify(rules_of(instants), numbers, n, False, kept, lowest, taken):
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


@kernel
def _end(
    program: Program, reason: int, margin: int, mode: int, been: Bools, watch: Watch,
    state: Array, time: float,
) -> int:  # fmt: skip
    """Return how a row ends that its loop has left.

    Where a stop fell, what else happens there comes first. For what may just be happening as time
    is over see `statechart.execution.finding.closing`.
    """
    row = program.modes[mode]
    stopped = reason == runs.FELL and margin >= row[STOPS]
    if reason != runs.OVER and not stopped:
        return runs.UNUSUAL
    if not been[mode]:
        return runs.ENDED
    margins, judged = np.empty(row[STOPS] if stopped else row[MARGINS]), False
    evaluate(program, row[WATCHED : WATCHED + TAPE], state, watch.parameters, time, margins)
    for i in range(margins.shape[0]):
        kind = program.ints[row[MARGINS_AT] + 2 * i]
        own = watch.bands[program.ints[row[MARGINS_AT] + 2 * i + 1]]
        if stopped and not margins[i] > (own if own >= 0.0 else watch.kinds[kind]):
            return runs.UNUSUAL
        if kind == GAP and margins[i] <= AT_END * watch.kinds[GAP]:
            return runs.UNUSUAL
        if kind == SPEED and margins[i] <= watch.kinds[SPEED]:
            return runs.UNUSUAL
        judged = judged or (kind == PLAIN and own >= 0.0)
    if stopped:
        return runs.STOPPED
    return runs.CLOSING if judged else runs.ENDED


@kernel
def _other(values: Array, zeros: Bools) -> bool:
    """Return whether other parameters are zero than these."""
    other = False
    for i in range(values.shape[0]):
        other = other or (values[i] == 0.0) != zeros[i]
    return other


@kernel
def _record_arc(
    block: TraceBuffer,
    workspace: FlowWorkspace,
    mode: int,
    j: int,
    steps: int,
    high: float,
    low: float,
) -> None:
    """Write the steps of a flow behind the others, without terms that are zero in all of them."""
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
def _hold(
    program: Program, watch: Watch, scene: SceneWatch, states: Ints, state: Array, time: float
) -> None:
    """Write targets and weights of the constraints of a flow that begins here."""
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
    evaluate(program, watch.off, state, watch.parameters, time, watch.targets)
    for c in range(states.shape[0]):
        at = _PER_CONTACT * c
        for k in range(at, at + _PER_CONTACT):
            if states[c] != PIN or k < at + 3:
                watch.targets[k] = 0.0


@kernel
def _advance(now: Array, elapsed: float) -> None:
    """Advance the clock of a run as `statechart.automaton.clock.Clock.later` does."""
    high = now[runs.T_HIGH]
    total = high + elapsed
    part = total - high
    error = (high - (total - part)) + (elapsed - part) + now[runs.T_LOW]
    now[runs.T_HIGH] = total + error
    now[runs.T_LOW] = error - (now[runs.T_HIGH] - total)


@kernel
def _run(
    program: Program,
    watch: Watch,
    workspace: FlowWorkspace,
    scene: SceneWatch,
    block: TraceBuffer,
    run: RunState,
    entered: Bools,
) -> tuple[int, int, float]:
    """Flow and jump until an instant is not unambiguous.

    Brings `run` and `entered` up to date. Returns why it ends, the margin that fell or the series
    that accumulates, and the time to the accumulation.
    """
    now, place, state, kept = run.now, run.place, run.state, run.states
    contacts = kept.shape[0]
    most = workspace.coefficients.shape[0]
    most_terms = workspace.coefficients.size
    begun_steps, begun_boxes = place[runs.N_STEPS], place[runs.N_BOXES]
    decided = 0  # by what fell as a mode went on without a jump
    while True:
        used = block.used
        if (
            used[ARCS] == block.arcs.shape[0]
            or used[EVENTS] + MOST_AT_ONCE + 1 > block.events.shape[0]
            or used[TIMES] + most + 1 > block.times.shape[0]
            or used[TERMS] + most_terms > block.coefficients.shape[0]
        ):
            return runs.FULL, -1, 0.0
        if place[runs.N_STEPS] - begun_steps > _STEPS or place[runs.N_BOXES] - begun_boxes > _BOXES:
            return runs.PAUSED, -1, 0.0
        mode = place[runs.N_MODE]
        high, low = now[runs.T_HIGH], now[runs.T_LOW]
        begun = high
        duration = (now[runs.T_END] - high) - low
        if duration <= 0.0:
            return runs.OVER, -1, 0.0
        entered[mode] = True
        at = program.modes[mode, LAWS_AT]
        for c in range(contacts):
            kept[c] = program.ints[at + c]
        _hold(program, watch, scene, kept, state, high)
        if scene.nodes.shape[0] > 0:
            hold_conditions(program, watch, scene, state, high, decided)
        decided = 0
        verdict, margin, steps, boxes = flow_to_event(
            program, mode, watch, workspace, state, high, duration, now[runs.T_HORIZON]
        )
        if verdict == IN_VAIN:
            return runs.FLOW, -1, 0.0
        place[runs.N_STEPS] += steps
        place[runs.N_BOXES] += boxes
        if steps > 0:
            _record_arc(block, workspace, mode, place[runs.N_JUMPS], steps, high, low)
            elapsed = workspace.times[steps]
            _advance(now, elapsed)
            if elapsed > 0.0:
                now[runs.T_HORIZON] = NEXT_LOOK * max(elapsed, now[runs.T_HIGH] - now[runs.T_SINCE])
        if verdict == WHOLE:
            return runs.OVER, -1, 0.0
        high = now[runs.T_HIGH]
        if margin >= program.modes[mode, STOPS]:
            return runs.FELL, margin, 0.0
        asked, fired = 0, program.ints[at + contacts + margin]
        while True:
            reason, row, rest = instant(
                program, watch, scene, block, run, margin, fired, high > begun
            )
            if reason != GOES_ON:
                return reason, row, rest
            if place[runs.N_RETRY] == 0:
                decided = row
                break
            asked += 1
            margin = -1
            fired = fired if place[runs.N_RETRY] == 1 else 0
            if asked > MOST_AT_ONCE:
                return runs.FELL, -1, 0.0
        at_stop = stands(
            program, place[runs.N_MODE], watch.parameters, watch.floors, state, now[runs.T_HIGH]
        )
        if at_stop:
            place[runs.N_RETRY] = 1
            return runs.FELL, -1, 0.0


@kernel
def _tolerances(scene: SceneBatch, scales: Array, kinds: Array) -> None:
    """Write the tolerance of each kind of margin."""
    kinds[PLAIN], kinds[GAP] = 0.0, max(scene.gap * scales[0], scales[4])
    kinds[SPEED], kinds[FORCE] = scene.speed * scales[1], FORCE_BAND * scales[3]
    kinds[HOLD] = HOLD_PART * kinds[FORCE]


@kernel
def _no_series(series: Array) -> None:
    for i in range(series.shape[0]):
        for k in range(WIDTH):
            series[i, k] = 0.0
        series[i, HIGH] = math.nan


@kernel(interpreted=False)
def run_batch(
    program: Program,
    workspace: FlowWorkspace,
    scene: SceneBatch,
    first_watch: Watch,
    first_instants: SceneWatch,
    rows: BatchInputs,
    block: TraceBuffer,
    found: BatchResult,
) -> int:
    """Take runs to their ends, from their start or on; return how many before the block was full.

    For program and memory see `statechart.engines.compiled_flow`. `first_watch` and
    `first_instants` are buffers: where the numbers of a run are known, they stand in
    `scene.numbers`, and the tolerances in `first_watch.kinds`. The block takes arcs and events of
    all runs. Fills `found`, a row for each; a run that ends as `UNUSUAL` or `OTHER` leaves nothing
    else. Of a run that has begun it says where that is.
    """
    used, before, numbers = block.used, np.empty(4, np.int64), scene.numbers
    contacts = scene.places.shape[0]
    taken, kept = np.empty(contacts, np.int64), np.empty(contacts, np.int64)
    for row in range(rows.inputs.shape[0]):
        ends, now, place = found.ends[row], found.now[row], found.place[row]
        state = found.final[row]
        ends[runs.HOW] = runs.UNUSUAL
        put_counts(used, before)
        if not rows.known:
            if not rows.until[row] >= 0.0 or not run_numbers(
                program, scene.tapes[INSTANTS:], scene.rules, rows.code, rows.constants,
                rows.outputs, rows.inputs[row], numbers,
            ):  # fmt: skip
                continue
            if _other(numbers.values, rows.zeros):
                ends[runs.HOW] = runs.OTHER
                continue
            _tolerances(scene, numbers.scales, first_watch.kinds)
        watch, instants = _watches(scene, rows.floor, first_watch, first_instants)
        if not rows.resumed:
            put(numbers.initial, state)
            mode = _start(program, scene, watch, instants, numbers.scales, state, taken)
            if mode < 0:
                continue
            now[runs.T_END] = rows.until[row]
            now[runs.T_HORIZON] = min(LOOK_AHEAD * numbers.scales[0] / numbers.scales[1], FARTHEST)
            place[runs.N_MODE], place[runs.N_MOST] = mode, rows.most_jumps
            ends[runs.FIRST_MODE] = mode
            put(numbers.values, found.values[row])
            put(numbers.initial, found.initial[row])
            _no_series(scene.series)
        pauses, run = 0, RunState(now, place, state, scene.series, kept)
        while True:
            ends[runs.REASON], ends[runs.MARGIN], now[runs.T_REST] = _run(
                program, watch, workspace, instants, block, run, found.entered[row]
            )
            pauses += 1
            if ends[runs.REASON] != runs.PAUSED or pauses == _PAUSES or rows.single:
                break
        if ends[runs.REASON] == runs.FULL and row > 0:
            put_counts(before, used)
            return row
        how = runs.HANDED
        if not rows.resumed:
            how = _end(
                program, ends[runs.REASON], ends[runs.MARGIN], place[runs.N_MODE],
                found.entered[row], watch, state, now[runs.T_HIGH],
            )  # fmt: skip
        if rows.single and how in (runs.UNUSUAL, runs.CLOSING):
            how = runs.HANDED
        ends[runs.HOW] = how
        if how == runs.HANDED:
            # Those of the flow that it has come to.
            put(watch.parameters, found.values[row])
        if how == runs.UNUSUAL:
            put_counts(before, used)
            continue
        spans = found.spans[row]
        spans[0], spans[1] = before[ARCS], used[ARCS]
        spans[2], spans[3] = before[EVENTS], used[EVENTS]
    return rows.inputs.shape[0]


_NAMES = {code: name for name, code in CODES.items() if name != OFF} | {OFF_CODE: OFF}


class SceneLoop:
    """Calls of the compiled loop of a scene (see `statechart.automaton.laws.CompiledLaws.call`).

    Without `rules` the loop starts no runs; `relative` is the tolerance of the integration.
    """

    def __init__(
        self, numbers: SceneNumbers, rules: Rules | None, loop: Loop, relative: float
    ) -> None:
        self.loop, self.starts, self._setup = loop, rules is not None, numbers
        laws = numbers.contacts(np.zeros(len(numbers.parameters.names)))
        rules = rules or no_rules(numbers)
        self._scene = _declared(numbers, rules, loop, laws, relative)
        self._buffers = _buffers(numbers, loop, laws)
        self.series = self._scene.series
        self._inputs: dict[tuple[str, ...], _Inputs] = {}
        self._entry: Callable[..., int] | None = None

    def inputs(self, names: tuple[str, ...], table: Array) -> tuple[Ints32, Array, Ints32, Array]:
        """Return the tape of the numbers of runs, and what it takes for rows (m, p) of values."""
        if names not in self._inputs:
            tape, inputs = self._setup.parameters.program(frozenset(names))
            literals = self._setup.parameters.literals
            given = [(i, names.index(name)) for i, name in enumerate(inputs) if name in names]
            fixed = np.array([*(literals.get(name, math.nan) for name in inputs), math.inf])
            self._inputs[names] = _Inputs(*tape.program, given, fixed)
        made = self._inputs[names]
        found = np.empty((len(table), len(made.fixed)))
        found[:] = made.fixed
        for place, column in made.varied:
            found[:, place] = table[:, column]
        return made.code, made.constants, made.outputs, found

    def start(self, rows: BatchInputs, block: TraceBuffer, found: BatchResult) -> int:
        """Make runs; return how many of them before the block was full."""
        return self._call(self._scene, rows, block, found)

    def begin(
        self, setup: Setup, until: float, most_jumps: int, floor: float, block: TraceBuffer,
        found: BatchResult,
    ) -> None:  # fmt: skip
        """Make a run of which the numbers are known."""
        scene = self._write_numbers(setup, setup.values)
        scene.numbers.initial[:] = setup.initial
        ends = np.array([until], float)
        rows = _SINGLE_RUN._replace(until=ends, most_jumps=most_jumps, floor=floor)
        self._call(scene, rows, block, found)

    def resume(
        self, setup: Setup, floor: float, block: TraceBuffer, found: BatchResult, series: Array
    ) -> None:
        """Take a run on that has come somewhere."""
        scene = self._write_numbers(setup, found.values[0])._replace(series=series)
        self._call(scene, _SINGLE_RUN._replace(floor=floor, resumed=True), block, found)

    def _write_numbers(self, setup: Setup, values: Array) -> SceneBatch:
        """Write the numbers of a run to the buffers."""
        assert isinstance(setup, SceneSetup)
        assert setup.sizes is not None
        numbers, (watch, _) = self._scene.numbers, self._buffers
        scales = setup.scales
        numbers.values[:], numbers.sizes[:] = values, setup.sizes
        numbers.scales[:] = (
            scales.length, scales.speed, scales.acceleration, scales.force, scales.rounding,
        )  # fmt: skip
        numbers.bands[:] = [setup.bands[name] for name in self._setup.stops]
        watch.kinds[:] = [setup.tolerances[kind] for kind in KINDS]
        return self._scene._replace(gap=setup.precision, force_uncertainty=setup.force_uncertainty)

    def _call(
        self, scene: SceneBatch, rows: BatchInputs, block: TraceBuffer, found: BatchResult
    ) -> int:
        loop = self.loop
        arguments = loop.program, loop.workspace, scene, *self._buffers, rows, block, found
        if self._entry is None:
            self._entry = entry(run_batch, *arguments)
        return self._entry(*arguments)


class _Inputs(NamedTuple):
    """Tape of the numbers of runs by the values of some parameters."""

    code: Ints32
    constants: Array
    outputs: Ints32
    varied: list[tuple[int, int]]  # Places in what it takes, and among the parameters.
    fixed: Array  # Its inputs, but for these.


_SINGLE_RUN = BatchInputs(
    np.empty((0, 3), np.int32), np.empty(0), np.empty(0, np.int32), np.empty((1, 0)), np.zeros(1),
    np.zeros(0, np.bool_), 0, 0.0, single=True, resumed=False, known=True,
)  # fmt: skip


def no_rules(numbers: SceneNumbers) -> Rules:
    """Return what stands for the rules where runs are not started by the loop."""
    none, nowhere = np.empty(0), np.empty(0, np.int64)
    forced = np.zeros(len(numbers.stops), np.bool_)
    return Rules(nowhere, none, none, nowhere, 0, 0, 0, forced, numbers.far)


def _starts(names: Sequence[str], declared: Mapping[str, str]) -> Bools:
    """Return (c, 6): whether a contact may start in the state of that code, as declared."""
    found = np.zeros((len(names), len(_NAMES)), np.bool_)
    for place, name in enumerate(names):
        wanted = declared.get(name)
        for code, state in _NAMES.items():
            fits = {state, *superstates_of((state,)).values()}
            found[place, code] = wanted is None or wanted in fits
    return found


def _declared(
    numbers: SceneNumbers, rules: Rules, loop: Loop, laws: Sequence[ContactLaw], relative: float
) -> SceneBatch:
    """Return what is the same whatever the values: what contacts may do, where coefficients are."""
    count = len(laws)
    gap, speed, _ = tolerated(relative)
    stops = [*numbers.stops]
    return SceneBatch(
        loop.tapes,
        rules,
        *numbers.coefficients(),
        np.array([stops.index(m) if m in stops else -1 for m in loop.margins], np.int64),
        _starts([law.name for law in laws], numbers.scene.initial_modes),
        gap,
        speed,
        force_uncertainty(relative),
        run_buffer(len(numbers.parameters.names), len(loop.workspace.state), rules),
        np.empty((max(len(CAUSES) * count, 4), WIDTH)),
    )


def _buffers(
    numbers: SceneNumbers, loop: Loop, laws: Sequence[ContactLaw]
) -> tuple[Watch, SceneWatch]:
    """Return buffers for the flows and the instants of a run."""
    variables, parameters = len(loop.workspace.state), len(numbers.parameters.names)
    contacts, count = len(laws), int(loop.tapes[1, 5])
    watch = Watch(
        np.empty(parameters),
        np.empty(len(KINDS)),
        np.empty(len(loop.margins)),
        np.empty(variables),
        loop.tapes[1],
        np.zeros(count),
        np.zeros(count),
        0.0,
        *loop.pace[:3],
    )
    instants = SceneWatch(
        loop.tapes[0],
        loop.tapes[2],
        numbers.conditions.nodes,
        numbers.conditions.slots(loop.margins),
        np.empty(variables + 1),
        0.0,
        allowed(tuple([law.states for law in laws])),
        np.empty((contacts, 2)),
        np.empty(contacts),
        np.array([meaning(law) for law in laws], np.int64),
        numbers.gap_offsets,
        *[0.0] * 10,
    )
    return watch, instants
