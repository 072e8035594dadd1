"""Unambiguous instants of a scene, compiled: conditions, modes, impacts of one or several contacts.

All others are left to the laws (`laws`, `switching`, `impact_jump`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.gates import (
    FAILS,
    PER_CONDITION,
    UNSURE,
    conditions_at,
    judge_atoms,
    margin_bands,
    round_off,
    truths,
)
from contacts.dynamics.snapshot import SCALARS
from contacts.impacts.impact import ENDED, MEANINGS, RAISES, strike
from contacts.impacts.impulses import strike_group
from contacts.modes.classification import ModeRules, classify, write_edges
from contacts.scene.parts import MOREAU
from contacts.states import FREE, OFF_CODE, PIN
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.trace_store import EVENTS, JUMP_OBJECT, TraceBuffer
from statechart.engines.compiled_flow import (
    ADDRESS,
    LAWS_AT,
    MARGINS_AT,
    SPEED,
    Program,
    Watch,
    evaluate,
    tape_of,
)
from statechart.execution import compiled_loop as runs
from statechart.execution.livelock import STEADY
from statechart.kernels.accumulation import add_jump
from statechart.kernels.copies import put
from statechart.kernels.jit import kernel

# Contacts within this many tolerances of gaps may meet in a corner.
_CORNER_GAPS = 16.0
TOUCHDOWN, LIFTOFF, STICK, SLIP, REVERSE, ENABLE, DISABLE = range(7)
"""Causes of changes of a contact's state, see `contacts.states.cause_of`."""
CAUSES = ("touchdown", "liftoff", "stick", "slip", "reverse", "enable", "disable")
"""In that order."""
_PER_CAUSE = len(CAUSES)
GOES_ON = -1


class SceneWatch(NamedTuple):
    """Constants of a run for compiled instants (see `contacts.modes.classification.classify`)."""

    # (9,): tapes of the scene's numbers, and of the margins of contacts' conditions.
    numbers: NDArray[np.int64]
    conditions: NDArray[np.int64]
    nodes: Ints  # (m, 3): trees of the contacts' conditions; see `contacts.dynamics.gates.tree`.
    # (2 k + c,): places in `Watch.bands` of the margins that fall as conditions cease to hold, of
    # those that do as they begin to, and as gaps of contacts that are off open; -1 for none.
    slots: Ints
    sizes: Array  # (n + 1,): of the state, and of time.
    relative: float  # Margins that are so small in parts of their terms are zero.
    allowed: Bools  # shape (c, 5)
    cones: Array  # (c, 2): unit edges of friction cones at rest.
    restitution: Array  # shape (c,)
    meanings: Ints  # (c,): what it means; -1 where the impact is none of a path.
    offsets: Ints  # (c,): places of the gaps' offsets among the parameters.
    near: float
    creep: float
    gap: float
    speed: float
    tie: float
    force_uncertainty: float
    force: float
    acceleration: float
    short: float
    capture: float  # Rebounds slower than this may stand for those that follow.


class RunState(NamedTuple):
    """State of a run in the loop, which brings it up to date."""

    now: Array  # (6,): see `statechart.execution.compiled_loop.T_HIGH`.
    place: Ints  # (6,): see `statechart.execution.compiled_loop.N_MODE`.
    state: Array  # shape (n,)
    series: Array  # (7 c, ..): of jumps (see `statechart.kernels.accumulation`).
    states: Ints  # (c,): state of every contact.


@kernel
def rules_of(scene: SceneWatch) -> ModeRules:
    """Return what of a scene decides the modes of its contacts."""
    return ModeRules(
        scene.allowed, scene.cones, scene.near, scene.creep, scene.gap, scene.speed, scene.tie,
        scene.force_uncertainty, scene.force, scene.acceleration,
    )  # fmt: skip


