"""Compiled jumps of a scene: conditions, modes, impacts of one or several contacts.

Only unambiguous instants are compiled; Python (`laws`, `switching`, `impact_jump`) takes the
others.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.dynamics.gates import (
    FAILS,
    PER_CONDITION,
    UNSURE,
    conditions_at,
    judge_atoms,
    margin_bands,
    round_off,
    write_node_verdicts,
)
from contacts.dynamics.snapshot import SCALARS
from contacts.impacts.impact import ENDED, solve_impact
from contacts.impacts.impulses import strike_group
from contacts.modes.compiled_classification import (
    InstantConstants,
    classify,
    violates_constraints,
    write_edges,
)
from contacts.states import FREE, OFF_CODE
from statechart.arrays import Array, Ints
from statechart.automaton.trace_store import EVENTS, JUMP_OBJECT, TraceBuffer
from statechart.engines.compiled_flow import (
    ADDRESS,
    LAWS_AT,
    MARGINS_AT,
    SPEED,
    FlowInputs,
    ModeTable,
    evaluate,
    tape_of,
)
from statechart.execution import compiled_loop as runs
from statechart.execution.livelock import STEADY
from statechart.kernels.accumulation import add_jump
from statechart.kernels.copies import copy_numbers
from statechart.kernels.jit import kernel

# Contacts within this many tolerances of gaps may meet in a corner.
_CORNER_GAPS = 16.0
GOES_ON = -1


class RunState(NamedTuple):
    """State of a run in the loop, which brings it up to date."""

    clock: Array  # (6,): see `statechart.execution.compiled_loop.T_HIGH`.
    place: Ints  # (6,): see `statechart.execution.compiled_loop.N_MODE`.
    state: Array  # shape (n,)
    series: Array  # (c, ..): of touchdowns (see `statechart.kernels.accumulation`).
    states: Ints  # (c,): state of every contact.


@kernel
def _closed(
    scene: InstantConstants, states: Ints, numbers: Array, scalars: int, group: Ints
) -> tuple[int, int]:
    """List the closed contacts; return their number and the first that strikes, else -1.

    Also -1 if the state has to be projected onto the constraints first.
    """
    count, striking = 0, -1
    for c in range(states.shape[0]):
        if states[c] == OFF_CODE:
            continue
        place = scalars + SCALARS * c
        gap, rate = numbers[place], numbers[place + 1]
        if violates_constraints(scene, numbers, place, states[c]):
            return count, -1
        if not gap >= -scene.gap or not scene.allowed[c, FREE]:
            return count, -1
        if gap <= scene.gap:
            group[count] = c
            count += 1
            if striking < 0 and rate < -scene.speed:
                striking = c
    return count, striking


@kernel
def _single_impact(
    scene: InstantConstants, mass: Array, numbers: Array, jacobians_at: int, scalars_at: int,
    c: int, velocity: Array, impulse: Array,
) -> int:  # fmt: skip
    """Compute the impact of one contact; return the code of its path, 0 if it has none."""
    if scene.meanings[c] < 0:
        return 0
    n, before = velocity.shape[0], velocity.copy()
    jacobian = numbers[jacobians_at + 2 * n * c : jacobians_at + 2 * n * (c + 1)].reshape((2, n))
    approach, slip = numbers[scalars_at + 1], numbers[scalars_at + 2]
    edges = np.empty((scene.cones.shape[0], 6))
    write_edges(scene.cones, numbers, scalars_at - SCALARS * c, edges)
    status, normal, tangential, path, _, _ = solve_impact(
        mass,
        jacobian,
        (approach, slip),
        edges[c],
        scene.meanings[c],
        scene.restitution[c],
        False,
        velocity,
    )
    if status != ENDED:
        return 0
    for i in range(n):
        # As impacts of several contacts at one instant are added up.
        velocity[i] = before[i] + (velocity[i] - before[i])
    impulse[c, 0], impulse[c, 1] = normal, tangential
    return path


@kernel
def solve_impact_instant(
    program: ModeTable, watch: FlowInputs, scene: InstantConstants, run: RunState, numbers: Array,
    impulse: Array, target: Ints,
) -> tuple[int, int, int]:  # fmt: skip
    """Compute an impact of the closed contacts that approach.

    Updates the state of the run and the numbers (o,) of the snapshot; fills the `impulse` (c, 2)
    and the state `target` (c,) of every contact. Returns the first contact that strikes; the code
    of its path, or of the states of several (`strike_group`); and a bit mask of these, 0 for a
    single one. In an ambiguous case the first number is -1 and only `numbers` are changed.
    """
    state, source = run.state, run.states
    n, contacts = state.shape[0] // 2, source.shape[0]
    jacobians_at = n * n + n + 1
    scalars = jacobians_at + (2 * n + 2) * contacts
    group = np.empty(contacts, np.int64)
    count, c = _closed(scene, source, numbers, scalars, group)
    # The bits of a group are those of an int32.
    if c < 0 or contacts > 31:
        return -1, 0, 0
    scalars_at = scalars + SCALARS * c
    after, mass = state.copy(), numbers[: n * n].reshape((n, n))
    impulse[:] = 0.0
    bits = 0
    if count == 1:
        path = _single_impact(scene, mass, numbers, jacobians_at, scalars_at, c, after[n:], impulse)
    else:
        path = strike_group(scene, numbers, group[:count], after[n:], impulse)
        for k in range(count):
            bits |= 1 << group[k]
    if path == 0:
        return -1, 0, 0
    energy = numbers[jacobians_at - 1]
    evaluate(program, scene.numbers, after, watch.parameters, run.clock[runs.T_HIGH], numbers)
    resting, slow_rebound = False, False
    for k in range(count):
        rate, e = numbers[scalars + SCALARS * group[k] + 1], scene.restitution[group[k]]
        if rate < -scene.speed:
            return -1, 0, 0
        slow_rebound = slow_rebound or (0.0 < e < 1.0 and scene.speed < rate <= 2.0 * scene.capture)
        resting = resting or rate <= scene.speed
    if slow_rebound:
        return -1, 0, 0
    if count > 1 and numbers[jacobians_at - 1] >= energy:
        return -1, 0, 0
    for i in range(contacts):
        target[i] = OFF_CODE if source[i] == OFF_CODE else FREE
    if resting:
        flying = target.copy()
        if not classify(scene, numbers, n, False, flying, -scene.gap, target):
            return -1, 0, 0
    copy_numbers(after, state)
    return c, path, bits


@kernel
def conditions(
    program: ModeTable, watch: FlowInputs, scene: InstantConstants, state: Array, time: float
) -> Array:
    """Return the numbers (4 k,) of the conditions in a state."""
    code, constants, outputs, _, _ = tape_of(program, scene.conditions)
    return conditions_at(
        code, constants, outputs, scene.sizes, scene.relative, state, watch.parameters, time
    )


@kernel
def hold_conditions(
    program: ModeTable,
    watch: FlowInputs,
    scene: InstantConstants,
    state: Array,
    time: float,
    fired: int,
) -> None:
    """Write the tolerances of the conditions' margins for a flow from a state.

    `fired` is the condition that was just decided on its boundary (see `switch_contacts`), or 0.
    See `contacts.dynamics.conditions.ConditionsAt.tolerances`.
    """
    count = (scene.slots.shape[0] - scene.allowed.shape[0]) // 2
    verdicts, bands = np.empty(count, np.int64), np.empty(scene.slots.shape[0])
    values = conditions(program, watch, scene, state, time)
    judge_atoms(values, scene.relative, fired, verdicts)
    margin_bands(scene.nodes, values, scene.relative, scene.gap, verdicts, bands)
    for i in range(bands.shape[0]):
        if scene.slots[i] >= 0:
            watch.bands[scene.slots[i]] = bands[i]


@kernel
def switch_contacts(
    scene: InstantConstants, values: Array, numbers: Array, scalars: int, fired: int, source: Ints,
    target: Ints,
) -> int:  # fmt: skip
    """Disable and enable contacts by their conditions; return the first that changes, else -1.

    Returns -2 if higher derivatives of a condition decide. `values` (4 k,) are the numbers of the
    conditions, `numbers` (o,) the snapshot, with contacts from `scalars` on. `fired` is the number
    (from 1 on) of the atom that ceased to hold, negative if it began to hold; it decides if the
    first derivative does not. Fills the states `target` (c,) from `source` (c,). See
    `contacts.dynamics.conditions.ConditionsAt.failing`.
    """
    changed, unsure, leaves, stays, neighbour_off = -1, False, False, False, False
    count = (scene.slots.shape[0] - scene.allowed.shape[0]) // 2
    verdicts, node_verdicts = np.empty(count, np.int64), np.empty(scene.nodes.shape[0], np.int64)
    judge_atoms(values, scene.relative, fired, verdicts)
    write_node_verdicts(scene.nodes, verdicts, node_verdicts)
    for c in range(source.shape[0]):
        target[c] = source[c]
    for i in range(scene.nodes.shape[0]):
        if scene.nodes[i, 1] >= 0:
            continue
        c = scene.nodes[i, 2]
        gap = numbers[scalars + SCALARS * c]
        if node_verdicts[i] == FAILS:
            target[c] = OFF_CODE
        elif source[c] == OFF_CODE and gap >= -scene.gap:
            target[c] = FREE
        # Python reports a gap without a value.
        undefined = source[c] == OFF_CODE and gap != gap
        unsure = unsure or (node_verdicts[i] != FAILS and (node_verdicts[i] == UNSURE or undefined))
        if changed < 0 and target[c] != source[c]:
            changed = c
        if abs(gap) <= _CORNER_GAPS * scene.gap:
            is_off, was_off = target[c] == OFF_CODE, source[c] == OFF_CODE
            stays = stays or not is_off
            leaves = leaves or (is_off and not was_off)
            neighbour_off = neighbour_off or (is_off and was_off)
    # Python handles a corner where no other contact takes over.
    unsure = unsure or (leaves and neighbour_off and not stays)
    return -2 if unsure else changed


@kernel
def mode_row(program: ModeTable, states: Ints) -> int:
    """Return the mode of these states of the contacts; -1 if it is not compiled."""
    modes = program.modes
    for row in range(modes.shape[0]):
        at = modes[row, LAWS_AT]
        if modes[row, ADDRESS] == 0 or at < 0:
            continue
        equal = True
        for c in range(states.shape[0]):
            equal = equal and program.ints[at + c] == states[c]
        if equal:
            return row
    return -1


@kernel
def _struck_in_sequence(block: TraceBuffer, contact: int, jumps: int) -> bool:
    """Return whether other contacts may have been struck since the last impact of a contact."""
    newest = block.used[EVENTS] - 1
    for event in range(newest, max(newest - jumps, -1), -1):
        struck, group = block.events[event, 4], block.events[event, 5]
        if (
            block.events[event, 0] == JUMP_OBJECT
            or group != 0
            or (struck >= 0 and struck != contact)
        ):
            return True
        if event < newest and struck == contact:
            return False
    return True


@kernel
def jump_instant(
    program: ModeTable, watch: FlowInputs, scene: InstantConstants, block: TraceBuffer,
    run: RunState, margin: int, fired: int, flowed: bool,
) -> tuple[int, int, float]:  # fmt: skip
    """Compute the jump of an unambiguous instant, and update the run.

    `margin` fell (-1 if the instant continues after a jump), and the condition `fired` (see
    `switch_contacts`; 0 for none, and after an impact); `flowed` is true if time has passed since
    the last instant. Returns the reason to leave the loop and its margin, or `GOES_ON` and the
    condition `fired` if the mode continues without a jump, else 0.
    """
    clock, place, state, source = run.clock, run.place, run.state, run.states
    contacts, n = source.shape[0], state.shape[0] // 2
    high, mode = clock[runs.T_HIGH], place[runs.N_MODE]
    numbers, target = np.empty(scene.numbers[5]), np.empty(contacts, np.int64)
    impulse, before = np.zeros((contacts, 2)), state.copy()
    evaluate(program, scene.numbers, state, watch.parameters, high, numbers)
    energy_at = n * n + n
    energy, struck, path, group = numbers[energy_at], -1, 0, 0
    scalars = energy_at + 1 + (2 * n + 2) * contacts
    unambiguous = boundary = False
    if scene.nodes.shape[0] > 0:
        values = conditions(program, watch, scene, state, high)
        for k in range((scene.slots.shape[0] - contacts) // 2):
            band = round_off(values[PER_CONDITION * k + 2], scene.relative)
            boundary = boundary or abs(values[PER_CONDITION * k]) <= band
        switching = switch_contacts(scene, values, numbers, scalars, fired, source, target)
        if switching == -2:
            return runs.FELL, margin, 0.0
        unambiguous = switching >= 0
    if boundary:
        for c in range(contacts):
            at = scalars + SCALARS * c
            if abs(numbers[at]) <= scene.gap and numbers[at + 1] < -scene.speed:
                # An impact on a boundary may enable closed contacts.
                return runs.FELL, margin, 0.0
    switches = unambiguous
    if not unambiguous:
        unambiguous = classify(scene, numbers, n, True, source, 0.0, target)
    if not unambiguous:
        if margin >= 0 and program.ints[program.modes[mode, MARGINS_AT] + 2 * margin] == SPEED:
            # Python decides whether the slip has ended within the resolution of time.
            return runs.FELL, margin, 0.0
        struck, path, group = solve_impact_instant(
            program, watch, scene, run, numbers, impulse, target
        )
    target_mode = mode_row(program, target) if unambiguous or struck >= 0 else -1
    if target_mode == mode and struck < 0 and margin < 0:
        place[runs.N_RETRY] = 0
        return GOES_ON, 0, 0.0
    if target_mode == mode and struck < 0 and flowed and fired != 0:
        # The verdicts of the gates are unchanged, but other conditions certify them from now on.
        hold_conditions(program, watch, scene, state, high, fired)
        count = (scene.slots.shape[0] - contacts) // 2
        slot = scene.slots[fired - 1 if fired > 0 else count - fired - 1]
        if watch.bands[slot] == math.inf:
            place[runs.N_RETRY] = 0
            return GOES_ON, fired, 0.0
    if target_mode < 0 or (target_mode == mode and struck < 0):
        copy_numbers(before, state)
        return runs.FELL, margin, 0.0
    event = block.used[EVENTS]
    block.events[event, 0], block.events[event, 1] = mode, target_mode
    block.events[event, 2], block.events[event, 3] = margin, path
    block.events[event, 4], block.events[event, 5] = struck, group
    block.numbers[event, 0] = high
    block.numbers[event, 1], block.numbers[event, 2] = energy, numbers[energy_at]
    block.numbers[event, 3:] = 0.0
    if struck >= 0:
        block.numbers[event, 4], block.numbers[event, 5] = impulse[struck]
    copy_numbers(before, block.states[event, 0])
    copy_numbers(state, block.states[event, 1])
    block.used[EVENTS] += 1
    place[runs.N_MODE] = target_mode
    place[runs.N_JUMPS] += 1
    # After an impact the state may leave the boundary of a condition in another direction.
    place[runs.N_RETRY] = 1 if switches else 2 if struck >= 0 and boundary else 0
    clock[runs.T_SINCE] = high
    # The jump is about the contact that is struck, or the first that changes.
    landing, first_change = struck, struck < 0
    for c in range(contacts):
        if first_change and source[c] != target[c]:
            first_change = False
            landing = c if source[c] == FREE and target[c] != OFF_CODE else -1
        gap = numbers[scalars + SCALARS * c]
        was_closed = source[c] != FREE and source[c] != OFF_CODE
        if target[c] != FREE:
            watch.parameters[scene.offsets[c]] = 0.0
        elif was_closed or c == struck or (struck >= 0 and (group >> c) & 1 == 1):
            # The gap of a flight starts at its round-off, and where others, projected onto their
            # surfaces, moved it.
            near = -contacts * scene.gap <= gap <= scene.gap
            watch.parameters[scene.offsets[c]] = gap if near else 0.0
        source[c] = target[c]
    if landing >= 0:
        series = run.series[landing]
        remaining = add_jump(series, high, clock[runs.T_LOW], margin >= 0, scene.short)
        if remaining >= 0.0 and _struck_in_sequence(block, landing, place[runs.N_JUMPS]):
            return runs.ACCUMULATES, landing, remaining
    count = place[runs.N_JUMPS]
    steady = count >= STEADY and count & (count - 1) == 0
    if count >= place[runs.N_MOST] or steady:
        return runs.COUNTED, -1, 0.0
    return GOES_ON, 0, 0.0
