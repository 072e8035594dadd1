"""Axes above each other, as wide as their labels and legends leave, and as high as these need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from statechart.pictures.film import Film
from statechart.pictures.snapshots import strip as draw_strip
from statechart.pictures.snapshots import strip_height

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# In inches: of the picture, at least of axes; around them, between them, of a line of labels.
_WIDTH, _NARROWEST = 7.2, 3.2
_LEFT, _RIGHT, _BETWEEN, _BELOW, _TITLE, _LINE = 0.08, 0.1, 0.12, 0.48, 0.28, 0.14
# Places are on a raster of an inch: letters are, and a picture is to the bit the same.
_RASTER = 100.0


def stack(
    figure: Figure,
    axes: Sequence[Axes],
    heights: Sequence[float],
    *,
    lines: int = 0,
    strip: Film | None = None,
) -> None:
    """Put drawn axes in their places, and give the figure its size.

    Parameters
    ----------
    figure : Figure
        Theirs; its title is written.
    axes : sequence of Axes
        From the top, all ready but for their places; legends are on their right.
    heights : sequence of float
        In inches, where their legends are not higher.
    lines : int
        Of labels above the first.
    strip : Film, optional
        What stands above them: some of its instants side by side.
    """
    dpi = figure.dpi
    figure.set_size_inches(_WIDTH, 2.0 * sum(heights))
    for ax, height in zip(axes, heights, strict=True):  # on which the number of its ticks depends
        ax.set_position((0.15, 0.1, 0.5, height / (2.0 * sum(heights))))
        label, room = ax.yaxis.label, (height + _BETWEEN / 2.0) * dpi
        if label.get_window_extent().height > room:
            label.set_text(label.get_text().replace(" in ", "\nin "))
    figure.align_ylabels(axes)
    left = max(ax.bbox.x0 - _outer(ax) for ax in axes) / dpi + _LEFT
    legends = [
        np.zeros(2) if legend is None else np.array(legend.get_window_extent().size) / dpi
        for legend in (ax.get_legend() for ax in axes)
    ]
    right = max(float(size[0]) for size in legends) + _RIGHT
    left, right = np.ceil(np.array([left, right]) * _RASTER) / _RASTER
    rows = [max(h, float(size[1])) for h, size in zip(heights, legends, strict=True)]
    # The power of ten of numbers that are very small or large stands above their axis.
    powers = [_LINE if ax.yaxis.get_offset_text().get_text() else 0.0 for ax in axes]
    rows = [max(r, h + 2.0 * p) for r, h, p in zip(rows, heights, powers, strict=True)]
    rows = [np.ceil(row * _RASTER) / _RASTER for row in rows]
    width = max(_WIDTH, left + right + _NARROWEST)
    above = _TITLE + _LINE * lines
    above += 0.0 if strip is None else strip_height(strip, width) + _BETWEEN
    high = above + sum(rows) + _BETWEEN * len(rows) + _BELOW
    figure.set_size_inches(width, high)
    top = high - above
    if strip is not None:
        draw_strip(figure, strip, high - _TITLE)
    for ax, row, height in zip(axes, rows, heights, strict=True):
        bottom = top - (row + height) / 2.0
        ax.set_position((left / width, bottom / high, 1.0 - (left + right) / width, height / high))
        top -= row + _BETWEEN
    if figure.get_suptitle():
        figure.suptitle(
            figure.get_suptitle(), x=0.01, y=1.0 - 0.06 / high, ha="left", va="top",
            fontsize=10, fontweight="bold",
        )  # fmt: skip


def _outer(ax: Axes) -> float:
    """Return where the labels on the left of axes begin, in pixels."""
    box = ax.yaxis.get_tightbbox()
    return ax.bbox.x0 if box is None else float(box.x0)
