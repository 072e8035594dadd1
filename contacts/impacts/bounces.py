"""Bounces too low to be resolved: how long they take, so that they can be skipped (equation 5)."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.classification import choose
from statechart.arrays import Array
from statechart.errors import SimulationError

_EPS = float(np.finfo(float).eps)
# Bounces lower than this many roundings of the gap are summed. The sum's error is of the third
# order in their speed: 1e-12 of the scene's time where coordinates are of its size.
_DIGITS = 1e8
FAST = 1e-3
"""No bounce this fast, in the scene's own speed, is summed."""
# Of the fastest rebound: what taking it away changes elsewhere.
_ELSEWHERE = 10.0


def rests_of_bounces(
    setup: SceneSetup, snapshot: Snapshot, state: Array, closed: Sequence[bool]
) -> dict[int, float]:
    """Return how long the further bounces take, for the contacts whose need no resolving.

    They sum to ``2 v / (g_n (1 - e))`` (equation 5); the impulse of a plastic impact plus the
    weight over that time equals the exact sum of theirs. A bounce is resolved as long as its
    height is known to some digits; below, its duration would be noise.

    Parameters
    ----------
    setup : SceneSetup
        The numbers of the run.
    snapshot : Snapshot
        Just after the impact.
    state : (2 n,) array
        There.
    closed : sequence of bool
        Which contacts took part in it.
    """
    rests: dict[int, float] = {}
    falling: Array | None = None
    slow, fast = setup.tolerances["speed"], FAST * setup.scales.speed
    for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
        rebound, e = contact.gap_rate, law.restitution
        if not closed[i] or not 0.0 < e < 1.0 or not slow < rebound <= fast:
            continue
        if falling is None:
            falling = _falling(setup, snapshot, closed)
        if not falling[i] > 0.0:
            continue
        # How high it bounces, against what rounding of the coordinates does to the gap.
        height = rebound**2 / (2.0 * falling[i])
        coordinates = np.abs(state[: len(state) // 2])
        rounding = _EPS * float(np.abs(snapshot.whole.jacobians[i, 0]) @ coordinates)
        if rebound <= setup.capture or height <= _DIGITS * rounding:
            rests[i] = 2.0 * rebound / (float(falling[i]) * (1.0 - e))
    return rests


def opens_in_vain(setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]) -> bool:
    """Whether contacts open, and none of them leaves the tolerance of its gap.

    Impacts in turn, each of which opens another contact, go on for ever there once they take no
    more energy than gaps get that are brought back onto their surfaces.

    Parameters
    ----------
    setup, snapshot, closed
        As for `rests_of_bounces`.
    """
    rates = np.array([contact.gap_rate for contact in snapshot.contacts])
    opening = np.asarray(closed) & (rates > setup.tolerances["speed"])
    if not opening.any():
        return False
    falling = _falling(setup, snapshot, closed)[opening]
    heights = setup.tolerances["gap"] * 2.0 * falling
    return bool((falling > 0.0).all() and (rates[opening] ** 2 < heights).all())


def _falling(setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]) -> Array:
    """Return how fast the rates of gaps fall just after an impact; nan where no mode tells."""
    slow = setup.tolerances["speed"]
    # What lies on its surface stays there: it carries its part of a body that bounces elsewhere.
    lying = [
        shut and contact.gap_rate <= slow
        for shut, contact in zip(closed, snapshot.contacts, strict=True)
    ]
    try:
        choice = choose(snapshot, setup.contacts, lying, setup.scales, setup.tie, 2.0 * slow)
    except SimulationError:
        return np.full(len(snapshot.contacts), np.nan)
    accelerations = choice.taken.accelerations
    return np.array([-float(c.jacobian[0] @ accelerations) - c.bias_n for c in snapshot.contacts])


def stands_for_bounces(
    rests: Collection[int], resolved: Snapshot, plastic: Snapshot, closed: Sequence[bool]
) -> bool:
    """Whether plastic contacts take no more than their bounces from the impact.

    Balls in a row pass a blow on through contacts that hardly open: what a rebound of next to
    nothing ends there is no bounce, and a plastic contact would keep the blow.

    Parameters
    ----------
    rests : collection of int
        The contacts taken as plastic.
    resolved, plastic : Snapshot
        After the impact by the declared laws, and with these contacts plastic.
    closed : sequence of bool
        Which contacts took part in it.
    """
    changes = [
        abs(a.gap_rate - b.gap_rate)
        for a, b, shut in zip(resolved.contacts, plastic.contacts, closed, strict=True)
        if shut
    ]
    return max(changes) <= _ELSEWHERE * max(resolved.contacts[i].gap_rate for i in rests)
