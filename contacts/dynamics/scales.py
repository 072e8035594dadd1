"""Characteristic length, speed, acceleration and force of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import sympy as sp

from contacts.dynamics.geometry import surface_frame
from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import MAGNITUDES
from contacts.scene.checks import MAX_SIZE
from contacts.scene.joints import Path
from statechart.arrays import EPS, Array, Ints
from statechart.automaton.margin_derivatives import derivative, tape_with_sizes
from statechart.errors import DeclarationProblem
from statechart.kernels.jets import tape_ranges
from statechart.kernels.jit import kernel

# Round-off of positions in units in the last place of the largest coordinate, accumulated over
# several steps.
_ROUNDING_UNITS = 16.0
# A turning surface moves a point by at most this multiple of its distance from the pivot.
_MAX_TURN_MOTION = 2.0
# Below it the squares of lengths, times and rates underflow.
_MIN_SIZE = 1e-100
# The longest duration that gives a length without springs. A later end means "late enough": with
# T = 1e8 the round-off of g T^2 would hide a fall of 1.
_LONGEST = 1e4


@dataclass(frozen=True, eq=False)
class Scales:
    """Characteristic sizes of a scene; all tolerances are relative to them."""

    # `length`, `speed`, `acceleration`, `force`: In the scene's units; independent of the origin
    length: float
    speed: float
    acceleration: float
    force: float
    # Round-off of positions, in the unit of length: units in the last place of the largest
    # coordinate
    rounding: float
    # (2 n,): Changes of each coordinate and rate that move a point by the length, or change its
    # velocity by the speed
    sizes: Array
    # Converts angles of couplings to lengths: the length; 1 in a scene without one
    lever: float = 1.0

    @property
    def numbers(self) -> Array:
        """The scales (6,) as `measure` writes them."""
        scales = self.length, self.speed, self.acceleration, self.force, self.rounding, self.lever
        return np.array(scales, float)

    @property
    def farthest(self) -> float:
        """The largest coordinate."""
        return self.rounding / (_ROUNDING_UNITS * EPS)

    @property
    def coordinates(self) -> Array:
        """The sizes (n,) of the coordinates."""
        return self.sizes[: len(self.sizes) // 2]

    def solved(self, count: int) -> Array:
        """Return the sizes of `count` unknowns: accelerations, then forces."""
        rates = self.sizes[len(self.sizes) // 2 :]
        forces = np.full(count - len(rates), self.force)
        return np.concatenate([rates * (self.speed / self.length), forces])


def check_range(number: float, quantity: str, loc: tuple[str, ...]) -> None:
    """Raise `DeclarationProblem` if the square of a quantity overflows."""
    if abs(number) > MAX_SIZE:
        raise DeclarationProblem(
            f"{quantity} must be at most {MAX_SIZE:g}, not {number:g}".lstrip(),
            advice="take larger units",
            loc=loc,
        )


class VariableSizes:
    """Sizes of the state with the controllers' variables.

    The size of a variable is its start. From zero it is the change in the scene's unit of time, by
    the terms of its rates in all states; 1 if only updates change it.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        controls = mechanics.scene.controlled
        symbols, parameters = mechanics.state, mechanics.parameters.ordered
        known, found = {*symbols, *parameters, mechanics.time}, dict[tuple[int, sp.Expr], None]()
        for region in {*controls.flowing.values()}:
            for state in controls.flat[region].states:
                values = mechanics.values_in({**controls.initial, region: state})
                rates = mechanics.controller_rates_in(values).values()
                moving = ((k, rate) for k, rate in enumerate(rates) if rate != 0)
                found |= {(k, r): None for k, r in moving if r.free_symbols <= known}
        self._places = np.array([k for k, _ in found], np.int64)
        named = set[sp.Basic]().union(*(rate.free_symbols for _, rate in found))
        self._read = np.array([k for k, one in enumerate(symbols) if one in named], np.int64)
        read, terms = tuple(symbols[k] for k in self._read), tuple(rate for _, rate in found)
        self._tape = tape_with_sizes(terms, read, parameters, mechanics.time)

    def at(self, scales: Scales, values: Array, initial: Array) -> Array:
        """Return the sizes of coordinates, rates and variables."""
        sizes = np.concatenate([scales.sizes, np.abs(initial[len(scales.sizes) :])])
        memory, unit = sizes[len(scales.sizes) :], scales.length / scales.speed
        while (zero := memory[self._places] == 0.0).any():
            inputs = np.concatenate([initial[self._read], sizes[self._read]])
            terms = self._tape.values(inputs, values, unit)
            terms = np.where(np.isfinite(terms[len(zero) :]), terms[len(zero) :], 0.0)
            np.maximum.at(memory, self._places[zero], unit * terms[zero])
            if not (memory[self._places[zero]] > 0.0).any():
                break
        memory[memory == 0.0] = 1.0
        return sizes


