"""Prescribed motion of surfaces, controllers and forces along the next steps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from contacts.collision_detection.applied import Ahead
from contacts.dynamics.controllers import given
from contacts.rigid_bodies.declared_surfaces import touched
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.rigid_bodies.paths import Paths, Where
from contacts.rigid_bodies.recall import Recall
from statechart.arrays import Array
from statechart.errors import NonFinite

# A start that is a whole number of steps but for this part of one is that.
_SAME = 1e-6


class Surroundings:
    """Prescribed motion and forces of one run.

    Parameters
    ----------
    mechanics : BodyMechanics
    paths : Paths
    recall : Recall
    known : mapping of str to float
        Parameters.
    values : (p,) array
        Of the parameters and what follows from them.

    Attributes
    ----------
    controlled : bool
        Whether there are controllers.
    forces : Forces
        While these are in their states.
    """

    def __init__(
        self,
        mechanics: BodyMechanics,
        paths: Paths,
        recall: Recall,
        known: Mapping[str, float],
        values: Array,
    ) -> None:
        self._mechanics, self._paths, self._recall = mechanics, paths, recall
        self._known, self._values = known, values
        self.controlled = bool(mechanics.scene.regions)
        # Where what has a path was at the last look, and what the length of that step was.
        self._last: tuple[Where, float] | None = None
        self._kept: tuple[Where, float] | None = None
        self.switch(mechanics.scene.controlled.initial)

    def switch(self, states: Mapping[str, str]) -> None:
        """Go on with controllers in other states."""
        self._states = states
        self.forces = self._mechanics.forces_at(states, self._values)
        self._given = self._mechanics.given_in(states)

    def forget(self) -> None:
        """Take back the last steps."""
        self._last = self._kept

    def ahead(
        self, start: float, h: float, remembered: Array, count: int
    ) -> tuple[Ahead, Array, int]:
        """Return what acts in the steps from an instant on, and what is remembered at their ends.

        And how many of them can be taken: as long as paths have values. Before a run begins
        surfaces move as they do then, and so do they before a step of another length, and where
        their paths end.

        Raises
        ------
        NonFinite
            If none can.
        """
        forces = self.forces.program
        # Counted from the start of the run: instants are the same in chunks of any length.
        number = round(start / h)
        first = number if abs(start - number * h) <= _SAME * h else start / h
        times: Array = h * (first + 0.5 * np.arange(2 * count + 2, dtype=float))
        memories = self._recall.along(self._states, self._values, remembered, times)
        seen = np.concatenate([memories[:1], memories[1::2]])
        if not self._paths.any:
            return (
                Ahead(*self._paths.none(count + 2), seen, forces),
                memories[2::2],
                count + 1,
            )
        now = self._paths.at(self._known, times[:1], memories[:1])
        looks = self._paths.at(self._known, times[1::2], memories[1::2])
        before = Where(*(2.0 * a - b[:1] for a, b in zip(now, looks, strict=True)))
        # What turns about a point goes on to do so.
        turned = before.frames[:, :, 2] - now.frames[:, :, 2]
        cos, sin = np.cos(turned), np.sin(turned)
        dx, dy = np.moveaxis((now.frames - looks.frames[:1])[:, :, :2], -1, 0)
        moved = np.stack([cos * dx - sin * dy, sin * dx + cos * dy], -1)
        before.frames[:, :, :2] = now.frames[:, :, :2] + moved
        if self._last is not None and self._last[1] == h:
            before = self._last[0]
        self._kept = self._last
        self._looks, self._h = looks, h
        frames, places = (np.concatenate(pair) for pair in zip(before, looks, strict=True))
        known = len(looks.frames)
        for rows in (frames, places):
            ends = np.flatnonzero(~np.isfinite(rows[1:]).all(axis=(1, 2)))
            known = min([known, *ends[:1].tolist()])
        if known == 0:
            raise NonFinite(
                f"{self._without(looks)} has no value, or an infinite one, at t = {times[1]:.6g}"
            )
        if known < len(looks.frames):
            for rows in (frames, places):
                rows[known + 1 :] = 2.0 * rows[known] - rows[known - 1]
        return Ahead(frames, places, seen, forces), memories[2::2], known

    def _without(self, looks: Where) -> str:
        """Return whose path has no value at the first of some looks."""
        scene = self._mechanics.scene
        surfaces = np.flatnonzero(~np.isfinite(looks.frames[0]).all(axis=1)).tolist()
        joints = np.flatnonzero(~np.isfinite(looks.places[0]).all(axis=1)).tolist()
        named = [f"surface {touched(scene)[s]!r}" for s in surfaces]
        named += [f"joint {list(scene.joints)[j]!r}" for j in joints]
        return f"the path of {named[0]}"

    @property
    def count(self) -> int:
        """How many values controllers give."""
        return len(given(self._mechanics))

    def given(self, start: float, h: float, states: Array) -> Array:
        """Return what controllers give (k, c) in the middles of steps between states (k + 1, w)."""
        times: Array = start + h * (0.5 + np.arange(len(states) - 1.0))
        return self._given.table(0.5 * (states[:-1] + states[1:]), self._values, times)

    def passed(self, count: int) -> None:
        """Note how many of these steps were taken."""
        if count and self._paths.any:
            self._last = Where(*(rows[count - 1 : count] for rows in self._looks)), self._h
