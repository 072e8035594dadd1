"""Zarr store of a sweep, on disk (resumable) or in memory.

A cell is done if its outcome is not empty; the outcome of a chunk is written last. Chunks of fill
values are written too, since Zarr cannot tell a lost chunk from fill values. Modes are coded in
order of arrival, and recoded in the order of the cells at the end, so that a store does not depend
on the order of computation.
"""

from __future__ import annotations

import errno
import itertools
import math
import os
import shutil
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from itertools import product
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints32
from statechart.documents.declaration import TIME
from statechart.documents.files import explain_os_errors, new_folder
from statechart.errors import DeclarationError, StatechartError
from statechart.sweeps.cells import OUTCOMES, CellBlock
from statechart.sweeps.plan import Plan, Slices, Tile

if TYPE_CHECKING:  # importing them takes half a second
    import xarray as xr
    import zarr

SEQUENCE, UNFINISHED = "sequence", "unfinished"
"""The texts of sequences of modes; the group of their codes while a sweep is under way."""
_LIST_CHUNK, _TABLE_CHUNK = 16, 256  # values of a list, and sequences, per chunk
_PARTIAL = "*.partial"  # temporary files of zarr
_LOCK = ".lock"
# Errors of network file systems without locks.
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)
_ALL_CHUNKS = {"array.write_empty_chunks": True}

_Kind = tuple[Any, Any]
"""Type of an array, and its fill value."""
_NUMBER, _TEXT, _FLAG, _CODE, _COUNT = (
    (float, math.nan), (str, ""), (bool, False), ("int32", -1), ("int32", 0),
)  # fmt: skip
# In order of writing, the outcome last.
_OWN: Mapping[str, tuple[_Kind, Mapping[str, str]]] = {
    "message": (_TEXT, {"long_name": "what kept the run from its end"}),
    "certified": (_FLAG, {"long_name": "every guard of every step was decided by enclosure"}),
    "t_end": (_NUMBER, {"long_name": "time at which the run ended"}),
    "seconds": (_NUMBER, {"long_name": "what the cell took", "units": "s"}),
    "error_estimate": (_NUMBER, {"long_name": "estimated error of the run, relative"}),
    "modes": (_CODE, {"long_name": "sequence of modes: place along sequence, -1 for none"}),
    "outcome": (_TEXT, {"long_name": "why the run ended; empty: not run yet", **OUTCOMES}),
}


@contextmanager
def lock_folder(path: Path) -> Iterator[Callable[[], None]]:
    """Create and lock a folder; yield a check that it still exists.

    The folder is removed if the work fails before anything is written. The operating system
    releases the lock when the process ends.
    """
    from filelock import FileLock, Timeout

    if path.exists() and not path.is_dir():  # refused later
        yield lambda: None
        return
    file = path / _LOCK
    with ExitStack() as stack:
        with explain_os_errors("write", path):
            stack.enter_context(new_folder(path))
            lock = FileLock(file)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                message = f"another process is writing {path}"
                advice = "wait until it has ended, or name another store"
                raise DeclarationError(message, advice=advice) from None
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
            file.touch()
            began = file.stat()

        def is_there() -> bool:
            try:
                return os.path.samestat(began, file.stat())
            except OSError:
                return False

        def check() -> None:
            if not is_there():
                message = f"{path} was removed while it was written; begin the sweep anew"
                raise StatechartError(message)

        try:
            yield check
        finally:
            if is_there():
                with suppress(OSError):
                    file.unlink()
            lock.release()


