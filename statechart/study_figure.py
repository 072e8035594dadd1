"""A study as a picture: error against time and against evaluations, both logarithmic."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from statechart.errors import StatechartError
from statechart.figure import LINES, STYLE, render
from statechart.files import write_atomic
from statechart.study import Point, Slope, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["figure", "write"]

_MARKERS = "osD^vPX"
_INK, _GRID = "#333333", "#E6E6E6"


def figure(study: Study) -> Figure:
    """Draw a study.

    Left, errors against the time of a run, with the Pareto front; right, against evaluations of
    the rates (steps, where the step is fixed), with the slopes that were fitted. Hollow: the run
    took other modes than the reference. Where the motion is chaotic, the time at which runs leave
    the reference stands in the place of errors.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        drawing = Figure(figsize=(9.0, 4.2), layout="constrained")
        left, right = drawing.subplots(1, 2, sharey=True)
        families = list(dict.fromkeys(p.setting.family for p in study.points))
        for place, family in enumerate(families):
            colour, marker = LINES[place % len(LINES)], _MARKERS[place % len(_MARKERS)]
            points = [p for p in study.points if p.setting.family == family]
            _draw(left, study, points, [p.seconds for p in points], colour, marker, family)
            _draw(right, study, points, [_work(p) for p in points], colour, marker, family)
        if study.parted is None:
            _front(left, study)
            for slope in study.slopes():
                colour = LINES[families.index(slope.family) % len(LINES)]
                _slope(right, study, slope, colour)
            left.set_ylabel("relative error")
            resolution = study.resolution.largest
            for ax in (left, right):
                ax.set_yscale("log")
                if resolution:
                    ax.axhspan(resolution / 10.0, resolution, color=_GRID, zorder=0)
        else:
            left.set_ylabel("time at which the run leaves the reference")
            for ax in (left, right):
                ax.axhline(study.parted, color=_INK, linewidth=0.8, linestyle=(0, (1, 2)))
        for ax, label in (
            (left, "time of a run, s"),
            (right, "evaluations of the rates (impulse: steps)"),
        ):
            ax.set_xscale("log")
            ax.set_xlabel(label)
            ax.grid(visible=True, color=_GRID, linewidth=0.6)
            ax.set_axisbelow(True)
            for side in ("top", "right"):
                ax.spines[side].set_visible(False)
        handles, labels = left.get_legend_handles_labels()
        if handles:
            drawing.legend(handles, labels, loc="outside right center")
        drawing.suptitle(study.model, x=0.01, ha="left", fontsize=10, fontweight="bold")
    return drawing


def write(folder: Path | str, study: Study) -> None:
    """Write a study's figure (trade.svg, trade.png) and table (trade.csv) to a folder.

    Raises
    ------
    StatechartError
        If they cannot be written.
    """
    folder = Path(folder)
    drawing = figure(study)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for kind in ("svg", "png"):
            write_atomic(folder / f"trade.{kind}", render(drawing, kind))
        write_atomic(folder / "trade.csv", _csv(study).encode())
    except OSError as error:
        raise StatechartError(f"cannot write to {folder}: {error.strerror or error}") from error


def _csv(study: Study) -> str:
    """Return one row per point."""
    kinds = list(dict.fromkeys(name for p in study.points for name in p.errors.violations))
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(
        ["engine", "method", "tolerance", "accuracy", "step", "outcome", "same_modes", "diverged",
         "parted", "error", "state", "times", "outputs", "energy", *kinds, "seconds", "repeats",
         "compiling", "steps", "evaluations", "kept"]
    )  # fmt: skip
    for p in study.points:
        s, e = p.setting, p.errors
        writer.writerow(
            [s.engine, s.method, s.tolerance, s.accuracy, s.step, p.outcome, p.same_modes,
             p.diverged, p.parted, study.error(p), e.state, e.times, e.outputs, e.energy,
             *(e.violations.get(name) for name in kinds), p.seconds, p.repeats, p.compiling,
             p.steps, p.evaluations, study.kept(p)]
        )  # fmt: skip
    return stream.getvalue()


def _work(point: Point) -> float:
    """Return evaluations; steps, where they are fixed; not a number where neither is counted."""
    count = point.steps if point.setting.step else point.evaluations
    return float(count) if count else math.nan


def _height(study: Study, point: Point) -> float:
    found = study.error(point) if study.parted is None else point.parted
    return math.nan if found is None else found


def _draw(
    ax: Axes,
    study: Study,
    points: Sequence[Point],
    costs: Sequence[float],
    colour: str,
    marker: str,
    family: str,
) -> None:
    heights = [_height(study, point) for point in points]
    ax.plot(costs, heights, color=colour, linewidth=0.8, alpha=0.6)
    for same in (True, False):
        chosen = [
            (cost, height)
            for point, cost, height in zip(points, costs, heights, strict=True)
            if point.same_modes is same and math.isfinite(cost) and math.isfinite(height)
        ]
        if chosen:
            ax.plot(
                *zip(*chosen, strict=True),
                marker,
                markersize=5,
                color=colour,
                markerfacecolor=colour if same else "white",
                label=family if same else f"{family}, other modes",
            )


def _front(ax: Axes, study: Study) -> None:
    front = study.front()
    ax.step(
        [point.seconds for point in front],
        [_height(study, point) for point in front],
        where="post",
        color=_INK,
        linewidth=0.9,
        linestyle=(0, (3, 2)),
        label="Pareto front",
    )


def _slope(ax: Axes, study: Study, slope: Slope, colour: str) -> None:
    """Draw the line of a fitted order beside the points of its family, with its number."""
    points = [
        (_work(p), _height(study, p))
        for p in study.points
        if p.setting.family == slope.family and p.same_modes
    ]
    works = np.array([w for w, h in points if math.isfinite(w) and math.isfinite(h)])
    heights = np.array([h for w, h in points if math.isfinite(w) and math.isfinite(h)])
    middle = len(works) // 2
    span = np.array([works.min(), works.max()])
    line = heights[middle] * (span / works[middle]) ** -slope.order
    inside = np.clip(line, heights.min(), heights.max())
    ends = works[middle] * (inside / heights[middle]) ** (-1.0 / slope.order)
    ax.plot(ends, inside, color=colour, linewidth=0.9, linestyle=(0, (4, 2)))
    ax.annotate(
        f"{slope.order:.1f}",
        (ends[1], inside[1]),
        textcoords="offset points",
        xytext=(4, 2),
        color=colour,
        fontsize=8,
    )
