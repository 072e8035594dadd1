"""Figure of a run: states, forces with their cones, modes and events against time."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from io import BytesIO
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Jump, Trace
from statechart.documents.declaration import TIME
from statechart.documents.files import explain_os_errors, write_atomic
from statechart.documents.quantities import axis_label
from statechart.errors import StatechartError
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples
from statechart.palette import GRID, INK, LINES, RUN
from statechart.pictures.drawing import strip as draw_strip
from statechart.pictures.drawing import strip_height
from statechart.pictures.film import Film
from statechart.reporting.curves import (
    COLUMNS,
    DrawnCurve,
    Panel,
    curves,
    end_of_activity,
    impulse_label,
    impulses_of,
    largest,
    remarks,
)

if TYPE_CHECKING:  # importing matplotlib takes half a second
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MAX_LABELLED = 24
# More event lines merge into a grey area.
_MAX_LINES = 75
# Space between labels, as a fraction of the width.
_LABEL_GAP = 0.02
# Rows of labels, and their distance in points.
_LEVELS, _LEVEL_HEIGHT = 3, 10.0
# Panel height in inches, for fewer than _MANY panels and for more.
_TALL, _LOW, _MANY = 1.3, 0.95, 5

# In inches: width of the figure, least width of the axes; margins, gaps, and a row of labels.
_WIDTH, _NARROWEST = 7.2, 3.2
_LEFT, _RIGHT, _BETWEEN, _BELOW, _TITLE, _ROW = 0.08, 0.1, 0.12, 0.48, 0.28, 0.14
# Positions are rounded to this raster per inch, so that files are identical bit by bit.
_RASTER = 100.0

Intervals = dict[str, list[tuple[float, float]]]
"""State -> intervals of time."""

_MAX_BANDS, _MAX_NAMED = 12, 24  # rows, and named intervals of a state in a row
_LEGEND_WIDTH = 26  # characters

SUFFIXES = (".svg", ".png", ".pdf")
"""Suffixes of the files that a figure can be written to."""

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
    observer: Observer, trace: Trace, path: Path | str | None = None, *, strip: Film | None = None
) -> Figure:
    """Draw a run.

    Panels: positions, angles and their velocities (each variable of a small chart), gaps, per
    contact the forces ``X.V`` and ``X.H`` with the friction cone ``+-X.friction * X.V`` and
    impulses as triangles, impulses alone if there are no forces, and controls. Of many curves those
    with the largest range are drawn. Below, a band of modes for every region. Dotted lines mark
    events, diamonds modes of zero duration. The time axis ends after the last visible change.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    samples, panels = curves(observer, trace)
    end = end_of_activity(trace, samples, panels) or 1.0
    bands = len(regions_with_bands(observer.automaton, trace)) or 1
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
        write_figure(result, path)
    return result


def write_figure(drawing: Figure, path: Path | str) -> None:
    """Write a figure to a file: svg, png or pdf by its suffix."""
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if f".{kind}" not in SUFFIXES:
        raise StatechartError(f"a figure is svg, png or pdf, not {path.suffix or path.name!r}")
    with explain_os_errors("write", path):
        write_atomic(path, render(drawing, kind))


def render(drawing: Figure, kind: str) -> bytes:
    """Return the content of a file of `kind` svg, png or pdf, reproducible bit by bit."""
    from matplotlib import rc_context

    stream = BytesIO()
    dated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with rc_context(STYLE):
        drawing.savefig(stream, format=kind, dpi=150, metadata=dated.get(kind))
    return stream.getvalue()


def frame(ax: Axes, *, hidden: Sequence[str] = ("top", "right"), grid: bool = True) -> None:
    """Style axes: hide spines, draw a light grid behind the curves."""
    if grid:
        ax.grid(visible=True, color=GRID, linewidth=0.6)
        ax.set_axisbelow(True)
    for side in hidden:
        ax.spines[side].set_visible(False)


