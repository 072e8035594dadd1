"""Duration of Zeno sequences of bounces, which are skipped (equation 5)."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.classification import choose
from statechart.arrays import Array
from statechart.errors import SimulationError

# Allowed relative first-order correction of the sum; terms of its square are neglected.
_MAX_CORRECTION = 1e-4
# Round-off of the ratio of two rebounds.
_SAME_RATIO = 1e-9
# Allowed velocity changes by removing the rebounds, relative to the fastest of them.
_MAX_CHANGE = 10.0


class Bounces(NamedTuple):
    """The further bounces of a contact."""

    ratio: float  # of the rebounds of two successive bounces
    duration: float  # of all


def remaining_bounces(
    setup: SceneSetup,
    strike: Callable[[Array, float, Sequence[bool]], tuple[Snapshot, Snapshot]],
    snapshot: Snapshot,
    state: Array,
    closed: Sequence[bool],
) -> dict[int, Bounces]:
    """Return the further bounces of the contacts whose bounces are skipped.

    They last ``2 v / (g_n (1 - r))`` (equation 5, where r = e). The impulse of a plastic impact
    plus that of the weight over this time equals the sum of the impulses exactly. The criterion
    uses velocities only, so that the number of resolved bounces does not depend on the origin.

    `snapshot` is that of `state`, after an impact; `strike` returns the snapshots before and after
    an impact of contacts at a state after a time.
    """
    found: dict[int, Bounces] = {}
    speed_tolerance = setup.tolerances["speed"]
    lying = snapshot.remaining(closed, speed_tolerance)
    for i, (law, contact) in enumerate(zip(setup.contacts, snapshot.contacts, strict=True)):
        rebound, e = contact.gap_rate, law.restitution
        if not closed[i] or not 0.0 < e < 1.0 or not speed_tolerance < rebound <= setup.capture:
            continue
        try:
            accelerations = _choose_resting(setup, snapshot, lying)
            fall = float(_closing(snapshot, accelerations)[i])
            if not fall > 0.0:
                continue
            flight = 2.0 * rebound / fall
            end = _moved(snapshot, state, accelerations, flight)
            hit = [rests or k == i for k, rests in enumerate(lying)]
            before, after = strike(end, flight, hit)
            ratio = -after.contacts[i].gap_rate / before.contacts[i].gap_rate
        except SimulationError:
            continue
        if abs(ratio - e) <= _SAME_RATIO:
            ratio = e
        if 0.0 <= ratio < 1.0:
            found[i] = Bounces(ratio, flight / (1.0 - ratio))
    return found


def correct_durations(
    bounces: Mapping[int, Bounces],
    setup: SceneSetup,
    at: Callable[[Array, float], Snapshot],
    resolved: Snapshot,
    plastic: Snapshot,
    state: Array,
    closed: Sequence[bool],
) -> dict[int, float] | None:
    """Return the duration of bounces under a varying acceleration; None if they must be resolved.

    The gap accelerates towards the surface by ``a - j t + c v``, where v is its rate, j is due to
    the motion along the surface, and c to drag, or to friction that turns the body. To first order
    in both a flight lasts ``2 v / a + 4 j v^2 / (3 a^3) - 2 c v^2 / (3 a^2)`` and ends at
    ``v - 2 (j / a^2 + c / a) v^2 / 3``, so that the sum R of equation 5 is multiplied by
    ``1 + j R / (3 a) - c R / 6``.

    `bounces` have the uncorrected sums, `at` is the snapshot at a state after a time. `resolved`
    and `plastic` are the snapshots after the impact with and without rebounds; the plastic impact
    leads to `state`.
    """
    speed_tolerance = setup.tolerances["speed"]
    lying = resolved.remaining(closed, speed_tolerance)
    resting = plastic.remaining(closed, speed_tolerance)
    try:
        accelerations = _choose_resting(setup, plastic, resting)
    except SimulationError:
        return {i: one.duration for i, one in bounces.items()}
    resolved_fall, resting_fall = (
        _closing_accelerations(setup, snapshot, lying) for snapshot in (resolved, plastic)
    )
    corrected_durations: dict[int, float] = {}
    for i, (ratio, _) in bounces.items():
        if not resting_fall[i] > 0.0:
            return None
        loss = 1.0 - ratio
        duration = 2.0 * resolved.contacts[i].gap_rate / (float(resting_fall[i]) * loss)
        state_after = _moved(plastic, state, accelerations, duration)
        final_fall = _closing_accelerations(setup, at(state_after, duration), lying)
        change = resting_fall[i] - final_fall[i] - (resolved_fall[i] - resting_fall[i]) / loss
        change /= 3.0 * resting_fall[i]
        if not abs(change) <= max(_MAX_CORRECTION, setup.capture / setup.scales.speed):
            return None
        corrected_durations[i] = float(duration * (1.0 + change))
    return corrected_durations


def _moved(snapshot: Snapshot, state: Array, accelerations: Array, duration: float) -> Array:
    if snapshot.reduction is not None:
        accelerations = snapshot.reduction.basis @ accelerations + snapshot.reduction.drift
    n, later = snapshot.size, state.copy()
    # Without the pads of compliant contacts, which are no coordinates of the scene.
    accelerations = accelerations[:n]
    later[:n] += duration * (state[n : 2 * n] + 0.5 * duration * accelerations)
    later[n : 2 * n] += duration * accelerations
    return later


def reopens_immediately(setup: SceneSetup, snapshot: Snapshot, closed: Sequence[bool]) -> bool:
    """Return whether contacts open and none of them leaves the tolerance of its gap.

    Alternating impacts, each of which opens another contact, would not end once they dissipate less
    energy than the projection of the gaps adds.
    """
    rates = np.array([contact.gap_rate for contact in snapshot.contacts])
    lying = snapshot.remaining(closed, setup.tolerances["speed"])
    opening = np.asarray(closed) & (rates > setup.tolerances["speed"])
    if not opening.any():
        return False
    fall = _closing_accelerations(setup, snapshot, lying)[opening]
    heights = setup.tolerances["gap"] * 2.0 * fall
    return bool((fall > 0.0).all() and (rates[opening] ** 2 < heights).all())


def rest_of_passages(
    setup: SceneSetup,
    at: Callable[[Array], Snapshot],
    strike: Callable[[Snapshot, Sequence[bool]], Array],
    state: Array,
    supporting: int,
    opening: int,
) -> float | None:
    """Return the total duration of a point's passages to and fro through a corner, or None.

    While `supporting` is closed the rate u of the `opening` gap falls by a, and by b after friction
    has reversed: a passage lasts ``u / a + u / sqrt(a b)`` and ends at ``-u sqrt(b / a)``. If two
    passages reduce the rate by the factor r, the total is their duration over ``1 - r``. `strike`
    returns the velocities after an impact of contacts.
    """
    first = rate = at(state).contacts[opening].gap_rate
    size, every, total = len(setup.scales.coordinates), range(len(setup.contacts)), 0.0
    both = [i in (supporting, opening) for i in every]
    for _ in range(2):
        back = state.copy()
        back[size : 2 * size] *= -1.0
        resting = [i == supporting for i in every]
        a, b = (
            float(_closing_accelerations(setup, at(one), resting)[opening]) for one in (state, back)
        )
        if not (a > 0.0 and b > 0.0 and rate > 0.0):
            return None
        is_slow = max(rate, abs(at(state).contacts[opening].slip)) <= setup.capture
        if not (is_slow or rate**2 <= 2.0 * a * setup.tolerances["gap"]):
            return None
        ratio = math.sqrt(b / a)
        total += rate / a * (1.0 + 1.0 / ratio)
        back[size : 2 * size] *= ratio
        try:
            state = at(back).moved(back, strike(at(back), both))
        except SimulationError:
            return None
        supporting, opening = opening, supporting
        contacts = at(state).contacts
        if contacts[supporting].gap_rate > setup.tolerances["speed"]:
            return None
        rate = contacts[opening].gap_rate
    return total / (1.0 - rate / first) if rate < first else None


def _choose_resting(setup: SceneSetup, snapshot: Snapshot, lying: Sequence[bool]) -> Array:
    return choose(setup, snapshot, lying).taken.accelerations


def _closing_accelerations(setup: SceneSetup, snapshot: Snapshot, lying: Sequence[bool]) -> Array:
    """Return the closing accelerations of the gaps with these contacts closed; nan if undefined."""
    try:
        return _closing(snapshot, _choose_resting(setup, snapshot, lying))
    except SimulationError:
        return np.full(len(snapshot.contacts), np.nan)


def _closing(snapshot: Snapshot, accelerations: Array) -> Array:
    return -(snapshot.jacobians[:, 0] @ accelerations) - snapshot.biases[:, 0]


def stands_for_bounces(
    bouncing: Collection[int], resolved: Snapshot, plastic: Snapshot, closed: Sequence[bool]
) -> bool:
    """Return whether the plastic impact changes little more than the rebounds themselves.

    A row of balls transmits a blow through contacts that hardly open: a plastic contact would stop
    the blow.
    """
    pairs = compress(zip(resolved.contacts, plastic.contacts, strict=True), closed)
    change = max(abs(a.gap_rate - b.gap_rate) for a, b in pairs)
    return change <= _MAX_CHANGE * max(resolved.contacts[i].gap_rate for i in bouncing)