# Groups of numbers that determine the scales; the components of gravity, then derivatives of
# positions by each coordinate, follow from GRAVITY on.
(
    PLACES, SPEEDS, PUSHES, STIFFNESS, MASS, DURATION, ACROSS, UPWARD, GAPS, EXTENTS, LEVERS,
    GRAVITY,
) = range(12)  # fmt: skip

# Least lever of a coordinate, as a part of the radius of gyration of a body that it turns.
_LEAST_LEVER = 1e-3


class ScaleTape:
    """Determines the scales from the initial state and the prescribed motions of a run.

    The length is the largest of the extents (radii, points of bodies, levers of surfaces that
    turn), the differences of positions, the initial gaps and the ranges of the prescribed motions;
    and at least the stopping distance ``v^2 / a``. Without extents, and if none of the others
    exceeds the round-off of the distances ``v T`` and ``a T^2`` covered by the run, the length is
    that distance; T is a shorter period of springs, or the duration up to 1e4. The acceleration
    is the largest of gravity (or of the forces without it) and of the prescribed motions; speed and
    force follow.

    The outputs of `tape` are groups of numbers that begin at `begins` (g + 1,). `places` counts the
    numbers of positions and their speeds, `gravity` the groups of gravity, `paths` the prescribed
    motions. `motions`, whose ranges over the run are needed, has prescribed displacements and
    angles of surfaces; their first and second derivatives; and accelerations by forces that vary in
    time.
    """

    def __init__(self, mechanics: Mechanics) -> None:
        scene = mechanics.scene
        points = {
            **{("bodies", name): mechanics.body_frame(name)[0] for name in scene.bodies},
            **{("contacts", name): mechanics.contact(name).point for name in scene.contacts},
            **{("joints", name): mechanics.point(own.point) for name, own in scene.joints.items()},
        }
        places = [(owner, place) for owner, point in points.items() for place in point]
        gaps = [mechanics.contact(name).gap for name in scene.contacts]
        lengths = [*(place for _, place in places), *gaps]
        speeds = [mechanics.rate(place) for _, place in places]
        masses = [mechanics.formula(body.mass) for body in scene.bodies.values()]
        accelerations = [
            (force / row[i], mechanics.q[i])
            for i, (force, row) in enumerate(
                zip(mechanics.generalised_forces, mechanics.mass_matrix, strict=True)
            )
            if row.get(i, 0) != 0
        ]
        pushes = [push for push, _ in accelerations]
        extents = _extents(mechanics)
        springs = [] if extents else [derivative(push, q) for push, q in accelerations]
        duration = mechanics.formula(1 if scene.stop.time is None else scene.stop.time)
        moving: dict[sp.Symbol, list[sp.Expr]] = {q: [] for q in mechanics.q}
        for _, place in places:
            for q in moving.keys() & place.free_symbols:
                moving[q].append(sp.diff(place, q))
        # At a dead point of a linkage the derivatives of its points may be round-off.
        for name, body in scene.bodies.items():
            for q in moving.keys() & mechanics.body_frame(name)[1].free_symbols:
                if body.position is not None and moving[q]:
                    mass, inertia = mechanics.inertia(name, body)
                    turn = sp.diff(mechanics.body_frame(name)[1], q)
                    moving[q].append(_LEAST_LEVER * turn * sp.sqrt(inertia / mass))
        moves = [derivatives or [sp.S.Zero] for derivatives in moving.values()]
        mass = sp.Add(*map(sp.Abs, masses))
        across, upward = _positions(mechanics)
        shifts, turns, levers = _prescribed(mechanics)
        gravity = [[g] for g in mechanics.gravity]
        # The scales use the largest number of each group.
        groups = [lengths, speeds, pushes, springs, [mass], [duration], across, upward, gaps]
        groups += [extents, levers, *gravity, *moves]
        self.gravity = len(gravity)
        # Owners of positions and gaps, and of speeds.
        self._movers = [owner for owner, _ in places]
        self._owners = [*self._movers, *(("contacts", name) for name in scene.contacts)]
        # Positions of contacts that may be off need not be finite.
        self._gated = {("contacts", name) for name in scene.contacts if scene.gate(name)}
        self.places = len(lengths) + len(speeds)
        self.begins = np.array([*accumulate(map(len, groups), initial=0)])
        self.tape = mechanics.tape(
            [expression for group in groups for expression in group],
            definitions=mechanics.controlled(),
        )
        moved = [*shifts, *turns]
        driven = [push for push in pushes if mechanics.time in push.free_symbols]
        if any(g != 0 for g in mechanics.gravity):
            driven = []
        self.paths, self.size = len(moved), len(mechanics.variables)
        self.motions = mechanics.tape(
            [motion for k in range(3) for motion in _derived(moved, mechanics.time, k)] + driven,
            definitions=mechanics.controlled(),
        )

    def at(self, values: Array, state: Array) -> Scales:
        """Return the scales of a run that starts at `state`.

        Raises `DeclarationProblem` if a place or the gravity there is not finite.
        """
        numbers = self.tape.at(state, values, 0.0)
        ranges = np.empty((len(self.motions.outputs), 2))
        scales, sizes = np.empty(6), np.empty(self.size)
        duration = horizon(numbers, self.begins)
        tape_ranges(*self.motions.program, state, values, duration, ranges)
        counts = self.places, self.gravity, self.paths
        if not measure(numbers, self.begins, *counts, ranges, scales, sizes):
            self._check(numbers)
        length, speed, acceleration, force, rounding, lever = scales.tolist()
        return Scales(length, speed, acceleration, force, rounding, sizes, lever)

    def _check(self, numbers: Array) -> None:
        """Raise at the first place, speed or gravity that is not finite or too large."""
        owners = [("place", owner) for owner in self._owners]
        owners += [("speed", owner) for owner in self._movers]
        for (quantity, owner), number in zip(owners, numbers, strict=False):
            if not math.isfinite(number):
                if owner in self._gated:
                    continue
                raise DeclarationProblem(
                    f"its {quantity} at the start is not finite",
                    advice="look for a logarithm, a root or a quotient without a value there",
                    loc=owner,
                )
            check_range(number, f"its {quantity} at the start", owner)
        gravity = numbers[self.begins[GRAVITY] : self.begins[GRAVITY + self.gravity]]
        if not np.isfinite(gravity).all():
            raise DeclarationProblem("must be finite", loc=("gravity",))
        for number in gravity:
            check_range(number, "", ("gravity",))


