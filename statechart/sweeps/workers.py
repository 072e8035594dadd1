"""Workers of a sweep: local processes or a Dask cluster."""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart import compiling
from statechart.errors import DeclarationError

if TYPE_CHECKING:
    from concurrent.futures import Future
    from multiprocessing.synchronize import Semaphore

_SCHEDULER_TIMEOUT = 10.0  # seconds
# Processes per processor; each costs 150 MB.
_MAX_PROCESSES = 16
# Seconds between checks for workers of a cluster, and until a cluster without workers fails.
_POLL_INTERVAL, _PATIENCE = 5.0, 60.0
_NAME = "contact-statecharts"


def crew(count: int | None, address: str | None) -> AbstractContextManager[Executor | None]:
    """Start `count` processes, or connect to the scheduler at an address; None for neither."""
    if count is not None:
        return processes(count)
    return nullcontext() if address is None else cluster(address)


@contextmanager
def processes(count: int) -> Iterator[Executor]:
    """Start worker processes, which end with this one."""
    here = os.cpu_count() or 1
    if count > _MAX_PROCESSES * here:
        advice = f"write --workers {here}, or take more machines with --scheduler"
        raise DeclarationError(f"{count} workers are too many for {here} processors", advice=advice)
    # Not forked, since threads of libraries do not survive that.
    context = multiprocessing.get_context("spawn")
    before = set(multiprocessing.active_children())
    # One worker announces the compilation.
    says = context.Semaphore(1) if compiling.announced() else None
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=(says,))
    try:
        with _block_signals():
            started: list[Future[str]] = [pool.submit(version, _NAME) for _ in range(count)]
        del started
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()


def guard_advice(error: Exception) -> str:
    """Return advice if workers died because the main script has no guard; else nothing."""
    file = getattr(sys.modules["__main__"], "__file__", None)
    if not isinstance(error, BrokenProcessPool) or file is None:
        return ""
    with suppress(OSError, UnicodeDecodeError):
        if "__name__" not in Path(file).read_text(encoding="utf-8"):
            return (
                f'; processes import the script that makes them: write `if __name__ == "__main__":`'
                f" in {Path(file).name} before what it does, and indent that"
            )
    return ""


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Connect to the scheduler of a Dask cluster."""
    try:
        from distributed import Client
    except ImportError:
        message = "a cluster needs Dask, which is not installed"
        advice = "install it with: pip install 'distributed>=2024.8'"
        raise DeclarationError(message, advice=advice) from None
    # A Dask client without a scheduler would retry, and log errors when deleted.
    try:
        kind = asyncio.run(asyncio.wait_for(_identity(address), _SCHEDULER_TIMEOUT))
    except (OSError, ValueError) as error:
        raise _silence(address, str(error) or "it took too long") from None
    except Exception:  # the answer of another program
        raise _silence(address, "another program listens there") from None
    if kind != "Scheduler":
        raise _silence(address, f"there is a {kind}")
    client = Client(address, timeout=_SCHEDULER_TIMEOUT, set_as_default=False)
    try:
        _check(client, address)
        yield client.get_executor()
    finally:
        client.close(timeout=_SCHEDULER_TIMEOUT)


class ClusterWatch:
    """Checks that a cluster has workers, since Dask waits for new ones for ever."""

    def __init__(self, executor: Executor) -> None:
        self._client: Any = getattr(executor, "_client", None)
        self._last_check, self._last_seen = -math.inf, math.inf

    def check(self, returned: bool) -> None:
        """Raise `BrokenExecutor` if nothing `returned` and no worker existed for a minute."""
        now = time.monotonic()
        if returned:
            self._last_seen = now
        elif "distributed" in sys.modules and now - self._last_check > _POLL_INTERVAL:
            self._last_check = now
            self._ask()

    def worker_left(self, future: Future[Any]) -> bool:
        """Return whether a worker left just after it returned a result, so that the cell is rerun.

        `distributed` reads the status of a task after its result (`_cascade_future` of its
        executor), and unpacks the result of a task lost meanwhile like an error.
        """
        error = None if self._client is None or future.cancelled() else future.exception()
        return isinstance(error, TypeError) and "cannot unpack non-iterable" in str(error)

    def _ask(self) -> None:
        from distributed import Client

        if not isinstance(self._client, Client):
            return
        client = self._client
        with suppress(OSError):  # its scheduler does not answer
            if client.sync(client.scheduler.ncores, callback_timeout=_SCHEDULER_TIMEOUT):
                self._last_seen = self._last_check
        if self._last_check - self._last_seen > _PATIENCE:
            raise BrokenExecutor(f"the cluster has had none for {_PATIENCE:g} s")


async def _identity(address: str) -> str:
    """Return what answers at an address: Scheduler, Worker or Nanny."""
    from distributed import rpc

    async with rpc(address) as there:
        return str((await there.identity())["type"])


def _silence(address: str, words: str) -> DeclarationError:
    message = f"no scheduler answers at {address}: " + words.strip().split("\n")[0]
    advice = "start one with `dask scheduler`; it prints its address, tcp://HOST:8786"
    return DeclarationError(message, advice=advice)


def _check(client: object, address: str) -> None:
    """Raise `DeclarationError` unless there are workers, and each can run a sweep."""
    from distributed import Client

    assert isinstance(client, Client)
    if not client.nthreads():
        advice = f"start some with `dask worker {address} --nthreads 1`"
        raise DeclarationError(f"the scheduler at {address} has no workers", advice=advice)
    try:
        found = client.run(version, _NAME)
    except PackageNotFoundError:
        message = f"a worker of {address} does not have {_NAME}"
        raise DeclarationError(message, advice="install it on all workers") from None
    here = version(_NAME)
    for worker, there in found.items():
        if there != here:
            message = f"the worker {worker} has version {there} of {_NAME}, not {here}"
            raise DeclarationError(message, advice="install the same version on all workers")


@contextmanager
def _block_signals() -> Iterator[None]:
    """Block terminal signals in processes started meanwhile; this process ends its workers."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(says: Semaphore | None) -> None:
    """Initialise a worker; it ends when its parent process is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if says is not None and says.acquire(block=False):
        compiling.announce(compiling.StderrLine())
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
