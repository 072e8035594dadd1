"""The impact of a contact that is closed alone, compiled; see `impact_jump` for all others."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.impacts.path import ENDED, strike
from contacts.modes.fast_classification import usual
from contacts.states import FREE
from statechart.arrays import Array, Bools, Ints, Ints32
from statechart.kernels.jit import part
from statechart.kernels.tapes import tape_values

# Numbers of a contact behind all Jacobians and biases: gap, its rate, slip, point, tangent.
_SCALARS = 7
# An impact that raises the energy by more than this part of the terms of its work is told of.
_RAISES = 1e-9


class SceneWatch(NamedTuple):
    """What the instants of a run take of it (see `contacts.modes.fast_classification.usual`).

    Attributes
    ----------
    numbers : (9,) array of int64
        Tape of the scene's numbers.
    allowed : (c, 5) array of bool
    cones : (c, 2) array
    restitution : (c,) array
    meanings : (c,) array of int64
        What it means; -1 where the impact is none of a path.
    near, creep, gap, speed, tie, force, acceleration, short : float
    fast : float
        Rebounds slower than this may stand for those that follow.
    """

    numbers: NDArray[np.int64]
    allowed: Bools
    cones: Array
    restitution: Array
    meanings: Ints
    near: float
    creep: float
    gap: float
    speed: float
    tie: float
    force: float
    acceleration: float
    short: float
    fast: float


@part
def classified(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    scene: SceneWatch,
    parameters: Array,
    state: Array,
    time: float,
    under_way: bool,
    kept: Ints,
    numbers: Array,
    taken: Ints,
) -> bool:
    """Classify every contact; False where the instant is not a usual one."""
    return usual(
        code,
        constants,
        outputs,
        state,
        parameters,
        time,
        scene.allowed,
        scene.cones,
        under_way,
        kept,
        scene.near,
        scene.creep,
        scene.gap,
        scene.speed,
        scene.tie,
        scene.force,
        scene.acceleration,
        numbers,
        taken,
    )


@part
def _struck(scene: SceneWatch, kept: Ints, numbers: Array, first: int) -> int:
    """Return the contact that strikes, where no other is closed and all can open; else -1."""
    place = -1
    for c in range(kept.shape[0]):
        gap, rate = numbers[first + _SCALARS * c], numbers[first + _SCALARS * c + 1]
        if kept[c] != FREE or not scene.allowed[c, FREE] or not gap >= -scene.gap:
            return -1
        if gap <= scene.gap:
            if place >= 0 or not rate < -scene.speed or scene.meanings[c] < 0:
                return -1
            place = c
    return place


@part
def hit(
    code: Ints32,
    constants: Array,
    outputs: Ints32,
    scene: SceneWatch,
    parameters: Array,
    state: Array,
    time: float,
    kept: Ints,
    numbers: Array,
    impulse: Array,
    taken: Ints,
) -> tuple[int, int]:
    """Let a contact be hit.

    Parameters
    ----------
    state : (n,) array
        Before; brought up to date.
    kept : (c,) array of int64
        How the flow kept every contact.
    numbers : (o,) array
        The scene's, there; brought up to date.
    impulse : (2,), taken : (c,) array
        To be filled: the impulse on the body, the state of every contact after it.

    Returns
    -------
    contact : int
        That was hit; -1, and nothing changed but the numbers, where this is not so simple.
    path : int
        Code of its path.
    """
    half, contacts = state.shape[0] // 2, kept.shape[0]
    at = half * half + half + 1
    scalars = at + (2 * half + 2) * contacts
    c = _struck(scene, kept, numbers, scalars)
    if c < 0:
        return -1, 0
    place, begin = scalars + _SCALARS * c, at + 2 * half * c
    approach, slip = numbers[place + 1], numbers[place + 2]
    after = state.copy()
    jacobian = numbers[begin : begin + 2 * half].reshape((2, half))
    e = scene.restitution[c]
    status, normal, tangential, path, _, _ = strike(
        numbers[: half * half].reshape((half, half)),
        jacobian,
        approach,
        slip,
        scene.cones[c],
        scene.meanings[c],
        e,
        False,
        after[half:],
    )
    if status != ENDED:
        return -1, 0
    rise = glide = 0.0
    for i in range(half):
        change = after[half + i] - state[half + i]
        # As impacts of several contacts at one instant are added up.
        after[half + i] = state[half + i] + change
        rise += jacobian[0, i] * change
        glide += jacobian[1, i] * change
    work = normal * (approach + 0.5 * rise) + tangential * (slip + 0.5 * glide)
    if work > _RAISES * (normal * abs(approach) + abs(tangential * slip)):
        return -1, 0
    tape_values(code, constants, outputs, after, parameters, time, numbers)
    rebound = numbers[place + 1]
    if 0.0 < e < 1.0 and scene.speed < rebound <= scene.fast:
        return -1, 0
    if rebound <= scene.speed:
        flying = np.full(contacts, FREE)
        if not classified(
            code, constants, outputs, scene, parameters, after, time, False, flying, numbers, taken
        ):
            return -1, 0
        if e == 0.0 and taken[c] == FREE:
            return -1, 0
    else:
        taken[:] = FREE
    state[:] = after
    impulse[0], impulse[1] = normal, tangential
    return c, path
