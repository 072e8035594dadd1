"""Pieces of a page whose places are known: boxes, text and arrows in points, y upwards."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot

import numpy as np

from statechart.arrays import Array

Look = Mapping[str, str]
"""Attributes of DOT that say how something is drawn, and not where."""

Point = tuple[float, float]

_POINT = re.compile(r"(-?[\d.]+(?:e[+-]?\d+)?),(-?[\d.]+(?:e[+-]?\d+)?)")
# Where an arrow's head ends, which is no point of its curve.
_ENDS = re.compile(r"[es],\S+")
# Length of an arrow's head, which its line stops short of (Graphviz: 10 pt times arrowsize).
_HEAD = 7.0
# Points a curve that are looked at; how far into a box a line may reach by rounding, in points.
_SAMPLES, _TOUCH = 40, 0.6


@dataclass(frozen=True)
class Box:
    """Something at a place: a state, what encloses states, or text.

    Attributes
    ----------
    name : str
        Identifier in DOT; that of text begins with an underscore.
    centre : (float, float)
        Where it is.
    size : (float, float)
        Width and height.
    look : mapping
        Attributes.
    """

    name: str
    centre: Point
    size: Point
    look: Look


@dataclass(frozen=True)
class Arrow:
    """A line from a box to another.

    Attributes
    ----------
    source, target : str
        Names of boxes.
    course : str
        Bezier curves as Graphviz writes them (its type splineType).
    look : mapping
        Attributes.
    """

    source: str
    target: str
    course: str
    look: Look


@dataclass(frozen=True)
class Block:
    """Boxes, those that enclose others first, and arrows, in a rectangle from (0, 0)."""

    size: Point
    boxes: tuple[Box, ...] = ()
    arrows: tuple[Arrow, ...] = ()

    def moved(self, by: Point) -> Block:
        """Return the same elsewhere."""
        return Block(
            self.size,
            tuple(
                replace(b, centre=(b.centre[0] + by[0], b.centre[1] + by[1])) for b in self.boxes
            ),
            tuple(replace(a, course=moved(a.course, by)) for a in self.arrows),
        )


def bounded(boxes: tuple[Box, ...], arrows: tuple[Arrow, ...]) -> Block:
    """Return a block just as large as what is in it."""
    low = [min(b.centre[k] - b.size[k] / 2 for b in boxes) for k in (0, 1)]
    high = [max(b.centre[k] + b.size[k] / 2 for b in boxes) for k in (0, 1)]
    size = high[0] - low[0], high[1] - low[1]
    return Block(size, boxes, arrows).moved((-low[0], -low[1]))


def moved(course: str, by: Point) -> str:
    """Return curves elsewhere."""
    return _POINT.sub(lambda m: f"{float(m[1]) + by[0]:.2f},{float(m[2]) + by[1]:.2f}", course)


def polyline(points: Iterable[Point], *, head: bool = True) -> str:
    """Return straight lines through points as curves; the last ends in an arrow's head."""
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


def covered(block: Block) -> int:
    """Return how often an arrow runs through text, a dot or a state that is not at its ends."""
    solid = [box for box in block.boxes if box.look["label"] or box.look["shape"] == "circle"]
    centres = np.array([box.centre for box in solid]).reshape(-1, 2)
    reach = np.array([box.size for box in solid]).reshape(-1, 2) / 2 - _TOUCH
    found = 0
    for arrow in block.arrows:
        off = np.abs(samples(arrow.course)[:, None] - centres)
        through = np.all(off < reach, axis=2).any(axis=0)
        ends = (arrow.source, arrow.target)
        found += sum(box.name not in ends for box, on in zip(solid, through, strict=True) if on)
    return found


def crossings(block: Block) -> int:
    """Return how often arrows cross each other."""
    pieces = [samples(arrow.course)[:: _SAMPLES // 8] for arrow in block.arrows]
    if not pieces:
        return 0
    start = np.concatenate([places[:-1] for places in pieces])
    way = np.concatenate([np.diff(places, axis=0) for places in pieces])
    owner = np.repeat(np.arange(len(pieces)), [len(places) - 1 for places in pieces])
    off = start[None, :] - start[:, None]
    across = _cross(way[:, None], way[None, :])
    with np.errstate(divide="ignore", invalid="ignore"):
        here = _cross(off, way[None, :]) / across
        there = _cross(off, way[:, None]) / across
    met = (here > 0) & (here < 1) & (there > 0) & (there < 1)
    apart = np.not_equal.outer(owner, owner)
    return int(np.count_nonzero(met & apart)) // 2


def _cross(one: Array, other: Array) -> Array:
    found: Array = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return found


def samples(course: str) -> Array:
    """Return points along curves, close enough that no word fits between two."""
    curves = [
        curve[k : k + 4]
        for piece in course.split(";")
        for curve in [[(float(x), float(y)) for x, y in _POINT.findall(_ENDS.sub("", piece))]]
        for k in range(0, len(curve) - 3, 3)
    ]
    t = np.linspace(0.0, 1.0, _SAMPLES)
    weights = np.stack([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3], axis=1)
    places: Array = (weights @ np.array(curves)).reshape(-1, 2)
    return places
