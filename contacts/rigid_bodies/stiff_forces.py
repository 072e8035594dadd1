"""Whether forces grow so fast with places and speeds that steps swing ever farther under them.

The tension of joints is no such force: what it adds is told by `RigidBodyRun`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.midpoint import ForceProgram
from statechart.arrays import Array, Bools, Ints
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
# Squares of directions, beside theirs of one, that are rounding: joints may imply each other.
_DEPENDENT = 1e-12
# Steps of Arnoldi's iteration: what is larger than it finds is so by less than a hundredth.
_ITERATIONS = 60
# So many points a formula is evaluated at at once.
_AT_ONCE = 64


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
    """Stiffness and damping of a step in coordinates whose squared rates are energies."""

    size: int  # Coordinates, n.
    # (k,): what changes by what.
    rows: Ints
    columns: Ints
    # (k,): ``h^2 K`` and ``2 h D``: less force where bodies have moved, and are faster.
    places: Array
    rates: Array

    def most(self) -> float:
        """Return a bound of their sum."""
        sums = np.bincount(self.rows, np.abs(self.places + self.rates), minlength=self.size)
        return float(sums.max(initial=0.0))


def stiffness(
    forces: Forces, inverse: Array, size: float, h: float, state: Array, time: float
) -> Stiffness:
    """Return how forces change in a step; what has no value is left out.

    By differences, of coordinates that no formula reads two of at once (Curtis, Powell and Reid
    1974), so that what controllers give is in it.

    Parameters
    ----------
    inverse : (b, 3)
        See `contacts.collision_detection.body_numbers.BodyNumbers`.
    size : float
        Of a body.
    state : (6 b + w,)
    """
    n, tape = inverse.size, forces.tape
    outputs, variables, colours = tape.apart(2 * n)
    changes = np.where(variables % 3 == 2, _CHANGE, _CHANGE * size)
    changes[variables >= n] /= h
    found = np.zeros(len(outputs))
    for first in range(0, int(colours.max(initial=-1)) + 1, _AT_ONCE):
        mine = np.flatnonzero((colours >= first) & (colours < first + _AT_ONCE))
        k = colours[mine] - first
        around = np.tile(state, (2, int(k.max()) + 1, 1))
        around[0, k, variables[mine]] = state[variables[mine]] + changes[mine]
        around[1, k, variables[mine]] = state[variables[mine]] - changes[mine]
        points = around.reshape(-1, len(state))
        seen = tape.table(points, forces.values, np.full(len(points), time))
        more, less = seen.reshape(2, -1, len(tape.outputs))
        found[mine] = (less - more)[k, outputs[mine]] / (2.0 * changes[mine])
    found = np.where(np.isfinite(found), found, 0.0)
    rows, root = 3 * forces.bodies[outputs // 3] + outputs % 3, np.sqrt(inverse).ravel()
    columns, places = variables % n, variables < n
    found *= root[rows] * root[columns]
    return Stiffness(
        n, rows, columns, np.where(places, h * h * found, 0.0),
        np.where(places, 0.0, 2.0 * h * found),
    )  # fmt: skip


class Held(NamedTuple):
    """Directions in which contacts and joints hold."""

    bodies: Ints  # (r, 2): whose; -1: none.
    rows: Array  # (r, 6): of their rates.

    def only(self, which: Bools) -> Held:
        """Return some of them."""
        return Held(self.bodies[which], self.rows[which])

    def whole(self, count: int) -> Array:
        """Return them (r, 3 b) as rows of all bodies."""
        found = np.zeros((len(self.rows), count + 1, 3))
        # What is no body's is written behind the last.
        found[np.arange(len(self.rows))[:, None], self.bodies] = self.rows.reshape(-1, 2, 3)
        return found[:, :count].reshape(len(self.rows), 3 * count)


def check_followed(found: Stiffness, inverse: Array, held: Held, h: float) -> None:
    """Raise `StepTooLarge` where steps of this length swing ever farther under forces."""
    from scipy.sparse import csr_array, identity
    from scipy.sparse.linalg import splu

    root, n = np.sqrt(inverse).ravel(), found.size
    columns = (3 * held.bodies[:, :, None] + np.arange(3)).reshape(-1, 6)
    values = np.where(columns >= 0, held.rows * root[columns], 0.0)
    sizes = np.sqrt((values**2).sum(axis=1))
    values, columns = (values / sizes[:, None])[sizes > 0.0], columns[sizes > 0.0]
    of = np.repeat(np.arange(len(values)), 6)
    rows = csr_array((values.ravel(), (of, np.maximum(columns, 0).ravel())), (len(values), n))
    gram = (rows @ rows.T + _DEPENDENT * identity(len(values))).tocsc()
    factors = splu(gram) if len(values) else None

    def free(x: Array) -> Array:
        # Twice: what is nearly held is left to the rounding of its factors.
        for _ in range(2):
            x = x if factors is None else x - rows.T @ factors.solve(rows @ x)
        return x

    def largest(values: Array) -> float:
        matrix = csr_array((values, (found.rows, found.columns)), (n, n))
        return _largest(lambda x: free(matrix @ x), free(np.random.default_rng(0).normal(size=n)))

    most = largest(found.places + found.rates)
    if not most > UNSTABLE:
        return
    spring, damper = math.sqrt(max(largest(found.places), 0.0)), 0.5 * largest(found.rates)
    raise StepTooLarge(
        f"forces that change with places or speeds swing bodies by {math.sqrt(most):.3g} radians "
        f"in one step of {h:g}, and from 2 on ever farther; take "
        f"{_FINE * h / max(spring, damper, _FINE):.1g} or less"
    )


def _largest(matrix: Callable[[Array], Array], start: Array) -> float:
    """Return the largest real part of an eigenvalue; 0 where all are below (Arnoldi 1951)."""
    size = float(np.linalg.norm(start))
    if size < 1e-6:
        return 0.0
    steps = min(len(start), _ITERATIONS)
    basis, seen = np.zeros((steps + 1, len(start))), np.zeros((steps + 1, steps))
    basis[0] = start / size
    for k in range(steps):
        x = matrix(basis[k])
        before = float(np.linalg.norm(x))
        for _ in range(2):
            parts = basis[: k + 1] @ x
            seen[: k + 1, k] += parts
            x = x - parts @ basis[: k + 1]
        seen[k + 1, k] = np.linalg.norm(x)
        if seen[k + 1, k] <= 1e-10 * before:
            steps = k + 1
            break
        basis[k + 1] = x / seen[k + 1, k]
    return float(np.linalg.eigvals(seen[:steps, :steps]).real.max(initial=0.0))
