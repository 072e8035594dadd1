"""Zarr store of a run: states at every step as arrays, written piece by piece."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.arrays import Array
from statechart.automaton.clock import decimals
from statechart.automaton.trace import Trace
from statechart.documents.declaration import TIME
from statechart.errors import StatechartError
from statechart.observation.observer import Observer

if TYPE_CHECKING:
    import zarr


# Rows are written when they hold so many bytes: a chunk.
_CHUNK = 2**23


def write_store(
    path: Path | str, observer: Observer, trace: Trace, report: Mapping[str, Any]
) -> None:
    """Write a run to a new Zarr store.

    Dimension `t`: the beginning of every step, after the jumps there, and the end. Variables
    ``NAME.q`` that several NAMEs have, as those of bodies, are one array ``q`` over `t` and
    `body`; the others are arrays over `t`. Dimension `event`: `event_t`, `event_region`,
    `event_cause`. The rest of `report` is in the attribute `report`, as JSON.
    """
    import zarr

    trace.require_motion()
    path = Path(path)
    with _explained(path):
        group = zarr.open_group(path, mode="w-")
    model = observer.automaton.declaration
    bodies, shared, own = _arrays(trace.variables)
    with _explained(path):
        rest = {key: value for key, value in report.items() if key not in ("events", "final")}
        group.attrs.update({"model": trace.name, "report": json.dumps(rest)})
        width = len(trace.variables)
        rows = max(1, _CHUNK // (8 * width))
        _table(group, "t", "t", np.zeros(0), rows, _unit(model.unit(TIME)))
        for part, places in shared.items():
            unit = _unit(model.unit(trace.variables[places[0]]))
            _table(group, part, ("t", "body"), np.zeros((0, len(places))), rows, unit)
        if bodies:
            _table(group, "body", "body", np.array(bodies, dtype=np.str_), len(bodies), {})
        for name in own:
            _table(group, name, "t", np.zeros(0), rows, _unit(model.unit(name)))
        jumps = trace.jumps
        events: dict[str, Any] = {
            "event_t": np.array([jump.t for jump in jumps]),
            "event_region": np.array([jump.region for jump in jumps], dtype=np.str_),
            "event_cause": np.array([jump.cause for jump in jumps], dtype=np.str_),
        }
        for name, column in events.items():
            _table(group, name, "event", column, max(1, len(jumps)), {})
        for times, states in _pieces(trace, rows):
            for part, places in shared.items():
                _array(group, part).append(states[:, places])
            for name, place in own.items():
                _array(group, name).append(states[:, place])
            _array(group, "t").append(times)
        with warnings.catch_warnings():
            # It is no part of the format's version 3 yet, but all readers know it.
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(group.store)


def _arrays(names: tuple[str, ...]) -> tuple[list[str], dict[str, list[int]], dict[str, int]]:
    """Return the bodies, the places of what all of them have, and those of all other variables."""
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


def _pieces(trace: Trace, rows: int) -> Iterator[tuple[Array, Array]]:
    """Yield times and states where steps begin, and at the end, about `rows` of them at once."""
    times: list[Array] = []
    states: list[Array] = []
    for arc in trace.arcs:
        begun = arc.start.high + (arc.start.low + arc.times[:-1])
        times.append(begun if trace.step is None else decimals(begun))
        states.append(arc.coefficients[:, :, 0])
        if sum(map(len, times)) >= rows:
            yield np.concatenate(times), np.concatenate(states)
            times, states = [], []
    yield np.array([*np.concatenate([*times, [trace.t_end]])]), np.vstack([*states, trace.final])


def _table(
    group: zarr.Group,
    name: str,
    dims: str | tuple[str, ...],
    values: Any,
    rows: int,
    attributes: Mapping[str, str],
) -> None:
    """Make an array along dimensions, of which the first may grow by about so many rows."""
    chunks = (rows, *(max(1, size) for size in values.shape[1:]))
    array = group.create_array(
        name,
        shape=values.shape,
        dtype=str if values.dtype.kind == "U" else values.dtype,
        chunks=chunks,
        dimension_names=(dims,) if isinstance(dims, str) else dims,
        attributes=dict(attributes),
    )
    if values.size:
        array[...] = values


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    import zarr

    found = group[name]
    assert isinstance(found, zarr.Array)
    return found


def _unit(unit: str) -> dict[str, str]:
    return {"units": unit} if unit else {}


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    try:
        yield
    except FileExistsError:
        raise StatechartError(
            f"cannot write {path}: there is something of this name; name another place"
        ) from None
    except OSError as error:
        raise StatechartError(
            f"cannot write {path}: {error.strerror or error}; name a place that is writable"
        ) from error
