"""States of regions at the ends of steps, for `in(REGION.STATE)`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from contacts.states import STATES
from statechart.arrays import Bools, Ints
from statechart.automaton.regions import Region
from statechart.automaton.trace import Key


class ActiveStates:
    """The states of regions, by their codes in steps and by the states of controllers."""

    def __init__(self, regions: Sequence[Region]) -> None:
        self._places = {region.name: (place, region) for place, region in enumerate(regions)}

    def at(self, codes: Ints, controls: Key) -> Callable[[str, str], Bools]:
        """Return the test in which rows (m,) a region is in a state."""

        def active(name: str, state: str) -> Bools:
            place, region = self._places[name]
            if place >= codes.shape[1]:
                now = state in region.active(controls[place - codes.shape[1]])
                return np.full(len(codes), now)
            table = [state in region.active(other) for _, other in sorted(STATES.items())]
            return np.array(table)[codes[:, place]]

        return active
