"""Preallocated workspace of the rigid-body time step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.collision_detection.active_contacts import ActiveContacts
from contacts.collision_detection.body_numbers import BodyNumbers, WarmStart
from contacts.collision_detection.broad_phase import Grid
from contacts.collision_detection.midpoint import Midpoint
from contacts.solvers.contact_rows import ContactRows
from statechart.arrays import Array, Bools, Ints


class Workspace(NamedTuple):
    """Workspace of a step."""

    mid: Midpoint
    active: ActiveContacts
    grid: Grid
    # (c, 2): impulses of the step, and their force parts.
    pressed: Array
    steady: Array
    bounces: Ints  # (c,): 1 with restitution.
    known: Array  # (c,): slip error of the island's impulses.
    contacts: ContactRows  # Of one island.
    # Its `Island`: (7, c, 2), (2, c), (c,), (c,), (c, 3, 2).
    island: Array
    flags: Bools
    kinds: Ints
    slip_directions: Ints
    frictions: Array
    # See `contacts.rigid_bodies.island_step`.
    parents: Ints  # shape (b,)
    local: Ints  # shape (b,)
    begins: Ints  # shape (b + 1,)
    order: Ints  # shape (c,)
    spare: Ints  # shape (c,)
    pads: Ints  # shape (c,)
    borne: Array  # (b,): largest normal impulse on a body.
    earlier: WarmStart  # Before the last step.
    # (c, 4): limits of couplings (see `contacts.collision_detection.couplings`).
    limits: Array
    # (2,): energy that unclosed joints add in a step, relative to the kinetic energy; 1 if the
    # step can be split.
    joint_energy: Array

    @classmethod
    def of(cls, numbers: BodyNumbers, warm: WarmStart) -> Workspace:
        """Allocate a workspace of the capacity of a warm start."""
        count, most = len(numbers.sizes), len(warm.keys)
        return cls(
            Midpoint.allocate(numbers), ActiveContacts.allocate(most),
            Grid.allocate(len(numbers.pieces.sizes), most), np.empty((most, 2)),
            np.empty((most, 2)), np.empty(most, np.int64), np.empty(most),
            ContactRows.allocate(most, count, numbers.padded, numbers.links.rows),
            np.empty((7, most, 2)), np.empty((2, most), np.bool_), np.empty(most, np.int64),
            np.empty(most, np.int64), np.empty((most, 3, 2)), np.empty(count, np.int64),
            np.empty(count, np.int64), np.empty(count + 1, np.int64), np.empty(most, np.int64),
            np.empty(most, np.int64), np.empty(most, np.int64), np.empty(count),
            warm.copy(), np.zeros((len(numbers.couplings.holds), 4)), np.zeros(2),
        )  # fmt: skip
