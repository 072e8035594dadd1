"""The shapes of a film as artists of matplotlib, which move by their transforms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.arrays import Array
from statechart.palette import FRAME, INK
from statechart.pictures.film import WORLD, Film, Shape, placed, strokes

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

BODY, SOLID = "#C5D3E2", "#EEF1F4"
"""Of bodies and of what surfaces bound."""

# Sizes on the paper, in parts of the width of a picture.
_BAR, _MASS, _MARK = 0.012, 0.02, 0.011
_WINDINGS = 7


def points_of(unit: float, ax: Axes) -> float:
    """Return how many points of the paper the width of a picture is."""
    box = ax.get_window_extent()
    width, height = np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())
    scale = min(box.width / width, box.height / height)
    return float(unit * scale * 72.0 / ax.figure.dpi)


def bar_width(paper: float) -> float:
    """Return how wide a bar is with its edges, in points, for a picture so wide in points."""
    return max(_BAR * paper, 2.5) + 1.6


class Scenery:
    """The shapes of a film on axes.

    Parameters
    ----------
    ax : Axes
        Of the same scale along x and y, its limits set.
    film : Film
        What is drawn.
    """

    def __init__(self, ax: Axes, film: Film) -> None:
        self._ax, self._film = ax, film
        self._paper = points_of(film.unit, ax)
        self._made = [(shape, self._artists(shape)) for shape in film.shapes]

    def show(self, instant: int) -> None:
        """Move everything to where it is at an instant."""
        from matplotlib.transforms import Affine2D

        for shape, artists in self._made:
            if shape.kind in ("link", "spring"):
                ends = _ends(shape, self._film.poses[instant])
                artists[0].set_data(*_wound(ends, shape.kind, self._film.unit).T)
                continue
            if shape.frame != WORLD:
                x, y, angle = self._film.poses[instant, shape.frame]
                moved = Affine2D().rotate(angle).translate(x, y) + self._ax.transData
                for artist in artists:
                    artist.set_transform(moved)
            if shape.region >= 0:
                artists[0].set_facecolor(self._colour(instant, shape.region))

    def _colour(self, instant: int, region: int) -> str:
        from statechart.palette import state_colours

        states = self._film.states[region]
        return state_colours(states)[self._film.state(instant, region)]

    def _artists(self, shape: Shape) -> list[Any]:
        made = getattr(self, f"_{shape.kind}")(shape)
        for artist in made:
            if not artist.is_transform_set() or artist.axes is None:
                self._ax.add_artist(artist)
        return list(made)

    def _outline(self, shape: Shape) -> list[Artist]:
        from matplotlib.patches import Polygon

        return [Polygon(shape.points, closed=True, **_filled(self._film))]

    def _disc(self, shape: Shape) -> list[Artist]:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Circle

        centre = tuple(shape.points[0])
        made: list[Artist] = [Circle(centre, shape.radius, **_filled(self._film))]
        if shape.region >= 0:  # by a radius one sees it turn
            x, y = centre
            made.append(Line2D([x, x + shape.radius], [y, y], color=FRAME, lw=0.8, zorder=2.1))
        return made

    def _bar(self, shape: Shape) -> list[Artist]:
        from matplotlib.lines import Line2D

        width = bar_width(self._paper) - 1.6
        style: dict[str, Any] = {"solid_capstyle": "round", "zorder": 2.0}
        x, y = shape.points.T
        return [
            Line2D(x, y, color=FRAME, lw=width + 1.6, **style),
            Line2D(x, y, color=BODY, lw=width, **(style | {"zorder": 2.01})),
        ]

    def _marked(self, shape: Shape, marker: str, size: float, face: str) -> list[Artist]:
        from matplotlib.lines import Line2D

        x, y = shape.points.T
        size = max(size * self._paper, 4.0)
        mark = {"marker": marker, "markersize": size, "markeredgecolor": INK, "linestyle": "none"}
        return [Line2D(x, y, markerfacecolor=face, markeredgewidth=0.9, zorder=2.5, **mark)]  # type: ignore[arg-type]

    def _mass(self, shape: Shape) -> list[Artist]:
        return self._marked(shape, "o", _MASS, BODY)

    def _joint(self, shape: Shape) -> list[Artist]:
        return self._marked(shape, "o", _MARK, "white")

    def _pivot(self, shape: Shape) -> list[Artist]:
        return self._marked(shape, "s", _MARK, FRAME)

    def _link(self, shape: Shape) -> list[Artist]:
        from matplotlib.lines import Line2D

        return [Line2D([], [], color=FRAME, lw=1.1, zorder=1.8)]

    _spring = _link

    def _ground(self, shape: Shape) -> list[Artist]:
        from matplotlib.collections import LineCollection
        from matplotlib.lines import Line2D

        marks = strokes(shape.points, self._film.spacing)
        hatching = LineCollection(list(marks), colors=FRAME, linewidths=0.7, zorder=1.2)
        hatching.set_transform(self._ax.transData)
        return [Line2D(*shape.points.T, color=INK, lw=1.4, zorder=1.3), hatching]


def _filled(film: Film) -> dict[str, Any]:
    many = len(film.shapes) > 24
    return {"facecolor": BODY, "edgecolor": FRAME, "linewidth": 0.6 if many else 1.0, "zorder": 2.0}


def _ends(shape: Shape, poses: Array) -> Array:
    """Return the two ends of a link in the world."""
    first = placed(shape.points[:1], poses[shape.frame])
    last = placed(shape.points[-1:], poses[shape.other])
    return np.concatenate([first, last])


def _wound(ends: Array, kind: str, unit: float) -> Array:
    """Return the line between two ends; of a spring, a zigzag whose ends are straight."""
    if kind == "link":
        return ends
    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    if length == 0.0:
        return ends
    across = np.array([-along[1], along[0]]) / length * 0.018 * unit
    inner = np.linspace(0.2, 0.8, 2 * _WINDINGS + 1)
    side = np.where(np.arange(len(inner)) % 2 == 0, 1.0, -1.0)
    side[[0, -1]] = 0.0
    zigzag = ends[0] + inner[:, None] * along + side[:, None] * across
    return np.concatenate([ends[:1], zigzag, ends[1:]])
