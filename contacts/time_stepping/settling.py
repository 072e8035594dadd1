"""Modes of contacts where they change, from the acceleration complementarity problem.

In the steps after an impact impulses compensate the landing: motion turns a contact off its landing
gap by ``h^2 b/2`` and its normal velocity by ``h b``, where b is the bias of its normal
acceleration. These impulses are wrong by the order of the forces. Velocities of order ``h a``
also remain where a slip ends or a contact opens. Therefore, from an impact or a mode change on,
the modes are those of the event-driven engines::

    0 <= V,  0 <= a_n,  V a_n = 0,  a = J M^-1 f + b + W F,  F in the cone of friction

with the velocities after the step, until its impulses agree. Zero are quantities that a few steps
of acceleration explain: gaps up to ``16 h^2 a`` and their rates; slips against the mode of the
previous step up to ``4 h a`` while the contact is loaded, and slips that end within four steps;
accelerations of order ``h a`` only after an impact or against the impulses; slips of couplings
after a landing up to ``4 h a``, with the sizes a of all terms. In a group with a loaded compliant
contact, without a landing, slips are those of the steps: a foot beside a pinned compliant one
creeps. Groups of coupled contacts settle separately.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.solvers.contact_rows import STEEPEST
from contacts.solvers.lemke import forces_by_lemke
from contacts.solvers.step_impulses import SUM_ROUNDING
from contacts.states import FREE, LOCKED, OFF_CODE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.equations import (
    HOLDING,
    JOINT,
    LANDED,
    ContactHistory,
    FactoredEquations,
    StepConstants,
    TapeValues,
    is_coupling,
    solve_factored,
)
from contacts.time_stepping.step_contacts import (
    LOADED,
    LOADINGS,
    coupling_loads,
    coupling_mode,
    delassus_of,
    label_groups,
    load_couplings,
    normal_pads,
    unit_responses,
    write_cone,
)
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers, indices
from statechart.kernels.jit import kernel

# Steps of acceleration that explain a velocity, and of that velocity that explain a gap.
LEFT = 4.0
# Forces strictly inside their cone, relative to its edge.
_INSIDE = 1.0 - 1e-9
# Accelerations that are zero to first order, relative to those of the step; and their upper limit,
# relative to their terms, at any step size.
ALIKE, _MOST_ALIKE = 0.1, 1e-2


class _Accelerations(NamedTuple):
    """Contacts of a step, and their accelerations without forces of rigid free contacts."""

    moving: Array  # Accelerations of the coordinates, and constraint forces.
    # (c, 2): accelerations of contacts, and sums of absolute terms.
    free: Array
    sizes: Array
    # (c,): part of the acceleration problem; explained by steps of acceleration; `LANDED`;
    # compliant and loaded.
    closed: Bools
    near: Bools
    landed: Bools
    yields: Bools
    groups: Ints  # (c,): see `contacts.time_stepping.step_contacts.label_groups`.


@kernel
def unsettle(memory: ContactHistory, k: int, chunk: Chunk) -> bool:
    """Mark contacts whose modes change as settling; return whether any contact settles."""
    for i in range(len(memory.modes)):
        chunk.modes[k, i] = chunk.codes[k, i]
        changes = memory.modes[i] != chunk.codes[k, i]
        memory.settling[i] = max(memory.settling[i], int(changes))
    return bool(memory.settling.any())


@kernel
def _free_accelerations(
    scene: StepConstants, tape: TapeValues, equations: FactoredEquations
) -> Array:
    """Return the accelerations of the coordinates without forces of free contacts."""
    n, numbers, right = tape.size, tape.numbers, np.zeros(len(equations.order))
    for j in range(n):
        right[j] = numbers[n * n + j]
    at = n
    for i in range(len(scene.bilateral)):
        for d in range(scene.bilateral[i]):
            right[at] = -numbers[tape.first + tape.per * i + 2 * n + d]
            at += 1
    for i in range(scene.joints):
        row = tape.first + tape.per * len(scene.bilateral) + (n + JOINT) * i
        if numbers[row + n + 3] == 0.0:
            right[at] = -numbers[row + n + 2]
        at += 1
    return solve_factored(equations.factors, equations.order, right)


@kernel
def _is_yielding(scene: StepConstants, i: int) -> bool:
    """Return whether contact i is compliant, or the rolling resistance of a compliant one."""
    carrier = scene.carriers[i]
    return scene.compliance[i, 0] > 0.0 or (carrier >= 0 and scene.compliance[carrier, 0] > 0.0)


@kernel
def _add_yielding_forces(
    memory: ContactHistory, tape: TapeValues, equations: FactoredEquations, which: Ints, h: float,
    moving: Array,
) -> None:  # fmt: skip
    """Add the accelerations by loaded compliant contacts."""
    columns = unit_responses(tape, equations, which)
    for a in range(2 * len(which)):
        force = memory.impulses[which[a // 2], a % 2] / h
        for j in range(len(moving)):
            moving[j] += columns[a, j] * force


@kernel
def _write_accelerations(
    tape: TapeValues, i: int, moving: Array, accelerations: Array, sizes: Array
) -> None:
    """Write the accelerations (2,) of contact i, and the sums of absolute terms."""
    n = tape.size
    row = tape.first + tape.per * i
    for d in range(2):
        accelerations[d] = tape.numbers[row + 2 * n + d]
        sizes[d] = abs(accelerations[d])
        tangential = 0.0
        for j in range(n):
            tangential += tape.numbers[row + d * n + j] * moving[j]
        accelerations[d] += tangential
        sizes[d] += abs(tangential)


@kernel
def _is_near(memory: ContactHistory, tape: TapeValues, i: int, size: float, h: float) -> bool:
    """Return whether steps of acceleration explain a contact's gap and rate."""
    row, explained = tape.first + tape.per * i + 2 * tape.size, LEFT * h * size
    gap, rate = tape.numbers[row + 2] - memory.target_gap[i], tape.numbers[row + 3]
    return gap <= LEFT * h * explained and rate <= explained


