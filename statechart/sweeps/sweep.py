"""Sweep driver: distributes blocks of cells and stores their results."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import wait as wait_for
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Unpack, cast

import numpy as np
from numpy.typing import NDArray

from statechart import interrupts, progress
from statechart.arrays import Array
from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.documents.hints import check_arguments
from statechart.documents.setting import IntegrationWords, Setting
from statechart.documents.validation import Document
from statechart.errors import DeclarationError, StatechartError
from statechart.running.runner import Runner
from statechart.sweeps.cells import CellBlock, run_block
from statechart.sweeps.plan import Plan, Tile, columns_of
from statechart.sweeps.store import Store, lock_folder
from statechart.sweeps.workers import ClusterWatch, guard_advice
from statechart.tabular import pluralise

if TYPE_CHECKING:  # importing them takes half a second
    import pandas as pd
    import xarray as xr

_BLOCK = 0.25  # seconds of work in a block
_MAX_CELLS = 4096
# A block is at most 1/_PARTS of the remaining cells, so that workers finish together, but at least
# _MIN_CELLS, for efficient batches.
_PARTS, _MIN_CELLS = 16, 64
_WRITE_INTERVAL = 4.0  # seconds; a kill loses no more
_FIRST_BLOCKS, _MAX_BLOCKS = 64, 2048  # in flight, at first and at most
_POLL_INTERVAL = 0.1  # seconds between checks for a signal
_PROGRESS_INTERVAL = 10.0  # seconds between lines of progress without a terminal
INTERRUPTED = "interrupted"
"""`Sweep.ended` after a signal."""


class SweepWords(IntegrationWords, total=False):
    """Keyword arguments of the runs of a sweep."""

    until: float | None


@dataclass(frozen=True)
class Sweep:
    """State of a sweep: its store, and the reason why it is incomplete (else empty)."""

    store: Store
    ended: str

    def dataset(self, *, loaded: bool = False) -> xr.Dataset:
        """Return the results; attributes say why they are incomplete."""
        found = self.store.loaded() if loaded else self.store.dataset()
        return found.assign_attrs(ended=self.ended) if self.ended else found


@check_arguments
def sweep(
    model: Declaration | Document | str | Path,
    over: Mapping[str, Sequence[float] | Array] | None = None,
    *,
    samples: pd.DataFrame | None = None,
    outputs: Sequence[str] | None = None,
    executor: Executor | None = None,
    store: Path | str | None = None,
    resume: bool = False,
    progress: bool = False,
    **words: Unpack[SweepWords],
) -> xr.Dataset:
    """Run a model at many values of its parameters.

    Parameters
    ----------
    model : Declaration, Document, str or Path
        A model, a file, or the name of a shipped model.
    over : mapping of str to (n,) array
        Parameter -> its values, of which all combinations are run.
    samples : DataFrame, optional
        Instead of `over`: a column per parameter, a row per run.
    outputs : sequence of str, optional
        Outputs of the model to compute; all by default.
    executor : concurrent.futures.Executor, optional
        Runs blocks of cells: processes, or `client.get_executor()` of a Dask cluster; by default
        this process.
    store : Path or str, optional
        Zarr store of the result, by default in memory.
    resume : bool
        Whether to resume the sweep in the store.
    progress : bool
        Whether to report to stderr.
    until : float, optional
        End of the runs; `stop.time` of the model by default.
    engine, method, tolerance, accuracy, step, max_step
        As for `Runner`.

    Returns
    -------
    Dataset
        Over the swept parameters, or over `sample`: the outputs (a list is padded with NaN along
        its own dimension, with `NAME_count` values), `outcome` (empty for cells that did not run)
        and `message`, `certified`, `modes` (a place along `sequence`, or -1), `t_end`, `seconds`,
        and with an accuracy `error_estimate`. The attribute `complete` is 0 if the sweep was
        interrupted.

    Raises
    ------
    DeclarationError
        If the model, a parameter, a value or a setting is wrong, the store contains something else,
        or another process writes it.
    StatechartError
        If workers died, or the store cannot be written.

    Examples
    --------
    >>> found = sweep("bouncing_ball", {"k": [0.5, 0.7]}, outputs=["t_rest"])
    >>> dict(found.sizes)
    {'k': 2, 'sequence': 1}
    """
    until = words.pop("until", None)
    setting = Setting(**cast("IntegrationWords", words))
    plan = make_plan(model, over, samples, setting, until=until, outputs=outputs)
    made = run_plan(plan, executor, store=store, resume=resume, progress=progress)
    if made.ended and made.ended != INTERRUPTED:
        raise StatechartError(made.ended)
    return made.dataset()


def make_plan(
    model: Declaration | Document | str | Path,
    over: Mapping[str, Sequence[float] | Array] | None,
    samples: pd.DataFrame | None,
    setting: Setting,
    *,
    until: float | None = None,
    outputs: Sequence[str] | None = None,
) -> Plan:
    """Return the plan of a sweep; see `sweep` for the parameters."""
    if over is None and samples is None:
        advice = "such as over={'mu': [0.1, 0.2, 0.3]}, or samples=a table"
        raise DeclarationError("a sweep needs values of parameters", advice=advice)
    if over is not None and samples is not None:
        raise DeclarationError("give either ranges (over) or samples, not both")
    if over is not None and not isinstance(over, Mapping):
        raise DeclarationError(
            f"a sweep is over parameters and their values, not {over!r}",
            advice="such as over={'mu': [0.1, 0.2, 0.3]}",
        )
    runner = Runner(model, **asdict(setting))
    if until is not None or runner.model.stop.time is None:
        runner.end(until=until)
    columns = over if samples is None else columns_of(samples)
    accurate = runner.setting.accuracy is not None
    return Plan(
        runner.model, setting, columns or {}, grid=samples is None, until=until,
        outputs=outputs, accurate=accurate,
    )  # fmt: skip


def run_plan(
    plan: Plan,
    executor: Executor | None = None,
    *,
    store: Path | str | None = None,
    resume: bool = False,
    progress: bool = False,
) -> Sweep:
    """Run the undone cells of a sweep; see `sweep` for parameters and errors."""
    if resume and store is None:
        raise DeclarationError("there is no store to resume", advice="give its path")
    if executor is not None and not hasattr(executor, "submit"):
        message = f"executor must be an executor, such as ProcessPoolExecutor(4), not {executor!r}"
        raise DeclarationError(message)
    with nullcontext(lambda: None) if store is None else lock_folder(Path(store)) as check_lock:
        kept = Store(plan, store, resume=resume, check_lock=check_lock)
        left = kept.undone_count
        shown = _Progress(plan.size, plan.size - left) if progress else None
        try:
            with interrupts.deferred():
                work = _Work(plan, kept, shown, shared=executor is not None)
                ended = _ended(work, executor)
                kept.finish()
        except StatechartError:
            if kept.undone_count == left:
                kept.discard()
            raise
        finally:
            if shown is not None:
                shown.close()
        return Sweep(kept, ended)


class _Progress:
    """Progress on stderr, as a bar on a terminal, else as lines.

    The rate is measured since the first cells, which wait for processes to start, or since the last
    line, without compilation.
    """

    def __init__(self, total: int, done: int) -> None:
        self._total, self._done, self._said = total, done, -1
        self._shown, self._worked = time.monotonic(), working_time()
        self._display = progress.Display(total)
        self.close = self._display.close

    def advance(self, count: int) -> None:
        self._done += count
        now, worked = time.monotonic(), working_time()
        first = self._said < 0
        if first:
            self._worked, self._said = worked, self._done
        if not self._display.drawn and now - self._shown < _PROGRESS_INTERVAL:
            return
        words = f"{self._done} of {pluralise(self._total, 'cell')}"
        if not first:
            rate = (self._done - self._said) / max(worked - self._worked, 1e-9)
            left = timedelta(seconds=round((self._total - self._done) / rate))
            words += f", {rate:.3g} a second, {left} left"
        self._display.show(self._done, words)
        if not self._display.drawn:
            self._shown, self._worked, self._said = now, worked, self._done


def _ended(work: _Work, executor: Executor | None) -> str:
    """Run the cells; return why the sweep is incomplete, or an empty text."""
    try:
        if executor is None:
            while (job := work.next()) is not None:
                interrupts.check()
                work.take(job, run_block(work.task, job.parameters))
        else:
            _hand_out(work, executor)
    except KeyboardInterrupt:
        return INTERRUPTED
    except _WorkersFailed as lost:
        if not work.done:
            raise lost.args[0] from None
        return str(lost)
    finally:
        work.write()
    return ""


class _WorkersFailed(Exception):  # noqa: N818, said of the workers
    """The workers failed; the argument is the error."""


@dataclass
class _Chunk:
    """A chunk with running cells."""

    tile: Tile
    block: CellBlock
    left: int
    written: bool = True


class _Job(NamedTuple):
    """Cells of a chunk that one call runs."""

    chunk: _Chunk
    places: NDArray[np.intp]
    parameters: Array


class _Work:
    """Queue of undone cells, and the results not written yet."""

    def __init__(self, plan: Plan, store: Store, shown: _Progress | None, *, shared: bool) -> None:
        self._plan, self._store, self._shown = plan, store, shown
        self._left, self._shared = store.undone_count, shared
        self._open: list[_Chunk] = []
        self._parts = self._cells()
        self._size, self.done = 1, 0
        self._written_at = time.monotonic()
        self.task = plan.task
        next(self._parts)

    def next(self) -> _Job | None:
        """Return the next block, of about _BLOCK seconds."""
        size = self._size
        if self._shared:
            size = min(size, max(self._left // _PARTS, _MIN_CELLS))
        try:
            job = self._parts.send(size)
        except StopIteration:
            return None
        assert job is not None
        self._left -= len(job.places)
        return job

    def _cells(self) -> Generator[_Job | None, int, None]:
        size = yield None
        for tile in self._plan.tiles():
            places = self._store.undone(tile)
            if not places.size:
                continue
            chunk = _Chunk(tile, self._store.block(tile), len(places))
            self._open.append(chunk)
            while places.size:
                part, places = places[:size], places[size:]
                size = yield _Job(chunk, part, self._plan.parameter_values(tile, part))

    def take(self, job: _Job, block: CellBlock) -> None:
        """Store the results of cells; write them if due."""
        chunk = job.chunk
        chunk.block.take(job.places, block, self._store.codes(block))
        chunk.left -= len(job.places)
        self.done += len(job.places)
        chunk.written = False
        # The median, since a cell that compiles takes a thousand times as long as others.
        each = max(float(np.median(block.seconds)), 1e-9)
        self._size = int(np.clip(_BLOCK / each, 1, _MAX_CELLS))
        if time.monotonic() - self._written_at > _WRITE_INTERVAL:
            self.write()
        if self._shown is not None:
            self._shown.advance(len(job.places))

    def write(self) -> None:
        for chunk in self._open:
            if not chunk.written:
                self._store.write(chunk.tile, chunk.block)
                chunk.written = True
        self._open = [chunk for chunk in self._open if chunk.left]
        self._written_at = time.monotonic()


def _hand_out(work: _Work, executor: Executor) -> None:
    """Run blocks on an executor; each that returns increases their number in flight by one."""
    pending: dict[Future[CellBlock], _Job] = {}
    capacity, watch = _FIRST_BLOCKS, ClusterWatch(executor)
    try:
        while True:
            while len(pending) < capacity and (job := work.next()) is not None:
                pending[executor.submit(run_block, work.task, job.parameters)] = job
            if not pending:
                return
            returned, _ = wait_for(pending, timeout=_POLL_INTERVAL, return_when=FIRST_COMPLETED)
            interrupts.check()
            watch.check(bool(returned))
            for future in returned:
                job = pending.pop(future)
                if watch.worker_left(future):
                    pending[executor.submit(run_block, work.task, job.parameters)] = job
                    continue
                work.take(job, future.result())
                capacity = min(capacity + 1, _MAX_BLOCKS)
    except (KeyboardInterrupt, StatechartError, MemoryError):
        raise
    except ImportError as error:
        message = f"a worker cannot load what the sweep needs: {error}"
        advice = "install this package, in this version, on all workers"
        raise _WorkersFailed(DeclarationError(message, advice=advice)) from None
    except (BrokenExecutor, CancelledError) as error:
        words = str(error).strip().rstrip(".") or "the connection to them was lost"
        advice = "" if work.done else guard_advice(error)
        raise _WorkersFailed(StatechartError(f"workers died: {words}{advice}")) from None
    except Exception as error:  # executors raise various errors for failed workers
        problem = f"workers failed, {type(error).__name__}: {error}"
        raise _WorkersFailed(StatechartError(problem)) from None
    finally:
        for future in pending:
            future.cancel()
