"""Forces of sign functions in a sliding mode (Filippov), for the classification of contacts.

Contact laws classify contacts by the forces at a state. A velocity held at zero there has the sign
of its round-off, so that the force of its sign function is wrong. The residual of the equations of
motion in the mode of the flow is that error; it is added to the forces as parameters.
"""

from __future__ import annotations

from dataclasses import replace

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
        """Return the setup with the forces of sign functions of a flow in a state."""
        # The laws treat signs that are dry friction by their limits.
        if setup.modes is None or tape.signs or not any(map(slides, flow.signs)):
            return setup
        mechanics, mode = self._mechanics, setup.modes(flow.moving)
        if mode not in self._tapes:
            # The controls of the contact laws, not those that the mode solves for.
            controlled = {} if tape.states is None else mechanics.values_in(tape.states)
            motion = mechanics.equations[: len(mechanics.q)]
            self._tapes[mode] = mechanics.tape(
                [equation.xreplace(controlled) for equation in motion], definitions=mode.definitions
            )
        values = setup.values.copy()
        values[mechanics.held_forces] += self._tapes[mode].values(state, setup.values, time)
        return replace(setup, values=values)
