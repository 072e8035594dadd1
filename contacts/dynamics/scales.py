"""A scene's own units of length, speed, acceleration and force."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from statechart.arrays import Array, Ints
from statechart.errors import DeclarationProblem
from statechart.formulas.formula import parse
from statechart.kernels.jit import seldom

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

    @property
    def with_time(self) -> Array:
        """The sizes of coordinates and rates, and of time behind them."""
        return np.append(self.sizes, self.length / self.speed)

    def state(self, memory: Array) -> Array:
        """Return the sizes of coordinates, rates and what controllers remember, at its start."""
        # What begins at zero does not tell how large it gets.
        return np.concatenate([self.sizes, np.where(memory == 0.0, 1.0, np.abs(memory))])

    def solved(self, count: int) -> Array:
        """Return the sizes of so many unknowns: of accelerations, and forces behind them."""
        rates = self.sizes[len(self.sizes) // 2 :]
        forces = np.full(count - len(rates), self.force)
        return np.concatenate([rates * (self.speed / self.length), forces])


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

    Attributes
    ----------
    tape : Tape
        Outputs: groups of numbers.
    begins : (g + 1,) array of int64
        Where each group begins.
    places, gravity : int
        How many numbers places and their speeds are; how many groups gravity is.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        scene = mechanics.scene
        lengths: list[sp.Expr] = []
        speeds: list[sp.Expr] = []
        owners: list[tuple[str, ...]] = []  # of lengths
        movers: list[tuple[str, ...]] = []  # of speeds
        masses: list[sp.Expr] = []
        for name, body in scene.bodies.items():
            centre, _ = mechanics.body_frame(name)
            lengths += centre
            speeds += [mechanics.rate(component) for component in centre]
            owners += [("bodies", name)] * 2
            movers += [("bodies", name)] * 2
            masses.append(parse(body.mass).to_sympy(mechanics.known))
        for name in scene.contacts:
            geometry = mechanics.contact(name)
            lengths += [geometry.symbols.gap, *geometry.point]
            speeds += [mechanics.rate(component) for component in geometry.point]
            owners += [("contacts", name)] * 3
            movers += [("contacts", name)] * 2
        for name, joint in scene.joints.items():
            place = mechanics.point(joint.point)
            lengths += place
            speeds += [mechanics.rate(component) for component in place]
            owners += [("joints", name)] * 2
            movers += [("joints", name)] * 2
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
        self.gravity = len(mechanics.gravity)
        groups += moves
        self._owners, self._movers = owners, movers
        # Their places are looked at where they are not off.
        self._gated = {("contacts", name) for name in scene.contacts if scene.gate(name)}
        self.places = len(owners) + len(movers)
        self.begins = np.array([*accumulate(map(len, groups), initial=0)])
        self.tape = mechanics.tape(
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
        numbers = self.tape.at(state, values, 0.0)
        scales, sizes = np.empty(4), np.empty(len(state))
        if not measure(numbers, self.begins, self.places, self.gravity, scales, sizes):
            self._check(numbers)
        length, speed, acceleration, force = scales.tolist()
        return Scales(length, speed, acceleration, force, sizes)

    def _check(self, numbers: Array) -> None:
        """Raise at the first place, speed or gravity that is not finite or too large."""
        owners = [("place", owner) for owner in self._owners]
        owners += [("speed", owner) for owner in self._movers]
        for (what, owner), number in zip(owners, numbers, strict=False):
            if not math.isfinite(number):
                if owner in self._gated:
                    continue
                raise DeclarationProblem(
                    f"its {what} at the start is not finite",
                    advice="look for a logarithm, a root or a quotient without a value there",
                    loc=owner,
                )
            check_range(number, f"its {what} at the start", owner)
        gravity = numbers[self.begins[5] : self.begins[5 + self.gravity]]
        if not np.isfinite(gravity).all():
            raise DeclarationProblem("must be finite", loc=("gravity",))
        for number in gravity:
            check_range(number, "", ("gravity",))


@seldom
def measure(
    numbers: Array, begins: Ints, places: int, gravity: int, scales: Array, sizes: Array
) -> bool:
    """Read the scales off a scene's numbers at the start; False where some are out of range.

    Parameters
    ----------
    numbers, begins, places, gravity
        See `ScaleTape`.
    scales : (4,), sizes : (2 n,) array
        To be filled: length, speed, acceleration, force; the sizes of coordinates and rates.
    """
    n = sizes.shape[0] // 2
    largest = np.zeros(begins.shape[0] - 1)
    for group in range(largest.shape[0]):
        for i in range(begins[group], begins[group + 1]):
            if largest[group] < abs(numbers[i]) < math.inf:
                largest[group] = abs(numbers[i])
    inside = True
    for i in range(begins[5 + gravity]):
        if i < places or i >= begins[5]:
            inside = inside and abs(numbers[i]) <= _MOST
    length, speed, push, mass = largest[0], largest[1], largest[2], largest[3]
    duration = min(max(largest[4], _LEAST), _MOST)
    acceleration = 0.0
    for i in range(5, 5 + gravity):
        acceleration = math.hypot(acceleration, largest[i])
    if acceleration == 0.0:
        acceleration = push
    # A start that is off zero by rounding of what the motion needs to turn has no length.
    turn = speed * speed / acceleration if acceleration > 0.0 else 0.0
    if length <= max(_LEAST, _EPS * turn):
        length = max(speed * duration, acceleration * (duration * duration))
        if length == 0.0:
            length = 1.0
    acceleration = max(acceleration, speed * speed / length)
    if acceleration == 0.0:
        acceleration = length / (duration * duration)
    speed = max(speed, math.sqrt(acceleration * length))
    scales[0], scales[1], scales[2], scales[3] = length, speed, acceleration, mass * acceleration
    for i in range(n):
        move = largest[5 + gravity + i]
        # A coordinate that moves no point is an angle about a centre.
        sizes[i] = length / move if move > 0.0 else 1.0
        sizes[n + i] = sizes[i] * (speed / length)
    return inside
