"""Prescribed motion of surfaces, controllers and forces along the next steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.collision_detection.midpoint import Prescribed
from contacts.dynamics.controllers import given
from contacts.dynamics.geometry import surface_frame
from contacts.rigid_bodies.declared_numbers import symbols_of, touched
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.scene.joints import Path
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.documents.declaration import TIME
from statechart.errors import NonFinite
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape


class Positions(NamedTuple):
    """Positions of surfaces and joint places at instants."""

    frames: Array  # (m, s, 3): of all surfaces that bodies touch.
    places: Array  # (m, j, 2): of all joints; zero where they hold two bodies together.


class Paths:
    """The paths of a scene; `any` tells whether there are some."""

    def __init__(self, scene: Scene) -> None:
        surfaces = [scene.surfaces[name] for name in touched(scene)]
        self._surfaces, self._joints = len(surfaces), len(scene.joints)
        self._moved = [s for s, surface in enumerate(surfaces) if surface.moves]
        self._names = tuple(scene.parameters)
        parameters, time = symbols_of(self._names), sp.Symbol("t", real=True)
        memory = {n: sp.Symbol(f"w{i}", real=True) for i, n in enumerate(scene.controlled.memory)}
        known = {TIME: time, **memory, **dict(zip(self._names, parameters, strict=True))}
        expressions = [e for s in self._moved for e in surface_frame(surfaces[s], known)]
        for joint in scene.joints.values():
            path = joint.to if isinstance(joint.to, Path) else Path(x=0, y=0)
            expressions += [parse(text or 0).to_sympy(known) for text in (path.x, path.y)]
        self.any = bool(self._moved or self._joints)
        self._tape = compile_tape(
            expressions, variables=tuple(memory.values()), parameters=parameters, time=time
        )

    def none(self, count: int) -> Positions:
        """Return where all is at so many instants when nothing has a path."""
        return Positions(np.zeros((count, self._surfaces, 3)), np.zeros((count, 0, 2)))

    def at(self, known: Mapping[str, float], times: Array, memories: Array) -> Positions:
        """Return where all is at instants."""
        count, moved = len(times), len(self._moved)
        if not self.any:
            return self.none(count)
        frames = np.zeros((count, self._surfaces, 3))
        values = np.array([known[name] for name in self._names], dtype=float)
        found = self._tape.table(memories, values, times)
        frames[:, self._moved] = found[:, : 3 * moved].reshape(count, moved, 3)
        return Positions(frames, np.array(found[:, 3 * moved :]).reshape(count, self._joints, 2))


def integrate(rates: Tape, values: Array, remembered: Array, times: Array) -> Array:
    """Return controller variables (m, w) at instants (m,), from those at the first of them.

    By the rule of Runge and Kutta from each instant to the next: no motion of bodies changes them.
    """
    result = np.empty((len(times), len(remembered)))
    result[0] = remembered
    if not len(remembered):
        return result
    if not len(rates.reads):
        # All of it flows at constant rates, as clocks do.
        # Added up one by one, so that it does not matter where steps begin.
        result[1:] = np.outer(np.diff(times), rates.at(remembered, values, 0.0))
        found: Array = np.cumsum(result, axis=0)
        return found
    for k, h in enumerate(np.diff(times).tolist()):
        t, w = float(times[k]), result[k]
        first = rates.at(w, values, t)
        second = rates.at(w + 0.5 * h * first, values, t + 0.5 * h)
        third = rates.at(w + 0.5 * h * second, values, t + 0.5 * h)
        last = rates.at(w + h * third, values, t + h)
        result[k + 1] = w + h / 6.0 * (first + 2.0 * second + 2.0 * third + last)
    return result


# A start that is a whole number of steps but for this part of one is that.
_SAME_MOTION = 1e-6


class PrescribedMotion:
    """Prescribed motion and `forces` of one run, in the states of its controllers.

    Parameters are `known` by name; `values` (p,) are theirs and those that follow from them.
    `controlled` tells whether there are controllers.
    """

    def __init__(
        self,
        mechanics: BodyMechanics,
        paths: Paths,
        known: Mapping[str, float],
        values: Array,
    ) -> None:
        self._mechanics, self._paths = mechanics, paths
        self._known, self._values = known, values
        self.controlled = bool(mechanics.scene.regions)
        # Where what has a path was at the last detection, and what the length of that step was.
        self._last: tuple[Positions, float] | None = None
        self._saved: tuple[Positions, float] | None = None
        self.switch(mechanics.scene.controlled.initial)

    def switch(self, states: Mapping[str, str]) -> None:
        """Go on with controllers in other states."""
        self._states = states
        self.forces = self._mechanics.forces_at(states, self._values)
        self._given = self._mechanics.given_in(states)

    def forget(self) -> None:
        """Take back the last steps."""
        self._last = self._saved

    def ahead(
        self, start: float, h: float, remembered: Array, count: int
    ) -> tuple[Prescribed, Array, int]:
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
        first = number if abs(start - number * h) <= _SAME_MOTION * h else start / h
        times: Array = h * (first + 0.5 * np.arange(2 * count + 2, dtype=float))
        flows = self._mechanics.flows_in(self._states)
        memories = integrate(flows, self._values, remembered, times)
        seen = np.concatenate([memories[:1], memories[1::2]])
        if not self._paths.any:
            return (
                Prescribed(*self._paths.none(count + 2), seen, forces),
                memories[2::2],
                count + 1,
            )
        now = self._paths.at(self._known, times[:1], memories[:1])
        looks = self._paths.at(self._known, times[1::2], memories[1::2])
        before = Positions(*(2.0 * a - b[:1] for a, b in zip(now, looks, strict=True)))
        # A surface that turns about a point continues to do so.
        turned = before.frames[:, :, 2] - now.frames[:, :, 2]
        cos, sin = np.cos(turned), np.sin(turned)
        dx, dy = np.moveaxis((now.frames - looks.frames[:1])[:, :, :2], -1, 0)
        moved = np.stack([cos * dx - sin * dy, sin * dx + cos * dy], -1)
        before.frames[:, :, :2] = now.frames[:, :, :2] + moved
        if self._last is not None and self._last[1] == h:
            before = self._last[0]
        self._saved = self._last
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
        return Prescribed(frames, places, seen, forces), memories[2::2], known

    def _without(self, looks: Positions) -> str:
        """Return whose path has no value at the first of some looks."""
        scene = self._mechanics.scene
        surfaces = np.flatnonzero(~np.isfinite(looks.frames[0]).all(axis=1)).tolist()
        joints = np.flatnonzero(~np.isfinite(looks.places[0]).all(axis=1)).tolist()
        named = [f"surface {touched(scene)[s]!r}" for s in surfaces]
        named += [f"joint {list(scene.joints)[j]!r}" for j in joints]
        return f"the path of {named[0]}"

    @property
    def count(self) -> int:
        """Number of values that controllers give."""
        return len(given(self._mechanics))

    def given(self, start: float, h: float, states: Array) -> Array:
        """Return what controllers give (k, c) in the middles of steps between states (k + 1, w)."""
        times: Array = start + h * (0.5 + np.arange(len(states) - 1.0))
        return self._given.table(0.5 * (states[:-1] + states[1:]), self._values, times)

    def passed(self, count: int) -> None:
        """Note how many of these steps were taken."""
        if count and self._paths.any:
            self._last = Positions(*(rows[count - 1 : count] for rows in self._looks)), self._h
