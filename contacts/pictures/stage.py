"""The stage of a scene: a film from the states of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from contacts.dynamics.geometry import rotation, surface_frame
from contacts.dynamics.mechanics import Mechanics
from contacts.pictures.bodies import BodyShapes, disc_of, led_ends
from contacts.pictures.links import compile_expressions
from contacts.scene.parts import Surface
from contacts.scene.scene import Scene
from contacts.states import OFF, OPEN
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.formulas.formula import evaluator, parse
from statechart.formulas.tape import Tape
from statechart.pictures.film import (
    HATCH,
    WORLD,
    Film,
    Shape,
    Touch,
    arrows,
    cones,
    ends_of,
    place_points,
)
from statechart.pictures.stage import FilmInstants

# Number of bodies above which there are no trails.
_MOST_TRAILS = 5
# Distance to which surfaces are searched, in picture sizes.
_FAR = 4.0
# Quantile of the forces that gets an arrow of a quarter of the picture.
_FEW = 0.9


class SceneStage:
    """The scene of an automaton as a stage; see `statechart.pictures.stage.Stage`."""

    def __init__(self, automaton: Automaton) -> None:
        scene = automaton.declaration
        assert isinstance(scene, Scene)
        self._automaton, self._scene = automaton, scene
        self._mechanics = Mechanics(scene.expanded)
        moving_surfaces = [n for n, s in scene.surfaces.items() if s.moves]
        self._bodies = {name: 1 + k for k, name in enumerate(scene.bodies)}
        self._led = led_ends(scene)
        first = 1 + len(self._bodies) + len(self._led)
        self._moved = {name: first + k for k, name in enumerate(moving_surfaces)}

    @property
    def observables(self) -> tuple[str, ...]:
        """Gaps and forces of contacts, coefficients of friction that change, gaps of ropes."""
        names = [f"{c}.{q}" for c in self._scene.contacts for q in ("gap", "V", "H", "friction")]
        names += [f"{name}.gap" for name in self._scene.joints]
        return tuple(name for name in names if name in self._automaton.observables)

    def film(self, moments: FilmInstants) -> Film:
        """Return the film of a scene at instants of a run; see `Stage`."""
        scene, regions = self._scene, self._automaton.regions
        key = moments.keys[0]
        states, unrecorded = tuple(self._automaton.recorded_states(key)), len(regions) - len(key)
        modes = np.zeros((len(moments.times), len(regions)), dtype=np.intp)
        for instant, key in enumerate(moments.keys):
            pairs = zip(states[unrecorded:], key, strict=True)
            modes[instant, unrecorded:] = [known.index(state) for known, state in pairs]
        never = frozenset(
            region.name
            for k, region in enumerate(regions)
            if OFF in states[k] and (modes[:, k] == states[k].index(OFF)).all()
        )
        poses = self._poses(moments)
        made = BodyShapes(self._mechanics, self._automaton, moments.parameters).shapes(never)
        shapes = [self._slackened(shape, moments, poses) for shape in made]
        touches = tuple(
            self._touch(name, moments, poses) for name in scene.contacts if name not in never
        )
        force = _typical_force(touches)
        closed = [
            np.array([states[t.region][k] not in OPEN for k in modes[:, t.region]]) for t in touches
        ]
        centres, half = self._window(moments, shapes, poses, touches, closed, force)
        unit = 2.0 * max(half)
        poses = self._wrap_straight_surfaces(poses, moments, HATCH * unit)
        carried = self._grounds(moments, poses, centres, 1.05 * np.array(half))
        trails = tuple(self._bodies.values()) if len(self._bodies) <= _MOST_TRAILS else ()
        names = tuple(region.name for region in regions)
        return Film(
            self._automaton.name, moments.times, moments.jumps, names, states, modes,
            (*carried, *shapes), poses, touches, centres, half, force, trails,
        )  # fmt: skip

    def _window(
        self,
        moments: FilmInstants,
        shapes: Sequence[Shape],
        poses: Array,
        touches: Sequence[Touch],
        closed: Sequence[NDArray[np.bool_]],
        force: float,
    ) -> tuple[Array, tuple[float, float]]:
        """Return the window of bodies, contacts, force arrows and supporting surfaces."""
        below = [self._below(touch, moments) for touch in touches]
        cloud = cloud_of(shapes, poses, [*(touch.places for touch in touches), *below])
        centres, half = window(cloud)
        known = self._scene.surfaces
        around = self._grounds(moments, poses, centres, _FAR * np.array(half))
        supporting = [s for s in around if known[s.name].body is None]
        cloud = include_near_surfaces(cloud, supporting, poses)
        if len(moments.times) == 1:
            cloud = include_nearest_points(cloud, supporting, poses)
        _, half = window(cloud)
        tips = [(t.places + arrows(t.forces, half, force))[:, None] for t in touches]
        rims = [
            np.where(when[:, None, None], cones(t, half), t.places[:, None])
            for t, when in zip(touches, closed, strict=True)
        ]
        return window(np.concatenate([cloud, *tips, *rims], axis=1))

    def _grounds(
        self, moments: FilmInstants, poses: Array, centres: Array, reach: Array
    ) -> tuple[Shape, ...]:
        """Return the visible parts of surfaces, for the reach of a picture."""
        shift = np.abs(poses[:, [WORLD, *self._moved.values()], :2]).max(axis=(0, 1))
        box = centres.min(axis=0) - reach - shift, centres.max(axis=0) + reach + shift
        frames = {
            name: self._bodies[s.body] if s.body is not None else self._moved.get(name, WORLD)
            for name, s in self._scene.surfaces.items()
        }
        return grounds(self._scene, moments.parameters, frames, box, 2.0 * float(reach.max()))

    def _below(self, touch: Touch, moments: FilmInstants) -> Array:
        """Return the surface point of a contact: vertically below it on a graph."""
        surface = self._scene.surface_of(touch.name)
        gap = moments.columns[f"{touch.name}.gap"][:, None]
        if surface.height is None or "x" not in parse(surface.height).names or surface.turn != 0:
            return touch.places - gap * touch.normals
        return touch.places - gap / touch.normals[:, 1:] * np.array([0.0, 1.0])

    @cached_property
    def _frames(self) -> Tape:
        """The poses of all frames but the world's."""
        mechanics = self._mechanics
        expressions: list[sp.Expr] = []
        for name in self._scene.bodies:
            (x, y), angle = mechanics.body_frame(name)
            expressions += [x, y, angle]
        for name in self._led:
            expressions += [*mechanics.joint_end(self._scene.joints[name].to), sp.S.Zero]
        for name in self._moved:
            expressions += surface_frame(self._scene.surfaces[name], mechanics.known)
        return compile_expressions(self._automaton, expressions)

    @cached_property
    def _contact_tapes(self) -> dict[str, Tape]:
        """The points of contacts, and the normals of their surfaces there, in the world."""
        mechanics, tapes = self._mechanics, {}
        for name, contact in self._scene.contacts.items():
            angle = mechanics.surface_frame(self._scene.surface_of(name))[1]
            n_x, n_y = rotation(angle)(mechanics.contact(name).normal)
            (x, y), radius = mechanics.point(contact.point), mechanics.formula(contact.radius or 0)
            expressions = [x - radius * n_x, y - radius * n_y, n_x, n_y]
            tapes[name] = compile_expressions(self._automaton, expressions)
        return tapes

    def _poses(self, moments: FilmInstants) -> Array:
        moving = self._frames.table(moments.states, moments.values, moments.times)
        still = np.zeros((len(moments.times), 1, 3))
        return np.concatenate([still, moving.reshape(len(moments.times), -1, 3)], axis=1)

    def _slackened(self, shape: Shape, moments: FilmInstants, poses: Array) -> Shape:
        """Return a rope with the instants at which it is longer than the distance of its ends."""
        if shape.kind != "rope":
            return shape
        first, last = ends_of(shape, poses)
        distance = np.hypot(*(last - first).T)
        slack = moments.columns.get(f"{shape.name}.gap")
        if slack is None:
            length = parse(self._scene.joints[shape.name].rope or 0).value(moments.parameters)
            slack = length - distance
        return replace(shape, slack=slack > _SLACK * distance)

    def _wrap_straight_surfaces(self, poses: Array, moments: FilmInstants, spacing: float) -> Array:
        """Return the poses with straight surfaces moved along themselves by less than a stroke.

        Their hatching looks the same.
        """
        result = poses.copy()
        for name, frame in self._moved.items():
            surface = self._scene.surfaces[name]
            if surface.turn != 0 or not surface.straight:
                continue
            _, direction = np.array(surface.point_and_direction(evaluator(moments.parameters)))
            projections = result[:, frame, :2] @ direction
            whole = spacing * np.round(projections / spacing)
            result[:, frame, :2] -= whole[:, None] * direction
        return result

    def _touch(self, name: str, moments: FilmInstants, poses: Array) -> Touch:
        contact = self._scene.contacts[name]
        values = self._contact_tapes[name].table(moments.states, moments.values, moments.times)
        places, normals = values[:, :2], values[:, 2:]
        radius = disc_of(self._scene, contact, evaluator(moments.parameters))
        places = places - radius * normals
        names = [region.name for region in self._automaton.regions]
        region = names.index(name)
        zeros = np.zeros(len(moments.times))
        # Contacts without recorded modes show the forces of steps.
        place = region - len(names)
        open_ = np.array([len(key) >= -place and key[place] in OPEN for key in moments.keys])
        normal, tangential = (
            np.where(open_, 0.0, np.nan_to_num(moments.columns.get(f"{name}.{force}", zeros)))
            for force in ("V", "H")
        )
        tangents = np.column_stack([normals[:, 1], -normals[:, 0]])
        forces = normal[:, None] * normals + tangential[:, None] * tangents
        friction = moments.columns.get(f"{name}.friction")
        if friction is None:
            unbounded = np.inf if contact.friction is None and "pin" in contact.kinds else 0.0
            friction = np.full(len(zeros), moments.parameters.get(f"{name}.friction", unbounded))
        return Touch(name, region, places, normals, forces, friction)


