"""A run in compiled code, from flow to flow, as long as its instants are usual ones."""

from __future__ import annotations

import math

import numpy as np

from contacts.dynamics.gates import PER_CONDITION, conditions_at, round_off
from contacts.dynamics.snapshot import SCALARS
from contacts.event_driven.hit import SceneWatch, classified, hit
from contacts.event_driven.switching import hold_conditions, switched
from contacts.states import FREE, OFF_CODE, PIN
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.trace_store import ARCS, EVENTS, MADE, TERMS, TIMES, TraceBuffer
from statechart.engines.engine import Pace
from statechart.engines.flow_watch import SPEED, Watch
from statechart.engines.mode_table import (
    ADDRESS,
    LAWS_AT,
    MARGINS_AT,
    STOPS,
    Program,
    Scratch,
    stands,
    tape_of,
)
from statechart.engines.whole_flow import ENDED, UNUSUAL, flow_to_event
from statechart.execution.compiled_loop import (
    ACCUMULATES,
    COUNTED,
    FELL,
    FLOW,
    FULL,
    LOOK_AHEAD,
    N_ASKED,
    N_BOXES,
    N_JUMPS,
    N_MODE,
    N_MOST,
    N_STEPS,
    OVER,
    PAUSED,
    T_END,
    T_HIGH,
    T_HORIZON,
    T_LOW,
    T_SINCE,
)
from statechart.execution.livelock import STEADY
from statechart.kernels.accumulation import follow
from statechart.kernels.copies import put
from statechart.kernels.jit import kernel, part
from statechart.kernels.tapes import tape_values

# Numbers of a contact among the constraints: gap, its rate, slip, point.
_PER_CONTACT = 5
TOUCHDOWN, LIFTOFF, STICK, SLIP, REVERSE, ENABLE, DISABLE = range(7)
"""What a change of a contact's state is called, see `contacts.states.cause_of`."""
CAUSES = ("touchdown", "liftoff", "stick", "slip", "reverse", "enable", "disable")
"""In that order."""
_PER_CAUSE = len(CAUSES)
GOES_ON = -1
# Jumps of an instant.
MOST_AT_ONCE = 16
# So many steps and boxes in one call, some tens of milliseconds.
_STEPS, _BOXES = 4096, 65536


@part
def record_arc(
    block: TraceBuffer, memory: Scratch, mode: int, j: int, steps: int, high: float, low: float
) -> None:
    """Write the steps of a flow behind the others, without terms that are zero in all of them."""
    coeffs, used = memory.coefficients, block.used
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
        block.times[at + i] = memory.times[i]
    for i in range(steps):
        for v in range(n):
            for k in range(width):
                block.coefficients[place + k] = coeffs[i, v, k]
            place += width
    used[ARCS], used[TIMES], used[TERMS] = arc + 1, at + steps + 1, place


@part
def _cause(before: int, after: int) -> int:
    if before == OFF_CODE or after == OFF_CODE:
        return ENABLE if before == OFF_CODE else DISABLE
    if before == FREE:
        return TOUCHDOWN
    if after == FREE:
        return LIFTOFF
    if after == PIN:
        return STICK
    return SLIP if before == PIN else REVERSE


