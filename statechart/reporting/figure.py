"""A run as one picture: states, forces with their cones, modes and events against time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import Jump, Trace
from statechart.documents.declaration import TIME
from statechart.documents.files import write_atomic
from statechart.documents.quantities import entitled
from statechart.errors import StatechartError
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples
from statechart.palette import GRID, INK, LINES, RUN
from statechart.pictures.film import Film
from statechart.reporting.bands import banded, draw_bands
from statechart.reporting.curves import Panel, busy_until, curves, impulse_label, largest, struck
from statechart.reporting.legends import legend, remark_lines, room
from statechart.reporting.stack import stack
from statechart.reporting.thinning import Line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MOST_LABELLED = 24
# Of more the lines make a grey area, which tells nothing that bands of modes do not.
_MOST_LINES = 75
# Between a label that ends at its event and one that begins there, of the width.
_GAP = 0.02
# Lines of labels, and how far apart they are in points.
_LEVELS, _LINE = 3, 10.0
# How high a panel is, of few and of many.
_TALL, _LOW, _MANY = 1.3, 0.95, 5

SUFFIXES = (".svg", ".png", ".pdf")
"""Of the files that a figure can be written to."""

STYLE = {
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "svg.hashsalt": "statechart",
}


def figure(
    observer: Observer,
    trace: Trace,
    path: Path | str | None = None,
    *,
    strip: Film | None = None,
) -> Figure:
    """Draw a run.

    Panels, where there is something to show: positions, angles and their velocities (of a small
    chart, each variable), gaps, and per contact the forces ``X.V`` and ``X.H`` with the edges of
    the cone ``+-X.friction * X.V``, its impulses as triangles; impulses alone where there are no
    forces; controls. Of many curves those that move most are drawn, and the others named. Below, a
    band of modes for every region. Dotted lines and labels mark events, where they do not crowd;
    diamonds mark modes of zero duration. Time ends where nothing happens any more.

    Raises
    ------
    StatechartError
        If the suffix is none of these or the file cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    samples, panels = curves(observer, trace)
    end = busy_until(trace, samples, panels) or 1.0
    bands = len(banded(observer.automaton, trace)) or 1
    each = _TALL if len(panels) < _MANY else _LOW
    heights = [*(each for _ in panels), 0.26 * bands]
    with rc_context(STYLE):
        result = Figure()
        axes = list(result.subplots(len(heights), 1, sharex=True, squeeze=False)[:, 0])
        for ax, panel in zip(axes, panels, strict=False):
            _draw_panel(ax, panel, samples, trace)
        draw_bands(axes[-1], observer.automaton, trace, end)
        axes[-1].set_xlabel(_time(observer.automaton.declaration.unit(TIME), trace, end))
        lines = _draw_events(axes, trace, end)
        result.suptitle(trace.name)
        stack(result, axes, heights, lines=lines, strip=strip)
    if path is not None:
        write(result, path)
    return result


def write(drawing: Figure, path: Path | str) -> None:
    """Write a figure to a file: svg, png or pdf by its suffix.

    Raises
    ------
    StatechartError
        If the suffix is none of these or the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if f".{kind}" not in SUFFIXES:
        raise StatechartError(f"a figure is svg, png or pdf, not {path.suffix or path.name!r}")
    try:
        write_atomic(path, render(drawing, kind))
    except OSError as error:
        raise StatechartError(f"cannot write {path}: {error.strerror or error}") from error


def render(drawing: Figure, kind: str) -> bytes:
    """Return a figure as a file's content: `kind` svg, png or pdf; the same each time."""
    from matplotlib import rc_context

    stream = BytesIO()
    dated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with rc_context(STYLE):
        drawing.savefig(stream, format=kind, dpi=150, metadata=dated.get(kind))
    return stream.getvalue()