def _typical_force(touches: tuple[Touch, ...]) -> float:
    sizes = [np.hypot(*touch.forces.T) for touch in touches]
    sizes = [size[size > 0.0] for size in sizes]
    positive = np.concatenate(sizes) if sizes else np.empty(0)
    return float(np.quantile(positive, _FEW)) if len(positive) else 1.0


# Margin around the content, relative to its size.
_MARGIN = 0.15
# Largest aspect ratio; window of a body that moves farther and is followed, in its sizes.
_LONGEST, _FOLLOWED = 4.0, 3.0
# Smallest aspect ratio.
_SHORTEST = 0.45
_ROUND = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
# Size, relative to the moving bodies, up to which a surface is shown whole; the same for one that
# surrounds them.
_AROUND, _ROUND_ABOUT = 2.2, 6.0
# Distance of surfaces shown in a still picture, in half sizes of the bodies: beyond it bodies would
# be dots.
_VISIBLE = 20.0
# Clearance above which a rope is drawn slack, relative to the distance of its ends.
_SLACK = 1e-3
# Smoothing window of the camera, relative to the run.
_SMOOTH = 0.04


def cloud_of(shapes: Sequence[Shape], poses: Array, places: Sequence[Array]) -> Array:
    """Return all visible points at every instant (k, m, 2)."""
    clouds = [at[:, None, :] for at in places if np.isfinite(at).any()]
    for shape in shapes:
        points = shape.points
        if shape.kind == "disc":
            points = points + shape.radius * np.column_stack([np.cos(_ROUND), np.sin(_ROUND)])
        ends = [(points, shape.frame)]
        if shape.other != shape.frame:
            ends = [(points[:1], shape.frame), (points[-1:], shape.other)]
        clouds += [place_points(part, poses[:, frame]) for part, frame in ends]
    cloud = np.concatenate(clouds, axis=1)
    return np.where(np.isfinite(cloud), cloud, np.nanmean(cloud, axis=(0, 1)))


