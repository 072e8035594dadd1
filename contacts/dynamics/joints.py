"""What joints hold and what they leave free: rows, their redundancy, the motions they allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.solvers.dependence import CANCELLING, DEAD_POINT, column_scales
from contacts.solvers.redundancy import connected
from statechart.arrays import Array, Bools

# Of a unit combination: whose share is less takes no part.
_SHARE = 1e-3


@dataclass(frozen=True, eq=False)
class JointRow:
    """One component of a joint: what it holds at zero, in every mode.

    Attributes
    ----------
    joint, component : str
        Its name; X or Y.
    gap, gap_rate, bias : Expr
        Point less place; its rate; the part of its second derivative that does not depend on the
        unknown accelerations.
    jacobian : tuple of Expr
        d(gap)/d(coordinates).
    force : Symbol
        On the body of the point.
    path_rate : Expr
        Velocity of the place, where it is driven in time; what the force works on from outside.
    redundant : Symbol
        Parameter: 1 where the rows before imply this one in a run, else 0.
    """

    joint: str
    component: str
    gap: sp.Expr
    gap_rate: sp.Expr
    bias: sp.Expr
    jacobian: tuple[sp.Expr, ...]
    force: sp.Symbol
    path_rate: sp.Expr
    redundant: sp.Symbol


class JointNumbers(NamedTuple):
    """Numbers of every row of the joints at a state.

    Attributes
    ----------
    gaps, rates, biases : (m,) array
        Point less place, its rate, and the part of its second derivative that the unknown
        accelerations do not enter.
    jacobian : (m, n) array
    redundant : (m,) array of bool
        Rows that those before them imply.
    """

    gaps: Array
    rates: Array
    biases: Array
    jacobian: Array
    redundant: Bools


@dataclass(frozen=True)
class Block:
    """Rows and coordinates that joints link; coordinates alone where no joint holds them."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Motions:
    """The velocities that joints allow are ``basis u + velocity``, accelerations alike.

    Attributes
    ----------
    basis : (n, k) array
        What the rows do not see.
    left : (k, n) array
        ``left @ basis`` is the identity.
    velocity, acceleration : (n,) array
        Particular ones: of driven points, and centripetal.
    """

    basis: Array
    left: Array
    velocity: Array
    acceleration: Array


def blocks(pattern: Bools) -> tuple[Block, ...]:
    """Return the parts that joints link; `pattern` (m, n) is where the Jacobian has entries."""
    labels = connected(pattern.T @ pattern)
    found = []
    for label in np.unique(labels):
        columns = np.flatnonzero(labels == label)
        rows = np.flatnonzero(pattern[:, columns].any(axis=1))
        found.append(Block(tuple(rows.tolist()), tuple(columns.tolist())))
    return tuple(found)


def motions(numbers: JointNumbers, velocity: Array, parts: Sequence[Block]) -> Motions:
    """Return what the joints allow at a state with rates `velocity` (n,)."""
    size = len(velocity)
    driven = numbers.rates - numbers.jacobian @ velocity
    basis, left = [np.zeros((size, 0))], [np.zeros((0, size))]
    particular = np.zeros((2, size))
    for part in parts:
        columns = list(part.columns)
        rows = [i for i in part.rows if not numbers.redundant[i]]
        if not rows:
            basis.append(np.eye(size)[:, columns])
            left.append(np.eye(size)[columns])
            continue
        jacobian = numbers.jacobian[np.ix_(rows, columns)]
        scale = column_scales(jacobian)
        outer, sizes, right = np.linalg.svd(jacobian * scale)
        seen, free = right[: len(rows)], right[len(rows) :]
        # At a singular configuration the motion is not determined; the least one is finite.
        inverse = np.where(sizes > CANCELLING * sizes[0], 1.0 / np.maximum(sizes, 1e-300), 0.0)
        right_sides = np.array([driven[rows], numbers.biases[rows]])
        particular[:, columns] = -((right_sides @ outer) * inverse @ seen) * scale
        basis.append(np.zeros((size, len(free))))
        basis[-1][columns] = (free * scale).T
        left.append(np.zeros((len(free), size)))
        left[-1][:, columns] = free / scale
    return Motions(np.hstack(basis), np.vstack(left), particular[0], particular[1])


def dependent(rows: Sequence[tuple[str, Array]]) -> str:
    """Return whose rows have become dependent, as a sentence; "" where none have."""
    if len(rows) < 2:
        return ""
    scaled = np.array([row for _, row in rows])
    scaled /= np.linalg.norm(scaled, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(scaled)
    if len(values) == len(rows) and values[-1] > DEAD_POINT:
        return ""
    names = dict.fromkeys(
        name for (name, _), share in zip(rows, left[:, -1], strict=True) if abs(share) > _SHARE
    )
    return (
        f"the constraints of {', '.join(names)} have become dependent (a dead point of the "
        "linkage): the motion can go on in more than one way"
    )
