"""Workers: processes and Dask clusters, those that die and those that cannot run sweeps."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from statechart import sweep
from statechart.errors import DeclarationError, StatechartError
from statechart.sweeps import sweep as sweeps
from statechart.sweeps import workers
from statechart.sweeps.workers import cluster, crew, processes

distributed = pytest.importorskip("distributed")
# Warning of tornado's event loop, which its threads close.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")

STICK = "toppling_stick"
GRID = {"mu": np.geomspace(0.05, 50.0, 6), "I_G": np.array([0.0, 1 / 3, 1.0])}


@pytest.fixture(scope="module")
def machines() -> Iterator[Any]:
    """Two workers, each a process of its own that is started again when it dies."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", processes=True
    ) as made:
        yield made


def same(one: xr.Dataset, other: xr.Dataset) -> None:
    one, other = one.drop_vars("seconds").load(), other.drop_vars("seconds").load()
    xr.testing.assert_identical(one, other)


def test_a_cluster_loses_no_cells_with_a_worker(
    machines: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweeps, "_FIRST_BLOCKS", 4)
    monkeypatch.setattr(sweeps, "_BLOCK", 0.0)
    address, killed = machines.scheduler_address, []

    class Killing(Executor):
        """Kills a worker of a cluster when some blocks are done, and others are handed out."""

        def __init__(self, client: Any) -> None:
            self._client, self._inner, self._calls = client, client.get_executor(), 0

        def submit(self, work: Any, /, *values: Any, **options: Any) -> Any:
            self._calls += 1
            if self._calls == 9:
                pids = self._client.run(os.getpid)
                killed.extend(list(pids.values())[:1])
                os.kill(killed[0], signal.SIGKILL)
            return self._inner.submit(work, *values, **options)

    with distributed.Client(address, set_as_default=False) as client:
        found = sweep(STICK, GRID, executor=Killing(client), store=tmp_path / "a.zarr").load()
    assert killed
    assert found.attrs["complete"] == 1
    same(found, sweep(STICK, GRID))


def test_a_cluster_without_workers_is_reported_and_the_sweep_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sweeps, "_FIRST_BLOCKS", 2)
    monkeypatch.setattr(sweeps, "_BLOCK", 0.0)
    monkeypatch.setattr(workers, "_POLL_INTERVAL", 0.1)
    monkeypatch.setattr(workers, "_PATIENCE", 1.0)
    store = tmp_path / "a.zarr"
    with (
        distributed.LocalCluster(n_workers=1, dashboard_address=":0", processes=False) as made,
        distributed.Client(made, set_as_default=False) as client,
    ):

        class Leaving(Executor):
            """Closes all workers of a cluster when some blocks are done."""

            def __init__(self) -> None:
                self._client, self._calls = client, 0

            def submit(self, work: Any, /, *values: Any, **options: Any) -> Any:
                self._calls += 1
                if self._calls == 5:
                    made.scale(0)
                    while client.nthreads():
                        pass
                return client.get_executor().submit(work, *values, **options)

        with pytest.raises(StatechartError, match="workers died: the cluster has had none for 1 s"):
            sweep(STICK, GRID, executor=Leaving(), store=store)
    with xr.open_zarr(store, chunks=None) as part:
        assert 0 < (part["outcome"] != "").sum() < 18
    same(sweep(STICK, GRID, store=store, resume=True), sweep(STICK, GRID))


def test_a_cluster_is_reached_by_its_address(machines: Any) -> None:
    with cluster(machines.scheduler_address) as executor:
        same(sweep(STICK, GRID, executor=executor), sweep(STICK, GRID))


def test_a_cluster_without_workers_is_refused() -> None:
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0", processes=False) as empty,
        pytest.raises(DeclarationError, match="has no workers"),
        cluster(empty.scheduler_address),
    ):
        raise AssertionError


def _bare(tmp_path: Path, code: str) -> dict[str, str]:
    """Return the environment of a process that runs some code before all else."""
    (tmp_path / "sitecustomize.py").write_text(textwrap.dedent(code))
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


