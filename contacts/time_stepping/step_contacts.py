"""Active contacts of a step of points on surfaces: their impulses, modes and forces.

Moreau's midpoint rule: one contact problem per step, at its midpoint.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import ContactRows, velocity_scale
from contacts.solvers.dependence import CANCELLING
from contacts.solvers.impulse_coupling import coupled_contacts
from contacts.solvers.redundancy import shared_forces
from contacts.solvers.step_impulses import (
    LIMIT,
    LIVELY,
    SUM_ROUNDING,
    TWO,
    Island,
    coordinate_rows,
    forces_without_impacts,
    is_sliding,
    new_island,
    order_matters,
    project_into_cone,
    removable_share,
    write_velocities,
)
from contacts.states import (
    FREE,
    LOCKED,
    OFF_CODE,
    OPEN_CODE,
    PIN,
    SLIDE,
    SLIDE_MINUS,
    SLIDE_PLUS,
    SLIP_MINUS,
    SLIP_PLUS,
)
from contacts.time_stepping.chunk import (
    CHOSEN,
    HIT,
    JAMMED,
    LASTING,
    SEPARATED,
    SLOW,
    TIME_MARGIN,
    Chunk,
    compliant_row,
    contact_role,
    curvature_speed,
    time_in_contact,
)
from contacts.time_stepping.equations import (
    EDGES,
    HOLDING,
    JOINT,
    LANDED,
    ContactHistory,
    ContactRoles,
    FactoredEquations,
    StepConstants,
    TapeValues,
    is_coupling,
    solve_factored,
)
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import copy_numbers, copy_rows, indices
from statechart.kernels.jit import kernel


@kernel
def mode_of_impulse(impulse: Array, slip: float, sliding: bool, cone: Array, directed: bool) -> int:
    """Return the mode of a loaded contact.

    `slip` (after the step), `sliding` (under friction), `directed` (its slides have a direction
    even without friction).
    """
    if cone[1] == 0.0 and not directed:
        return SLIDE
    if cone[1] == 0.0:
        sliding = slip != 0.0
    if not sliding:
        return PIN
    if slip != 0.0:
        return SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS
    return SLIDE_PLUS if impulse[1] < 0.0 else SLIDE_MINUS


@kernel
def friction_presses(own: Array, slip: float, cone: Array) -> bool:
    """Return whether friction presses a sliding contact into its surface (Painleve's paradox)."""
    against = -cone[1] if slip > 0.0 else cone[1]
    return slip != 0.0 and own[0] * cone[0] + own[2] * against <= 0.0


# Relative tolerance of opposite directions.
_OPPOSITE = 1e-9
# Tolerance factor of a remaining gap, for curvature.
_BENT = 1.01


@kernel
def close_opposed(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, h: float, met: ContactRoles
) -> None:
    """Close both or none of two opposed contacts, such as a latch and its stop.

    The small gap left when one closes must not count as clearance of the other: the body would
    bounce between them, and be struck in turn instead of at once, however short the step.
    """
    n = tape.size
    for i in range(len(scene.cones)):
        row = tape.first + tape.per * i
        gap = tape.numbers[row + 2 * n + 2]
        if memory.disabled[i] or met.hit[i] or scene.bilateral[i] > 0 or not gap > 0.0:
            continue
        for other in range(len(scene.cones)):
            left = tape.numbers[tape.first + tape.per * other + 2 * n + 2]
            lasts = met.active[other] and not met.hit[other]
            if not lasts or memory.target_gap[other] >= -scene.gap_tolerance:
                continue
            lever = _opposing_lever(tape, i, other)
            if lever > 0.0 and gap <= scene.gap_tolerance - _BENT * lever * left:
                # With matching target gaps neither contact is pushed by the other's error.
                met.active[i], memory.closed[i] = True, True
                memory.target_gap[i] = -lever * memory.target_gap[other]
                above = gap + lever * memory.target_gap[other]
                met.bias[i, 0] = above / h + 0.5 * h * tape.numbers[row + 2 * n]
                met.bias[i, 1] = 0.5 * h * tape.numbers[row + 2 * n + 1]
                break


@kernel
def _opposing_lever(tape: TapeValues, i: int, other: int) -> float:
    """Return the closing of contact `i` per opening of `other`; 0 unless they are opposed."""
    n, own, its = tape.size, tape.first + tape.per * i, tape.first + tape.per * other
    most = least = apart = 0.0
    for j in range(n):
        most = max(most, abs(tape.numbers[own + j]))
        least = max(least, abs(tape.numbers[its + j]))
    if most == 0.0 or least == 0.0:
        return 0.0
    lever = most / least
    for j in range(n):
        apart = max(apart, abs(tape.numbers[own + j] + lever * tape.numbers[its + j]))
    return lever if apart <= _OPPOSITE * most else 0.0


# Approach velocity, relative to the velocity change of a free step, of a landing without momentum.
_NEGLIGIBLE_LANDING = 1e-9


@kernel
def _slow(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, met: ContactRoles, i: int,
    h: float,
) -> float:  # fmt: skip
    """Return the approach velocity up to which a contact lasts; see `SLOW`.

    A contact that has rebounded can return by rotation alone: no impact in every step. A point that
    meets a surface tangentially has, at its depth, the approach that the curvature gives it.
    """
    change = met.free[i, 0] - met.before[i, 0]
    slow, at = abs(change), tape.first + tape.per * i + 2 * tape.size
    if memory.landing_steps[i] > 0:
        slow = max(slow, abs(change + h * tape.numbers[at]))
    slow = max(slow, curvature_speed(-tape.numbers[at], -tape.numbers[at + 2]))
    return max(SLOW * slow, scene.speed_tolerance)


@kernel
def write_rates(tape: TapeValues, change: Array, i: int, met: ContactRoles) -> None:
    """Write the velocities of contact i before a step, and after it without contacts."""
    n, row = tape.size, tape.first + tape.per * i
    for d in range(2):
        met.before[i, d] = met.free[i, d] = tape.numbers[row + 2 * n + 3 + d]
        for j in range(n):
            met.free[i, d] += tape.numbers[row + d * n + j] * change[j]


@kernel
def find_active(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, change: Array, k: int,
    met: ContactRoles, chunk: Chunk,
) -> None:  # fmt: skip
    """Write the active contacts of step k, whose rates change by `change` without contacts."""
    numbers, n, off, level, h = tape.numbers, tape.size, memory.disabled, memory.target_gap, chunk.h
    for i in range(len(scene.cones)):
        row = tape.first + tape.per * i
        gap = numbers[row + 2 * n + 2]
        met.active[i] = met.hit[i] = False
        if scene.bilateral[i] > 0 or off[i]:
            continue
        before, free = met.before[i], met.free[i]
        write_rates(tape, change, i, met)
        if is_coupling(scene, i):
            met.active[i], met.bias[i, 1] = True, 0.5 * h * numbers[row + 2 * n + 1]
            continue
        if scene.compliance[i, 0] > 0.0:
            start, end = gap - 0.5 * h * before[0], gap + 0.5 * h * before[0]
            met.active[i] = start <= scene.gap_tolerance or end < -scene.gap_tolerance
            met.bias[i, 1] = 0.5 * h * numbers[row + 2 * n + 1]
            continue
        nearing, slow = -before[0], _slow(scene, memory, tape, met, i, h)
        bias = 0.5 * h * numbers[row + 2 * n]
        closing, reached = h * (slow - (free[0] + bias)), TIME_MARGIN * h * nearing
        # No more than half a step early: bounces within the gap tolerance would sink, not end. A
        # surface that curves away is not reached.
        reached = max(reached, min(scene.gap_tolerance, 0.5 * h * (nearing - 0.5 * bias)))
        if memory.closed[i] and level[i] == math.inf:
            # It has no target gap at the start: rotation until mid-step takes no force.
            level[i] = gap
        role, level[i], above = contact_role(
            gap, level[i], memory.closed[i], nearing, slow, closing, reached, scene.gap_tolerance
        )
        met.active[i], met.hit[i] = role != SEPARATED, role == HIT
        if role == LASTING:
            met.bias[i, 0] = above / h + bias
            if abs(free[0] + met.bias[i, 0]) <= scene.round_off:
                # Bodies that fall side by side have no contact force.
                met.bias[i, 0] = -free[0]
            met.bias[i, 1] = 0.5 * h * numbers[row + 2 * n + 1]
            # Depth between midpoints by rotation.
            chunk.approach[k] = max(chunk.approach[k], 2.0 * abs(bias))
        elif role == HIT:
            # Error of the impact direction by rotation within the step.
            speed = max(math.hypot(before[0], before[1]), scene.min_speed)
            chunk.energy_gain[k] = max(chunk.energy_gain[k], (bias / speed) ** 2)
            met.bias[i, 0] = -scene.restitution[i] * nearing
            chunk.approach[k] = max(chunk.approach[k], nearing)
            chunk.closing[k] = max(chunk.closing[k], -gap)
    if not met.hit.any():
        return
    for i in range(len(scene.cones)):
        lands = met.hit[i] or memory.closed[i] or _is_finite(scene, i)
        if met.active[i] and not lands:
            # It has rebounded, and is still as deep as it landed: the impacts of others do not see
            # it, and one that sends it back is its next impact.
            met.active[i] = not met.before[i, 0] > _slow(scene, memory, tape, met, i, h)


@kernel
def _is_finite(scene: StepConstants, i: int) -> bool:
    """Return whether contact i is compliant or a coupling, which has no impacts."""
    return scene.compliance[i, 0] > 0.0 or is_coupling(scene, i)


@kernel
def unit_responses(tape: TapeValues, equations: FactoredEquations, which: Ints) -> Array:
    """Return M^-1 J^T: the response to unit impulses of contacts (2 m, s)."""
    n, moving = tape.size, len(equations.order)
    columns, push = np.zeros((2 * len(which), moving)), np.zeros(moving)
    for a in range(len(which)):
        row = tape.first + tape.per * which[a]
        for d in range(2):
            for j in range(n):
                push[j] = tape.numbers[row + d * n + j]
            copy_numbers(
                solve_factored(equations.factors, equations.order, push), columns[2 * a + d]
            )
    return columns


@kernel
def delassus_of(tape: TapeValues, which: Ints, columns: Array) -> Array:
    """Return the Delassus matrix J M^-1 J^T (2 m, 2 m)."""
    m, n = len(which), tape.size
    result = np.zeros((2 * m, 2 * m))
    for a in range(m):
        row = tape.first + tape.per * which[a]
        for d in range(2):
            for b in range(2 * m):
                value = 0.0
                for j in range(n):
                    value += tape.numbers[row + d * n + j] * columns[b, j]
                result[2 * a + d, b] = value
    return result


@kernel
def normal_pads(
    scene: StepConstants, tape: TapeValues, which: Ints, columns: Array, h: float
) -> tuple[Array, Array]:
    """Return the pad compliances (m,) of compliant contacts and couplings, and biases (m,).

    The normal rows of couplings move only pads, scaled to other velocities.
    """
    pads, biases = np.zeros(len(which)), np.zeros(len(which))
    for a in range(len(which)):
        i, n, own = which[a], tape.size, 0.0
        row = tape.first + tape.per * i
        if scene.compliance[i, 0] > 0.0:
            for b in range(len(which)):
                part = 0.0
                for j in range(n if scene.compliance[which[b], 0] > 0.0 else 0):
                    part += tape.numbers[row + j] * columns[2 * b, j]
                own += abs(part)
            rate = tape.numbers[row + 2 * n + 3]
            start = tape.numbers[row + 2 * n + 2] - 0.5 * h * rate
            stiffness, damping = scene.compliance[i]
            pads[a], biases[a] = compliant_row(stiffness, damping, own, start, rate, h, h)
        if is_coupling(scene, i):
            for j in range(n):
                pads[a] += tape.numbers[row + n + j] * columns[2 * a + 1, j]
            pads[a] = pads[a] if pads[a] > 0.0 else 1.0
    return pads, biases


@kernel
def force_duration(scene: StepConstants, tape: TapeValues, i: int, h: float) -> float:
    """Return how long the force of contact i, or of its rolling resistance, acts in a step."""
    contact = i if scene.carriers[i] < 0 else scene.carriers[i]
    if scene.compliance[contact, 0] == 0.0:
        return h
    row = tape.first + tape.per * contact + 2 * tape.size
    gap, rate = tape.numbers[row + 2], tape.numbers[row + 3]
    return time_in_contact(gap - 0.5 * h * rate, rate, h)


# Iterations of the loads of rolling resistances, and their relative tolerance. Each iteration
# reduces the change by length*dV/dM.
LOADINGS, LOADED = 40, 1e-10


@kernel
def coupling_loads(
    scene: StepConstants, which: Ints, columns: Array, free: Array, pushes: Array, h: float
) -> Array:
    """Return the factors (m,) of limits: h; for rolling resistance its contact's normal impulse.

    `columns` (2 m, s): see `unit_responses`; `free` (s,): changes of rates and constraint impulses
    without contacts; `pushes` (m, 2): contact impulses.
    """
    loads = np.full(len(which), h)
    for a in range(len(which)):
        carrier = scene.carriers[which[a]]
        if carrier < 0:
            continue
        loads[a] = 0.0
        for b in range(len(which)):
            if which[b] == carrier:
                loads[a] = max(pushes[b, 0], 0.0)
        if scene.bilateral[carrier] > 0:
            at = scene.size + scene.bilateral[:carrier].sum()
            load = free[at]
            for b in range(2 * len(which)):
                load += columns[b, at] * pushes[b // 2, b % 2]
            loads[a] = max(load, 0.0)
    return loads


@kernel
def load_couplings(
    scene: StepConstants, tape: TapeValues, which: Ints, loads: Array, pads: Array, free: Array
) -> float:
    """Write the static limits of couplings as loads of their pads; return the relative change.

    Their normal rows, which move only pads, then have these impulses as solutions, and a friction
    cone of coefficient 1 expresses the limit.
    """
    changed = 0.0
    for a in range(len(which)):
        if is_coupling(scene, which[a]):
            limit = tape.numbers[tape.first + tape.per * which[a] + 2 * tape.size + 2]
            before, free[a, 0] = free[a, 0], -pads[a] * loads[a] * limit
            if before != free[a, 0]:
                size = max(abs(before), abs(free[a, 0]))
                changed = max(changed, abs(free[a, 0] - before) / size)
    return changed


@kernel
def label_groups(scene: StepConstants, tape: TapeValues, chosen: Bools, groups: Ints) -> None:
    """Label chosen contacts, and constraints, by the first of their coupled group; others -1."""
    numbers, n, c, active = tape.numbers, tape.size, len(scene.bilateral), indices(chosen)
    constraints, joints, width = indices(scene.bilateral > 0), tape.first + tape.per * c, n + JOINT
    which = np.empty(len(active) + len(constraints), np.int64)
    for a in range(len(which)):
        which[a] = active[a] if a < len(active) else constraints[a - len(active)]
    labels = coupled_contacts(
        numbers[: n * n].reshape((n, n)),
        numbers[joints : joints + width * scene.joints].reshape((scene.joints, width)),
        numbers[tape.first : joints].reshape((c, tape.per)),
        which,
        scene.bilateral,
    )
    groups[:] = -1
    for a in range(len(which)):
        groups[which[a]] = which[labels[a]]


@kernel
def group_members(met: ContactRoles, label: int) -> Ints:
    """Return the active contacts with a label."""
    return indices((met.groups == label) & met.active)


@kernel
def write_cone(scene: StepConstants, tape: TapeValues, i: int, direction: int, cone: Array) -> None:
    """Write the unit cone edge (2,) of contact i that slips in a direction, or rests (0)."""
    copy_numbers(scene.cones[i], cone)
    if direction != 0 and (scene.coefficient_places[i] >= 0 or is_coupling(scene, i)):
        at = tape.first + tape.per * i + 2 * tape.size + (EDGES if direction > 0 else EDGES + 2)
        cone[0], cone[1] = tape.numbers[at], tape.numbers[at + 1]
        if cone[1] <= SUM_ROUNDING * cone[0]:
            cone[1] = 0.0


@kernel
def rebounds(scene: StepConstants, met: ContactRoles, i: int) -> bool:
    """Return whether contact i has an impact with restitution, which plastic groups have not."""
    rigid_count = 0
    for k in range(len(met.groups)):
        in_group = met.groups[k] == met.groups[i]
        rigid_count += 1 if in_group and not _is_finite(scene, k) else 0
    restores = met.hit[i] and scene.restitution[i] > 0.0
    return restores and not (scene.plastic and rigid_count > 1)


@kernel
def group_island(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    members: Ints, met: ContactRoles, h: float,
) -> tuple[Island, ContactRows, Array, Array]:  # fmt: skip
    """Return a coupled group as an island and its rows, their `unit_responses`, and pads.

    Removes restitution in plastic groups.
    """
    columns = unit_responses(tape, equations, members)
    pads, biases = normal_pads(scene, tape, members, columns, h)
    m, n, struck = len(members), tape.size, False
    island = new_island(members, met.before[members], met.free[members], np.zeros((m, 2)))
    jacobians, cones = np.empty((m, 2, n)), np.empty((m, 2))
    for a in range(m):
        i = members[a]
        row, slip = tape.first + tape.per * i, island.start[a, 1]
        for d in range(2):
            for j in range(n):
                jacobians[a, d, j] = tape.numbers[row + d * n + j]
        if abs(slip) > scene.round_off and (memory.slip[i] != 0.0 or not memory.closed[i]):
            island.slip_directions[a] = 1 if slip > 0.0 else -1
        write_cone(scene, tape, i, island.slip_directions[a], cones[a])
        if scene.coefficient_places[i] >= 0 or is_coupling(scene, i):
            island.kinds[a] = TWO if scene.coefficient_places[i] >= 0 else LIMIT
            for way in range(-1, 2):
                write_cone(scene, tape, i, way, island.frictions[a, way])
        island.rebounds[a] = rebounds(scene, met, i)
        if met.hit[i] and scene.restitution[i] > 0.0 and not island.rebounds[a]:
            met.bias[i, 0] = 0.0
        island.hit[a] = met.hit[i if scene.carriers[i] < 0 else scene.carriers[i]]
        struck = struck or island.hit[a]
        copy_numbers(memory.impulses[i], island.chosen[a])
    for a in range(m):
        copy_numbers(met.bias[members[a]], island.bias[a])
        if scene.compliance[members[a], 0] > 0.0:
            island.bias[a, 0] = biases[a]
        # The slip bias assumes the old rotation, which an impact changes.
        if struck:
            island.bias[a, 1] = 0.0
    loads = coupling_loads(scene, members, columns, equations.change, island.chosen, h)
    load_couplings(scene, tape, members, loads, pads, island.unforced)
    return island, coordinate_rows(jacobians, columns, pads, cones), columns, pads


@kernel
def time_to_touch(
    scene: StepConstants, tape: TapeValues, members: Ints, met: ContactRoles, h: float
) -> float:
    """Return the time to the last touch of a group; infinite if one did not begin within a step."""
    last = -math.inf
    for i in members:
        row = tape.first + tape.per * i + 2 * tape.size
        gap, nearing = tape.numbers[row + 2], -tape.numbers[row + 3]
        if scene.compliance[i, 0] > 0.0 or (met.hit[i] and abs(gap) >= h * nearing):
            return math.inf
        if met.hit[i]:
            last = max(last, gap / nearing)
    return last if last > -math.inf else math.inf


@kernel
def split_forces(
    scene: StepConstants, memory: ContactHistory, island: Island, contacts: ContactRows, k: int,
    chunk: Chunk,
) -> tuple[Array, Ints]:  # fmt: skip
    """Return the force part of impulses, and the modes; a jam becomes an impact.

    If friction presses an approaching sliding contact into its surface, no finite force keeps it
    there; one that would separate may also slide on. Impact and force together stay within the
    impulse.
    """
    pushes, least, after, hit = island.chosen, island.least, island.after, island.hit
    m, cones, under, slides = len(least), contacts.cones, after, np.zeros(len(least), np.bool_)
    modes = np.full(m, FREE)
    for a in range(m):
        i = island.members[a]
        # A sticking contact's slip is round-off.
        if scene.slips[i] > 0 and (memory.slip[i] != 0.0 or not memory.closed[i]):
            paradox = friction_presses(contacts.own[a], island.start[a, 1], cones[a])
            if paradox and least[a, 0] < 0.0 and not hit[a]:
                hit[a], chunk.stats[k, JAMMED] = True, i + 1
            clear = SUM_ROUNDING * (abs(island.start[a, 0]) + abs(island.unforced[a, 0]))
            # Other contacts' impulses would decide as well.
            if paradox and least[a, 0] > clear and memory.closed[i] and m == 1:
                chunk.stats[k, CHOSEN] = 1.0
    steady, struck = pushes.copy(), hit.any()
    if struck:
        fast = velocity_scale(contacts, least)
        steady = forces_without_impacts(contacts, hit, least, pushes, scene.impulse_tolerance, fast)
        under = np.empty_like(after)
        write_velocities(contacts, least, steady, under)
    for a in range(m):
        slides[a] = not hit[a] and is_sliding(cones[a], steady[a], under[a, 1])
        part = removable_share(pushes[a], steady[a], cones[a]) if struck else 1.0
        steady[a, 0] *= part
        steady[a, 1] *= part
    if struck:
        write_velocities(contacts, least, steady, under)
    for a in range(m):
        i, slip = island.members[a], under[a, 1]
        directed = scene.slips[i] == 2
        if is_coupling(scene, i):
            modes[a] = FREE if after[a, 1] != 0.0 else LOCKED
        elif steady[a, 0] > 0.0:
            modes[a] = mode_of_impulse(steady[a], after[a, 1], slides[a], cones[a], directed)
        elif pushes[a, 0] <= 0.0 and abs(under[a, 0]) <= scene.round_off:
            sliding = abs(slip) > scene.round_off
            modes[a] = mode_of_impulse(steady[a], slip, sliding, cones[a], directed)
    return steady, modes


@kernel
def energy_added(
    scene: StepConstants, tape: TapeValues, island: Island, contacts: ContactRows, rates: Array
) -> float:
    """Return the energy that contacts add to a group, relative to its kinetic energy.

    Impulses P with velocities U- before and U+ after a step change the energy by ``P (U+ + U-)/2``,
    besides the work of moving surfaces. Friction and restitution dissipate. The constraint of a
    turning surface or body returns in the second half step what it took in the first; a contact
    that lands on a surface that turns by a radian within the step took nothing before, and an
    impact there has a direction error of the same size, which counts as if it had landed.
    """
    n, gained, energy, had = tape.size, 0.0, 0.0, scene.min_energy
    moves = np.zeros(n, np.bool_)
    for a in range(len(island.members)):
        # The spring of a compliant contact returns energy.
        for d in range(1 if scene.compliance[island.members[a], 0] > 0.0 else 0, 2):
            change = island.after[a, d] - island.least[a, d]
            both = island.start[a, d] + island.unforced[a, d] + change
            gained += island.chosen[a, d] * both
        speed = max(math.hypot(island.start[a, 0], island.start[a, 1]), scene.min_speed)
        own = contacts.own[a, 0]
        if scene.compliance[island.members[a], 0] > 0.0:
            # The compliance of the pad would hide the mass of the contact.
            own = 0.0
            for j in range(n):
                own += contacts.rows[a, 0, j] * contacts.columns[a, 0, j]
        if own > 0.0:
            had = max(had, speed * speed / own)
        for j in range(n):
            moves[j] = moves[j] or contacts.rows[a, 0, j] != 0.0 or contacts.rows[a, 1, j] != 0.0
    for i in range(n):
        for j in range(n if moves[i] else 0):
            energy += rates[i] * tape.numbers[n * i + j] * rates[j]
    return max(gained, 0.0) / max(had, energy)


@kernel
def is_mixed_with_impacts(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, island: Island, h: float
) -> bool:
    """Return whether impulses of a group in this step include impacts."""
    lands = holds = False
    for a in range(len(island.members)):
        i, nearing = island.members[a], -island.start[a, 0]
        late = _NEGLIGIBLE_LANDING * abs(island.unforced[a, 0] + nearing)
        bias = 0.5 * h * tape.numbers[tape.first + tape.per * i + 2 * tape.size]
        arrives = nearing > late or abs(island.bias[a, 0] - bias) > late
        arrives = arrives and not memory.closed[i] and not scene.compliance[i, 0] > 0.0
        lands = lands or (island.chosen[a, 0] > 0.0 and (island.hit[a] or arrives))
    for i in island.members:
        if lands:
            memory.landing_steps[i], memory.settling[i] = HOLDING, LANDED
        holds = holds or memory.landing_steps[i] > 0
    return holds


@kernel
def coupling_mode(scene: StepConstants, i: int, slip: float, modes: Ints) -> int:
    """Return the mode of a coupling that is not open; rolling resistance follows its contact.

    `modes` (c,) are those of contacts.
    """
    carrier = scene.carriers[i]
    if carrier >= 0 and scene.bilateral[carrier] == 0 and modes[carrier] in (FREE, OFF_CODE):
        return FREE
    if slip == 0.0:
        return LOCKED
    return SLIP_PLUS if slip > 0.0 else SLIP_MINUS


# Round-off of gaps, relative to their tolerance. Slips that pass zero slowly are larger.
_GAP_ROUNDING = 1e-4


@kernel
def clear_round_off(scene: StepConstants, island: Island, contacts: ContactRows, h: float) -> None:
    """Clear coupling slips that are round-off of speeds or of the gaps of loaded contacts."""
    for a in range(len(island.members)):
        coupled, widest = is_coupling(scene, island.members[a]), scene.gap_tolerance / h
        slip = scene.round_off if coupled else 0.0
        for b in range(len(island.members) if coupled else 0):
            if island.chosen[b, 0] > 0.0 and not _is_finite(scene, island.members[b]):
                turned = 0.0
                for k in range(contacts.rows.shape[2]):
                    turned += contacts.rows[a, 1, k] * contacts.columns[b, 0, k]
                blurred = min(abs(island.after[b, 0]) + _GAP_ROUNDING * widest, widest)
                slip += abs(turned) / contacts.own[b, 0] * blurred
        if abs(island.after[a, 1]) <= slip:
            island.after[a, 1] = 0.0


@kernel
def write_modes(
    scene: StepConstants, memory: ContactHistory, island: Island, contacts: ContactRows,
    steady: Array, met: ContactRoles, k: int, chunk: Chunk,
) -> None:  # fmt: skip
    """Write the modes and impulses of step k, and the contact history."""
    cones, pushes, struck = contacts.cones, island.chosen, island.hit.any()
    used_at = scene.size + scene.joints + 2 * len(scene.cones)
    for a in range(len(pushes)):
        i, slip = island.members[a], island.after[a, 1]
        copy_numbers(pushes[a], memory.impulses[i])
        memory.slip[i] = slip
        if is_coupling(scene, i):
            memory.closed[i] = True
            chunk.codes[k, i] = coupling_mode(scene, i, slip, chunk.codes[k])
            if scene.carriers[i] >= 0:
                at = scene.joints + i - len(scene.cones)
                chunk.joint_impulses[k, at + scene.couplings] = pushes[a, 1] - steady[a, 1]
            continue
        if struck:
            for d in range(2):
                chunk.impulses[k, i, d] = pushes[a, d] - steady[a, d]
            copy_numbers(project_into_cone(chunk.impulses[k, i], cones[a]), chunk.impulses[k, i])
        pressed = pushes[a, 0] > 0.0
        if scene.coefficient_places[i] >= 0:
            mu = cones[a, 1] / cones[a, 0] if cones[a, 0] > 0.0 else math.inf
            chunk.solved[k, used_at + scene.coefficient_places[i]] = mu
        distant = not met.hit[i] and not memory.closed[i] and not scene.compliance[i, 0] > 0.0
        if pressed and distant:
            chunk.closing[k] = max(chunk.closing[k], chunk.gaps[k, i] - memory.target_gap[i])
        # A contact that another one's impulse stops counts as struck.
        chunk.struck[k, i] = island.hit[a] and (
            pressed or (met.hit[i] and island.after[a, 0] == 0.0)
        )
        if chunk.struck[k, i] and not met.hit[i]:
            # A jamming contact moves freely until its impact at mid-step.
            falling = -0.5 * (island.start[a, 0] + island.unforced[a, 0])
            chunk.approach[k] = max(chunk.approach[k], falling)
        memory.closed[i] = pressed and not island.rebounds[a]
        if memory.closed[i]:
            sliding = is_sliding(cones[a], pushes[a], slip)
            directed = scene.slips[i] == 2
            chunk.codes[k, i] = mode_of_impulse(pushes[a], slip, sliding, cones[a], directed)
            # The slip of a pinned contact is the residual of the impulses.
            memory.slip[i] = 0.0 if chunk.codes[k, i] == PIN else slip


@kernel
def impact_order_matters(
    scene: StepConstants, island: Island, contacts: ContactRows, k: int, chunk: Chunk
) -> bool:
    """Return whether sequential impacts in step k would have another outcome."""
    lively = np.zeros(len(island.members), np.bool_)
    for a in range(len(lively)):
        i = island.members[a]
        slow = max(SLOW * abs(island.unforced[a, 0] - island.start[a, 0]), scene.speed_tolerance)
        sudden = contacts.own[a, 0] * chunk.impulses[k, i, 0]
        lively[a] = scene.restitution[i] >= LIVELY and sudden > slow
    impulses = chunk.impulses[k][island.members]
    return scene.capped and order_matters(contacts, scene.pairs[island.members], lively, impulses)


@kernel
def _add_multiple(other: Array, factor: float, row: Array, sizes: Array) -> None:
    """Add a multiple of another row to a row, and the sizes of the terms to `sizes`."""
    for j in range(len(other)):
        row[j] += factor * other[j]
        sizes[j] += abs(factor * other[j])


@kernel
def free_rows(
    scene: StepConstants, tape: TapeValues, contacts: ContactRows, columns: Array
) -> Array:
    """Return the rows of contacts without the part that joints and bilateral contacts bear.

    J + L G, with the rows G of joints and bilateral contacts, and their impulses L per unit impulse
    of a contact: `columns` from n on. Entries up to ``CANCELLING r c`` are zero, with the largest
    terms c of their coordinate, and the largest r of their row relative to these.
    """
    n, rows = tape.size, contacts.rows
    if columns.shape[1] == n:
        return rows
    rows, sizes, largest = rows.copy(), np.abs(rows), np.zeros(n)
    for a in range(len(rows)):
        for d in range(2):
            at = n
            for i in range(len(scene.bilateral)):
                row = tape.first + tape.per * i
                for e in range(scene.bilateral[i]):
                    bears = tape.numbers[row + e * n : row + (e + 1) * n]
                    _add_multiple(bears, columns[2 * a + d, at], rows[a, d], sizes[a, d])
                    at += 1
            for i in range(scene.joints):
                # The impulse of a joint that is off is zero.
                row = tape.first + tape.per * len(scene.bilateral) + (n + JOINT) * i
                bears = tape.numbers[row : row + n]
                _add_multiple(bears, columns[2 * a + d, at + i], rows[a, d], sizes[a, d])
            for j in range(n):
                largest[j] = max(largest[j], sizes[a, d, j])
    for a in range(len(rows)):
        for d in range(2):
            part = 0.0
            for j in range(n):
                part = max(part, sizes[a, d, j] / largest[j] if largest[j] > 0.0 else 0.0)
            for j in range(n):
                if abs(rows[a, d, j]) <= CANCELLING * part * largest[j]:
                    rows[a, d, j] = 0.0
    return rows


@kernel
def share_loads(scene: StepConstants, island: Island, rows: Array, cones: Array) -> None:
    """Share undetermined impulses among all touching contacts, in place; see `free_rows`."""
    m, pushes = len(island.members), island.chosen
    modes = np.full(m, FREE)
    for a in range(m):
        if m < 2 or _is_finite(scene, island.members[a]):
            return
        slip, directed = island.after[a, 1], scene.slips[island.members[a]] == 2
        if pushes[a, 0] > 0.0 or abs(island.after[a, 0]) <= scene.round_off:
            sliding = abs(slip) > scene.round_off
            sliding = sliding and (pushes[a, 0] <= 0.0 or is_sliding(cones[a], pushes[a], slip))
            modes[a] = mode_of_impulse(pushes[a], slip, sliding, cones[a], directed)
    copy_rows(shared_forces(modes, cones, rows, pushes)[1], pushes)


@kernel
def share_forces(
    scene: StepConstants, island: Island, rows: Array, cones: Array, modes: Ints, steady: Array
) -> tuple[Bools, Array]:
    """Return the contacts with undetermined forces, and the forces, shared; see `free_rows`."""
    for i in island.members:
        # Compliance determines the load sharing.
        if len(steady) < 2 or scene.compliance[i, 0] > 0.0:
            return np.zeros(len(steady), np.bool_), steady
    return shared_forces(modes, cones, rows, steady)


@kernel
def clear_contacts(scene: StepConstants, off: Bools, before: int, k: int, chunk: Chunk) -> None:
    """Clear modes, impulses and forces of contacts in step k; forces begin at `before`."""
    for i in range(len(off)):
        none = OPEN_CODE if is_coupling(scene, i) else OFF_CODE
        chunk.codes[k, i] = none if off[i] else FREE
        chunk.struck[k, i] = chunk.shared[k, i] = False
        for d in range(2):
            chunk.impulses[k, i, d] = 0.0
            chunk.solved[k, before + 2 * i + d] = 0.0
