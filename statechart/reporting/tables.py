"""Runs as tables and data sets, in memory and on disk."""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.automaton.trace import Trace
from statechart.documents.declaration import TIME
from statechart.documents.files import explain_os_errors, staging_folder, write_atomic
from statechart.documents.quantities import unit_of
from statechart.documents.setting import Record
from statechart.errors import StatechartError
from statechart.observation.observer import Observer
from statechart.observation.sampling import Samples
from statechart.reporting.partial_report import PartialReport, short_length
from statechart.reporting.report import dumps

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

RESERVED = frozenset(
    {"byte", "char", "short", "ushort", "int", "uint", "int64", "uint64", "float", "real"}
    | {"double", "bool", "string"}
)
"""Names reserved by NetCDF."""

_TAKEN = RESERVED | {"t", "j", "mode", "sample", "event"}
_FILES = ("run.json", "trace.nc", "events.csv", "samples.csv", "figure.svg", "figure.png")
_ADVICE = "nothing was written; name a writable folder on a disk with space"
_ROWS = 8  # per step of the integrator


def samples_table(observer: Observer, trace: Trace) -> pd.DataFrame:
    """Return a run as a table: t, j, mode, then every variable and observable.

    Both ends of an arc have a row, so a jump gives two rows of one time.
    """
    return _table(observer, observer.sample(trace, per_step=_rows_of(trace)))


def _table(observer: Observer, samples: Samples) -> pd.DataFrame:
    import pandas as pd

    names = _columns(samples.columns)
    modes = pd.Categorical.from_codes(samples.mode, _labels(observer, samples))
    columns = {names[name]: values for name, values in samples.columns.items()}
    table = pd.DataFrame({"t": samples.t, "j": samples.j, "mode": modes, **columns})
    model = observer.automaton.declaration
    table.attrs["units"] = _without_empty(
        {"t": model.unit(TIME), **{names[n]: model.unit(n) for n in samples.columns}}
    )
    table.attrs["long_names"] = {names[n]: model.quantity(n).words for n in samples.columns}
    return table


def events_table(observer: Observer, trace: Trace) -> pd.DataFrame:
    """Return the jumps of a run as a table, one row each.

    Columns: t, j, region, cause, source, target, skipped, the impulses `X.normal` and
    `X.tangential` of regions X, `energy before` and `energy after`, and `X before` and `X` of every
    variable X. Units are in `attrs`.
    """
    import pandas as pd

    label, jumps = cache(observer.automaton.label), trace.jumps
    columns: dict[str, Any] = {
        "t": np.array([jump.t for jump in jumps]),
        "j": np.array([jump.j for jump in jumps], dtype=np.int64),
        "region": [jump.region for jump in jumps],
        "cause": [jump.cause for jump in jumps],
        "source": [label(jump.source) for jump in jumps],
        "target": [label(jump.target) for jump in jumps],
        "skipped": np.array([jump.skipped for jump in jumps]),
    }
    none = (np.nan, np.nan)
    model = observer.automaton.declaration
    impulse, energy = unit_of("impulse", model.units), model.unit("energy")
    units = {"t": model.unit(TIME), "skipped": model.unit(TIME)}
    for region in trace.regions:
        if any(region in jump.impulse for jump in jumps):
            pairs = np.array([jump.impulse.get(region, none) for jump in jumps])
            named = {f"{region}.normal": pairs[:, 0], f"{region}.tangential": pairs[:, 1]}
            columns, units = columns | named, units | dict.fromkeys(named, impulse)
    if any(jump.energy is not None for jump in jumps):
        pairs = np.array([jump.energy or none for jump in jumps])
        named = {"energy before": pairs[:, 0], "energy after": pairs[:, 1]}
        columns, units = columns | named, units | dict.fromkeys(named, energy)
    for k, name in enumerate(trace.variables):
        after = name if name not in columns else f"{name} after"
        columns[f"{name} before"] = np.array([jump.before[k] for jump in jumps])
        columns[after] = np.array([jump.after[k] for jump in jumps])
        units |= dict.fromkeys((f"{name} before", after), model.unit(name))
    table = pd.DataFrame(columns)
    table.attrs["units"] = _without_empty(units)
    return table


def to_xarray(observer: Observer, trace: Trace) -> xr.Dataset:
    """Return a run as a data set that NetCDF can store."""
    return _data_set(observer, trace, observer.sample(trace, per_step=_rows_of(trace)))


def _data_set(observer: Observer, trace: Trace, samples: Samples) -> xr.Dataset:
    import xarray as xr

    names = _columns(samples.columns)
    labels = np.array(_labels(observer, samples), dtype=np.str_)
    model = observer.automaton.declaration
    data: dict[str, Any] = {
        names[name]: ("sample", values, _attributes(observer, name))
        for name, values in samples.columns.items()
    }
    coordinates: dict[str, Any] = {
        "t": ("sample", samples.t, {"long_name": "time", **_unit(model.unit(TIME))}),
        # NetCDF 3 has no 64-bit integers.
        "j": ("sample", samples.j.astype(np.int32), {"long_name": "number of jumps before"}),
        "mode": ("sample", labels[samples.mode], {"long_name": "mode"}),
    }
    events = events_table(observer, trace)
    for name, column in events.items():
        values = column.to_numpy()
        if values.dtype == np.int64:
            values = values.astype(np.int32)
        elif values.dtype != np.float64:
            values = values.astype(np.str_)
        target = coordinates if name in ("t", "j") else data
        attrs = {"long_name": f"{name} of the event", **_unit(events.attrs["units"].get(name, ""))}
        target[f"event_{name}"] = ("event", values, attrs)
    attributes: dict[str, str | float] = {
        "model": trace.name,
        "outcome": trace.outcome.name,
        "message": trace.message,
        "engine": trace.engine,
        "tolerance": trace.tolerance,
        "t_end": trace.t_end,
        "certified": str(trace.certified).lower(),
    }
    attributes |= {f"parameter.{name}": value for name, value in trace.parameters.items()}
    return xr.Dataset(data, coordinates, attributes)