@kernel
def _closed(
    scene: SceneWatch, kept: Ints, numbers: Array, first: int, group: Ints
) -> tuple[int, int]:
    """List the closed contacts; return how many, and which of them strikes first, else -1.

    None strikes where a contact that the flow kept closed has to be brought back.
    """
    count, striking = 0, -1
    for c in range(kept.shape[0]):
        if kept[c] == OFF_CODE:
            continue
        place = first + SCALARS * c
        gap, rate, slip = numbers[place], numbers[place + 1], numbers[place + 2]
        off = abs(gap) > scene.near or abs(rate) > scene.creep
        if kept[c] != FREE and (off or (kept[c] == PIN and abs(slip) > scene.creep)):
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
    scene: SceneWatch, mass: Array, numbers: Array, at: int, place: int, c: int,
    velocity: Array, impulse: Array,
) -> int:  # fmt: skip
    """Let one contact be hit by its own law; return the code of its path, 0 where it has none."""
    if scene.meanings[c] < 0:
        return 0
    n, before = velocity.shape[0], velocity.copy()
    jacobian = numbers[at + 2 * n * c : at + 2 * n * (c + 1)].reshape((2, n))
    approach, slip = numbers[place + 1], numbers[place + 2]
    edges = np.empty((scene.cones.shape[0], 6))
    write_edges(scene.cones, numbers, place - SCALARS * c, edges)
    status, normal, tangential, path, _, _ = strike(
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
    rise = glide = 0.0
    for i in range(n):
        change = velocity[i] - before[i]
        # As impacts of several contacts at one instant are added up.
        velocity[i] = before[i] + change
        rise += jacobian[0, i] * change
        glide += jacobian[1, i] * change
    work = normal * (approach + 0.5 * rise) + tangential * (slip + 0.5 * glide)
    if work > RAISES * (normal * abs(approach) + abs(tangential * slip)):
        return 0
    impulse[c, 0], impulse[c, 1] = normal, tangential
    return path


@kernel
def hit(
    program: Program,
    watch: Watch,
    scene: SceneWatch,
    run: RunState,
    numbers: Array,
    impulse: Array,
    taken: Ints,
) -> tuple[int, int, int]:
    """Compute an impact of the closed contacts that approach.

    Brings the state of the run and the numbers (o,) of the scene there up to date; fills `impulse`
    (c, 2) on the bodies at every contact, and its state `taken` (c,) after it. Returns the first
    contact that strikes (-1, and nothing changed but the numbers, where this is not so simple); the
    code of its path, or of the states of several (`strike_group`); and these several, a bit each, 0
    where it is alone.
    """
    state, kept = run.state, run.states
    n, contacts = state.shape[0] // 2, kept.shape[0]
    at = n * n + n + 1
    scalars = at + (2 * n + 2) * contacts
    group = np.empty(contacts, np.int64)
    count, c = _closed(scene, kept, numbers, scalars, group)
    # The bits of a group are those of an int32.
    if c < 0 or contacts > 31:
        return -1, 0, 0
    place = scalars + SCALARS * c
    after, mass = state.copy(), numbers[: n * n].reshape((n, n))
    impulse[:] = 0.0
    bits = 0
    if count == 1:
        path = _single_impact(scene, mass, numbers, at, place, c, after[n:], impulse)
    else:
        path = strike_group(
            rules_of(scene), numbers, scene.restitution, group[:count], after[n:], impulse
        )
        for k in range(count):
            bits |= 1 << group[k]
    if path == 0:
        return -1, 0, 0
    energy = numbers[at - 1]
    evaluate(program, scene.numbers, after, watch.parameters, run.now[runs.T_HIGH], numbers)
    lowest, resting, slowly = np.full(contacts, -scene.gap), False, False
    for k in range(count):
        rate, e = numbers[scalars + SCALARS * group[k] + 1], scene.restitution[group[k]]
        if rate < -scene.speed:
            return -1, 0, 0
        slowly = slowly or (0.0 < e < 1.0 and scene.speed < rate <= 2.0 * scene.capture)
        resting = resting or rate <= scene.speed
    if slowly:
        return -1, 0, 0
    if count > 1 and numbers[at - 1] >= energy:
        return -1, 0, 0
    for i in range(contacts):
        taken[i] = OFF_CODE if kept[i] == OFF_CODE else FREE
    if resting:
        flying = taken.copy()
        if not classify(rules_of(scene), numbers, n, False, flying, lowest, taken):
            return -1, 0, 0
    put(after, state)
    return c, path, bits


def meaning(law: ContactLaw) -> int:
    """Return what restitution means where an impact goes along a path."""
    return -1 if law.impact == MOREAU else MEANINGS[law.impact]


@kernel
def conditions(
    program: Program, watch: Watch, scene: SceneWatch, state: Array, time: float
) -> Array:
    """Return the numbers (4 k,) of the conditions in a state."""
    code, constants, outputs, _, _ = tape_of(program, scene.conditions)
    return conditions_at(
        code, constants, outputs, scene.sizes, scene.relative, state, watch.parameters, time
    )


@kernel
def hold_conditions(
    program: Program, watch: Watch, scene: SceneWatch, state: Array, time: float, fired: int
) -> None:
    """Write how far below zero a flow from a state lets the margins of conditions go.

    `fired`: as for `switched`, of what has just decided a condition on its boundary; 0 for none.

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
def switched(
    scene: SceneWatch, values: Array, numbers: Array, first: int, fired: int, kept: Ints,
    taken: Ints,
) -> int:  # fmt: skip
    """Take contacts off or back whose conditions say so; return the first, -1 where there is none.

    -2 where further derivatives of a condition decide. `values` (4 k,) are the numbers of the
    conditions, `numbers` (o,) those of the scene, of contacts from `first` on. `fired` is the
    number of the atom that ceased to hold, from 1 on; minus it, if it began to. That decides where
    the first derivative does not: a flow on whose way a margin falls did not begin on its boundary.
    Each contact was in its state `kept` (c,), and `taken` (c,) is to be filled. See
    `contacts.dynamics.conditions.ConditionsAt.failing`.
    """
    place, unsure, leaves, stays, beside = -1, False, False, False, False
    count = (scene.slots.shape[0] - scene.allowed.shape[0]) // 2
    verdicts, found = np.empty(count, np.int64), np.empty(scene.nodes.shape[0], np.int64)
    judge_atoms(values, scene.relative, fired, verdicts)
    truths(scene.nodes, verdicts, found)
    for c in range(kept.shape[0]):
        taken[c] = kept[c]
    for i in range(scene.nodes.shape[0]):
        if scene.nodes[i, 1] >= 0:
            continue
        c = scene.nodes[i, 2]
        gap = numbers[first + SCALARS * c]
        if found[i] == FAILS:
            taken[c] = OFF_CODE
        elif kept[c] == OFF_CODE and gap >= -scene.gap:
            taken[c] = FREE
        # The laws report a gap without a value.
        nowhere = kept[c] == OFF_CODE and gap != gap
        unsure = unsure or (found[i] != FAILS and (found[i] == UNSURE or nowhere))
        if place < 0 and taken[c] != kept[c]:
            place = c
        close = abs(gap) <= _CORNER_GAPS * scene.gap
        stays = stays or (close and taken[c] != OFF_CODE)
        leaves = leaves or (close and taken[c] == OFF_CODE and kept[c] != OFF_CODE)
        beside = beside or (close and taken[c] == OFF_CODE and kept[c] == OFF_CODE)
    # A corner where nothing takes over is for the laws.
    unsure = unsure or (leaves and beside and not stays)
    return -2 if unsure else place


@kernel
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


@kernel
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


@kernel
def _in_turn(block: TraceBuffer, row: int, jumps: int) -> bool:
    """Return whether other contacts may have been hit since a contact last was."""
    if row % _PER_CAUSE != TOUCHDOWN:
        return False
    contact, last = row // _PER_CAUSE, block.used[EVENTS] - 1
    for event in range(last, max(last - jumps, -1), -1):
        struck, group = block.events[event, 4], block.events[event, 5]
        if (
            block.events[event, 0] == JUMP_OBJECT
            or group != 0
            or (struck >= 0 and struck != contact)
        ):
            return True
        if event < last and struck == contact:
            return False
    return True


@kernel
def instant(
    program: Program,
    watch: Watch,
    scene: SceneWatch,
    block: TraceBuffer,
    run: RunState,
    margin: int,
    fired: int,
    flowed: bool,
) -> tuple[int, int, float]:
    """Jump, where that is as simple as most jumps are.

    Brings the run up to date. `margin` fell (-1 where the instant goes on after a jump), and the
    condition `fired` (see `switched`; 0 for none, and after an impact); `flowed`: time has passed
    since the last instant. Returns what the loop does; `GOES_ON` where that can, with what is asked
    next in `place`, and in the place of the margin `fired`, if the mode goes on, else 0.
    """
    now, place, state, kept = run.now, run.place, run.state, run.states
    contacts, n = kept.shape[0], state.shape[0] // 2
    high, mode = now[runs.T_HIGH], place[runs.N_MODE]
    numbers, taken = np.empty(scene.numbers[5]), np.empty(contacts, np.int64)
    impulse, lowest, before = np.zeros((contacts, 2)), np.empty(contacts), state.copy()
    evaluate(program, scene.numbers, state, watch.parameters, high, numbers)
    energy_at = n * n + n
    energy, struck, path, group = numbers[energy_at], -1, 0, 0
    first = energy_at + 1 + (2 * n + 2) * contacts
    found = boundary = False
    if scene.nodes.shape[0] > 0:
        values = conditions(program, watch, scene, state, high)
        for k in range((scene.slots.shape[0] - contacts) // 2):
            band = round_off(values[PER_CONDITION * k + 2], scene.relative)
            boundary = boundary or abs(values[PER_CONDITION * k]) <= band
        switching = switched(scene, values, numbers, first, fired, kept, taken)
        if switching == -2:
            return runs.FELL, margin, 0.0
        found = switching >= 0
    if boundary:
        for c in range(contacts):
            at = first + SCALARS * c
            if abs(numbers[at]) <= scene.gap and numbers[at + 1] < -scene.speed:
                # An impact on a boundary may bring contacts back that are closed.
                return runs.FELL, margin, 0.0
    switches = found
    if not found:
        for c in range(contacts):
            lasting = kept[c] != FREE and kept[c] != OFF_CODE
            lowest[c] = -scene.near if lasting else 0.0
        found = classify(rules_of(scene), numbers, n, True, kept, lowest, taken)
    if not found:
        if margin >= 0 and program.ints[program.modes[mode, MARGINS_AT] + 2 * margin] == SPEED:
            # Slip that has ended as far as time tells is the laws' to see.
            return runs.FELL, margin, 0.0
        struck, path, group = hit(program, watch, scene, run, numbers, impulse, taken)
    target = row_of(program, taken) if found or struck >= 0 else -1
    if target == mode and struck < 0 and margin < 0:
        place[runs.N_RETRY] = 0
        return GOES_ON, 0, 0.0
    if target == mode and struck < 0 and flowed and fired != 0:
        # The gates hold or fail as before: other conditions decide that from here on.
        hold_conditions(program, watch, scene, state, high, fired)
        count = (scene.slots.shape[0] - contacts) // 2
        slot = scene.slots[fired - 1 if fired > 0 else count - fired - 1]
        if watch.bands[slot] == math.inf:
            place[runs.N_RETRY] = 0
            return GOES_ON, fired, 0.0
    if target < 0 or (target == mode and struck < 0):
        put(before, state)
        return runs.FELL, margin, 0.0
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
    place[runs.N_MODE] = target
    place[runs.N_JUMPS] += 1
    # After an impact the state may leave the boundary of a condition another way.
    place[runs.N_RETRY] = 1 if switches else 2 if struck >= 0 and boundary else 0
    now[runs.T_SINCE] = high
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
    rest = add_jump(run.series[row], high, now[runs.T_LOW], margin >= 0, scene.short)
    if rest >= 0.0 and _in_turn(block, row, place[runs.N_JUMPS]):
        return runs.ACCUMULATES, row, rest
    count = place[runs.N_JUMPS]
    steady = count >= STEADY and count & (count - 1) == 0
    if count >= place[runs.N_MOST] or steady:
        return runs.COUNTED, -1, 0.0
    return GOES_ON, 0, 0.0
