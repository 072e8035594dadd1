"""Surfaces as lines with their solid on the right, as far as they are seen."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from contacts.pictures.bodies import disc_of
from contacts.scene.parts import Surface
from contacts.scene.scene import Scene
from statechart.arrays import Array
from statechart.formulas.formula import parse
from statechart.pictures.film import WORLD, Shape, ShapeKind

_ROUND = 180  # points of a circle
_FINE = 320  # points of a curve, in the width of a picture
_MAX_POINTS = 6000
# What is carried by a body and has no end is shown so far, of the picture's width.
_CARRIED = 0.06


def grounds(
    scene: Scene,
    known: Mapping[str, float],
    frames: Mapping[str, int],
    box: tuple[Array, Array],
    unit: float,
) -> tuple[Shape, ...]:
    """Return the surfaces of a scene, for values `known` of its parameters.

    `frames` maps each surface to the frame that moves it, `box` are the corners of all that is ever
    seen, in the world and in the frames of what is displaced, and `unit` is the width of a picture.
    """

    def number(text: str | int | float) -> float:
        return parse(text).value(known)

    found: list[Shape] = []
    straight: list[tuple[int, Array, Array]] = []
    for name, surface in scene.surfaces.items():
        frame = frames[name]
        if surface.body is not None:
            found += _carried(scene, name, surface, frame, unit, number)
            continue
        lift = _lift(scene, name, number)
        if surface.edge is not None:
            points = np.array([[number(x), number(y)] for x, y in surface.edge])
        elif surface.circle is not None:
            side = -1.0 if surface.hollow else 1.0
            turn = -side * np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
            radius = number(surface.radius or 0) - side * lift
            centre = [number(text) for text in surface.circle]
            points = centre + radius * np.column_stack([np.cos(turn), np.sin(turn)])
            lift = 0.0
        elif not is_straight(surface):
            points = _graph(surface.height or 0, known, box, unit)
        else:
            start, direction = line_of(surface, number)
            start = start + lift * np.array([direction[1], -direction[0]])
            straight.append((len(found), start, direction))
            found.append(_ground(name, _through(start, direction, box), frame))
            continue
        found.append(_ground(name, _shifted(points, lift), frame))
    return tuple(_cut(found, straight))


def _ground(name: str, points: Array, frame: int) -> Shape:
    return Shape("ground", points, frame, frame, name=name)


def _carried(
    scene: Scene,
    name: str,
    surface: Surface,
    frame: int,
    unit: float,
    number: Callable[[str | int | float], float],
) -> list[Shape]:
    """Return what a body carries, as lines or discs; nothing where its shape is declared."""
    assert surface.body is not None
    if scene.bodies[surface.body].shape:
        return []
    kind: ShapeKind = "link"
    radius = 0.0
    if surface.circle is not None:
        kind, radius = "disc", number(surface.radius or 0)
        points = np.array([[number(text) for text in surface.circle]])
    elif surface.edge is not None:
        points = np.array([[number(x), number(y)] for x, y in surface.edge])
    else:
        start, direction = line_of(surface, number)
        # Beside the body's centre.
        start = start - (start @ direction) * direction
        points = np.array(
            [start - _CARRIED * unit * direction, start + _CARRIED * unit * direction]
        )
    return [Shape(kind, points, frame, frame, radius, name=name)]


def _lift(scene: Scene, name: str, number: Callable[[str | int | float], float]) -> float:
    """Return how far below the declared surface it is drawn: discs touch it with their rims."""
    contacts = [c for c in scene.contacts.values() if c.surface == name]
    radii = {disc_of(scene, contact, number) for contact in contacts}
    return radii.pop() if len(radii) == 1 else 0.0


def is_straight(surface: Surface) -> bool:
    """Return whether a surface is a straight line without ends."""
    graph = surface.height is not None and "x" in parse(surface.height).names
    return not graph and surface.edge is None and surface.circle is None


def line_of(surface: Surface, number: Callable[[str | int | float], float]) -> tuple[Array, Array]:
    """Return a point of a straight surface and its direction, the solid on the right."""
    if surface.height is not None:
        slope = parse(surface.height)
        low = slope.value(dict.fromkeys(slope.names & {"x"}, 0.0)) if "x" in slope.names else 0
        return np.array([0.0, number(surface.height) if "x" not in slope.names else low]), np.array(
            [1.0, 0.0]
        )
    if surface.line is not None:
        one, two = (np.array([number(x), number(y)]) for x, y in surface.line)
        return one, (two - one) / np.hypot(*(two - one))
    angle = number(surface.incline or 0)
    return np.array([number(text) for text in surface.through]), np.array(
        [np.cos(angle), np.sin(angle)]
    )


def _through(start: Array, direction: Array, box: tuple[Array, Array]) -> Array:
    """Return the part of a line that is as long as a box and beside its middle."""
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


def _shifted(points: Array, lift: float) -> Array:
    if lift == 0.0:
        return points
    along = np.gradient(points, axis=0)
    along /= np.hypot(*along.T)[:, None]
    return points + lift * np.column_stack([along[:, 1], -along[:, 0]])


def _cut(shapes: list[Shape], straight: Sequence[tuple[int, Array, Array]]) -> list[Shape]:
    """Cut off what of straight surfaces at rest is in the solid of another one."""
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
