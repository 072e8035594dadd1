"""Active contacts of a step of a scene on tape, their impulses, modes and forces.

Moreau's midpoint rule: all impulses of a step are those of one contact problem in its middle.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_rows import BEGINS, ON_TRIAL, overload
from contacts.solvers.impulse_coupling import coupled_contacts
from contacts.solvers.redundancy import shared_forces
from contacts.solvers.step_impulses import (
    SUM_ROUNDING,
    ContactProblem,
    into_cone,
    is_sliding,
    of_group,
    steady_impulses,
    velocity_after,
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
    HIT,
    LASTING,
    LIVELY,
    SEPARATED,
    SLOW,
    TIME_MARGIN,
    Chunk,
    arriving,
)
from contacts.time_stepping.equations import (
    EDGES,
    HOLDING,
    JOINT,
    LANDED,
    ContactForces,
    ContactHistory,
    ContactRoles,
    FactoredEquations,
    StepConstants,
    TapeValues,
    is_coupling,
    solve_factored,
)
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices, put
from statechart.kernels.jit import kernel


@kernel
def energy_added(
    numbers: Array,
    rates: Array,
    rows: Ints,
    groups: Ints,
    work: Array,
    moving: Array,
    negligible: float,
) -> float:
    """Return the largest part of its own energy that contacts add to a group of them.

    With velocities U- before a step and U+ after it, impulses P change the energy by
    ``P (U+ + U-)/2``, beside what surfaces do that move. Friction and restitution take energy. What
    keeps a contact on its surface, while the surface or the body turns, gives in its second half
    what it took in its first; a contact that lands where the surface turns by a radian within the
    step has taken nothing before. One that is struck there is struck in a direction that is as far
    off: what it would add had it landed counts for it as well.

    Parameters
    ----------
    numbers : (k,) array
        Of the step's tape, beginning with the mass matrix (n, n).
    rates : (n,) array
        Before the step.
    rows : (m,) array of int
        Where the Jacobians of contacts are among the numbers.
    groups : (m,) array of int
        Equal for contacts that feel each other's impulses; below m.
    work : (m,) array
        P (U+ + U-) of contacts.
    moving : (m,) array
        Twice the energy that they move with at least.
    negligible : float
        Twice the energy that is none.
    """
    n, worst = len(rates), 0.0
    moved = np.empty(n, np.bool_)
    for group in range(len(groups)):
        gained, had, kinetic = 0.0, 0.0, 0.0
        moved[:] = False
        for a in range(len(rows)):
            if groups[a] != group:
                continue
            gained += work[a]
            had = max(had, moving[a])
            for j in range(n):
                hold = numbers[rows[a] + j] != 0.0 or numbers[rows[a] + n + j] != 0.0
                moved[j] = moved[j] or hold
        if gained <= 0.0:
            continue
        for i in range(n):
            if moved[i]:
                for j in range(n):
                    kinetic += rates[i] * numbers[n * i + j] * rates[j]
        worst = max(worst, gained / max(had, kinetic, negligible))
    return worst


@kernel
def mode_of_impulse(impulse: Array, slip: float, sliding: bool, cone: Array, directed: bool) -> int:
    """Return the number of the mode of a contact that bears an impulse.

    Parameters
    ----------
    impulse : (2,)
    slip : float
        After the step.
    sliding : bool
        Whether it slips under friction.
    cone : (2,)
    directed : bool
        Whether its slides have a direction, whatever the friction.
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
def pressing(compliance: Array, slip: float, cone: Array) -> bool:
    """Return whether friction presses a sliding contact into its surface (Painleve's paradox)."""
    against = -cone[1] if slip > 0.0 else cone[1]
    return slip != 0.0 and compliance[0, 0] * cone[0] + compliance[0, 1] * against <= 0.0


# Directions are opposite to within this part of their size.
_OPPOSITE = 1e-9
# By so much more than the lever of a landing says, a gap is left: gaps bend.
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
        if memory.off[i] or met.hit[i] or scene.held[i] > 0 or not gap > 0.0:
            continue
        for other in range(len(scene.cones)):
            left = tape.numbers[tape.first + tape.per * other + 2 * n + 2]
            lasts = met.active[other] and not met.hit[other]
            if not lasts or memory.level[other] >= -scene.near:
                continue
            lever = _opposing_lever(tape, i, other)
            if lever > 0.0 and gap <= scene.near - _BENT * lever * left:
                # Kept where the other is, neither is asked to part by what the other is not.
                met.active[i], memory.closed[i] = True, True
                memory.level[i] = -lever * memory.level[other]
                above = gap + lever * memory.level[other]
                met.wanted[i, 0] = above / h + 0.5 * h * tape.numbers[row + 2 * n]
                met.wanted[i, 1] = 0.5 * h * tape.numbers[row + 2 * n + 1]
                break


