"""Rows of joints, their redundancy, and the motions that they allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.scene.modes import Row
from contacts.solvers.dependence import CANCELLING, DEAD_POINT, column_scales
from contacts.solvers.impulse_coupling import label_coordinates
from statechart.arrays import Array, Bools
from statechart.automaton.regions import Hold

OFF_ROW = 2.0
"""Status of a row of a joint that is off; see `JointRow.status`."""
# Rows with a smaller coefficient in a unit null vector are not named as dependent.
_MIN_COEFFICIENT = 1e-3
ROUND_OFF = 4e-15
"""Entries of an orthonormal basis of motions up to this size are round-off."""


@dataclass(frozen=True, eq=False)
class JointRow:
    """Constraint row of a joint: gap = 0 while the joint is closed."""

    # `joint`, `component`: Name of the joint; X, Y, M (a couple), or T (along a rod)
    joint: str
    component: str
    force: sp.Symbol  # On the body of the point
    # `gap`, `gap_rate`, `bias`: Point minus target; its rate; its second derivative at zero
    # accelerations. Rows of bodies with shapes are arrays, which leave these at zero
    gap: sp.Expr = sp.S.Zero
    gap_rate: sp.Expr = sp.S.Zero
    bias: sp.Expr = sp.S.Zero
    jacobian: Row = field(default_factory=dict)  # d(gap)/d(coordinates)
    # Velocity of the target on its path; the force does work on it
    path_rate: sp.Expr = sp.S.Zero
    # Parameter: 1 where the rows before imply this one in a run, else 0
    redundant: sp.Expr = sp.S.Zero
    # Control: 1 while the joint is closed, 0 while it is off; None where it is always closed
    closed: sp.Symbol | None = None

    @property
    def status(self) -> sp.Expr:
        """0 if the row holds, 1 if others imply it, `OFF_ROW` if its joint is off."""
        if self.closed is None:
            return self.redundant
        return self.redundant * self.closed + OFF_ROW * (1 - self.closed)

    def equation(self, accelerations: Sequence[sp.Symbol]) -> sp.Expr:
        """Return the acceleration of the gap, plus the force if the row is redundant; = 0."""
        terms = (entry * accelerations[i] for i, entry in self.jacobian.items())
        return sp.Add(self.bias, *terms) + self.redundant * self.force

    def hold(self, accelerations: Sequence[sp.Symbol]) -> Hold:
        """Return the constraint of the row in a mode."""
        return Hold((self.gap,), (self.equation(accelerations),), (self.force,))


class JointNumbers(NamedTuple):
    """Numbers of every row of the joints at a state."""

    # `gaps`, `rates`, `biases`: (m,): As in `JointRow`
    gaps: Array
    rates: Array
    biases: Array
    jacobian: Array  # (m, n)
    redundant: Bools  # (m,): Rows that those before them imply, and those of joints that are off
    on: Bools  # (m,): Rows of joints that are closed

    def closed(self) -> JointNumbers:
        """Return the numbers of the joints that are closed."""
        return JointNumbers._make([numbers[self.on] for numbers in self])


@dataclass(frozen=True)
class JointGroup:
    """Joint rows and the coordinates that they couple; a free coordinate has no rows."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Motions:
    """Null-space parametrisation of the motions that joints allow.

    Velocities are ``basis u + velocity``, accelerations ``basis u' + acceleration``.
    """

    basis: Array  # (n, k): Null space of the joint rows
    left_inverse: Array  # (k, n): ``left_inverse @ basis`` is the identity
    # `velocity`, `acceleration`: (n,): Particular solutions, of driven points and centripetal
    velocity: Array
    acceleration: Array


def joint_groups(pattern: Bools) -> tuple[JointGroup, ...]:
    """Return the groups of coupled rows; `pattern` (m, n) marks nonzeros of the Jacobian."""
    size = pattern.shape[1]
    labels = label_coordinates(np.zeros((size, size)), pattern.astype(float, order="C"), size)
    groups = []
    for label in np.unique(labels):
        columns = np.flatnonzero(labels == label)
        rows = np.flatnonzero(pattern[:, columns].any(axis=1))
        groups.append(JointGroup(tuple(rows.tolist()), tuple(columns.tolist())))
    return tuple(groups)


def motions(numbers: JointNumbers, velocity: Array, groups: Sequence[JointGroup]) -> Motions:
    """Return the motions that joints allow at a state with rates `velocity` (n,)."""
    size = len(velocity)
    driven = numbers.rates - numbers.jacobian @ velocity
    basis, left = [np.zeros((size, 0))], [np.zeros((0, size))]
    particular = np.zeros((2, size))
    for group in groups:
        columns = list(group.columns)
        rows = [i for i in group.rows if not numbers.redundant[i]]
        if not rows:
            basis.append(np.eye(size)[:, columns])
            left.append(np.eye(size)[columns])
            continue
        jacobian = numbers.jacobian[np.ix_(rows, columns)]
        # Scaling of columns would enlarge round-off, such as cos(pi/2).
        noise = CANCELLING * np.abs(jacobian).max(axis=1, keepdims=True, initial=0.0)
        scale = column_scales(np.where(np.abs(jacobian) > noise, jacobian, 0.0))
        outer, sizes, right = np.linalg.svd(jacobian * scale)
        row_space, null_space = right[: len(rows)], right[len(rows) :]
        null_space = np.where(np.abs(null_space) > ROUND_OFF, null_space, 0.0)
        # At a singular configuration the motion is not unique: the least-norm one is taken.
        inverse = np.where(sizes > CANCELLING * sizes[0], 1.0 / np.maximum(sizes, 1e-300), 0.0)
        right_sides = np.array([driven[rows], numbers.biases[rows]])
        right_sides = right_sides @ outer[:, : len(sizes)]
        particular[:, columns] = -(right_sides * inverse @ row_space) * scale
        basis.append(np.zeros((size, len(null_space))))
        basis[-1][columns] = (null_space * scale).T
        left.append(np.zeros((len(null_space), size)))
        left[-1][:, columns] = null_space / scale
    return Motions(np.hstack(basis), np.vstack(left), particular[0], particular[1])


def dependent(rows: Sequence[tuple[str, Array]]) -> str:
    """Return a sentence on the rows that have become dependent; "" if there are none."""
    # No coordinate moves a row of zeros.
    rows = [(name, row) for name, row in rows if row.any()]
    if len(rows) < 2:
        return ""
    scaled = np.array([row for _, row in rows])
    scaled /= np.linalg.norm(scaled, axis=1, keepdims=True)
    left, values, _ = np.linalg.svd(scaled)
    if len(values) == len(rows) and values[-1] > DEAD_POINT:
        return ""
    names = dict.fromkeys(
        name
        for (name, _), coefficient in zip(rows, left[:, -1], strict=True)
        if abs(coefficient) > _MIN_COEFFICIENT
    )
    return (
        f"the constraints of {', '.join(names)} have become dependent (a dead point of the "
        "linkage), so that the motion is not unique; avoid this configuration, or end the "
        "run before it"
    )
