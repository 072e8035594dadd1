"""Whether forces grow so fast with places and speeds that steps swing ever farther under them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from contacts.detection.applied import ForceProgram
from statechart.arrays import Array, Ints
from statechart.errors import StepTooLarge
from statechart.formulas.tape import Tape

UNSTABLE = 4.0
"""Forces are those in the middle of a step, at the speeds before it. Under a stiffness k and a
damping d, by mass, steps turn what moves around ever farther where h^2 k + 2 h d is above this."""
# Radians, or parts of a speed, that a step may take.
_FINE = 0.1
# Of the size of a body: by so much places, and what they move in a step, are changed to see how
# forces do.
_CHANGE = 1e-6
# Directions are one to within this part of the largest; so many coordinates are looked at.
_DEPENDENT, _MOST = 1e-9, 1500


class Forces(NamedTuple):
    """Forces on bodies: which bodies (f,), and three formulas for each; values of parameters."""

    bodies: Ints
    tape: Tape
    values: Array

    @property
    def program(self) -> ForceProgram:
        """As steps run it."""
        tape = self.tape
        return ForceProgram(self.bodies, tape.code, tape.constants, tape.outputs, self.values)


class Stiffness(NamedTuple):
    """What a step of forces does per change, of coordinates whose squared rates are energies.

    Attributes
    ----------
    places, rates : (n, n) array
        ``h^2 K`` and ``2 h D``: less force where bodies have moved, and are faster.
    """

    places: Array
    rates: Array

    def most(self) -> float:
        """Return a bound of their sum."""
        return float(np.abs(self.places + self.rates).sum(axis=1).max(initial=0.0))


def stiffness(
    forces: Forces, inverse: Array, size: float, h: float, state: Array, time: float
) -> Stiffness | None:
    """Return how forces change in a step; None where they change with nothing that moves.

    Parameters
    ----------
    forces : Forces
    inverse : (b, 3)
        See `contacts.detection.body_numbers.BodyNumbers`.
    size : float
        Of a body.
    h : float
    state : (6 b + w,)
    time : float
    """
    n, tape = inverse.size, forces.tape
    reads = tape.reads[tape.reads < 2 * n]
    if not len(reads) or n > _MOST:
        return None
    changes = np.where(reads % 3 == 2, _CHANGE, _CHANGE * size)
    changes[reads >= n] /= h
    around = np.tile(state, (2, len(reads), 1))
    around[0, range(len(reads)), reads] += changes
    around[1, range(len(reads)), reads] -= changes
    seen = tape.table(around.reshape(-1, len(state)), forces.values, np.full(2 * len(reads), time))
    more, less = seen.reshape(2, len(reads), -1)
    found = np.zeros((n, 2 * n))
    rows = (3 * forces.bodies[:, None] + np.arange(3)).ravel()
    found[rows[:, None], reads] = ((less - more) / (2.0 * changes[:, None])).T
    if not np.isfinite(found).all():
        return None
    root = np.sqrt(inverse).ravel()
    places, rates = root[:, None] * np.stack([found[:, :n], found[:, n:]]) * root
    return Stiffness(h * h * places, 2.0 * h * rates)


def check_followed(found: Stiffness, inverse: Array, held: Array, h: float) -> None:
    """Raise `StepTooLarge` where steps of this length swing ever farther under forces.

    Parameters
    ----------
    found : Stiffness
    inverse : (b, 3)
    held : (r, n) array
        Directions in which contacts and joints hold.
    h : float
    """
    free = np.eye(inverse.size)
    if len(held):
        _, sizes, rows = np.linalg.svd(held * np.sqrt(inverse).ravel())
        free = rows[int((sizes > _DEPENDENT * sizes[0]).sum()) :].T

    def largest(matrix: Array) -> float:
        eigenvalues = np.linalg.eigvals(free.T @ matrix @ free)
        return float(eigenvalues.real.max(initial=0.0))

    most = largest(found.places + found.rates)
    if not most > UNSTABLE:
        return
    spring, damper = math.sqrt(max(largest(found.places), 0.0)), 0.5 * largest(found.rates)
    raise StepTooLarge(
        f"forces that change with places or speeds swing bodies by {math.sqrt(most):.3g} radians "
        f"in one step of {h:g}, and from 2 on ever farther; take "
        f"{_FINE * h / max(spring, damper, _FINE):.1g} or less"
    )