@part
def _hold(
    program: Program,
    watch: Watch,
    scene: SceneWatch,
    states: Ints,
    state: Array,
    time: float,
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
    code, constants, outputs, _, _ = tape_of(program, watch.off)
    tape_values(code, constants, outputs, state, watch.parameters, time, watch.targets)
    for c in range(states.shape[0]):
        at = _PER_CONTACT * c
        for k in range(at, at + _PER_CONTACT):
            if states[c] != PIN or k < at + 3:
                watch.targets[k] = 0.0


@part
def row_of(program: Program, states: Ints) -> int:
    """Return the mode of these states of the contacts; -1 where it is not compiled."""
    modes = program.modes
    for row in range(modes.shape[0]):
        at = modes[row, LAWS_AT]
        if modes[row, ADDRESS] == 0 or at < 0:
            continue
        same = True
        for c in range(states.shape[0]):
            same = same and program.ints[at + c] == states[c]
        if same:
            return row
    return -1


@part
def _in_turn(block: TraceBuffer, row: int, jumps: int) -> bool:
    """Whether other contacts may have been hit since a contact last was: the laws are to know."""
    if row % _PER_CAUSE != TOUCHDOWN:
        return False
    contact, last = row // _PER_CAUSE, block.used[EVENTS] - 1
    for event in range(last, max(last - jumps, -1), -1):
        struck, group = block.events[event, 4], block.events[event, 5]
        if block.events[event, 0] == MADE or group != 0 or (struck >= 0 and struck != contact):
            return True
        if event < last and struck == contact:
            return False
    return True


@part
def _instant(
    program: Program,
    watch: Watch,
    scene: SceneWatch,
    block: TraceBuffer,
    now: Array,
    place: Ints,
    state: Array,
    series: Array,
    margin: int,
    fired: int,
    flowed: bool,
    kept: Ints,
) -> tuple[int, int, float]:
    """Jump, where that is as simple as most jumps are.

    Parameters
    ----------
    margin : int
        That fell; -1 where the instant goes on after a jump.
    fired : int
        Condition that fell, see `switched`; 0 for none, and after an impact.
    flowed : bool
        Whether time has passed since the last instant.
    kept : (c,) array of int64
        State of every contact; brought up to date.

    Returns
    -------
    As `run_compiled`; `GOES_ON` where that can, with what is asked next in `place`, and
    in the place of the margin `fired`, if the mode goes on, else 0.
    """
    contacts, n, high, mode = kept.shape[0], state.shape[0] // 2, now[T_HIGH], place[N_MODE]
    code, constants, outputs, _, _ = tape_of(program, scene.numbers)
    numbers, taken = np.empty(outputs.shape[0]), np.empty(contacts, np.int64)
    impulse, lowest, before = np.zeros((contacts, 2)), np.empty(contacts), state.copy()
    tape_values(code, constants, outputs, state, watch.parameters, high, numbers)
    energy_at = n * n + n
    energy, struck, path, group = numbers[energy_at], -1, 0, 0
    first = energy_at + 1 + (2 * n + 2) * contacts
    found = boundary = False
    if scene.nodes.shape[0] > 0:
        code, constants, outputs, _, _ = tape_of(program, scene.conditions)
        values = conditions_at(
            code, constants, outputs, scene.sizes, scene.relative, state, watch.parameters, high
        )
        for k in range((scene.slots.shape[0] - contacts) // 2):
            band = round_off(values[PER_CONDITION * k + 2], scene.relative)
            boundary = boundary or abs(values[PER_CONDITION * k]) <= band
        switching = switched(scene, values, numbers, first, fired, kept, taken)
        if switching == -2:
            return FELL, margin, 0.0
        found = switching >= 0
    if boundary:
        for c in range(contacts):
            at = first + SCALARS * c
            if abs(numbers[at]) <= scene.gap and numbers[at + 1] < -scene.speed:
                # An impact on a boundary may bring contacts back that are closed.
                return FELL, margin, 0.0
    switches = found
    if not found:
        for c in range(contacts):
            lasting = kept[c] != FREE and kept[c] != OFF_CODE
            lowest[c] = -scene.near if lasting else 0.0
        found = classified(scene, numbers, n, True, kept, lowest, taken)
    if not found:
        if margin >= 0 and program.ints[program.modes[mode, MARGINS_AT] + 2 * margin] == SPEED:
            # Slip that has ended as far as time tells is the laws' to see.
            return FELL, margin, 0.0
        struck, path, group = hit(
            program, scene, watch.parameters, state, high, kept, numbers, impulse, taken
        )
    target = row_of(program, taken) if found or struck >= 0 else -1
    if target == mode and struck < 0 and margin < 0:
        place[N_ASKED] = 0
        return GOES_ON, 0, 0.0
    if target == mode and struck < 0 and flowed and fired != 0:
        # The gates hold or fail as before: other conditions decide that from here on.
        hold_conditions(program, watch, scene, state, high, fired)
        count = (scene.slots.shape[0] - contacts) // 2
        slot = scene.slots[fired - 1 if fired > 0 else count - fired - 1]
        if watch.bands[slot] == math.inf:
            place[N_ASKED] = 0
            return GOES_ON, fired, 0.0
    if target < 0 or (target == mode and struck < 0):
        put(before, state)
        return FELL, margin, 0.0
    event = block.used[EVENTS]
    block.events[event, 0], block.events[event, 1] = mode, target
    block.events[event, 2], block.events[event, 3] = margin, path
    block.events[event, 4], block.events[event, 5] = struck, group
    block.numbers[event, 0] = high
    block.numbers[event, 1], block.numbers[event, 2] = energy, numbers[energy_at]
    block.numbers[event, 3:] = 0.0
    if struck >= 0:
        block.numbers[event, 4], block.numbers[event, 5] = impulse[struck]
    put(before, block.states[event, 0])
    put(state, block.states[event, 1])
    block.used[EVENTS] += 1
    place[N_MODE] = target
    place[N_JUMPS] += 1
    # What an impact leaves may go another way from the boundary of a condition.
    place[N_ASKED] = 1 if switches else 2 if struck >= 0 and boundary else 0
    now[T_SINCE] = high
    row = _PER_CAUSE * struck + TOUCHDOWN
    if struck < 0:
        changed = 0
        while kept[changed] == taken[changed]:
            changed += 1
        row = _PER_CAUSE * changed + _cause(kept[changed], taken[changed])
    for c in range(contacts):
        gap, lay = numbers[first + SCALARS * c], kept[c] != FREE and kept[c] != OFF_CODE
        if taken[c] != FREE:
            watch.parameters[scene.offsets[c]] = 0.0
        elif lay or c == struck or (struck >= 0 and (group >> c) & 1 == 1):
            # Its flight is measured from where round-off has left it.
            watch.parameters[scene.offsets[c]] = gap if abs(gap) <= scene.gap else 0.0
        kept[c] = taken[c]
    rest = follow(series[row], high, now[T_LOW], margin >= 0, scene.short)
    if rest >= 0.0 and _in_turn(block, row, place[N_JUMPS]):
        return ACCUMULATES, row, rest
    count = place[N_JUMPS]
    steady = count >= STEADY and count & (count - 1) == 0
    if count >= place[N_MOST] or steady:
        return COUNTED, -1, 0.0
    return GOES_ON, 0, 0.0


@kernel
def run_compiled(
    program: Program,
    pace: Pace,
    watch: Watch,
    memory: Scratch,
    scene: SceneWatch,
    block: TraceBuffer,
    now: Array,
    place: Ints,
    state: Array,
    series: Array,
    entered: Bools,
) -> tuple[int, int, float]:
    """Flow and jump until something is to be done that is not usual.

    Parameters
    ----------
    program, pace, watch, memory
        See `statechart.engines.mode_table`.
    scene : SceneWatch
        For the classification of instants.
    block : TraceBuffer
        Takes arcs and jumps.
    now : (5,), place : (6,) array
        Where the run is, see `statechart.execution.compiled_loop`; brought up to date.
    state : (n,) array
        Likewise.
    series : (7 c, ..) array
        Of jumps, for every contact and cause (see `statechart.kernels.accumulation`).
    entered : (m,) array of bool
        Modes that the run has been in; brought up to date.

    Returns
    -------
    reason : int
        Why it ends.
    margin : int
        That fell, or the series that accumulates.
    rest : float
        Time to the accumulation.
    """
    contacts = scene.allowed.shape[0]
    kept = np.empty(contacts, np.int64)
    most = memory.coefficients.shape[0]
    most_terms = memory.coefficients.size
    begun_steps, begun_boxes = place[N_STEPS], place[N_BOXES]
    decided = 0  # by what fell as a mode went on without a jump
    while True:
        used = block.used
        if (
            used[ARCS] == block.arcs.shape[0]
            or used[EVENTS] + MOST_AT_ONCE + 1 > block.events.shape[0]
            or used[TIMES] + most + 1 > block.times.shape[0]
            or used[TERMS] + most_terms > block.coefficients.shape[0]
        ):
            return FULL, -1, 0.0
        if place[N_STEPS] - begun_steps > _STEPS or place[N_BOXES] - begun_boxes > _BOXES:
            return PAUSED, -1, 0.0
        mode = place[N_MODE]
        high, low = now[T_HIGH], now[T_LOW]
        begun = high
        duration = (now[T_END] - high) - low
        if duration <= 0.0:
            return OVER, -1, 0.0
        entered[mode] = True
        at = program.modes[mode, LAWS_AT]
        for c in range(contacts):
            kept[c] = program.ints[at + c]
        _hold(program, watch, scene, kept, state, high)
        if scene.nodes.shape[0] > 0:
            hold_conditions(program, watch, scene, state, high, decided)
        decided = 0
        verdict, margin, steps, boxes = flow_to_event(
            program, mode, pace, watch, memory, state, high, duration, now[T_HORIZON]
        )
        if verdict == UNUSUAL:
            return FLOW, -1, 0.0
        place[N_STEPS] += steps
        place[N_BOXES] += boxes
        if steps > 0:
            record_arc(block, memory, mode, place[N_JUMPS], steps, high, low)
            elapsed = memory.times[steps]
            total = high + elapsed
            error = total - high
            error = (high - (total - error)) + (elapsed - error) + low
            now[T_HIGH] = total + error
            now[T_LOW] = error - (now[T_HIGH] - total)
            if elapsed > 0.0:
                now[T_HORIZON] = LOOK_AHEAD * max(elapsed, now[T_HIGH] - now[T_SINCE])
        if verdict == ENDED:
            return OVER, -1, 0.0
        high = now[T_HIGH]
        if margin >= program.modes[mode, STOPS]:
            return FELL, margin, 0.0
        asked, fired = 0, program.ints[at + contacts + margin]
        while True:
            reason, row, rest = _instant(
                program, watch, scene, block, now, place, state, series, margin, fired,
                high > begun, kept,
            )  # fmt: skip
            if reason != GOES_ON:
                return reason, row, rest
            if place[N_ASKED] == 0:
                decided = row
                break
            asked += 1
            margin = -1
            fired = fired if place[N_ASKED] == 1 else 0
            if asked > MOST_AT_ONCE:
                return FELL, -1, 0.0
        at_stop = stands(program, place[N_MODE], watch.parameters, watch.floors, state, now[T_HIGH])
        if at_stop:
            place[N_ASKED] = 1
            return FELL, -1, 0.0