def frame_bands(ax: Axes) -> None:
    """Style axes of coloured bands."""
    ax.tick_params(axis="y", length=0)
    frame(ax, hidden=("top", "right", "left"), grid=False)


def set_title(drawing: Figure, title: str) -> Figure:
    """Write the title of a figure in its upper left corner."""
    drawing.suptitle(title, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawing


def _draw_panel(ax: Axes, panel: Panel, samples: Samples, trace: Trace) -> None:
    line = DrawnCurve.of(samples)
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
        look: Any = {"color": "#777777", "linewidth": 0.9, "linestyle": (0, (4, 2))}
        ax.plot(t, edge, **look, label="\u00b1\u03bcV, the cone")
        ax.plot(t, -edge, **look)
        # A cone much wider than the force is clipped.
        reach = min(largest(edge), 2.0 * max(abs(low), abs(high)))
        low, high = min(low, -1.08 * reach), max(high, 1.08 * reach)
    if panel.impulses and panel.names:
        _mark_impulses(ax, panel, trace)
    elif panel.impulses:
        low, high = _draw_impulses(ax, panel, trace)
    ax.set_ylim(low, high)
    ax.set_ylabel(panel.label)
    frame(ax)
    if panel.names != (panel.title,) or panel.remarks:
        handles, _ = ax.get_legend_handles_labels()
        legend(ax, [*handles, *remark_lines(panel.remarks)])


def _mark_impulses(ax: Axes, panel: Panel, trace: Trace) -> None:
    """Mark the times of impulses on a force axis."""
    look: Any = {"ms": 5.0, "color": RUN, "markeredgecolor": "white", "markeredgewidth": 0.5}
    for region in panel.impulses:
        times, impulses = impulses_of(trace, region)
        label = impulse_label(panel, impulses)
        ax.plot(times, np.zeros(len(times)), "^", **look, zorder=4, label=label)


def _draw_impulses(ax: Axes, panel: Panel, trace: Trace) -> tuple[float, float]:
    """Draw impulses as stems; return the limits of the axis."""
    greatest = 0.0
    for region, colour in zip(panel.impulses, LINES, strict=False):
        times, impulses = impulses_of(trace, region)
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
    label = axis_label("time", unit)
    if end < trace.t_end:
        label += f"; no change until the end at {trace.t_end:.6g}"
    return label


def _event_labels(jumps: Sequence[Jump]) -> Iterator[tuple[Jump, str]]:
    """Yield events with their labels, one label for more than _LEVELS events at one instant."""
    for _, group in groupby(jumps, key=lambda jump: jump.t):
        together = list(group)
        named = [f"{jump.region}.{jump.cause}".removeprefix(".") for jump in together]
        if len(together) > _LEVELS:
            yield together[0], f"{named[0]} and {len(named) - 1} more"
        else:
            yield from zip(together, named, strict=True)


def _draw_events(axes: Sequence[Axes], trace: Trace, span: float) -> int:
    """Draw lines at events with labels that do not overlap; return the rows of labels."""
    jumps = [jump for jump in trace.jumps if jump.t <= span]
    times: list[float] = []
    for jump in jumps:
        # Accumulating events would draw a black bar.
        if not times or jump.t - times[-1] > span / 250:
            times.append(jump.t)
    if len(times) > _MAX_LINES:
        return 0
    faint = 0.8 if len(jumps) <= _MAX_LABELLED else 0.35
    look: Any = {"color": INK, "alpha": faint, "linewidth": 0.6, "linestyle": (0, (1, 2))}
    for ax in axes:
        ax.vlines(times, 0.0, 1.0, transform=ax.get_xaxis_transform(), zorder=2, **look)
    if len(jumps) > _MAX_LABELLED:
        return 0
    free = [-1.0] * _LEVELS
    top = axes[0].get_xaxis_transform()
    for jump, label in _event_labels(jumps):
        place, width = jump.t / span, label_width(label)
        left = place if place + width <= 1.0 else place - width
        level = next((k for k, last in enumerate(free) if left >= last), None)
        if level is None:
            continue
        free[level] = left + width + (_LABEL_GAP if left < place else 0.0)
        above = (0.0, 2.0 + _LEVEL_HEIGHT * level)
        side = "left" if left == place else "right"
        axes[0].annotate(
            label, (jump.t, 1.0), above, xycoords=top, textcoords="offset points",
            fontsize=8, color=INK, ha=side, va="bottom",
        )  # fmt: skip
    return sum(last > -1.0 for last in free)


def regions_with_bands(automaton: Automaton, trace: Trace) -> list[int]:
    """Return the regions with a band: at most _MAX_BANDS that change mode.

    Regions with unique states, such as controllers, come before one of many alike.
    """
    places = list(range(len(trace.regions)))
    if len(places) > _MAX_BANDS:
        changing = [k for k in places if len(_intervals(trace, k)) > 1 or _instants(trace, k)]
        states = {region.name: region.states for region in automaton.regions}
        alike = Counter(states[name] for name in trace.regions)
        own = sorted(changing or places, key=lambda k: alike[states[trace.regions[k]]] > 1)
        places = sorted(own[:_MAX_BANDS])
    return places


def draw_bands(ax: Axes, automaton: Automaton, trace: Trace, end: float) -> None:
    """Draw one row per region, the first on top, with its states as coloured intervals."""
    from matplotlib.patches import Patch

    places = regions_with_bands(automaton, trace)
    unnamed: dict[str, Artist] = {}
    drawn = [automaton.colours[trace.regions[row]] for row in places]
    of_state = {state: {c[state] for c in drawn if state in c} for c in drawn for state in c}
    for y, row in zip(reversed(range(len(places))), places, strict=True):
        colours = automaton.colours[trace.regions[row]]
        for state, stretches in _visible(_intervals(trace, row), end).items():
            spans = [(start, last - start) for start, last in stretches]
            width = 0.4 if len(stretches) < _MAX_NAMED else 0.0
            look: Any = {"facecolors": colours[state], "edgecolor": "white", "linewidth": width}
            ax.broken_barh(spans, (y + 0.1, 0.8), **look)
            seen = [(start, min(last, end)) for start, last in stretches if start < end]
            wide = [pair for pair in seen if (pair[1] - pair[0]) / end > label_width(state)]
            for start, last in wide[:_MAX_NAMED]:
                ax.text((start + last) / 2, y + 0.5, state, ha="center", va="center", fontsize=8)
            if not wide:
                label = state if len(of_state[state]) == 1 else f"{trace.regions[row]} {state}"
                unnamed[label] = Patch(facecolor=colours[state], label=label)
        for state, times in _instants(trace, row).items():
            label = f"{state} for no time"
            (unnamed[label],) = ax.plot(
                times, [y + 0.5] * len(times), "D", markersize=4.5, clip_on=False, label=label,
                color=colours[state], markeredgecolor=INK, markeredgewidth=0.7,
            )  # fmt: skip
    rows = len(places)
    ax.set_ylim(0, rows or 1)
    ax.set_yticks([rows - 0.5 - k for k in range(rows)], [trace.regions[k] for k in places])
    frame_bands(ax)
    ax.set_xlim(0.0, end)
    left = remark_lines(band_remarks(trace, places))
    if unnamed or left:
        legend(ax, [*unnamed.values(), *left], 2 if len(unnamed) > max(2 * rows, 3) else 1)


def band_remarks(trace: Trace, places: Sequence[int]) -> tuple[str, ...]:
    """Return remarks on regions without a row."""
    found: dict[str, list[str]] = {}
    for k, name in enumerate(trace.regions):
        if k not in places:
            states = list(_intervals(trace, k))
            still = len(states) == 1 and not _instants(trace, k)
            found.setdefault(f"always {states[0]}" if still else "not drawn", []).append(name)
    return remarks(found)


def _intervals(trace: Trace, row: int) -> Intervals:
    """Return state -> intervals of a region, adjacent ones joined."""
    result: Intervals = {}
    for state, group in groupby(trace.arcs, key=lambda arc: arc.mode[row]):
        arcs = list(group)
        result.setdefault(state, []).append((arcs[0].start.high, arcs[-1].end.high))
    return result


def _visible(stretches: Intervals, end: float) -> Intervals:
    """Decimate many intervals to one sample per column of the figure."""
    if sum(map(len, stretches.values())) <= COLUMNS:
        return stretches
    every = sorted((start, state) for state, those in stretches.items() for start, _ in those)
    edges = np.linspace(0.0, end, COLUMNS + 1)
    # Low-discrepancy offsets (golden ratio) do not alias with periodic motion.
    times = edges[:-1] + np.arange(COLUMNS) * ((5**0.5 - 1) / 2) % 1 * (end / COLUMNS)
    places = np.searchsorted([start for start, _ in every], times, side="right") - 1
    states = np.array([every[place][1] for place in places])
    begins = np.union1d(np.flatnonzero(states != np.roll(states, 1)), [0])
    seen: Intervals = {state: [] for state in stretches}
    for first, after in zip(begins, [*begins[1:], COLUMNS], strict=True):
        seen[str(states[first])].append((float(edges[first]), float(edges[after])))
    return seen


def _instants(trace: Trace, row: int) -> dict[str, list[float]]:
    """Return state -> times of modes of zero duration."""
    flowed = {arc.j for arc in trace.arcs}
    result: dict[str, list[float]] = {}
    for jump, following in zip(trace.jumps, trace.jumps[1:], strict=False):
        state = jump.target[row]
        if jump.j + 1 not in flowed and state not in (jump.source[row], following.target[row]):
            result.setdefault(state, []).append(jump.t)
    return result


def remark_lines(texts: Sequence[str]) -> list[Artist]:
    """Return legend entries for wrapped texts."""
    from matplotlib.lines import Line2D

    wrapped = ("\n".join(textwrap.wrap(text, _LEGEND_WIDTH)) for text in texts)
    return [Line2D([], [], linestyle="none", label=text) for text in wrapped]


def legend(ax: Axes, handles: Sequence[Artist], columns: int = 1) -> None:
    """Draw a legend to the right of the axes."""
    ax.legend(
        handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5), ncols=columns,
        borderaxespad=0.3, handlelength=1.4, labelspacing=0.2, columnspacing=1.0,
    )  # fmt: skip


