"""Which product modes of a scene are kinematically possible at a configuration."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.feasibility import DRIVEN, feasible_modes, without_direction
from statechart.arrays import Array
from statechart.automaton.feasibility import Feasibility
from statechart.automaton.regions import Region
from statechart.errors import StatechartError


def judged(
    regions: Sequence[Region], setup: SceneSetup, snapshot: Snapshot, failing: Sequence[str]
) -> Feasibility:
    """Judge every product mode of a scene by the velocities that it asks for.

    Contacts that do not touch at the configuration, or are off, are judged as if they did and were
    not: the remarks say which. Regions that are no contact's ask for no velocity.

    Raises
    ------
    StatechartError
        If a contact has no direction there (a point at the centre of a circle).
    """
    names = [law.name for law in setup.contacts]
    options = [law.states for law in setup.contacts]
    jacobians = snapshot.jacobians
    driven = _driven(snapshot)
    if driven.any():
        further = np.zeros((1, 2, jacobians.shape[2] + 1))
        further[0, 0, -1] = 1.0
        jacobians = np.concatenate(
            [np.concatenate([jacobians, driven[:, :, None]], axis=2), further]
        )
        names, options = [*names, DRIVEN], [*options, ("free",)]
    if not np.isfinite(jacobians).all():
        raise StatechartError(
            "the contacts have no direction at this configuration: give another one"
        )
    found = feasible_modes(jacobians, options, names)
    count = len(setup.contacts)
    directed = {mode.states[:count]: mode.reason for mode in found}
    undirected = {key[:count]: reason for key, reason in without_direction(found).items()}
    places = [[region.name for region in regions].index(n) for n in names[:count]]
    declared = (dict.fromkeys(map(region.declared, region.states)) for region in regions)
    return Feasibility(
        {k: directed[tuple(k[i] for i in places)] for k in product(*(r.states for r in regions))},
        {k: undirected[tuple(k[i] for i in places)] for k in product(*declared)},
        _remarks(setup, snapshot, failing),
    )


def _driven(snapshot: Snapshot) -> Array:
    """Return the velocities (c, 2) of the contacts while all that is not driven rests."""
    rates = np.array([(contact.gap_rate, contact.slip) for contact in snapshot.contacts])
    moved = snapshot.jacobians @ snapshot.velocity
    found: Array = rates.reshape(-1, 2) - moved
    sizes = np.abs(snapshot.jacobians) @ np.abs(snapshot.velocity)
    # What is left of a difference of equal numbers is rounding.
    return np.where(np.abs(found) > 1e-12 * (sizes + np.abs(moved)), found, 0.0)


def _remarks(setup: SceneSetup, snapshot: Snapshot, failing: Sequence[str]) -> tuple[str, ...]:
    near = setup.tolerances["gap"]
    found = []
    for law, contact, why in zip(setup.contacts, snapshot.contacts, failing, strict=True):
        if why:
            found.append(f"{law.name} is off, as {why!r} does not hold: judged as if it were on")
        elif contact.gap > near:
            found.append(f"{law.name} does not touch (gap {contact.gap:.6g}): judged as if it did")
        elif contact.gap < -near:
            found.append(f"{law.name} is {-contact.gap:.6g} inside its surface")
    if snapshot.held is not None:
        apart = float(np.abs(snapshot.held.joints.gaps).max(initial=0.0))
        if apart > near:
            found.append(f"joints are apart by up to {apart:.6g}")
    return tuple(found)