@kernel
def solve_accelerations(
    delassus: Array, free: Array, cones: Array, slides: Array, sizes: Array, accelerations: Array,
    sums: Array,
) -> tuple[bool, Array]:  # fmt: skip
    """Write the accelerations (m, 2) of contacts; return whether they are solved for, and forces.

    For `delassus`, `free`, `cones`, `slides` see `contacts.solvers.lemke.impulses_by_lemke`;
    `sizes` and `sums` (m, 2) are sums of absolute terms, of `free` and of the accelerations.
    """
    solved, forces = forces_by_lemke(delassus, free, cones, slides)
    for a in range(len(accelerations)):
        for d in range(2):
            accelerations[a, d], terms = free[a, d], sizes[a, d]
            for b in range(len(accelerations)):
                for e in range(2):
                    term = delassus[2 * a + d, 2 * b + e] * forces[b, e]
                    accelerations[a, d] += term
                    terms += abs(term)
            sums[a, d] = terms
            if abs(accelerations[a, d]) <= SUM_ROUNDING * terms:
                accelerations[a, d] = 0.0
        # By complementarity; tied pivots leave a residual.
        if forces[a, 0] > 0.0:
            accelerations[a, 0], across = 0.0, abs(forces[a, 1]) * max(cones[a, 0], STEEPEST)
            if slides[a] == 0.0 and across < _INSIDE * cones[a, 1] * forces[a, 0]:
                accelerations[a, 1] = 0.0
    return solved, forces


@kernel
def clear_first_order_zeros(accelerations: Array, sums: Array, per_speed: float) -> None:
    """Clear accelerations (2,) that are zero to first order in the step.

    Contacts of one body that landed at different depths have lever arms, and so accelerations, that
    differ by ``h a`` relative to the scene's speed.
    """
    for d in range(2):
        if abs(accelerations[d]) <= min(per_speed * sums[d], _MOST_ALIKE) * sums[d]:
            accelerations[d] = 0.0


@kernel
def end_slips(
    slips: Array, accelerations: Array, against: Bools, sizes: Array, h: float, slides: Array
) -> bool:
    """Clear the directions (m,) of slips that some steps explain; return whether there are.

    These are slips that end within some steps, and slips `against` the previous mode that
    accelerations, with terms of these `sizes` (m, 2), cause within them.
    """
    any_ended = False
    for a in range(len(slips)):
        explained = LEFT * h * (sizes[a, 1] + abs(accelerations[a, 1]))
        ends = slides[a] * (slips[a] + LEFT * h * accelerations[a, 1]) < 0.0
        if ends or (against[a] and abs(slips[a]) <= explained):
            slides[a], any_ended = 0.0, True
    return any_ended