@kernel
def _opposing_lever(tape: TapeValues, i: int, other: int) -> float:
    """Return how far contact `i` closes where `other` opens by 1; 0 where they do not face."""
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


# Another impact that changes a velocity by less than this part of its own change is not felt: a
# body turns within a step.
_NEGLIGIBLE_CHANGE = 1e-3
# A contact that lands slower than this part of what a step without contact would make of rest
# brings no momentum that forces would tell.
_NEGLIGIBLE_LANDING = 1e-9


@kernel
def _slow(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, met: ContactRoles, i: int,
    h: float,
) -> float:  # fmt: skip
    """Return the approach velocity up to which a contact lasts, see `SLOW`.

    A contact that has just rebounded comes back by turning as well: else it would at every step.
    """
    change = met.free[i, 0] - met.before[i, 0]
    slow = abs(change)
    if memory.fresh[i] > 0:
        row = tape.first + tape.per * i
        slow = max(slow, abs(change + h * tape.numbers[row + 2 * tape.size]))
    return max(SLOW * slow, scene.still)


@kernel
def find_active(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, change: Array, k: int,
    met: ContactRoles, chunk: Chunk,
) -> None:  # fmt: skip
    """Write which contacts take part in step k.

    Without contacts the step changes the rates by `change`.
    """
    numbers, n, off, level, h = tape.numbers, tape.size, memory.off, memory.level, chunk.h
    for i in range(len(scene.cones)):
        row = tape.first + tape.per * i
        gap = numbers[row + 2 * n + 2]
        met.active[i] = met.hit[i] = False
        if scene.held[i] > 0 or off[i]:
            continue
        before, free = met.before[i], met.free[i]
        for d in range(2):
            before[d] = free[d] = numbers[row + 2 * n + 3 + d]
            for j in range(n):
                free[d] += numbers[row + d * n + j] * change[j]
        if is_coupling(scene, i):
            met.active[i], met.wanted[i, 1] = True, 0.5 * h * numbers[row + 2 * n + 1]
            continue
        if scene.soft[i, 0] > 0.0:
            # Implicit Euler: h times the force at the gap at the start plus h times the rate at
            # the end, never below 0. It takes energy from steps longer than a contact lasts.
            start = gap - 0.5 * h * before[0]
            met.active[i] = min(start, gap) <= 0.0
            met.wanted[i, 0] = h * scene.soft[i, 0] * start / _yielding(scene, i, h)
            met.wanted[i, 1] = 0.5 * h * numbers[row + 2 * n + 1]
            continue
        nearing, slow = -before[0], _slow(scene, memory, tape, met, i, h)
        bias = 0.5 * h * numbers[row + 2 * n]
        closing, reached = h * (slow - (free[0] + bias)), TIME_MARGIN * h * nearing
        role, level[i], above = arriving(
            gap, level[i], memory.closed[i], nearing, slow, closing, reached, scene.near
        )
        met.active[i], met.hit[i] = role != SEPARATED, role == HIT
        if role == LASTING:
            met.wanted[i, 0] = above / h + bias
            if abs(free[0] + met.wanted[i, 0]) <= scene.rounding:
                # Bodies that fall side by side do not press each other.
                met.wanted[i, 0] = -free[0]
            met.wanted[i, 1] = 0.5 * h * numbers[row + 2 * n + 1]
            # Between its middles a step is as deep as turning makes it.
            chunk.approach[k] = max(chunk.approach[k], 2.0 * abs(bias))
        elif role == HIT:
            # The direction it is hit in is as far off as it turns within the step.
            speed = max(math.hypot(before[0], before[1]), scene.slowest)
            chunk.gained[k] = max(chunk.gained[k], (bias / speed) ** 2)
            met.wanted[i, 0] = -scene.restitution[i] * nearing
            chunk.approach[k] = max(chunk.approach[k], nearing)
            chunk.closing[k] = max(chunk.closing[k], -gap)