def _draw_panel(ax: Axes, panel: Panel, samples: Samples, trace: Trace) -> None:
    # Broken at jumps, which take no time: a vertical line would be no part of the motion.
    line = Line.of(samples)
    ax.axhline(0.0, color=INK, linewidth=0.6, zorder=1)
    values = [samples.columns[name] for name in panel.names]
    for name, column, colour in zip(panel.names, values, LINES, strict=False):
        ax.plot(line.times, line.values(column), color=colour, label=name, zorder=3)
    low, high = _limits(values)
    if panel.cone is not None:
        name, friction = panel.cone
        edge = line.values(friction * samples.columns[name])
        t = line.times
        ax.fill_between(t, -edge, edge, color="#000000", alpha=0.06, linewidth=0.0, zorder=0)
        for sign in (1.0, -1.0):
            label = "\u00b1\u03bcV, the cone" if sign > 0 else None
            ax.plot(
                t, sign * edge, color="#777777", linewidth=0.9, linestyle=(0, (4, 2)), label=label
            )
        # A cone much wider than the force is cut off: the force is what is looked at.
        reach = min(largest(edge), 2.0 * max(abs(low), abs(high)))
        low, high = min(low, -1.08 * reach), max(high, 1.08 * reach)
    if panel.impulses and panel.names:
        _mark_impulses(ax, panel, trace)
    elif panel.impulses:
        low, high = _draw_impulses(ax, panel, trace)
    ax.set_ylim(low, high)
    ax.set_ylabel(panel.label)
    ax.grid(visible=True, color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    if panel.names != (panel.title,) or panel.remarks:
        handles, _ = ax.get_legend_handles_labels()
        legend(ax, [*handles, *remark_lines(panel.remarks)])


def _mark_impulses(ax: Axes, panel: Panel, trace: Trace) -> None:
    """Mark impulses on the axis of forces, which has no place for their size."""
    for region in panel.impulses:
        times, impulses = struck(trace, region)
        ax.plot(
            times,
            np.zeros(len(times)),
            "^",
            markersize=5.0,
            color=RUN,
            markeredgecolor="white",
            markeredgewidth=0.5,
            zorder=4,
            label=impulse_label(panel, impulses),
        )


def _draw_impulses(ax: Axes, panel: Panel, trace: Trace) -> tuple[float, float]:
    """Draw impulses as stems; return the limits of the axis."""
    greatest = 0.0
    for region, colour in zip(panel.impulses, LINES, strict=False):
        times, impulses = struck(trace, region)
        ax.vlines(times, 0.0, impulses, color=colour, linewidth=1.2, zorder=3)
        ax.plot(times, impulses, "o", markersize=2.5, color=colour, label=region, zorder=3)
        greatest = max(greatest, largest(impulses))
    return -0.08 * greatest, 1.08 * greatest


def _limits(curves: Sequence[Array]) -> tuple[float, float]:
    finite = np.concatenate([np.zeros(1), *(c[np.isfinite(c)] for c in curves)])
    low, high = float(finite.min()), float(finite.max())
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin


def _time(unit: str, trace: Trace, end: float) -> str:
    """Return what stands at the axis of time."""
    label = entitled("time", unit)
    if end < trace.t_end:
        label += f"; until the end at {trace.t_end:.6g} nothing happens any more"
    return label


def _called(jumps: Sequence[Jump]) -> Iterator[tuple[Jump, str]]:
    """Yield events and what they are called; of more at one instant than have lines the first."""
    for _, group in groupby(jumps, key=lambda jump: jump.t):
        together = list(group)
        named = [f"{jump.region}.{jump.cause}".removeprefix(".") for jump in together]
        if len(together) > _LEVELS:
            yield together[0], f"{named[0]} and {len(named) - 1} more"
        else:
            yield from zip(together, named, strict=True)


def _draw_events(axes: Sequence[Axes], trace: Trace, span: float) -> int:
    """Draw lines at events, and label them where they do not crowd; return lines of labels."""
    jumps = [jump for jump in trace.jumps if jump.t <= span]
    times: list[float] = []
    for jump in jumps:
        # Events that accumulate would make a black bar.
        if not times or jump.t - times[-1] > span / 250:
            times.append(jump.t)
    if len(times) > _MOST_LINES:
        return 0
    faint = 0.8 if len(jumps) <= _MOST_LABELLED else 0.35
    for ax in axes:
        ax.vlines(
            times,
            0.0,
            1.0,
            transform=ax.get_xaxis_transform(),
            color=INK,
            alpha=faint,
            linewidth=0.6,
            linestyle=(0, (1, 2)),
            zorder=2,
        )
    if len(jumps) > _MOST_LABELLED:
        return 0
    # Labels on levels over the first panel; what has no room on them is left out.
    free = [-1.0] * _LEVELS
    top = axes[0].get_xaxis_transform()
    for jump, said in _called(jumps):
        place, width = jump.t / span, room(said)
        left = place if place + width <= 1.0 else place - width
        level = next((k for k, last in enumerate(free) if left >= last), None)
        if level is None:
            continue
        free[level] = left + width + (_GAP if left < place else 0.0)
        axes[0].annotate(
            said,
            (jump.t, 1.0),
            (0.0, 2.0 + _LINE * level),
            xycoords=top,
            textcoords="offset points",
            fontsize=8,
            color=INK,
            ha="left" if left == place else "right",
            va="bottom",
        )
    return sum(last > -1.0 for last in free)
