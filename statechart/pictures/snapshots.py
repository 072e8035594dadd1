"""One picture of a scene, and a strip of several."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from statechart.pictures.drawing import Drawing
from statechart.pictures.film import Film

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# In inches.
_WIDTH, _HIGHEST, _STRIP = 7.2, 6.4, 1.9
# Above a snapshot, for its time.
_CLOCK = 0.25
_SIDE_BY_SIDE = 5
# Of its place an instant takes so much.
_PART = 0.93


def picture(film: Film) -> Figure:
    """Return the first instant of a film, its bodies, contacts and surfaces named."""
    from matplotlib.figure import Figure

    size = shaped(film, _WIDTH, _HIGHEST)
    result = Figure(figsize=size)
    Drawing(result.add_axes((0.0, 0.0, 1.0, 1.0)), film, names=True)
    return result


def strip(figure: Figure, film: Film, top: float) -> None:
    """Draw instants of a film side by side, each with the trails up to it."""
    width, height = figure.get_size_inches()
    own, high = shaped(film, width / _SIDE_BY_SIDE, _STRIP)
    own, high = _PART * own / width, _PART * high / height
    chosen = spread(film, _SIDE_BY_SIDE)
    for place, instant in enumerate(chosen):
        left = (place + 0.5) / len(chosen) - own / 2.0
        ax = figure.add_axes((left, (top - _CLOCK) / height - high, own, high))
        Drawing(ax, film).show(instant)
        ax.set_title(film.clock(instant), loc="left", fontsize=8, y=1.0, pad=3.0)


def strip_height(film: Film, width: float) -> float:
    """Return how high a strip of so many inches is."""
    return _PART * shaped(film, width / _SIDE_BY_SIDE, _STRIP)[1] + _CLOCK


def shaped(film: Film, width: float, highest: float) -> tuple[float, float]:
    """Return width and height that fit a film, neither above what is given."""
    height = width * film.half[1] / film.half[0]
    return (width, height) if height <= highest else (width * highest / height, highest)


def spread(film: Film, count: int) -> list[int]:
    """Return the first, the last, and instants between which bodies move alike far."""
    moved = np.abs(np.diff(film.poses[:, :, :2], axis=0)).max(axis=(1, 2)) / film.unit
    turned = np.abs(np.diff(film.poses[:, :, 2], axis=0)).max(axis=1)
    far = np.concatenate([[0.0], np.cumsum(moved + 0.2 * turned)])
    if not far[-1] > 0.0:
        return [0]
    chosen = np.searchsorted(far, np.linspace(0.0, far[-1], count) * (1.0 - 1e-12))
    return [int(place) for place in np.unique(chosen)]
