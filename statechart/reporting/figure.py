"""A run as one picture: states, forces with their cones, modes and events against time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.documents.files import write_atomic
from statechart.errors import StatechartError
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples
from statechart.palette import GRID, INK, LINES, state_colours
from statechart.pictures.film import Film
from statechart.pictures.snapshots import strip as draw_strip
from statechart.pictures.snapshots import strip_height

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


_WIDTH = 7.2
_MOST_LINES = 6
_MOST_PANELS = 4
# Relative to the largest value: below this a curve is the rounding of zero.
_NOTHING = 1e-9
_MOST_LABELLED = 24
# Between a label that ends at its event and one that begins there, of the width.
_GAP = 0.02
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


@dataclass(frozen=True)
class Panel:
    """Columns that share an axis; cone: the column and the factor that make its edges."""

    title: str
    names: tuple[str, ...]
    cone: tuple[str, float | Array] | None = None


def figure(
    observer: Observer,
    trace: Trace,
    path: Path | str | None = None,
    *,
    strip: Film | None = None,
) -> Figure:
    """Draw a run.

    Panels, where there is something to show: the variables that others are the rates of, those
    rates (of a small chart, each variable), gaps, and per contact the forces ``X.V`` and ``X.H``
    with the edges of the cone ``+-X.friction * X.V``; below, a band of modes for every region.
    Dotted lines and labels mark events, where they do not crowd; diamonds mark modes of zero
    duration.

    Parameters
    ----------
    observer : Observer
        Of the simulator that made the run.
    trace : Trace
        The run.
    path : Path or str, optional
        Where to write it, too; svg, png or pdf by its suffix.
    strip : Film, optional
        What stands above the panels: the bodies, at some of its instants side by side.

    Raises
    ------
    StatechartError
        If the suffix is none of these or the file cannot be written.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    samples, panels = curves(observer, trace)
    bands = len(trace.regions)
    heights = [1.6 if i == 0 else 1.3 for i in range(len(panels))] + [0.26 * bands]
    with rc_context(STYLE):
        high = 0.9 + 1.12 * sum(heights)
        above = 0.0 if strip is None else 0.3 + strip_height(strip, _WIDTH)
        whole = Figure(figsize=(_WIDTH, high + above), layout="constrained")
        result: Figure | SubFigure = whole
        if strip is not None:
            (upper,), (result,) = whole.subfigures(2, 1, squeeze=False, height_ratios=(above, high))
            draw_strip(upper, strip, _WIDTH)
        axes = result.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[
            :, 0
        ]
        for ax, panel in zip(axes, panels, strict=False):
            _draw_panel(ax, panel, samples)
        _draw_bands(axes[-1], observer.automaton, trace)
        _draw_events(list(axes), trace)
        result.align_ylabels(axes)
        result.suptitle(trace.name, x=0.01, ha="left", fontsize=10, fontweight="bold")
    if path is not None:
        write(whole, path)
    return whole


def write(drawing: Figure, path: Path | str) -> None:
    """Write a figure to a file: svg, png or pdf by its suffix.

    Raises
    ------
    StatechartError
        If the suffix is none of these or the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("svg", "png", "pdf"):
        raise StatechartError(f"a figure is svg, png or pdf, not {path.suffix or path.name!r}")
    try:
        write_atomic(path, render(drawing, kind))
    except OSError as error:
        raise StatechartError(f"cannot write {path}: {error.strerror or error}") from error


def curves(observer: Observer, trace: Trace) -> tuple[Samples, list[Panel]]:
    """Return a run sampled for curves, and which of them share an axis."""
    samples = observer.sample(trace, per_step=_per_step(trace))
    return samples, _panels(observer.automaton, trace, samples)


def render(drawing: Figure, kind: str) -> bytes:
    """Return a figure as a file's content: `kind` svg, png or pdf; the same each time."""
    from matplotlib import rc_context

    stream = BytesIO()
    dated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
    with rc_context(STYLE):
        drawing.savefig(stream, format=kind, dpi=150, metadata=dated.get(kind))
    return stream.getvalue()


