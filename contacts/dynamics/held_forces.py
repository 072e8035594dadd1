"""Forces of signs that a flow slides along, as the laws of contacts see them.

Laws classify contacts by the forces at a state, where the sign of a velocity that is held at zero
is that of its round-off. What the mode of the flow finds for it follows from its accelerations and
contact forces: Q = M a - J^T f. The difference is a parameter of the forces, zero by default.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import SnapshotTape
from statechart.arrays import Array
from statechart.automaton.laws import Flow
from statechart.automaton.regions import Mode
from statechart.automaton.switches import SLIDES
from statechart.formulas.tape import Tape


class HeldForces:
    """Evaluates the forces of signs in the flows of a scene."""

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._tapes: dict[Mode, Tape] = {}

    def within(
        self, setup: SceneSetup, flow: Flow, state: Array, time: float, tape: SnapshotTape
    ) -> SceneSetup:
        """Return the numbers of a run with the forces of signs in a flow at its end."""
        if not flow.signs or SLIDES not in flow.signs[0].share or setup.modes is None:
            return setup
        mechanics, mode = self._mechanics, setup.modes(flow.moving)
        n, count = len(mechanics.q), len(mechanics.scene.contacts)
        if mode not in self._tapes:
            forces = [force for pair in mechanics.forces.values() for force in pair]
            forces += [row.force for row in mechanics.joint_rows]
            self._tapes[mode] = mechanics.whole_tape(
                [*mechanics.a, *forces], definitions=mode.definitions
            )
        found = self._tapes[mode].values(state, setup.values, time)
        known = np.concatenate([state[2 * n :], setup.values])
        whole, joints = tape.whole(known, state[: 2 * n], time)
        forces = found[n : n + 2 * count].reshape(count, 2)
        held = whole.mass @ found[:n] - whole.forces
        held -= np.einsum("ckn,ck->n", whole.jacobians, forces)
        if joints is not None:
            held -= joints.jacobian.T @ found[n + 2 * count :]
        values = setup.values.copy()
        values[mechanics.held_forces] += held
        return replace(setup, values=values)
