"""Figure of a sweep: lines over one parameter, maps over two, coloured by sequences of modes.

Lines join neighbours with the same sequence of modes, since outputs may jump elsewhere. A list is
drawn as points: a bifurcation diagram.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Bools
from statechart.errors import DeclarationError
from statechart.palette import LINES
from statechart.reporting.figure import STYLE, frame, frame_bands, set_title
from statechart.sweeps.cells import SUCCEEDED
from statechart.sweeps.mode_sequences import shorten_alike
from statechart.sweeps.plan import Plan

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

_MAX_COLOURS = 12  # sequences of modes; the rest share one
# Okabe and Ito (2008), then Tol (2021): light enough for labels.
_COLOURS = (
    "#56B4E9", "#E69F00", "#009E73", "#CC79A7", "#F0E442", "#0072B2",
    "#D55E00", "#882255", "#999933", "#AA4499", "#332288", "#117733",
)  # fmt: skip
_OTHERS, _NOTHING, _BLANK = "#BBBBBB", "#FFFFFF", "#E6E6E6"
_FAILED: Any = {"hatch": "////", "facecolor": _NOTHING, "edgecolor": _OTHERS}
# A second axis of at most _FEW values is drawn as lines if the first has _DENSER times as many.
_FEW, _DENSER = 7, 3
_WIDTH = 7.6  # inches
_WIDE = 5.0  # ratio of the largest to the least value of a logarithmic axis
_LETTER, _HANDLE = 0.058, 0.6  # of a legend; widths in inches


def check_drawable(plan: Plan) -> None:
    """Raise `DeclarationError` unless a sweep varies one or two parameters."""
    varied = _varied(plan)
    if len(varied) not in (1, 2):
        fewer = "vary fewer, or draw what -o FILE.nc keeps"
        message = f"a picture shows one or two parameters, not {len(varied)}"
        raise DeclarationError(message, advice=fewer if varied else "give one several values")


def _varied(plan: Plan) -> list[str]:
    return [name for name, column in plan.columns.items() if len(np.unique(column)) > 1]


def figure(plan: Plan, data: xr.Dataset) -> Figure:
    """Draw a sweep over one or two parameters."""
    from matplotlib import rc_context

    check_drawable(plan)
    with rc_context(STYLE):
        cells = _Cells(plan, data)
        if len(cells.names) < 2:
            return _lines(plan, data, cells)
        few, many = sorted(len(np.unique(column)) for column in cells.columns)
        if plan.grid and few <= _FEW and many >= _DENSER * few:
            return _lines(plan, data, cells)
        return _maps(plan, data, cells)


class _Cells:
    """Cells of a sweep as flat arrays (n,).

    `columns` are values of the parameters that vary; `good` cells reached a declared end, `done`
    cells were run. `modes` are codes of their sequences, `kinds` places among `labels` and
    `colours` by decreasing frequency, -1 for none.
    """

    def __init__(self, plan: Plan, data: xr.Dataset) -> None:
        columns = plan.columns.values()
        cells = np.meshgrid(*columns, indexing="ij") if plan.grid else columns
        values = dict(zip(plan.columns, cells, strict=True))
        self.names = _varied(plan)
        self.columns: list[Array] = [values[name].ravel() for name in self.names]
        outcome = data["outcome"].to_numpy().ravel().astype(object)
        self.modes: NDArray[np.int32] = data["modes"].to_numpy().ravel()
        texts = data["sequence"].to_numpy()
        self.good: Bools = np.isin(outcome.astype(str), SUCCEEDED)
        self.done: Bools = outcome != ""
        codes, counts = np.unique(self.modes[self.good], return_counts=True)
        order = codes[np.argsort(-counts, kind="stable")]
        shown = order if len(order) <= _MAX_COLOURS else order[: _MAX_COLOURS - 1]
        places = np.full(len(texts) + 1, len(shown), dtype=np.int64)
        places[shown] = np.arange(len(shown))
        self.labels = shorten_alike([str(texts[code]) for code in shown])
        self.colours = list(_COLOURS[: len(shown)])
        if len(order) > len(shown):
            self.labels.append(f"others ({len(order) - len(shown)})")
            self.colours.append(_OTHERS)
        self.kinds = np.where(self.good, places[self.modes], -1)

    def handles(self, *, grid: bool = True, blank: bool = False) -> list[Patch | Line2D]:
        """Return the legend entries of modes, failed cells, and cells without a value."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        found: list[Patch | Line2D] = [
            Patch(facecolor=colour, label=label)
            for label, colour in zip(self.labels, self.colours, strict=True)
        ]
        if (self.done & ~self.good).any():
            cross = Line2D([], [], color=_OTHERS, marker="x", linestyle="", label="failed")
            found.append(Patch(**_FAILED, label="failed") if grid else cross)
        if blank or not self.done.all():
            found.append(Patch(facecolor=_BLANK, label="no value"))
        return found


