"""The shapes of a film as artists of matplotlib, which move by their transforms."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.arrays import Array
from statechart.palette import FRAME, INK, state_colours
from statechart.pictures.film import BETWEEN, WORLD, Film, Shape, ends_of, hatching

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.path import Path

BODY, SOLID = "#C5D3E2", "#EEF1F4"
"""Fill colours of bodies and of the solid below surfaces."""

_DASHED = (0, (4, 3))
# Sizes relative to the width of the picture.
_BAR, _MASS, _MARK = 0.012, 0.02, 0.011
_WINDINGS = 7
# Lines of springs and dampers: how far along and, in half widths of a spring, across. A damper is a
# rod with its piston, then the cylinder with its rod.
_ALONG = np.linspace(0.2, 0.8, 2 * _WINDINGS + 1)
_ACROSS = [0.0, *(1.0 - 2.0 * (np.arange(1, 2 * _WINDINGS) % 2)), 0.0]
_ZIGZAG = np.concatenate([[(0.0, 0.0)], np.column_stack([_ALONG, _ACROSS]), [(1.0, 0.0)]])
_PISTON = [(0.0, 0.0), (0.55, 0.0), (0.55, 0.3), (0.55, -0.3), (np.nan, np.nan)]
_CYLINDER = [(0.4, 0.45), (0.7, 0.45), (0.7, -0.45), (0.4, -0.45)]
_DASHPOT = np.array([*_PISTON, *_CYLINDER, (np.nan, np.nan), (0.7, 0.0), (1.0, 0.0)])
_PROFILES = {"spring": _ZIGZAG, "damper": _DASHPOT}
# Half width of a spring relative to the picture; fraction of its length at which a spring beside
# its line leaves the line.
_HALF_WIDTH, _TURNS = 0.018, 0.12
# Number of shapes, and width of the picture in points, from which edges are thinner.
_MANY, _NARROW, _THINNEST = 24, 260.0, 0.4
_FILLED = ("outline", "disc")


def points_of(unit: float, ax: Axes) -> float:
    """Return the width of a picture in points."""
    box = ax.get_window_extent()
    width, height = np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())
    scale = min(box.width / width, box.height / height)
    return float(unit * scale * 72.0 / ax.figure.dpi)


def thinner(paper: float) -> float:
    """Return the factor on line widths for a picture of this width in points."""
    return min(max(paper / _NARROW, _THINNEST), 1.0)


def bar_width(paper: float) -> float:
    """Return the width of a bar with its edges for a picture of this width, both in points."""
    return max(_BAR * paper, 2.5 * thinner(paper)) + 1.6 * thinner(paper)


class Scenery:
    """The shapes of a film on axes, which have one scale along x and y and their limits set."""

    def __init__(self, ax: Axes, film: Film) -> None:
        self._ax, self._film = ax, film
        self._paper = points_of(film.unit, ax)
        self._thin = thinner(self._paper)
        self._bodies: list[_Bodies] = []
        self._made: list[tuple[Shape, list[Any]]] = []
        for filled, shapes in groupby(film.shapes, lambda shape: shape.kind in _FILLED):
            if filled:
                self._bodies.append(_Bodies(ax, film, list(shapes)))
            else:
                self._made += [(shape, self._artists(shape)) for shape in shapes]

    @property
    def still(self) -> Iterator[Artist]:
        """Shapes that never move."""
        for shape, artists in self._made:
            if shape.frame == WORLD and shape.kind not in BETWEEN:
                yield from artists

    def show(self, instant: int) -> None:
        """Move all artists to their positions at an instant."""
        from matplotlib.transforms import Affine2D

        for bodies in self._bodies:
            bodies.show(instant)
        for shape, artists in self._made:
            if shape.kind in BETWEEN:
                ends = np.array(ends_of(shape, self._film.poses[instant]))
                artists[0].set_data(*self._line(shape, ends).T)
                if shape.slack is not None:
                    artists[0].set_linestyle(_DASHED if shape.slack[instant] else "-")
                if shape.kind == "coupling":
                    artists[1].set_data(*ends.mean(axis=0)[:, None])
                    artists[1].set_markerfacecolor(state_colour(self._film, instant, shape.region))
                continue
            if shape.frame != WORLD:
                x, y, angle = self._film.poses[instant, shape.frame]
                transform = Affine2D().rotate(angle).translate(x, y) + self._ax.transData
                for artist in artists:
                    artist.set_transform(transform)

    def _line(self, shape: Shape, ends: Array) -> Array:
        """Return the line between two ends; parts of it are separated by nan."""
        direction = ends[1] - ends[0]
        length = float(np.hypot(*direction))
        if shape.kind not in _PROFILES or length == 0.0:
            return ends
        profile = _PROFILES[shape.kind]
        if shape.aside:
            profile = profile * (1.0 - 2.0 * _TURNS, 1.0) + np.array([_TURNS, shape.aside])
            corners = np.array([(0.0, 0.0), (_TURNS, 0.0)])
            profile = np.concatenate([corners, profile, (1.0, 0.0) - corners[::-1]])
        across = np.array([-direction[1], direction[0]]) / length * _HALF_WIDTH * self._film.unit
        return ends[0] + profile[:, :1] * direction + profile[:, 1:] * across

    def _artists(self, shape: Shape) -> list[Any]:
        made = getattr(self, f"_{shape.kind}")(shape)
        for artist in made:
            if not artist.is_transform_set() or artist.axes is None:
                self._ax.add_artist(artist)
        return list(made)

    def _bar(self, shape: Shape) -> list[Artist]:
        from matplotlib.lines import Line2D

        edge = 1.6 * self._thin
        width = bar_width(self._paper) - edge
        style: dict[str, Any] = {"solid_capstyle": "round", "zorder": 2.0}
        x, y = shape.points.T
        return [
            Line2D(x, y, color=FRAME, lw=width + edge, **style),
            Line2D(x, y, color=BODY, lw=width, **(style | {"zorder": 2.01})),
        ]

    def _marked(self, shape: Shape, marker: str, size: float, face: str) -> list[Artist]:
        from matplotlib.lines import Line2D

        x, y = shape.points.T
        mark = Line2D(x, y, marker=marker, linestyle="none", color=INK, zorder=2.5)
        mark.set(markersize=max(size * self._paper, 4.0 * self._thin), markerfacecolor=face)
        mark.set_markeredgewidth(0.9 * self._thin)
        return [mark]

    def _mass(self, shape: Shape) -> list[Artist]:
        return self._marked(shape, "o", _MASS, BODY)

    def _joint(self, shape: Shape) -> list[Artist]:
        return self._marked(shape, "o", _MARK, "white")

    def _pivot(self, shape: Shape) -> list[Artist]:
        return self._marked(shape, "s", _MARK, FRAME)

    def _link(self, shape: Shape) -> list[Artist]:
        from matplotlib.lines import Line2D

        return [Line2D([], [], color=FRAME, lw=1.1 * self._thin, zorder=1.8)]

    _rope = _spring = _damper = _link

    def _reaction(self, shape: Shape) -> list[Artist]:
        (line,) = self._link(shape)
        line.set(linestyle=_DASHED)
        return [line]

    def _coupling(self, shape: Shape) -> list[Artist]:
        return [*self._reaction(shape), *self._marked(shape, "D", _MARK, BODY)]

    def _ground(self, shape: Shape) -> list[Artist]:
        from matplotlib.collections import LineCollection
        from matplotlib.lines import Line2D

        marks = hatching(shape.points, self._film.spacing)
        lines = LineCollection(list(marks), colors=FRAME, linewidths=0.7 * self._thin, zorder=1.2)
        lines.set_transform(self._ax.transData)
        return [Line2D(*shape.points.T, color=INK, lw=1.4 * self._thin, zorder=1.3), lines]


class _Bodies:
    """Outlines and discs, back to front, as one artist, which draws a thousand fast."""

    def __init__(self, ax: Axes, film: Film, shapes: list[Shape]) -> None:
        from matplotlib.collections import LineCollection, PathCollection

        self._film = film
        self._edges = [_edge(shape) for shape in shapes]
        self._frames = np.array([shape.frame for shape in shapes])
        self._regions = [shape.region for shape in shapes]
        # Discs that turn show a radius.
        turning = [(k, s) for k, s in enumerate(shapes) if s.kind == "disc" and s.turns]
        radii = [s.points[0] + np.array([[0.0, 0.0], [s.radius, 0.0]]) for _, s in turning]
        # All points, and the shape that each belongs to.
        points = [*(edge.vertices for edge in self._edges), *radii]
        counts = [np.shape(part)[0] for part in points]
        owners = [*range(len(shapes)), *(k for k, _ in turning)]
        self._points, self._ends = np.concatenate(points), np.cumsum(counts)[:-1]
        self._of = self._frames[np.repeat(owners, counts)]
        width = thinner(points_of(film.unit, ax)) * (0.6 if len(film.shapes) > _MANY else 1.0)
        self._filled = PathCollection([], edgecolors=FRAME, linewidths=width, zorder=2.0)
        self._radii = LineCollection([], colors=FRAME, linewidths=0.8 * width, zorder=2.1)
        for artist in (self._filled, self._radii):
            ax.add_collection(artist, autolim=False)

    def show(self, instant: int) -> None:
        from matplotlib.path import Path

        film, poses = self._film, self._film.poses[instant, self._of]
        c, s, (x, y) = np.cos(poses[:, 2]), np.sin(poses[:, 2]), self._points.T
        there = np.column_stack([c * x - s * y, s * x + c * y]) + poses[:, :2]
        parts = np.split(there, self._ends)
        edges = zip(parts, self._edges, strict=False)
        self._filled.set_paths([Path(part, edge.codes) for part, edge in edges])
        self._radii.set_segments(parts[len(self._edges) :])
        self._filled.set_facecolor([state_colour(film, instant, k) for k in self._regions])


def state_colour(film: Film, instant: int, region: int) -> str:
    """Return the colour of a region's state at an instant; the colour of bodies without one."""
    return BODY if region < 0 else state_colours(film.states[region])[film.state(instant, region)]


def _edge(shape: Shape) -> Path:
    """Return the closed edge of an outline or a disc, in its frame."""
    from matplotlib.path import Path

    if shape.kind == "disc":
        circle = Path.unit_circle()
        return Path(shape.points[0] + shape.radius * np.asarray(circle.vertices), circle.codes)
    return Path(np.concatenate([shape.points, shape.points[:1]]), closed=True)
