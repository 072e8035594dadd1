"""What a step of a given length cannot follow: springs that swing fast, forces that change."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from statechart.arrays import Array
from statechart.errors import StepTooLarge
from statechart.kernels.resolution import roughness

# The midpoint rule swings with growing amplitude from here on (radians a step), and is off by a
# hundredth of a period's phase from the second.
_UNSTABLE, _COARSE = 2.0, 0.5
# So many radians a step are enough.
_FINE = 0.1
# Impulses that no step shows, in parts of the scene's momentum, are worth a word.
_MISSED = 0.05


class StepLimits:
    """Watches how steps follow the forces of a scene.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    forces : sequence of Expr
        Generalised forces, in coordinates, rates, parameters and time.
    """

    def __init__(self, mechanics: Mechanics, forces: Sequence[sp.Expr]) -> None:
        self._size = len(mechanics.q)
        stiffness = [-sp.diff(force, place) for force in forces for place in mechanics.q]
        self._stiffness = (
            mechanics.tape([*mechanics.mass_matrix, *stiffness])
            if any(entry != 0 for entry in stiffness)
            else None
        )
        changing = {*mechanics.q, *mechanics.v, mechanics.time}
        self._forces = (
            mechanics.tape(forces) if any(f.free_symbols & changing for f in forces) else None
        )

    def swing(self, values: Array, state: Array, time: float, held: Array) -> float:
        """Return the fastest swing of the springs in radians per time, 0 where there is none.

        Parameters
        ----------
        values : (p,) array
            Of the parameters.
        state : (2 n,) array
        time : float
        held : (r, n) array
            Directions in which contacts and joints hold.
        """
        if self._stiffness is None:
            return 0.0
        n = self._size
        mass, stiff = self._stiffness.values(state, values, time).reshape(2, n, n)
        if not (np.isfinite(mass).all() and np.isfinite(stiff).all()):
            return 0.0
        free = np.eye(n)
        if len(held):
            _, sizes, rows = np.linalg.svd(held)
            rank = int((sizes > _DEPENDENT * sizes[0]).sum()) if sizes[0] > 0.0 else 0
            free = rows[rank:].T
        if free.shape[1] == 0:
            return 0.0
        squares = np.linalg.eigvals(np.linalg.pinv(free.T @ mass @ free) @ (free.T @ stiff @ free))
        return math.sqrt(max(float(squares.real.max()), 0.0))

    def missed(self, setup: SceneSetup, start: float, times: Array, lines: Array) -> float:
        """Return the impulses that steps may have missed, in parts of the scene's momentum.

        Parameters
        ----------
        setup : SceneSetup
        start, times, lines
            As in `statechart.kernels.resolution.roughness`.
        """
        tape, n = self._forces, self._size
        if tape is None or not len(lines):
            return 0.0
        found = roughness(
            *tape.program, tape.reads, tape.n_fixed, setup.values, start, times, lines
        )
        impulses = np.diff(times) @ np.where(np.isfinite(found), found, 0.0)
        scales = setup.scales
        # What the scene's force gives in the time that its speed takes for its length.
        sizes = scales.force * scales.length**2 / scales.speed / scales.sizes[:n]
        return float((impulses / sizes).max(initial=0.0))


# Directions are one to within this part of the largest.
_DEPENDENT = 1e-9


def check_swing(swing: float, h: float) -> None:
    """Raise `StepTooLarge` where springs swing ever farther by steps of this length."""
    if swing * h >= _UNSTABLE:
        raise StepTooLarge(
            f"springs swing by {swing * h:.3g} radians in one step of {h:g}, and from 2 on ever "
            f"farther; take {_FINE / swing:.1g} or less"
        )


def remarks(swing: float, h: float, missed: float) -> tuple[str, ...]:
    """Say what steps follow badly."""
    found: list[str] = []
    if swing * h > _COARSE:
        found.append(
            f"springs swing by up to {swing * h:.2g} radians in one step of {h:g}: their periods "
            f"are off by {(swing * h) ** 2 / 24:.1%}; take {_FINE / swing:.1g} or less"
        )
    if missed > _MISSED:
        found.append(
            f"forces change within steps of {h:g} by more than these show: impulses of up to "
            f"{missed:.2g} of the scene's own may be missed; take a tenth of the step"
        )
    return tuple(found)
