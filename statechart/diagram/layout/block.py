"""Blocks of a page: boxes, text and arrows with positions in points, y upwards."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot

import numpy as np

from statechart.arrays import Array
from statechart.diagram.layout.graphviz_program import measure_boxes
from statechart.diagram.layout.markup import START, arrow

Attributes = Mapping[str, str]
"""DOT attributes of appearance, without position."""

Point = tuple[float, float]

_POINT = re.compile(r"(-?[\d.]+(?:e[+-]?\d+)?),(-?[\d.]+(?:e[+-]?\d+)?)")
# End point of an arrowhead in a splineType.
_ENDS = re.compile(r"[es],\S+")
# Length of an arrowhead (Graphviz: 10 pt times arrowsize).
_HEAD = 7.0
# Distance of samples of a curve, and allowed overlap with a box, in points.
_STEP, _TOUCH = 5.0, 0.6
# Initial dot: width, distance, and radius of the corner of a state, in points.
_DOT, _OFF, _ROUND = 9.4, 13.0, 2.5


@dataclass(frozen=True)
class Box:
    """A state, a frame, or text; `name` in DOT begins with an underscore for text."""

    name: str
    centre: Point
    size: Point
    attributes: Attributes


@dataclass(frozen=True)
class Arrow:
    """A line between boxes; `curve` are Bezier curves as Graphviz writes them (splineType)."""

    source: str
    target: str
    curve: str
    attributes: Attributes


@dataclass(frozen=True)
class LayoutBlock:
    """Boxes, frames first, and arrows, in a rectangle from (0, 0)."""

    size: Point
    boxes: tuple[Box, ...] = ()
    arrows: tuple[Arrow, ...] = ()

    def moved(self, x: float, y: float) -> LayoutBlock:
        """Return the translated block."""
        return LayoutBlock(
            self.size,
            tuple(replace(b, centre=(b.centre[0] + x, b.centre[1] + y)) for b in self.boxes),
            tuple(replace(a, curve=_translate(a.curve, x, y)) for a in self.arrows),
        )


def bounding_block(boxes: Sequence[Box], arrows: Sequence[Arrow]) -> LayoutBlock:
    """Return the block with the bounding box of boxes and arrows."""
    centres, sizes = np.array([box.centre for box in boxes]), np.array([box.size for box in boxes])
    corners = [centres - sizes / 2, centres + sizes / 2]
    places = np.concatenate([*corners, *(samples(one.curve) for one in arrows)])
    (left, low), (right, high) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    return LayoutBlock((right - left, high - low), (*boxes,), (*arrows,)).moved(-left, -low)


def _translate(curves: str, x: float, y: float) -> str:
    return _POINT.sub(lambda m: f"{float(m[1]) + x:.2f},{float(m[2]) + y:.2f}", curves)


def text_block(name: str, label: str) -> LayoutBlock:
    """Return a text as a block."""
    attributes = {"shape": "plain", "label": label}
    size = measure_boxes({name: attributes})[name]
    return LayoutBlock(size, (Box(name, (size[0] / 2, size[1] / 2), size, attributes),))


def side_by_side(blocks: Sequence[LayoutBlock], gap: float) -> LayoutBlock:
    """Return blocks in a row, aligned at the top."""
    height = max(block.size[1] for block in blocks)
    placed, x = [], 0.0
    for block in blocks:
        placed.append(block.moved(x, height - block.size[1]))
        x += block.size[0] + gap
    return _merge((x - gap, height), placed)


def stacked(blocks: Sequence[LayoutBlock], gap: float, *, centred: bool = True) -> LayoutBlock:
    """Return blocks in a column."""
    width = max(block.size[0] for block in blocks)
    placed, y = [], 0.0
    for block in reversed(blocks):
        placed.append(block.moved((width - block.size[0]) / 2 if centred else 0.0, y))
        y += block.size[1] + gap
    return _merge((width, y - gap), placed[::-1])


def _merge(size: Point, blocks: Sequence[LayoutBlock]) -> LayoutBlock:
    boxes = (box for block in blocks for box in block.boxes)
    return LayoutBlock(size, (*boxes,), tuple(a for block in blocks for a in block.arrows))


def with_start(block: LayoutBlock, state: str, name: str) -> LayoutBlock:
    """Return a block with a start at the corner of a state where it is least in the way.

    Corners where its dot would lie on the line of a frame come last.
    """
    (box,) = (box for box in block.boxes if box.name == state)

    def at(across: int, up: int) -> LayoutBlock:
        x, y = (
            c + way * (s / 2 - _ROUND)
            for c, s, way in zip(box.centre, box.size, (across, up), strict=True)
        )
        dot = x + across * _OFF, y + up * _OFF
        begin = Arrow(name, state, polyline([dot, (x, y)]), arrow(()))
        boxes = (*block.boxes, Box(name, dot, (_DOT, _DOT), START))
        return bounding_block(boxes, (*block.arrows, begin))

    corners = (at(across, up) for across, up in ((-1, 1), (1, 1), (-1, -1), (1, -1)))
    return min(corners, key=lambda one: (count_overlaps(one), _on_frame(one, name)))


def _on_frame(block: LayoutBlock, dot: str) -> bool:
    """Return whether a dot lies on the line of a box without a label."""
    (x, y) = next(box.centre for box in block.boxes if box.name == dot)
    frames = (box for box in block.boxes if not box.attributes["label"] and box.name != dot)
    off = (np.abs(np.subtract((x, y), f.centre)) - np.array(f.size) / 2 for f in frames)
    return any(abs(distances.max()) < _DOT for distances in off)


def polyline(points: Iterable[Point], *, head: bool = True) -> str:
    """Return a polyline as Bezier curves, ending in an arrowhead."""
    places = list(points)
    start = ""
    if head:
        (x0, y0), (x1, y1) = places[-2:]
        length = hypot(x1 - x0, y1 - y0)
        start = f"e,{x1:.2f},{y1:.2f} "
        places[-1] = (x1 - _HEAD * (x1 - x0) / length, y1 - _HEAD * (y1 - y0) / length)
    curve = [places[0]]
    for (x0, y0), (x1, y1) in pairwise(places):
        curve += [(x0 + k * (x1 - x0) / 3, y0 + k * (y1 - y0) / 3) for k in (1, 2, 3)]
    return start + " ".join(f"{x:.2f},{y:.2f}" for x, y in curve)


def count_overlaps(block: LayoutBlock) -> int:
    """Return the number of overlaps of arrows with text, dots or other states."""
    looks = ((box, box.attributes) for box in block.boxes)
    solid = [box for box, look in looks if look["label"] or look["shape"] == "circle"]
    centres = np.array([box.centre for box in solid]).reshape(-1, 2)
    reach = np.array([box.size for box in solid]).reshape(-1, 2) / 2 - _TOUCH
    found = 0
    for one in block.arrows:
        off = np.abs(samples(one.curve)[:, None] - centres)
        through = np.all(off < reach, axis=2).any(axis=0)
        ends = (one.source, one.target)
        found += sum(box.name not in ends for box, on in zip(solid, through, strict=True) if on)
    return found


def samples(curves: str) -> Array:
    """Return dense samples of curves."""
    controls = [
        curve[k : k + 4]
        for piece in curves.split(";")
        for curve in [[(float(x), float(y)) for x, y in _POINT.findall(_ENDS.sub("", piece))]]
        for k in range(0, len(curve) - 3, 3)
    ]
    points = np.array(controls)
    # No curve is faster than thrice its longest control leg.
    legs = 3 * np.hypot(*np.diff(points, axis=1).T).max()
    t = np.linspace(0.0, 1.0, 2 + int(legs / _STEP))
    weights = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    places: Array = (weights @ points).reshape(-1, 2)
    return places
