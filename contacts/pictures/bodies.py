"""Shapes of bodies: declared ones, else inferred from points and masses."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy as sp

import contacts.scene.shapes as declared
from contacts.dynamics.mechanics import Mechanics
from contacts.pictures.links import SAME, Links
from contacts.scene.joints import Joint, Path
from contacts.scene.parts import Body, Contact, Point
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.formulas.formula import evaluator, parse
from statechart.pictures.film import WORLD, Shape, ShapeKind

# Number of fixed, and of led bodies above which they have no labels.
_NAMED = 5


class BodyShapes:
    """The shapes of a scene's bodies for values of its parameters.

    A body without a declared shape is drawn from its known points: rims of discs, contact points,
    joints, edges, and bodies fixed in its frame. Collinear points make a bar; a bar with a single
    known end has the length of a uniform bar of its inertia. Other points make their convex hull,
    with their mirror images in the centre of mass if they do not enclose it. A point mass is a dot
    with bars to its points. Bodies fixed to a body with a declared shape are part of that shape.

    The automaton of the scene may have more variables and parameters than the mechanics; `known`
    are the values of its parameters, in order.
    """

    def __init__(
        self, mechanics: Mechanics, automaton: Automaton, known: Mapping[str, float]
    ) -> None:
        self._mechanics, self._number = mechanics, evaluator(known)
        assert isinstance(automaton.declaration, Scene)
        self._scene = automaton.declaration
        self._frames = {name: 1 + place for place, name in enumerate(self._scene.bodies)}
        led = led_ends(self._scene)
        self._led = {name: 1 + len(self._frames) + place for place, name in enumerate(led)}
        self._links = Links(mechanics, automaton, known, self._frames)

    def shapes(self, idle: frozenset[str]) -> tuple[Shape, ...]:
        """Return the shapes, from back to front.

        Points of `idle` contacts count only for a body that has no others.
        """
        bare = [name for name, body in self._scene.bodies.items() if not body.shape]
        fixed = self._fixed(bare) if bare else {}
        shapes_found: list[Shape] = []
        regions = {name: k for k, name in enumerate(self._scene.bodies)}
        prescribed = [body.fixed for body in self._scene.bodies.values() if body.prescribed]
        many = {fixed for fixed, number in Counter(prescribed).items() if number > _NAMED}
        for name, body in self._scene.bodies.items():
            if body.shape:
                region = regions[name] if self._scene.collisions and not body.prescribed else -1
                shown = "" if body.prescribed and body.fixed in many else name
                shapes_found += [self._shape(name, part, region, shown) for part in body.shape]
            elif name in fixed:
                points = self._points(name, idle) or self._points(name, frozenset())
                rims = self._rolling_discs(name)
                shapes_found += [*rims, *self._inferred(name, body, [*points, *fixed[name]], rims)]
        return (
            *_side_by_side(self._links.shapes()),
            *shapes_found,
            *self._joints(),
            *self._couplings(),
        )

    def _shape(self, name: str, part: declared.Shape, region: int, shown: str) -> Shape:
        frame = self._frames[name]
        if part.disc is not None:
            centre, radius = np.array([self._vector(part.at)]), self._number(part.disc)
            _, angle = self._mechanics.body_frame(name)
            turns = angle.has(*self._mechanics.q, self._mechanics.time)
            return Shape("disc", centre, frame, frame, radius, region, shown, turns=turns)
        points = np.array([self._vector(corner) for corner in part.polygon or ()])
        return Shape("outline", points, frame, frame, region=region, name=shown)

    def _points(self, name: str, idle: frozenset[str]) -> list[tuple[float, float]]:
        scene = self._scene
        touching = scene.contacts.items()
        points = [c.point for key, c in touching if key not in idle and c.radius is None]
        points += [joint.point for joint in scene.joints.values()]
        points += [joint.to for joint in scene.joints.values() if isinstance(joint.to, Point)]
        places = [self._vector(point.at) for point in points if point.body == name]
        for surface in scene.surfaces.values():
            if surface.body == name and surface.edge is not None:
                places += [self._vector(corner) for corner in surface.edge]
        return places

    def _rolling_discs(self, name: str) -> list[Shape]:
        frame = self._frames[name]
        discs = {
            (self._vector(contact.point.at), self._number(contact.radius)): None
            for contact in self._scene.contacts.values()
            if contact.point.body == name and contact.radius is not None
        }
        rims = [Shape("disc", np.array([at]), frame, frame, r, name=name) for at, r in discs]
        for (x, y), r in discs:
            # A spoke shows the rotation.
            spoke = np.array([[x, y], [x, y - r]])
            rims.append(Shape("outline", spoke, frame, frame, name=name))
        return rims

    def _inferred(
        self, name: str, body: Body, points: Sequence[tuple[float, float]], rims: Sequence[Shape]
    ) -> list[Shape]:
        frame = self._frames[name]
        points = [*points, *(tuple(rim.points[0]) for rim in rims)]

        def shape(kind: ShapeKind, corners: Sequence[Sequence[float] | Array] | Array) -> Shape:
            return Shape(kind, np.array(corners, float), frame, frame, name=name)

        reach = max((np.hypot(*point) for point in points), default=0.0)
        away = [p for p in _distinct(points) if np.hypot(*p) > SAME * reach]
        if not away:
            return [] if rims else [shape("mass", [[0.0, 0.0]])]
        inertia = self._number(body.inertia or 0)
        mass = self._number(body.mass)
        if not inertia > 0.0:
            bars = [shape("bar", [[0.0, 0.0], point]) for point in away]
            return [*bars, shape("mass", [[0.0, 0.0]])]
        projections, flat = _line(np.array(away))
        if flat:
            direction, places = projections
            low, high = min(0.0, float(places.min())), max(0.0, float(places.max()))
            uniform = float(np.sqrt(3.0 * inertia / mass)) if mass > 0.0 else 0.0
            if low == 0.0:
                low = -min(high, uniform)
            elif high == 0.0:
                high = min(-low, uniform)
            return [shape("bar", [low * direction, high * direction])]
        hull = _hull(np.array(away))
        if not _encloses(hull):
            hull = _hull(np.concatenate([hull, -hull]))
        return [shape("outline", hull)]

    def _fixed(self, bare: Sequence[str]) -> dict[str, list[tuple[float, float]]]:
        """Return, for every drawn body, the places in its frame of bodies that move with it.

        Drawn are those of `bare` that do not move with a declared shape: with a constant place in
        its frame, or with its coordinates (formulas may be for small angles).
        """
        coordinates = {name: self._coordinates(name) for name in self._scene.bodies}
        shapes = {coordinates[name] for name, body in self._scene.bodies.items() if body.shape}
        names = list(self._scene.bodies)
        frames = [self._mechanics.body_frame(name) for name in names]
        tried = self._links.sample_values([e for (x, y), angle in frames for e in (x, y, angle)])
        poses = tried.reshape(len(tried), -1, 3)
        size = float(np.abs(poses[..., :2]).max(initial=0.0))

        def places(frames: Array, of: Array) -> tuple[Array, Array]:
            """Return places in frames at one configuration, and whether they stay there."""
            angle, away = frames[..., 2].T, (of - frames)[..., :2].T
            projections = np.cos(angle) * away[0] + np.sin(angle) * away[1]
            across = np.cos(angle) * away[1] - np.sin(angle) * away[0]
            own = np.stack([projections, across], axis=-1)
            return own[:, 0], (np.ptp(own, axis=1) <= SAME * size).all(axis=-1)

        shaped = np.array([bool(body.shape) for body in self._scene.bodies.values()])
        attached: dict[str, list[tuple[float, float]]] = {}
        for name in bare:
            own_poses = poses[:, [names.index(name)]]
            if coordinates[name] not in shapes and not places(poses[:, shaped], own_poses)[1].any():
                others, stay = places(own_poses, poses)
                stay[names.index(name)] = False
                turns = np.ptp(own_poses[..., 2]) != 0.0
                attached[name] = [(float(x), float(y)) for x, y in others[stay & turns]]
        return attached

    def _coordinates(self, name: str) -> frozenset[sp.Symbol]:
        (x, y), angle = self._mechanics.body_frame(name)
        used = {symbol for part in (x, y, angle) for symbol in part.free_symbols}
        return frozenset(used.intersection(self._mechanics.q))

    def _joints(self) -> list[Shape]:
        shapes = []
        for name, joint in self._scene.joints.items():
            frame = self._frames[joint.point.body]
            kind: ShapeKind = "joint"
            if isinstance(joint.to, Path) and None not in (joint.to.x, joint.to.y):
                kind = "joint" if _is_led(self._scene, joint.to) else "pivot"
            at = self._vector(joint.point.at)
            if joint.rod is not None or joint.rope is not None:
                shapes += self._line(name, joint, at, frame)
                kind = "joint"
            shapes.append(Shape(kind, np.array([at]), frame, frame, name=name))
        return shapes

    def _couplings(self) -> list[Shape]:
        """Return couplings, at the joint of their bodies if there is one, else between them."""
        scene, shapes = self._scene, []
        first_region = len(scene.moving()) if scene.collisions else len(scene.contacts)
        for region, name in enumerate(scene.couplings, first_region):
            bodies = scene.coupled(name)
            own = scene.couplings[name].joint
            joint = next(
                (
                    one
                    for key, one in scene.joints.items()
                    if key == own
                    or (own is None and {*bodies} == {end.body for end in one.ends.values()})
                ),
                None,
            )
            first = self._frames[bodies[0] if joint is None else joint.point.body]
            ends, other = np.zeros((2, 2)), self._frames[bodies[-1]]
            if joint is not None:
                ends, other = np.array([self._vector(joint.point.at)] * 2), first
            shapes.append(Shape("coupling", ends, first, other, region=region, name=name))
        return shapes

    def _line(self, name: str, joint: Joint, at: tuple[float, float], frame: int) -> list[Shape]:
        """Return a rod or a rope, up to a fixed or led end."""
        kind: ShapeKind = "link" if joint.rope is None else "rope"
        end, other = (0.0, 0.0), self._led.get(name, WORLD)
        if isinstance(joint.to, Point):
            end, other = self._vector(joint.to.at), self._frames[joint.to.body]
        elif other == WORLD:
            end = self._number(joint.to.x or 0), self._number(joint.to.y or 0)
        line = Shape(kind, np.array([at, end]), frame, other, name=name)
        if isinstance(joint.to, Point):
            return [line]
        return [line, Shape("pivot", np.array([end]), other, other, name=name)]

    def _vector(self, pair: tuple[str | int | float, str | int | float]) -> tuple[float, float]:
        return self._number(pair[0]), self._number(pair[1])


def led_ends(scene: Scene) -> tuple[str, ...]:
    """Return the rods and ropes whose end is led along a path."""
    lines = ((n, j) for n, j in scene.joints.items() if j.rod is not None or j.rope is not None)
    return tuple(n for n, j in lines if isinstance(j.to, Path) and _is_led(scene, j.to))


def _is_led(scene: Scene, path: Path) -> bool:
    return not parse(path.x or 0).names | parse(path.y or 0).names <= {*scene.parameters}


def _side_by_side(shapes: Sequence[Shape]) -> list[Shape]:
    """Return shapes with springs and dampers between the same points beside each other."""
    lanes: defaultdict[object, list[Shape]] = defaultdict(list)
    for shape in shapes:
        if shape.kind in ("spring", "damper"):
            ends = zip((shape.frame, shape.other), map(tuple, shape.points), strict=True)
            lanes[frozenset(ends)].append(shape)
    coordinates = {}
    for lane in lanes.values():
        for place, shape in enumerate(lane):
            # To the left of the first one, for either direction of this one.
            side = 1.0 if shape.frame == lane[0].frame else -1.0
            coordinates[id(shape)] = replace(shape, aside=side * (len(lane) - 1.0 - 2.0 * place))
    return [coordinates.get(id(shape), shape) for shape in shapes]


def disc_of(scene: Scene, contact: Contact, number: Callable[[str | int | float], float]) -> float:
    """Return the radius of a declared disc centred at a contact point, else 0."""
    if contact.radius is not None:
        return 0.0
    at = tuple(map(number, contact.point.at))
    for shape in scene.bodies[contact.point.body].shape:
        if shape.disc is not None and at == tuple(map(number, shape.at)):
            return number(shape.disc)
    return 0.0


def _distinct(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    reach = max((np.hypot(*point) for point in points), default=0.0)
    distinct: list[tuple[float, float]] = []
    for x, y in points:
        if all(np.hypot(x - u, y - v) > SAME * reach for u, v in distinct):
            distinct.append((x, y))
    return distinct


def _line(points: Array) -> tuple[tuple[Array, Array], bool]:
    """Return the line through the centre and farthest point, and whether all points are on it.

    The line is its direction and the positions of the points along it.
    """
    direction = points[np.argmax(np.hypot(*points.T))]
    direction = direction / np.hypot(*direction)
    across = points @ np.array([-direction[1], direction[0]])
    places: Array = points @ direction
    return (direction, places), bool(np.abs(across).max() <= SAME * np.abs(places).max())


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull, counter-clockwise (Andrew 1979).

    Unlike Qhull it accepts collinear points.
    """
    ordered = sorted({(float(x), float(y)) for x, y in points})

    def half(chain: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        corners: list[tuple[float, float]] = []
        for x, y in chain:
            while len(corners) > 1:
                (a, b), (c, d) = corners[-2:]
                if (c - a) * (y - b) - (d - b) * (x - a) > 0.0:
                    break
                corners.pop()
            corners.append((x, y))
        return corners[:-1]

    return np.array([*half(ordered), *half(ordered[::-1])])


def _encloses(hull: Array) -> bool:
    (x, y), (u, v) = hull.T, np.roll(hull, -1, axis=0).T
    size = float(np.abs(hull).max())
    return len(hull) > 2 and bool((x * v - y * u > SAME * size**2).all())
