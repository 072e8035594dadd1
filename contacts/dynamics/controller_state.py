"""Controller variables, which follow those of the motion in the state.

Forces may depend on them, but nothing that contacts do changes them: the laws of contacts see them
as they see parameters.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.setup import SceneSetup
from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.constraints import Constraints
from statechart.charts.flatten import Updates
from statechart.errors import NonFinite
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape


class ControllerState:
    """The variables of a scene's controllers; all of it does nothing where there are none."""

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._names = tuple(mechanics.memory)
        self._size = len(mechanics.variables)
        self._updates: dict[tuple[tuple[tuple[str, object], ...], ...], Tape] = {}

    def parted(self, state: Array) -> Array:
        """Return the part of a state, or of terms, that is positions and rates."""
        return state[: self._size] if self._names else state

    def joined(self, motion: Array, state: Array) -> Array:
        """Return positions and rates with what is remembered in `state`."""
        return np.concatenate([motion, state[self._size :]]) if self._names else motion

    def within(self, setup: SceneSetup, state: Array) -> SceneSetup:
        """Return the numbers of a run as the laws of contacts take them in `state`."""
        if not self._names:
            return setup
        return replace(setup, values=np.concatenate([state[self._size :], setup.values]))

    def constraints(self, of_motion: Constraints) -> Constraints:
        """Return constraints of positions and rates as those of the whole state."""
        if not self._names:
            return of_motion

        def project(state: Array, time: float) -> Array:
            motion = self.parted(state)
            projected = of_motion.project(motion, time)
            return state if projected is motion else self.joined(projected, state)

        within = of_motion.within
        return of_motion._replace(
            tape=self._whole(of_motion.tape),
            project=project,
            within=None if within is None else self._whole(within),
        )

    def updated(
        self,
        setup: SceneSetup,
        clock: Clock,
        cause: str,
        blocks: tuple[Updates, ...],
        state: Array,
    ) -> Array:
        """Return the state after updates; those of a block see what the one before it left.

        Raises
        ------
        NonFinite
            If one has no finite value.
        """
        if not blocks:
            return state
        key = tuple(tuple(block.items()) for block in blocks)
        tape = self._updates.get(key)
        if tape is None:
            tape = self._updates[key] = self._compiled(blocks)
        remembered = tape.at(state, setup.values, clock.high)
        for name, value in zip(self._names, remembered.tolist(), strict=True):
            if not np.isfinite(value):
                raise NonFinite(f"{cause} sets {name} to {value}")
        return np.concatenate([state[: self._size], remembered])

    def _compiled(self, blocks: tuple[Updates, ...]) -> Tape:
        mechanics = self._mechanics
        found: dict[str, sp.Expr] = dict(mechanics.memory)
        for block in blocks:
            known = {**mechanics.known, **found}
            found |= {name: parse(text).to_sympy(known) for name, text in block.items()}
        return compile_tape(
            list(found.values()),
            variables=(*mechanics.variables, *mechanics.memory.values()),
            parameters=mechanics.parameters.ordered,
            time=mechanics.time,
        )

    def _whole(self, tape: Tape) -> Tape:
        """Return a tape of the motion as one of the state: what is remembered stands between."""
        count = len(self._names)
        time = tape.reads == tape.n_variables
        return replace(
            tape,
            n_variables=tape.n_variables + count,
            n_parameters=tape.n_parameters - count,
            reads=np.where(time, tape.n_variables + count, tape.reads).astype(np.int32),
        )
