"""Setup of a run of a scene: coefficients of contacts, scales and tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.scales import Scales
from contacts.scene.parts import Resolution, Simultaneous
from statechart.arrays import Array
from statechart.automaton.laws import InstantOf, Setup
from statechart.engines.compiled_flow import FORCE, GAP, HOLD, IMPLIED, PLAIN, SPEED
from statechart.kernels.jit import kernel

# Hysteresis of force margins, relative to the force scale: a mode is left below -FORCE_BAND and
# entered above half of that. It covers the round-off of a solved mode, and is independent of the
# tolerance of the integration: events are those of the computed trajectory.
FORCE_BAND = 1e-12
# Part of it for the bounds of static friction: kinetic friction is smaller, so that slip does not
# return at once. Larger than the negligible part of a tie (`contacts.modes.classification`).
HOLD_PART = 0.1
# Slip, in tolerances of speed, above which a pinned contact whose constraint another one implied
# slides. Slips up to 2 tolerances count as zero in the choice of a mode.
IMPLIED_BAND = 4.0
# A violation of an inequality of a mode by up to this part of the force's tolerance is a tie.
TIE = 0.5
# Flights shorter than this part of the unit of time may belong to an accumulation of impacts; the
# height of the flights decides.
SHORT = 0.1
# Round-off of positions and speeds relative to the scene.
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneSetup(Setup):
    """Parameters, initial state, scales and tolerances of one run of a scene."""

    sizes: Array  # (n,): Scales of the variables
    scales: Scales  # Scales of this run
    contacts: tuple[ContactLaw, ...]  # With this run's coefficients
    # `simultaneous`, `paradox`: Laws of simultaneous impacts and of Painleve's paradox
    simultaneous: Simultaneous
    paradox: Resolution
    capture: float  # Rebounds slower than this are summed instead of simulated
    # Stop condition -> the tolerance of its margin, from its initial value
    bands: Mapping[str, float]
    coordinates: tuple[str, ...] = ()  # Their names, for messages
    start_depth: float = 0.0  # Initial penetration of bodies with shapes
    # Residual motion of resting bodies after steps, relative to the size of each number: round-off
    # of impulses (1e-16 of the speeds times the mass ratio) for points, the residual of the solver
    # for bodies with shapes
    rounded: float = 1e-12

    @property
    def tie(self) -> float:
        """Largest violation of an inequality of a mode, in the scales, that counts as a tie."""
        return TIE * self.tolerances["force"] / self.scales.force

    @property
    def slip_tolerance(self) -> float:
        """Largest slip of a contact that counts as rest."""
        return 2.0 * self.tolerances["speed"]

    @property
    def residual_slip(self) -> float:
        """Largest slip after a step that counts as rest: twice the round-off of speeds."""
        return 2.0 * self.rounded * self.scales.speed

    @property
    def force_uncertainty(self) -> float:
        """Uncertainty of forces in the scales: beyond it a force is certainly off its bound."""
        return self.capture / self.scales.speed


SceneInstant = InstantOf[SceneSetup]
"""End of a flow of a scene."""


def tolerated(relative: float) -> tuple[float, float]:
    """Return the tolerances of gap and speed in the scene's scales."""
    return max(10.0 * relative, ROUNDING), max(10.0 * relative, 10.0 * ROUNDING)


@kernel
def write_tolerances(gap: float, speed: float, scales: Array, tolerances: Array) -> None:
    """Write the tolerances (6,) of all kinds of margins, from those of gap and speed in `scales`.

    For the scales (6,) see `contacts.dynamics.scales.measure`.
    """
    tolerances[PLAIN], tolerances[GAP] = 0.0, max(gap * scales[0], scales[4])
    tolerances[SPEED], tolerances[FORCE] = speed * scales[1], FORCE_BAND * scales[3]
    tolerances[HOLD] = HOLD_PART * tolerances[FORCE]
    tolerances[IMPLIED] = IMPLIED_BAND * tolerances[SPEED]


def force_uncertainty(relative: float) -> float:
    """Return the root of the tolerance: a bound of magnified errors, in the scales."""
    return math.sqrt(max(relative, ROUNDING))