def _legend_columns(cells: _Cells, width: float, most: int) -> int:
    longest = _HANDLE + _LETTER * max(map(len, cells.labels), default=0)
    return int(np.clip(width / longest, 1, most))


@dataclass(frozen=True, eq=False)
class _Axis:
    """An axis of a parameter; `at` are the values of the cells, or ranks if one is infinite."""

    name: str
    at: Array
    log: bool
    labels: tuple[str, ...]

    @classmethod
    def of(cls, name: str, column: Array) -> _Axis:
        values, ranks = np.unique(column, return_inverse=True)
        if not np.isfinite(values).all():
            return cls(name, ranks.astype(float), False, tuple(f"{v:.4g}" for v in values))
        log = bool(values[0] > 0.0 and values[-1] > _WIDE * values[0])
        if log and len(values) > 2:
            # The more evenly spaced of the values and their logarithms.
            log = _unevenness(np.log(values)) < _unevenness(values)
        return cls(name, column, log, ())

    def edges(self) -> Array:
        """Return the edges (m + 1,) of the bands around its m places."""
        places = np.unique(self.at)
        places = np.log(places) if self.log else places
        middles = 0.5 * (places[1:] + places[:-1])
        ends = [2.0 * places[0] - middles[0]], [2.0 * places[-1] - middles[-1]]
        edges = np.concatenate([ends[0], middles, ends[1]])
        return np.exp(edges) if self.log else edges

    def put(self, ax: Axes, which: str) -> None:
        """Label and scale the axis `which`, x or y."""
        if self.log:
            ax.set(**{f"{which}scale": "log"})
        if self.labels:
            ax.set(**{f"{which}ticks": range(len(self.labels)), f"{which}ticklabels": self.labels})
        ax.set(**{f"{which}label": self.name})


def _unevenness(values: Array) -> float:
    steps = np.diff(values)
    return float(np.std(steps) / np.mean(steps))


def _lines(plan: Plan, data: xr.Dataset, cells: _Cells) -> Figure:
    """Draw outputs over the parameter with most values, one colour per value of the other."""
    from matplotlib.figure import Figure

    axis = int(np.argmax([len(np.unique(column)) for column in cells.columns]))
    x = _Axis.of(plan.entitled(cells.names[axis]), cells.columns[axis])
    alone = len(cells.names) == 1
    other = np.zeros(len(x.at)) if alone else cells.columns[1 - axis]
    count = len(plan.task.outputs)
    heights = [2.4 if count == 1 else 1.5] * count + ([0.3] if alone else [])
    columns = _legend_columns(cells, _WIDTH, 2)
    legend = 0.18 * math.ceil(len(cells.labels) / columns) if alone else 0.0
    size = (_WIDTH, 1.0 + 1.25 * sum(heights) + legend)
    drawing = Figure(figsize=size, layout="constrained")
    axes = drawing.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    for ax, name in zip(axes[:, 0], plan.task.outputs, strict=False):
        values = data[plan.variables[name]].to_numpy()
        for value, colour in zip(np.unique(other), cycle(LINES), strict=False):
            chosen = np.flatnonzero((other == value) & cells.good)
            chosen = chosen[np.argsort(x.at[chosen], kind="stable")]
            if name in plan.lists:
                _points(ax, x.at[chosen], values.reshape(len(x.at), -1)[chosen], colour)
            else:
                _join_cells(ax, x.at[chosen], values.ravel()[chosen], cells.modes[chosen], colour)
        if (values[np.isfinite(values)] % 1.0 == 0.0).all():  # counts
            ax.locator_params(axis="y", integer=True)
        ax.set_ylabel(plan.entitled(name))
        frame(ax)
    x.put(axes[-1, 0], "x")
    if alone:
        _band(axes[-1, 0], x, cells)
        drawing.legend(handles=cells.handles(), loc="outside lower left", ncols=columns)
    else:
        from matplotlib.lines import Line2D

        name = cells.names[1 - axis]
        handles = [
            Line2D([], [], color=colour, label=f"{name} = {value:.4g}")
            for value, colour in zip(np.unique(other), cycle(LINES), strict=False)
        ]
        drawing.legend(handles=handles, loc="outside right upper", handlelength=1.4)
    return set_title(drawing, plan.model.name)


def _join_cells(ax: Axes, x: Array, y: Array, modes: NDArray[np.int32], colour: str) -> None:
    """Join neighbours with the same modes; other cells are dots."""
    here = np.isfinite(y)
    joins = (modes[1:] == modes[:-1]) & here[1:] & here[:-1]
    breaks = np.flatnonzero(~joins) + 1
    ax.plot(np.insert(x, breaks, math.nan), np.insert(y, breaks, math.nan), color=colour)
    lonely = here & ~np.append(joins, False) & ~np.insert(joins, 0, False)
    ax.plot(x[lonely], y[lonely], ".", markersize=3, color=colour)


