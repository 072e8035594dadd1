"""Plan of a sweep: its cells, their chunks, and the task of each cell."""

from __future__ import annotations

import hashlib
import json
import math
import pickle
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.metadata import version
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.documents.declaration import Declaration
from statechart.documents.hints import unknown_parameter
from statechart.documents.outputs import Value
from statechart.documents.quantities import axis_label
from statechart.documents.setting import Setting
from statechart.errors import DeclarationError, close_matches
from statechart.reporting.tables import RESERVED
from statechart.sweeps.ranges import numbers

if TYPE_CHECKING:
    import pandas as pd

_FORMAT = "statechart sweep 2"
_MAX_CELLS = 100_000_000  # their status is in memory
_CHUNK = 16384  # cells of a Zarr chunk, the unit of reading
SAMPLE = "sample"
"""Dimension of a table of samples."""
# Variables and dimensions of every sweep.
_OWN = frozenset(
    {"outcome", "message", "certified", "modes", "sequence", "t_end", "seconds", "error_estimate"}
)

Slices = tuple[slice, ...]


@dataclass(frozen=True)
class Task:
    """Task of every cell, picklable."""

    model: bytes  # pickled declaration
    setting: Setting
    until: float | None  # end of the runs, by default `stop.time` of the model
    names: tuple[str, ...]  # swept parameters
    outputs: tuple[str, ...]
    version: str  # of this package: another one may give other bits

    @classmethod
    def of(
        cls,
        model: Declaration,
        setting: Setting,
        until: float | None,
        names: Sequence[str],
        outputs: Sequence[str] | None,
    ) -> Task:
        """Return a task; raise `DeclarationError` for an unknown output."""
        declared = model.outputs
        if isinstance(outputs, str):
            message = f"outputs are a list of names, not the text {outputs!r}"
            raise DeclarationError(message, advice=f"write [{outputs!r}]")
        for name in outputs or ():
            if name not in declared:
                advice = close_matches(name, declared)
                raise DeclarationError(f"the model has no output {name!r}", advice=advice)
        chosen = tuple(declared) if outputs is None else tuple(dict.fromkeys(outputs))
        here = version("contact-statecharts")
        return cls(pickle.dumps(model), setting, until, tuple(names), chosen, here)


@dataclass(frozen=True)
class Tile:
    """Cells of one chunk: slices and shape."""

    slices: Slices
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)


