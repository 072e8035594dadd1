"""Names beside bodies, contacts and surfaces, where they hide nothing and are whole."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.arrays import Array
from statechart.palette import INK, LINES
from statechart.pictures.film import BETWEEN, Film, Shape, arrows, placed, strokes
from statechart.pictures.scenery import bar_width, points_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIZE = 8  # points
# What is in the way of a name, from what must not be to what is not nice.
_OUTSIDE, _TEXT, _MARK, _LINE, _FARTHER = 1000.0, 500.0, 30.0, 4.0, 0.4
# Around a point a name is tried in so many directions and distances, these in points of the paper.
_ROUND, _DISTANCES = 12, (3.0, 8.0, 16.0, 28.0)
# Kept free around it, in points.
_CLEAR = 1.5
# Between two names, along and across lines of text.
_APART = np.array([5.0, 0.0])
_CORNERS = np.linspace(0.0, 2.0 * np.pi, 25)


@dataclass(frozen=True, eq=False)
class _Name:
    """A name, how it is written, and where it may stand: middles (m, 2) in pixels, best first."""

    text: str
    style: dict[str, Any]
    size: Array
    places: Array


def write_names(ax: Axes, film: Film, mark: float) -> None:
    """Write names into the first picture of a film.

    Each goes where it is whole and hides least; where there is no such place it is left out.
    """
    scale = ax.figure.dpi / 72.0
    inner = np.array(ax.get_window_extent().padded(-_CLEAR * scale).extents)
    lines = ax.transData.transform(_lines(film).reshape(-1, 2)).reshape(-1, 2, 2)
    marks = ax.transData.transform(_marks(film))
    radius = 0.5 * mark * scale
    clear = _CLEAR * scale + 0.5 * bar_width(points_of(film.unit, ax)) * scale
    taken: list[Array] = []
    for name in _names(ax, film, radius):
        costs = _costs(name, lines, marks, (clear, radius), taken, inner)
        best = int(np.argmin(costs))
        if costs[best] >= _TEXT:
            continue
        middle = name.places[best]
        reach = name.size / 2.0 + _APART * scale
        taken.append(np.array([middle - reach, middle + reach]))
        x, y = ax.transData.inverted().transform(middle)
        ax.text(x, y, name.text, ha="center", va="center", fontsize=_SIZE, zorder=4.0, **name.style)


def _names(ax: Axes, film: Film, radius: float) -> Iterator[_Name]:
    """Return names with their places, those with the fewest of these first."""
    scale = ax.figure.dpi / 72.0
    named = set()
    for touch in film.touches:
        place, size = ax.transData.transform(touch.places[0]), _size(ax, touch.name)
        yield _Name(touch.name, {"color": LINES[0]}, size, _around(place, size, radius, scale))
    for shape in film.shapes:
        # What is one of many is coloured by what it does, and has no name.
        if shape.name in named or shape.kind in (*BETWEEN, "joint", "pivot"):
            continue
        if shape.region >= 0 or not shape.name:
            continue
        named.add(shape.name)
        if shape.kind == "ground":
            style: dict[str, Any] = {"color": INK}
            size = _size(ax, shape.name)
            places = _along(ax, film, shape, size, scale)
        else:
            style = {"color": INK, "style": "italic"}
            size = _size(ax, shape.name)
            at = ax.transData.transform(film.poses[0, shape.frame, :2])
            places = _around(at, size, radius, scale)
            if shape.kind in ("outline", "disc"):
                places = np.concatenate([at[None], places])
        if len(places):
            yield _Name(shape.name, style, size, places)


def _size(ax: Axes, text: str) -> Array:
    """Return width and height of a text in pixels."""
    drawn = ax.text(0.0, 0.0, text, fontsize=_SIZE)
    extent = drawn.get_window_extent()
    drawn.remove()
    return np.array([extent.width, extent.height])


def _around(place: Array, size: Array, radius: float, scale: float) -> Array:
    """Return middles of a text around a point, on the right and near first."""
    turns = np.pi * np.arange(_ROUND) / (_ROUND / 2)
    turns = turns[np.argsort(1.0 - np.cos(turns - np.pi / 6.0), kind="stable")]
    directions = np.column_stack([np.cos(turns), np.sin(turns)])
    found = [
        place + directions * (size / 2.0 + radius + distance * scale) for distance in _DISTANCES
    ]
    return np.concatenate(found)


def _along(ax: Axes, film: Film, shape: Shape, size: Array, scale: float) -> Array:
    """Return middles of a text along a surface, on the side of its solid, beyond the hatching."""
    points = ax.transData.transform(placed(shape.points, film.poses[0, shape.frame]))
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    far = np.concatenate([[0.0], np.cumsum(lengths)])
    at = np.linspace(0.0, far[-1], 400)[1:-1]
    piece = np.clip(np.searchsorted(far, at, side="right") - 1, 0, len(steps) - 1)
    kept = lengths[piece] > 0.0
    at, piece = at[kept], piece[kept]
    direction = steps[piece] / lengths[piece, None]
    right = np.column_stack([direction[:, 1], -direction[:, 0]])
    stroke = film.spacing * ax.get_window_extent().width / (2.0 * film.half[0])
    away = stroke + 2.0 * scale + np.abs(right) @ (size / 2.0)
    middles = points[piece] + (at - far[piece])[:, None] * direction + away[:, None] * right
    box = ax.get_window_extent().extents
    inside = ((middles - size / 2.0 >= box[:2]) & (middles + size / 2.0 <= box[2:])).all(axis=1)
    # The end on the right, or below, first.
    order = np.argsort(middles[:, 1] - middles[:, 0], kind="stable")
    chosen: Array = middles[order][inside[order]]
    return chosen


def _costs(
    name: _Name,
    lines: Array,
    marks: Array,
    around: tuple[float, float],
    taken: list[Array],
    box: Array,
) -> Array:
    """Return the cost of each place of a name; lines and marks reach as far as `around`."""
    low, high = name.places - name.size / 2.0, name.places + name.size / 2.0
    costs = np.linspace(0.0, _FARTHER * _ROUND, len(low))
    clear, radius = around
    costs += _OUTSIDE * ((low < box[:2]) | (high > box[2:])).any(axis=1)
    for other in taken:
        costs += _TEXT * ((low < other[1]) & (high > other[0])).all(axis=1)
    for mark in marks:
        costs += _MARK * ((low < mark + radius) & (high > mark - radius)).all(axis=1)
    for one, two in lines:
        costs += _LINE * crossing(low - clear, high + clear, one, two)
    return costs


def crossing(low: Array, high: Array, one: Array, two: Array) -> Array:
    """Return which boxes (m,) a line from one point to another passes (Liang and Barsky 1984)."""
    along = two - one
    with np.errstate(divide="ignore", invalid="ignore"):
        enter, leave = (low - one) / along, (high - one) / along
    first, last = np.minimum(enter, leave), np.maximum(enter, leave)
    beside = (low <= one) & (one <= high)
    still = along == 0.0
    first = np.where(still, np.where(beside, -np.inf, np.inf), first).max(axis=1)
    last = np.where(still, np.where(beside, np.inf, -np.inf), last).min(axis=1)
    found: Array = (first <= last) & (first <= 1.0) & (last >= 0.0)
    return found


def _marks(film: Film) -> Array:
    """Return the places (m, 2) of all marks of the first picture."""
    found = [touch.places[:1] for touch in film.touches]
    marked = [s for s in film.shapes if s.kind in ("mass", "joint", "pivot")]
    found += [placed(shape.points, film.poses[0, shape.frame]) for shape in marked]
    return np.concatenate([np.empty((0, 2)), *found])


def _lines(film: Film) -> Array:
    """Return all lines (m, 2, 2) of the first picture: edges, bars, surfaces, arrows."""
    found = [np.empty((0, 2, 2))]
    poses = film.poses[0]
    for shape in film.shapes:
        points = placed(shape.points, poses[shape.frame])
        if shape.kind == "disc":
            rim = np.column_stack([np.cos(_CORNERS), np.sin(_CORNERS)])
            points = points + shape.radius * rim
        elif shape.kind == "outline":
            points = np.concatenate([points, points[:1]])
        elif shape.kind in BETWEEN:
            points[-1:] = placed(shape.points[-1:], poses[shape.other])
        elif shape.kind == "ground":
            found.append(strokes(points, film.spacing))
        found.append(np.stack([points[:-1], points[1:]], axis=1))
    for touch in film.touches:
        tip = touch.places[0] + arrows(touch.forces[0], film.half, film.force)
        found.append(np.array([[touch.places[0], tip]]))
    return np.concatenate(found)
