"""Forces of signs that a flow slides along, as the laws of contacts see them.

Laws classify contacts by the forces at a state, where the sign of a velocity that is held at zero
is that of its round-off. The equations of motion under the accelerations and forces that the mode
of the flow finds are off by the difference; it is a parameter of the forces, zero by default.
"""

from __future__ import annotations

from dataclasses import replace

from contacts.dynamics.controllers import values_in
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from statechart.arrays import Array
from statechart.automaton.laws import Flow
from statechart.automaton.regions import Mode
from statechart.automaton.switches import slides
from statechart.formulas.tape import Tape


class HeldForces:
    """Evaluates the forces of signs in the flows of a scene."""

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._tapes: dict[Mode, Tape] = {}

    def within(
        self, setup: SceneSetup, flow: Flow, state: Array, time: float, tape: SnapshotTape
    ) -> SceneSetup:
        """Return the numbers of a run with the forces of signs in a flow that is in a state."""
        # The laws know signs that are dry friction by their limits.
        if setup.modes is None or tape.signs or not any(map(slides, flow.signs)):
            return setup
        mechanics, mode = self._mechanics, setup.modes(flow.moving)
        if mode not in self._tapes:
            # Controls as the laws know them, not as the mode finds them.
            known = {} if tape.states is None else values_in(mechanics, tape.states)
            motion = mechanics.equations[: len(mechanics.q)]
            self._tapes[mode] = mechanics.whole_tape(
                [equation.xreplace(known) for equation in motion], definitions=mode.definitions
            )
        values = setup.values.copy()
        values[mechanics.held_forces] += self._tapes[mode].values(state, setup.values, time)
        return replace(setup, values=values)
