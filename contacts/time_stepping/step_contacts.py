"""The contacts of a step of a scene on tape: which take part, what they bear, and how that is told.

Moreau's midpoint rule: all impulses of a step are those of one contact problem in its middle.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_lcp_kernels import UNKNOWNS
from contacts.solvers.impulse_coupling import coupled_contacts
from contacts.solvers.redundancy import shared_forces
from contacts.solvers.step_impulses import (
    into_cone,
    of_group,
    relieve,
    steady_impulses,
)
from contacts.states import FREE, OFF_CODE
from contacts.time_stepping.chunk import (
    APART,
    BESIDE,
    HIT,
    LASTING,
    LIVELY,
    SLOW,
    Chunk,
    arriving,
    pressed_guess,
)
from contacts.time_stepping.energy import energy_added
from contacts.time_stepping.equations import JOINT, back
from contacts.time_stepping.forces import ROUNDING, borne_mode, pressing, velocity_after
from contacts.time_stepping.impact_order import coupled_order_matters
from contacts.time_stepping.scene_numbers import (
    HOLDING,
    LANDED,
    Answer,
    ContactMemory,
    Met,
    Problem,
    SceneNumbers,
    Tape,
)
from statechart.arrays import Array, Bools, Ints
from statechart.kernels.copies import indices, put
from statechart.kernels.jit import part

# A contact that lands slower than this part of what a step without contact would make of rest
# brings no momentum that forces would tell.
_LATE = 1e-9


@part
def taking_part(
    scene: SceneNumbers, memory: ContactMemory, tape: Tape, change: Array, k: int, met: Met,
    chunk: Chunk,
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
        nearing, slow = -before[0], max(SLOW * abs(free[0] - before[0]), scene.still)
        bias = 0.5 * h * numbers[row + 2 * n]
        role, level[i], above = arriving(
            gap, level[i], memory.closed[i], nearing, free[0] + bias, slow, BESIDE, scene.near, h
        )
        met.active[i], met.hit[i] = role != APART, role == HIT
        if role == LASTING:
            met.wanted[i, 0] = above / h + bias
            if not memory.closed[i] and abs(free[0] + met.wanted[i, 0]) <= scene.rounding:
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


@part
def _alone(groups: Ints, a: int) -> bool:
    """Whether a contact is the only one of its group."""
    alone = True
    for b in range(len(groups)):
        alone = alone and (b == a or groups[b] != groups[a])
    return alone


@part
def moved_columns(tape: Tape, factors: Array, order: Ints, which: Ints) -> Array:
    """Return what unit impulses of contacts do to all that moves (2 m, s)."""
    n = tape.size
    columns, push = np.zeros((2 * len(which), len(order))), np.zeros(len(order))
    for a in range(len(which)):
        row = tape.first + tape.per * which[a]
        for d in range(2):
            for j in range(n):
                push[j] = tape.numbers[row + d * n + j]
            put(back(factors, order, push), columns[2 * a + d])
    return columns


@part
def delassus_of(tape: Tape, which: Ints, columns: Array) -> Array:
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


@part
def _groups(scene: SceneNumbers, tape: Tape, which: Ints) -> Ints:
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


@part
def contact_problem(
    scene: SceneNumbers, tape: Tape, factors: Array, order: Ints, which: Ints, met: Met
) -> Problem:
    """Return the problem of the contacts that take part; `met` is told who does not rebound.

    What moves has the equations of these factors, in this order.
    """
    m = len(which)
    columns = moved_columns(tape, factors, order, which)
    delassus = delassus_of(tape, which, columns)
    groups = _groups(scene, tape, which)
    cones, before = np.empty((m, 2)), np.empty((m, 2))
    free, wanted = np.empty((m, 2)), np.empty((m, 2))
    rebounds, sudden = np.empty(m, np.bool_), np.empty(m, np.bool_)
    for a in range(m):
        i = which[a]
        rebounds[a], sudden[a] = met.hit[i] and scene.restitution[i] > 0.0, met.hit[i]
        if scene.plastic and rebounds[a] and not _alone(groups, a):
            rebounds[a], met.wanted[i, 0] = False, 0.0
        put(scene.cones[i], cones[a])
        put(met.before[i], before[a])
        put(met.free[i], free[a])
        put(met.wanted[i], wanted[a])
    return Problem(
        which, columns, delassus, groups[:m], cones, before, free, wanted, rebounds, sudden
    )  # fmt: skip


@part
def guessed(problem: Problem, bases: Bools) -> Bools:
    """Return which unknowns (4 m,) are positive: those of the last problem; what is new presses."""
    m = len(problem.which)
    guess = np.zeros(UNKNOWNS * m, np.bool_)
    for a in range(m):
        for u in range(UNKNOWNS):
            guess[UNKNOWNS * a + u] = bases[problem.which[a], u]
        if not guess[UNKNOWNS * a]:
            slip = problem.free[a, 1] + problem.wanted[a, 1]
            mine = guess[UNKNOWNS * a : UNKNOWNS * (a + 1)]
            pressed_guess(mine, slip, problem.cones[a, 1] > 0.0)
    return guess


@part
def answered(
    scene: SceneNumbers, memory: ContactMemory, problem: Problem, z: Array, basis: Bools,
    least: Array, pushes: Array,
) -> Answer:  # fmt: skip
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
            clear = ROUNDING * (abs(problem.before[a, 0]) + abs(problem.free[a, 0]))
            # What others bear tells, too, where there are others.
            off = least[a, 0] > clear and memory.closed[i] and _alone(problem.groups, a)
            several = several or (paradox and off)
    steady, slides = steady_impulses(delassus, least, problem.cones, z, pushes, sudden)
    relieve(problem.groups, problem.cones, z, pushes, sudden, steady, slides)
    return Answer(z, basis, least, pushes, steady, slides, several, jammed)


@part
def energy_of(
    scene: SceneNumbers, tape: Tape, problem: Problem, pushes: Array, rates: Array
) -> float:
    """Return the largest part of its own energy that contacts add to a group of them."""
    m, delassus = len(problem.which), problem.delassus
    work, moving, rows = np.empty(m), np.empty(m), np.empty(m, np.int64)
    for a in range(m):
        work[a], rows[a] = 0.0, tape.first + tape.per * problem.which[a]
        for d in range(2):
            both = problem.before[a, d] + problem.free[a, d]
            for b in range(2 * m):
                both += delassus[2 * a + d, b] * pushes[b // 2, b % 2]
            work[a] += pushes[a, d] * both
        speed = max(math.hypot(problem.before[a, 0], problem.before[a, 1]), scene.slowest)
        moving[a] = speed * speed / delassus[2 * a, 2 * a]
    return energy_added(tape.numbers, rates, rows, problem.groups, work, moving, scene.negligible)


@part
def mixed_with_impacts(
    memory: ContactMemory, tape: Tape, problem: Problem, pushes: Array, h: float
) -> Bools:
    """Return whose impulses (m,) of this step are not those of forces alone."""
    which, groups, m = problem.which, problem.groups, len(problem.which)
    mixed = np.zeros(m, np.bool_)
    for a in range(m):
        i, nearing = which[a], -problem.before[a, 0]
        late = _LATE * abs(problem.free[a, 0] + nearing)
        bias = 0.5 * h * tape.numbers[tape.first + tape.per * i + 2 * tape.size]
        arrives = nearing > late or abs(problem.wanted[a, 0] - bias) > late
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


@part
def told(
    scene: SceneNumbers, memory: ContactMemory, problem: Problem, answer: Answer, met: Met, k: int,
    chunk: Chunk,
) -> Ints:  # fmt: skip
    """Write modes and impulses of step k, and who lasts; return the modes (m,) under forces."""
    m, sudden, cones = len(problem.which), problem.sudden, problem.cones
    pushes, steady = answer.pushes, answer.steady
    modes = np.full(m, FREE)
    for a in range(m):
        i = problem.which[a]
        for u in range(UNKNOWNS):
            memory.bases[i, u] = answer.basis[UNKNOWNS * a + u]
        slip = velocity_after(problem.delassus, answer.least, pushes, a, 1)
        memory.slid[i] = slip != 0.0
        if of_group(sudden, problem.groups, problem.groups[a]):
            for d in range(2):
                chunk.impulses[k, i, d] = pushes[a, d] - steady[a, d]
            put(into_cone(chunk.impulses[k, i], cones[a]), chunk.impulses[k, i])
        pressed, directed = pushes[a, 0] > 0.0, scene.slips[i] == 2
        if pressed and not met.hit[i] and not memory.closed[i]:
            chunk.closing[k] = max(chunk.closing[k], chunk.gaps[k, i] - memory.level[i])
        chunk.struck[k, i] = sudden[a] and pressed
        if chunk.struck[k, i] and not met.hit[i]:
            # What jams falls freely up to the middle of the step, where it is struck.
            falling = -0.5 * (problem.before[a, 0] + problem.free[a, 0])
            chunk.approach[k] = max(chunk.approach[k], falling)
        memory.closed[i] = pressed and not problem.rebounds[a]
        if memory.closed[i]:
            sliding = answer.z[UNKNOWNS * a + 3] > 0.0 and slip != 0.0
            chunk.codes[k, i] = borne_mode(pushes[a], slip, sliding, cones[a], directed)
        if steady[a, 0] > 0.0:
            modes[a] = borne_mode(steady[a], slip, answer.slides[a], cones[a], directed)
        elif not pressed and velocity_after(problem.delassus, answer.least, steady, a, 0) == 0.0:
            slip = velocity_after(problem.delassus, answer.least, steady, a, 1)
            modes[a] = borne_mode(steady[a], slip, slip != 0.0, cones[a], directed)
    return modes


@part
def order_decides(scene: SceneNumbers, problem: Problem, k: int, chunk: Chunk) -> bool:
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


@part
def as_shared(
    memory: ContactMemory, tape: Tape, problem: Problem, modes: Ints, steady: Array, k: int,
    chunk: Chunk,
) -> Array:  # fmt: skip
    """Write whose forces the motion does not determine; return them shared out."""
    m, n = len(problem.which), tape.size
    if m < 2:
        return steady
    reach, struck = np.empty((m, 2, n)), False
    for a in range(m):
        row = tape.first + tape.per * problem.which[a]
        struck = struck or problem.sudden[a]
        for d in range(2):
            for j in range(n):
                reach[a, d, j] = tape.numbers[row + d * n + j]
    alike, result = shared_forces(modes, problem.cones, reach, steady)
    for a in range(m):
        i = problem.which[a]
        chunk.shared[k, i] = alike[a]
        if result[a, 0] > 0.0 and not memory.closed[i] and not struck:
            # Others bore its share.
            memory.closed[i] = True
            chunk.codes[k, i] = modes[a]
    return result


@part
def nothing_borne(off: Bools, before: int, k: int, chunk: Chunk) -> None:
    """Write of step k that no contact bears anything; forces of contacts begin at `before`."""
    for i in range(len(off)):
        chunk.codes[k, i] = OFF_CODE if off[i] else FREE
        chunk.struck[k, i] = chunk.shared[k, i] = False
        for d in range(2):
            chunk.impulses[k, i, d] = 0.0
            chunk.solved[k, before + 2 * i + d] = 0.0
