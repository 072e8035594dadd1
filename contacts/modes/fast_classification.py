"""The usual instant: no impact, nothing to be brought back, and one mode that agrees.

One compiled call then says which; everything else is left to the laws, which go through it step by
step (`contacts.event_driven.laws`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from contacts.dynamics.contact_law import cones
from contacts.dynamics.projection import landing
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SCALARS, SnapshotTape
from contacts.solvers.mode_solver import solve_modes
from contacts.states import CODES, FREE, OFF, OFF_CODE, OPEN, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.automaton.trace import Key
from statechart.kernels.jit import part, seldom
from statechart.kernels.tapes import tape_values

_NAMES = {code: name for name, code in CODES.items() if name != OFF}


def fast_mode(
    setup: SceneSetup, tape: SnapshotTape, state: Array, time: float, flow: Key | None
) -> tuple[Key, float] | None:
    """Return the mode that the state calls for and the energy; None where the instant is not usual.

    Parameters
    ----------
    setup : SceneSetup
        The numbers of the run.
    tape : SnapshotTape
        Of a scene without joints.
    state : (2 n,) array
        Left as it is.
    time : float
        When.
    flow : tuple of str or None
        The mode that led here; None at the start of a run.
    """
    contacts, tolerances = setup.contacts, setup.tolerances
    near, creep = landing(tolerances)
    codes = np.empty(len(contacts), np.int64)
    numbers = np.empty(len(tape.tape.outputs))
    found = usual(
        *tape.tape.program,
        state,
        setup.values,
        time,
        allowed(tuple([law.states for law in contacts])),
        cones(contacts),
        *_kept(flow, len(contacts)),
        near,
        creep,
        tolerances["gap"],
        tolerances["speed"],
        setup.tie,
        setup.doubtful,
        setup.scales.force,
        setup.scales.acceleration,
        numbers,
        codes,
    )
    if not found:
        return None
    size = tape.size
    return tuple([_NAMES[code] for code in codes.tolist()]), numbers.item(size * size + size)


@lru_cache(maxsize=1024)
def allowed(states: tuple[tuple[str, ...], ...]) -> Bools:
    """Return (c, 5): whether a contact's region has the state of that code."""
    allowed = np.zeros((len(states), len(_NAMES)), np.bool_)
    for i, several in enumerate(states):
        for name in several:
            if name != OFF:
                allowed[i, CODES[name]] = True
    return allowed


@lru_cache(maxsize=1024)
def _kept(flow: Key | None, count: int) -> tuple[bool, Ints]:
    """Return whether a flow led here, and in which state it kept every contact."""
    if flow is None:
        return False, np.full(count, FREE)
    return True, np.array([FREE if s in OPEN else CODES[s] for s in flow], np.int64)


# In the scene's forces: beyond, a sliding contact may bear what only rounding keeps finite.
ENDLESS = 1e13
# More combinations of states are left to the laws.
_MOST = 64


@seldom
def usual(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    state: Array,
    parameters: Array,
    time: float,
    allowed: Bools,
    cones: Array,
    under_way: bool,
    kept: Ints,
    near: float,
    creep: float,
    close: float,
    slow: float,
    tie: float,
    doubtful: float,
    force_scale: float,
    acceleration_scale: float,
    numbers: Array,
    taken: Ints,
) -> bool:
    """Classify every contact; False where the instant is not a usual one.

    Parameters
    ----------
    code, constants, outputs
        Tape of the scene's numbers (`contacts.dynamics.snapshot.SnapshotTape`).
    state, parameters, time
        Where.
    numbers : (o,) array
        To be filled with the scene's numbers.
    allowed, cones, under_way, kept, near, creep, close, slow, tie, doubtful
        See `classify`, as for the scales and `taken`.
    """
    tape_values(code, constants, outputs, state, parameters, time, numbers)
    lowest = np.empty(taken.shape[0])
    for c in range(taken.shape[0]):
        lowest[c] = 0.0 if kept[c] == FREE else -near
    return classify(
        numbers,
        state.shape[0] // 2,
        allowed,
        cones,
        under_way,
        kept,
        lowest,
        near,
        creep,
        close,
        slow,
        tie,
        doubtful,
        force_scale,
        acceleration_scale,
        taken,
    )


@part
def _doubted(
    codes: Ints, kept: Ints, closed: Bools, still: Bools, verdicts: Array, doubtful: float
) -> bool:
    """Whether a mode in which a contact comes to rest is close to the bounds of its forces."""
    for k in range(codes.shape[0]):
        if abs(verdicts[k, 0]) <= doubtful:
            for c in range(codes.shape[1]):
                if codes[k, c] == PIN and kept[c] != PIN and closed[c] and still[c]:
                    return True
    return False


@part
def classify(
    numbers: Array,
    n: int,
    allowed: Bools,
    cones: Array,
    under_way: bool,
    kept: Ints,
    lowest: Array,
    near: float,
    creep: float,
    close: float,
    slow: float,
    tie: float,
    doubtful: float,
    force_scale: float,
    acceleration_scale: float,
    taken: Ints,
) -> bool:
    """Classify every contact; False where that is not as simple.

    Parameters
    ----------
    numbers : (o,) array
        The scene's.
    n : int
        Number of coordinates.
    allowed : (c, 5) array
        Whether a contact may be in the state of that code.
    cones : (c, 2) array
        cone_n, cone_t.
    under_way, kept
        Whether a flow led here, and in which state (c,) it kept each contact; what is off stays so.
    lowest : (c,) array
        Of the gaps.
    near, creep : float
        A closed contact's gap and velocities that need no projection.
    close, slow : float
        Tolerances of gap and speed.
    tie, force_scale, acceleration_scale : float
        See `contacts.solvers.mode_solver.solve_modes`.
    doubtful : float
        Forces of a contact that comes to rest are no nearer to a bound (`contacts.modes.doubt`).
    taken : (c,) array
        To be filled: the state of every contact.
    """
    contacts = taken.shape[0]
    at = n * n + n + 1
    biases_at = at + 2 * n * contacts
    scalars = biases_at + 2 * contacts
    closed, still = np.empty(contacts, np.bool_), np.empty(contacts, np.bool_)
    options, counts = np.empty((contacts, 5), np.int64), np.empty(contacts, np.int64)
    total = 1
    for c in range(contacts):
        if kept[c] == OFF_CODE:
            closed[c] = still[c] = False
            options[c, 0], counts[c] = FREE, 1
            continue
        place = scalars + SCALARS * c
        gap, rate, slip = numbers[place], numbers[place + 1], numbers[place + 2]
        shut = gap <= close
        if not gap >= lowest[c] or (shut and rate < -slow):
            return False
        lasting = kept[c] != FREE
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
    if _doubted(codes, kept, closed, still, verdicts, doubtful):
        return False
    for c in range(contacts):
        for force in forces[agreeing, c]:
            if abs(force) > ENDLESS * force_scale:
                return False
        place = scalars + SCALARS * c
        taken[c] = OFF_CODE if kept[c] == OFF_CODE else codes[agreeing, c]
        if taken[c] != FREE and taken[c] != OFF_CODE:
            if abs(numbers[place]) > near or abs(numbers[place + 1]) > creep:
                return False
            if taken[c] == PIN and abs(numbers[place + 2]) > creep:
                return False
    return True
