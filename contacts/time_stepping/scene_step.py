"""Compiled time steps of a scene of points, by Moreau's midpoint rule.

Theta method with theta = 1/2 (Moreau 1988; Acary and Brogliato 2008, 10.1): half a step with the
old velocities, all impulses at the midpoint, half a step with the new ones. Lasting contacts stay
closed to second order: see `contacts.time_stepping.stepper`.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.step_impulses import change_friction, coordinate_impulses
from contacts.states import FREE, PIN, SLIDE
from contacts.time_stepping.chunk import (
    AMBIGUOUS,
    BAD_INERTIA,
    CALMED,
    CONTACTS,
    DONE,
    NOT_FINITE,
    ORDERED,
    RESIDUAL,
    TIME_MARGIN,
    Chunk,
)
from contacts.time_stepping.equations import (
    CONTACT,
    EDGES,
    JOINT,
    ContactHistory,
    ContactRoles,
    FactoredEquations,
    StepConstants,
    StepInstant,
    TapeValues,
    factor_equations,
    is_coupling,
    solve_factored,
)
from contacts.time_stepping.settling import settle, unsettle
from contacts.time_stepping.step_contacts import (
    LOADED,
    LOADINGS,
    clear_contacts,
    clear_round_off,
    close_opposed,
    coupling_loads,
    energy_added,
    find_active,
    force_duration,
    free_rows,
    group_island,
    group_members,
    impact_order_matters,
    is_mixed_with_impacts,
    label_groups,
    load_couplings,
    rebounds,
    share_forces,
    share_loads,
    split_forces,
    time_to_touch,
    unit_responses,
    write_modes,
    write_rates,
)
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers, copy_rows, indices
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values

# A point has left a surface that it slid off when its depth exceeds the landing depth by this
# factor, and its distance so many steps at its speed.
_LEFT_BEHIND, _STEPS = 2.0, 4.0


@kernel
def _gap_between(past: Array, gap: float, rate: float, part_of: float, h: float) -> float:
    """Return an upper bound of a contact's gap between two midpoints.

    Linear interpolation plus the error of a parabola with the change of the gap rate.
    """
    result: float = past[1] + part_of * (gap - past[1]) + 0.125 * h * abs(rate - past[2])
    return result


@kernel
def _deepest(memory: ContactHistory, tape: TapeValues, i: int) -> float:
    """Return the smallest allowed gap of contact i for a point that comes from other surfaces.

    A continuing surface is reached at the depth in the previous one, times the largest ratio of gap
    derivatives; a surface not left yet at its landing depth.
    """
    lowest, n = min(memory.target_gap[i], 0.0) if memory.left_behind[i] else 0.0, tape.size
    for k in range(len(memory.disabled)):
        deep = memory.target_gap[k]
        if not memory.disabled[k] and memory.last[k, 1] < deep:
            deep = memory.last[k, 1]
        if k == i or not deep < 0.0:
            continue
        factor = 1.0
        for j in range(n):
            one = abs(tape.numbers[tape.first + tape.per * i + j])
            other = abs(tape.numbers[tape.first + tape.per * k + j])
            if one > factor * other > 0.0:
                factor = one / other
        lowest = min(lowest, factor * deep)
    return lowest


@kernel
def _is_at_kink(tape: TapeValues, change: Array, i: int, h: float, lies: float, acute: int) -> bool:
    """Return whether a point is near the kink of a valley, beyond the end of contact i's edge.

    It is within its depth in one of the edges, or within some steps of its motion. In an obtuse
    valley every point on the other edge is beyond the end: `acute` (0 or 1) excludes those.
    """
    n, numbers, row = tape.size, tape.numbers, tape.first + tape.per * i
    changes = np.zeros(2)
    for d in range(2):
        for j in range(n):
            changes[d] += numbers[row + d * n + j] * change[j]
    at = row + 2 * n + 2
    speed = math.hypot(numbers[at + 1], numbers[at + 2]) + math.hypot(changes[0], changes[1])
    reach = _STEPS * (h * speed - lies)
    beyond = max(numbers[at], -numbers[at + 3])
    return numbers[at + 3] < 0.0 < numbers[at + 4 + acute] and beyond <= reach


@kernel
def _note_missed(missed: Array, off: bool, holds: bool, depth: float) -> None:
    """Write how deep a point is in the surface of a disabled contact: see `ContactHistory`."""
    if off and holds:
        missed[0] = missed[0] if missed[0] > 0.0 else depth
        missed[1] = depth
        return
    if off and missed[1] > missed[0]:
        missed[2] = min(missed[2], missed[0])
    missed[0] = missed[1] = 0.0


@kernel
def _end_of_condition(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, i: int
) -> tuple[float, float]:
    """Return when the condition of a contact ends, in parts of a step, and its gap there.

    The gap is infinite unless the point of a free contact passes the surface in this step. Where it
    is negative, the point lands first: between two midpoints it may also pass the end of an edge.
    """
    at, before = tape.first + tape.per * i + 2 * tape.size + 2, memory.last[i]
    gap, condition = tape.numbers[at], tape.numbers[at + 3]
    passes = gap < -scene.gap_tolerance < before[1] and condition < 0.0 < before[0]
    lasts = (
        memory.disabled[i]
        or memory.closed[i]
        or scene.bilateral[i] > 0
        or scene.compliance[i, 0] > 0.0
    )
    if lasts or not passes:
        return 1.0, math.inf
    part = before[0] / (before[0] - condition)
    return part, before[1] + part * (gap - before[1])


@kernel
def _write_surface_tape(
    scene: StepConstants, tape: TapeValues, equations: FactoredEquations, instant: StepInstant,
    i: int, there: Array,
) -> float:  # fmt: skip
    """Write the tape `there`, with contact i moved out to the surface; return its gap if < 0."""
    n, row, middle, own = tape.size, tape.first + tape.per * i, instant.middle.copy(), 0.0
    moves = unit_responses(tape, equations, np.full(1, i))[0]
    for j in range(n):
        own += tape.numbers[row + j] * moves[j]
    deep = min(tape.numbers[row + 2 * n + 2], 0.0)
    for j in range(n):
        middle[j] -= deep / own * moves[j]
    tape_values(*scene.equations, middle, scene.parameters, instant.time, there)
    return deep


@kernel
def switch_contacts(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    k: int, met: ContactRoles, chunk: Chunk, instant: StepInstant,
) -> bool:  # fmt: skip
    """Disable and enable contacts by their conditions, and write gaps; return False if one is NaN.

    Lasting contacts stay enabled for now if their conditions cease to hold: see `keep_leaving`. At
    the kink of a valley both edges hold a point. `equations`: with the change of rates in a step
    without contacts.
    """
    numbers, n, off, h, left = tape.numbers, tape.size, memory.disabled, chunk.h, 1.0
    change, time, there = equations.change, instant.time, np.empty_like(numbers)
    deepest, at_kink = np.empty(len(off)), np.empty((len(off), 2), np.bool_)
    landed, missed = np.zeros(len(off), np.bool_), np.full(len(off), math.inf)
    for i in range(len(off)):
        part, at_end = _end_of_condition(scene, memory, tape, i)
        landed[i] = at_end < -scene.gap_tolerance
        if landed[i]:
            memory.last[i, 1], left = at_end, min(left, part)
        elif at_end <= scene.gap_tolerance:
            missed[i] = time + (part - 1.0) * h
    for i in range(len(off)):
        deepest[i] = _deepest(memory, tape, i) - scene.gap_tolerance
        lies = min(deepest[i], memory.target_gap[i])
        for acute in range(2):
            at_kink[i, acute] = _is_at_kink(tape, change, i, h, lies, acute)
        if scene.compliance[i, 0] > 0.0:
            deepest[i] = -math.inf
    for i in range(len(off)):
        row = tape.first + tape.per * i
        gap, condition, before = numbers[row + 2 * n + 2], numbers[row + 2 * n + 5], memory.last[i]
        if is_coupling(scene, i):
            continue
        if not off[i] and condition < 0.0:
            if landed[i] or at_kink[i, 1 if memory.closed[i] else 0]:
                continue
            memory.missed_depths[i, 3] = min(memory.missed_depths[i, 3], missed[i])
            inside = memory.closed[i] or memory.target_gap[i] < 0.0
            if inside and gap < 0.0 and scene.bilateral[i] == 0:
                # Its depth may be beyond the bound of a condition that holds on the surface.
                _write_surface_tape(scene, tape, equations, instant, i, there)
                if there[row + 2 * n + 5] > 0.0:
                    numbers[row + 2 * n + 5] = there[row + 2 * n + 5]
                    continue
            met.leaving[i] = inside and scene.bilateral[i] == 0
            off[i], memory.left_behind[i] = not met.leaving[i], met.leaving[i]
            if met.leaving[i] and before[0] > 0.0:
                left = min(left, before[0] / (before[0] - condition))
        elif off[i] and memory.left_behind[i]:
            away = abs(gap - memory.target_gap[i]) - _STEPS * h * abs(numbers[row + 2 * n + 3])
            memory.left_behind[i] = away <= (_LEFT_BEHIND - 1.0) * abs(memory.target_gap[i])
        if off[i] and not memory.left_behind[i]:
            memory.target_gap[i] = 0.0
    leaves, lands = met.leaving.any(), landed.any()
    for i in range(len(off)):
        row = tape.first + tape.per * i
        gap, condition, before = numbers[row + 2 * n + 2], numbers[row + 2 * n + 5], memory.last[i]
        rate = numbers[row + 2 * n + 3]
        if is_coupling(scene, i):
            kinetic = numbers[row + 2 * n + EDGES + 1]
            off[i], met.entered[i] = not condition > 0.0, -math.inf
            if math.isnan(condition) or not (off[i] or math.isfinite(gap + kinetic)):
                return False
            chunk.gaps[k, i] = math.inf if off[i] else kinetic if kinetic < 0.0 else gap
            continue
        if off[i]:
            entered = gap
            if before[0] <= 0.0 < condition:
                begins = before[0] / (before[0] - condition)
                entered = max(gap, _gap_between(before, gap, rate, begins, h))
            met.entered[i] = max(entered, _gap_between(before, gap, rate, left, h))
            holds = condition > 0.0 or (at_kink[i, 1] and rate < 0.0)
            entered = met.entered[i] if lands else entered
            off[i] = not (holds and entered >= deepest[i])
            if lands and off[i] and entered >= deepest[i] and gap < 0.0:
                # It lies below the kink, beyond both edges.
                memory.left_behind[i], memory.target_gap[i] = True, gap
            _note_missed(memory.missed_depths[i], off[i], condition > 0.0, -gap)
            if leaves and off[i] and memory.left_behind[i] and condition < 0.0:
                # Below a kink a point is beyond the ends of both surfaces.
                met.leaving[i], off[i] = True, False
        before[0], before[1], before[2] = condition, gap, rate
        if not off[i] and (math.isnan(condition) or not math.isfinite(gap)):
            return False
        chunk.gaps[k, i] = math.inf if off[i] else gap
    return True


# Earliest impact before the middle of a step, relative to the step: some time must precede it.
_EARLIEST = 0.5 - TIME_MARGIN
# Newton iterations of the time of a touch.
_TOUCHES = 4
# Relative curvature of the direction out of a surface.
_BENT = 0.01
# Relative decrease of a condition in a step that is round-off.
_AT_REST = 1e-9


@kernel
def _free_change(
    scene: StepConstants, light: Bools, numbers: Array, h: float, after: float
) -> tuple[bool, FactoredEquations]:
    """Return the change of rates without free contacts, and whether the equations are regular.

    Forces act at the new rates for the time `after`. Coordinates without inertia receive a small
    one, from there on.
    """
    n, held, joints = scene.size, scene.bilateral, scene.joints
    after = after if scene.damped else 0.0
    regular, factors, order, right = factor_equations(numbers, n, h, after, held, joints, light[0])
    if not regular and not light[0]:
        light[0] = True
        regular, factors, order, right = factor_equations(numbers, n, h, after, held, joints, True)
    change = solve_factored(factors, order, right) if regular else right
    return regular, FactoredEquations(factors, order, change, np.empty(len(change)))


# Sweeps over the signs, and the change at which they have converged.
_SWEEPS, _SETTLED = 200, 1e-14


@kernel
def hold_signs(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    state: Array, h: float, first: int,
) -> Array:  # fmt: skip
    """Solve for the signs in forces at the end of a step; add their effect to its change.

    The sign of a function is 1 or -1 above or below zero at the end of the step, and between if it
    is zero (backward Euler: Acary and Brogliato 2008, 1.4). Signs that push away from zero are
    those of mid-step. Lasting contacts act as in the previous step.

    Parameters
    ----------
    first : int
        Start of the sign rows in the numbers of the tape: forces (n,), derivatives of the function
        by rates and positions (2 n,), the function, effects on controlled values.

    Returns
    -------
    signs : (m,) array
    """
    n, m, numbers, change = tape.size, scene.signs, tape.numbers, equations.change
    signs, free, matrix = np.zeros(m), np.zeros(m), np.zeros((m, m))
    responses, per = np.zeros((m, len(change))), 0
    if m > 0:
        per = (len(numbers) - first) // m
    for i in range(m):
        row, right = first + i * per, np.zeros(len(change))
        for j in range(n):
            right[j] = h * numbers[row + j]
        responses[i] = solve_factored(equations.factors, equations.order, right)
    for i in range(m):
        row = first + i * per
        free[i] = numbers[row + 3 * n]
        signs[i] = (free[i] > 0.0) - (free[i] < 0.0)
        for j in range(n):
            slope = numbers[row + n + j] + 0.5 * h * numbers[row + 2 * n + j]
            free[i] += slope * (change[j] + memory.contact_change[j])
            free[i] += 0.5 * h * numbers[row + 2 * n + j] * state[n + j]
            for k in range(m):
                matrix[i, k] += slope * responses[k, j]
    for _ in range(_SWEEPS):
        moved = 0.0
        for i in range(m):
            if not matrix[i, i] < 0.0:
                continue
            value = free[i]
            for k in range(m):
                if k != i:
                    value += matrix[i, k] * signs[k]
            sign = min(max(-value / matrix[i, i], -1.0), 1.0)
            moved = max(moved, abs(sign - signs[i]))
            signs[i] = sign
        if moved <= _SETTLED:
            break
    for i in range(m):
        for j in range(len(change)):
            change[j] += signs[i] * responses[i, j]
    return signs


@kernel
def _add_impulses(columns: Array, impulses: Array, rates: Array) -> None:
    """Add the effect of impulses (m, 2) with columns (2 m, s) to rates (s,)."""
    for a in range(len(impulses)):
        for d in range(2):
            for j in range(len(rates)):
                rates[j] += columns[2 * a + d, j] * impulses[a, d]


@kernel
def _step_group(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    members: Ints, met: ContactRoles, k: int, chunk: Chunk,
) -> bool:  # fmt: skip
    """Solve a coupled group of contacts in step k; return whether forces are mixed with impacts."""
    n, h, rounds, loaded, changes = tape.size, chunk.h, 0, 0.0, True
    island, contacts, columns, pads = group_island(scene, memory, tape, equations, members, met, h)
    struck, error, softened = bool(island.hit.any()), 0.0, False
    while changes:
        error, softened = coordinate_impulses(contacts, island, scene.impulse_tolerance)
        rounds += 1
        # Friction switches under the final limits.
        loads = coupling_loads(scene, members, columns, equations.change, island.chosen, h)
        loaded = load_couplings(scene, tape, members, loads, pads, island.unforced)
        changes = loaded > LOADED and rounds < LOADINGS
        changes = changes or change_friction(contacts, island, scene.round_off, struck)
    if loaded > LOADED:
        error = max(error, loaded)
    clear_round_off(scene, island, contacts, h)
    chunk.stats[k, RESIDUAL] = max(chunk.stats[k, RESIDUAL], error)
    chunk.stats[k, CALMED] = max(chunk.stats[k, CALMED], 1.0 if softened else 0.0)
    steady, modes = split_forces(scene, memory, island, contacts, k, chunk)
    made = energy_added(scene, tape, island, contacts, chunk.states[k, n : 2 * n])
    chunk.energy_gain[k] = max(chunk.energy_gain[k], made)
    _add_impulses(columns, island.chosen, equations.change)
    _add_impulses(columns, steady, equations.lasting)
    # Before the contact history changes.
    mixed = is_mixed_with_impacts(scene, memory, tape, island, h)
    write_modes(scene, memory, island, contacts, steady, met, k, chunk)
    rows = free_rows(scene, tape, contacts, columns)
    redundant, shared = share_forces(scene, island, rows, contacts.cones, modes, steady)
    for a in range(len(members)):
        i, at = members[a], n + scene.joints + 2 * members[a]
        chunk.shared[k, i] = redundant[a]
        if shared[a, 0] > 0.0 and not memory.closed[i] and not island.hit.any():
            # Its share of the load was in the force of another contact.
            memory.closed[i] = True
            chunk.codes[k, i] = modes[a]
        for d in range(2):
            # Joints bear the rest.
            for j in range(n, columns.shape[1]):
                rest = columns[2 * a + d, j] * (shared[a, d] - steady[a, d])
                equations.change[j] += rest
                equations.lasting[j] += rest
            force = math.nan if mixed else shared[a, d] / force_duration(scene, tape, i, h)
            chunk.solved[k, at + d] = 0.0 if chunk.codes[k, i] == FREE else force
    if impact_order_matters(scene, island, contacts, k, chunk):
        chunk.stats[k, AMBIGUOUS] = 1.0
    return mixed


@kernel
def _evaluate_at_touch(
    scene: StepConstants, instant: StepInstant, delay: float, moved: Array, numbers: Array
) -> None:
    """Evaluate the tape `delay` after mid-step, after impacts that change rates by `moved`."""
    n, (time, state, middle) = scene.size, instant
    there = middle.copy()
    for j in range(n):
        there[j] += delay * state[n + j]
        there[n + j] += moved[j]
    tape_values(*scene.equations, there, scene.parameters, time + delay, numbers)


@kernel
def _hold_after_touch(
    scene: StepConstants, numbers: Array, equations: FactoredEquations, columns: Array, h: float,
    left: float,
) -> None:  # fmt: skip
    """Close the constraints that the impulses of a group move, `left` after its touch.

    `numbers`: of the tape after its impact; `columns`: see `unit_responses`.
    """
    n, held, change, right = scene.size, scene.bilateral, equations.change, np.zeros(len(columns.T))
    at = n
    first = n * n + n + (n * n if scene.damped else 0)
    for i in range(len(held) + scene.joints):
        joint, row = i - len(held), first + (2 * n + CONTACT) * min(i, len(held))
        row += (n + JOINT) * max(joint, 0)
        for d in range(held[i] if joint < 0 else 1):
            gap, rate, bias = row + n, row + n + 1, row + n + 2
            if joint < 0:
                gap, rate, bias = row + 2 * n + 2, row + 2 * n + 3 + d, row + 2 * n + d
            on = joint < 0 or numbers[row + n + 3] == 0.0
            if on and np.abs(columns[:, at]).max() > 0.0:
                right[at] = -0.5 * left * left / h * numbers[bias] - numbers[rate]
                right[at] -= numbers[gap] / h if d == 0 else 0.0
                for j in range(n):
                    right[at] -= numbers[row + d * n + j] * change[j]
            at += 1
    correction = solve_factored(equations.factors, equations.order, right)
    for j in range(len(change)):
        change[j] += correction[j]


@kernel
def _touch(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    instant: StepInstant, members: Ints, met: ContactRoles, h: float,
) -> tuple[float, Array, TapeValues, FactoredEquations]:  # fmt: skip
    """Return when a group that lands touches, after mid-step, and the change of rates (n,) there.

    And the tape and equations for its impulses there, with the forces of mid-step. The time is 0
    if a contact rebounds, or `time_to_touch` is infinite.
    """
    n, delay, later = tape.size, 0.0, time_to_touch(scene, tape, members, met, h)
    moved, there = np.zeros(n), TapeValues(np.empty_like(tape.numbers), *tape[1:])
    for i in members:
        later = 0.0 if rebounds(scene, met, i) else later
    for _ in range(_TOUCHES):
        if not TIME_MARGIN * h < abs(later) < h or delay + later > 0.0:
            break
        delay += later
        _evaluate_at_touch(scene, instant, delay, moved, there.numbers)
        later = time_to_touch(scene, there, members, met, h)
    if not (abs(later) <= TIME_MARGIN * h and -h < delay < 0.0):
        return 0.0, moved, tape, equations
    regular, at_touch = _free_change(scene, memory.light, there.numbers, h, 0.5 * h - delay)
    if not regular:
        return 0.0, moved, tape, equations
    change, left, after = equations.change, h - delay, np.empty_like(tape.numbers)
    at_touch = FactoredEquations(at_touch.factors, at_touch.order, change, equations.lasting)
    for i in members:
        write_rates(there, change, i, met)
    # The impact by itself, without forces.
    island, contacts, columns, _ = group_island(scene, memory, there, at_touch, members, met, h)
    copy_rows(island.start, island.unforced)
    island.bias[:] = 0.0
    coordinate_impulses(contacts, island, scene.impulse_tolerance)
    _add_impulses(columns, island.chosen, moved)
    _evaluate_at_touch(scene, instant, delay, moved, after)
    _hold_after_touch(scene, after, at_touch, columns, h, left)
    for i in members:
        write_rates(there, change, i, met)
        at = tape.first + tape.per * i + 2 * n
        if met.hit[i]:
            memory.target_gap[i] = min(after[at + 2], scene.gap_tolerance)
        if not is_coupling(scene, i):
            # Contacts reach their target at the middle of the next step.
            above = after[at + 2] - memory.target_gap[i] + 0.5 * left * left * after[at]
            met.bias[i, 0] = above / h
    return delay, moved, there, at_touch


@kernel
def _write_delays(touches: Array, landed: Bools, owners: Ints, k: int, chunk: Chunk) -> None:
    """Write when the impacts of step k are recorded, after mid-step, in the order of their touches.

    Landings are recorded where they touch (c,), other impacts at mid-step. Several touches keep
    their order: landings after another impact are recorded at mid-step, too, touches before the
    step just after its begin. `owners`: contacts that move coordinates and joint forces, or -1.
    """
    h, c, early, last, ordered = chunk.h, len(touches), math.inf, -0.5 * chunk.h, 0.0
    for i in range(c):
        for j in range(i if touches[i] < math.inf else 0):
            if touches[j] < math.inf and touches[j] != touches[i]:
                ordered = ORDERED
        if not landed[i]:
            early = min(early, touches[i])
    for i in range(c):
        delay, touch = -0.5 * h, touches[i]
        if touch < math.inf:
            delay = touch if landed[i] and touch < early else ordered * touch
            delay = max(delay, ordered * (touch + h) - _EARLIEST * h)
        chunk.impact_delay[k, i] = delay
        last = max(last, delay)
    for j in range(len(owners)):
        chunk.impact_delay[k, c + j] = last if owners[j] < 0 else chunk.impact_delay[k, owners[j]]


@kernel
def _note_impacts(scene: StepConstants, members: Ints, moved: Bools, owners: Ints) -> None:
    """Write a member of a group at what its impacts moved; `moved`: rates and constraints (s,)."""
    n, first = scene.size, len(moved) - scene.joints
    for j in range(len(moved)):
        if moved[j] and (j < n or j >= first):
            owners[j if j < n else n + j - first] = members[0]
    for i in members:
        if is_coupling(scene, i):
            owners[n + scene.joints + scene.couplings + i - len(scene.cones)] = i


@kernel
def _write_held(
    scene: StepConstants, equations: FactoredEquations, blurred: bool, k: int, chunk: Chunk
) -> None:
    """Write the forces of bilateral contacts and joints."""
    n, h, total, lasting = scene.size, chunk.h, equations.change, equations.lasting
    at = n
    for i in range(len(scene.bilateral)):
        held = scene.bilateral[i]
        if held > 0:
            chunk.codes[k, i] = PIN if held == 2 else SLIDE
        for d in range(held):
            force = math.nan if blurred else lasting[at] / h
            chunk.solved[k, n + scene.joints + 2 * i + d] = force
            chunk.impulses[k, i, d] = total[at] - lasting[at]
            at += 1
    for i in range(scene.joints):
        chunk.solved[k, n + i] = math.nan if blurred else lasting[at + i] / h
        chunk.joint_impulses[k, i] = total[at + i] - lasting[at + i]


@kernel
def _flow_controllers(
    scene: StepConstants, time: float, there: Array, h: float, state: Array
) -> None:
    """Advance the controller variables by h, in place, at the rates of a state `there`."""
    count = len(state) - 2 * scene.size
    if count == 0:
        return
    rates = np.empty(count)
    tape_values(*scene.flows, there, scene.parameters, time, rates)
    for i in range(count):
        state[2 * scene.size + i] += h * rates[i]


@kernel
def _enable_continuations(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, there: Array, met: ContactRoles,
    near: float,
) -> None:  # fmt: skip
    """Enable contacts on the continuation of a surface that a point leaves.

    `there`: tape at the point moved out of that surface by its landing depth. A deep point between
    two edges at an angle is beyond both.
    """
    for i in range(len(memory.disabled)):
        at = tape.first + tape.per * i + 2 * tape.size
        moved = there[at + 2] - tape.numbers[at + 2]
        lay = min(memory.target_gap[i], 0.0) if memory.left_behind[i] else 0.0
        holds = there[at + 5] > 0.0 and met.entered[i] + moved >= lay - near
        if memory.disabled[i] and not met.leaving[i] and holds and scene.bilateral[i] == 0:
            memory.disabled[i] = False


@kernel
def keep_leaving(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    instant: StepInstant, k: int, met: ContactRoles, chunk: Chunk,
) -> None:  # fmt: skip
    """Disable lasting contacts whose conditions cease to hold.

    In a valley each side leads back to the other, and both hold at the kink. A contact therefore
    stays on in a step in which it is loaded and its condition rises, or would fall without the
    other contacts. Parameters: those of `step_scene` in step k.
    """
    n, h, (time, state, middle) = tape.size, chunk.h, instant
    change, c = equations.change, len(memory.target_gap)
    level, closed = memory.target_gap.copy(), memory.closed.copy()
    find_active(scene, memory, tape, change, k, met, chunk)
    close_opposed(scene, memory, tape, h, met)
    label_groups(scene, tape, met.active, met.groups)
    which, bears, pushes = indices(met.active), np.zeros(c, np.bool_), np.zeros((c, 2))
    # Changes of rates per unit normal and tangential impulse.
    moves = np.zeros((c, 2, n))
    there, ahead = middle.copy(), np.empty_like(tape.numbers)
    alone = np.empty_like(tape.numbers)
    for label in which:
        members = group_members(met, label)
        if len(members) == 0:
            continue
        group = group_island(scene, memory, tape, equations, members, met, h)
        island, contacts, columns, _ = group
        for at_rest in (False, True):
            for a in range(len(members) if at_rest else 0):
                # Landing gaps also move the point, to where it rests.
                if not met.hit[members[a]]:
                    island.bias[a, 0] = 0.0
                copy_numbers(memory.impulses[members[a]], island.chosen[a])
            error, _ = coordinate_impulses(contacts, island, scene.impulse_tolerance)
            rows = free_rows(scene, tape, contacts, columns)
            share_loads(scene, island, rows, contacts.cones)
            for a in range(len(members)):
                i, solved = members[a], error <= scene.impulse_tolerance
                presses = solved and island.chosen[a, 0] > 0.0
                bears[i] = presses and (bears[i] or not at_rest)
        for a in range(len(members)):
            for d in range(2):
                pushes[members[a], d] = island.chosen[a, d]
                copy_numbers(columns[2 * a + d, :n], moves[members[a], d])
    for j in range(n):
        there[n + j] = state[n + j] + change[j]
        for i in which:
            for d in range(2):
                there[n + j] += moves[i, d, j] * pushes[i, d]
        there[j] += h * there[n + j]
    _flow_controllers(scene, time, middle, h, there)
    tape_values(*scene.equations, there, scene.parameters, time + h, ahead)
    for i in range(len(closed)):
        memory.disabled[i] = memory.disabled[i] or met.leaving[i]
    for i in which:
        if not met.leaving[i]:
            continue
        at = tape.first + tape.per * i + 2 * n + 5
        now, then = tape.numbers[at], ahead[at]
        # At rest conditions change by round-off.
        rounding = _AT_REST * abs(now) + h * scene.round_off
        stays_on = bears[i] and now - then <= rounding
        if stays_on and then - now <= rounding:
            # It does not return by itself.
            apart = there.copy()
            for j in range(n):
                for b in which:
                    for d in range(2 if b != i else 0):
                        apart[n + j] -= moves[b, d, j] * pushes[b, d]
                apart[j] += h * (apart[n + j] - there[n + j])
            tape_values(*scene.equations, apart, scene.parameters, time + h, alone)
            stays_on = then - alone[at] > rounding
        memory.disabled[i] = not stays_on
    for i in which:
        if met.leaving[i] and memory.disabled[i]:
            deep = _write_surface_tape(scene, tape, equations, instant, i, ahead)
            near = scene.gap_tolerance - _BENT * deep
            _enable_continuations(scene, memory, tape, ahead, met, near)
    for i in range(len(closed)):
        gap = tape.numbers[tape.first + tape.per * i + 2 * n + 2]
        chunk.gaps[k, i] = math.inf if memory.disabled[i] else gap
        memory.closed[i] = closed[i]
    copy_numbers(level, memory.target_gap)
    chunk.approach[k] = chunk.closing[k] = chunk.energy_gain[k] = 0.0


@kernel
def _settle(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    instant: StepInstant, k: int, chunk: Chunk,
) -> None:  # fmt: skip
    """Write the modes of settling contacts, for the velocities after the step."""
    n, there = tape.size, instant.middle.copy()
    copy_numbers(instant.state[n : 2 * n], there[n : 2 * n])
    tape_values(*scene.equations, there, scene.parameters, instant.time, tape.numbers)
    settle(scene, memory, tape, equations, k, chunk)


@kernel
def _age_contacts(memory: ContactHistory, active: Bools) -> None:
    """Update contact histories at the end of a step."""
    for i in range(len(active)):
        memory.landing_steps[i] = max(memory.landing_steps[i] - 1, 0)
        if not active[i]:
            memory.closed[i] = False


@kernel
def step_scene(
    scene: StepConstants, memory: ContactHistory, start: float, chunk: Chunk
) -> tuple[int, int]:
    """Take the steps of a chunk; return their number, and the status.

    Parameters
    ----------
    memory : ContactHistory
        Changed in place.
    start : float
        Time of the first step.
    chunk : Chunk
        Output; unknowns are accelerations (n,), forces of joints and lasting contacts (2 c,; NaN if
        the step also holds an impact), controlled values (u,).
    """
    h, state = chunk.h, chunk.states[0].copy()
    n, c = scene.size, len(scene.cones)
    numbers = np.empty(len(scene.equations[2]))
    tape = TapeValues(numbers, n, n * n + n + (n * n if scene.damped else 0), 2 * n + CONTACT)
    set_at, forces = tape.first + tape.per * c + (n + JOINT) * scene.joints, n + scene.joints
    given_count = len(numbers) - set_at - scene.signs * (3 * n + 1)
    given_count = given_count // (1 + scene.signs)
    per = 3 * n + 1 + given_count
    for k in range(len(chunk.codes)):
        middle = state.copy()
        _flow_controllers(scene, start + k * h, state, 0.5 * h, middle)
        for i in range(n):
            middle[i] += 0.5 * h * state[n + i]
        time = start + (k + 0.5) * h
        tape_values(*scene.equations, middle, scene.parameters, time, numbers)
        regular, equations = _free_change(scene, memory.light, numbers, h, 0.5 * h)
        if not regular:
            return k, BAD_INERTIA
        signs = hold_signs(scene, memory, tape, equations, state, h, set_at + given_count)
        for i in range(given_count):
            value = numbers[set_at + i]
            for j in range(scene.signs):
                value += signs[j] * numbers[set_at + given_count + (j + 1) * per - given_count + i]
            chunk.solved[k, forces + 2 * c + i] = value
        chunk.approach[k] = chunk.closing[k] = chunk.energy_gain[k] = 0.0
        met = ContactRoles(
            np.zeros(c, np.bool_), np.zeros(c, np.bool_), np.zeros(c, np.bool_), np.empty(c),
            np.empty(c, np.int64), np.zeros((c, 2)), np.zeros((c, 2)), np.zeros((c, 2)),
        )  # fmt: skip
        instant = StepInstant(time, state, middle)
        if not switch_contacts(scene, memory, tape, equations, k, met, chunk, instant):
            return k, NOT_FINITE
        if met.leaving.any():
            keep_leaving(scene, memory, tape, equations, instant, k, met, chunk)
        find_active(scene, memory, tape, equations.change, k, met, chunk)
        close_opposed(scene, memory, tape, h, met)
        total, lasting, before = equations.change, equations.lasting, equations.change.copy()
        copy_numbers(total, lasting)
        copy_numbers(-lasting[:n], memory.contact_change)
        which, blurred, shift = indices(met.active), False, np.zeros(n)
        touches, landed = np.full(c, math.inf), np.zeros(c, np.bool_)
        owners = np.full(chunk.impact_delay.shape[1] - c, -1)
        chunk.stats[k, CONTACTS] = len(which)
        clear_contacts(scene, memory.disabled, forces, k, chunk)
        if len(which) > 0:
            label_groups(scene, tape, met.active, met.groups)
        for label in which:
            members = group_members(met, label)
            if len(members) == 0:
                continue
            instant = StepInstant(time, state, middle)
            delay, moved, there, at_touch = _touch(
                scene, memory, tape, equations, instant, members, met, h
            )
            copy_numbers(total, before)
            touch = time_to_touch(scene, tape, members, met, h)
            touch = touch if touch < math.inf else 0.0
            mixed = _step_group(scene, memory, there, at_touch, members, met, k, chunk)
            blurred = blurred or mixed
            if chunk.struck[k][members].any():
                touch = delay if delay < 0.0 else min(touch, 0.0)
                for i in range(c):
                    # Round-off must not separate simultaneous impacts.
                    touch = touches[i] if abs(touches[i] - touch) <= TIME_MARGIN * h else touch
                _note_impacts(scene, members, total != before, owners)
                for i in members:
                    touches[i], landed[i] = touch, delay < 0.0
                for j in range(n):
                    shift[j] -= delay * moved[j]
        _write_delays(touches, landed, owners, k, chunk)
        # The steps after an impact bring joints to the violation of the new velocity.
        _write_held(scene, equations, blurred or bool(memory.landing_steps.any()), k, chunk)
        for i in range(n):
            memory.contact_change[i] += lasting[i]
            chunk.solved[k, i] = lasting[i] / h
            # Mean velocity of the step.
            middle[n + i] += 0.5 * total[i]
            middle[i] += shift[i]
            state[n + i] += total[i]
            state[i] = middle[i] + 0.5 * h * state[n + i]
            if not math.isfinite(state[i]):
                return k, NOT_FINITE
        # Compliant contacts have no acceleration problem.
        if unsettle(memory, k, chunk) and (scene.compliance[:, 0] == 0.0).any():
            _settle(scene, memory, tape, equations, instant, k, chunk)
        _age_contacts(memory, met.active)
        _flow_controllers(scene, time, middle, h, state)
        for i in range(2 * n, len(state)):
            if not math.isfinite(state[i]):
                return k, NOT_FINITE
        copy_numbers(state, chunk.states[k + 1])
    return len(chunk.codes), DONE
