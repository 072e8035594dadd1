"""Dead points of linkages: where constraints become dependent, and the motion may branch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from contacts.candidates import ContactLaw
from contacts.snapshot import Snapshot
from contacts.states import OPEN
from statechart.arrays import Array
from statechart.automaton.trace import Key

# Constraints that are so near to dependent, in the scene's sizes, leave forces to rounding.
_DEAD_POINT = 1e-5
# Of a unit combination: whose share is less takes no part.
_SHARE = 1e-3


def dead_point(snapshot: Snapshot, laws: Sequence[ContactLaw], moving: Key, sizes: Array) -> str:
    """Return which contacts' constraints have become dependent; "" where they are not.

    A linkage that comes to a dead point (two rods that fold on each other, each with its end on
    the floor) can go on in more than one way, and its forces are not determined there.

    Parameters
    ----------
    moving : tuple of str
        The mode of every contact.
    sizes : (n,) array
        Of the coordinates.
    """
    rows = [
        (law.name, snapshot.jacobians[i, d])
        for i, (law, state) in enumerate(zip(laws, moving, strict=True))
        if state not in OPEN
        for d in range(2 if state == "pin" else 1)
    ]
    if snapshot.held is None:
        rows = [(name, row * sizes) for name, row in rows]
    return dependent(rows)


def dependent(rows: Sequence[tuple[str, Array]]) -> str:
    """Return whose rows have become dependent, as a sentence; "" where none have.

    Parameters
    ----------
    rows : sequence of (str, (n,) array)
        Whose constraint it is, and its derivatives by the coordinates, in their sizes.
    """
    if len(rows) < 2:
        return ""
    scaled = np.array([row for _, row in rows])
    scaled /= np.linalg.norm(scaled, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(scaled)
    if len(values) == len(rows) and values[-1] > _DEAD_POINT:
        return ""
    names = dict.fromkeys(
        name for (name, _), share in zip(rows, left[:, -1], strict=True) if abs(share) > _SHARE
    )
    return (
        f"the constraints of {', '.join(names)} have become dependent (a dead point of the "
        "linkage): the motion can go on in more than one way"
    )