@kernel
def _direction(mode: int) -> float:
    return 1.0 if mode == SLIDE_PLUS else -1.0 if mode == SLIDE_MINUS else 0.0


@kernel
def mode_of_acceleration(
    acceleration: Array, slip: float, still: bool, cone: Array, directed: bool
) -> int:
    """Return the mode of a contact with accelerations (2,)."""
    if acceleration[0] > 0.0:
        return FREE
    if cone[1] == 0.0 and not directed:
        return SLIDE
    tangential = acceleration[1] if still else slip
    if tangential == 0.0:
        return PIN
    return SLIDE_PLUS if tangential > 0.0 else SLIDE_MINUS


@kernel
def settle(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    k: int, chunk: Chunk,
) -> None:  # fmt: skip
    """Write the modes of coupled groups with settling contacts in step k.

    The tape is that of the midpoint, with the velocities after the step.
    """
    c, h = len(scene.cones), chunk.h
    problem = _Accelerations(
        _free_accelerations(scene, tape, equations), np.zeros((c, 2)), np.zeros((c, 2)),
        np.zeros(c, np.bool_), np.zeros(c, np.bool_), np.zeros(c, np.bool_), np.zeros(c, np.bool_),
        np.empty(c, np.int64),
    )  # fmt: skip
    for i in range(c):
        bears = chunk.codes[k, i] != FREE and not memory.disabled[i]
        problem.yields[i] = bears and _is_yielding(scene, i)
    _add_yielding_forces(memory, tape, equations, indices(problem.yields), h, problem.moving)
    closed, near = problem.closed, problem.near
    for i in range(c):
        _write_accelerations(tape, i, problem.moving, problem.free[i], problem.sizes[i])
        if _is_yielding(scene, i):
            continue
        if is_coupling(scene, i):
            closed[i] = not memory.disabled[i]
        elif scene.bilateral[i] == 0 and not memory.disabled[i]:
            near[i] = _is_near(memory, tape, i, problem.sizes[i, 0], h)
            lasts = near[i] and memory.modes[i] != FREE and memory.modes[i] != OFF_CODE
            closed[i] = lasts or chunk.codes[k, i] != FREE
            problem.landed[i] = closed[i] and memory.settling[i] == LANDED
    coupled = closed | problem.yields | (memory.settling > 0)
    label_groups(scene, tape, coupled, problem.groups)
    for label in indices(coupled):
        members = indices((problem.groups == label) & coupled)
        if (memory.settling[members] > 0).any():
            _settle_group(scene, memory, tape, equations, problem, members, k, chunk)
            _finish_settling(memory, tape.size + scene.joints, members, k, chunk)


