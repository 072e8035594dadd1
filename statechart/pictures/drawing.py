"""A film on the axes of a picture: its shapes, contacts by mode, forces in their cones, trails."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import dropwhile
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.arrays import Array
from statechart.palette import FAINT, INK, LINES, PAPER, state_colours
from statechart.pictures.film import (
    BETWEEN,
    Film,
    Shape,
    Touch,
    arrows,
    cones,
    hatching,
    place_points,
)
from statechart.pictures.scenery import Scenery, bar_width, points_of, thinner

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FORCE, TRAIL = LINES[1], LINES[0]
"""Colours of force arrows and of trails."""

CLOSED = ("pin", "slide", "slide+", "slide-")
"""States of a contact that has a force."""

_RIM = 37  # points on the rim of a cone
_TOUCH, _MIN_TOUCH = 0.014, 3.0
# Length of an arrowhead in arrow widths; largest width in arrow lengths.
_HEAD, _SHAFT = 5.0, 0.2


class Drawing:
    """A film on axes, shown at one instant after another.

    Trails reach `trail` back in time, all the way by default. With `names` bodies, contacts and
    surfaces are named.
    """

    def __init__(
        self, ax: Axes, film: Film, *, trail: float | None = None, names: bool = False
    ) -> None:
        self._ax, self._film, self._trail = ax, film, trail
        ax.set_aspect("equal", adjustable="box")
        ax.set_axis_off()
        self._limits: tuple[tuple[float, float], ...] = ()
        self._move_window(0)
        self._scenery = Scenery(ax, film)
        paper = points_of(film.unit, ax)
        self._points, self._thin = paper / film.unit, thinner(paper)
        self._size = max(_TOUCH * paper, _MIN_TOUCH)
        self._trails = [
            ax.plot([], [], color=TRAIL, lw=self._thin, alpha=0.55, zorder=1.6)[0]
            for _ in film.trails
        ]
        self._cones = {touch.name: cones(touch, film.half, _RIM) for touch in film.touches}
        self._contacts = [self._contact(touch) for touch in film.touches]
        self.show(0)
        if names:
            write_names(ax, film, self._size)

    def show(self, instant: int) -> None:
        """Show an instant, by its number."""
        film = self._film
        self._move_window(instant)
        self._scenery.show(instant)
        for line, frame in zip(self._trails, film.trails, strict=True):
            since = 0.0 if self._trail is None else film.times[instant] - self._trail
            first = int(np.searchsorted(film.times, since))
            line.set_data(*film.poses[first : instant + 1, frame, :2].T)
        for touch, artists in zip(film.touches, self._contacts, strict=True):
            self._show(touch, artists, instant)

    def moving(self) -> list[Artist]:
        """Return the artists to redraw at another instant, from back to front.

        These are the moving artists and those in front of them; all, if the window moves.
        """
        drawn = {*self._ax.lines, *self._ax.patches, *self._ax.collections, *self._ax.texts}
        ordered = [artist for artist in self._ax.get_children() if artist in drawn]
        ordered.sort(key=lambda artist: artist.get_zorder())
        stands = bool((self._film.centres == self._film.centres[0]).all())
        still = set(self._scenery.still) if stands else set()
        return [*dropwhile(lambda artist: artist in still, ordered)]

    def _move_window(self, instant: int) -> None:
        (x, y), (width, height) = self._film.centres[instant], self._film.half
        limits = (x - width, x + width), (y - height, y + height)
        # Setting equal limits would trigger a new layout.
        if limits != self._limits:
            self._limits = limits
            self._ax.set(xlim=limits[0], ylim=limits[1])

    def _contact(self, touch: Touch) -> tuple[Any, Any, Any]:
        from matplotlib.patches import FancyArrowPatch, Polygon

        cone = Polygon(np.zeros((3, 2)), closed=True, color="#000000", alpha=0.09, lw=0, zorder=2.3)
        arrow = FancyArrowPatch(
            (0, 0), (0, 0), arrowstyle="-|>", shrinkA=0, shrinkB=0, color=FORCE, zorder=3.0,
        )  # fmt: skip
        self._ax.add_patch(cone)
        self._ax.add_patch(arrow)
        edge = 0.9 * self._thin
        (mark,) = self._ax.plot([], [], "o", ms=self._size, markeredgewidth=edge, zorder=3.2)
        return mark, arrow, cone

    def _show(self, touch: Touch, artists: tuple[Any, Any, Any], instant: int) -> None:
        film = self._film
        mark, arrow, cone = artists
        state, place = film.state(instant, touch.region), touch.places[instant]
        closed = state in CLOSED
        mark.set_data(*place[:, None])
        mark.set_visible(state != "off")
        face = state_colours(film.states[touch.region])[state] if closed else PAPER
        mark.set(markerfacecolor=face, markeredgecolor=INK if closed else FAINT)
        mark.set_markersize(self._size if closed else 0.7 * self._size)
        force = arrows(touch.forces[instant], film.half, film.force)
        # A short arrow has a small head: it would point the other way.
        long = float(np.hypot(*force)) * self._points
        width = min(1.8 * self._thin, _SHAFT * long)
        arrow.set_linewidth(width)
        arrow.set_mutation_scale(_HEAD * width)
        arrow.set_visible(long > 0.0)
        arrow.set_positions(tuple(place), tuple(place + force))
        rim = self._cones[touch.name][instant]
        cone.set_visible(closed and bool(touch.friction[instant] > 0.0))
        cone.set_xy(np.concatenate([place[None], rim]))


_SIZE = 8  # points
# Costs of a name that covers other parts, from forbidden to undesirable.
_OUTSIDE, _TEXT, _MARK, _LINE, _FARTHER = 1000.0, 500.0, 30.0, 4.0, 0.4
# Directions and distances (in points) around a point at which a name is tried.
_ROUND, _DISTANCES = 12, (3.0, 8.0, 16.0, 28.0)
# Free margin around a name, in points.
_CLEAR = 1.5
# Largest number of bodies with a mode that are named.
_MAX_NAMED = 12
# Least distance of two names, along and across lines of text.
_APART = np.array([5.0, 0.0])
_CORNERS = np.linspace(0.0, 2.0 * np.pi, 25)


@dataclass(frozen=True, eq=False)
class _Name:
    """A label with its style, size and candidate centres (m, 2) in pixels, best first."""

    text: str
    style: dict[str, Any]
    size: Array
    places: Array


def write_names(ax: Axes, film: Film, mark: float) -> None:
    """Write names into the first picture of a film.

    Each name takes the place where it hides least. A name without a free place is not written.
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
    many = len({shape.name for shape in film.shapes if shape.region >= 0}) > _MAX_NAMED
    for touch in film.touches:
        place, size = ax.transData.transform(touch.places[0]), _size(ax, touch.name)
        places = _places_around(place, size, radius, scale)
        yield _Name(touch.name, {"color": LINES[0]}, size, places)
    for shape in film.shapes:
        if shape.name in named or shape.kind in (*BETWEEN, "joint", "pivot"):
            continue
        # One of many bodies is coloured by its mode, and has no name.
        if not shape.name or (many and shape.region >= 0):
            continue
        named.add(shape.name)
        style, size = {"color": INK}, _size(ax, shape.name)
        if shape.kind == "ground":
            places = _label_positions(ax, film, shape, size, scale)
        else:
            style["style"] = "italic"
            pose = film.poses[0, shape.frame]
            solid = shape.kind in ("outline", "disc")
            # The centre of mass may lie at the rim, as of a block that slides on its base.
            middle = place_points(shape.points, pose).mean(axis=0) if solid else pose[:2]
            at = ax.transData.transform(middle)
            places = _places_around(at, size, radius, scale)
            if solid:
                places = np.concatenate([at[None], places])
        if len(places):
            yield _Name(shape.name, style, size, places)


