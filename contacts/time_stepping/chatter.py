"""Chatter: regions that return to their last state after one step, again and again.

With events such a run ends, as each state at once calls for the other. Time steps alternate between
them, about the motion along the boundary.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from contacts.states import OFF, OFF_CODE, OPEN_CODE
from statechart.arrays import Bools, Ints
from statechart.execution.outcome import TWO_BOUNDS

# Visits of one step, without a longer one to the same state, from which a region chatters. A
# decaying oscillation passes a boundary a few times; chatter goes on to the end of the run.
_VISITS = 8
# Steps of a stay from which the region follows a motion that the steps resolve, below 0.2 rad a
# step: a cam closes a switch for one step in each turn.
_RESOLVED = 32


class Chatter:
    """Counts the visits of one step that regions pay to their states.

    `gated` (r,): contacts and couplings with a relation `enabled` of coordinates or rates, which
    begin in modes `start` (r,).
    """

    def __init__(self, names: Sequence[str], gated: Bools, start: Ints) -> None:
        self._gated = [(name, i) for i, name in enumerate(names) if gated[i]]
        self._places = [i for _, i in self._gated]
        self._off = _inactive(start[self._places])
        self._steps = 0
        self._last: dict[str, tuple[int, str]] = {}
        # Region -> state -> number of visits, and time of the first.
        self._visits: dict[str, dict[str, tuple[int, float]]] = {}
        self._since: dict[str, float] = {}

    def add(self, codes: Ints, start: float, h: float) -> None:
        """Count visits in the modes (k, r) of steps of size h."""
        if self._gated:
            off = _inactive(codes[:, self._places])
            changed = off != np.vstack([self._off, off[:-1]])
            for k, g in np.argwhere(changed).tolist():
                source, target = ("on", OFF) if off[k, g] else (OFF, "on")
                self.change(self._gated[g][0], source, target, start + k * h, self._steps + k)
            self._off = off[-1]
        self._steps += len(codes)

    def change(
        self, region: str, source: str, target: str, time: float, step: int | None = None
    ) -> None:
        """Count a change of a region that its relations call for, by default after all steps."""
        step = self._steps if step is None else step
        entered, before = self._last.get(region, (step, ""))
        self._last[region] = step, source
        if step == entered:
            return
        visits = self._visits.setdefault(region, {})
        if step - entered >= _RESOLVED:
            visits.clear()
        if target != before or step - entered > 1:
            visits.pop(source, None)
            return
        count, first = visits.get(source, (0, time))
        visits[source] = count + 1, first
        if count + 1 == _VISITS:
            self._since.setdefault(region, first)

    def forget(self, region: str) -> None:
        """Begin anew with a region that something else has changed."""
        self._last.pop(region, None)

    @property
    def remarks(self) -> tuple[str, ...]:
        """A warning for each region that chatters."""
        return tuple(
            f"{region} returns to its last state after one step, again and again from "
            f"t = {since:.6g} on; write a shorter step or, {TWO_BOUNDS}"
            for region, since in self._since.items()
        )


def _inactive(codes: Ints) -> Bools:
    return (codes == OFF_CODE) | (codes == OPEN_CODE)
