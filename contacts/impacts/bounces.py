"""Bounces too low to be resolved: how long they take, so that they can be skipped (equation 5)."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.classification import choose
from statechart.arrays import Array
from statechart.errors import SimulationError

EPS = float(np.finfo(float).eps)
"""What a number is known to, in parts of it."""
DIGITS = 1e8
"""Bounces lower than this many round-offs of the gap are summed where no other contact closes
meanwhile. The sum's error is of the third order in their speed: 1e-12 of the scene's time where
coordinates are of its size. Elsewhere the sum is less exact: an impact at another contact does not
do to a contact that lies what it does to one that bounces."""
# Gaps that are this many times as wide as what closes them stay open.
_ROOM = 2.0
# Of the fastest rebound: what taking it away changes elsewhere.
_ELSEWHERE = 10.0


def rests_of_bounces(
    setup: SceneSetup, snapshot: Snapshot, state: Array, closed: Sequence[bool]
) -> dict[int, float]:
    """Return how long the further bounces take, for the contacts whose need no resolving.

    They sum to ``2 v / (g_n (1 - e))`` (equation 5); the impulse of a plastic impact plus the
    weight over that time equals the exact sum of theirs. A bounce is resolved as long as its
    height is known to some digits; below, its duration would be noise.
    """
    rests: dict[int, float] = {}
    falling: Array | None = None
    slow, fast = setup.tolerances["speed"], setup.fast
    lying = _lying(setup, snapshot, closed)
    for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
        rebound, e = contact.gap_rate, law.restitution
        if not closed[i] or not 0.0 < e < 1.0 or not slow < rebound <= fast:
            continue
        if falling is None:
            falling = _falling(setup, snapshot, lying)
        if not falling[i] > 0.0:
            continue
        rest = 2.0 * rebound / (float(falling[i]) * (1.0 - e))
        blur = _blur(snapshot, state, i, float(falling[i]))
        low = rebound**2 <= 2.0 * float(falling[i]) * setup.lowest
        if not low and DIGITS * blur >= 1.0:
            low = _alone(i, snapshot, lying, falling, rest)
        if rebound <= setup.capture or low:
            rests[i] = rest
    return rests


def corrected(
    rests: Mapping[int, float],
    setup: SceneSetup,
    at: Callable[[Array, float], Snapshot],
    resolved: Snapshot,
    plastic: Snapshot,
    state: Array,
    closed: Sequence[bool],
) -> dict[int, float] | None:
    """Return how long bounces take whose acceleration changes; None where they are to be resolved.

    While a contact bounces the gap falls by ``a - j t + c v``, where v is its rate: j is what the
    motion on the surface changes it by, c what drag does, or friction that turns the body. To
    first order in both the sum of equation 5, with the acceleration a at rest, is longer by
    ``1 + j R / (3 a) - c R / 6``: so that a flight lasts ``2 v / a + 4 j v^2 / (3 a^3)
    - 2 c v^2 / (3 a^2)``, and ends at ``v - 2 (j / a^2 + c / a) v^2 / 3``.

    `rests` are the sums without that, `at` gives the numbers at a state so much later. `resolved`
    and `plastic` are those after the impact by the declared laws, and with these contacts plastic,
    which leaves the bodies in `state`.
    """
    lying = _lying(setup, resolved, closed)
    try:
        accelerations = _chosen(setup, plastic, _lying(setup, plastic, closed))
    except SimulationError:
        return dict(rests)
    if plastic.held is not None:
        accelerations = plastic.held.basis @ accelerations + plastic.held.drift
    n = len(state) // 2
    fast, still = (_falling(setup, snapshot, lying) for snapshot in (resolved, plastic))
    found: dict[int, float] = {}
    for i in rests:
        if not still[i] > 0.0:
            return None
        flying = 1.0 - setup.contacts[i].restitution
        rest = 2.0 * resolved.contacts[i].gap_rate / (float(still[i]) * flying)
        later = state.copy()
        later[:n] += rest * (state[n:] + 0.5 * rest * accelerations)
        later[n:] += rest * accelerations
        end, rebound = at(later, rest), resolved.contacts[i].gap_rate
        if rebound > setup.capture and (
            any(_stops(setup, begin, end, closed) for begin in (resolved, plastic))
            or _wanders(setup, resolved, plastic, lying, i, rest)
        ):
            return None
        last = _falling(setup, end, lying)
        change = (still[i] - last[i] - (fast[i] - still[i]) / flying) / (3.0 * still[i])
        # What is left out of the series is of the square of this.
        known = math.sqrt(_blur(resolved, state, i, float(still[i])))
        if not abs(change) <= max(known, setup.capture / setup.scales.speed):
            return None
        found[i] = float(rest * (1.0 + change))
    return found


def _stops(setup: SceneSetup, snapshot: Snapshot, end: Snapshot, closed: Sequence[bool]) -> bool:
    """Whether friction stops a slip while contacts bounce: it stops elsewhere than in their sum.

    The slip after the impact may be zero, and that after the plastic one, with less friction, not.
    """
    still = 2.0 * setup.tolerances["speed"]
    return any(
        shut and abs(now.slip) > still and now.slip * last.slip <= still * abs(now.slip)
        for now, last, shut in zip(snapshot.contacts, end.contacts, closed, strict=True)
    )


def _wanders(
    setup: SceneSetup,
    resolved: Snapshot,
    plastic: Snapshot,
    lying: Sequence[bool],
    contact: int,
    rest: float,
) -> bool:
    """Whether a contact that sticks at each bounce moves on in its flights, as on a slope.

    By ``a_t (2 v / a)^2 / (2 (1 - e^2))`` in all, where their sum rests.
    """
    now = resolved.contacts[contact]
    if abs(plastic.contacts[contact].slip) > 2.0 * setup.tolerances["speed"]:
        return False
    along = float(now.jacobian[1] @ _chosen(setup, resolved, lying)) + now.bias_t
    return abs(along) * rest * rest > setup.tolerances["gap"]


def opens_in_vain(setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]) -> bool:
    """Whether contacts open, and none of them leaves the tolerance of its gap.

    Impacts in turn, each of which opens another contact, go on for ever there once they take no
    more energy than gaps get that are brought back onto their surfaces.
    """
    rates = np.array([contact.gap_rate for contact in snapshot.contacts])
    opening = np.asarray(closed) & (rates > setup.tolerances["speed"])
    if not opening.any():
        return False
    falling = _falling(setup, snapshot, _lying(setup, snapshot, closed))[opening]
    heights = setup.tolerances["gap"] * 2.0 * falling
    return bool((falling > 0.0).all() and (rates[opening] ** 2 < heights).all())


def _blur(snapshot: Snapshot, state: Array, contact: int, falling: float) -> float:
    """Return what rounding of the coordinates does to the gap, against how high it bounces."""
    height = snapshot.contacts[contact].gap_rate ** 2 / (2.0 * falling)
    coordinates = np.abs(state[: len(state) // 2])
    rounding = EPS * float(np.abs(snapshot.whole.jacobians[contact, 0]) @ coordinates)
    return rounding / height


def _alone(
    bouncing: int, snapshot: Snapshot, lying: Sequence[bool], falling: Array, rest: float
) -> bool:
    """Return whether every other contact lies, or stays open for a time, with room."""
    for i, contact in enumerate(snapshot.contacts):
        fall = abs(contact.gap_rate) * rest + 0.5 * abs(float(falling[i])) * rest * rest
        if i != bouncing and not lying[i] and not contact.gap > _ROOM * fall:
            return False
    return True


def _lying(setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]) -> list[bool]:
    """Return which contacts stay on their surfaces, and carry their part of what bounces."""
    slow = setup.tolerances["speed"]
    return [
        shut and contact.gap_rate <= slow
        for shut, contact in zip(closed, snapshot.contacts, strict=True)
    ]


def _chosen(setup: SceneSetup, snapshot: Snapshot, lying: Sequence[bool]) -> Array:
    """Return the accelerations in the mode in which these contacts are closed."""
    still = 2.0 * setup.tolerances["speed"]
    chosen = choose(snapshot, setup.contacts, lying, setup.scales, setup.tie, still)
    return chosen.taken.accelerations


def _falling(setup: SceneSetup, snapshot: Snapshot, lying: Sequence[bool]) -> Array:
    """Return how fast the rates of gaps fall while these lie; nan where no mode tells."""
    try:
        accelerations = _chosen(setup, snapshot, lying)
    except SimulationError:
        return np.full(len(snapshot.contacts), np.nan)
    return np.array([-float(c.jacobian[0] @ accelerations) - c.bias_n for c in snapshot.contacts])


def stands_for_bounces(
    rests: Collection[int], resolved: Snapshot, plastic: Snapshot, closed: Sequence[bool]
) -> bool:
    """Whether plastic contacts take no more than their bounces from the impact.

    Balls in a row pass a blow on through contacts that hardly open: what a rebound of next to
    nothing ends there is no bounce, and a plastic contact would keep the blow.
    """
    changes = [
        abs(a.gap_rate - b.gap_rate)
        for a, b, shut in zip(resolved.contacts, plastic.contacts, closed, strict=True)
        if shut
    ]
    return max(changes) <= _ELSEWHERE * max(resolved.contacts[i].gap_rate for i in rests)