def window(cloud: Array) -> tuple[Array, tuple[float, float]]:
    """Return the centre (k, 2) of the picture at every instant, and half its width and height."""
    low, high = cloud.min(axis=1), cloud.max(axis=1)
    least, most = low.min(axis=0), high.max(axis=0)
    whole, own = most - least, (high - low).max(axis=0)
    centres = np.tile((least + most) / 2.0, (len(cloud), 1))
    half = whole / 2.0
    for axis in (0, 1):
        size = max(own.max(), whole[1 - axis])
        if size > 0.0 and whole[axis] > _LONGEST * size:
            half[axis] = _FOLLOWED * size / 2.0
            centres[:, axis] = _smooth(((low + high) / 2.0)[:, axis])
    half = half * (1.0 + 2.0 * _MARGIN)
    largest = float(half.max()) or 1.0
    half = np.maximum(half, _SHORTEST * largest)
    return centres, (float(half[0]), float(half[1]))


def include_near_surfaces(cloud: Array, surfaces: Sequence[Shape], poses: Array) -> Array:
    """Return a cloud with the surfaces that end near it.

    A drum around its grains or a floor between walls counts; an infinite surface does not.
    """
    low, high = cloud.min(axis=(0, 1)), cloud.max(axis=(0, 1))
    middle, size = (low + high) / 2.0, float((high - low).max()) / 2.0
    clouds = [cloud]
    for surface in surfaces:
        line = place_points(surface.points, poses[:, surface.frame])
        near = (np.abs(line - middle) <= _AROUND * size).all()
        if np.allclose(line[:, 0], line[:, -1], atol=1e-9 * size):
            around = line.min(axis=1) <= low, line.max(axis=1) >= high
            near |= np.all(around) and np.ptp(line, axis=1).max() <= _ROUND_ABOUT * 2.0 * size
        if near:
            clouds.append(line)
    return np.concatenate(clouds, axis=1)


