"""Legends on the right of axes, and how much room words take."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

# Characters of a line.
_LEGEND = 26


def remark_lines(texts: Sequence[str]) -> list[Artist]:
    """Return what stands in a legend for texts, in a few lines each."""
    from matplotlib.lines import Line2D

    wrapped = ("\n".join(textwrap.wrap(text, _LEGEND)) for text in texts)
    return [Line2D([], [], linestyle="none", label=text) for text in wrapped]


def legend(ax: Axes, handles: Sequence[Artist], columns: int = 1) -> None:
    """Write a legend; of many short entries in columns."""
    ax.legend(
        handles=handles,
        loc="center left",
        bbox_to_anchor=(1.0, 0.5),
        borderaxespad=0.3,
        handlelength=1.4,
        labelspacing=0.2,
        columnspacing=1.0,
        ncols=columns,
    )


def room(text: str) -> float:
    """Return the width of a label as a part of the axis."""
    return 0.0145 * (len(text) + 1)
