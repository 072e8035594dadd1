"""Prescribed motion of surfaces, led bodies, controllers and forces along the next steps."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
import sympy as sp

from contacts.collision_detection.midpoint import Prescribed
from contacts.dynamics.controllers import controlled_symbols
from contacts.dynamics.geometry import surface_frame
from contacts.rigid_bodies.declared_numbers import symbols_of, touched
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.scene.expansion import captured
from contacts.scene.joints import Path
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.automaton.trace import Key
from statechart.documents.declaration import TIME
from statechart.documents.fields import FormulaText
from statechart.errors import NonFinite
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape


class Positions(NamedTuple):
    """Positions of surfaces, joint places and led bodies at instants."""

    frames: Array  # (m, s, 3): of all surfaces that bodies touch.
    places: Array  # (m, j, 2): of all joints; zero where they hold two bodies together.
    poses: Array  # (m, l, 3)


class Paths:
    """The paths of a scene; `any` tells whether there are some, `led` whose bodies' they are.

    `leads` tells whether surfaces or bodies have one.
    """

    def __init__(self, scene: Scene) -> None:
        surfaces = [scene.surfaces[name] for name in touched(scene)]
        self._surfaces, self._joints = len(surfaces), len(scene.joints)
        self._moved = [s for s, surface in enumerate(surfaces) if surface.moves]
        single = scene.single_bodies()
        self._led = {n: b for n, b in single.items() if b.prescribed and not b.fixed}
        self.led = list(self._led)
        self._scene, self._names = scene, tuple(scene.parameters)
        self.leads = bool(self._moved or self.led)
        self.any = bool(self.leads or self._joints)
        # Tapes by the states of the controllers, whose controls paths of bodies may use.
        self._tapes: dict[Key, Tape] = {}

    def _tape(self, states: Mapping[str, str]) -> Tape:
        """Return all paths over what controllers remember, parameters and time."""
        key = tuple(states.values())
        if key not in self._tapes:
            scene = self._scene
            parameters, time = symbols_of(self._names), sp.Symbol("t", real=True)
            remembered, sets = scene.controlled.controller_state, dict[str, FormulaText]()
            memory = {name: sp.Symbol(f"w{i}", real=True) for i, name in enumerate(remembered)}
            known = {TIME: time, **memory, **dict(zip(self._names, parameters, strict=True))}
            expressions = [
                e
                for s in self._moved
                for e in surface_frame(scene.surfaces[touched(scene)[s]], known)
            ]
            for joint in scene.joints.values():
                path = joint.to if isinstance(joint.to, Path) else Path(x=0, y=0)
                expressions += [parse(text or 0).to_sympy(known) for text in (path.x, path.y)]
            for region, state in states.items():
                sets |= scene.controlled.values(region, state)
            for control in scene.controlled.order:
                # Those that depend on bodies are in no path.
                if parse(sets[control]).names <= known.keys():
                    known[control] = parse(sets[control]).to_sympy(known)
            for body in self._led.values():
                expressions += [parse(text).to_sympy(known) for text in body.path]
            self._tapes[key] = compile_tape(
                expressions, variables=tuple(memory.values()), parameters=parameters, time=time
            )
        return self._tapes[key]

    def none(self, count: int) -> Positions:
        """Return where all is at so many instants when nothing has a path."""
        frames, nowhere = np.zeros((count, self._surfaces, 3)), np.zeros((count, 0, 3))
        return Positions(frames, nowhere[:, :, :2], nowhere)

    def at(
        self,
        known: Mapping[str, float],
        times: Array,
        memories: Array,
        states: Mapping[str, str] | None = None,
    ) -> Positions:
        """Return where all is at instants, in these states of the controllers or the first."""
        count, moved, joints = len(times), len(self._moved), self._joints
        if not self.any:
            return self.none(count)
        frames = np.zeros((count, self._surfaces, 3))
        values = np.array([known[name] for name in self._names], dtype=float)
        tape = self._tape(states or self._scene.controlled.initial)
        found = tape.table(memories, values, times)
        of_joints, of_bodies = 3 * moved, 3 * moved + 2 * joints
        frames[:, self._moved] = found[:, :of_joints].reshape(count, moved, 3)
        places = np.array(found[:, of_joints:of_bodies]).reshape(count, joints, 2)
        poses = np.array(found[:, of_bodies:]).reshape(count, len(self.led), 3)
        return Positions(frames, places, poses)


def _previous_frames(now: Array, look: Array) -> Array:
    """Return frames (m, 3) half a step before `now`, as far as they are at the `look` after it.

    What turns about a point continues to do so.
    """
    before = 2.0 * now - look
    turned = before[:, 2] - now[:, 2]
    cos, sin = np.cos(turned), np.sin(turned)
    dx, dy = (now - look)[:, :2].T
    before[:, :2] = now[:, :2] + np.stack([cos * dx - sin * dy, sin * dx + cos * dy], -1)
    return before


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
# Paths that differ by more than this part of the largest coordinate have jumped: round-off of what
# is integrated from step to step is less.
_JUMPED = 1e-9


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
        self.joints, self.leads = tuple(mechanics.scene.joints), paths.leads
        # Where what has a path was at the last detection, and what the length of that step was.
        self._last: tuple[Positions, float] | None = None
        self._saved: tuple[Positions, float] | None = None
        # Where it was at the end of the last step, when that was, and what was remembered then.
        self._ends: tuple[Array, Array] | None = None
        self._end: tuple[float, Positions] | None = None
        self.switch(mechanics.scene.controlled.initial)

    def switch(self, states: Mapping[str, str]) -> None:
        """Go on with controllers in other states."""
        self._states = states
        self.forces = self._mechanics.forces_at(states, self._values)
        self._controls = self._mechanics.control_values(states)

    def captured(self, joint: str, remembered: Array) -> dict[str, float]:
        """Return the pose that a joint has captured as it closed: x, y and turn."""
        known = dict(zip(self._mechanics.controller_state, remembered.tolist(), strict=True))
        names = captured(joint, self._mechanics.scene.joints[joint])
        return {name.rpartition(".")[2]: known[name] for name in names}

    def place_of(self, joint: int, time: float, remembered: Array) -> Array:
        """Return where a joint holds its point in the world at an instant."""
        found: Array = self._now(time, remembered).places[0, joint]
        return found

    def forget(self) -> None:
        """Take back the last steps."""
        self._last = self._saved

    def restart(self) -> None:
        """Let surfaces and led bodies move from here on as if they had always moved so."""
        self._last = None

    def prescribe(
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
        now = self._paths.at(self._known, times[:1], memories[:1], self._states)
        looks = self._paths.at(self._known, times[1::2], memories[1::2], self._states)
        before = Positions(
            _previous_frames(now.frames[0], looks.frames[0])[None],
            2.0 * now.places - looks.places[:1],
            _previous_frames(now.poses[0], looks.poses[0])[None],
        )
        if self._last is not None and self._last[1] == h and not self.jumped(start, remembered):
            before = self._last[0]
        self._saved = self._last
        self._looks, self._h, self._ends = looks, h, (times[2::2], memories[2::2])
        rows = Positions(*(np.concatenate(pair) for pair in zip(before, looks, strict=True)))
        known = len(looks.frames)
        for paths in rows:
            ends = np.flatnonzero(~np.isfinite(paths[1:]).all(axis=(1, 2)))
            known = min([known, *ends[:1].tolist()])
        if known == 0:
            raise NonFinite(
                f"{self._without(looks)} has no value, or an infinite one, at t = {times[1]:.6g}"
            )
        for paths in rows if known < len(looks.frames) else ():
            paths[known + 1 :] = 2.0 * paths[known] - paths[known - 1]
        return Prescribed(*rows, seen, forces), memories[2::2], known

    def jumped(self, start: float, remembered: Array) -> list[str]:
        """Return whose paths are elsewhere at an instant than the last step has left them."""
        if self._end is None or abs(self._end[0] - start) > _SAME_MOTION * self._h:
            return []
        before, now = self._end[1], self._now(start, remembered)
        found = []
        for names, one, other in zip(self._named, before, now, strict=True):
            far = np.abs(other - one)[0] > _JUMPED * np.abs(other).max(initial=0.0)
            found += [name for name, away in zip(names, far, strict=True) if away.any()]
        return found

    def _now(self, time: float, remembered: Array) -> Positions:
        return self._paths.at(self._known, np.array([time]), remembered[None], self._states)

    @cached_property
    def _named(self) -> tuple[list[str], list[str], list[str]]:
        scene = self._mechanics.scene
        return (
            [f"surface {name!r}" for name in touched(scene)],
            [f"joint {name!r}" for name in scene.joints],
            [f"body {name!r}" for name in self._paths.led],
        )

    def _without(self, looks: Positions) -> str:
        """Return whose path has no value at the first of some looks."""
        lost = [
            name
            for names, paths in zip(self._named, looks, strict=True)
            for name, pose in zip(names, paths[0], strict=True)
            if not np.isfinite(pose).all()
        ]
        return f"the path of {lost[0]}"

    @property
    def count(self) -> int:
        """Number of values that controllers give."""
        return len(controlled_symbols(self._mechanics))

    def control_values(self, start: float, h: float, states: Array) -> Array:
        """Return the controls (k, c) in the middles of steps between states (k + 1, w)."""
        times: Array = start + h * (0.5 + np.arange(len(states) - 1.0))
        return self._controls.table(0.5 * (states[:-1] + states[1:]), self._values, times)

    def passed(self, count: int) -> None:
        """Note how many of these steps were taken."""
        if count and self._paths.any:
            self._last = Positions(*(rows[count - 1 : count] for rows in self._looks)), self._h
            assert self._ends is not None
            time, remembered = float(self._ends[0][count - 1]), self._ends[1][count - 1]
            if self.controlled:
                self._end = time, self._now(time, remembered)
