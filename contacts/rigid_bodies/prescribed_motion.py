"""Prescribed motion of led bodies, controllers and forces in the next steps."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from contacts.collision_detection.midpoint import LimitProgram, Prescribed
from contacts.rigid_bodies.declared_numbers import joint_title, led_parts, rotated, surface_title
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.scene.expansion import captured_variables
from statechart.arrays import Array
from statechart.errors import NonFinite
from statechart.formulas.tape import Tape


class Paths:
    """The paths of a scene.

    `names` are those of the led bodies in messages: first so many `bodies` with a shape, then so
    many `surfaces`. `any` is true if there are paths, `leads` if surfaces or bodies have some.
    """

    def __init__(self, mechanics: BodyMechanics) -> None:
        self._mechanics = mechanics
        bodies, surfaces, joints = led_parts(mechanics.scene)
        declared = [f"body {name!r}" for name in bodies]
        self.names = [*declared, *map(surface_title, surfaces), *map(joint_title, joints)]
        self.bodies, self.surfaces = len(bodies), len(surfaces)
        self.any, self.leads = bool(self.names), bool(bodies or surfaces)

    def at(
        self,
        values: Array,
        times: Array,
        memories: Array,
        states: Mapping[str, str] | None = None,
    ) -> Array:
        """Return the poses (m, l, 3) of led bodies, in these controller states or the initial ones.

        `times` (m,); `memories` (m, w): controller variables.
        """
        if not self.any:
            return np.zeros((len(times), 0, 3))
        tapes = self._mechanics.at(states or self._mechanics.scene.controlled.initial)
        found = np.array(tapes.paths.table(memories, values, times))
        return found.reshape(len(times), len(self.names), 3)


def _previous_poses(now: Array, later: Array) -> Array:
    """Return poses (l, 3) half a step before `now` by mirroring `later`, half a step after it.

    Rotation about a point continues uniformly.
    """
    before = 2.0 * now - later
    before[:, :2] = now[:, :2] + rotated(before[:, 2] - now[:, 2], (now - later)[:, :2])
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
        self.scene, self.joints = mechanics.scene, mechanics.scene.joints
        self.leads = paths.leads
        # Poses at the last detection, and its step size.
        self._last: tuple[Array, float] | None = None
        self._saved: tuple[Array, float] | None = None
        # Times and controller variables at the ends of the prescribed steps; poses at the last end.
        self._ends: tuple[Array, Array] | None = None
        self.end: tuple[float, Array] | None = None
        self._saved_end: tuple[float, Array] | None = None
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
        names = captured_variables(joint, self.joints[joint])
        return {name.rpartition(".")[2]: known[name] for name in names}

    def poses(self, time: float, remembered: Array) -> Array:
        """Return the poses (l, 3) of led bodies at an instant."""
        found = self._paths.at(self._values, np.array([time]), remembered[None], self._states)
        return found.reshape(-1, 3)

    def save(self) -> None:
        """Let `forget` revert all steps from here on."""
        self._saved, self._saved_end = self._last, self.end

    def forget(self) -> None:
        """Revert the last steps."""
        self._last, self.end = self._saved, self._saved_end

    def restart(self) -> None:
        """Let led bodies move from here on as if they had always moved so."""
        self._last = None

    def prescribe(
        self, start: float, h: float, remembered: Array, count: int
    ) -> tuple[Prescribed, Array, int]:
        """Return the prescribed motion of steps, controller variables at their ends, their number.

        The number ends where paths have no value. Before the run, after a change of step size and
        beyond the ends of paths, motion is extrapolated.

        Raises `NonFinite` if no step can be taken.
        """
        # Counted from the start of the run, so that instants do not depend on chunks.
        number = round(start / h)
        first = number if abs(start - number * h) <= _SAME_MOTION * h else start / h
        times: Array = h * (first + 0.5 * np.arange(2 * count + 2, dtype=float))
        memories = integrate(self._tapes.flows, self._values, remembered, times)
        midpoints = self._paths.at(self._values, times[1::2], memories[1::2], self._states)
        before = _previous_poses(self.poses(times[0], memories[0]), midpoints[0])
        if self._last is not None and self._last[1] == h and not self.jumped(start, remembered):
            before = self._last[0]
        self._looks, self._h, self._ends = midpoints, h, (times[2::2], memories[2::2])
        rows, known = np.concatenate([before[None], midpoints]), len(midpoints)
        lost = ~np.isfinite(rows).all(axis=2)
        if lost[1:].any():
            known = int(np.argmax(lost[1:].any(axis=1)))
        if known == 0:
            raise NonFinite(
                f"the path of {self._paths.names[int(np.argmax(lost[1]))]} has no value, or an "
                f"infinite one, at t = {times[1]:.6g}"
            )
        if known < len(midpoints):
            rows[known + 1 :] = 2.0 * rows[known] - rows[known - 1]
        variables = np.concatenate([memories[:1], memories[1::2]])
        forces = self.forces.program
        return Prescribed(rows, variables, forces, self._limits), memories[2::2], known

    def jumped(self, start: float, remembered: Array) -> list[str]:
        """Return the names whose path at an instant differs from the end of the last step."""
        if self.end is None or abs(self.end[0] - start) > _SAME_MOTION * self._h:
            return []
        before, now = self.end[1], self.poses(start, remembered)
        far = np.abs(now - before).max(axis=1) > _JUMPED * np.abs(now).max(initial=0.0)
        return [name for name, away in zip(self._paths.names, far.tolist(), strict=True) if away]

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
            self._last = self._looks[count - 1], self._h
            assert self._ends is not None
            time, remembered = float(self._ends[0][count - 1]), self._ends[1][count - 1]
            if self.controlled:
                self.end = time, self.poses(time, remembered)