class Plan:
    """A sweep: parameters, their values, and the task of every cell.

    `columns` are the values of each parameter along its axis (`grid`), or the columns of a table.
    Runs end at `until`, by default `stop.time` of the model. `outputs` are all by default. With
    `accurate` runs estimate their error.
    """

    def __init__(
        self,
        model: Declaration,
        setting: Setting,
        columns: Mapping[str, Sequence[float] | Array],
        *,
        grid: bool = True,
        until: float | None = None,
        outputs: Sequence[str] | None = None,
        accurate: bool = False,
    ) -> None:
        if not columns:
            advice = "give names and values"
            raise DeclarationError("a sweep needs parameters to vary", advice=advice)
        for name in columns:
            if name not in model.parameters:
                advice = unknown_parameter(name, model.parameters)
                raise DeclarationError(f"the model has no parameter {name!r}", advice=advice)
        self.model, self.grid, self.accurate = model, grid, accurate
        self.columns = {name: numbers(name, values) for name, values in columns.items()}
        self.task = Task.of(model, setting, until, tuple(columns), outputs)
        lengths = tuple(len(column) for column in self.columns.values())
        if grid:
            for name, column in self.columns.items():
                if len(np.unique(column)) < len(column):
                    advice = "give every value once"
                    raise DeclarationError(f"a value of {name} is given twice", advice=advice)
        elif len(set(lengths)) > 1:
            raise DeclarationError("the columns of a table of samples have one length")
        self.shape = lengths if grid else lengths[:1]
        if self.size > _MAX_CELLS:
            message = f"a sweep has at most {_MAX_CELLS} cells, not {self.size}"
            raise DeclarationError(message, advice="give fewer values")

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @cached_property
    def coordinates(self) -> dict[str, str]:
        """Parameter -> name of its coordinate."""
        taken = {*_OWN, SAMPLE}
        return {name: _claim_name(name, taken) for name in self.columns}

    @cached_property
    def variables(self) -> dict[str, str]:
        """Output -> name of its variable."""
        taken = {*_OWN, SAMPLE, *self.coordinates.values()}
        suffixes = dict.fromkeys(self.lists, ("", "_count", "_index"))
        outputs = self.task.outputs
        return {name: _claim_name(name, taken, suffixes.get(name, ("",))) for name in outputs}

    @property
    def dims(self) -> tuple[str, ...]:
        """The dimensions."""
        return tuple(self.coordinates.values()) if self.grid else (SAMPLE,)

    @cached_property
    def lists(self) -> frozenset[str]:
        """The outputs that are lists."""
        return lists(self.model, self.task.outputs)

    @property
    def numbers(self) -> tuple[str, ...]:
        """The outputs that are one number each."""
        return tuple(name for name in self.task.outputs if name not in self.lists)

    def named(self, name: str) -> dict[str, str]:
        """Return name and unit of a parameter or output as attributes."""
        unit = self.model.unit(name)
        return {"long_name": name} | ({"units": unit} if unit else {})

    def entitled(self, name: str) -> str:
        """Return the axis label of a parameter or output."""
        return axis_label(name, self.model.unit(name))

    def declared(self, name: str) -> dict[str, str]:
        """Return the declaration of an output as attributes of its variable."""
        found = self.model.outputs[name].model_dump(mode="json", exclude_defaults=True)
        return {key: str(value) for key, value in found.items()}

    def attributes(self) -> dict[str, str]:
        """Return the identity of this sweep as text and digest."""
        task = self.task
        varied = "".join(
            f", {name}: {len(column)} from {column.min():g} to {column.max():g}"
            for name, column in self.columns.items()
        )
        options = {key: value for key, value in asdict(task.setting).items() if value is not None}
        options |= {} if task.until is None else {"until": task.until}
        found = {
            "format": _FORMAT,
            "model": self.model.name,
            "doc": self.model.doc,
            "version": task.version,
            "swept": f"{'grid' if self.grid else 'table'}{varied}",
            "asked": ", ".join(f"{key} {value}" for key, value in options.items()) or "nothing",
            "outputs": ", ".join(task.outputs),
        }
        return {**found, "digest": self._digest(found)}

    def _digest(self, words: Mapping[str, str]) -> str:
        model = self.model.model_dump(mode="json", exclude={"doc", "ranges"})
        text = json.dumps([model, words], sort_keys=True, default=str)
        found = hashlib.sha256(text.encode())
        for column in self.columns.values():
            found.update(column.tobytes())
        return found.hexdigest()[:16]

    @cached_property
    def chunk(self) -> tuple[int, ...]:
        """Shape of a chunk.

        It contains whole trailing axes as far as they fit, and one value of each structural
        parameter, so that its cells share compiled programs.
        """
        found, free = [], _CHUNK
        for name, length in zip(reversed(self.columns), reversed(self.shape), strict=False):
            longest = 1 if self.grid and name in self.model.whole else min(length, max(free, 1))
            pieces = -(-length // longest)
            found.append(-(-length // pieces))
            free //= found[-1]
        return tuple(reversed(found))

    def tiles(self) -> Iterator[Tile]:
        """Yield the chunks, ordered by the structure of the model."""
        starts = [range(0, n, k) for n, k in zip(self.shape, self.chunk, strict=True)]
        names = list(self.columns) if self.grid else [SAMPLE]
        # The last factor of a product varies fastest.
        order = sorted(range(len(names)), key=lambda axis: names[axis] not in self.model.whole)
        for corner in product(*(starts[axis] for axis in order)):
            begins = [corner[order.index(axis)] for axis in range(len(order))]
            ends = [min(b + k, n) for b, k, n in zip(begins, self.chunk, self.shape, strict=True)]
            pairs = list(zip(begins, ends, strict=True))
            yield Tile(tuple(slice(b, e) for b, e in pairs), tuple(e - b for b, e in pairs))

    def parameter_values(self, tile: Tile, places: NDArray[np.intp]) -> Array:
        """Return the parameters (m, p) of the cells at `places` of a chunk."""
        where = np.unravel_index(places, tile.shape)
        indices = [part.start + place for part, place in zip(tile.slices, where, strict=True)]
        if not self.grid:
            indices *= len(self.columns)
        columns = [column[k] for column, k in zip(self.columns.values(), indices, strict=True)]
        return np.ascontiguousarray(np.stack(columns, axis=1))


def lists(model: Declaration, names: Sequence[str]) -> frozenset[str]:
    """Return the outputs that are lists of values at several events."""
    values = ((name, one) for name in names if isinstance(one := model.outputs[name], Value))
    return frozenset(name for name, output in values if output.moment.several)


def columns_of(samples: pd.DataFrame) -> dict[str, Array]:
    """Return the columns of a table of samples."""
    if not hasattr(samples, "columns"):
        message = f"samples are a table, not of type {type(samples).__name__}"
        raise DeclarationError(message, advice="write pandas.DataFrame({'NAME': [...]})")
    names = [str(name) for name in samples.columns]
    if len(set(names)) < len(names):
        raise DeclarationError("two columns of the samples have one name", advice="remove one")
    return {name: numbers(name, samples.iloc[:, k].array) for k, name in enumerate(names)}


def _claim_name(name: str, taken: set[str], suffixes: Sequence[str] = ("",)) -> str:
    """Return a name that is free with all suffixes, and reserve these."""
    while name in RESERVED or not taken.isdisjoint(name + suffix for suffix in suffixes):
        name += "_"
    taken.update(name + suffix for suffix in suffixes)
    return name