def _size(ax: Axes, text: str) -> Array:
    drawn = ax.text(0.0, 0.0, text, fontsize=_SIZE)
    extent = drawn.get_window_extent()
    drawn.remove()
    return np.array([extent.width, extent.height])


def _places_around(place: Array, size: Array, radius: float, scale: float) -> Array:
    """Return middles of a text around a point, on the right and near first."""
    turns = np.pi * np.arange(_ROUND) / (_ROUND / 2)
    turns = turns[np.argsort(1.0 - np.cos(turns - np.pi / 6.0), kind="stable")]
    directions = np.column_stack([np.cos(turns), np.sin(turns)])
    reaches = (size / 2.0 + radius + distance * scale for distance in _DISTANCES)
    return np.concatenate([place + directions * reach for reach in reaches])


def _label_positions(ax: Axes, film: Film, shape: Shape, size: Array, scale: float) -> Array:
    """Return middles of a text along a surface, on the side of its solid, beyond the hatching."""
    points = ax.transData.transform(place_points(shape.points, film.poses[0, shape.frame]))
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
        costs += _LINE * crosses_boxes(low - clear, high + clear, one, two)
    return costs


def crosses_boxes(low: Array, high: Array, one: Array, two: Array) -> Array:
    """Return which boxes (m,) a line from one point to another passes (Liang and Barsky 1984)."""
    direction = two - one
    with np.errstate(divide="ignore", invalid="ignore"):
        enter, leave = (low - one) / direction, (high - one) / direction
    first, last = np.minimum(enter, leave), np.maximum(enter, leave)
    is_between = (low <= one) & (one <= high)
    still = direction == 0.0
    first = np.where(still, np.where(is_between, -np.inf, np.inf), first).max(axis=1)
    last = np.where(still, np.where(is_between, np.inf, -np.inf), last).min(axis=1)
    found: Array = (first <= last) & (first <= 1.0) & (last >= 0.0)
    return found


