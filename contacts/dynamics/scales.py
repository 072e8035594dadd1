"""A scene's own units of length, speed, acceleration and force."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.solvers.saddle_point import largest_sizes
from statechart.arrays import Array
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse

_EPS = float(np.finfo(float).eps)
# Beyond these the squares of lengths, times and rates leave the floats; a length below is none.
_LEAST, _MOST = 1e-100, 1e100


@dataclass(frozen=True, eq=False)
class Scales:
    """The sizes that a scene's numbers are compared with; no tolerance of ours is absolute.

    Attributes
    ----------
    length, speed, acceleration, force : float
        In the scene's units.
    sizes : (2 n,) array
        How large each coordinate and each rate is: what moves a point by the length, in the time
        that this takes at the speed.
    """

    length: float
    speed: float
    acceleration: float
    force: float
    sizes: Array


def check_range(number: float, what: str, loc: tuple[str, ...]) -> None:
    """Raise `DeclarationProblem` where the square of a length, a speed or the like is no float."""
    if abs(number) > _MOST:
        raise DeclarationProblem(
            f"{what} must be at most {_MOST:g}, not {number:g}".lstrip(),
            advice="take larger units",
            loc=loc,
        )


class ScaleTape:
    """Reads the scales off the initial state.

    The length is the largest coordinate of a body or contact point (rounding is proportional to
    it); acceleration is gravity's, or what the initial forces and velocities give; speed and
    force follow.

    Parameters
    ----------
    mechanics : Mechanics
        The scene's equations.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        scene = mechanics.scene
        lengths: list[sp.Expr] = []
        speeds: list[sp.Expr] = []
        owners: list[tuple[str, ...]] = []
        masses: list[sp.Expr] = []
        for name, body in scene.bodies.items():
            centre, _ = mechanics.body_frame(name)
            lengths += centre
            speeds += [mechanics.rate(component) for component in centre]
            owners += [("bodies", name)] * 2
            masses.append(parse(body.mass).to_sympy(mechanics.known))
        for name in scene.contacts:
            geometry = mechanics.contact(name)
            lengths += [geometry.symbols.gap, *geometry.point]
            speeds += [mechanics.rate(component) for component in geometry.point]
            owners += [("contacts", name)] * 3
        for name, joint in scene.joints.items():
            place = mechanics.point(joint.point)
            lengths += place
            speeds += [mechanics.rate(component) for component in place]
            owners += [("joints", name)] * 2
        pushes = [
            force / mechanics.mass_matrix[i, i]
            for i, force in enumerate(mechanics.generalised_forces)
            if mechanics.mass_matrix[i, i] != 0
        ]
        end = scene.stop.time
        duration = parse(end).to_sympy(mechanics.known) if end is not None else sp.S.One
        points = [mechanics.body_frame(name)[0] for name in scene.bodies]
        points += [mechanics.contact(name).point for name in scene.contacts]
        points += [mechanics.point(joint.point) for joint in scene.joints.values()]
        moves = [[sp.diff(c, q) for point in points for c in point] for q in mechanics.q]
        mass = sp.Add(*map(sp.Abs, masses))
        # Of each group the largest is wanted.
        groups = [lengths, speeds, pushes, [mass], [duration], *([g] for g in mechanics.gravity)]
        self._gravity = len(mechanics.gravity)
        groups += moves
        self._owners = owners
        self._begins = np.array([*accumulate(map(len, groups), initial=0)])
        self._tape = mechanics.tape(
            [expression for group in groups for expression in group],
            definitions=mechanics.controlled(),
        )

    def at(self, values: Array, state: Array) -> Scales:
        """Return the scales of a run that starts at `state` (2 n,).

        Raises
        ------
        DeclarationProblem
            If a place or the gravity there is not finite.
        """
        sizes = np.empty(len(self._begins) - 1)
        numbers = self._tape.at(state, values, 0.0)
        checked = np.abs(numbers[: 2 * len(self._owners)]).max(initial=0.0)
        pulls = np.abs(numbers[self._begins[5] : self._begins[5 + self._gravity]]).max(initial=0.0)
        if not (checked <= _MOST and pulls <= _MOST):
            self._check(numbers)
        largest_sizes(numbers, self._begins, sizes)
        largest = sizes.tolist()
        length, speed, push, mass, duration = largest[:5]
        moves = largest[5 + self._gravity :]
        duration = min(max(duration, _LEAST), _MOST)
        acceleration = math.hypot(*largest[5 : 5 + self._gravity]) or push
        # A start that is off zero by rounding of what the motion needs to turn has no length.
        turn = speed**2 / acceleration if acceleration > 0.0 else 0.0
        if length <= max(_LEAST, _EPS * turn):
            length = max(speed * duration, acceleration * duration**2) or 1.0
        acceleration = max(acceleration, speed**2 / length)
        if acceleration == 0.0:
            acceleration = length / duration**2
        speed = max(speed, math.sqrt(acceleration * length))
        # A coordinate that moves no point is an angle about a centre.
        coordinates = [length / move if move > 0.0 else 1.0 for move in moves]
        sizes = np.array([*coordinates, *(size * (speed / length) for size in coordinates)])
        return Scales(length, speed, acceleration, mass * acceleration, sizes)

    def _check(self, numbers: Array) -> None:
        """Raise at the first place, speed or gravity that is not finite or too large."""
        for place, owner in enumerate(self._owners):
            if not math.isfinite(numbers[place]):
                raise DeclarationProblem(
                    "its place at the start is not finite",
                    advice="look for a logarithm, a root or a quotient without a value there",
                    loc=owner,
                )
            check_range(numbers[place], "its place at the start", owner)
            speed = numbers[len(self._owners) + place]
            check_range(speed, "its speed at the start", owner)
        gravity = numbers[self._begins[5] : self._begins[5 + self._gravity]]
        if not np.isfinite(gravity).all():
            raise DeclarationProblem("must be finite", loc=("gravity",))
        for number in gravity:
            check_range(number, "", ("gravity",))