@kernel
def _yielding(scene: StepConstants, i: int, h: float) -> float:
    """Return the impulse per velocity of a compliant contact in a step, implicitly."""
    found: float = h * (h * scene.soft[i, 0] + scene.soft[i, 1])
    return found


@kernel
def _is_alone(groups: Ints, a: int, without: Bools) -> bool:
    """Return whether a contact is the only one of its group, but for the first ones `without`."""
    alone = True
    for b in range(len(groups)):
        left_out = b < len(without) and without[b]
        alone = alone and (b == a or left_out or groups[b] != groups[a])
    return alone


@kernel
def unit_responses(tape: TapeValues, equations: FactoredEquations, which: Ints) -> Array:
    """Return what unit impulses of contacts do to all that moves (2 m, s)."""
    n, moving = tape.size, len(equations.order)
    columns, push = np.zeros((2 * len(which), moving)), np.zeros(moving)
    for a in range(len(which)):
        row = tape.first + tape.per * which[a]
        for d in range(2):
            for j in range(n):
                push[j] = tape.numbers[row + d * n + j]
            put(solve_factored(equations.factors, equations.order, push), columns[2 * a + d])
    return columns


@kernel
def delassus_of(tape: TapeValues, which: Ints, columns: Array) -> Array:
    """Return what unit impulses of contacts do to their velocities."""
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


# Rolling resistances are loaded so often, and until none changes by more than this part of itself.
# Each time leaves the part length*dV/dM of the change.
LOADINGS, LOADED = 40, 1e-10