def by_time(data: xr.Dataset) -> xr.Dataset:
    """Return a data set of `to_xarray` over the dimension t, with one sample per time."""
    t = data["t"].to_numpy()
    last = np.append(np.diff(t) > 0.0, True)
    return data.isel(sample=last).swap_dims(sample="t")


def write_run(
    folder: Path | str,
    observer: Observer,
    trace: Trace,
    report: Callable[[], Mapping[str, Any]],
    pieces: PartialReport | None = None,
    samples: bool = True,
) -> tuple[str, ...]:
    """Write a run to a folder: trace.nc, run.json, events.csv, samples.csv and its figure.

    A run with `record: nothing` has run.json and events.csv only.

    Files are staged first. A new folder then appears atomically; in an existing one, files of these
    names are replaced one by one. A file that cannot be written does not stop the others.

    `report` is called after the trajectory is written. `pieces` records parts that failed; without
    it an error is raised. Returns the names of the files.
    """
    from statechart.reporting.figure import figure, render

    folder = Path(folder).resolve()
    done = pieces or PartialReport()

    @cache
    def recorded(short: bool) -> tuple[Trace, Samples]:
        run, per_step = _shape(trace, done, short)
        return run, observer.sample(run, per_step=per_step)

    contents: dict[str, Callable[[bool], bytes]] = {
        "trace.nc": lambda short: netcdf(_data_set(observer, *recorded(short))),
        "run.json": lambda _: dumps(run).encode(),
        "samples.csv": lambda short: _csv(_table(observer, recorded(short)[1])),
        "events.csv": lambda short: _csv(events_table(observer, _shape(trace, done, short)[0])),
    }

    with explain_os_errors("write", folder, _ADVICE):
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "there is a file of this name")
        with staging_folder(folder, _FILES) as place:

            def write(name: str, short: bool = False) -> None:
                write_atomic(place / name, contents[name](short))

            # The trajectory first, since it cannot be recomputed quickly.
            recorded_states = trace.record is not Record.NOTHING
            if recorded_states:
                done.keep("trace.nc", partial(write, "trace.nc"), None)
            run = report()
            done.keep("run.json", partial(write, "run.json"), None)
            for name in ("events.csv", *["samples.csv"] * (recorded_states and samples)):
                done.attempt(name, partial(write, name, done.hurried), None)
            draw_it = partial(figure, observer, trace)
            drawing = done.attempt("figure", draw_it, None) if recorded_states else None
            if drawing is not None:
                for kind in ("svg", "png"):
                    path = place / f"figure.{kind}"
                    draw = partial(render, drawing, kind)
                    done.attempt(path.name, lambda: write_atomic(path, draw()), None)  # noqa: B023
            names = tuple(sorted(os.listdir(place)))
            if not names:
                raise StatechartError(f"cannot write {folder}: {done.text()}; {_ADVICE}")
    if pieces is None and done.failed:
        message = f"{folder} has only {', '.join(names)}; could not be written: {done.text()}"
        raise StatechartError(message)
    return names


def _rows_of(trace: Trace) -> int:
    return 1 if trace.record is Record.POSES else _ROWS


def _csv(table: pd.DataFrame) -> bytes:
    return bytes(table.to_csv(index=False, lineterminator="\n").encode())


def _shape(trace: Trace, pieces: PartialReport, short: bool) -> tuple[Trace, float]:
    """Return a run and its rows per step, in short form a selection of arcs and events."""
    if not short:
        return trace, _rows_of(trace)
    width = len(trace.variables)
    arcs = pieces.some("flows", trace.arcs, width)
    jumps = pieces.some("events", trace.jumps, width)
    steps = sum(len(arc.times) - 1 for arc in arcs)
    per_step = min(_rows_of(trace), short_length(width) / max(steps, 1))
    if per_step < 1.0:
        pieces.leave(f"all states but one of {math.ceil(1.0 / per_step)}")
    return replace(trace, arcs=arcs, jumps=jumps), per_step


def netcdf(data: xr.Dataset) -> bytes:
    """Return the content of a NetCDF file, so that no partial file is written."""
    return bytes(data.to_netcdf(engine="scipy"))


def _labels(observer: Observer, samples: Samples) -> list[str]:
    return [observer.automaton.label(key) for key in samples.modes]


def _columns(names: Iterable[str]) -> dict[str, str]:
    return {name: f"{name}_" if name in _TAKEN else name for name in names}


def _attributes(observer: Observer, name: str) -> dict[str, str]:
    model = observer.automaton.declaration
    role = "variable" if name in observer.automaton.names else "observable"
    return {"long_name": model.quantity(name).words, "role": role, **_unit(model.unit(name))}


def _unit(unit: str) -> dict[str, str]:
    return {"units": unit} if unit else {}


def _without_empty(units: Mapping[str, str]) -> dict[str, str]:
    return {name: unit for name, unit in units.items() if unit}
