"""What the cells of a sweep gave, in Zarr: on disk, where a sweep goes on from, or in memory.

A cell is done where its outcome is not empty, which is written after all else of its chunk. Modes
are coded in the order in which their sequences come in; once all cells are done they are coded
anew in the order of the cells, so that nothing in a store tells in what order it was made.
"""

from __future__ import annotations

import math
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints32
from statechart.documents.declaration import TIME
from statechart.errors import DeclarationError, StatechartError
from statechart.sweeps.block import Block
from statechart.sweeps.claim import Claim
from statechart.sweeps.plan import Plan, Slices, Tile
from statechart.sweeps.variables import CODE, COUNT, NUMBER, OWN, TEXT, Kind

if TYPE_CHECKING:
    import xarray as xr
    import zarr

_SEQUENCE, _UNFINISHED = "sequence", "unfinished"
# Values of a list along its own dimension, and sequences, that one chunk holds.
_LIST_CHUNK, _TABLE_CHUNK = 16, 256
# What zarr writes before it has a name.
_PARTIAL = "*.partial"


class Store:
    """A Zarr group that holds a sweep.

    Parameters
    ----------
    plan : Plan
        The sweep.
    path : Path or str, optional
        Where on disk; in memory by default.
    resume : bool
        Go on with the sweep that is there, if one is.
    claim : Claim, optional
        That no other process writes there.

    Raises
    ------
    DeclarationError
        If something else is there.
    StatechartError
        If it cannot be written.
    """

    def __init__(
        self,
        plan: Plan,
        path: Path | str | None = None,
        *,
        resume: bool = False,
        claim: Claim | None = None,
    ) -> None:
        self._plan, self._claim = plan, claim
        self._path = None if path is None else Path(path)
        self._fresh = False
        self._codes: dict[str, int] = {}
        self._arrays: dict[str, zarr.Array[Any]] = {}
        with self._explained():
            self._group = self._opened(resume)
            self._done = np.array(self._read("outcome") != "", dtype=bool)
        self._longest = {name: self._array(plan.variables[name]).shape[-1] for name in plan.lists}

    @property
    def left(self) -> int:
        """Number of cells that are not done."""
        return int(self._done.size - np.count_nonzero(self._done))

    def undone(self, tile: Tile) -> NDArray[np.intp]:
        """Return the places of the cells of a chunk that are not done."""
        return np.flatnonzero(~self._done[tile.slices])

    def begun(self, tile: Tile) -> Block:
        """Return what the cells of a chunk gave so far."""
        plan = self._plan
        block = Block.empty(tile.size, plan.numbers, plan.lists)
        if not self._done[tile.slices].any():
            return block
        for name, column in self._named(block):
            column[:] = self._read(name, tile.slices).ravel()
        for name in plan.lists:
            variable = plan.variables[name]
            counts = self._read(f"{variable}_count", tile.slices).ravel()
            table = self._read(variable, tile.slices).reshape(tile.size, -1)
            block.lists[name] = [row[:n] for row, n in zip(table, counts, strict=True)]
        return block

    def coded(self, block: Block) -> Ints32:
        """Return the codes (n,) of the sequences of a block's cells, new ones noted."""
        places = [self._codes.setdefault(text, len(self._codes)) for text in block.sequences]
        # The code of a cell without any, -1, is that of the last place.
        return np.array([*places, -1], dtype=np.int32)[block.modes]

    def write(self, tile: Tile, block: Block) -> None:
        """Write what the cells of a chunk gave so far; its modes are `coded`."""
        where = tile.slices
        with self._explained():
            self._table()
            for name, rows in block.lists.items():
                self._list(name, tile, rows)
            for name, column in self._named(block):
                if name == "modes":
                    self._array(f"{_UNFINISHED}/modes")[where] = column.reshape(tile.shape)
                self._array(name)[where] = column.reshape(tile.shape)
        self._done[where] = (block.outcome != "").reshape(tile.shape)

    def finish(self) -> None:
        """Code modes in the order of the cells, if all cells are done."""
        if self.left or _UNFINISHED not in self._group:
            return
        with self._explained():
            raw = self._read(f"{_UNFINISHED}/modes").ravel()
            found, first = np.unique(raw, return_index=True)
            order = found[np.argsort(first)]
            order = order[order >= 0]
            texts = list(self._codes)
            codes = np.full(len(texts) + 1, -1, dtype=np.int32)
            codes[order] = np.arange(len(order))
            self._fill(self._array(_SEQUENCE), [texts[k] for k in order])
            # Chunk by chunk: what is written is what stays in memory.
            for tile in self._plan.tiles():
                part = self._read(f"{_UNFINISHED}/modes", tile.slices)
                self._array("modes")[tile.slices] = codes[part]
            self._group.attrs["complete"] = 1
            del self._group[_UNFINISHED]
            self._consolidate()

    def discard(self) -> None:
        """Remove what was made here, as nothing came of it."""
        if self._fresh and self._path is not None:
            with suppress(StatechartError):
                self._check_claim()
                shutil.rmtree(self._path, ignore_errors=True)

    def dataset(self) -> xr.Dataset:
        """Return the sweep, read from the store where and when it is looked at."""
        import xarray as xr

        try:
            return xr.open_zarr(self._group.store, chunks=None)
        except OSError as error:
            raise self._problem("read", error) from error

    def loaded(self) -> xr.Dataset:
        """Return the sweep, read; `DeclarationError` if a part of it is damaged."""
        found = self.dataset()
        for name, variable in found.variables.items():
            with self._whole(str(name)):
                variable.load()
        return found

    def _opened(self, resume: bool) -> zarr.Group:
        import zarr
        from zarr.storage import MemoryStore

        path = self._path
        if path is None:
            return self._created(MemoryStore())
        if path.is_dir() and all(part.match(_PARTIAL) for part in path.iterdir()):
            return self._made_anew(path)
        if not resume:
            raise DeclarationError(
                f"{path} exists already",
                advice="to go on with the sweep in it, resume (--resume); else name another",
            )
        try:
            group = zarr.open_group(path, mode="r+", use_consolidated=False)
        except PermissionError:
            raise
        except Exception:  # whatever the library makes of what is no store
            raise DeclarationError(
                f"{path} is no store of a sweep", advice="name another, or remove it"
            ) from None
        self._check(group)
        for part in path.rglob(_PARTIAL):  # of a process that was killed while it wrote them
            part.unlink()
        with self._whole("outcome"):
            begun = "outcome" in group
        if not begun:  # made by a process that was killed while it made it
            return self._made_anew(path)
        self._group = group
        self._look()
        return group

    def _look(self) -> None:
        """Read what a sweep goes on with, but for what its cells gave.

        Raises
        ------
        DeclarationError
            If it is not whole.
        """
        for name, _ in self._named(Block.empty(0, self._plan.numbers, self._plan.lists)):
            self._array(name)
        for name, column in self._plan.columns.items():
            if not np.array_equal(self._read(self._plan.coordinates[name]), column):
                raise self._damaged(name)
        self._read(_SEQUENCE)
        if _UNFINISHED in self._group:
            self._array(f"{_UNFINISHED}/modes")
            texts = [str(text) for text in self._read(f"{_UNFINISHED}/{_SEQUENCE}")]
            self._codes = {text: code for code, text in enumerate(texts)}
            if "" in self._codes:
                raise self._damaged(_SEQUENCE)
        elif not self._group.attrs.get("complete"):
            raise self._damaged(_UNFINISHED)

    def _check(self, group: zarr.Group) -> None:
        """Raise `DeclarationError` where a store holds another sweep."""
        told, mine = dict(group.attrs), self._plan.attributes()
        if told.get("format") != mine["format"]:
            raise DeclarationError(
                f"{self._path} is no store of a sweep that this version can read",
                advice="name another, or remove it",
            )
        if told.get("digest") == mine["digest"]:
            return
        differs = [key for key, value in mine.items() if key != "digest" and told.get(key) != value]
        raise DeclarationError(
            f"{self._path} holds another sweep; it differs in "
            + (" and ".join(differs) or "its model, which was changed"),
            advice="repeat what made it, or name another store",
        )

    def _made_anew(self, path: Path) -> zarr.Group:
        """Return the group in a folder that holds nothing else from here on; its lock stays."""
        for part in path.iterdir():
            if part.is_dir():
                shutil.rmtree(part)
            else:
                part.unlink()
        return self._created(path)

    def _created(self, where: Any) -> zarr.Group:
        import zarr

        self._fresh = True
        plan = self._plan
        self._group = group = zarr.create_group(
            where, attributes={**plan.attributes(), "complete": 0}
        )
        for name, column in plan.columns.items():
            told = {**plan.named(name), "declared": str(plan.model.parameters[name])}
            dims = (plan.coordinates[name],) if plan.grid else plan.dims
            shape = column.shape
            self._make(plan.coordinates[name], NUMBER, shape, shape, dims, told)[:] = column
        shape, chunk, dims = plan.shape, plan.chunk, plan.dims
        for name in plan.task.outputs:
            variable, told = plan.variables[name], {**plan.named(name), **plan.declared(name)}
            if name in plan.lists:
                own = ((*shape, 0), (*chunk, _LIST_CHUNK), (*dims, f"{variable}_index"))
                self._make(variable, NUMBER, *own, told)
                told = {"long_name": f"number of {name}"}
                self._make(f"{variable}_count", COUNT, shape, chunk, dims, told)
            else:
                self._make(variable, NUMBER, shape, chunk, dims, told)
        for place in (_SEQUENCE, f"{_UNFINISHED}/{_SEQUENCE}"):
            told = {"long_name": "modes in the order in which they were entered"}
            self._make(place, TEXT, (0,), (_TABLE_CHUNK,), (_SEQUENCE,), told)
        self._make(f"{_UNFINISHED}/modes", CODE, shape, chunk, dims, {})
        for name, (kind, told_of_all) in OWN.items():
            if name != "error_estimate" or plan.accurate:
                unit = plan.named(TIME) if name == "t_end" else {}
                self._make(name, kind, shape, chunk, dims, {**unit, **told_of_all})
        self._consolidate()
        return group

    def _make(
        self,
        name: str,
        kind: Kind,
        shape: tuple[int, ...],
        chunk: tuple[int, ...],
        dims: tuple[str, ...],
        told: Mapping[str, str],
    ) -> zarr.Array[Any]:
        return self._group.create_array(
            name,
            shape=shape,
            chunks=chunk,
            dtype=kind.dtype,
            fill_value=kind.fill,
            dimension_names=dims,
            attributes=dict(told),
        )

    def _named(self, block: Block) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield variables of one value a cell with their values (n,), the outcome last."""
        for name, values in block.numbers.items():
            yield self._plan.variables[name], values
        for name in OWN:
            if name != "error_estimate" or self._plan.accurate:
                yield name, getattr(block, name)

    def _table(self) -> None:
        """Write the texts of sequences that are new."""
        known = self._array(_SEQUENCE).shape[0]
        if len(self._codes) == known:
            return
        # First where a sweep goes on from: a code without a text would be lost there.
        for place in (f"{_UNFINISHED}/{_SEQUENCE}", _SEQUENCE):
            self._fill(self._array(place), list(self._codes), known)
        self._consolidate()

    @staticmethod
    def _fill(array: zarr.Array[Any], texts: list[str], known: int = 0) -> None:
        array.resize((len(texts),))
        if texts[known:]:
            array[known:] = np.array(texts[known:], dtype=object)

    def _list(self, name: str, tile: Tile, values: list[Array]) -> None:
        variable = self._plan.variables[name]
        counts = np.array([len(row) for row in values], dtype=np.int32)
        longest = int(counts.max(initial=0))
        if longest > self._longest[name]:
            self._array(variable).resize((*self._plan.shape, longest))
            self._longest[name] = longest
            self._consolidate()
        table = np.full((tile.size, longest), math.nan)
        for row, found in zip(table, values, strict=True):
            row[: len(found)] = found
        if longest:
            shape = (*tile.shape, longest)
            self._array(variable)[(*tile.slices, slice(0, longest))] = table.reshape(shape)
        self._array(f"{variable}_count")[tile.slices] = counts.reshape(tile.shape)

    def _array(self, name: str) -> zarr.Array[Any]:
        found = self._arrays.get(name)
        if found is None:
            import zarr

            with self._whole(name):
                found = zarr.open_array(self._group.store, path=name, mode="r+")
            self._arrays[name] = found
        return found

    def _read(self, name: str, where: Slices | EllipsisType = ...) -> NDArray[Any]:
        with self._whole(name):
            return np.asarray(self._array(name)[where])

    def _consolidate(self) -> None:
        """Gather what readers open first: without it they warn that they read it piece by piece."""
        import zarr

        with warnings.catch_warnings():
            # It is no part of the format's version 3 yet, but all readers know it.
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(self._group.store)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        self._check_claim()
        try:
            yield
        except OSError as error:
            self._check_claim()
            raise self._problem("write", error) from error

    def _check_claim(self) -> None:
        if self._claim is not None:
            self._claim.check()

    @contextmanager
    def _whole(self, name: str) -> Iterator[None]:
        """Tell what the library makes of files that are cut off, or missing."""
        try:
            yield
        except (FileNotFoundError, ValueError, KeyError, RuntimeError):
            raise self._damaged(name) from None

    def _damaged(self, name: str) -> DeclarationError:
        return DeclarationError(
            f"{self._path} is damaged: {name} cannot be read",
            advice="remove it, and begin the sweep anew",
        )

    def _problem(self, verb: str, error: OSError) -> StatechartError:
        return StatechartError(f"cannot {verb} {self._path}: {error.strerror or error}")