@kernel
def coupling_loads(
    scene: StepConstants, which: Ints, columns: Array, free: Array, pushes: Array, h: float
) -> Array:
    """Return the factors (m,) of limits: h; of rolling resistance, its contact's normal impulse.

    Parameters
    ----------
    which : (m,) array of int
    columns : (2 m, s) array
        See `unit_responses`.
    free : (s,) array
        Changes of the rates, and impulses of constraints, without those of contacts.
    pushes : (m, 2) array
        Impulses of contacts.
    h : float
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
        if scene.held[carrier] > 0:
            at = scene.size + scene.held[:carrier].sum()
            load = free[at]
            for b in range(2 * len(which)):
                load += columns[b, at] * pushes[b // 2, b % 2]
            loads[a] = max(load, 0.0)
    return loads


@kernel
def load_couplings(
    scene: StepConstants, tape: TapeValues, which: Ints, loads: Array, delassus: Array, free: Array
) -> float:
    """Load couplings, in place, with the impulses of their limits at rest; return what changed.

    So their normal rows, which move nothing, have these impulses as their solution, and what is in
    the cone of friction 1 is within the limit. The change is the largest, in parts of the impulse.
    """
    changed = 0.0
    for a in range(len(which)):
        if is_coupling(scene, which[a]):
            # Of the size of velocities, as the other rows.
            own = delassus[2 * a + 1, 2 * a + 1]
            delassus[2 * a, 2 * a] = own if own > 0.0 else 1.0
            limit = tape.numbers[tape.first + tape.per * which[a] + 2 * tape.size + 2]
            before, free[a, 0] = free[a, 0], -delassus[2 * a, 2 * a] * loads[a] * limit
            if before != free[a, 0]:
                size = max(abs(before), abs(free[a, 0]))
                changed = max(changed, abs(free[a, 0] - before) / size)
    return changed


@kernel
def _has_two(scene: StepConstants, i: int) -> bool:
    """Return whether a contact has a friction at rest and another in motion."""
    return scene.used[i] >= 0 or is_coupling(scene, i)


@kernel
def _groups(scene: StepConstants, tape: TapeValues, which: Ints) -> Ints:
    """Label the groups of the contacts `which` (m,), then those of constraints."""
    numbers, n, c, m = tape.numbers, tape.size, len(scene.held), len(which)
    constraints = indices(scene.held > 0)
    members = np.empty(m + len(constraints), np.int64)
    for a in range(len(members)):
        members[a] = which[a] if a < m else constraints[a - m]
    joints, width = tape.first + tape.per * c, n + JOINT
    return coupled_contacts(
        numbers[: n * n].reshape((n, n)),
        numbers[joints : joints + width * scene.joints].reshape((scene.joints, width)),
        numbers[tape.first : joints].reshape((c, tape.per)),
        members,
        scene.held,
    )


@kernel
def write_cone(scene: StepConstants, tape: TapeValues, i: int, direction: int, cone: Array) -> None:
    """Write the unit edge (2,) of the friction cone of contact i that slips, or rests (0)."""
    put(scene.cones[i], cone)
    if direction != 0 and _has_two(scene, i):
        at = tape.first + tape.per * i + 2 * tape.size + (EDGES if direction > 0 else EDGES + 2)
        cone[0], cone[1] = tape.numbers[at], tape.numbers[at + 1]
        if cone[1] <= SUM_ROUNDING * cone[0]:
            cone[1] = 0.0


@kernel
def change_friction(
    scene: StepConstants, tape: TapeValues, problem: ContactProblem, least: Array, pushes: Array
) -> bool:
    """Change the friction of contacts whose slip begins or turns; return whether there are.

    A slip that would turn in the step stops if static friction bears what would hold it over the
    whole step; in an impact kinetic friction stops or turns it. What static friction does not hold
    slips under kinetic friction: what slipped before the step first, then one by one the most
    overloaded, as each relieves the others. Each contact changes three times at most.
    """
    ways, first, most, way, changes = problem.directions, -1, 0.0, 0, False
    for a in range(len(ways)):
        i, normal = problem.which[a], pushes[a, 0]
        slip = velocity_after(problem.delassus, least, pushes, a, 1)
        judged = _has_two(scene, i) and abs(ways[a]) != BEGINS and normal > 0.0
        if not judged or slip == 0.0 or (abs(ways[a]) == 1 and slip * ways[a] > 0.0):
            continue
        turned = BEGINS if slip > 0.0 else -BEGINS
        if abs(ways[a]) == 1:
            struck = of_group(problem.sudden, problem.groups, problem.groups[a])
            ways[a], changes = turned if struck and scene.used[i] >= 0 else 0, True
            write_cone(scene, tape, i, ways[a], problem.cones[a])
            if not struck:
                ways[a] = ON_TRIAL
                problem.wanted[a, 1] -= problem.before[a, 1]
            continue
        load = overload(slip, problem.delassus[2 * a + 1, 2 * a + 1], normal, problem.cones[a])
        if abs(problem.before[a, 1]) > scene.rounding:
            load = math.inf
        if load > most:
            first, most, way = a, load, turned
    if changes:
        return True
    for a in range(len(ways)):
        if ways[a] == ON_TRIAL and first in (a, -1):
            ways[a], changes = 0, True
            problem.wanted[a, 1] += problem.before[a, 1]
    if first >= 0:
        ways[first], changes = way, True
        write_cone(scene, tape, problem.which[first], way, problem.cones[first])
    return changes


@kernel
def contact_problem(
    scene: StepConstants, memory: ContactHistory, tape: TapeValues, equations: FactoredEquations,
    which: Ints, met: ContactRoles, h: float,
) -> ContactProblem:  # fmt: skip
    """Return the problem of the contacts that take part; `met` loses rebounds of plastic groups."""
    m = len(which)
    columns = unit_responses(tape, equations, which)
    delassus, jacobians = delassus_of(tape, which, columns), np.empty((m, 2, tape.size))
    groups = _groups(scene, tape, which)
    cones, before = np.empty((m, 2)), np.empty((m, 2))
    free, wanted = np.empty((m, 2)), np.empty((m, 2))
    rebounds, sudden = np.empty(m, np.bool_), np.empty(m, np.bool_)
    directions = np.zeros(m, np.int64)
    yields, apart = np.empty(m, np.bool_), np.empty(m, np.bool_)
    for a in range(m):
        i = which[a]
        row = tape.first + tape.per * i
        for d in range(2):
            for j in range(tape.size):
                jacobians[a, d, j] = tape.numbers[row + d * tape.size + j]
        slip = met.before[i, 1]
        if abs(slip) > scene.rounding and (memory.slid[i] or not memory.closed[i]):
            directions[a] = 1 if slip > 0.0 else -1
        rebounds[a], sudden[a] = met.hit[i] and scene.restitution[i] > 0.0, met.hit[i]
        if scene.carriers[i] >= 0:
            sudden[a] = met.hit[scene.carriers[i]]
        write_cone(scene, tape, i, directions[a], cones[a])
        put(met.before[i], before[a])
        put(met.free[i], free[a])
        yields[a] = scene.soft[i, 0] > 0.0
        apart[a] = yields[a] or is_coupling(scene, i)
        if yields[a]:
            delassus[2 * a, 2 * a] += 1.0 / _yielding(scene, i, h)
    loads = coupling_loads(scene, which, columns, equations.change, np.zeros((m, 2)), h)
    load_couplings(scene, tape, which, loads, delassus, free)
    for a in range(m):
        # Couples and compliant forces are finite: no impact is simultaneous with them.
        if scene.plastic and rebounds[a] and not _is_alone(groups, a, apart):
            rebounds[a], met.wanted[which[a], 0] = False, 0.0
        put(met.wanted[which[a]], wanted[a])
        # After an impact bodies turn otherwise than they did: no slip is left to what they did.
        if of_group(sudden, groups[:m], groups[a]):
            wanted[a, 1] = 0.0
    return ContactProblem(
        which, jacobians, columns, delassus, groups[:m], directions, cones, before, free, wanted,
        rebounds, sudden, yields, apart,
    )  # fmt: skip


@kernel
def split_forces(
    scene: StepConstants, memory: ContactHistory, problem: ContactProblem, least: Array,
    pushes: Array, allowed: float,
) -> ContactForces:  # fmt: skip
    """Return what of impulses is force; what jams is struck at an instant.

    Where friction presses a sliding contact into its surface no finite force keeps one there that
    would go in; one that would come off may as well slide on.
    """
    delassus, sudden, several, jammed = problem.delassus, problem.sudden, False, 0
    for a in range(len(problem.which)):
        i = problem.which[a]
        corner, slip = delassus[2 * a : 2 * a + 2, 2 * a : 2 * a + 2], problem.before[a, 1]
        # Where it stuck, its slip is rounding.
        if scene.slips[i] > 0 and (memory.slid[i] or not memory.closed[i]):
            paradox = pressing(corner, slip, problem.cones[a])
            if paradox and least[a, 0] < 0.0 and not sudden[a]:
                sudden[a], jammed = True, i + 1
            clear = SUM_ROUNDING * (abs(problem.before[a, 0]) + abs(problem.free[a, 0]))
            # The impulses of others decide, too, where there are others.
            off = least[a, 0] > clear and memory.closed[i]
            off = off and _is_alone(problem.groups, a, np.zeros(0, np.bool_))
            several = several or (paradox and off)
    steady, slides = steady_impulses(problem, least, pushes, allowed)
    return ContactForces(least, pushes, steady, slides, several, jammed)


@kernel
def largest_energy_gain(
    scene: StepConstants, tape: TapeValues, problem: ContactProblem, pushes: Array, rates: Array
) -> float:
    """Return the largest part of its own energy that contacts add to a group of them."""
    m, delassus = len(problem.which), problem.delassus
    work, moving, rows = np.empty(m), np.empty(m), np.empty(m, np.int64)
    for a in range(m):
        work[a], rows[a] = 0.0, tape.first + tape.per * problem.which[a]
        # The spring of a compliant contact gives energy back.
        for d in range(1 if problem.yields[a] else 0, 2):
            both = problem.before[a, d] + problem.free[a, d]
            for b in range(2 * m):
                both += delassus[2 * a + d, b] * pushes[b // 2, b % 2]
            work[a] += pushes[a, d] * both
        speed = max(math.hypot(problem.before[a, 0], problem.before[a, 1]), scene.slowest)
        moving[a] = speed * speed / delassus[2 * a, 2 * a]
    return energy_added(tape.numbers, rates, rows, problem.groups, work, moving, scene.negligible)


@kernel
def mixed_with_impacts(
    memory: ContactHistory, tape: TapeValues, problem: ContactProblem, pushes: Array, h: float
) -> Bools:
    """Return whose impulses (m,) of this step are not those of forces alone."""
    which, groups, m = problem.which, problem.groups, len(problem.which)
    mixed = np.zeros(m, np.bool_)
    for a in range(m):
        i, nearing = which[a], -problem.before[a, 0]
        late = _NEGLIGIBLE_LANDING * abs(problem.free[a, 0] + nearing)
        bias = 0.5 * h * tape.numbers[tape.first + tape.per * i + 2 * tape.size]
        arrives = nearing > late or abs(problem.wanted[a, 0] - bias) > late
        arrives = arrives and not problem.yields[a]
        if pushes[a, 0] > 0.0 and (problem.sudden[a] or (not memory.closed[i] and arrives)):
            for b in range(m):
                if groups[b] == groups[a]:
                    memory.fresh[which[b]] = HOLDING
                    memory.settling[which[b]] = LANDED
    for a in range(m):
        if memory.fresh[which[a]] > 0:
            for b in range(m):
                mixed[b] = mixed[b] or groups[b] == groups[a]
    return mixed


@kernel
def coupling_mode(scene: StepConstants, i: int, slip: float, modes: Ints) -> int:
    """Return the mode of a coupling that is not open: that of rolling resistance is its contact's.

    `modes` (c,) are those of contacts.
    """
    carrier = scene.carriers[i]
    if carrier >= 0 and scene.held[carrier] == 0 and modes[carrier] in (FREE, OFF_CODE):
        return FREE
    if slip == 0.0:
        return LOCKED
    return SLIP_PLUS if slip > 0.0 else SLIP_MINUS


@kernel
def _round_off(
    scene: StepConstants, problem: ContactProblem, pushes: Array, a: int, h: float
) -> float:
    """Return the slip of coupling `a` that round-off of the gaps of contacts that press makes."""
    most, delassus, groups = 0.0, problem.delassus, problem.groups
    for b in range(len(groups)):
        if groups[b] == groups[a] and pushes[b, 0] > 0.0 and not problem.apart[b]:
            most = max(most, abs(delassus[2 * a + 1, 2 * b]) / delassus[2 * b, 2 * b])
    found: float = most * scene.near / h
    return found


@kernel
def write_modes(
    scene: StepConstants, memory: ContactHistory, problem: ContactProblem, answer: ContactForces,
    met: ContactRoles, k: int, chunk: Chunk,
) -> Ints:  # fmt: skip
    """Write modes and impulses of step k, and who lasts; return the modes (m,) under forces."""
    m, sudden, cones = len(problem.which), problem.sudden, problem.cones
    pushes, steady = answer.pushes, answer.steady
    modes = np.full(m, FREE)
    used_at = scene.size + scene.joints + 2 * len(scene.cones)
    for a in range(m):
        i = problem.which[a]
        put(pushes[a], memory.pushes[i])
        slip = velocity_after(problem.delassus, answer.least, pushes, a, 1)
        if is_coupling(scene, i) and abs(slip) <= _round_off(scene, problem, pushes, a, chunk.h):
            slip = 0.0
        memory.slid[i] = slip != 0.0
        if is_coupling(scene, i):
            memory.closed[i] = True
            modes[a] = FREE if slip != 0.0 else LOCKED
            chunk.codes[k, i] = coupling_mode(scene, i, slip, chunk.codes[k])
            continue
        if of_group(sudden, problem.groups, problem.groups[a]):
            for d in range(2):
                chunk.impulses[k, i, d] = pushes[a, d] - steady[a, d]
            put(into_cone(chunk.impulses[k, i], cones[a]), chunk.impulses[k, i])
        pressed, directed = pushes[a, 0] > 0.0, scene.slips[i] == 2
        if scene.used[i] >= 0:
            mu = cones[a, 1] / cones[a, 0] if cones[a, 0] > 0.0 else math.inf
            chunk.solved[k, used_at + scene.used[i]] = mu
        if pressed and not met.hit[i] and not memory.closed[i]:
            chunk.closing[k] = max(chunk.closing[k], chunk.gaps[k, i] - memory.level[i])
        # What another contact's impulse stops as its own would is struck, too.
        met_alike = met.hit[i] and velocity_after(problem.delassus, answer.least, pushes, a, 0) == 0
        chunk.struck[k, i] = sudden[a] and (pressed or met_alike)
        if chunk.struck[k, i] and not met.hit[i]:
            # A jamming contact falls freely up to the middle of the step, where it is struck.
            falling = -0.5 * (problem.before[a, 0] + problem.free[a, 0])
            chunk.approach[k] = max(chunk.approach[k], falling)
        memory.closed[i] = pressed and not problem.rebounds[a]
        if memory.closed[i]:
            chunk.codes[k, i] = mode_of_impulse(
                pushes[a], slip, is_sliding(problem, answer.least, pushes, a), cones[a], directed
            )
        if steady[a, 0] > 0.0:
            modes[a] = mode_of_impulse(steady[a], slip, answer.slides[a], cones[a], directed)
        elif not pressed and velocity_after(problem.delassus, answer.least, steady, a, 0) == 0.0:
            slip = velocity_after(problem.delassus, answer.least, steady, a, 1)
            modes[a] = mode_of_impulse(steady[a], slip, slip != 0.0, cones[a], directed)
    return modes


@kernel
def coupled_order_matters(
    bodies: Ints, pairs: Ints, lively: Bools, delassus: Array, cones: Array, impulses: Array
) -> bool:
    """Return whether a body is struck at once at contacts whose impacts change each other.

    `bodies`, `pairs`, `lively`: bodies (m, 2) of contacts, which pairs of them touch, and whose
    impacts are `LIVELY`; `delassus` (2 m, 2 m), `cones` (m, 2), `impulses` (m, 2): of the step's
    contact problem.
    """
    for a in range(len(pairs)):
        for b in range(len(pairs)):
            if lively[a] and lively[b] and pairs[a] != pairs[b]:
                for d in range(2 if cones[b, 1] > 0.0 else 1):
                    own = abs(delassus[2 * b + d, 2 * b + d] * impulses[b, 0])
                    moved = 0.0
                    for e in range(2):
                        moved += delassus[2 * b + d, 2 * a + e] * impulses[a, e]
                    if _share_body(bodies, a, b) and abs(moved) > _NEGLIGIBLE_CHANGE * own:
                        return True
    return False


@kernel
def _share_body(bodies: Ints, a: int, b: int) -> bool:
    shared = False
    for i in range(2):
        for j in range(2):
            shared = shared or (bodies[a, i] >= 0 and bodies[a, i] == bodies[b, j])
    return shared


@kernel
def order_decides(scene: StepConstants, problem: ContactProblem, k: int, chunk: Chunk) -> bool:
    """Return whether the impacts of step k, one after another, would have another outcome."""
    m, which = len(problem.which), problem.which
    lively = np.empty(m, np.bool_)
    for a in range(m):
        i = which[a]
        slow = max(SLOW * abs(problem.free[a, 0] - problem.before[a, 0]), scene.still)
        sudden = problem.delassus[2 * a, 2 * a] * chunk.impulses[k, i, 0]
        lively[a] = scene.restitution[i] >= LIVELY and sudden > slow
    bodies, pairs = scene.bodies[which], scene.pairs[which]
    return coupled_order_matters(
        bodies, pairs, lively, problem.delassus, problem.cones, chunk.impulses[k][which]
    )


@kernel
def shared_impulses(
    scene: StepConstants, problem: ContactProblem, least: Array, pushes: Array
) -> Array:
    """Return impulses (m, 2), shared out by all that touch where the motion leaves them open."""
    m = len(pushes)
    if m < 2 or problem.apart.any():
        return pushes
    modes = np.full(m, FREE)
    for a in range(m):
        slip = velocity_after(problem.delassus, least, pushes, a, 1)
        sliding = slip != 0.0
        if pushes[a, 0] > 0.0:
            sliding = is_sliding(problem, least, pushes, a)
        elif velocity_after(problem.delassus, least, pushes, a, 0) != 0.0:
            continue
        directed = scene.slips[problem.which[a]] == 2
        modes[a] = mode_of_impulse(pushes[a], slip, sliding, problem.cones[a], directed)
    return shared_forces(modes, problem.cones, problem.jacobians, pushes)[1]


@kernel
def share_forces(
    memory: ContactHistory, problem: ContactProblem, modes: Ints, steady: Array, k: int,
    chunk: Chunk,
) -> Array:  # fmt: skip
    """Write whose forces the motion does not determine; return them shared out."""
    m, struck = len(problem.which), problem.sudden.any()
    # Compliant contacts share a load by their depths.
    if m < 2 or problem.yields.any():
        return steady
    alike, result = shared_forces(modes, problem.cones, problem.jacobians, steady)
    for a in range(m):
        i = problem.which[a]
        chunk.shared[k, i] = alike[a]
        if result[a, 0] > 0.0 and not memory.closed[i] and not struck:
            # Others bore its share.
            memory.closed[i] = True
            chunk.codes[k, i] = modes[a]
    return result


@kernel
def clear_contacts(scene: StepConstants, off: Bools, before: int, k: int, chunk: Chunk) -> None:
    """Write of step k that no contact bears anything; forces of contacts begin at `before`."""
    for i in range(len(off)):
        none = OPEN_CODE if is_coupling(scene, i) else OFF_CODE
        chunk.codes[k, i] = none if off[i] else FREE
        chunk.struck[k, i] = chunk.shared[k, i] = False
        for d in range(2):
            chunk.impulses[k, i, d] = 0.0
            chunk.solved[k, before + 2 * i + d] = 0.0
