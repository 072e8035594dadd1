"""Running every cell of a sweep: blocks handed out, here or to workers, and kept as they return."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart import interrupts
from statechart.arrays import Array
from statechart.documents.declaration import Declaration
from statechart.documents.document import Document
from statechart.documents.hints import checked
from statechart.documents.setting import Setting
from statechart.errors import DeclarationError, StatechartError
from statechart.running.runner import Runner
from statechart.sweeps.block import Block, run_block
from statechart.sweeps.claim import claimed
from statechart.sweeps.plan import Plan, Tile, of_table
from statechart.sweeps.progress import told
from statechart.sweeps.store import Store
from statechart.sweeps.workers import Watch, unguarded

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

# Seconds that a block takes: much longer than handing it out, much shorter than people wait.
_BLOCK = 0.25
_MOST_CELLS = 4096
# What is handed out is no more than one part in so many of what is left, down to so many cells:
# workers come to their end together, and cells of one compiled call are worth it.
_PARTS, _FEWEST = 16, 64
# Seconds between what is written; a kill loses no more.
_WRITTEN = 4.0
# Blocks handed out at first, and at most; each that returns makes room for one more.
_FIRST, _MOST = 64, 2048
# Seconds between looks for a signal while workers work.
_LOOK = 0.1
INTERRUPTED = "interrupted"
"""What ended a sweep that a signal ended."""


@dataclass(frozen=True)
class Made:
    """A sweep as far as it has come.

    Attributes
    ----------
    plan : Plan
        The cells.
    store : Store
        What they gave.
    ended : str
        Why not all of them are done; else empty.
    """

    plan: Plan
    store: Store
    ended: str

    def dataset(self) -> xr.Dataset:
        """Return what the cells gave, why it is not all of it among the attributes."""
        return self._told(self.store.dataset())

    def loaded(self) -> xr.Dataset:
        """Return the same, read from the store."""
        return self._told(self.store.loaded())

    def _told(self, found: xr.Dataset) -> xr.Dataset:
        return found.assign_attrs(ended=self.ended) if self.ended else found


# One argument for every word of a setting, as `Runner`.
@checked
def sweep(
    model: Declaration | Document | str | Path,
    over: Mapping[str, Sequence[float] | Array] | None = None,
    *,
    samples: pd.DataFrame | None = None,
    outputs: Sequence[str] | None = None,
    until: float | None = None,
    engine: str | None = None,
    method: str | None = None,
    tolerance: float | None = None,
    accuracy: float | None = None,
    step: float | None = None,
    max_step: float | None = None,
    executor: Executor | None = None,
    store: Path | str | None = None,
    resume: bool = False,
    progress: bool = False,
) -> xr.Dataset:
    """Run a model at many values of its parameters.

    Parameters
    ----------
    model : Declaration, Document, str or Path
        A model, a file, or the name of a shipped model.
    over : mapping of str to (n,) array
        Parameter -> its values; every value is combined with all of the others.
    samples : DataFrame, optional
        In the place of `over`: a column for every parameter, a row for every run.
    outputs : sequence of str, optional
        Outputs of the model to compute; all by default.
    until : float, optional
        End of the runs; `stop.time` of the model by default.
    engine, method, tolerance, accuracy, step, max_step
        As for `Runner`.
    executor : concurrent.futures.Executor, optional
        What runs blocks of cells: processes, or `client.get_executor()` of a Dask cluster; this
        process by default.
    store : Path or str, optional
        Where to keep the result, in Zarr, block by block; in memory by default.
    resume : bool
        Go on with the sweep that the store holds, if it does.
    progress : bool
        Whether to report to stderr.

    Returns
    -------
    Dataset
        Over the swept parameters, or over `sample`: the outputs (a list is padded with not a
        number along its own dimension, and `NAME_count` says how many values there are),
        `outcome` (empty where a cell has not run) and `message`, `certified`, `modes` (a place
        along `sequence`, or -1), `t_end`, `seconds`, and with an accuracy `error_estimate`. A
        cell that cannot run has an outcome that says so. Its attribute `complete` is 0 where the
        sweep was interrupted.

    Raises
    ------
    DeclarationError
        If the model, a parameter, a value or a setting is wrong, the store holds something else,
        or another process writes it.
    StatechartError
        If workers died, or the store cannot be written.

    Examples
    --------
    >>> found = sweep("bouncing_ball", {"k": [0.5, 0.7]}, outputs=["t_rest"])
    >>> dict(found.sizes)
    {'k': 2, 'sequence': 1}
    """
    setting = Setting(engine, method, tolerance, accuracy, step, None, max_step)
    plan = planned(model, over, samples, setting, until=until, outputs=outputs)
    made = make(plan, executor, store=store, resume=resume, progress=progress)
    if made.ended and made.ended != INTERRUPTED:
        raise StatechartError(made.ended)
    return made.dataset()


def planned(
    model: Declaration | Document | str | Path,
    over: Mapping[str, Sequence[float] | Array] | None,
    samples: pd.DataFrame | None,
    setting: Setting,
    *,
    until: float | None = None,
    outputs: Sequence[str] | None = None,
) -> Plan:
    """Return a sweep that can be run; see `sweep` for the parameters.

    Raises
    ------
    DeclarationError
        If something that is asked for is wrong.
    """
    if (over is None) == (samples is None):
        raise DeclarationError("a sweep is over ranges or over samples: give one of them")
    if over is not None and not isinstance(over, Mapping):
        raise DeclarationError(
            f"a sweep is over parameters and their values, not {over!r}",
            advice="such as over={'mu': [0.1, 0.2, 0.3]}",
        )
    runner = Runner(model, **asdict(setting))
    if until is not None or runner.model.stop.time is None:
        runner.end(until=until)
    columns = over if samples is None else of_table(samples)
    return Plan(
        runner.model,
        setting,
        columns or {},
        grid=samples is None,
        until=until,
        outputs=outputs,
        accurate=runner.setting.accuracy is not None,
    )


def make(
    plan: Plan,
    executor: Executor | None = None,
    *,
    store: Path | str | None = None,
    resume: bool = False,
    progress: bool = False,
) -> Made:
    """Run the cells of a sweep that are not done; see `sweep` for the parameters.

    Raises
    ------
    DeclarationError
        If the store holds something else, or another process writes it, there is none to resume, or
        no worker has this package.
    StatechartError
        If the store cannot be written.
    """
    if resume and store is None:
        raise DeclarationError("there is no store to resume", advice="name the one that was begun")
    with nullcontext() if store is None else claimed(Path(store)) as claim:
        kept = Store(plan, store, resume=resume, claim=claim)
        left = kept.left
        try:
            with interrupts.held(), told(plan.size, plan.size - left, shown=progress) as tell:
                work = _Work(plan, kept, tell, shared=executor is not None)
                ended = _ended(work, executor)
                kept.finish()
        except StatechartError:
            if kept.left == left:
                kept.discard()
            raise
        return Made(plan, kept, ended)


def _ended(work: _Work, executor: Executor | None) -> str:
    """Do the work; return why not all of it is done, else an empty text.

    Raises
    ------
    StatechartError
        If none of it could be done.
    """
    try:
        if executor is None:
            _run_here(work)
        else:
            _hand_out(work, executor)
    except KeyboardInterrupt:
        return INTERRUPTED
    except _Lost as lost:
        if not work.done:
            raise lost.error from None
        return str(lost.error)
    finally:
        work.write()
    return ""


class _Lost(Exception):  # noqa: N818 - it is workers that are lost
    """Workers cannot go on."""

    def __init__(self, error: StatechartError) -> None:
        super().__init__(str(error))
        self.error = error


@dataclass
class _Chunk:
    """A chunk that is worked on."""

    tile: Tile
    block: Block
    left: int
    written: bool = True


class _Job(NamedTuple):
    """Cells of a chunk that are handed out together."""

    chunk: _Chunk
    places: NDArray[np.intp]
    rows: Array


class _Work:
    """The cells that are not done yet, and those whose results are not written yet."""

    def __init__(
        self, plan: Plan, store: Store, tell: Callable[[int], None], *, shared: bool
    ) -> None:
        self._plan, self._store, self._tell = plan, store, tell
        self._left, self._shared = store.left, shared
        self._open: list[_Chunk] = []
        self._parts = self._cells()
        self._size, self.done = 1, 0
        self._written_at = time.monotonic()
        self.task = plan.task
        next(self._parts)

    def next(self) -> _Job | None:
        """Return the next cells to run, as many as take a moment."""
        size = self._size
        if self._shared:
            size = min(size, max(self._left // _PARTS, _FEWEST))
        try:
            job = self._parts.send(size)
        except StopIteration:
            return None
        assert job is not None
        self._left -= len(job.places)
        return job

    def _cells(self) -> Generator[_Job | None, int, None]:
        """Yield as many cells of a chunk as are sent for."""
        size = yield None
        for tile in self._plan.tiles():
            places = self._store.undone(tile)
            if not places.size:
                continue
            chunk = _Chunk(tile, self._store.begun(tile), len(places))
            self._open.append(chunk)
            while places.size:
                part, places = places[:size], places[size:]
                size = yield _Job(chunk, part, self._plan.rows(tile, part))

    def take(self, job: _Job, block: Block) -> None:
        """Take what cells gave; write it, if that is due."""
        chunk = job.chunk
        chunk.block.take(job.places, block, self._store.coded(block))
        chunk.left -= len(job.places)
        self.done += len(job.places)
        chunk.written = False
        # Not the mean: a cell that compiles takes a thousand times as long as others.
        each = max(float(np.median(block.seconds)), 1e-9)
        self._size = int(np.clip(_BLOCK / each, 1, _MOST_CELLS))
        if time.monotonic() - self._written_at > _WRITTEN:
            self.write()
        self._tell(len(job.places))

    def write(self) -> None:
        """Write what is not written."""
        for chunk in self._open:
            if not chunk.written:
                self._store.write(chunk.tile, chunk.block)
                chunk.written = True
        self._open = [chunk for chunk in self._open if chunk.left]
        self._written_at = time.monotonic()


def _run_here(work: _Work) -> None:
    while (job := work.next()) is not None:
        interrupts.check()
        work.take(job, run_block(work.task, job.rows))


def _hand_out(work: _Work, executor: Executor) -> None:
    """Let an executor run blocks; what is handed out grows with what returns."""
    pending: dict[Future[Block], _Job] = {}
    room, watch = _FIRST, Watch(executor)
    try:
        while True:
            while len(pending) < room and (job := work.next()) is not None:
                pending[executor.submit(run_block, work.task, job.rows)] = job
            if not pending:
                return
            returned, _ = wait_for(pending, timeout=_LOOK, return_when=FIRST_COMPLETED)
            interrupts.check()
            watch.look(bool(returned))
            for future in returned:
                work.take(pending.pop(future), future.result())
                room = min(room + 1, _MOST)
    except (KeyboardInterrupt, StatechartError, MemoryError):
        raise
    except ImportError as error:
        raise _Lost(
            DeclarationError(
                f"a worker cannot load what the sweep needs: {error}",
                advice="install this package, in this version, on all workers",
            )
        ) from None
    except (BrokenExecutor, CancelledError) as error:
        words = str(error).strip().rstrip(".") or "the connection to them was lost"
        advice = "" if work.done else unguarded(error)
        raise _Lost(StatechartError(f"workers died: {words}{advice}")) from None
    except Exception as error:  # whatever an executor makes of workers that fail
        problem = f"workers failed, {type(error).__name__}: {error}"
        raise _Lost(StatechartError(problem)) from None
    finally:
        for future in pending:
            future.cancel()
