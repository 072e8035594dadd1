"""Paths in time of surfaces and of the places that joints hold points to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.dynamics.geometry import surface_frame
from contacts.rigid_bodies.declared_surfaces import symbols_of, touched
from contacts.scene.joints import Path
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.documents.declaration import TIME
from statechart.formulas.formula import parse
from statechart.formulas.writer import compile_tape


class Where(NamedTuple):
    """Positions of surfaces and joint places at instants."""

    frames: Array  # (m, s, 3): of all surfaces that bodies touch.
    places: Array  # (m, j, 2): of all joints; zero where they hold two bodies together.


class Paths:
    """The paths of a scene.

    Attributes
    ----------
    any : bool
        Whether there are any.
    """

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

    def none(self, count: int) -> Where:
        """Return where all is at so many instants when nothing has a path."""
        return Where(np.zeros((count, self._surfaces, 3)), np.zeros((count, 0, 2)))

    def at(self, known: Mapping[str, float], times: Array, memories: Array) -> Where:
        """Return where all is at instants."""
        count, moved = len(times), len(self._moved)
        if not self.any:
            return self.none(count)
        frames = np.zeros((count, self._surfaces, 3))
        values = np.array([known[name] for name in self._names], dtype=float)
        found = self._tape.table(memories, values, times)
        frames[:, self._moved] = found[:, : 3 * moved].reshape(count, moved, 3)
        return Where(frames, np.array(found[:, 3 * moved :]).reshape(count, self._joints, 2))
