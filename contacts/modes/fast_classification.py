"""The usual instant: no impact, nothing to be brought back, and one mode that agrees.

One compiled call then says which; everything else is left to the laws, which go through it step by
step (`contacts.event_driven.laws`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import cones
from contacts.dynamics.projection import landing
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SCALARS, SnapshotTape
from contacts.solvers.mode_solver import solve_modes
from contacts.states import CODES, FREE, OFF, OFF_CODE, OPEN, PIN, SLIDE, SLIDE_MINUS, SLIDE_PLUS
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.trace import Key
from statechart.kernels.jit import part, seldom

_NAMES = {code: name for name, code in CODES.items() if name != OFF}


class ModeRules(NamedTuple):
    """Inputs of the classification of contacts.

    Attributes
    ----------
    allowed : (c, 5) array
        Whether a contact may be in the state of that code.
    cones : (c, 2) array
        cone_n, cone_t.
    near, creep : float
        A closed contact's gap and velocities that need no projection.
    gap, speed : float
        Their tolerances.
    tie, force, acceleration : float
        See `contacts.solvers.mode_solver.solve_modes`; the last two are the scales.
    doubtful : float
        Forces of a contact that comes to rest are no nearer to a bound
        (`contacts.modes.force_uncertainty`).
    """

    allowed: Bools
    cones: Array
    near: float
    creep: float
    gap: float
    speed: float
    tie: float
    doubtful: float
    force: float
    acceleration: float


def mode_rules(setup: SceneSetup) -> ModeRules:
    """Return the rules of a run."""
    return ModeRules(
        allowed(tuple([law.states for law in setup.contacts])),
        cones(setup.contacts),
        *landing(setup.tolerances),
        setup.tolerances["gap"],
        setup.tolerances["speed"],
        setup.tie,
        setup.doubtful,
        setup.scales.force,
        setup.scales.acceleration,
    )


def fast_mode(
    setup: SceneSetup, tape: SnapshotTape, state: Array, time: float, flow: Key | None
) -> tuple[Key, float] | None:
    """Return the mode that the state calls for and the energy; None where that is not as simple.

    `flow` is the mode that led here, None at the start of a run. The scene has no joints.
    """
    numbers, size = tape.tape.at(state, setup.values, time), tape.size
    count = len(setup.contacts)
    codes, kept = np.empty(count, np.int64), _kept(flow, count)
    rules = mode_rules(setup)
    lowest = np.where(kept == FREE, 0.0, -rules.near)
    if not classify(rules, numbers, size, flow is not None, kept, lowest, codes):
        return None
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
def _kept(flow: Key | None, count: int) -> Ints:
    """Return the state in which a flow, where one led here, kept every contact."""
    return np.array([FREE if s in OPEN else CODES[s] for s in flow or [OFF] * count], np.int64)


# In the scene's forces: beyond, a sliding contact may bear what only rounding keeps finite.
ENDLESS = 1e13
# More combinations of states are left to the laws.
_MAX_COMBINATIONS = 64


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


@seldom
def classify(
    rules: ModeRules,
    numbers: Array,
    n: int,
    under_way: bool,
    kept: Ints,
    lowest: Array,
    taken: Ints,
) -> bool:
    """Classify every contact; False where that is not as simple.

    Parameters
    ----------
    rules : ModeRules
    numbers : (o,) array
        The scene's.
    n : int
        Number of coordinates.
    under_way, kept
        Whether a flow led here, and in which state (c,) it kept each contact; what is off stays so.
    lowest : (c,) array
        Of the gaps.
    taken : (c,) array
        To be filled: the state of every contact.
    """
    allowed, near, creep, slow, tie = (
        rules.allowed, rules.near, rules.creep, rules.speed, rules.tie,
    )  # fmt: skip
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
        shut = gap <= rules.gap
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
    if total == 0 or total > _MAX_COMBINATIONS:
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
        rules.cones,
        codes,
        closed,
        still,
        rules.force,
        rules.acceleration,
        status,
        np.empty((total, n)),
        forces,
        verdicts,
        tie,
    )
    if redundant > 0 or agreeing < 0 or not verdicts[agreeing, 0] < -tie:
        return False
    if _doubted(codes, kept, closed, still, verdicts, rules.doubtful):
        return False
    for c in range(contacts):
        for force in forces[agreeing, c]:
            if abs(force) > ENDLESS * rules.force:
                return False
        place = scalars + SCALARS * c
        taken[c] = OFF_CODE if kept[c] == OFF_CODE else codes[agreeing, c]
        if taken[c] != FREE and taken[c] != OFF_CODE:
            if abs(numbers[place]) > near or abs(numbers[place + 1]) > creep:
                return False
            if taken[c] == PIN and abs(numbers[place + 2]) > creep:
                return False
    return True
