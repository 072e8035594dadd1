"""What the cells of a sweep gave, in Zarr: on disk, where a sweep goes on from, or in memory.

A cell is done where its outcome is not empty, which is written after all else of its chunk. Modes
are coded in the order in which their sequences come in; once all cells are done they are coded
anew in the order of the cells, so that nothing in a store tells in what order it was made.
"""

from __future__ import annotations

import itertools
import math
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array, Ints32
from statechart.errors import DeclarationError, StatechartError
from statechart.sweeps.block import Block
from statechart.sweeps.chunks import ALL, lost
from statechart.sweeps.claim import Claim
from statechart.sweeps.plan import Plan, Slices, Tile
from statechart.sweeps.variables import OWN, SEQUENCE, UNFINISHED, create

if TYPE_CHECKING:
    import xarray as xr
    import zarr

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
        self._written = 0  # of their texts
        self._arrays: dict[str, zarr.Array[Any]] = {}
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
                    self._array(f"{UNFINISHED}/modes")[where] = column.reshape(tile.shape)
                self._array(name)[where] = column.reshape(tile.shape)
        self._done[where] = (block.outcome != "").reshape(tile.shape)

    def finish(self) -> None:
        """Code modes in the order of the cells, if all cells are done."""
        if self.left or self._complete:
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
            # Chunk by chunk: what is written is what stays in memory.
            for tile in self._plan.tiles():
                part = self._read(f"{UNFINISHED}/modes", tile.slices)
                self._array("modes")[tile.slices] = codes[part]
            self._group.attrs["complete"] = 1
            del self._group[UNFINISHED]
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
        texts = self._read(SEQUENCE)
        if not self._complete:
            if UNFINISHED not in self._group:
                raise self._damaged(UNFINISHED)
            texts = self._read(f"{UNFINISHED}/{SEQUENCE}")
        # There may be room for more, of a process that ended before it wrote them.
        known = itertools.takewhile(bool, map(str, texts))
        self._codes = {text: code for code, text in enumerate(known)}

    def _check_whole(self) -> None:
        """Raise `DeclarationError` where what cells gave is not there, or a text of their modes."""
        plan, root, complete = self._plan, self._path, self._complete
        assert root is not None
        modes = "modes" if complete else f"{UNFINISHED}/modes"
        names = [name for name, _ in self._named(Block.empty(0, plan.numbers, ()))]
        counts = {plan.variables[name]: f"{plan.variables[name]}_count" for name in plan.lists}
        for tile in plan.tiles():
            if not (complete or self._done[tile.slices].any()):
                continue
            parts = dict.fromkeys([modes, *names, *sorted(counts.values())], tile.slices)
            for name, count in sorted(counts.items()):
                longest = int(self._read(count, tile.slices).max())
                parts[name] = (*tile.slices, slice(0, longest))
            for name, where in parts.items():
                if file := lost(root, self._array(name), where):
                    raise self._damaged(file, "is missing")
            if self._read(modes, tile.slices).max() >= len(self._codes):
                raise self._damaged(SEQUENCE)
        if complete and (root / UNFINISHED).exists():  # of a process that was removing it
            shutil.rmtree(root / UNFINISHED)
            self._consolidate()

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
        told = {**self._plan.attributes(), "complete": 0}
        self._group = group = zarr.create_group(where, attributes=told)
        with zarr.config.set(ALL):
            create(group, self._plan)
        self._consolidate()
        return group

    def _named(self, block: Block) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield variables of one value a cell with their values (n,), the outcome last."""
        for name, values in block.numbers.items():
            yield self._plan.variables[name], values
        for name in OWN:
            if name != "error_estimate" or self._plan.accurate:
                yield name, getattr(block, name)

    def _table(self) -> None:
        """Write the texts of sequences that are new."""
        if len(self._codes) == self._written:
            return
        # First where a sweep goes on from: a code without a text would be lost there.
        for place in (f"{UNFINISHED}/{SEQUENCE}", SEQUENCE):
            self._fill(self._array(place), list(self._codes), self._written)
        self._written = len(self._codes)
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

            with self._whole(name), zarr.config.set(ALL):
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

    def _damaged(self, name: str, words: str = "cannot be read") -> DeclarationError:
        return DeclarationError(
            f"{self._path} is damaged: {name} {words}",
            advice="remove it, and begin the sweep anew",
        )

    def _problem(self, verb: str, error: OSError) -> StatechartError:
        return StatechartError(f"cannot {verb} {self._path}: {error.strerror or error}")
