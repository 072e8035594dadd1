"""Stability of explicit forces: ``h^2 k + 2 h d`` must stay below 4.

Of a scene of points the equations have the stiffness, and damping is taken implicitly; of bodies
with shapes both are differences of the forces. What contacts and joints hold is left out. The
tension of joints is no such force: `contacts.rigid_bodies.rigid_body_run` limits its energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.time_stepping.force_quadrature_error import force_quadrature_error
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.margin_derivatives import derivative
from statechart.errors import StepTooLarge
from statechart.formulas.tape import Tape
from statechart.kernels.boxes import Steps

if TYPE_CHECKING:
    from scipy.sparse import csr_array

UNSTABLE = 4.0
"""Forces are those in the middle of a step, at the speeds before it. Under a stiffness k and a
damping d, by mass, steps turn what moves around ever farther where h^2 k + 2 h d is above this."""
# From here on (radians a step) the midpoint rule is off by a hundredth of a period's phase.
_COARSE = 0.5
# Radians, or parts of a speed, a step that are accurate.
_FINE = 0.1
# Directions are one to within this part of the largest.
DEPENDENT = 1e-9
CHANGE = 1e-6
"""Step of the finite differences of forces, relative to the size of a body."""
# Squares of directions, beside theirs of one, that are rounding: joints may imply each other.
_DEPENDENT_SQUARES = 1e-12
# Steps of Arnoldi's iteration: what is larger than it finds is so by less than a hundredth.
_ITERATIONS = 60
# Points at which a formula is evaluated at once.
_AT_ONCE = 64


def unstable(what: str, radians: float, h: float, finest: float) -> StepTooLarge:
    """Return the error of a step under whose forces motion swings ever farther."""
    return StepTooLarge(
        f"{what} by {radians:.3g} radians in one step of {h:g}, which is unstable from 2 on; "
        f"take {finest:.1g} or less"
    )


class Swings(NamedTuple):
    """Oscillations of springs."""

    speeds: Array  # (k,): in radians per time.
    shapes: Array  # (n, k): how far each moves the coordinates.
    parts: Array  # (k, n): what each has of the rates.

    def off(self, rates: Array, smooth: Bools, h: float, span: float) -> Array:
        """Return how far off rates (n,) are after so long, as the midpoint rule swings too fast.

        What swings at w is ahead by (w h)^2/24 of its phase.
        """
        changes = np.diff(rates, axis=0)[smooth] @ self.parts.T
        if len(changes) < 2:
            return np.zeros(len(self.shapes))
        # Slow motion, and motion under constant forces, does not change its rate so.
        turns = self.speeds * h
        sizes = math.sqrt(2.0) * changes.std(axis=0) / turns
        ahead = 2.0 * np.sin(np.minimum(self.speeds * span * turns**2 / 24.0, math.pi) / 2.0)
        found: Array = (self.shapes * (ahead * sizes)).max(axis=1)
        return found


class StepLimits:
    """Watches how steps follow the forces of a scene."""

    def __init__(self, mechanics: Mechanics, forces: Sequence[sp.Expr]) -> None:
        self._size = len(mechanics.q)
        stiffness = [-derivative(force, place) for force in forces for place in mechanics.q]
        self._stiffness = (
            mechanics.whole_tape([*mechanics.mass_matrix, *stiffness])
            if any(entry != 0 for entry in stiffness)
            else None
        )
        self._mass = mechanics.whole_tape([*mechanics.mass_matrix])
        changing = {
            *mechanics.q,
            *mechanics.v,
            *mechanics.controller_state.values(),
            mechanics.time,
        }
        varies = any(force.free_symbols & changing for force in forces)
        self._forces = mechanics.whole_tape(forces) if varies else None

    def swings(self, values: Array, state: Array, time: float, held: Array) -> Swings | None:
        """Return how springs swing; None where there is none."""
        if self._stiffness is None:
            return None
        n = self._size
        mass, stiff = self._stiffness.values(state, values, time).reshape(2, n, n)
        if not (np.isfinite(mass).all() and np.isfinite(stiff).all()):
            return None
        free = np.eye(n)
        if len(held):
            _, sizes, rows = np.linalg.svd(held)
            rank = int((sizes > DEPENDENT * sizes[0]).sum()) if sizes[0] > 0.0 else 0
            free = rows[rank:].T
        if free.shape[1] == 0:
            return None
        squares, shapes = np.linalg.eig(
            np.linalg.pinv(free.T @ mass @ free) @ (free.T @ stiff @ free)
        )
        swinging = squares.real > 0.0
        if not swinging.any():
            return None
        return Swings(
            np.sqrt(squares.real[swinging]),
            np.abs(free @ shapes[:, swinging]),
            (np.linalg.pinv(shapes) @ free.T)[swinging],
        )

    def missed(
        self, values: Array, start: float, h: float, states: Array
    ) -> tuple[Array, Array] | None:
        """Return the velocities that forces give in each step and their middles do not show.

        Returns
        -------
        known, unknown : (k, n) array
            The unknown is a bound, of what is not among the known; None where forces are constant.
        """
        tape, n, count = self._forces, self._size, len(states) - 1
        if tape is None or not count:
            return None
        lines = np.stack([states[:-1], np.diff(states, axis=0)], -1)
        rates = slice(n, 2 * n)
        lines[:, rates, 0], lines[:, rates, 1] = 0.5 * (states[:-1, rates] + states[1:, rates]), 0.0
        known, unknown = force_quadrature_error(
            tape.parts, Steps(h * np.arange(count + 1.0), lines, values, start)
        )
        mass = self._mass.values(states[0], values, start).reshape(n, n)
        if not np.isfinite(mass).all():
            return None
        # A coordinate without inertia has no speed of its own.
        inverse = np.linalg.pinv(mass, hermitian=True)
        return known @ inverse, unknown @ np.abs(inverse)


def check_swing(swing: float, h: float) -> None:
    """Raise `StepTooLarge` where springs swing ever farther by steps of this length."""
    if (swing * h) ** 2 >= UNSTABLE:
        raise unstable("springs swing", swing * h, h, _FINE / swing)


def remarks(swing: float, h: float) -> tuple[str, ...]:
    """Say what springs steps follow badly."""
    if not swing * h > _COARSE:
        return ()
    return (
        (
            f"springs oscillate by up to {swing * h:.2g} radians in one step of {h:g}: their "
            f"periods are off by {(swing * h) ** 2 / 24:.1%}; take {_FINE / swing:.1g} or less"
        ),
    )


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
    bodies: Ints, tape: Tape, values: Array, inverse: Array, size: float, h: float, state: Array,
    time: float,
) -> Stiffness:  # fmt: skip
    """Return how forces change in a step; what has no value is left out.

    By differences, of coordinates that no formula reads two of at once (Curtis, Powell and Reid
    1974), so that what controllers give is in it.

    Bodies (f,) have three forces each on the tape, `inverse` masses (b, 3) and this `size`; the
    state (6 b + w,) is that of the step.
    """
    n = inverse.size
    outputs, variables, colours = tape.coloured_sparsity(2 * n)
    changes = np.where(variables % 3 == 2, CHANGE, CHANGE * size)
    changes[variables >= n] /= h
    found = np.zeros(len(outputs))
    for first in range(0, int(colours.max(initial=-1)) + 1, _AT_ONCE):
        mine = np.flatnonzero((colours >= first) & (colours < first + _AT_ONCE))
        k = colours[mine] - first
        around = np.tile(state, (2, int(k.max()) + 1, 1))
        around[0, k, variables[mine]] = state[variables[mine]] + changes[mine]
        around[1, k, variables[mine]] = state[variables[mine]] - changes[mine]
        points = around.reshape(-1, len(state))
        seen = tape.table(points, values, np.full(len(points), time))
        more, less = seen.reshape(2, -1, len(tape.outputs))
        found[mine] = (less - more)[k, outputs[mine]] / (2.0 * changes[mine])
    found = np.where(np.isfinite(found), found, 0.0)
    rows, root = 3 * bodies[outputs // 3] + outputs % 3, np.sqrt(inverse).ravel()
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
        # Rows of no body are written behind the last.
        found[np.arange(len(self.rows))[:, None], self.bodies] = self.rows.reshape(-1, 2, 3)
        return found[:, :count].reshape(len(self.rows), 3 * count)

    def scaled(self, inverse: Array) -> csr_array:
        """Return them as rows of rates whose squares are energies, by inverse masses (b, 3)."""
        from scipy.sparse import csr_array

        root = np.sqrt(inverse).ravel()
        columns = (3 * self.bodies[:, :, None] + np.arange(3)).reshape(-1, 6)
        values = np.where(columns >= 0, self.rows * root[columns], 0.0)
        of = np.repeat(np.arange(len(values)), 6)
        places = of, np.maximum(columns, 0).ravel()
        return csr_array((values.ravel(), places), (len(values), root.size))


def check_stiffness(found: Stiffness, held: csr_array | Array, h: float) -> None:
    """Raise `StepTooLarge` where steps of this length swing ever farther under forces.

    `held` (r, n) are rows that contacts and joints hold.
    """
    from scipy.sparse import csr_array, diags_array, identity
    from scipy.sparse.linalg import splu

    n, rows = found.size, csr_array(held)
    sizes = np.sqrt(np.asarray((rows * rows).sum(axis=1))).ravel()
    rows = diags_array(1.0 / sizes[sizes > 0.0]) @ rows[np.flatnonzero(sizes > 0.0)]
    gram = (rows @ rows.T + _DEPENDENT_SQUARES * identity(rows.shape[0])).tocsc()
    factors = splu(gram) if rows.shape[0] else None

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
    what = "position- or velocity-dependent forces oscillate"
    raise unstable(what, math.sqrt(most), h, _FINE * h / max(spring, damper, _FINE))


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