def include_nearest_points(cloud: Array, surfaces: Sequence[Shape], poses: Array) -> Array:
    """Return the cloud of one instant with the nearest points of surfaces.

    For example the ground on which a body will fall.
    """
    low, high = cloud.min(axis=(0, 1)), cloud.max(axis=(0, 1))
    middle, size = (low + high) / 2.0, float((high - low).max()) / 2.0
    clouds = [cloud]
    for surface in surfaces:
        line = place_points(surface.points, poses[:, surface.frame])[0]
        projections = np.diff(line, axis=0)
        squares = np.maximum((projections**2).sum(axis=1), np.finfo(float).tiny)
        part = ((middle - line[:-1]) * projections).sum(axis=1) / squares
        places = line[:-1] + np.clip(part, 0.0, 1.0)[:, None] * projections
        away = np.hypot(*(places - middle).T)
        if len(away) and away.min() <= _VISIBLE * size:
            clouds.append(places[None, [int(away.argmin())]])
    return np.concatenate(clouds, axis=1)


def _smooth(values: Array) -> Array:
    width = max(1, round(_SMOOTH * len(values)))
    padded = np.concatenate([np.full(width, values[0]), values, np.full(width, values[-1])])
    kernel = np.hanning(2 * width + 1) if width > 1 else np.array([0.25, 0.5, 0.25])
    averaged: Array = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return averaged


_CIRCLE_POINTS = 180
_FINE = 320  # Points of a curve per picture width.
_MAX_POINTS = 6000
# Length of an infinite surface carried by a body, relative to the picture.
_CARRIED = 0.06


def grounds(
    scene: Scene,
    known: Mapping[str, float],
    frames: Mapping[str, int],
    box: tuple[Array, Array],
    unit: float,
) -> tuple[Shape, ...]:
    """Return the surfaces of a scene, for values `known` of its parameters.

    `frames` maps each surface to its frame, `box` are the corners of all visible points, in the
    world and in moved frames, `unit` is the width of a picture.
    """
    number = evaluator(known)
    shapes: list[Shape] = []
    straight: list[tuple[int, Array, Array]] = []
    for name, surface in scene.surfaces.items():
        frame = frames[name]
        if surface.body is not None:
            # A body with a declared shape shows its surfaces itself.
            if not scene.bodies[surface.body].shape:
                shapes.append(_carried(name, surface, frame, unit, known))
            continue
        offset = _rim_offset(scene, name, number)
        if surface.edge is not None:
            points = np.array([[number(x), number(y)] for x, y in surface.edge])
        elif surface.circle is not None:
            side = -1.0 if surface.hollow else 1.0
            turn = -side * np.linspace(0.0, 2.0 * np.pi, _CIRCLE_POINTS + 1)
            radius = number(surface.radius or 0) - side * offset
            centre = [number(text) for text in surface.circle]
            points = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
            offset = 0.0
        elif not surface.straight:
            points = _graph(surface.height or 0, known, box, unit)
        else:
            start, direction = np.array(surface.point_and_direction(number))
            start = start + offset * np.array([direction[1], -direction[0]])
            straight.append((len(shapes), start, direction))
            shapes.append(_ground(name, _line_through(start, direction, box), frame))
            continue
        shapes.append(_ground(name, _shift(points, offset), frame))
    return tuple(_clip_line(shapes, straight))