class Store:
    """Zarr group of a sweep."""

    def __init__(
        self,
        plan: Plan,
        path: Path | str | None = None,
        *,
        resume: bool = False,
        check_lock: Callable[[], None] = lambda: None,
    ) -> None:
        self._plan, self._check_lock = plan, check_lock
        self._path = None if path is None else Path(path)
        self._fresh = False
        self._codes: dict[str, int] = {}
        self._written = 0  # texts written
        self._array = cache(self._opened_array)
        try:
            with self._explained():
                self._group = self._opened(resume)
                self._done = np.array(self._read("outcome") != "", dtype=bool)
                if not self._fresh:
                    self._check_whole()
        except StatechartError:
            self.discard()
            raise
        self._longest = {name: self._array(plan.variables[name]).shape[-1] for name in plan.lists}

    @property
    def _complete(self) -> bool:
        return bool(self._group.attrs.get("complete"))

    @property
    def undone_count(self) -> int:
        """Number of undone cells."""
        return int(self._done.size - np.count_nonzero(self._done))

    def undone(self, tile: Tile) -> NDArray[np.intp]:
        """Return the places of the undone cells of a chunk."""
        return np.flatnonzero(~self._done[tile.slices])

    def block(self, tile: Tile) -> CellBlock:
        """Return the results of the cells of a chunk so far."""
        plan = self._plan
        block = CellBlock.empty(tile.size, plan.numbers, plan.lists)
        if not self._done[tile.slices].any():
            return block
        for name, column in self._columns(block).items():
            column[:] = self._read(name, tile.slices).ravel()
        for name in plan.lists:
            variable = plan.variables[name]
            counts = self._read(f"{variable}_count", tile.slices).ravel()
            table = self._read(variable, tile.slices).reshape(tile.size, -1)
            block.lists[name] = [row[:n] for row, n in zip(table, counts, strict=True)]
        return block

    def codes(self, block: CellBlock) -> Ints32:
        """Return the sequence codes (n,) of the cells of a block, after adding new sequences."""
        places = [self._codes.setdefault(text, len(self._codes)) for text in block.sequences]
        # -1, the code of cells without a sequence, indexes the last place.
        return np.array([*places, -1], dtype=np.int32)[block.modes]

    def write(self, tile: Tile, block: CellBlock) -> None:
        """Write the results of a chunk; its modes are `codes`."""
        where = tile.slices
        with self._explained():
            self._write_sequences()
            for name, rows in block.lists.items():
                self._write_list(name, tile, rows)
            for name, column in self._columns(block).items():
                if name == "modes":
                    self._array(f"{UNFINISHED}/modes")[where] = column.reshape(tile.shape)
                self._array(name)[where] = column.reshape(tile.shape)
        self._done[where] = (block.outcome != "").reshape(tile.shape)

    def finish(self) -> None:
        """Recode modes in the order of the cells if all cells are done."""
        if self.undone_count or self._complete:
            return
        with self._explained():
            raw = self._read(f"{UNFINISHED}/modes").ravel()
            found, first = np.unique(raw, return_index=True)
            order = found[np.argsort(first)]
            order = order[order >= 0]
            texts = list(self._codes)
            codes = np.full(len(texts) + 1, -1, dtype=np.int32)
            codes[order] = np.arange(len(order))
            self._fill(self._array(SEQUENCE), [texts[k] for k in order])
            for tile in self._plan.tiles():
                part = self._read(f"{UNFINISHED}/modes", tile.slices)
                self._array("modes")[tile.slices] = codes[part]
            self._group.attrs["complete"] = 1
            del self._group[UNFINISHED]
            self._consolidate()

    def discard(self) -> None:
        """Remove the store if this object created it."""
        if self._fresh and self._path is not None:
            with suppress(StatechartError):
                self._check_lock()
                shutil.rmtree(self._path, ignore_errors=True)

    def dataset(self) -> xr.Dataset:
        """Return the sweep as a lazily loaded data set."""
        import xarray as xr

        with explain_os_errors("read", str(self._path)):
            return xr.open_zarr(self._group.store, chunks=None)

    def loaded(self) -> xr.Dataset:
        """Return the sweep in memory; raise `DeclarationError` if a part is damaged."""
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
        if path.is_dir() and all(p.match(_PARTIAL) or p.name == _LOCK for p in path.iterdir()):
            return self._remake(path)
        if not resume and path.is_dir():
            advice = "continue it with --resume (resume=True), or name another store"
            raise DeclarationError(f"{path} exists already", advice=advice)
        try:
            group = zarr.open_group(path, mode="r+", use_consolidated=False)
        except PermissionError:
            raise
        except Exception:  # zarr raises various errors for other folders
            advice = "name another, or remove it"
            raise DeclarationError(f"{path} is no sweep store", advice=advice) from None
        self._check(group)
        for part in path.rglob(_PARTIAL):  # of a killed process
            part.unlink()
        with self._whole("outcome"):
            outcome = "outcome" in group
        if not outcome:  # of a process killed during creation
            return self._remake(path)
        self._group = group
        self._read_sequences()
        return group

    def _read_sequences(self) -> None:
        """Check the coordinates of a resumed sweep, and read its sequences of modes."""
        for name in self._single:
            self._array(name)
        for name, column in self._plan.columns.items():
            if not np.array_equal(self._read(self._plan.coordinates[name]), column):
                raise self._damaged(name)
        texts = self._read(SEQUENCE)
        if not self._complete:
            if UNFINISHED not in self._group:
                raise self._damaged(UNFINISHED)
            texts = self._read(f"{UNFINISHED}/{SEQUENCE}")
        # A killed process may have left trailing empty texts.
        known = itertools.takewhile(bool, map(str, texts))
        self._codes = {text: code for code, text in enumerate(known)}

    def _check_whole(self) -> None:
        """Raise `DeclarationError` if results of cells or texts of their modes are missing."""
        plan, root, complete = self._plan, self._path, self._complete
        assert root is not None
        modes = "modes" if complete else f"{UNFINISHED}/modes"
        counts = {plan.variables[name]: f"{plan.variables[name]}_count" for name in plan.lists}
        for tile in plan.tiles():
            if not (complete or self._done[tile.slices].any()):
                continue
            parts = dict.fromkeys([modes, *self._single, *sorted(counts.values())], tile.slices)
            for name, count in sorted(counts.items()):
                longest = int(self._read(count, tile.slices).max())
                parts[name] = (*tile.slices, slice(0, longest))
            for name, where in parts.items():
                if file := _missing_chunk(root, self._array(name), where):
                    raise self._damaged(file, "is missing")
            if self._read(modes, tile.slices).max() >= len(self._codes):
                raise self._damaged(SEQUENCE)
        if complete and (root / UNFINISHED).exists():  # of a process that was removing it
            shutil.rmtree(root / UNFINISHED)
            self._consolidate()

    def _check(self, group: zarr.Group) -> None:
        found, mine = dict(group.attrs), self._plan.attributes()
        if found.get("format") != mine["format"]:
            advice = "name another, or remove it"
            raise DeclarationError(f"{self._path} is no sweep store of this version", advice=advice)
        if found.get("digest") == mine["digest"]:
            return
        changed = [key for key, value in mine.items() if found.get(key) != value]
        differs = [key for key in changed if key != "digest"]
        message = f"{self._path} holds another sweep; it differs in " + (
            " and ".join(differs) or "its model, which was changed"
        )
        raise DeclarationError(message, advice="repeat what made it, or name another store")

    def _remake(self, path: Path) -> zarr.Group:
        """Empty a folder except for its lock, and create the group in it."""
        for part in path.iterdir():
            if part.is_dir():
                shutil.rmtree(part)
            elif part.name != _LOCK:
                part.unlink()
        return self._created(path)

    def _created(self, where: Any) -> zarr.Group:
        import zarr

        self._fresh = True
        attributes = {**self._plan.attributes(), "complete": 0}
        self._group = group = zarr.create_group(where, attributes=attributes)
        with zarr.config.set(_ALL_CHUNKS):
            create(group, self._plan)
        self._consolidate()
        return group

    @property
    def _single(self) -> list[str]:
        """The variables of one value per cell, the outcome last."""
        plan = self._plan
        return [*map(plan.variables.__getitem__, plan.numbers), *_sweep_variables(plan)]

    def _columns(self, block: CellBlock) -> dict[str, NDArray[Any]]:
        """Return variables of one value per cell -> their values (n,), the outcome last."""
        found = {self._plan.variables[name]: values for name, values in block.numbers.items()}
        return found | {name: getattr(block, name) for name in _sweep_variables(self._plan)}

    def _write_sequences(self) -> None:
        if len(self._codes) == self._written:
            return
        # First the copy that a resumed sweep reads, since a code without a text would be lost.
        for place in (f"{UNFINISHED}/{SEQUENCE}", SEQUENCE):
            self._fill(self._array(place), list(self._codes), self._written)
        self._written = len(self._codes)
        self._consolidate()

    @staticmethod
    def _fill(array: zarr.Array[Any], texts: list[str], known: int = 0) -> None:
        array.resize((len(texts),))
        if texts[known:]:
            array[known:] = np.array(texts[known:], dtype=object)

    def _write_list(self, name: str, tile: Tile, values: list[Array]) -> None:
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

    def _opened_array(self, name: str) -> zarr.Array[Any]:
        import zarr

        with self._whole(name), zarr.config.set(_ALL_CHUNKS):
            return zarr.open_array(self._group.store, path=name, mode="r+")

    def _read(self, name: str, where: Slices | EllipsisType = ...) -> NDArray[Any]:
        with self._whole(name):
            return np.asarray(self._array(name)[where])

    def _consolidate(self) -> None:
        """Consolidate the metadata: readers warn without it."""
        import zarr

        with warnings.catch_warnings():
            # Not part of Zarr format 3 yet, but all readers know it.
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(self._group.store)

    @contextmanager
    def _explained(self) -> Iterator[None]:
        self._check_lock()
        with explain_os_errors("write", str(self._path)):
            try:
                yield
            except OSError:
                self._check_lock()
                raise

    @contextmanager
    def _whole(self, name: str) -> Iterator[None]:
        """Raise `DeclarationError` for truncated or missing files."""
        try:
            yield
        except (FileNotFoundError, ValueError, KeyError, RuntimeError):
            raise self._damaged(name) from None

    def _damaged(self, name: str, words: str = "cannot be read") -> DeclarationError:
        advice = "remove it, and begin the sweep anew"
        return DeclarationError(f"{self._path} is damaged: {name} {words}", advice=advice)


