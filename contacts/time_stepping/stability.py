"""Stability of explicit forces: ``h^2 k + 2 h d`` must stay below 4; and their quadrature error.

For points on surfaces the equations give the stiffness, and damping is implicit; for bodies with
shapes both are finite differences. Directions held by contacts and joints are excluded, and so is
the tension of joints: `contacts.rigid_bodies.rigid_body_run` limits its energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.solvers.dependence import null_space
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.margin_derivatives import derivative
from statechart.errors import StepTooLarge
from statechart.formulas.tape import Tape
from statechart.kernels.boxes import Steps
from statechart.kernels.quadrature import integrate_outputs

UNSTABLE = 4.0
"""Limit of ``h^2 k + 2 h d`` for forces evaluated at mid-step, at the velocities before it, with
stiffness k and damping d per mass."""
# Radians per step at which the phase error is a hundredth of a period.
_COARSE = 0.5
# Recommended radians, or relative velocity change, per step.
_FINE = 0.1
CHANGE = 1e-6
"""Step of the finite differences of forces, relative to the size of a body."""
# Regularisation of the Gram matrix of held directions, which may be redundant.
_DEPENDENT_SQUARES = 1e-12
# Quadrature error of forces, relative to the largest, below that of a warning at a tenth.
_FORCES = 1e-3
# Arnoldi iterations: an error below a hundredth.
_ITERATIONS = 60
# Batch size of formula evaluation.
_AT_ONCE = 64


def instability_error(motion: str, radians: float, h: float, finest: float) -> StepTooLarge:
    """Return the error of an unstable step size."""
    return StepTooLarge(
        f"{motion} by {radians:.3g} radians in one step of {h:g}, which is unstable from 2 on; "
        f"take {finest:.1g} or less"
    )


class Swings(NamedTuple):
    """Oscillations of springs."""

    speeds: Array  # (k,): angular frequencies.
    shapes: Array  # (n, k): absolute mode shapes.
    parts: Array  # (k, n): projections of the rates on the modes.

    def off(self, rates: Array, smooth: Bools, h: float, span: float) -> Array:
        """Return the velocity errors (n,) after `span` by the phase error of the midpoint rule.

        The phase at frequency w leads by (w h)^2/24.
        """
        changes = np.diff(rates, axis=0)[smooth] @ self.parts.T
        if len(changes) < 2:
            return np.zeros(len(self.shapes))
        # Slow motion under constant forces has no oscillating rate changes.
        turns = self.speeds * h
        sizes = math.sqrt(2.0) * changes.std(axis=0) / turns
        ahead = 2.0 * np.sin(np.minimum(self.speeds * span * turns**2 / 24.0, math.pi) / 2.0)
        errors: Array = (self.shapes * (ahead * sizes)).max(axis=1)
        return errors


class StepLimits:
    """Stability and force quadrature of the steps of a scene."""

    def __init__(self, mechanics: Mechanics, forces: Sequence[sp.Expr]) -> None:
        stiffness = [-derivative(force, place) for force in forces for place in mechanics.q]
        springs = any(entry != 0 for entry in stiffness)
        self._stiffness = mechanics.tape(stiffness) if springs else None
        changing = {*mechanics.state, mechanics.time}
        varies = any(force.free_symbols & changing for force in forces)
        self.forces = mechanics.tape(forces) if varies else None
        """Forces that vary within a step; None without any."""

    def swings(
        self, mass: Array, values: Array, state: Array, time: float, held: Array
    ) -> Swings | None:
        """Return the oscillations of springs orthogonal to the rows `held`; None without any."""
        if self._stiffness is None:
            return None
        stiff = self._stiffness.values(state, values, time).reshape(mass.shape)
        if not (np.isfinite(mass).all() and np.isfinite(stiff).all()):
            return None
        free = null_space(held)
        if free.shape[1] == 0:
            return None
        inverse = np.linalg.pinv(free.T @ mass @ free)
        squares, shapes = np.linalg.eig(inverse @ (free.T @ stiff @ free))
        swinging = squares.real > 0.0
        if not swinging.any():
            return None
        return Swings(
            np.sqrt(squares.real[swinging]),
            np.abs(free @ shapes[:, swinging]),
            (np.linalg.pinv(shapes) @ free.T)[swinging],
        )

    def missed(self, mass: Array, values: Array, start: float, h: float, states: Array) -> Array:
        """Return the velocities (k, n) by the quadrature error of `forces`."""
        tape, n, count = self.forces, len(mass), len(states) - 1
        if tape is None or not np.isfinite(mass).all():
            return np.zeros((count, n))
        lines = np.stack([states[:-1], np.diff(states, axis=0)], -1)
        rates = slice(n, 2 * n)
        lines[:, rates, 0], lines[:, rates, 1] = 0.5 * (states[:-1, rates] + states[1:, rates]), 0.0
        steps = Steps(h * np.arange(count + 1.0), lines, values, start)
        sums, _ = integrate_outputs(tape.parts, steps, 0.0, h * count, _FORCES)
        middles = start + h * (np.arange(count) + 0.5)
        errors = sums - h * tape.table(lines @ (1.0, 0.5), values, middles)
        # A coordinate without inertia has no independent velocity.
        inverse = np.linalg.pinv(mass, hermitian=True)
        return np.where(np.isfinite(errors), errors, 0.0) @ inverse


def check_swing(swing: float, h: float) -> None:
    """Raise `StepTooLarge` if springs are unstable at this step size."""
    if (swing * h) ** 2 >= UNSTABLE:
        raise instability_error("springs swing", swing * h, h, _FINE / swing)


def remarks(swing: float, h: float) -> tuple[str, ...]:
    """Return a warning of springs that steps follow badly."""
    if not swing * h > _COARSE:
        return ()
    return (
        f"springs oscillate by up to {swing * h:.2g} rad in one step of {h:g}: their periods are "
        f"off by {(swing * h) ** 2 / 24:.1%}; take {_FINE / swing:.1g} or less",
    )


class Stiffness(NamedTuple):
    """Stiffness and damping of a step in coordinates whose squared rates are energies."""

    size: int  # Coordinates, n.
    # (k,): indices of the entries.
    rows: Ints
    columns: Ints
    # (k,): entries of ``h^2 K`` and ``2 h D``.
    places: Array
    rates: Array

    def most(self) -> float:
        """Return the row-sum bound of their sum."""
        sums = np.bincount(self.rows, np.abs(self.places + self.rates), minlength=self.size)
        return float(sums.max(initial=0.0))


def stiffness(
    bodies: Ints, tape: Tape, values: Array, inverse: Array, size: float, h: float, state: Array,
    time: float,
) -> Stiffness:  # fmt: skip
    """Return the stiffness and damping of forces in a step; non-finite entries are omitted.

    Central differences of groups of coordinates that no formula reads together (Curtis, Powell and
    Reid 1974), so that controllers are included. Bodies (f,) have three forces each on the tape,
    `inverse` masses (b, 3) and a `size`; the state (6 b + w,) is that of the step.
    """
    n = inverse.size
    outputs, variables, colours = tape.coloured_sparsity(2 * n)
    changes = np.where(variables % 3 == 2, CHANGE, CHANGE * size)
    changes[variables >= n] /= h
    entries = np.zeros(len(outputs))
    for first in range(0, int(colours.max(initial=-1)) + 1, _AT_ONCE):
        mine = np.flatnonzero((colours >= first) & (colours < first + _AT_ONCE))
        k = colours[mine] - first
        around = np.tile(state, (2, int(k.max()) + 1, 1))
        around[:, k, variables[mine]] += np.outer([1.0, -1.0], changes[mine])
        points = around.reshape(-1, len(state))
        forces = tape.table(points, values, np.full(len(points), time))
        more, less = forces.reshape(2, -1, len(tape.outputs))
        entries[mine] = (less - more)[k, outputs[mine]] / (2.0 * changes[mine])
    entries = np.where(np.isfinite(entries), entries, 0.0)
    rows, root = 3 * bodies[outputs // 3] + outputs % 3, np.sqrt(inverse).ravel()
    columns, places = variables % n, variables < n
    entries *= root[rows] * root[columns]
    return Stiffness(
        n, rows, columns, np.where(places, h * h * entries, 0.0),
        np.where(places, 0.0, 2.0 * h * entries),
    )  # fmt: skip


class Held(NamedTuple):
    """Directions held by contacts and joints."""

    bodies: Ints  # (r, 2): their bodies; -1: none.
    rows: Array  # (r, 6): on the rates of both.

    def only(self, which: Bools) -> Held:
        """Return a selection."""
        return Held(self.bodies[which], self.rows[which])

    def whole(self, count: int) -> Array:
        """Return the rows (r, 3 b) on all bodies."""
        result = np.zeros((len(self.rows), count + 1, 3))
        # Index -1 writes behind the last body.
        result[np.arange(len(self.rows))[:, None], self.bodies] = self.rows.reshape(-1, 2, 3)
        return result[:, :count].reshape(len(self.rows), 3 * count)


def check_stiffness(entries: Stiffness, held: Array, h: float) -> None:
    """Raise `StepTooLarge` if forces are unstable at this step size.

    `held` (r, n) are rows that contacts and joints hold.
    """
    from scipy.sparse import csr_array, diags_array, identity
    from scipy.sparse.linalg import splu

    n, rows = entries.size, csr_array(held)
    sizes = np.sqrt(np.asarray((rows * rows).sum(axis=1))).ravel()
    rows = diags_array(1.0 / sizes[sizes > 0.0]) @ rows[np.flatnonzero(sizes > 0.0)]
    gram = (rows @ rows.T + _DEPENDENT_SQUARES * identity(rows.shape[0])).tocsc()
    factors = splu(gram) if rows.shape[0] else None

    def free(x: Array) -> Array:
        # Twice, against round-off of the factors.
        for _ in range(2):
            x = x if factors is None else x - rows.T @ factors.solve(rows @ x)
        return x

    def largest(values: Array) -> float:
        matrix = csr_array((values, (entries.rows, entries.columns)), (n, n))
        return _largest(lambda x: free(matrix @ x), free(np.random.default_rng(0).normal(size=n)))

    most = largest(entries.places + entries.rates)
    if not most > UNSTABLE:
        return
    spring, damper = math.sqrt(max(largest(entries.places), 0.0)), 0.5 * largest(entries.rates)
    what = "position- or velocity-dependent forces oscillate"
    raise instability_error(what, math.sqrt(most), h, _FINE * h / max(spring, damper, _FINE))


def _largest(matrix: Callable[[Array], Array], start: Array) -> float:
    """Return the largest real part of an eigenvalue, at least 0 (Arnoldi 1951)."""
    size = float(np.linalg.norm(start))
    if size < 1e-6:
        return 0.0
    steps = min(len(start), _ITERATIONS)
    basis, hessenberg = np.zeros((steps + 1, len(start))), np.zeros((steps + 1, steps))
    basis[0] = start / size
    for k in range(steps):
        x = matrix(basis[k])
        before = float(np.linalg.norm(x))
        for _ in range(2):
            parts = basis[: k + 1] @ x
            hessenberg[: k + 1, k] += parts
            x = x - parts @ basis[: k + 1]
        hessenberg[k + 1, k] = np.linalg.norm(x)
        if hessenberg[k + 1, k] <= 1e-10 * before:
            steps = k + 1
            break
        basis[k + 1] = x / hessenberg[k + 1, k]
    return float(np.linalg.eigvals(hessenberg[:steps, :steps]).real.max(initial=0.0))
