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
    """Workspace of a step; only `worst` keeps its content between steps."""

    mid: Midpoint
    active: ActiveContacts
    grid: Grid
    # (c, 2): impulses of the step, and those of them that are forces.
    pressed: Array
    steady: Array
    bounces: Ints  # (c,): 1: restitution is asked for.
    known: Array  # (c,): slip that the impulses of the island may have missed.
    contacts: ContactRows  # Those of an island.
    # Those of its `Island`: (7, c, 2), (2, c), (c,), (c,), and (c, 3, 2).
    island: Array
    flags: Bools
    kinds: Ints
    ways: Ints
    frictions: Array
    # See `contacts.rigid_bodies.island_step`.
    parents: Ints  # shape (b,)
    local: Ints  # shape (b,)
    begins: Ints  # shape (b + 1,)
    order: Ints  # shape (c,)
    spare: Ints  # shape (c,)
    pads: Ints  # shape (c,)
    borne: Array  # (b,): the largest impulse that presses a body.
    # (4,): what lasts: of all islands whose impulses missed what was allowed, that with the largest
    # ratio of masses: this ratio, its lightest and its heaviest body, the residual.
    worst: Array
    earlier: WarmStart  # The memory before the last step.
    # (2,): the part of the energy of motion that joints add in a step, for which no impulses were
    # found that close them; and 1 where it can be taken in parts.
    joint_energy: Array

    @classmethod
    def of(cls, numbers: BodyNumbers, warm: WarmStart) -> Workspace:
        """Return room for as many contacts as are remembered."""
        count, most = len(numbers.sizes), len(warm.keys)
        return cls(
            Midpoint.allocate(numbers),
            ActiveContacts.allocate(most),
            Grid.allocate(len(numbers.pieces.sizes), most),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty(most, np.int64),
            np.empty(most),
            ContactRows.allocate(most, count, numbers.padded, numbers.links.rows),
            np.empty((7, most, 2)),
            np.empty((2, most), np.bool_),
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty((most, 3, 2)),
            np.empty(count, np.int64),
            np.empty(count, np.int64),
            np.empty(count + 1, np.int64),
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty(count),
            np.zeros(4),
            warm.copy(),
            np.zeros(2),
        )