def _ground(name: str, points: Array, frame: int) -> Shape:
    return Shape("ground", points, frame, frame, name=name)


def _carried(
    name: str, surface: Surface, frame: int, unit: float, known: Mapping[str, float]
) -> Shape:
    """Return a surface that a body carries: a disc, a line, or a graph as wide as the picture."""
    number = evaluator(known)
    if surface.circle is not None:
        centre = np.array([[number(text) for text in surface.circle]])
        return Shape("disc", centre, frame, frame, number(surface.radius or 0), name=name)
    if surface.edge is not None:
        points = np.array([[number(x), number(y)] for x, y in surface.edge])
    elif surface.straight:
        start, direction = np.array(surface.point_and_direction(number))
        # Beside the body's centre.
        start = start - (start @ direction) * direction
        points = start + _CARRIED * unit * np.outer([-1.0, 1.0], direction)
    else:
        half = np.full(2, unit / 2.0)
        return _ground(name, _graph(surface.height or 0, known, (-half, half), unit), frame)
    return Shape("link", points, frame, frame, name=name)


def _rim_offset(scene: Scene, name: str, number: Callable[[str | int | float], float]) -> float:
    """Return how far below the declared surface it is drawn, for rims of discs to touch it."""
    contacts = [c for c in scene.contacts.values() if c.surface == name]
    radii = {disc_of(scene, contact, number) for contact in contacts}
    return radii.pop() if len(radii) == 1 else 0.0


def _line_through(start: Array, direction: Array, box: tuple[Array, Array]) -> Array:
    """Return the part of a line next to the middle of a box, as long as the box."""
    middle, reach = (box[0] + box[1]) / 2.0, np.hypot(*(box[1] - box[0])) / 2.0
    nearest = start + ((middle - start) @ direction) * direction
    return np.array([nearest - reach * direction, nearest + reach * direction])


def _graph(
    text: str | int | float, known: Mapping[str, float], box: tuple[Array, Array], unit: float
) -> Array:
    formula = parse(text)
    low, high = float(box[0][0]), float(box[1][0])
    count = int(np.clip(_FINE * (high - low) / unit, _FINE, _MAX_POINTS))
    x = np.linspace(low, high, count)
    points = np.column_stack([x, [formula.value({**known, "x": float(at)}) for at in x]])
    return points[np.isfinite(points).all(axis=1)]


def _shift(points: Array, offset: float) -> Array:
    if offset == 0.0:
        return points
    projections = np.gradient(points, axis=0)
    projections /= np.hypot(*projections.T)[:, None]
    return points + offset * np.column_stack([projections[:, 1], -projections[:, 0]])


def _clip_line(shapes: list[Shape], straight: Sequence[tuple[int, Array, Array]]) -> list[Shape]:
    """Cut off parts of fixed straight surfaces inside the solids of others."""
    result = list(shapes)
    for place, _, _ in straight:
        one, two = result[place].points
        if result[place].frame != WORLD:
            continue
        low, high = 0.0, 1.0
        for other, start, direction in straight:
            if other == place or shapes[other].frame != WORLD:
                continue
            normal = np.array([-direction[1], direction[0]])
            a, b = float((one - start) @ normal), float((two - start) @ normal)
            if a * b < 0.0:
                low, high = (
                    (max(low, a / (a - b)), high) if a < 0.0 else (low, min(high, a / (a - b)))
                )
        if low < high:
            points = np.array([one + low * (two - one), one + high * (two - one)])
            result[place] = _ground(result[place].name, points, WORLD)
    return result
