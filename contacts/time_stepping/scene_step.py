"""Time steps of a scene whose equations are on tape, compiled once.

Moreau's midpoint rule (the theta method with theta = 1/2; Moreau 1988, Acary and Brogliato 2008,
10.1): half a step with the old velocities, all impulses there at once, half a step with the new
ones. Contacts that last are kept closed to the second order: see `contacts.time_stepping.loop`.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.solvers.contact_lcp_kernels import UNKNOWNS
from contacts.solvers.redundancy import shared_forces
from contacts.solvers.step_impulses import (
    AS_ASKED,
    coupled_contacts,
    into_cone,
    of_group,
    relieve,
    solve_impacts,
    steady_impulses,
)
from contacts.states import FREE, OFF_CODE, PIN, SLIDE
from contacts.time_stepping.chunk import (
    APART,
    BAD_INERTIA,
    BESIDE,
    DONE,
    HARD,
    HIT,
    LASTING,
    NOT_FINITE,
    SLOW,
    Chunk,
    arriving,
    pressed_guess,
)
from contacts.time_stepping.energy import energy_added
from contacts.time_stepping.equations import CONTACT, JOINT, back, factored
from contacts.time_stepping.forces import borne_mode, jammed, resting
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.copies import indices, put
from statechart.kernels.jit import kernel, part
from statechart.kernels.tapes import tape_values

# A contact that lands slower than this part of what a step without contact would make of rest
# brings no momentum that forces would tell.
_LATE = 1e-9
# So many steps hold an impulse: that of a landing; the next, as the motion turned the contact off
# its level in the landing's; and the one after that, which ends what the next began.
_SETTLING = 3


@part
def _alone(groups: Ints, a: int) -> bool:
    """Whether a contact is the only one of its group."""
    alone = True
    for b in range(len(groups)):
        alone = alone and (b == a or groups[b] != groups[a])
    return alone


@kernel
def step_scene(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    damped: bool,
    parameters: Array,
    cones: Array,
    restitution: Array,
    plastic: bool,
    held: Ints,
    slips: Ints,
    joints: int,
    near: float,
    slowest: float,
    negligible: float,
    start: float,
    level: Array,
    closed: Bools,
    fresh: Ints,
    off: Bools,
    light: Bools,
    bases: Bools,
    given: Array,
    how: int,
    chunk: Chunk,
) -> tuple[int, int, Array, Array, Array]:
    """Take the steps of a chunk; return (steps, status, W, free, cones).

    The last three are the contact problem that was not solved, where the status is `HARD`; called
    again with its unknowns as `given`, the step is finished with them.

    Parameters
    ----------
    code, constants, outputs
        The tape: mass (n, n), forces (n,), where `damped` also their derivatives by the rates
        (n, n), then per contact Jacobian (2, n) and what `CONTACT` lists, per component of a joint
        Jacobian (n,) and what `JOINT` lists, and what controllers set (u,).
    parameters : (p,)
    cones : (c, 2), restitution : (c,)
    plastic : bool
        Whether contacts that are hit together do not rebound.
    held : (c,) array of int
        How many components of a contact's velocity are constrained whatever the impulse: 0, 1
        (normal), 2 (both).
    slips : (c,) array of int
        Whether a contact may slide: 0, 1, or 2 if its slides have a direction.
    joints : int
        Number of components of joints.
    near : float
        Contacts that were off come back where they are no deeper than this.
    slowest, negligible : float
        What contacts add to the energy is told in parts of what they move with: at this speed at
        least, and twice this energy at least.
    start : float
        Time of the first state.
    level : (c,)
        Gap at which a contact that lasts is kept: what its landing has left, never above 0.
        Changed in place, as are the following five.
    closed : (c,)
        Whether it lasts.
    fresh : (c,) array of int
        Of how many steps, this one included, impulses are not those of forces alone.
    off : (c,)
        Whether its condition keeps it off.
    light : (1,)
        Whether coordinates without an inertia of their own were given one.
    bases : (c, 4)
        Positive unknowns of the last problem.
    given : (k,)
        Solutions of problems of the first step that were not solved before.
    how : int
        What is asked of the first step: `AS_ASKED`, `SOFTENED` or `AS_GIVEN`.
    chunk : Chunk
        To be filled; unknowns are accelerations (n,), forces of joints and of contacts that last
        (2 c,; not a number where the step holds an impact as well), what controllers set (u,).
    """
    (
        h,
        states,
        solved,
        codes,
        struck,
        shared,
        impulses,
        gaps,
        approach,
        closing,
        _,
        gained,
        efforts,
    ) = chunk
    state = states[0].copy()
    n, c = len(state) // 2, len(cones)
    nothing, none = np.empty((0, 0)), np.empty((0, 2))
    numbers = np.empty(len(outputs))
    per = 2 * n + CONTACT
    first = n * n + n + (n * n if damped else 0)
    borne = n + joints
    for k in range(len(codes)):
        time = start + (k + 0.5) * h
        middle = state.copy()
        for i in range(n):
            middle[i] += 0.5 * h * state[n + i]
        tape_values(code, constants, outputs, middle, parameters, time, numbers)
        regular, matrix, order, right = factored(numbers, n, h, damped, held, joints, light[0])
        if not regular and not light[0]:
            light[0] = True
            regular, matrix, order, right = factored(numbers, n, h, damped, held, joints, True)
        if not regular:
            return k, BAD_INERTIA, nothing, none, none
        size = len(right)
        change = back(matrix, order, right)
        for i in range(first + per * c + (n + JOINT) * joints, len(numbers)):
            solved[k, borne + 2 * c + i - (first + per * c + (n + JOINT) * joints)] = numbers[i]
        # Which contacts take part, and what their velocities may not fall below.
        approach[k] = closing[k] = gained[k] = 0.0
        active = np.zeros(c, np.bool_)
        hit = np.zeros(c, np.bool_)
        wanted = np.zeros((c, 2))
        before = np.zeros((c, 2))
        free = np.zeros((c, 2))
        for i in range(c):
            row = first + per * i
            gap = numbers[row + 2 * n + 2]
            condition = numbers[row + 2 * n + 5]
            was_off = off[i]
            if was_off:
                off[i] = not (condition > 0.0 and gap >= -near)
            elif condition < 0.0:
                off[i] = True
            if not off[i] and (math.isnan(condition) or not math.isfinite(gap)):
                return k, NOT_FINITE, nothing, none, none
            gaps[k, i] = math.inf if off[i] else gap
            if held[i] > 0 or off[i] or was_off:
                level[i] = 0.0
                continue
            for d in range(2):
                before[i, d] = free[i, d] = numbers[row + 2 * n + 3 + d]
                for j in range(n):
                    free[i, d] += numbers[row + d * n + j] * change[j]
            nearing = -before[i, 0]
            slow = SLOW * abs(free[i, 0] - before[i, 0])
            bias = 0.5 * h * numbers[row + 2 * n]
            part, level[i], above = arriving(
                gap, level[i], closed[i], nearing, free[i, 0] + bias, slow, BESIDE, h
            )
            active[i], hit[i] = part != APART, part == HIT
            if part == HIT:
                # The direction it is hit in is as far off as it turns within the step.
                speed = max(math.hypot(before[i, 0], before[i, 1]), slowest)
                gained[k] = max(gained[k], (bias / speed) ** 2)
            if part == LASTING:
                wanted[i, 0] = above / h + bias
                wanted[i, 1] = 0.5 * h * numbers[row + 2 * n + 1]
            elif part == HIT:
                wanted[i, 0] = -restitution[i] * nearing
                approach[k] = max(approach[k], nearing)
                closing[k] = max(closing[k], -gap)
        which = indices(active)
        m = len(which)
        efforts[k, 2] = m
        total = np.zeros(size)
        for i in range(size):
            total[i] = change[i]
        lasting = change.copy()
        blurred = False
        for i in range(c):
            codes[k, i] = OFF_CODE if off[i] else FREE
            struck[k, i] = shared[k, i] = False
            for d in range(2):
                impulses[k, i, d] = 0.0
                solved[k, borne + 2 * i + d] = 0.0
        if m > 0:
            columns = np.zeros((2 * m, size))
            for a in range(m):
                row = first + per * which[a]
                for d in range(2):
                    push = np.zeros(size)
                    for j in range(n):
                        push[j] = numbers[row + d * n + j]
                    put(back(matrix, order, push), columns[2 * a + d])
            delassus = np.zeros((2 * m, 2 * m))
            for a in range(m):
                row = first + per * which[a]
                for d in range(2):
                    for b in range(2 * m):
                        value = 0.0
                        for j in range(n):
                            value += numbers[row + d * n + j] * columns[b, j]
                        delassus[2 * a + d, b] = value
            groups = coupled_contacts(delassus)
            rebounds, sudden = np.empty(m, np.bool_), np.empty(m, np.bool_)
            for a in range(m):
                rebounds[a] = hit[which[a]] and restitution[which[a]] > 0.0
                sudden[a] = hit[which[a]]
            if plastic:
                for a in range(m):
                    if rebounds[a] and not _alone(groups, a):
                        rebounds[a] = False
                        wanted[which[a], 0] = 0.0
            ours, start_at, unforced = np.empty((m, 2)), np.empty((m, 2)), np.empty((m, 2))
            asked, least = np.empty((m, 2)), np.empty((m, 2))
            for a in range(m):
                for d in range(2):
                    i = which[a]
                    ours[a, d], start_at[a, d] = cones[i, d], before[i, d]
                    unforced[a, d], asked[a, d] = free[i, d], wanted[i, d]
                    least[a, d] = free[i, d] + wanted[i, d]
            guess = np.zeros(UNKNOWNS * m, np.bool_)
            for a in range(m):
                for u in range(UNKNOWNS):
                    guess[UNKNOWNS * a + u] = bases[which[a], u]
                if not guess[UNKNOWNS * a]:
                    mine = guess[UNKNOWNS * a : UNKNOWNS * (a + 1)]
                    pressed_guess(mine, least[a, 1], ours[a, 1] > 0.0)
            good, z, basis, pushes, least = solve_impacts(
                delassus, groups, start_at, unforced, asked, ours, rebounds, guess,
                given if k == 0 else given[:0], how if k == 0 else AS_ASKED,
            )  # fmt: skip
            if not good:
                return k, HARD, delassus, least, ours
            for a in range(m):
                i = which[a]
                corner = delassus[2 * a : 2 * a + 2, 2 * a : 2 * a + 2]
                # Where it stuck, its slip is rounding.
                if slips[i] > 0 and (bases[i, 3] or not closed[i]):
                    sudden[a] = sudden[a] or jammed(corner, least[a], start_at[a, 1], ours[a])
            steady, slides = steady_impulses(delassus, least, ours, z, pushes, sudden)
            relieve(groups, ours, z, pushes, sudden, steady, slides)
            work, moving, rows = np.empty(m), np.empty(m), np.empty(m, np.int64)
            for a in range(m):
                work[a], rows[a] = 0.0, first + per * which[a]
                for d in range(2):
                    both = start_at[a, d] + free[which[a], d]
                    for b in range(2 * m):
                        both += delassus[2 * a + d, b] * pushes[b // 2, b % 2]
                    work[a] += pushes[a, d] * both
                speed = max(math.hypot(start_at[a, 0], start_at[a, 1]), slowest)
                moving[a] = speed * speed / delassus[2 * a, 2 * a]
            made = energy_added(numbers, state[n:], rows, groups, work, moving, negligible)
            gained[k] = max(gained[k], made)
            modes = np.full(m, FREE)
            # Whose impulses of this step are not those of forces alone.
            mixed = np.zeros(m, np.bool_)
            for a in range(m):
                i = which[a]
                late = _LATE * abs(free[i, 0] - before[i, 0])
                bias = 0.5 * h * numbers[first + per * i + 2 * n]
                arrives = before[i, 0] < -late or abs(wanted[i, 0] - bias) > late
                if pushes[a, 0] > 0.0 and (sudden[a] or (not closed[i] and arrives)):
                    for b in range(m):
                        if groups[b] == groups[a]:
                            fresh[which[b]] = _SETTLING
            for a in range(m):
                if fresh[which[a]] > 0:
                    for b in range(m):
                        mixed[b] = mixed[b] or groups[b] == groups[a]
            for a in range(m):
                i = which[a]
                for u in range(UNKNOWNS):
                    bases[i, u] = basis[UNKNOWNS * a + u]
                slip = least[a, 1]
                for b in range(2 * m):
                    slip += delassus[2 * a + 1, b] * pushes[b // 2, b % 2]
                if of_group(sudden, groups, groups[a]):
                    for d in range(2):
                        impulses[k, i, d] = pushes[a, d] - steady[a, d]
                    put(into_cone(impulses[k, i], ours[a]), impulses[k, i])
                for d in range(2):
                    for j in range(size):
                        total[j] += columns[2 * a + d, j] * pushes[a, d]
                        lasting[j] += columns[2 * a + d, j] * steady[a, d]
                pressed = pushes[a, 0] > 0.0
                if pressed and not hit[i] and not closed[i]:
                    closing[k] = max(closing[k], gaps[k, i] - level[i])
                struck[k, i] = sudden[a] and pressed
                closed[i] = pressed and not rebounds[a]
                directed = slips[i] == 2
                if closed[i]:
                    sliding = z[UNKNOWNS * a + 3] > 0.0
                    codes[k, i] = borne_mode(pushes[a], slip, sliding, ours[a], directed)
                if steady[a, 0] > 0.0:
                    modes[a] = borne_mode(steady[a], slip, slides[a], ours[a], directed)
                elif not pressed:
                    rests, slip = resting(delassus, least, steady, a)
                    if rests:
                        modes[a] = borne_mode(steady[a], slip, slip != 0.0, ours[a], directed)
            if m > 1:
                reach = np.empty((m, 2, n))
                for a in range(m):
                    row = first + per * which[a]
                    for d in range(2):
                        for j in range(n):
                            reach[a, d, j] = numbers[row + d * n + j]
                alike, steady = shared_forces(modes, ours, reach, steady)
                for a in range(m):
                    i = which[a]
                    shared[k, i] = alike[a]
                    if steady[a, 0] > 0.0 and not closed[i] and not sudden.any():
                        # Others bore its share.
                        closed[i] = True
                        codes[k, i] = modes[a]
            for a in range(m):
                for d in range(2):
                    force = math.nan if mixed[a] else steady[a, d] / h
                    solved[k, borne + 2 * which[a] + d] = force
            blurred = bool(mixed.any())
        for i in range(c):
            fresh[i] = max(fresh[i] - 1, 0)
            if not active[i]:
                closed[i] = False
        at = n
        for i in range(c):
            if held[i] > 0:
                codes[k, i] = PIN if held[i] == 2 else SLIDE
                for d in range(held[i]):
                    solved[k, borne + 2 * i + d] = math.nan if blurred else lasting[at] / h
                    impulses[k, i, d] = total[at] - lasting[at]
                    at += 1
        for i in range(joints):
            solved[k, n + i] = math.nan if blurred else lasting[at + i] / h
        for i in range(n):
            solved[k, i] = lasting[i] / h
            state[n + i] += total[i]
            state[i] = middle[i] + 0.5 * h * state[n + i]
            if not math.isfinite(state[i]):
                return k, NOT_FINITE, nothing, none, none
        for i in range(2 * n):
            states[k + 1, i] = state[i]
    return len(codes), DONE, nothing, none, none
