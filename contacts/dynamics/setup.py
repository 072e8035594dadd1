"""Setup of a run of a scene: coefficients of contacts, scales and tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from contacts.dynamics.contact_law import ContactLaw
from contacts.dynamics.scales import Scales
from statechart.automaton.laws import Setup

# Force margins may fall below zero by this much of the force scale before a mode is left: the
# size of rounding in a solved mode, with room; entering asks for half of it (hysteresis). It does
# not grow with the tolerance of the integration: events are those of the trajectory computed.
FORCE_BAND = 1e-12
# Of that, for bounds of static friction: kinetic friction is less, and nothing comes back from
# slip. More than the part of a tie that is nearly none (`contacts.modes.classification`).
HOLD_PART = 0.1
# A violation of an inequality of a mode by up to this part of the force's tolerance is a tie.
TIE = 0.5
# Sequences of impacts are looked at from here on; how high the contacts still fly decides.
SHORT = 0.1
# Positions and speeds carry rounding of this size relative to the scene.
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneSetup(Setup):
    """The numbers of one run of a scene."""

    scales: Scales  # Scales of this run
    contacts: tuple[ContactLaw, ...]  # With this run's coefficients
    capture: float  # Rebounds slower than this are summed instead of simulated
    # Stop condition -> how near zero its margin counts as met; from its value at the start
    bands: Mapping[str, float]
    start_depth: float = 0.0  # Initial penetration of bodies with shapes
    # Residual motion of resting bodies after steps, in parts of the size of each number: for points
    # round-off of impulses, 1e-16 of the speeds, times the ratio of masses; for bodies with shapes
    # the residual of their impulses
    rounded: float = 1e-12

    @property
    def tie(self) -> float:
        """Up to this, in the scales, what breaks an inequality of a mode is a boundary case."""
        return TIE * self.tolerances["force"] / self.scales.force

    @property
    def force_uncertainty(self) -> float:
        """Forces no nearer to a bound, in the scales, are on that side of it for sure."""
        return self.capture / self.scales.speed


def tolerated(relative: float) -> tuple[float, float, float]:
    """Return the tolerances of gap, speed and force in the scene's scales."""
    return max(10.0 * relative, ROUNDING), max(10.0 * relative, 10.0 * ROUNDING), FORCE_BAND


def force_uncertainty(relative: float) -> float:
    """Return what errors that are magnified stay below, in the scales: the root of a tolerance."""
    return math.sqrt(max(relative, ROUNDING))