@kernel
def _settle_group(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    problem: _Accelerations, members: Ints, k: int, chunk: Chunk,
) -> None:  # fmt: skip
    """Write the modes of a coupled group in step k, from its acceleration problem."""
    n, h, moving, near = tape.size, chunk.h, problem.moving, problem.near
    landed, yields = problem.landed[members].any(), problem.yields[members].any()
    for i in members:
        memory.settling[i] = max(memory.settling[i], 1)
    which = members[problem.closed[members]]
    m = len(which)
    modes = chunk.modes[k]
    if m > 0:
        columns = unit_responses(tape, equations, which)
        delassus = delassus_of(tape, which, columns)
        slips, slides, rounding = np.empty(m), np.zeros(m), SUM_ROUNDING * scene.speed
        forced, sums, alone = np.empty((m, 2)), np.empty((m, 2)), np.empty((m, 2))
        cones, terms = np.empty((m, 2)), np.empty((m, 2))
        against, brakes = np.zeros(m, np.bool_), np.zeros(m, np.bool_)
        for a in range(m):
            i = which[a]
            copy_numbers(problem.free[i], alone[a])
            copy_numbers(problem.sizes[i], terms[a])
            slips[a] = tape.numbers[tape.first + tape.per * i + 2 * n + 4]
            if chunk.codes[k, i] != FREE:
                # The slip at mid-step differs by the step's rotation.
                slips[a] = memory.slip[i]
            if abs(slips[a]) > rounding:
                slides[a] = 1.0 if slips[a] > 0.0 else -1.0
            write_cone(scene, tape, i, int(slides[a]), cones[a])
            lasts = memory.modes[i] != FREE and memory.landing_steps[i] != HOLDING
            # The impulses that correct a landing may unload a contact for a step.
            lasts = lasts and (chunk.codes[k, i] != FREE or memory.settling[i] == LANDED)
            against[a] = lasts and _direction(memory.modes[i]) != slides[a]
            # Forces decide the slip that an impact leaves to a brake.
            brakes[a] = landed and is_coupling(scene, i) and scene.carriers[i] < 0
            against[a] = against[a] or brakes[a]
        ended, solved, forces = yields and not landed, False, np.zeros((m, 2))
        pads, _ = normal_pads(scene, tape, which, columns, h)
        for a in range(m):
            delassus[2 * a, 2 * a] += pads[a]
        loads = coupling_loads(scene, which, columns, moving, forces, 1.0)
        load_couplings(scene, tape, which, loads, pads, alone)
        for _ in range(LOADINGS):
            solved, forces = solve_accelerations(
                delassus, alone, cones, slides, terms, forced, sums
            )
            loads = coupling_loads(scene, which, columns, moving, forces, 1.0)
            if load_couplings(scene, tape, which, loads, pads, alone) > LOADED:
                continue
            for a in range(m):
                if brakes[a]:
                    # Contact forces rotate the coupled bodies.
                    copy_numbers(sums[a], terms[a])
            if ended or not (solved and end_slips(slips, forced, against, terms, h, slides)):
                break
            ended = True
            for a in range(m):
                write_cone(scene, tape, which[a], int(slides[a]), cones[a])
        for a in range(m):
            i = which[a]
            # An impact elsewhere may leave a lasting contact without load, but does not open it.
            kept = memory.landing_steps[i] == HOLDING and memory.modes[i] not in (FREE, OFF_CODE)
            idle = forces[a, 0] == 0.0 and chunk.codes[k, i] == FREE and not kept
            if solved and near[i] and not idle:
                still, directed = slides[a] == 0.0, scene.slips[i] == 2
                modes[i] = mode_of_acceleration(forced[a], slips[a], still, cones[a], directed)
                if memory.settling[i] == LANDED or modes[i] != chunk.codes[k, i]:
                    clear_first_order_zeros(forced[a], sums[a], ALIKE * h / scene.speed)
                    modes[i] = mode_of_acceleration(forced[a], slips[a], still, cones[a], directed)
            if solved and brakes[a]:
                clear_first_order_zeros(forced[a], sums[a], ALIKE * h / scene.speed)
                tangential = slips[a] if slides[a] != 0.0 else forced[a, 1]
                modes[i] = coupling_mode(scene, i, tangential, modes)
            if memory.settling[i] == LANDED and modes[i] in (PIN, LOCKED):
                # Its slip is of these impulses: no kinetic friction.
                memory.closed[i], memory.slip[i] = True, 0.0
            if scene.carriers[i] >= 0:
                found = coupling_mode(scene, i, slips[a] if slides[a] != 0.0 else 0.0, modes)
                modes[i] = found if FREE in (found, modes[i]) else modes[i]


@kernel
def _finish_settling(
    memory: ContactHistory, first: int, members: Ints, k: int, chunk: Chunk
) -> None:
    """End the settling of a group whose impulses in step k agree with the recorded modes.

    `first`: index of the contact forces in the unknowns of the step.
    """
    agree = True
    for i in members:
        mode = memory.modes[i] = chunk.modes[k, i]
        agree = agree and mode == chunk.codes[k, i] and memory.landing_steps[i] == 0
        if mode != chunk.codes[k, i]:
            for d in range(2):
                force = math.nan if mode != FREE else 0.0
                chunk.solved[k, first + 2 * i + d] = force
    for i in members:
        memory.settling[i] = 0 if agree else memory.settling[i]
