"""The variables of a sweep, and the arrays of a store that hold them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from statechart.documents.declaration import TIME
from statechart.sweeps.block import WORDS
from statechart.sweeps.plan import Plan

if TYPE_CHECKING:
    import zarr

SEQUENCE, UNFINISHED = "sequence", "unfinished"
"""The texts of sequences of modes; the group of their codes while a sweep is under way."""
# Values of a list along its own dimension, and sequences, that one chunk holds.
_LIST_CHUNK, _TABLE_CHUNK = 16, 256


class Kind(NamedTuple):
    """What an array holds, and what where nothing was written."""

    dtype: Any
    fill: Any


NUMBER, TEXT, FLAG = Kind(float, math.nan), Kind(str, ""), Kind(bool, False)
CODE, COUNT = Kind("int32", -1), Kind("int32", 0)
# In the order in which they are written: with its outcome a cell is done.
OWN: Mapping[str, tuple[Kind, Mapping[str, str]]] = {
    "message": (TEXT, {"long_name": "what kept the run from its end"}),
    "certified": (FLAG, {"long_name": "every guard of every step was decided by enclosure"}),
    "t_end": (NUMBER, {"long_name": "time at which the run ended"}),
    "seconds": (NUMBER, {"long_name": "what the cell took", "units": "s"}),
    "error_estimate": (NUMBER, {"long_name": "estimated error of the run, relative"}),
    "modes": (CODE, {"long_name": "sequence of modes: place along sequence, -1 for none"}),
    "outcome": (TEXT, {"long_name": "why the run ended; empty: not run yet", **WORDS}),
}


def create(group: zarr.Group, plan: Plan) -> None:
    """Make the arrays of a sweep in a group; the outcome last."""
    for name, column in plan.columns.items():
        told = {**plan.named(name), "declared": str(plan.model.parameters[name])}
        dims = (plan.coordinates[name],) if plan.grid else plan.dims
        shape = column.shape
        _make(group, plan.coordinates[name], NUMBER, shape, shape, dims, told)[:] = column
    shape, chunk, dims = plan.shape, plan.chunk, plan.dims
    for name in plan.task.outputs:
        variable, told = plan.variables[name], {**plan.named(name), **plan.declared(name)}
        if name in plan.lists:
            own = ((*shape, 0), (*chunk, _LIST_CHUNK), (*dims, f"{variable}_index"))
            _make(group, variable, NUMBER, *own, told)
            told = {"long_name": f"number of {name}"}
            _make(group, f"{variable}_count", COUNT, shape, chunk, dims, told)
        else:
            _make(group, variable, NUMBER, shape, chunk, dims, told)
    for place in (SEQUENCE, f"{UNFINISHED}/{SEQUENCE}"):
        told = {"long_name": "modes in the order in which they were entered"}
        _make(group, place, TEXT, (0,), (_TABLE_CHUNK,), (SEQUENCE,), told)
    _make(group, f"{UNFINISHED}/modes", CODE, shape, chunk, dims, {})
    for name, (kind, told_of_all) in OWN.items():
        if name != "error_estimate" or plan.accurate:
            unit = plan.named(TIME) if name == "t_end" else {}
            _make(group, name, kind, shape, chunk, dims, {**unit, **told_of_all})


def _make(
    group: zarr.Group,
    name: str,
    kind: Kind,
    shape: tuple[int, ...],
    chunk: tuple[int, ...],
    dims: tuple[str, ...],
    told: Mapping[str, str],
) -> zarr.Array[Any]:
    return group.create_array(
        name,
        shape=shape,
        chunks=chunk,
        dtype=kind.dtype,
        fill_value=kind.fill,
        dimension_names=dims,
        attributes=dict(told),
    )
