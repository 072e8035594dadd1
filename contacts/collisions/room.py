"""Where steps of bodies work."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.detection.body_numbers import BodyNumbers, Memory
from contacts.detection.broad_phase import Grid
from contacts.detection.look import Look
from contacts.detection.touches import Touches
from contacts.solvers.contact_rows import ContactRows
from statechart.arrays import Array, Bools, Ints


class Room(NamedTuple):
    """Where steps work; of it `worst` alone lasts.

    Attributes
    ----------
    look : Look
    touches : Touches
    grid : Grid
    pressed : (c, 2), steady : (c, 2)
        Impulses of the step, and those of them that are forces.
    bounces : (c,) array of int
        1: restitution is asked for.
    known : (c,)
        Slip that the impulses of the island may have missed.
    contacts : ContactRows
        Those of an island.
    island : (5, c, 2)
        Their velocities before the step and without impulses, what is wanted, and impulses; and
        those of impacts in turn.
    rebounds : (c,) array of bool
        Which of them do.
    parents, local : (b,) array of int, begins : (b + 1,), order, spare : (c,)
        See `contacts.collisions.islands`.
    borne : (b,)
        The largest impulse that presses a body.
    worst : (4,)
        What lasts: of all islands whose impulses missed what was allowed, that with the largest
        ratio of masses: this ratio, its lightest and its heaviest body, the residual.
    earlier : Memory
        What was remembered before the last step.
    apart : (2,)
        The part of the energy of motion that joints add in a step, for which no impulses were
        found that close them; and 1 where it can be taken in parts.
    """

    look: Look
    touches: Touches
    grid: Grid
    pressed: Array
    steady: Array
    bounces: Ints
    known: Array
    contacts: ContactRows
    island: Array
    rebounds: Bools
    parents: Ints
    local: Ints
    begins: Ints
    order: Ints
    spare: Ints
    borne: Array
    worst: Array
    earlier: Memory
    apart: Array

    @classmethod
    def of(cls, numbers: BodyNumbers, memory: Memory) -> Room:
        """Return room for as many contacts as are remembered."""
        count, most = len(numbers.sizes), len(memory.keys)
        return cls(
            Look.room(numbers),
            Touches.room(most),
            Grid.room(len(numbers.pieces.sizes), most),
            np.empty((most, 2)),
            np.empty((most, 2)),
            np.empty(most, np.int64),
            np.empty(most),
            ContactRows.room(most, count),
            np.empty((5, most, 2)),
            np.empty(most, np.bool_),
            np.empty(count, np.int64),
            np.empty(count, np.int64),
            np.empty(count + 1, np.int64),
            np.empty(most, np.int64),
            np.empty(most, np.int64),
            np.empty(count),
            np.zeros(4),
            memory.copy(),
            np.zeros(2),
        )