def _per_step(trace: Trace) -> int:
    """Enough points for a smooth curve, few for a run of many steps."""
    steps = sum(len(arc.coefficients) for arc in trace.arcs)
    return int(np.clip(4000 // max(steps, 1), 4, 64))


def _panels(automaton: Automaton, trace: Trace, samples: Samples) -> list[Panel]:
    # A variable whose rate is another variable is a position, the other its speed.
    places = {symbol: k for k, symbol in enumerate(automaton.variables)}
    speeds = {places[rate] for rate in automaton.rates if rate in places}
    groups: dict[str, list[str]] = {"position": [], "velocity": []}
    for k, name in enumerate(automaton.names):
        groups["velocity" if k in speeds else "position"].append(name)
    if not speeds:
        # Nothing tells which belong together: few get a panel each, since units may differ.
        few = len(automaton.names) < _MOST_PANELS
        groups = {n: [n] for n in automaton.names} if few else {"variables": groups["position"]}
    panels = [Panel(title, tuple(names)) for title, names in groups.items() if names]
    columns = samples.columns
    scale = max((_largest(columns[name]) for name in automaton.names), default=0.0)
    gaps, forces = [], []
    for region in trace.regions:
        gap = columns.get(f"{region}.gap")
        # On the ground all the time, or the height that is drawn already: nothing to see.
        if gap is not None and _largest(gap) > _NOTHING * scale:
            others = (_largest(gap - columns[name]) for name in automaton.names)
            if min(others, default=np.inf) > _NOTHING * scale:
                gaps.append(f"{region}.gap")
        normal, tangential = f"{region}.V", f"{region}.H"
        if normal in columns and tangential in columns and _largest(columns[normal]) > 0.0:
            # A column where states of regions set it.
            friction = columns.get(f"{region}.friction")
            if friction is None:
                friction = np.array(trace.parameters.get(f"{region}.friction", 0.0))
            drawable = np.where((friction > 0.0) & (friction < np.inf), friction, np.nan)
            cone = None if np.isnan(drawable).all() else (normal, drawable)
            drawn = (normal, tangential) if _largest(columns[tangential]) > 0.0 else (normal,)
            forces.append(Panel("force", drawn, cone))
    forces = forces[: _MOST_PANELS - len(panels)]
    if gaps and len(panels) + len(forces) < _MOST_PANELS:
        panels.append(Panel("gap", tuple(gaps)))
    # Coefficients of contacts show as the edges of their cones.
    controls = [
        name
        for name, expression in automaton.observables.items()
        if expression in automaton.controls and "." not in name
    ]
    if controls:
        forces.append(Panel("control", tuple(controls)))
    return panels + forces


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))


def _draw_panel(ax: Axes, panel: Panel, samples: Samples) -> None:
    # Broken at jumps, which take no time: a vertical line would be no part of the motion.
    breaks = np.flatnonzero(np.diff(samples.j)) + 1
    t = np.insert(samples.t, breaks, np.nan)
    ax.axhline(0.0, color=INK, linewidth=0.6, zorder=1)
    values = {name: samples.columns[name] for name in panel.names}
    for name, colour in zip(panel.names[:_MOST_LINES], LINES, strict=False):
        ax.plot(t, np.insert(values[name], breaks, np.nan), color=colour, label=name, zorder=3)
    if len(panel.names) > _MOST_LINES:
        ax.plot([], [], " ", label=f"and {len(panel.names) - _MOST_LINES} more")
    low, high = _limits(list(values.values())[:_MOST_LINES])
    if panel.cone is not None:
        name, friction = panel.cone
        edge = np.insert(friction * values[name], breaks, np.nan)
        ax.fill_between(t, -edge, edge, color="#000000", alpha=0.06, linewidth=0.0, zorder=0)
        for sign in (1.0, -1.0):
            label = "\u00b1\u03bcV, the cone" if sign > 0 else None
            ax.plot(
                t, sign * edge, color="#777777", linewidth=0.9, linestyle=(0, (4, 2)), label=label
            )
        # A cone much wider than the force is cut off: the force is what is looked at.
        reach = min(_largest(edge), 2.0 * max(abs(low), abs(high)))
        low, high = min(low, -1.08 * reach), max(high, 1.08 * reach)
    ax.set_ylim(low, high)
    ax.set_ylabel(panel.title)
    ax.grid(visible=True, color=GRID, linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    if panel.names != (panel.title,):
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1.6)


