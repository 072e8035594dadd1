"""The usual instant, compiled (see `contacts.usual`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from contacts.solvers.mode_solver import solve_modes
from contacts.states import FREE, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array, Ints32
from statechart.kernels.jit import kernel
from statechart.kernels.tapes import tape_values

# In the scene's forces: beyond, a sliding contact may bear what only rounding keeps finite.
ENDLESS = 1e13
# More combinations of states are left to the laws.
_MOST = 64
# Numbers of a contact behind all Jacobians and biases: gap, its rate, slip, point, tangent.
_SCALARS = 7


@kernel
def usual(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    state: Array,
    parameters: Array,
    time: float,
    allowed: NDArray[np.bool_],
    cones: Array,
    under_way: bool,
    kept: NDArray[np.int64],
    near: float,
    creep: float,
    close: float,
    slow: float,
    tie: float,
    force_scale: float,
    acceleration_scale: float,
    numbers: Array,
    taken: NDArray[np.int64],
) -> bool:
    """Classify every contact; False where the instant is not a usual one.

    Parameters
    ----------
    code, constants, outputs
        Tape of the scene's numbers (`contacts.dynamics.snapshot.SnapshotTape`).
    state, parameters, time
        Where.
    allowed : (c, 5) array
        Whether a contact may be in the state of that code.
    cones : (c, 2) array
        cone_n, cone_t.
    under_way, kept
        Whether a flow led here, and in which state (c,) it kept each contact.
    near, creep : float
        A closed contact's gap and velocities that need no projection.
    close, slow : float
        Tolerances of gap and speed.
    tie, force_scale, acceleration_scale : float
        See `contacts.solvers.mode_solver.solve_modes`.
    numbers : (o,), taken : (c,) array
        To be filled: the scene's numbers; the state of every contact.
    """
    n, contacts = state.shape[0] // 2, taken.shape[0]
    tape_values(code, constants, outputs, state, parameters, time, numbers)
    at = n * n + n + 1
    biases_at = at + 2 * n * contacts
    scalars = biases_at + 2 * contacts
    closed, still = np.empty(contacts, np.bool_), np.empty(contacts, np.bool_)
    options, counts = np.empty((contacts, 5), np.int64), np.empty(contacts, np.int64)
    total = 1
    for c in range(contacts):
        place = scalars + _SCALARS * c
        gap, rate, slip = numbers[place], numbers[place + 1], numbers[place + 2]
        shut = gap <= close
        lasting = kept[c] != FREE
        if not (gap >= 0.0 or (lasting and gap >= -near)) or (shut and rate < -slow):
            return False
        off = gap > near or abs(rate) > creep
        if lasting and (off or (kept[c] == PIN and abs(slip) > creep)):
            return False
        closed[c], still[c] = shut and rate <= slow, abs(slip) <= 2.0 * slow
        if not closed[c] and not allowed[c, FREE]:
            return False
        if closed[c] and off and not under_way:
            return False
        counts[c] = 0
        for s in range(5):
            if not closed[c]:
                free = s == FREE
            elif s in (FREE, SLIDE) or still[c]:
                free = allowed[c, s]
            else:
                free = allowed[c, s] and s == (SLIDE_PLUS if slip > 0.0 else SLIDE_MINUS)
            if free:
                options[c, counts[c]] = s
                counts[c] += 1
        total *= counts[c]
    if total == 0 or total > _MOST:
        return False
    codes = np.empty((total, contacts), np.int64)
    for k in range(total):
        left = k
        for c in range(contacts):
            codes[k, c] = options[c, left % counts[c]]
            left //= counts[c]
    status, verdicts = np.empty(total, np.int64), np.empty((total, 4))
    forces = np.empty((total, contacts, 2))
    redundant, agreeing = solve_modes(
        numbers[: n * n].reshape((n, n)),
        numbers[n * n : n * n + n],
        numbers[at:biases_at].reshape((contacts, 2, n)),
        numbers[biases_at:scalars].reshape((contacts, 2)),
        cones,
        codes,
        closed,
        still,
        force_scale,
        acceleration_scale,
        status,
        np.empty((total, n)),
        forces,
        verdicts,
        tie,
    )
    if redundant > 0 or agreeing < 0 or not verdicts[agreeing, 0] < -tie:
        return False
    for c in range(contacts):
        for force in forces[agreeing, c]:
            if abs(force) > ENDLESS * force_scale:
                return False
        place = scalars + _SCALARS * c
        taken[c] = codes[agreeing, c]
        if taken[c] != FREE:
            if abs(numbers[place]) > near or abs(numbers[place + 1]) > creep:
                return False
            if taken[c] == PIN and abs(numbers[place + 2]) > creep:
                return False
    return True
