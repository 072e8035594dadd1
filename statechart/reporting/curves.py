"""Selection of the curves of a run, their panels, and decimation of many points."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Trace
from statechart.documents.declaration import TIME
from statechart.documents.quantities import axis_label, unit_of, unit_suffix
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples

# Columns of a figure, more than screens and prints resolve.
COLUMNS = 2000
# A curve with more points per column is drawn by the minimum and maximum of each column.
_DENSE = 10
MAX_CURVES = 5
"""Curves of a panel."""

_MAX_FORCES = 3
# Sizes of one order of magnitude count as equal.
_SAME_SCALE = 0.1
_MAX_NAMED = 2  # names in a remark
_MAX_PANELS = 4
# A curve below this fraction of the largest value is round-off.
_ROUND_OFF = 1e-9
# A velocity below this many impulse residuals is round-off.
_VELOCITY_RESIDUALS = 10.0
# A force below this many force tolerances is round-off.
_FORCE_TOLERANCES = 10.0
# A curve that changes by less than this fraction of its range is constant.
_CONSTANT = 2e-3
# Fraction of a run shown after the last change; a cut saves at least the second fraction.
REST, _SAVED = 0.08, 0.25
_STATES = {"length": "position", "angle": "angle"}
_STATES |= {"length/time": "velocity", "angle/time": "angular velocity"}
_OTHER_STATES = ("coordinate", "rate", "memory")
_ORDER = ("position", "coordinate", "angle", "velocity", "rate", "angular velocity", "memory")


@dataclass(frozen=True)
class Panel:
    """Curves that share an axis."""

    title: str
    names: tuple[str, ...]  # columns drawn
    unit: str = ""
    left_out: tuple[str, ...] = ()  # columns not drawn
    zero: tuple[str, ...] = ()  # columns that are zero throughout
    cone: tuple[str, float | Array] | None = None  # normal force and friction coefficient
    impulses: tuple[str, ...] = ()  # regions whose impulses are marked
    impulse_unit: str = ""

    @property
    def label(self) -> str:
        """Label of the axis."""
        return axis_label(self.title, self.unit)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on the columns that are not drawn."""
        return remarks({"not drawn": self.left_out, "0 all along": self.zero})