_WITHOUT = """
    import importlib.metadata

    def version(name):
        if name == "contact-statecharts":
            raise importlib.metadata.PackageNotFoundError(name)
        return real(name)

    real, importlib.metadata.version = importlib.metadata.version, version
"""
_OLDER = """
    import importlib.metadata

    def version(name):
        return "0.0.1" if name == "contact-statecharts" else real(name)

    real, importlib.metadata.version = importlib.metadata.version, version
"""


@pytest.mark.parametrize(
    ("code", "words"),
    [(_WITHOUT, "does not have contact-statecharts"), (_OLDER, "has version 0.0.1 of")],
)
def test_a_worker_that_cannot_run_sweeps_is_refused(tmp_path: Path, code: str, words: str) -> None:
    with distributed.LocalCluster(n_workers=0, dashboard_address=":0", processes=True) as empty:
        address = empty.scheduler_address
        worker = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", address, "--no-dashboard",
             "--no-nanny", "--local-directory", str(tmp_path)],
            env=_bare(tmp_path, code),
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            with distributed.Client(address, set_as_default=False) as client:
                client.wait_for_workers(1, timeout=60)
            with pytest.raises(DeclarationError, match=words), cluster(address):
                raise AssertionError
        finally:
            worker.terminate()
            worker.wait()


def test_processes_run_a_sweep_and_end() -> None:
    with processes(2) as executor:
        pids = {executor.submit(os.getpid).result() for _ in range(20)}
        same(sweep(STICK, GRID, executor=executor), sweep(STICK, GRID))
    for pid in pids:
        _gone(pid)


def _gone(pid: int) -> None:
    """Wait until a process has ended."""
    import time

    for _ in range(600):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        state = Path(f"/proc/{pid}/stat")
        if state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z":
            return
        time.sleep(0.1)
    raise AssertionError(f"{pid} is still there")


_COMPILING = """
import time

from statechart import compiling
from statechart.sweeps.workers import processes

def work(number):
    compiling._AFTER = 0.0
    time.sleep(0.01)
    with compiling.whole("a kernel"):
        pass

if __name__ == "__main__":
    compiling.announce(compiling.StderrLine())
    with processes(2) as executor:
        for done in [executor.submit(work, k) for k in range(50)]:
            done.result()
        print("all", len(executor._processes))
"""


def test_only_one_process_reports_compilations(tmp_path: Path) -> None:
    script = tmp_path / "compiling.py"
    script.write_text(_COMPILING)
    said = subprocess.run([sys.executable, script], capture_output=True, text=True, check=True)
    assert said.stdout == "all 2\n"
    assert said.stderr.count("compiled a kernel in 0 s") == 1


_ORPHANS = """
import os, signal
from statechart.sweeps.workers import processes

if __name__ == "__main__":
    with processes(1) as executor:
        print(executor.submit(os.getpid).result(), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    script = tmp_path / "orphans.py"
    script.write_text(_ORPHANS)
    said = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert said.returncode == -signal.SIGKILL
    _gone(int(said.stdout))


_UNGUARDED = """
from statechart import sweep
from statechart.errors import StatechartError
from statechart.sweeps.workers import processes

with processes(1) as executor:
    try:
        sweep("toppling_stick", {"mu": [0.2, 0.4]}, executor=executor)
    except StatechartError as error:
        print(error)
"""
_GUARDED = """
import os
from statechart import sweep
from statechart.errors import StatechartError
from statechart.sweeps.workers import processes

if __name__ == "__main__":
    with processes(1) as executor:
        executor.submit(os._exit, 1)
        try:
            sweep("toppling_stick", {"mu": [0.2, 0.4]}, executor=executor)
        except StatechartError as error:
            print(error)
"""


@pytest.mark.parametrize(("script", "advised"), [(_UNGUARDED, True), (_GUARDED, False)])
def test_a_script_that_its_processes_run_again_is_advised(
    tmp_path: Path, script: str, advised: bool
) -> None:
    file = tmp_path / "maps.py"
    file.write_text(script)
    said = subprocess.run([sys.executable, file], capture_output=True, text=True, check=True)
    assert said.stdout.startswith("workers died: ")
    advice = 'write `if __name__ == "__main__":` in maps.py before what it does, and indent that'
    assert (advice in said.stdout) == advised


def test_no_workers_are_requested_by_default() -> None:
    with crew(None, None) as executor:
        assert executor is None