def _points(ax: Axes, x: Array, lists: Array, colour: str) -> None:
    places = np.broadcast_to(x[:, None], lists.shape)
    known = np.isfinite(lists)
    size = float(np.clip(2e2 / np.sqrt(np.count_nonzero(known) + 1.0), 0.6, 4.0))
    look: Any = {"markersize": size, "markeredgewidth": 0.0, "rasterized": True}
    ax.plot(places[known], lists[known], ".", color=colour, **look)


def _band(ax: Axes, x: _Axis, cells: _Cells) -> None:
    edges, places = x.edges(), np.searchsorted(np.unique(x.at), x.at)
    for kind, colour in enumerate(cells.colours):
        mine = np.unique(places[cells.kinds == kind])
        # One bar for neighbours: seams between them would show.
        alike = np.split(mine, np.flatnonzero(np.diff(mine) > 1) + 1) if len(mine) else []
        stretches = [(edges[k[0]], edges[k[-1] + 1] - edges[k[0]]) for k in alike]
        ax.broken_barh(stretches, (0.0, 1.0), facecolors=colour, linewidth=0.0)
    for k in np.unique(places[cells.done & ~cells.good]):
        ax.axvspan(edges[k], edges[k + 1], **_FAILED)
    ax.set_ylim(0.0, 1.0)
    ax.set_yticks([0.5], ["modes"])
    ax.set_xlim(edges[0], edges[-1])
    frame_bands(ax)


def _maps(plan: Plan, data: xr.Dataset, cells: _Cells) -> Figure:
    """Draw a map of every output (the length of a list), and one of the modes."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

    titles = map(plan.entitled, cells.names)
    x, y = (_Axis.of(*pair) for pair in zip(titles, cells.columns, strict=True))
    outputs = list(plan.task.outputs)
    count = len(outputs) + 1
    columns = min(count, 3 if count > 4 else 2)
    rows = math.ceil(count / columns)
    drawing = Figure(figsize=(max(4.0 * columns, 6.0), 3.3 * rows), layout="constrained")
    axes = drawing.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    blank = False
    for ax, name in zip(axes, outputs, strict=False):
        variable, title = plan.variables[name], plan.entitled(name)
        if name in plan.lists:
            variable, title = f"{variable}_count", f"number of {name}"
        values = np.where(cells.good, data[variable].to_numpy().ravel(), math.nan)
        blank = blank or bool((np.isnan(values) & cells.good).any())
        drawing.colorbar(_map(ax, x, y, values, plan, cells, cmap="viridis"), ax=ax, pad=0.02)
        ax.set_title(title, fontsize=9)
    ax = axes[len(outputs)]
    colours = ListedColormap(cells.colours or [_NOTHING])
    kinds = np.where(cells.kinds >= 0, cells.kinds, math.nan)
    limits = {"vmin": -0.5, "vmax": max(len(cells.colours), 1) - 0.5}
    _map(ax, x, y, kinds, plan, cells, cmap=colours, **limits)
    ax.set_title("modes", fontsize=9)
    for ax in axes[count:]:
        ax.set_visible(False)
    # Axes are shared: those below nothing that is shown have labels.
    for k, ax in enumerate(axes[:count]):
        x.put(ax, "x")
        y.put(ax, "y")
        ax.xaxis.label.set_visible(k + columns >= count)
        ax.yaxis.label.set_visible(k % columns == 0)
        ax.tick_params(labelbottom=k + columns >= count)
    drawing.legend(
        handles=cells.handles(grid=plan.grid, blank=blank),
        loc="outside lower center",
        ncols=_legend_columns(cells, drawing.get_figwidth(), 3 if columns > 2 else 2),
    )
    return set_title(drawing, plan.model.name)


def _map(
    ax: Axes, x: _Axis, y: _Axis, values: Array, plan: Plan, cells: _Cells, **options: Any
) -> Any:
    """Draw a value per cell as a colour; failed cells are hatched."""
    ax.set_facecolor(_BLANK if plan.grid else _NOTHING)
    if not plan.grid:
        size = float(np.clip(4e3 / len(values), 2.0, 40.0))
        failed, blank = cells.done & ~cells.good, np.isnan(values) & (cells.good | ~cells.done)
        ax.scatter(x.at[failed], y.at[failed], size, color=_OTHERS, marker="x", linewidths=0.6)
        ax.scatter(x.at[blank], y.at[blank], size, color=_BLANK, linewidths=0.0)
        return ax.scatter(x.at, y.at, size, values, linewidths=0.0, rasterized=True, **options)
    shape = len(np.unique(y.at)), len(np.unique(x.at))
    order = np.lexsort((x.at, y.at))
    bad = (cells.done & ~cells.good)[order].reshape(shape)
    if bad.any():
        table = np.where(bad, 0.0, math.nan)
        look: Any = {**_FAILED, "linewidth": 0.0, "cmap": "Greys"}
        ax.pcolor(x.edges(), y.edges(), table, **look)
    table = values[order].reshape(shape)
    return ax.pcolormesh(x.edges(), y.edges(), table, rasterized=True, **options)
