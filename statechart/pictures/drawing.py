"""A film on the axes of a picture: its shapes, contacts by mode, forces in their cones, trails."""

from __future__ import annotations

from itertools import dropwhile
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.palette import FAINT, INK, LINES, PAPER, state_colours
from statechart.pictures.film import Film, Touch, arrows, cones
from statechart.pictures.names import write_names
from statechart.pictures.scenery import Scenery, points_of, thinner

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

FORCE, TRAIL = LINES[1], LINES[0]
"""Of arrows of forces, and of where bodies have been."""

CLOSED = ("pin", "slide", "slide+", "slide-")
"""States of a contact in which it has a force."""

_RIM = 13  # points on the rim of a cone
_TOUCH, _LEAST = 0.014, 3.0
# The head of an arrow, of its width; a width, at most of its length.
_HEAD, _SHAFT = 5.0, 0.2


class Drawing:
    """A film on axes, shown at one instant after another.

    Trails reach `trail` back in time, all the way by default. With `names` bodies, contacts and
    surfaces are named.
    """

    def __init__(
        self,
        ax: Axes,
        film: Film,
        *,
        trail: float | None = None,
        names: bool = False,
    ) -> None:
        self._ax, self._film, self._trail = ax, film, trail
        ax.set_aspect("equal", adjustable="box")
        ax.set_axis_off()
        self._limits: tuple[tuple[float, float], ...] = ()
        self._look(0)
        self._scenery = Scenery(ax, film)
        paper = points_of(film.unit, ax)
        self._points, self._thin = paper / film.unit, thinner(paper)
        self._size = max(_TOUCH * paper, _LEAST)
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
        self._look(instant)
        self._scenery.show(instant)
        for line, frame in zip(self._trails, film.trails, strict=True):
            since = 0.0 if self._trail is None else film.times[instant] - self._trail
            first = int(np.searchsorted(film.times, since))
            line.set_data(*film.poses[first : instant + 1, frame, :2].T)
        for touch, artists in zip(film.touches, self._contacts, strict=True):
            self._show(touch, artists, instant)

    def moving(self) -> list[Artist]:
        """Return all that has to be drawn anew at another instant, from back to front.

        That is what moves, and what is drawn upon it. What is seen by an eye that moves does, too.
        """
        drawn = {*self._ax.lines, *self._ax.patches, *self._ax.collections, *self._ax.texts}
        ordered = [artist for artist in self._ax.get_children() if artist in drawn]
        ordered.sort(key=lambda artist: artist.get_zorder())
        stands = bool((self._film.centres == self._film.centres[0]).all())
        still = set(self._scenery.still) if stands else set()
        return [*dropwhile(lambda artist: artist in still, ordered)]

    def _look(self, instant: int) -> None:
        (x, y), (width, height) = self._film.centres[instant], self._film.half
        limits = (x - width, x + width), (y - height, y + height)
        # To set them, though they are the same, places everything anew.
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
        mark.set_markerfacecolor(
            state_colours(film.states[touch.region])[state] if closed else PAPER
        )
        mark.set_markeredgecolor(INK if closed else FAINT)
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
