"""Signs that are dry friction as couplings, where their rates are zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.snapshot import PerContact, Snapshot
from contacts.states import COUPLING_STATES
from statechart.arrays import Array


def signs_at_rest(snapshot: Snapshot, still_below: float) -> list[int]:
    """Return the signs at rest: with rates of at most `still_below`."""
    if snapshot.signs is None:
        return []
    slips, _, limits = snapshot.signs.numbers.T
    slow = np.abs(slips) <= still_below * np.abs(snapshot.signs.rows).max(axis=1, initial=0.0)
    found: list[int] = np.flatnonzero(slow & (limits > 0.0)).tolist()
    return found


def laws_of(snapshot: Snapshot, which: Sequence[int]) -> tuple[ContactLaw, ...]:
    """Return signs as laws of couplings."""
    assert snapshot.signs is not None
    names = [snapshot.signs.frictions[k].name for k in which]
    return tuple(ContactLaw(n, COUPLING_STATES, 0.0, 1.0, 0.0, "newton", True) for n in names)


def with_signs(snapshot: Snapshot, which: Sequence[int]) -> Snapshot:
    """Return the snapshot with signs as its last couplings, and without their forces."""
    assert snapshot.signs is not None
    slips, biases, limits = snapshot.signs.numbers[which].T
    rows, reduction = snapshot.signs.rows[which], snapshot.reduction
    effect = np.sign(slips) * limits
    if reduction is None:
        return _extend(snapshot, rows, biases, limits, effect)
    whole = _extend(snapshot.unreduced, rows, biases, limits, effect)
    biases, rows = biases + rows @ reduction.drift, rows @ reduction.basis
    extended = _extend(snapshot, rows, biases, limits, effect)
    return extended._replace(reduction=replace(reduction, unreduced=whole))


def _extend(
    snapshot: Snapshot, rows: Array, biases: Array, limits: Array, effect: Array
) -> Snapshot:
    jacobians = np.stack([np.zeros_like(rows), rows], axis=1)
    contacts = [
        PerContact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, bias, jacobian)
        for bias, jacobian in zip(biases.tolist(), jacobians, strict=True)
    ]
    return snapshot._replace(
        forces=snapshot.forces + effect @ rows,
        contacts=(*snapshot.contacts, *contacts),
        jacobians=np.concatenate([snapshot.jacobians, jacobians]),
        biases=np.concatenate([snapshot.biases, np.stack([0.0 * biases, biases], axis=1)]),
        limits=np.concatenate([snapshot.limits, np.stack([limits, limits], axis=1)]),
    )