def _positions(mechanics: Mechanics) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Return x and y, in the world, of bodies, points of contacts and joints, and ends of edges."""
    scene = mechanics.scene
    positions = [mechanics.body_frame(name)[0] for name in scene.bodies]
    for contact in scene.contacts.values():
        positions.append(mechanics.point(contact.point))
        positions += mechanics.edge_ends(scene.surfaces[contact.surface])
    across, upward = [x for x, _ in positions], [y for _, y in positions]
    for joint in scene.joints.values():
        ends = mechanics.point(joint.point), mechanics.joint_end(joint.to)
        for component, *coordinates in zip(("X", "Y"), *ends, strict=True):
            if component in joint.components:
                (across if component == "X" else upward).extend(coordinates)
    return across, upward


def _derived(expressions: Iterable[sp.Expr], symbol: sp.Symbol, order: int) -> list[sp.Expr]:
    derivatives = list(expressions)
    for _ in range(order):
        derivatives = [derivative(expression, symbol) for expression in derivatives]
    return derivatives


def _extents(mechanics: Mechanics) -> list[sp.Expr]:
    scene = mechanics.scene
    texts = [contact.radius for contact in scene.contacts.values()]
    texts += [scene.surfaces[contact.surface].radius for contact in scene.contacts.values()]
    texts += [text for contact in scene.contacts.values() for text in contact.point.at]
    texts += [t for joint in scene.joints.values() for t in (*joint.point.at, joint.rod)]
    extents = [mechanics.formula(text) for text in texts if text is not None]
    return [extent for extent in extents if extent != 0]


def _prescribed(mechanics: Mechanics) -> tuple[list[sp.Expr], list[sp.Expr], list[sp.Expr]]:
    """Return prescribed displacements, angles of surfaces that turn, and levers to their pivots."""
    scene = mechanics.scene
    shifts: dict[sp.Expr, None] = {}
    turns: list[sp.Expr] = []
    levers: list[sp.Expr] = []
    for contact in scene.contacts.values():
        surface = scene.surfaces[contact.surface]
        shifts[mechanics.formula(surface.radius or 0)] = None
        if not surface.moves:
            continue
        shifts |= dict.fromkeys(mechanics.vector(surface.displacement))
        angle = surface_frame(surface, mechanics.known)[2]
        if angle != 0:
            px, py = mechanics.vector(surface.pivot)
            x, y = mechanics.point(contact.point)
            turns.append(angle)
            levers.append(sp.sqrt((x - px) ** 2 + (y - py) ** 2))
    for joint in scene.joints.values():
        if isinstance(joint.to, Path):
            shifts |= dict.fromkeys(mechanics.joint_end(joint.to))
    return [shift for shift in shifts if mechanics.time in shift.free_symbols], turns, levers


@kernel
def mass_unit(acceleration: float, force: float) -> float:
    """Return the power of two below the mass of a scene where that is extreme; else 0."""
    mass = force / acceleration
    if mass == 0.0 or MAGNITUDES[0] <= mass <= MAGNITUDES[1]:
        return 0.0
    return float(2.0 ** math.floor(math.log2(mass)))


@kernel
def horizon(numbers: Array, begins: Ints) -> float:
    """Return the duration of a run, between bounds whose squares are finite and positive."""
    duration = abs(numbers[begins[DURATION]])
    return min(max(duration, _MIN_SIZE), MAX_SIZE) if duration < math.inf else MAX_SIZE


@kernel
def measure(
    numbers: Array,
    begins: Ints,
    places: int,
    gravity: int,
    paths: int,
    ranges: Array,
    scales: Array,
    sizes: Array,
) -> bool:
    """Compute the scales from a scene's initial numbers; False if some are out of range.

    `ranges` (m, 2) are those of `ScaleTape.motions` over the run; see `ScaleTape` for the other
    inputs. Fills `scales` (6,) with length, speed, acceleration, force, round-off of positions and
    lever, and `sizes` (2 n,) of coordinates and rates.
    """
    n = sizes.shape[0] // 2
    groups = begins.shape[0] - 1
    largest, low, high = np.zeros(groups), np.full(groups, math.inf), np.full(groups, -math.inf)
    for group in range(groups):
        for i in range(begins[group], begins[group + 1]):
            if abs(numbers[i]) < math.inf:
                largest[group] = max(largest[group], abs(numbers[i]))
                low[group], high[group] = min(low[group], numbers[i]), max(high[group], numbers[i])
    in_range = True
    for i in range(begins[GRAVITY + gravity]):
        if i < places or i >= begins[GRAVITY]:
            in_range = in_range and abs(numbers[i]) <= MAX_SIZE
    duration, levers = horizon(numbers, begins), begins[LEVERS + 1] - begins[LEVERS]
    coordinates = max(largest[PLACES], largest[ACROSS], largest[UPWARD])
    reach = driven_speed = 0.0
    for i in range(paths):
        lowest, highest = ranges[i, 0], ranges[i, 1]
        rate = max(abs(ranges[paths + i, 0]), abs(ranges[paths + i, 1]))
        turn = i - (paths - levers)
        lever = 1.0 if turn < 0 else abs(numbers[begins[LEVERS] + turn])
        if highest - lowest < math.inf:
            width = highest - lowest if turn < 0 else min(highest - lowest, _MAX_TURN_MOTION)
            reach = max(reach, width * lever)
            if turn < 0:
                coordinates = max(coordinates, abs(lowest), abs(highest))
        if rate * lever < math.inf:
            driven_speed = max(driven_speed, rate * lever)
    acceleration = 0.0
    for i in range(GRAVITY, GRAVITY + gravity):
        acceleration = math.hypot(acceleration, largest[i])
    if acceleration == 0.0:
        acceleration = largest[PUSHES]
        for i in range(3 * paths, ranges.shape[0]):
            push = max(abs(ranges[i, 0]), abs(ranges[i, 1]))
            acceleration = max(acceleration, push) if push < math.inf else acceleration
    for i in range(paths):
        turn = i - (paths - levers)
        lever = 1.0 if turn < 0 else abs(numbers[begins[LEVERS] + turn])
        push = lever * max(abs(ranges[2 * paths + i, 0]), abs(ranges[2 * paths + i, 1]))
        acceleration = max(acceleration, push) if push < math.inf else acceleration
    rounding = _ROUNDING_UNITS * EPS * coordinates
    spread = max(largest[GAPS], high[ACROSS] - low[ACROSS], high[UPWARD] - low[UPWARD])
    extent = max(largest[EXTENTS], largest[LEVERS])
    length = extent
    if spread > rounding:
        length = max(length, spread)
    if acceleration > 0.0:
        reach = min(reach, driven_speed * driven_speed / acceleration)
    length, start, speed = max(length, reach), largest[SPEEDS], max(largest[SPEEDS], driven_speed)
    period = min(duration, _LONGEST)
    if largest[STIFFNESS] * (duration * duration) > 1.0:
        period = 1.0 / math.sqrt(largest[STIFFNESS])
    farthest = max(speed * period, acceleration * (period * period))
    has_length = True
    # Initial distances below the round-off of the distance covered give no length.
    if extent <= _MIN_SIZE and length <= max(_MIN_SIZE, EPS * farthest):
        length, has_length = farthest if farthest > 0.0 else 1.0, False
    elif acceleration > 0.0:
        length = max(length, min(start * duration, start * start / acceleration))
        speed = start
    acceleration = max(acceleration, speed * speed / length)
    if acceleration == 0.0:
        acceleration = length / (duration * duration)
    speed = max(start, driven_speed, math.sqrt(acceleration * length))
    scales[0], scales[1], scales[2] = length, speed, acceleration
    scales[3], scales[4] = largest[MASS] * acceleration, rounding
    scales[5] = length if has_length else 1.0
    for i in range(n):
        move = largest[GRAVITY + gravity + i]
        # A coordinate that moves no point is an angle about a centre.
        sizes[i] = length / move if move > 0.0 else 1.0
        sizes[n + i] = sizes[i] * (speed / length)
    return in_range
