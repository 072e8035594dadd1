"""Rolling resistance in an impact: a couple of at most a length times the normal impulse.

The couple opposes the rotation that the impact leaves, and reverses none. A contact that sticks
afterwards goes on to stick, if friction gives what that takes; so does one that does not rebound
stay closed. Bounces that are summed lose the same spin as those that are resolved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import Snapshot, answer
from contacts.impacts.simultaneous import Impacts


def resisted(
    snapshot: Snapshot, laws: Sequence[ContactLaw], result: Impacts, still_below: float
) -> Impacts:
    """Return the impacts of an instant with the couples of rolling resistance.

    Speeds up to `still_below` are zero.
    """
    for place, law in enumerate(laws):
        if law.carrier < 0 or not result.impulses[law.carrier, 0] > 0.0:
            continue
        _, bound = (snapshot.limits[place - len(laws)] * result.impulses[law.carrier, 0]).tolist()
        touching, cone = snapshot.contacts[law.carrier], laws[law.carrier]
        change = result.velocity - snapshot.velocity
        slip = snapshot.contacts[place].slip + float(snapshot.jacobians[place, 1] @ change)
        if not abs(slip) > still_below or bound == 0.0:
            continue
        after = [
            rate + float(row @ change)
            for rate, row in zip((touching.gap_rate, touching.slip), touching.jacobian, strict=True)
        ]
        kept = [d for d in range(2) if abs(after[d]) <= still_below]
        # Once more without the tangent, where friction does not hold the point.
        for held in (kept, [d for d in kept if d == 0]):
            rows = np.array([snapshot.jacobians[place, 1], *(touching.jacobian[d] for d in held)])
            solved = answer(snapshot, rows, rows, np.array([-slip, *(0.0 for _ in held)]))
            if solved is None:
                continue
            part = min(1.0, bound / abs(solved[1][0])) if solved[1][0] != 0.0 else 1.0
            impulses = result.impulses.copy()
            for d, impulse in zip(held, solved[1][1:].tolist(), strict=True):
                impulses[law.carrier, d] += part * impulse
            normal, tangential = impulses[law.carrier].tolist()
            if 1 not in held or cone.cone_n * abs(tangential) <= cone.cone_t * normal:
                velocity = result.velocity + part * solved[0]
                result = replace(result, velocity=velocity, impulses=impulses)
                break
    return result