def remarks(names: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
    """Return remarks with the first names and the number of the others."""
    texts = []
    for remark, those in names.items():
        more = len(those) - _MAX_NAMED
        shown = [*those[:_MAX_NAMED], *([f"{more} more"] if more > 0 else [])]
        texts += [f"{remark}: {', '.join(shown)}"] if shown else []
    return tuple(texts)


def curves(observer: Observer, trace: Trace) -> tuple[Samples, list[Panel]]:
    """Return the samples of a run, and the panels that show them."""
    steps = sum(len(arc.coefficients) for arc in trace.arcs)
    samples = observer.sample(trace, per_step=min(max(4000 // max(steps, 1), 4), 64))
    samples = without_round_off(observer.automaton, trace, samples)
    states = _variable_panels(observer.automaton, samples)
    forces = _force_panels(observer.automaton, trace, samples)
    panels = [*states, *_gaps(observer.automaton, trace, samples), *forces]
    panels += _couples(observer.automaton, trace, samples)
    panels += _impulses(observer.automaton, trace, forces)
    return samples, [*panels, *_controls(observer.automaton, samples)]


def end_of_activity(trace: Trace, samples: Samples, panels: Iterable[Panel]) -> float:
    """Return the time of the last visible change plus a margin, at most the end of the run."""
    events = [jump.t for jump in trace.jumps if jump.t < trace.t_end]
    last = max(events, default=0.0)
    for panel in panels:
        names = [n for n in (*panel.names, *panel.left_out) if n in samples.columns]
        columns = [np.nan_to_num(samples.columns[n], posinf=0.0, neginf=0.0) for n in names]
        spans = [float(np.ptp(values)) for values in columns]
        widest = max(spans[: len(panel.names)], default=np.inf)
        for place, values in enumerate(columns):
            span = spans[place] if place < len(panel.names) else widest
            moving = np.flatnonzero(np.abs(values - values[-1]) > _CONSTANT * span)
            if len(moving):
                last = max(last, float(samples.t[min(moving[-1] + 1, len(values) - 1)]))
    end = (1.0 + REST) * last
    return end if 0.0 < end < (1.0 - _SAVED) * trace.t_end else trace.t_end


def largest(values: Array) -> float:
    """Return the largest finite magnitude."""
    return float(np.max(np.abs(values), initial=0.0, where=np.isfinite(values)))


def impulses_of(trace: Trace, region: str) -> tuple[Array, Array]:
    """Return the times and normal impulses of impacts in a region; see `largest_impulses`."""
    found = [(jump.t, jump.impulse[region][0]) for jump in trace.jumps if region in jump.impulse]
    times, impulses = np.array(found).reshape(-1, 2).T
    return largest_impulses(times, impulses, trace.t_end)


def impulse_label(panel: Panel, impulses: Array) -> str:
    """Return the legend of impulses on a force axis, with their maximum."""
    return f"impulse, up to {largest(impulses):.3g} {unit_suffix(panel.impulse_unit)}".rstrip()


def without_round_off(automaton: Automaton, trace: Trace, samples: Samples) -> Samples:
    """Return samples with round-off of zero replaced by zero.

    Scales of a column: the largest column of its dimension, one radian, and the velocity that
    covers the largest length during the run. Time stepping resolves velocities and angles to the
    residual of its impulses.
    """
    columns = dict(samples.columns)
    groups: dict[str, list[str]] = {}
    for name in columns:
        groups.setdefault(automaton.declaration.quantity(name).dimension, []).append(name)
    length, speed = (
        max((largest(columns[name]) for name in groups.get(dimension, ())), default=0.0)
        for dimension in ("length", "length/time")
    )
    scales = {"angle": 1.0}
    if trace.t_end > 0.0:
        turning = max(1.0 / trace.t_end, speed / length if length > 0.0 else 0.0)
        scales |= {"length/time": length / trace.t_end, "angle/time": turning}
    resolved = max(_ROUND_OFF, _VELOCITY_RESIDUALS * trace.tolerances.get("impulse", 0.0))
    for dimension, names in groups.items():
        if not dimension:
            continue
        size = max(largest(columns[name]) for name in names)
        part = resolved if dimension in ("angle", "length/time", "angle/time") else _ROUND_OFF
        round_off = part * max(size, scales.get(dimension, 0.0))
        if dimension == "force":
            round_off = max(round_off, _FORCE_TOLERANCES * trace.tolerances.get("force", 0.0))
        for name in names:
            if largest(columns[name]) <= round_off:
                columns[name] = np.where(np.isfinite(columns[name]), 0.0, columns[name])
    return replace(samples, columns=columns)


def _choose_panel(title: str, names: Sequence[str], unit: str, samples: Samples) -> Panel:
    """Return a panel of the curves with the largest range, evenly chosen if many are similar."""
    columns = {name: np.nan_to_num(samples.columns[name]) for name in names}
    round_off = _ROUND_OFF * max(map(largest, columns.values()))
    spans = {name: float(np.ptp(column)) for name, column in columns.items()}
    widest = max(spans, key=spans.__getitem__).rpartition(".")[2]
    # One quantity of many bodies, such as their heights.
    same = {name: span for name, span in spans.items() if name.rpartition(".")[2] == widest}
    drawn = _evenly_chosen(same, round_off)
    if not drawn:
        # Constant curves by their distance from zero.
        order = {n: (-m if m > round_off else 0.0, -largest(columns[n])) for n, m in spans.items()}
        drawn = sorted(names, key=order.__getitem__)[:MAX_CURVES]
    shown = tuple(name for name in names if name in drawn)
    return Panel(title, shown, unit, tuple(name for name in names if name not in drawn))


def _evenly_chosen(sizes: Mapping[str, float], round_off: float = 0.0) -> list[str]:
    """Return MAX_CURVES of more names of similar size, from first to last; else none."""
    most = max(sizes.values())
    alike = [name for name, size in sizes.items() if size >= _SAME_SCALE * most > round_off]
    if len(alike) <= MAX_CURVES:
        return []
    return [alike[round(k * (len(alike) - 1) / (MAX_CURVES - 1))] for k in range(MAX_CURVES)]


def _variable_panels(automaton: Automaton, samples: Samples) -> list[Panel]:
    """Return panels of the variables, one per quantity and unit."""
    model = automaton.declaration
    places = {symbol: k for k, symbol in enumerate(automaton.variables)}
    speeds = {places[rate] for rate in automaton.rates if rate in places}
    variables = {k for k, rate in enumerate(automaton.rates) if rate in places}
    few = len(automaton.names) < _MAX_PANELS
    groups: dict[tuple[str, str], list[str]] = {}
    for k, name in enumerate(automaton.names):
        if name in model.timers:
            continue
        dimension, unit = model.quantity(name).dimension, model.unit(name)
        title = _STATES.get(dimension, "")
        if not title and speeds:
            title = _OTHER_STATES[0 if k in variables else 1 if k in speeds else 2]
        elif not title:
            # Variables without dimensions: few get a panel each, since units may differ.
            title = name if few else "variables"
        groups.setdefault((title, unit), []).append(name)
    ordered = sorted(groups, key=lambda g: _ORDER.index(g[0]) if g[0] in _ORDER else len(_ORDER))
    panels = [_choose_panel(title, groups[title, unit], unit, samples) for title, unit in ordered]
    # The last nonzero panel lists the columns of the zero panels.
    nonzero = [p for p in panels if any(largest(samples.columns[name]) > 0.0 for name in p.names)]
    nonzero = nonzero or panels[:1]
    zero = tuple(n for p in panels if p not in nonzero for n in (*p.names, *p.left_out))
    return [*nonzero[:-1], replace(nonzero[-1], zero=zero)] if nonzero else []


def _gaps(automaton: Automaton, trace: Trace, samples: Samples) -> list[Panel]:
    columns, model = samples.columns, automaton.declaration
    lengths = [n for n in automaton.names if model.quantity(n).dimension == "length"]
    scale = max((largest(columns[name]) for name in lengths or automaton.names), default=0.0)
    names = []
    for region in trace.regions:
        gap = columns.get(f"{region}.gap")
        # Skipped: zero throughout, or equal to a variable drawn already.
        if gap is not None and largest(gap) > _ROUND_OFF * scale:
            others = (largest(gap - columns[name]) for name in automaton.names)
            if min(others, default=np.inf) > _ROUND_OFF * scale:
                names.append(f"{region}.gap")
    if not names:
        return []
    changing = set[str]()
    for jump in trace.jumps:
        states = zip(trace.regions, jump.source, jump.target, strict=True)
        changing |= {f"{region}.gap" for region, source, target in states if source != target}
    active = [name for name in names if name in changing]
    active = active if active and len(names) > MAX_CURVES else names
    panel = _choose_panel("gap", active, model.unit(names[0]), samples)
    idle = tuple(name for name in names if name not in active)
    return [replace(panel, left_out=(*panel.left_out, *idle))]


def _force_panels(automaton: Automaton, trace: Trace, samples: Samples) -> list[Panel]:
    """Return panels of contact forces with their friction cones, at most _MAX_FORCES."""
    columns, model = samples.columns, automaton.declaration
    struck = {region for jump in trace.jumps for region in jump.impulse}
    panels = []
    for region in trace.regions:
        normal, tangential = f"{region}.V", f"{region}.H"
        if not (normal in columns and largest(columns[normal]) > 0.0):
            continue
        # States of regions may set the coefficient.
        friction = columns.get(f"{region}.friction")
        if friction is None:
            friction = np.array(trace.parameters.get(f"{region}.friction", 0.0))
        drawable = np.where((friction > 0.0) & (friction < np.inf), friction, np.nan)
        cone = None if np.isnan(drawable).all() else (normal, drawable)
        slanted = tangential in columns and largest(columns[tangential]) > 0.0
        drawn = (normal, tangential) if slanted else (normal,)
        marked = (region,) if region in struck else ()
        panel = Panel("force", drawn, model.unit(normal), cone=cone, impulses=marked)
        panels.append(replace(panel, impulse_unit=unit_of("impulse", model.units)))
    first, others = panels[:_MAX_FORCES], panels[_MAX_FORCES:]
    if others:
        left_out = tuple(name for panel in others for name in panel.names)
        first[-1] = replace(first[-1], left_out=left_out)
    return first


def _couples(automaton: Automaton, trace: Trace, samples: Samples) -> list[Panel]:
    """Return panels of the couples, and the forces along guides, of couplings."""
    model, groups = automaton.declaration, dict[tuple[str, str], list[str]]()
    for name in (f"{region}.M" for region in trace.regions):
        if name in samples.columns and largest(samples.columns[name]) > 0.0:
            key = model.quantity(name).dimension, model.unit(name)
            groups.setdefault(key, []).append(name)
    return [_choose_panel(title, group, unit, samples) for (title, unit), group in groups.items()]


def _impulses(automaton: Automaton, trace: Trace, forces: Sequence[Panel]) -> list[Panel]:
    drawn = {name.rpartition(".")[0] for panel in forces for name in panel.names}
    most: dict[str, float] = {}
    for jump in trace.jumps:
        for region, (normal, _) in jump.impulse.items():
            if region not in drawn:
                most[region] = max(most.get(region, 0.0), abs(normal))
    if not any(most.values()):
        return []
    ordered = {region: most[region] for region in trace.regions if region in most}
    chosen = _evenly_chosen(ordered) or sorted(most, key=lambda r: -most[r])[:MAX_CURVES]
    marked = tuple(region for region in trace.regions if region in chosen)
    left_out = tuple(region for region in trace.regions if region in most and region not in chosen)
    unit = unit_of("impulse", automaton.declaration.units)
    return [Panel("impulse", (), unit, left_out, impulses=marked)]


def _controls(automaton: Automaton, samples: Samples) -> list[Panel]:
    # Coefficients of contacts are drawn as friction cones.
    observed = automaton.observables.items()
    controls = (name for name, expression in observed if expression in automaton.controls)
    names = [name for name in controls if "." not in name and name != TIME]
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(automaton.declaration.unit(name), []).append(name)
    return [_choose_panel("control", group, unit, samples) for unit, group in groups.items()]


@dataclass(frozen=True, eq=False)
class DrawnCurve:
    """Polyline of samples, with breaks at jumps."""

    times: Array  # (m,), NaN at breaks
    _begins: NDArray[np.intp] | None
    _breaks: NDArray[np.intp]

    @classmethod
    def of(cls, samples: Samples) -> DrawnCurve:
        """Return the polyline; for many samples or jumps, the least and largest of each column."""
        t, jumped = samples.t, np.flatnonzero(np.diff(samples.j)) + 1
        if len(t) <= _DENSE * COLUMNS and len(jumped) <= COLUMNS:
            return cls(np.insert(t, jumped, np.nan), None, jumped)
        edges = np.linspace(t[0], t[-1], COLUMNS + 1)[:-1]
        begins = np.unique(np.searchsorted(t, edges))
        if len(jumped) <= COLUMNS:
            begins = np.union1d(begins, jumped)
        # Two points per column. More jumps than columns are not drawn as breaks.
        breaks = 2 * np.flatnonzero(np.isin(begins, jumped))
        return cls(np.insert(np.repeat(t[begins], 2), breaks, np.nan), begins, breaks)

    def values(self, column: Array) -> Array:
        """Return the values (m,) of a column of the samples."""
        if self._begins is not None:
            low = np.fmin.reduceat(column, self._begins)
            column = np.column_stack([low, np.fmax.reduceat(column, self._begins)]).ravel()
        return np.insert(column, self._breaks, np.nan)


def largest_impulses(times: Array, sizes: Array, end: float) -> tuple[Array, Array]:
    """Return events and their sizes, of many the largest in each column of the figure."""
    if len(times) <= COLUMNS:
        return times, sizes
    column = np.minimum((times * (COLUMNS / end)).astype(np.intp), COLUMNS - 1)
    order = np.lexsort((-np.abs(sizes), column))
    chosen = order[np.flatnonzero(np.diff(column[order], prepend=-1))]
    return times[chosen], sizes[chosen]
