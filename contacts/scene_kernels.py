"""Time steps of a scene whose equations are on tape, compiled once.

Moreau's midpoint rule (the theta method with theta = 1/2; Moreau 1988, Acary and Brogliato 2008,
10.1): half a step with the old velocities, all impulses there at once, half a step with the new
ones. Contacts that last are kept closed to the second order: see `contacts.impulse`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from contacts.kernels import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from contacts.step_kernels import UNKNOWNS, capped, impulses_of, solve_contacts
from statechart.kernels import tape_values

__all__ = ["BAD_INERTIA", "DONE", "HARD", "NOT_FINITE", "step_scene"]

Array = NDArray[np.float64]

_kernel = njit(cache=True, no_cfunc_wrapper=True)

DONE, HARD, BAD_INERTIA, NOT_FINITE = range(4)

_PIVOTS = 20
# Impulses of contacts that approach slower than what so many steps without contact would make of
# rest are those of a contact that lasts.
_SLOW = 2.0
# A pivot below this part of its row's scale: the equations do not determine the motion.
_SINGULAR = 1e-12


@_kernel
def _factor(matrix: Array) -> tuple[bool, NDArray[np.int64]]:
    """Factor in place with partial pivoting of equilibrated rows; False where singular."""
    size = len(matrix)
    order = np.arange(size)
    scale = np.empty(size)
    for i in range(size):
        largest = np.abs(matrix[i]).max()
        if not (largest > 0.0 and math.isfinite(largest)):
            return False, order
        scale[i] = 1.0 / largest
    for k in range(size):
        best = k
        for i in range(k + 1, size):
            if abs(matrix[i, k]) * scale[i] > abs(matrix[best, k]) * scale[best]:
                best = i
        if abs(matrix[best, k]) * scale[best] <= _SINGULAR:
            return False, order
        if best != k:
            for j in range(size):
                matrix[k, j], matrix[best, j] = matrix[best, j], matrix[k, j]
            scale[k], scale[best] = scale[best], scale[k]
            order[k], order[best] = order[best], order[k]
        for i in range(k + 1, size):
            if matrix[i, k] != 0.0:
                factor = matrix[i, k] / matrix[k, k]
                matrix[i, k] = factor
                for j in range(k + 1, size):
                    matrix[i, j] -= factor * matrix[k, j]
    return True, order


@_kernel
def _back(factors: Array, order: NDArray[np.int64], right: Array) -> Array:
    size = len(right)
    x = np.empty(size)
    for i in range(size):
        total = right[order[i]]
        for j in range(i):
            total -= factors[i, j] * x[j]
        x[i] = total
    for i in range(size - 1, -1, -1):
        total = x[i]
        for j in range(i + 1, size):
            total -= factors[i, j] * x[j]
        x[i] = total / factors[i, i]
    return x


@_kernel
def _state(impulse: Array, slip: float, sliding: bool, cone: Array) -> int:
    """Return the mode of a contact that bears an impulse, as `contacts.kernels` numbers them."""
    if cone[1] == 0.0:
        return SLIDE
    if not sliding:
        return PIN
    if slip != 0.0:
        return SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS
    return SLIDE_PLUS if impulse[1] < 0.0 else SLIDE_MINUS


@_kernel
def step_scene(
    code: NDArray[np.int32],
    constants: Array,
    outputs: NDArray[np.int32],
    damped: bool,
    parameters: Array,
    cones: Array,
    restitution: Array,
    held: NDArray[np.int64],
    joints: int,
    start: float,
    h: float,
    state: Array,
    level: Array,
    closed: NDArray[np.bool_],
    bases: NDArray[np.bool_],
    given: Array,
    states: Array,
    solved: Array,
    impulses: Array,
    codes: NDArray[np.int64],
    struck: NDArray[np.bool_],
    gaps: Array,
    approach: Array,
    closing: Array,
) -> tuple[int, int, Array, Array, Array]:
    """Take steps until the arrays are full; return (steps, status, W, free, cones).

    The last three are the contact problem that was not solved, where the status is `HARD`; called
    again with its unknowns as `given`, the step is finished with them.

    Parameters
    ----------
    code, constants, outputs
        The tape: mass (n, n), forces (n,), where `damped` also their derivatives by the rates
        (n, n), then per contact Jacobian (2, n), biases (2,), gap, its rate, slip, and per
        component of a joint Jacobian (n,), gap, rate, bias, whether other rows imply it.
    parameters : (p,)
    cones : (c, 2), restitution : (c,)
    held : (c,) array of int
        How many components of a contact's velocity are constrained whatever the impulse: 0, 1
        (normal), 2 (both).
    joints : int
        Number of components of joints.
    start, h : float
        Time of the state, and step.
    state : (2 n,)
        Changed in place, as are the following three.
    level : (c,)
        Gap at which a contact that lasts is kept: what its landing has left, never above 0.
    closed : (c,)
        Whether it lasts.
    bases : (c, 4)
        Positive unknowns of the last problem.
    given : (4 m,) or (0,)
        A solution of the first step's problem.
    states : (k, 2 n), solved : (k, n + 2 c + joints)
    impulses : (k, c, 2), codes, struck, gaps : (k, c)
        To be filled: state after each step; accelerations and forces of contacts that last;
        impulses; modes; where Newton's law was applied; gaps at the midpoints.
    approach, closing : (k,)
        Fastest approach of an impact; largest gap, of either sign, that the step closes.
    """
    n, c = len(state) // 2, len(cones)
    nothing, none = np.empty((0, 0)), np.empty((0, 2))
    numbers = np.empty(len(outputs))
    per = 2 * n + 5
    first = n * n + n + (n * n if damped else 0)
    extra = joints
    for i in range(c):
        extra += held[i]
    for k in range(len(states)):
        time = start + (k + 0.5) * h
        middle = state.copy()
        for i in range(n):
            middle[i] += 0.5 * h * state[n + i]
        tape_values(code, constants, outputs, middle, parameters, time, numbers)
        size = n + extra
        matrix = np.zeros((size, size))
        right = np.zeros(size)
        for i in range(n):
            right[i] = h * numbers[n * n + i]
            for j in range(n):
                matrix[i, j] = numbers[n * i + j]
                if damped:
                    matrix[i, j] -= 0.5 * h * numbers[n * n + n + n * i + j]
        at = n
        for i in range(c):
            row = first + per * i
            for d in range(held[i]):
                # The velocity that the surface gives it, and what keeps the gap at zero.
                offset = numbers[row + 2 * n + 3 + d] + 0.5 * h * numbers[row + 2 * n + d]
                if d == 0:
                    offset += numbers[row + 2 * n + 2] / h
                for j in range(n):
                    matrix[at, j] = numbers[row + d * n + j]
                    matrix[j, at] = -numbers[row + d * n + j]
                right[at] = -offset
                at += 1
        for i in range(joints):
            row = first + per * c + (n + 4) * i
            if numbers[row + n + 3] != 0.0:
                matrix[at, at] = 1.0
            else:
                for j in range(n):
                    matrix[at, j] = numbers[row + j]
                    matrix[j, at] = -numbers[row + j]
                right[at] = -numbers[row + n] / h - numbers[row + n + 1]
                right[at] -= 0.5 * h * numbers[row + n + 2]
            at += 1
        regular, order = _factor(matrix)
        if not regular:
            return k, BAD_INERTIA, nothing, none, none
        change = _back(matrix, order, right)
        # Which contacts take part, and what their velocities may not fall below.
        approach[k] = closing[k] = 0.0
        active = np.zeros(c, np.bool_)
        hit = np.zeros(c, np.bool_)
        wanted = np.zeros((c, 2))
        before = np.zeros((c, 2))
        free = np.zeros((c, 2))
        for i in range(c):
            row = first + per * i
            gap = numbers[row + 2 * n + 2]
            gaps[k, i] = gap
            if held[i] > 0:
                continue
            for d in range(2):
                before[i, d] = free[i, d] = numbers[row + 2 * n + 3 + d]
                for j in range(n):
                    free[i, d] += numbers[row + d * n + j] * change[j]
            if gap > 0.0 and not closed[i]:
                level[i] = 0.0
            nearing = -before[i, 0]
            slow = _SLOW * abs(free[i, 0] - before[i, 0])
            above = gap - level[i]
            bias = 0.5 * h * numbers[row + 2 * n]
            # What is slow is let in before it arrives: others may push it there in this step.
            soon = above + h * (free[i, 0] + bias - slow) <= 0.0
            if closed[i] or (nearing <= slow and soon):
                active[i] = True
                if above < 0.0 and not closed[i]:
                    level[i] = gap
                    above = 0.0
                wanted[i, 0] = above / h + bias
                wanted[i, 1] = 0.5 * h * numbers[row + 2 * n + 1]
            elif above <= 0.0 and nearing > slow:
                active[i] = hit[i] = True
                wanted[i, 0] = -restitution[i] * nearing
                approach[k] = max(approach[k], nearing)
                closing[k] = max(closing[k], -gap)
                level[i] = min(gap, 0.0)
        which = np.nonzero(active)[0]
        m = len(which)
        total = np.zeros(size)
        for i in range(size):
            total[i] = change[i]
        lasting = change.copy()
        for i in range(c):
            codes[k, i] = FREE
            struck[k, i] = False
            for d in range(2):
                impulses[k, i, d] = 0.0
                solved[k, n + 2 * i + d] = 0.0
        if m > 0:
            columns = np.zeros((2 * m, size))
            for a in range(m):
                row = first + per * which[a]
                for d in range(2):
                    push = np.zeros(size)
                    for j in range(n):
                        push[j] = numbers[row + d * n + j]
                    columns[2 * a + d] = _back(matrix, order, push)
            delassus = np.zeros((2 * m, 2 * m))
            for a in range(m):
                row = first + per * which[a]
                for d in range(2):
                    for b in range(2 * m):
                        value = 0.0
                        for j in range(n):
                            value += numbers[row + d * n + j] * columns[b, j]
                        delassus[2 * a + d, b] = value
            ours, start_at = cones[which], before[which]
            unforced = free[which]
            least = unforced + wanted[which]
            guess = np.zeros(UNKNOWNS * m, np.bool_)
            for a in range(m):
                for u in range(UNKNOWNS):
                    guess[UNKNOWNS * a + u] = bases[which[a], u]
                if not guess[UNKNOWNS * a]:
                    guess[UNKNOWNS * a] = True
                    if ours[a, 1] > 0.0:
                        guess[UNKNOWNS * a + (1 if least[a, 1] < 0.0 else 2)] = True
                        guess[UNKNOWNS * a + 3] = True
            if k == 0 and len(given) == UNKNOWNS * m:
                z, basis = given, given > 0.0
            else:
                good, z, basis = solve_contacts(
                    delassus, least, ours, guess, 50 + _PIVOTS * UNKNOWNS * m
                )
                if not good:
                    return k, HARD, delassus, least, ours
            pushes = impulses_of(z)
            rebounds = False
            for a in range(m):
                rebounds = rebounds or (hit[which[a]] and restitution[which[a]] > 0.0)
            if rebounds:
                soft = least.copy()
                for a in range(m):
                    if hit[which[a]]:
                        soft[a, 0] = unforced[a, 0]
                good, plastic, _ = solve_contacts(
                    delassus, soft, ours, guess, 50 + _PIVOTS * UNKNOWNS * m
                )
                if good:
                    pushes, _ = capped(delassus, start_at, unforced, impulses_of(plastic), pushes)
            for a in range(m):
                i = which[a]
                for u in range(UNKNOWNS):
                    bases[i, u] = basis[UNKNOWNS * a + u]
                slip = least[a, 1]
                for b in range(2 * m):
                    slip += delassus[2 * a + 1, b] * pushes[b // 2, b % 2]
                for d in range(2):
                    impulses[k, i, d] = pushes[a, d]
                    for j in range(size):
                        total[j] += columns[2 * a + d, j] * pushes[a, d]
                        if not hit[i]:
                            lasting[j] += columns[2 * a + d, j] * pushes[a, d]
                    if not hit[i]:
                        solved[k, n + 2 * i + d] = pushes[a, d] / h
                pressed = pushes[a, 0] > 0.0
                if pressed and not hit[i] and not closed[i]:
                    closing[k] = max(closing[k], gaps[k, i] - level[i])
                struck[k, i] = hit[i] and pressed
                closed[i] = pressed and not (hit[i] and restitution[i] > 0.0)
                if closed[i]:
                    sliding = z[UNKNOWNS * a + 3] > 0.0
                    codes[k, i] = _state(pushes[a], slip, sliding, ours[a])
        for i in range(c):
            if not active[i]:
                closed[i] = False
        at = n
        for i in range(c):
            if held[i] > 0:
                codes[k, i] = PIN if held[i] == 2 else SLIDE
                for d in range(held[i]):
                    solved[k, n + 2 * i + d] = total[at] / h
                    impulses[k, i, d] = total[at]
                    at += 1
        for i in range(joints):
            solved[k, n + 2 * c + i] = total[at + i] / h
        for i in range(n):
            solved[k, i] = lasting[i] / h
            state[n + i] += total[i]
            state[i] = middle[i] + 0.5 * h * state[n + i]
            if not math.isfinite(state[i]):
                return k, NOT_FINITE, nothing, none, none
        for i in range(2 * n):
            states[k, i] = state[i]
    return len(states), DONE, nothing, none, none