def _sweep_variables(plan: Plan) -> list[str]:
    """Return the variables of every sweep, the outcome last."""
    return [name for name in _OWN if name != "error_estimate" or plan.accurate]


def _missing_chunk(root: Path, array: zarr.Array[Any], where: Slices) -> str:
    """Return the file of the first missing chunk of a part of an array, or an empty string."""
    pairs = zip(where, array.chunks, strict=True)
    for place in product(*(range(s.start // size, -(-s.stop // size)) for s, size in pairs)):
        file = f"{array.path}/{array.metadata.encode_chunk_key(place)}"
        if not (root / file).exists():
            return file
    return ""


def create(group: zarr.Group, plan: Plan) -> None:
    """Create the arrays of a sweep in a group, the outcome last."""

    def make(
        name: str, kind: _Kind, shape: Any, chunks: Any, dims: Any, attributes: Mapping[str, str]
    ) -> zarr.Array[Any]:
        return group.create_array(
            name, shape=shape, chunks=chunks, dtype=kind[0], fill_value=kind[1],
            dimension_names=dims, attributes=dict(attributes),
        )  # fmt: skip

    for name, column in plan.columns.items():
        attributes = {**plan.named(name), "declared": str(plan.model.parameters[name])}
        dims = (plan.coordinates[name],) if plan.grid else plan.dims
        shape = column.shape
        make(plan.coordinates[name], _NUMBER, shape, shape, dims, attributes)[:] = column
    shape, chunk, dims = plan.shape, plan.chunk, plan.dims
    for name in plan.task.outputs:
        variable, attributes = plan.variables[name], {**plan.named(name), **plan.declared(name)}
        if name in plan.lists:
            own = ((*shape, 0), (*chunk, _LIST_CHUNK), (*dims, f"{variable}_index"))
            make(variable, _NUMBER, *own, attributes)
            counts = {"long_name": f"number of {name}"}
            make(f"{variable}_count", _COUNT, shape, chunk, dims, counts)
        else:
            make(variable, _NUMBER, shape, chunk, dims, attributes)
    for place in (SEQUENCE, f"{UNFINISHED}/{SEQUENCE}"):
        texts = {"long_name": "modes in the order in which they were entered"}
        make(place, _TEXT, (0,), (_TABLE_CHUNK,), (SEQUENCE,), texts)
    make(f"{UNFINISHED}/modes", _CODE, shape, chunk, dims, {})
    for name in _sweep_variables(plan):
        kind, words = _OWN[name]
        unit = plan.named(TIME) if name == "t_end" else {}
        make(name, kind, shape, chunk, dims, {**unit, **words})
