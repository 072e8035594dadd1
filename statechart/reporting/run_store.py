"""Zarr store of a run: states at every step as arrays, written in chunks."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from statechart.arrays import Array
from statechart.automaton.clock import decimals
from statechart.automaton.trace import Trace
from statechart.documents.declaration import TIME
from statechart.documents.files import explain_os_errors
from statechart.errors import StatechartError
from statechart.observation.observer import Observer

_CHUNK = 2**23  # bytes


def write_store(
    path: Path | str, observer: Observer, trace: Trace, report: Mapping[str, Any]
) -> None:
    """Write a run to a new Zarr store.

    Dimension `t`: the start of every step, after the jumps there, and the end. Variables ``NAME.q``
    of several bodies are one array ``q`` over `t` and `body`; the others are arrays over `t`.
    Dimension `event`: `event_t`, `event_region`, `event_cause`. The attribute `report` contains the
    rest of `report` as JSON.
    """
    import xarray as xr

    trace.require_motion()
    if Path(path).exists():
        message = f"cannot write {path}: there is something of this name; name another place"
        raise StatechartError(message)
    model = observer.automaton.declaration
    bodies, shared, own = _arrays(trace.variables)
    rows = max(1, _CHUNK // (8 * len(trace.variables)))

    def array(dims: tuple[str, ...], values: Array, name: str) -> tuple[Any, ...]:
        unit = model.unit(name)
        chunks = {"chunks": (rows, *values.shape[1:])}
        return dims, values, {"units": unit} if unit else {}, chunks

    def data(times: Array, states: Array) -> xr.Dataset:
        found = {name: array(("t",), states[:, place], name) for name, place in own.items()}
        for part, places in shared.items():
            name = trace.variables[places[0]]
            found[part] = array(("t", "body"), states[:, places], name)
        return xr.Dataset(found, {"t": array(("t",), times, TIME)}, attributes)

    rest = {key: value for key, value in report.items() if key not in ("events", "final")}
    attributes = {"model": trace.name, "report": json.dumps(rest)}
    jumps = trace.jumps
    pieces = _chunks(trace, rows)
    texts = {"region": [jump.region for jump in jumps], "cause": [jump.cause for jump in jumps]}
    first = data(*next(pieces)).assign(
        {"event_t": ("event", np.array([jump.t for jump in jumps]))}
        | {f"event_{name}": ("event", _text(column)) for name, column in texts.items()}
    )
    if bodies:
        first = first.assign_coords(body=_text(bodies))
    explained = explain_os_errors("write", path, "name a place that is writable")
    with explained, warnings.catch_warnings():
        # Consolidated metadata are not part of Zarr format 3 yet, but all readers know them.
        warnings.simplefilter("ignore")
        first.to_zarr(path, mode="w-")
        for piece in pieces:
            data(*piece).drop_encoding().to_zarr(path, append_dim="t")


def _text(values: list[str]) -> np.ndarray[Any, Any]:
    return np.array(values, dtype=np.dtypes.StringDType())


def _arrays(names: tuple[str, ...]) -> tuple[list[str], dict[str, list[int]], dict[str, int]]:
    """Return bodies, places of the variables that all of them have, and of the others."""
    parts: dict[str, dict[str, int]] = {}
    for place, name in enumerate(names):
        owner, _, part = name.rpartition(".")
        parts.setdefault(part, {})[owner] = place
    bodies = max((list(owners) for owners in parts.values()), key=len, default=[])
    alike = {part: owners for part, owners in parts.items() if list(owners) == bodies}
    if len(bodies) < 2:
        alike = {}
    shared = {part: list(owners.values()) for part, owners in alike.items()}
    taken = {place for places in shared.values() for place in places}
    own = {name: place for place, name in enumerate(names) if place not in taken}
    return bodies if shared else [], shared, own


def _chunks(trace: Trace, rows: int) -> Iterator[tuple[Array, Array]]:
    """Yield times (m,) and states (m, n) at the starts of steps and the end, m about `rows`."""
    times: list[Array] = []
    states: list[Array] = []
    for arc in trace.arcs:
        starts = arc.start.high + (arc.start.low + arc.times[:-1])
        times.append(starts if trace.step is None else decimals(starts))
        states.append(arc.coefficients[:, :, 0])
        if sum(map(len, times)) >= rows:
            yield np.concatenate(times), np.concatenate(states)
            times, states = [], []
    yield np.array([*np.concatenate([*times, [trace.t_end]])]), np.vstack([*states, trace.final])