def _limits(curves: Sequence[Array]) -> tuple[float, float]:
    finite = np.concatenate([np.zeros(1), *(c[np.isfinite(c)] for c in curves)])
    low, high = float(finite.min()), float(finite.max())
    margin = 0.08 * (high - low) or 1.0
    return low - margin, high + margin


def _draw_bands(ax: Axes, automaton: Automaton, trace: Trace) -> None:
    """Draw one row per region, the first on top, its states as coloured stretches of time."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    span = trace.t_end or 1.0
    rows = len(trace.regions)
    unnamed: dict[str, Patch | Line2D] = {}
    for row, region in enumerate(automaton.regions):
        y = rows - 1 - row
        colours = state_colours(region.states)
        for state, stretches in _stretches(trace, row).items():
            ax.broken_barh(
                [(start, end - start) for start, end in stretches],
                (y + 0.1, 0.8),
                facecolors=colours[state],
                edgecolor="white",
                linewidth=0.4 if len(stretches) < _MOST_LABELLED else 0.0,
            )
            wide = [pair for pair in stretches if (pair[1] - pair[0]) / span > _room(state)]
            for start, end in wide[:_MOST_LABELLED]:
                ax.text((start + end) / 2, y + 0.5, state, ha="center", va="center", fontsize=8)
            if not wide:
                unnamed[state] = Patch(facecolor=colours[state], label=state)
        for state, times in _instants(trace, row).items():
            unnamed[f"{state} for no time"] = ax.plot(
                times,
                np.full(len(times), y + 0.5),
                "D",
                markersize=4.5,
                clip_on=False,
                color=colours[state],
                markeredgecolor=INK,
                markeredgewidth=0.7,
                label=f"{state} for no time",
            )[0]
    ax.set_ylim(0, rows)
    ax.set_yticks([rows - 0.5 - row for row in range(rows)], trace.regions)
    ax.tick_params(axis="y", length=0)
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.set_xlim(0.0, span)
    ax.set_xlabel("time")
    if unnamed:
        ax.legend(
            handles=list(unnamed.values()),
            loc="center left",
            bbox_to_anchor=(1.0, 0.5),
            handlelength=1.0,
        )


def _room(text: str) -> float:
    """Return the width of a label as a part of the axis."""
    return 0.0125 * (len(text) + 1)


def _stretches(trace: Trace, row: int) -> dict[str, list[tuple[float, float]]]:
    """Return state -> times that the region spends in it, adjoining ones joined."""
    result: dict[str, list[tuple[float, float]]] = {}
    last = ""
    for arc in trace.arcs:
        state, start, end = arc.mode[row], arc.start.high, arc.end.high
        stretches = result.setdefault(state, [])
        if state == last:
            stretches[-1] = (stretches[-1][0], end)
        else:
            stretches.append((start, end))
        last = state
    return result


def _instants(trace: Trace, row: int) -> dict[str, list[float]]:
    """Return state -> times at which the region passed through it in no time."""
    flowed = {arc.j for arc in trace.arcs}
    result: dict[str, list[float]] = {}
    for jump, following in zip(trace.jumps, trace.jumps[1:], strict=False):
        state = jump.target[row]
        if jump.j + 1 not in flowed and state not in (jump.source[row], following.target[row]):
            result.setdefault(state, []).append(jump.t)
    return result


def _draw_events(axes: Sequence[Axes], trace: Trace) -> None:
    span = trace.t_end or 1.0
    times: list[float] = []
    for jump in trace.jumps:
        # Events that accumulate would make a black bar.
        if not times or jump.t - times[-1] > span / 250:
            times.append(jump.t)
    faint = 0.8 if len(trace.jumps) <= _MOST_LABELLED else 0.35
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
    if len(trace.jumps) > _MOST_LABELLED:
        return
    # Labels on two levels over the first panel; what has no room on them is left out.
    free = [-1.0] * 2
    top = axes[0].get_xaxis_transform()
    for jump in trace.jumps:
        place, width = jump.t / span, _room(jump.cause)
        left = place if place + width <= 1.0 else place - width
        level = next((k for k, end in enumerate(free) if left >= end), None)
        if level is None:
            continue
        free[level] = left + width + (_GAP if left < place else 0.0)
        axes[0].text(
            jump.t,
            1.02 + 0.1 * level,
            jump.cause,
            transform=top,
            fontsize=8,
            color=INK,
            ha="left" if left == place else "right",
            va="bottom",
        )