def label_width(text: str) -> float:
    """Return the width of a label as a fraction of the axis."""
    return 0.0145 * (len(text) + 1)


def stack(
    figure: Figure,
    axes: Sequence[Axes],
    heights: Sequence[float],
    *,
    lines: int = 0,
    strip: Film | None = None,
) -> None:
    """Set the positions of drawn axes and the size of the figure.

    Axes are stacked from the top, with legends on their right; a row is as high as its axes
    (`heights` in inches) or its legend. Above are `lines` rows of labels and the film strip.
    """
    dpi = figure.dpi
    figure.set_size_inches(_WIDTH, 2.0 * sum(heights))
    for ax, height in zip(axes, heights, strict=True):  # the number of ticks depends on the height
        ax.set_position((0.15, 0.1, 0.5, height / (2.0 * sum(heights))))
        label, available = ax.yaxis.label, (height + _BETWEEN / 2.0) * dpi
        if label.get_window_extent().height > available:
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
    # matplotlib writes the power of ten of tick labels above the axis.
    powers = [_ROW if ax.yaxis.get_offset_text().get_text() else 0.0 for ax in axes]
    rows = [max(r, h + 2.0 * p) for r, h, p in zip(rows, heights, powers, strict=True)]
    rows = [np.ceil(row * _RASTER) / _RASTER for row in rows]
    width = max(_WIDTH, left + right + _NARROWEST)
    above = _TITLE + _ROW * lines
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
    box = ax.yaxis.get_tightbbox()
    return ax.bbox.x0 if box is None else float(box.x0)
