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
# What breaks an inequality of a mode by up to this part of the force's tolerance is a tie.
TIE = 0.5
# Sequences of impacts are looked at from here on; how high the contacts still fly decides.
SHORT = 0.1
# Positions and speeds carry rounding of this size relative to the scene.
ROUNDING = 1e-13


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneSetup(Setup):
    """The numbers of one run of a scene."""

    scales: Scales  # Of this run
    contacts: tuple[ContactLaw, ...]  # With this run's coefficients
    capture: float  # Rebounds slower than this are summed instead of simulated
    # `lowest`, `fast`: Bounces lower than the first are summed, too; none is that is faster than
    # the second
    lowest: float
    fast: float
    # Stop condition -> how near zero its margin counts as met; from its value at the start
    bands: Mapping[str, float]
    start_depth: float = 0.0  # How deep bodies with shapes start in what they touch
    # What steps leave of what rests, in parts of the size of each number: of impulses of points
    # their rounding, 1e-16 of the speeds, times what masses are apart; of bodies with shapes what
    # their impulses miss by
    rounded: float = 1e-12

    @property
    def tie(self) -> float:
        """Up to this, in the scales, what breaks an inequality of a mode is a boundary case."""
        return TIE * self.tolerances["force"] / self.scales.force

    @property
    def doubtful(self) -> float:
        """Forces no nearer to a bound, in the scales, are on that side of it for sure."""
        return self.capture / self.scales.speed


def tolerated(relative: float) -> tuple[float, float, float]:
    """Return the tolerances of gap, speed and force in the scene's scales."""
    return max(10.0 * relative, ROUNDING), max(10.0 * relative, 10.0 * ROUNDING), FORCE_BAND


def doubtful(relative: float) -> float:
    """Return what errors that are magnified stay below, in the scales: the root of a tolerance."""
    return math.sqrt(max(relative, ROUNDING))
