"""Limits of the step size: stiff springs and forces that change."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.time_stepping.force_quadrature_error import force_quadrature_error
from statechart.arrays import Array, Bools
from statechart.errors import StepTooLarge

# The midpoint rule swings with growing amplitude from here on (radians a step), and is off by a
# hundredth of a period's phase from the second.
_UNSTABLE, _COARSE = 2.0, 0.5
# So many radians a step are enough.
_FINE = 0.1


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
        # What goes on slowly, or is pulled at evenly, does not change its rate so.
        turns = self.speeds * h
        sizes = math.sqrt(2.0) * changes.std(axis=0) / turns
        ahead = 2.0 * np.sin(np.minimum(self.speeds * span * turns**2 / 24.0, math.pi) / 2.0)
        found: Array = (self.shapes * (ahead * sizes)).max(axis=1)
        return found


class StepLimits:
    """Watches how steps follow the forces of a scene."""

    def __init__(self, mechanics: Mechanics, forces: Sequence[sp.Expr]) -> None:
        self._size = len(mechanics.q)
        stiffness = [-sp.diff(force, place) for force in forces for place in mechanics.q]
        self._stiffness = (
            mechanics.whole_tape([*mechanics.mass_matrix, *stiffness])
            if any(entry != 0 for entry in stiffness)
            else None
        )
        self._mass = mechanics.whole_tape([*mechanics.mass_matrix])
        changing = {*mechanics.q, *mechanics.v, *mechanics.memory.values(), mechanics.time}
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
            rank = int((sizes > _DEPENDENT * sizes[0]).sum()) if sizes[0] > 0.0 else 0
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
            *tape.program,
            tape.reads,
            tape.n_fixed,
            values,
            start,
            h * np.arange(count + 1.0),
            lines,
        )
        mass = self._mass.values(states[0], values, start).reshape(n, n)
        if not np.isfinite(mass).all():
            return None
        # What has no inertia has no speed of its own.
        inverse = np.linalg.pinv(mass, hermitian=True)
        return known @ inverse, unknown @ np.abs(inverse)


# Directions are one to within this part of the largest.
_DEPENDENT = 1e-9


def check_swing(swing: float, h: float) -> None:
    """Raise `StepTooLarge` where springs swing ever farther by steps of this length."""
    if swing * h >= _UNSTABLE:
        raise StepTooLarge(
            f"springs swing by {swing * h:.3g} radians in one step of {h:g}, and from 2 on ever "
            f"farther; take {_FINE / swing:.1g} or less"
        )


def remarks(swing: float, h: float) -> tuple[str, ...]:
    """Say what springs steps follow badly."""
    if not swing * h > _COARSE:
        return ()
    return (
        f"springs swing by up to {swing * h:.2g} radians in one step of {h:g}: their periods "
        f"are off by {(swing * h) ** 2 / 24:.1%}; take {_FINE / swing:.1g} or less",
    )
