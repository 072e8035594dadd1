"""Conditions and impacts that are simple, compiled; see `impact_jump` for all others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import SCALARS
from contacts.impacts.impact import ENDED, MEANINGS, RAISES, strike
from contacts.impacts.impulses import strike_group
from contacts.modes.classification import ModeRules, classify
from contacts.scene.parts import MOREAU
from contacts.states import FREE, OFF_CODE, PIN
from statechart.arrays import Array, Bools, Ints
from statechart.engines.mode_table import Program, tape_of
from statechart.kernels.copies import put
from statechart.kernels.jit import part
from statechart.kernels.tapes import tape_values


class SceneWatch(NamedTuple):
    """Constants of a run for compiled instants (see `contacts.modes.classification.classify`)."""

    # (9,): tapes of the scene's numbers, and of the margins of contacts' conditions.
    numbers: NDArray[np.int64]
    conditions: NDArray[np.int64]
    nodes: Ints  # (m, 3): trees of the contacts' conditions; see `contacts.dynamics.gates.tree`.
    # (2 k + c,): places in `Watch.bands` of the margins that fall as conditions cease to hold, of
    # those that do as they begin to, and as gaps of contacts that are off open; -1 for none.
    slots: Ints
    sizes: Array  # (n + 1,): of the state, and of time.
    relative: float  # What is so small in parts of its terms is zero.
    allowed: Bools  # shape (c, 5)
    cones: Array  # shape (c, 2)
    restitution: Array  # shape (c,)
    meanings: Ints  # (c,): what it means; -1 where the impact is none of a path.
    offsets: Ints  # (c,): places of the gaps' offsets among the parameters.
    near: float
    creep: float
    gap: float
    speed: float
    tie: float
    doubtful: float
    force: float
    acceleration: float
    short: float
    capture: float  # Rebounds slower than this may stand for those that follow.


@part
def rules_of(scene: SceneWatch) -> ModeRules:
    """Return what of a scene decides the modes of its contacts."""
    return ModeRules(
        scene.allowed, scene.cones, scene.near, scene.creep, scene.gap, scene.speed, scene.tie,
        scene.doubtful, scene.force, scene.acceleration,
    )  # fmt: skip


@part
def classified(
    scene: SceneWatch,
    numbers: Array,
    n: int,
    under_way: bool,
    kept: Ints,
    lowest: Array,
    taken: Ints,
) -> bool:
    """Classify every contact; False where the instant is not a usual one."""
    return classify(rules_of(scene), numbers, n, under_way, kept, lowest, taken)


@part
def _closed(
    scene: SceneWatch, kept: Ints, numbers: Array, first: int, group: Ints
) -> tuple[int, int]:
    """List the closed contacts; return how many, and which of them strikes first, else -1.

    None strikes where a contact that the flow kept closed has to be brought back.
    """
    count, striking = 0, -1
    for c in range(kept.shape[0]):
        if kept[c] == OFF_CODE:
            continue
        place = first + SCALARS * c
        gap, rate, slip = numbers[place], numbers[place + 1], numbers[place + 2]
        off = abs(gap) > scene.near or abs(rate) > scene.creep
        if kept[c] != FREE and (off or (kept[c] == PIN and abs(slip) > scene.creep)):
            return count, -1
        if not gap >= -scene.gap or not scene.allowed[c, FREE]:
            return count, -1
        if gap <= scene.gap:
            group[count] = c
            count += 1
            if striking < 0 and rate < -scene.speed:
                striking = c
    return count, striking


@part
def _alone(
    scene: SceneWatch, mass: Array, numbers: Array, at: int, place: int, c: int,
    velocity: Array, impulse: Array,
) -> int:  # fmt: skip
    """Let one contact be hit by its own law; return the code of its path, 0 where it has none."""
    if scene.meanings[c] < 0:
        return 0
    n, before = velocity.shape[0], velocity.copy()
    jacobian = numbers[at + 2 * n * c : at + 2 * n * (c + 1)].reshape((2, n))
    approach, slip = numbers[place + 1], numbers[place + 2]
    status, normal, tangential, path, _, _ = strike(
        mass,
        jacobian,
        (approach, slip),
        scene.cones[c],
        scene.meanings[c],
        scene.restitution[c],
        False,
        velocity,
    )
    if status != ENDED:
        return 0
    rise = glide = 0.0
    for i in range(n):
        change = velocity[i] - before[i]
        # As impacts of several contacts at one instant are added up.
        velocity[i] = before[i] + change
        rise += jacobian[0, i] * change
        glide += jacobian[1, i] * change
    work = normal * (approach + 0.5 * rise) + tangential * (slip + 0.5 * glide)
    if work > RAISES * (normal * abs(approach) + abs(tangential * slip)):
        return 0
    impulse[c, 0], impulse[c, 1] = normal, tangential
    return path


@part
def hit(
    program: Program,
    scene: SceneWatch,
    parameters: Array,
    state: Array,
    time: float,
    kept: Ints,
    numbers: Array,
    impulse: Array,
    taken: Ints,
) -> tuple[int, int, int]:
    """Let contacts be hit.

    Parameters
    ----------
    state : (n,) array
        Before; brought up to date.
    kept : (c,) array of int64
        How the flow kept every contact.
    numbers : (o,) array
        The scene's, there; brought up to date.
    impulse : (c, 2), taken : (c,) array
        To be filled: the impulse on the bodies at every contact, and its state after it.

    Returns
    -------
    contact : int
        The first that strikes; -1, and nothing changed but the numbers, where this is not so
        simple.
    path : int
        Code of its path, or of the states of several (see `strike_group`).
    group : int
        These several, a bit each; 0 where it is alone.
    """
    n, contacts = state.shape[0] // 2, kept.shape[0]
    at = n * n + n + 1
    scalars = at + (2 * n + 2) * contacts
    group = np.empty(contacts, np.int64)
    count, c = _closed(scene, kept, numbers, scalars, group)
    # The bits of a group are those of an int32.
    if c < 0 or contacts > 31:
        return -1, 0, 0
    place = scalars + SCALARS * c
    after, mass = state.copy(), numbers[: n * n].reshape((n, n))
    impulse[:] = 0.0
    bits = 0
    if count == 1:
        path = _alone(scene, mass, numbers, at, place, c, after[n:], impulse)
    else:
        path = strike_group(
            rules_of(scene), numbers, scene.restitution, group[:count], after[n:], impulse
        )
        for k in range(count):
            bits |= 1 << group[k]
    if path == 0:
        return -1, 0, 0
    energy = numbers[at - 1]
    code, constants, outputs, _, _ = tape_of(program, scene.numbers)
    tape_values(code, constants, outputs, after, parameters, time, numbers)
    lowest, resting, slowly = np.full(contacts, -scene.gap), False, False
    for k in range(count):
        rate, e = numbers[scalars + SCALARS * group[k] + 1], scene.restitution[group[k]]
        if rate < -scene.speed:
            return -1, 0, 0
        slowly = slowly or (0.0 < e < 1.0 and scene.speed < rate <= 2.0 * scene.capture)
        resting = resting or rate <= scene.speed
    if slowly:
        return -1, 0, 0
    if count > 1 and numbers[at - 1] >= energy:
        return -1, 0, 0
    for i in range(contacts):
        taken[i] = OFF_CODE if kept[i] == OFF_CODE else FREE
    if resting:
        flying = taken.copy()
        if not classified(scene, numbers, n, False, flying, lowest, taken):
            return -1, 0, 0
    put(after, state)
    return c, path, bits


def meaning(law: ContactLaw) -> int:
    """Return what restitution means where an impact goes along a path."""
    return -1 if law.impact == MOREAU else MEANINGS[law.impact]
