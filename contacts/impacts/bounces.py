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

# The sum may be longer by this part of itself; the series leaves out what is of its square.
_LONGER = 1e-4
# Of the fastest rebound: what taking it away changes elsewhere.
_MAX_CHANGE = 10.0


def rests_of_bounces(
    setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]
) -> dict[int, float]:
    """Return how long the further bounces take, for the contacts whose need no resolving.

    They sum to ``2 v / (g_n (1 - e))`` (equation 5); the impulse of a plastic impact plus the
    weight over that time equals the exact sum of theirs. Which are skipped depends on their
    velocities alone, so that a shift of the origin does not change how many are resolved.
    """
    rests: dict[int, float] = {}
    falling: Array | None = None
    slow = setup.tolerances["speed"]
    lying = _lying(setup, snapshot, closed)
    for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
        rebound, e = contact.gap_rate, law.restitution
        if not closed[i] or not 0.0 < e < 1.0 or not slow < rebound <= setup.capture:
            continue
        if falling is None:
            falling = _falling(setup, snapshot, lying)
        if falling[i] > 0.0:
            rests[i] = 2.0 * rebound / (float(falling[i]) * (1.0 - e))
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
    if plastic.reduction is not None:
        accelerations = plastic.reduction.basis @ accelerations + plastic.reduction.drift
    n = len(state) // 2
    # Pads of compliant contacts are no coordinates of the scene.
    accelerations = accelerations[:n]
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
        last = _falling(setup, at(later, rest), lying)
        change = (still[i] - last[i] - (fast[i] - still[i]) / flying) / (3.0 * still[i])
        if not abs(change) <= max(_LONGER, setup.capture / setup.scales.speed):
            return None
        found[i] = float(rest * (1.0 + change))
    return found


def opens_in_vain(setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]) -> bool:
    """Return whether contacts open, but none of them leaves the tolerance of its gap.

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


def rest_of_passages(
    setup: SceneSetup,
    at: Callable[[Array], Snapshot],
    strike: Callable[[Snapshot, Sequence[bool]], Array],
    state: Array,
    on: int,
    other: int,
) -> float | None:
    """Sum how long a point goes to and fro through the corner of two contacts.

    On one of them the rate u of the other gap falls by a, and by b once friction has turned: a
    passage lasts ``u / a + u / sqrt(a b)`` and ends at ``-u sqrt(b / a)``. Two passages leave the
    part r of the rate: all of them last as long as these over ``1 - r``. None where the point does
    not go on so, or leaves the gap's tolerance faster than rebounds that are summed. `strike`
    returns the velocities after an impact of contacts.
    """
    rates, total = [at(state).contacts[other].gap_rate], 0.0
    size = len(state) // 2
    for _ in range(2):
        snapshot, count = at(state), len(setup.contacts)
        back = np.concatenate([state[:size], -state[size:]])
        lying = [i == on for i in range(count)]
        a, b = (float(_falling(setup, now, lying)[other]) for now in (snapshot, at(back)))
        if not (a > 0.0 and b > 0.0 and rates[-1] > 0.0):
            return None
        slow = max(rates[-1], abs(snapshot.contacts[other].slip)) <= setup.capture
        if not (slow or rates[-1] ** 2 <= 2.0 * a * setup.tolerances["gap"]):
            return None
        part = math.sqrt(b / a)
        total += rates[-1] / a * (1.0 + 1.0 / part)
        back[size:] *= part
        try:
            velocity = strike(at(back), [i in (on, other) for i in range(count)])
        except SimulationError:
            return None
        state = at(back).moved(back, velocity)
        on, other = other, on
        contacts = at(state).contacts
        if contacts[on].gap_rate > setup.tolerances["speed"]:
            return None
        rates.append(contacts[other].gap_rate)
    left = rates[-1] / rates[0]
    return total / (1.0 - left) if left < 1.0 else None


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
    """Return whether plastic contacts take no more than their bounces from the impact.

    Balls in a row pass a blow on through contacts that hardly open: what a rebound of next to
    nothing ends there is no bounce, and a plastic contact would keep the blow.
    """
    changes = [
        abs(a.gap_rate - b.gap_rate)
        for a, b, shut in zip(resolved.contacts, plastic.contacts, closed, strict=True)
        if shut
    ]
    return max(changes) <= _MAX_CHANGE * max(resolved.contacts[i].gap_rate for i in rests)
