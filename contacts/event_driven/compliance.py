"""Compliant contacts: which margins end a flight, outside the surface and inside.

A damped contact lifts off while it is inside its surface, where its force vanishes. From there it
presses again, or leaves the surface, whichever comes first.
"""

from __future__ import annotations

import math

import numpy as np

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.event_driven.switching import alike
from contacts.scene.modes import FORCE_MARGINS, INSIDE, OUTSIDE
from contacts.states import OPEN
from statechart.arrays import Array
from statechart.automaton.laws import Flow, Instant, moving_mode
from statechart.automaton.margin_derivatives import UNDERFLOW
from statechart.automaton.trace import Jump, Key


class Compliance:
    """The compliant contacts of a scene."""

    def __init__(self, mechanics: Mechanics) -> None:
        names = [*mechanics.scene.contacts]
        self._places = [(name, names.index(name)) for name in mechanics.pads]
        symbols = [mechanics.contact(name).symbols for name in mechanics.pads]
        self._tape = mechanics.tape([e for one in symbols for e in (one.gap, one.compliance)])

    def tolerances(
        self, setup: SceneSetup, mode: Key, state: Array, time: float
    ) -> dict[str, float]:
        """Return margin -> how far below zero a flow from here lets it go; infinity: unwatched."""
        found: dict[str, float] = {}
        numbers = self._tape.at(state, setup.values, time).reshape(-1, 2)
        for (name, place), (gap, force) in zip(self._places, numbers.tolist(), strict=True):
            if mode[place] not in OPEN:
                # Round-off of a gap that has just closed, times a stiffness.
                if gap >= 0.0 and force < 0.0:
                    edge = max(setup.contacts[place].cone_n, np.finfo(float).tiny)
                    band = setup.tolerances["force"] - 2.0 * force / edge
                    found |= {f"{name}.{margin}": band for margin in FORCE_MARGINS}
                continue
            near, press = setup.tolerances["gap"], setup.tolerances["force"]
            bands = (math.inf, press, UNDERFLOW) if gap < -near else (near, math.inf, math.inf)
            margins = (f"{name}.{margin}" for margin in ("gap", INSIDE, OUTSIDE))
            found |= dict(zip(margins, bands, strict=True))
        return found

    def watched(
        self, at: Instant, made: tuple[Jump | None, Flow] | None
    ) -> tuple[Jump | None, Flow] | None:
        """Give a flow the margins that end its flights; also one that goes on."""
        jump, flow = (None, at.flow) if made is None else made
        state = flow.start if jump is None else jump.after
        where = at.state if state is None else state
        assert isinstance(at.setup, SceneSetup)
        own = self.tolerances(at.setup, moving_mode(flow.roles), where, at.clock.high)
        if made is None and alike(own, flow.tolerances):
            return None
        return jump, flow._replace(tolerances={**flow.tolerances, **own})
