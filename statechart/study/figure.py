"""Work-precision diagram of a study: error against cost and against tolerance."""

from __future__ import annotations

import csv
import io
import math
from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from statechart.documents.files import explain_os_errors, write_atomic
from statechart.palette import GRID, INK, LINES
from statechart.reporting.figure import STYLE, frame, render, set_title
from statechart.study.measurements import Measurements, Point
from statechart.study.slopes import Slope, points_to_fit, slopes
from statechart.study.text import describe_study, to_dict
from statechart.tabular import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = "osD^vPX"
_LABELS = (
    "time of a run, s (dots: cold)",
    "evaluations of the rates (impulse: steps)",
    "tolerance or accuracy (impulse: step)",
    "tolerance",
)
# Shorter scales have several ticks per decade.
_SHORT = 100.0


def figure(study: Measurements) -> Figure:
    """Draw a study.

    Above, errors against run time (small dots: first runs of a process, with their own Pareto
    front) and against evaluations of the rates. Below, errors and accepted steps against tolerance
    or fixed step, with fitted slopes and the line error = tolerance. Hollow marks: other modes than
    the reference. For chaotic motion the time of separation from the reference replaces errors.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 6.4), layout="constrained")
        axes = drawing.subplots(2, 2)
        (times, works), (promises, steps) = axes
        for place, (family, points) in enumerate(study.families.items()):
            line_style = _LineStyle(LINES[place % len(LINES)], _MARKERS[place % len(_MARKERS)])
            heights = [_height(study, p) for p in points]
            fineness = [p.setting.fineness for p in points]
            _draw(times, points, [p.seconds for p in points], heights, line_style, family)
            firsts = [math.nan if p.cold is None else p.cold for p in points]
            times.plot(firsts, heights, ".", markersize=3, color=line_style.colour, alpha=0.6)
            _draw(works, points, [_work(p) for p in points], heights, line_style)
            _draw(promises, points, fineness, heights, line_style)
            if points[0].setting.accuracy is None and not points[0].setting.stepped:
                _draw(steps, points, fineness, [float(p.steps) for p in points], line_style)
            for slope in slopes(study) if study.parted is None else ():
                if slope.family == family:
                    _slope(
                        promises if slope.of == "error" else steps, study, slope, line_style.colour
                    )
        if study.parted is None:
            for once in (False, True):
                _front(times, study, once=once)
            dotted = (0, (1, 2))
            promises.axline((1e-6, 1e-6), slope=1.0, color=INK, linewidth=0.6, linestyle=dotted)
            for ax in (times, works, promises):
                ax.set_ylabel("relative error")
                ax.set_yscale("log")
                if study.least > 0.0:
                    label = "error of the reference" if ax is times else None
                    band = study.least / 10.0, study.least
                    ax.axhspan(*band, color=GRID, zorder=0, label=label)
        else:
            look: Any = {"color": INK, "linewidth": 0.8, "linestyle": (0, (1, 2))}
            for ax in (times, works, promises):
                ax.set_ylabel("time of leaving the reference")
                ax.axhline(study.parted, **look, label="the check leaves it")
        steps.set_ylabel("accepted steps")
        steps.set_yscale("log")
        steps.set_visible(bool(steps.lines))
        for ax in (promises, steps):
            if any(line.get_label().startswith("slope") for line in ax.lines):
                ax.legend(loc="best", fontsize=7)
        for ax, label in zip((times, works, promises, steps), _LABELS, strict=True):
            _dress(ax, label)
        handles, labels = times.get_legend_handles_labels()
        if handles:
            drawing.legend(handles, labels, loc="outside right center")
        return set_title(drawing, study.model)


def write_study_figure(folder: Path | str, study: Measurements) -> None:
    """Write a study's figure (trade.svg, trade.png) and table (trade.csv) to a folder."""
    folder, drawing = Path(folder), figure(study)
    with explain_os_errors("write", f"to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / "trade.svg", _svg(drawing))
        write_atomic(folder / "trade.png", render(drawing, "png"))
        write_atomic(folder / "trade.csv", _csv(study).encode())


def page_content(study: Measurements, label: str) -> dict[str, Any]:
    """Return the content of a page about a study; its figure as base64, with its own style."""
    above, table, below = describe_study(study)
    assert isinstance(table, Table)
    own = [place for place, point in enumerate(study.points, 1) if point.setting.label == label]
    return {
        "figure": b64encode(svg(study)).decode(),
        "above": str(above).strip().splitlines(),
        "rows": [list(row) for row in table.rows],
        "own": own,
        "below": str(below).strip().splitlines(),
    }


def svg(study: Measurements) -> bytes:
    """Return the figure as SVG."""
    return _svg(figure(study))


def _svg(drawing: Figure) -> bytes:
    from matplotlib import rc_context

    # Text not as paths: half the file size.
    with rc_context({"svg.fonttype": "none"}):
        return render(drawing, "svg")


def _csv(study: Measurements) -> str:
    kinds = list(dict.fromkeys(name for p in study.points for name in p.errors.violations))
    stream = io.StringIO()
    columns = [
        "engine", "method", "tolerance", "accuracy", "step", "impulse_tolerance", "outcome",
        "same_modes", "diverged", "parted", "error", "state", "times", "outputs", "path", "energy",
        *kinds, "seconds", "repeats", "cold", "steps", "evaluations", "flows", "kept",
    ]  # fmt: skip
    writer = csv.DictWriter(stream, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for point in to_dict(study)["points"]:
        errors = point["errors"]
        writer.writerow({**errors["violations"], **errors, **point["setting"], **point})
    return stream.getvalue()


class _LineStyle(NamedTuple):
    """Colour and marker of a family."""

    colour: str
    marker: str


def _dress(ax: Axes, label: str) -> None:
    from matplotlib.ticker import LogLocator, NullLocator

    ax.set_xscale("log")
    ax.set_xlabel(label)
    ax.xaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_minor_locator(NullLocator())
    for axis in (ax.xaxis, ax.yaxis):
        low, high = axis.get_data_interval()
        if axis.get_scale() == "log" and 0.0 < low < high < _SHORT * low:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter("{x:g}")
    frame(ax)


def _work(point: Point) -> float:
    count = point.steps if point.setting.step else point.evaluations
    return float(count) if count else math.nan


def _height(study: Measurements, point: Point) -> float:
    found = study.error(point) if study.parted is None else point.parted
    return math.nan if found is None else found


def _draw(
    ax: Axes,
    points: Sequence[Point],
    places: Sequence[float],
    heights: Sequence[float],
    line_style: _LineStyle,
    family: str = "",
) -> None:
    ax.plot(places, heights, color=line_style.colour, linewidth=0.8, alpha=0.6)
    table = np.array([places, heights], dtype=float)
    same_modes = np.array([point.same_modes for point in points])
    for same in (True, False):
        chosen = table[:, (same_modes == same) & np.isfinite(table).all(axis=0)]
        label = family if same or not family else f"{family}, other modes"
        look: Any = {"color": line_style.colour, "markersize": 5, "label": label}
        fill = line_style.colour if same else "white"
        if chosen.size:
            ax.plot(*chosen, line_style.marker, markerfacecolor=fill, **look)


def _front(ax: Axes, study: Measurements, *, once: bool) -> None:
    front = study.front(once=once)
    costs, heights = [p.cost(once=once) for p in front], [_height(study, p) for p in front]
    dashes, label = ((1, 1.5), "front, cold (dots)") if once else ((3, 2), "front, warm")
    look: Any = {"color": INK, "linewidth": 0.9, "linestyle": (0, dashes), "label": label}
    ax.step(costs, heights, where="post", **look)


def _slope(ax: Axes, study: Measurements, slope: Slope, colour: str) -> None:
    """Draw a fitted line over its points, its slope in the legend."""
    x, y = np.log(np.array(points_to_fit(study, slope.family, slope.of))).T
    ends = np.array([x.min(), x.max()])
    line = np.exp(y.mean() + slope.slope * (ends - x.mean()))
    ends = np.exp(ends)
    label = f"slope {slope.slope:.2f}"
    ax.plot(ends, line, color=colour, linewidth=1.2, linestyle=(0, (4, 2)), label=label)
