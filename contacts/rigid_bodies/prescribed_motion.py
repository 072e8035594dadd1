"""Prescribed motion of surfaces and led bodies, controllers and forces in the next steps."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np

from contacts.collision_detection.midpoint import LimitProgram, Prescribed
from contacts.rigid_bodies.declared_numbers import touchable_surfaces
from contacts.rigid_bodies.mechanics import BodyMechanics, led_bodies
from contacts.scene.expansion import captured_variables
from statechart.arrays import Array
from statechart.errors import NonFinite
from statechart.formulas.tape import Tape


class Positions(NamedTuple):
    """Positions of surfaces, world anchors of joints and led bodies at m instants."""

    frames: Array  # (m, s, 3): all surfaces that bodies touch.
    places: Array  # (m, j, 2): all joints; zero between two bodies.
    poses: Array  # (m, l, 3)


class Paths:
    """The paths of a scene.

    `led` are the names of led bodies; `any` is true if there are paths, `leads` if surfaces or
    bodies have some.
    """

    def __init__(self, mechanics: BodyMechanics) -> None:
        self._mechanics, scene = mechanics, mechanics.scene
        surfaces = touchable_surfaces(scene)
        self._surfaces, self._joints = len(surfaces), len(scene.joints)
        self._moved = [s for s, name in enumerate(surfaces) if scene.surfaces[name].moves]
        self.led = led_bodies(scene)
        self.leads = bool(self._moved or self.led)
        self.any = bool(self.leads or self._joints)

    def none(self, count: int) -> Positions:
        """Return the positions of a scene without paths."""
        frames, nowhere = np.zeros((count, self._surfaces, 3)), np.zeros((count, 0, 3))
        return Positions(frames, nowhere[:, :, :2], nowhere)

    def at(
        self,
        values: Array,
        times: Array,
        memories: Array,
        states: Mapping[str, str] | None = None,
    ) -> Positions:
        """Return the positions at instants, in these controller states or the initial ones."""
        count, moved, joints = len(times), len(self._moved), self._joints
        if not self.any:
            return self.none(count)
        frames = np.zeros((count, self._surfaces, 3))
        tapes = self._mechanics.at(states or self._mechanics.scene.controlled.initial)
        found = tapes.paths.table(memories, values, times)
        of_joints, of_bodies = 3 * moved, 3 * moved + 2 * joints
        frames[:, self._moved] = found[:, :of_joints].reshape(count, moved, 3)
        places = np.array(found[:, of_joints:of_bodies]).reshape(count, joints, 2)
        poses = np.array(found[:, of_bodies:]).reshape(count, len(self.led), 3)
        return Positions(frames, places, poses)


def _previous_frames(now: Array, later: Array) -> Array:
    """Return frames (m, 3) half a step before `now` by mirroring `later`, half a step after it.

    Rotation about a point continues uniformly.
    """
    before = 2.0 * now - later
    turned = before[:, 2] - now[:, 2]
    cos, sin = np.cos(turned), np.sin(turned)
    dx, dy = (now - later)[:, :2].T
    before[:, :2] = now[:, :2] + np.stack([cos * dx - sin * dy, sin * dx + cos * dy], -1)
    return before


def integrate(rates: Tape, values: Array, remembered: Array, times: Array) -> Array:
    """Return controller variables (m, w) at instants (m,), from those at the first of them.

    Classical Runge-Kutta from each instant to the next: they do not depend on bodies.
    """
    result = np.empty((len(times), len(remembered)))
    result[0] = remembered
    if not len(remembered):
        return result
    if not len(rates.reads):
        # Constant rates, as of clocks. Summed one by one, so that the chunks do not matter.
        result[1:] = np.outer(np.diff(times), rates.at(remembered, values, 0.0))
        sums: Array = np.cumsum(result, axis=0)
        return sums
    for k, h in enumerate(np.diff(times).tolist()):
        t, w = float(times[k]), result[k]
        first = rates.at(w, values, t)
        second = rates.at(w + 0.5 * h * first, values, t + 0.5 * h)
        third = rates.at(w + 0.5 * h * second, values, t + 0.5 * h)
        last = rates.at(w + h * third, values, t + h)
        result[k + 1] = w + h / 6.0 * (first + 2.0 * second + 2.0 * third + last)
    return result


# Round-off of a start in whole steps.
_SAME_MOTION = 1e-6
# Difference of paths, relative to the largest coordinate, that is a jump and not round-off of
# integration.
_JUMPED = 1e-9


class PrescribedMotion:
    """Prescribed motion and `forces` of one run, in the current controller states.

    `values` (p,) are those of the parameters; `controlled` is true if there are controllers.
    """

    def __init__(self, mechanics: BodyMechanics, paths: Paths, values: Array) -> None:
        self._mechanics, self._paths, self._values = mechanics, paths, values
        self.controlled = bool(mechanics.scene.regions)
        self.joints, self.leads = tuple(mechanics.scene.joints), paths.leads
        # Positions at the last detection, and its step size.
        self._last: tuple[Positions, float] | None = None
        self._saved: tuple[Positions, float] | None = None
        # Times and controller variables at the ends of the prescribed steps; positions at the last
        # end.
        self._ends: tuple[Array, Array] | None = None
        self._end: tuple[float, Positions] | None = None
        self._saved_end: tuple[float, Positions] | None = None
        self.switch(mechanics.scene.controlled.initial)

    def switch(self, states: Mapping[str, str]) -> None:
        """Change the states of the controllers."""
        self._states = states
        self._tapes = self._mechanics.at(states)
        self.forces = self._tapes.forces(self._values)
        self._limits = LimitProgram(*self._tapes.limits.program, self._values)

    def captured(self, joint: str, remembered: Array) -> dict[str, float]:
        """Return the pose that a joint captured as it closed: x, y and turn."""
        known = dict(zip(self._mechanics.controller_state, remembered.tolist(), strict=True))
        names = captured_variables(joint, self._mechanics.scene.joints[joint])
        return {name.rpartition(".")[2]: known[name] for name in names}

    def place_of(self, joint: int, time: float, remembered: Array) -> Array:
        """Return the world anchor of a joint at an instant."""
        place: Array = self._now(time, remembered).places[0, joint]
        return place

    def forget(self) -> None:
        """Revert the last steps."""
        self._last, self._end = self._saved, self._saved_end

    def restart(self) -> None:
        """Let surfaces and led bodies move from here on as if they had always moved so."""
        self._last = None

    def prescribe(
        self, start: float, h: float, remembered: Array, count: int
    ) -> tuple[Prescribed, Array, int]:
        """Return the prescribed motion of steps, controller variables at their ends, their number.

        The number ends where paths have no value. Before the run, after a change of step size and
        beyond the ends of paths, motion is extrapolated.

        Raises `NonFinite` if no step can be taken.
        """
        forces = self.forces.program
        # Counted from the start of the run, so that instants do not depend on chunks.
        number = round(start / h)
        first = number if abs(start - number * h) <= _SAME_MOTION * h else start / h
        times: Array = h * (first + 0.5 * np.arange(2 * count + 2, dtype=float))
        memories = integrate(self._tapes.flows, self._values, remembered, times)
        variables = np.concatenate([memories[:1], memories[1::2]])
        if not self._paths.any:
            return (
                Prescribed(*self._paths.none(count + 2), variables, forces, self._limits),
                memories[2::2],
                count + 1,
            )
        now = self._paths.at(self._values, times[:1], memories[:1], self._states)
        midpoints = self._paths.at(self._values, times[1::2], memories[1::2], self._states)
        before = Positions(
            _previous_frames(now.frames[0], midpoints.frames[0])[None],
            2.0 * now.places - midpoints.places[:1],
            _previous_frames(now.poses[0], midpoints.poses[0])[None],
        )
        if self._last is not None and self._last[1] == h and not self.jumped(start, remembered):
            before = self._last[0]
        self._saved, self._saved_end = self._last, self._end
        self._looks, self._h, self._ends = midpoints, h, (times[2::2], memories[2::2])
        rows = Positions(*(np.concatenate(pair) for pair in zip(before, midpoints, strict=True)))
        known = len(midpoints.frames)
        for paths in rows:
            ends = np.flatnonzero(~np.isfinite(paths[1:]).all(axis=(1, 2)))
            known = min([known, *ends[:1].tolist()])
        if known == 0:
            raise NonFinite(
                f"{self._without(midpoints)} has no value, or an infinite one, "
                f"at t = {times[1]:.6g}"
            )
        for paths in rows if known < len(midpoints.frames) else ():
            paths[known + 1 :] = 2.0 * paths[known] - paths[known - 1]
        return Prescribed(*rows, variables, forces, self._limits), memories[2::2], known

    def jumped(self, start: float, remembered: Array) -> list[str]:
        """Return the names whose path at an instant differs from the end of the last step."""
        if self._end is None or abs(self._end[0] - start) > _SAME_MOTION * self._h:
            return []
        before, now = self._end[1], self._now(start, remembered)
        found = []
        for names, one, other in zip(self._named, before, now, strict=True):
            far = np.abs(other - one)[0] > _JUMPED * np.abs(other).max(initial=0.0)
            found += [name for name, away in zip(names, far, strict=True) if away.any()]
        return found

    def _now(self, time: float, remembered: Array) -> Positions:
        return self._paths.at(self._values, np.array([time]), remembered[None], self._states)

    @cached_property
    def _named(self) -> tuple[list[str], list[str], list[str]]:
        scene = self._mechanics.scene
        return (
            [f"surface {name!r}" for name in touchable_surfaces(scene)],
            [f"joint {name!r}" for name in scene.joints],
            [f"body {name!r}" for name in self._paths.led],
        )

    def _without(self, midpoints: Positions) -> str:
        """Describe the first path without a value."""
        lost = [
            name
            for names, paths in zip(self._named, midpoints, strict=True)
            for name, pose in zip(names, paths[0], strict=True)
            if not np.isfinite(pose).all()
        ]
        return f"the path of {lost[0]}"

    @property
    def count(self) -> int:
        """Number of controlled values."""
        return len(self._mechanics.controls)

    def control_values(self, start: float, h: float, states: Array) -> Array:
        """Return the controls (k, c) at the midpoints of steps between states (k + 1, w)."""
        times: Array = start + h * (0.5 + np.arange(len(states) - 1.0))
        return self._tapes.controls.table(0.5 * (states[:-1] + states[1:]), self._values, times)

    def advance(self, count: int) -> None:
        """Note how many of the prescribed steps were taken."""
        if count and self._paths.any:
            self._last = Positions(*(rows[count - 1 : count] for rows in self._looks)), self._h
            assert self._ends is not None
            time, remembered = float(self._ends[0][count - 1]), self._ends[1][count - 1]
            if self.controlled:
                self._end = time, self._now(time, remembered)