def _marks(film: Film) -> Array:
    found = [touch.places[:1] for touch in film.touches]
    marked = [s for s in film.shapes if s.kind in ("mass", "joint", "pivot")]
    found += [place_points(shape.points, film.poses[0, shape.frame]) for shape in marked]
    return np.concatenate([np.empty((0, 2)), *found])


def _lines(film: Film) -> Array:
    """Return all lines (m, 2, 2) of the first picture: edges, bars, surfaces, arrows."""
    found = [np.empty((0, 2, 2))]
    poses = film.poses[0]
    for shape in film.shapes:
        points = place_points(shape.points, poses[shape.frame])
        if shape.kind == "disc":
            rim = np.column_stack([np.cos(_CORNERS), np.sin(_CORNERS)])
            if shape.turns:
                spoke = shape.points + np.array([[0.0, 0.0], [shape.radius, 0.0]])
                found.append(place_points(spoke, poses[shape.frame])[None])
            points = points + shape.radius * rim
        elif shape.kind == "outline":
            points = np.concatenate([points, points[:1]])
        elif shape.kind in BETWEEN:
            points[-1:] = place_points(shape.points[-1:], poses[shape.other])
        elif shape.kind == "ground":
            found.append(hatching(points, film.spacing))
        found.append(np.stack([points[:-1], points[1:]], axis=1))
    for touch in film.touches:
        tip = touch.places[0] + arrows(touch.forces[0], film.half, film.force)
        found.append(np.array([[touch.places[0], tip]]))
    return np.concatenate(found)


# In inches.
_WIDTH, _HIGHEST, _STRIP = 7.2, 6.4, 1.9
# Height of the time above a snapshot.
_CLOCK = 0.25
_SIDE_BY_SIDE = 5
# Fraction of its cell that a snapshot takes.
_PART = 0.93


def picture(film: Film) -> Figure:
    """Return the first instant of a film, its bodies, contacts and surfaces named."""
    from matplotlib.figure import Figure

    size = picture_size(film, _WIDTH, _HIGHEST)
    result = Figure(figsize=size)
    Drawing(result.add_axes((0.0, 0.0, 1.0, 1.0)), film, names=True)
    return result


def strip(figure: Figure, film: Film, top: float) -> None:
    """Draw instants of a film side by side, each with the trails up to it."""
    width, height = figure.get_size_inches()
    own, high = picture_size(film, width / _SIDE_BY_SIDE, _STRIP)
    own, high = _PART * own / width, _PART * high / height
    chosen = spread(film, _SIDE_BY_SIDE)
    for place, instant in enumerate(chosen):
        left = (place + 0.5) / len(chosen) - own / 2.0
        ax = figure.add_axes((left, (top - _CLOCK) / height - high, own, high))
        Drawing(ax, film).show(instant)
        ax.set_title(film.clock(instant), loc="left", fontsize=8, y=1.0, pad=3.0)


def strip_height(film: Film, width: float) -> float:
    """Return the height of a strip of `width` inches."""
    return _PART * picture_size(film, width / _SIDE_BY_SIDE, _STRIP)[1] + _CLOCK


def picture_size(film: Film, width: float, highest: float) -> tuple[float, float]:
    """Return the largest size with the aspect ratio of a film within `width` and `highest`."""
    height = width * film.half[1] / film.half[0]
    return (width, height) if height <= highest else (width * highest / height, highest)


def spread(film: Film, count: int) -> list[int]:
    """Return the first and the last instant, and others at equal distances of the motion."""
    moves = np.abs(np.diff(film.poses, axis=0)).max(axis=1)
    steps = moves[:, :2].max(axis=1) / film.unit + 0.2 * moves[:, 2]
    far = np.concatenate([[0.0], np.cumsum(steps)])
    if not far[-1] > 0.0:
        return [0]
    chosen = np.searchsorted(far, np.linspace(0.0, far[-1], count) * (1.0 - 1e-12))
    return [int(place) for place in np.unique(chosen)]
