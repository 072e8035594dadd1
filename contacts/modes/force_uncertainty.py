"""Uncertainty of the forces of a mode: states are known to the tolerance of a run only.

A contact comes to rest where its run says, which is off by what the run is: where the force that
rest takes is just what friction gives, sticking and slipping on cannot be told apart. On its bound
friction holds, so such a contact sticks.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np

from contacts.dynamics.contact_law import cones
from contacts.dynamics.setup import SceneSetup
from contacts.dynamics.snapshot import Snapshot
from contacts.modes.candidates import Candidate, Case, candidates, openness
from contacts.solvers.mode_solver import judge_forces
from contacts.states import CODES
from statechart.arrays import Array
from statechart.automaton.trace import Key


class ForceUncertainty(NamedTuple):
    """Uncertainty of friction forces where contacts come to rest."""

    at: Callable[[Array, float], Snapshot]  # The scene's numbers at a state, so much later
    setup: SceneSetup  # Of the run
    state: Array  # (2 n,): As far as the run knows it
    # How contacts were kept, as far as that was in no doubt: what was pinned does not come to rest
    sure: Key
    # Contacts of which a force has just passed its bound: that is in no doubt either
    fell: Collection[int] = ()

    def sticking(
        self, case: Case, options: Sequence[Sequence[str]], taken: Candidate
    ) -> Candidate | None:
        """Return the mode that may hold as well as not.

        None where what the run is off by decides nothing.
        """
        if not any(map(_comes_to_rest, options, self.sure)):
            return None
        near = self.setup.doubtful
        for one in sorted(_solved(case._replace(tie=near), options), key=openness):
            if openness(one)[:2] > openness(taken)[:2]:
                break
            rests = any(map(_comes_to_rest, one.states, self.sure))
            close = rests and abs(one.violation) <= near and not self._passed(case, one)
            if close and max(abs(one.violation), case.tie) <= self._spread(case, one):
                return one
        return None

    def _passed(self, case: Case, one: Candidate) -> bool:
        """Whether a mode is broken by a force that has just passed its bound."""
        fell = [*self.fell]
        if not fell:
            return False
        if one.share is not None:
            return True
        verdict, codes = np.full(4, -np.inf), np.array([CODES[one.states[i]] for i in fell])
        edges = cones(tuple(case.laws))[fell]
        judge_forces(verdict, one.forces[fell], edges, codes, case.scales.force)
        return bool(verdict[0] > case.tie)

    def _spread(self, case: Case, one: Candidate) -> float:
        """Return by how much, in the scales, what a mode breaks may be off."""
        setup, near, total = self.setup, self.setup.doubtful, 0.0
        slow = setup.tolerances["speed"]
        off = slow / setup.scales.speed * np.maximum(setup.scales.sizes, np.abs(self.state))
        later = slow / setup.scales.acceleration
        moved = [(self.state + step, 0.0) for step in np.diag(off)]
        for state, time in [*moved, (self.state, later)]:
            there = case._replace(snapshot=self.at(state, time), tie=near)
            found = _solved(there, [(role,) for role in one.states])
            total += abs(found[0].violation - one.violation) if found else near
        return total


def _solved(case: Case, options: Sequence[Sequence[str]]) -> list[Candidate]:
    return [one for one in candidates(case, options) if isinstance(one, Candidate)]


def _comes_to_rest(may: Collection[str] | str, was: str) -> bool:
    return "pin" in may and was != "pin"
