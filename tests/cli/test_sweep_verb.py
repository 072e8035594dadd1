"""`statechart sweep`: output, files and refusals."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from runs import without_compilation

from statechart.cli.main import main

STICK = "toppling_stick"
OVER = ("--over", "mu=log:0.05:50:6", "--over", "I_G=0,1/3,1")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The store of a sweep that was not interrupted."""
    store = tmp_path_factory.mktemp("sweep") / "whole.zarr"
    assert main(["sweep", STICK, *OVER, "-o", str(store)]) == 0
    return store


def test_a_sweep_prints_a_summary(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", STICK, *OVER]) == 0
    reported = capsys.readouterr().out
    assert "mu (6 from 0.05 to 50), I_G (3 from 0 to 1)" in reported
    assert "18 cells, 18 certified" in reported
    assert "STOPPED" in reported
    assert "pin > slide- > slide+" in reported


def test_a_sweep_is_one_object_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", STICK, "--over", "mu=0.2,inf", "--outputs", "t_impact", "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (reported["cells"], reported["done"], reported["certified"]) == (2, 2, 2)
    assert reported["over"]["mu"] == {"values": 2, "least": 0.2, "greatest": "inf"}
    assert list(reported["outputs"]) == ["t_impact"]
    assert reported["outcomes"][0]["outcome"] == "STOPPED"


@pytest.mark.parametrize("name", ["a.zarr", "deep/a.nc"])
def test_a_sweep_is_stored(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    assert main(["sweep", STICK, *OVER, "-o", str(file)]) == 0
    with xr.open_dataset(file, engine="scipy" if name.endswith("nc") else "zarr") as found:
        assert dict(found.sizes) == {"mu": 6, "I_G": 3, "sequence": found.sizes["sequence"]}
        assert (found["outcome"] == "STOPPED").all()
        assert np.isfinite(found["t_impact"]).all()


@pytest.mark.parametrize(
    ("suffix", "begins"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF")]
)
def test_a_sweep_is_drawn(tmp_path: Path, suffix: str, begins: bytes) -> None:
    picture = tmp_path / f"a.{suffix}"
    over = ["--over", "mu=log:0.05:50:6", "--outputs", "t_impact"]
    assert main(["sweep", STICK, *over, "--plot", str(picture)]) == 0
    assert picture.read_bytes().startswith(begins)


@pytest.mark.parametrize(
    ("over", "code"),
    [
        (["--over", "mu=log:0.05:50:5", "--over", "I_G=lin:0:1:5", "--over", "theta0=0.01"], 0),
        (["--over", "mu=log:0.05:50:5", "--over", "I_G=lin:-1:1:5"], 0),
        (["--over", "mu=0.1,1,inf"], 0),
        (["--over", "mu=log:0.05:50", "--over", "I_G=lin:-0.2:1", "--sobol", "16"], 0),
        (["--over", "mu=lin:-1:-0.5:3"], 1),
    ],
    ids=["fixed", "refused", "infinite", "samples", "none"],
)
def test_grids_samples_and_lists_are_drawn(tmp_path: Path, over: list[str], code: int) -> None:
    picture = tmp_path / "a.svg"
    asked = ["sweep", STICK, *over, "--outputs", "t_impact", "--plot", str(picture)]
    assert main(asked) == code
    assert picture.exists()


def test_address_without_scheduler_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        answering = threading.Thread(target=_answer, args=(server,))
        answering.start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        assert main(["sweep", STICK, "--over", "mu=1", "--scheduler", address]) == 2
        answering.join()
    said = capfd.readouterr().err
    assert said.startswith(f"no scheduler answers at {address}: ")
    assert len(said.splitlines()) == 1


def _answer(server: socket.socket) -> None:
    """Answer as a web server."""
    connection, _ = server.accept()
    with connection:
        connection.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n" * 10)


def test_lists_are_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    over = ["--over", "e=lin:0.2:0.8:9", "--outputs", "impact_times,bounces"]
    assert main(["sweep", "bouncing_ball_hills", *over, "--plot", str(picture)]) == 0
    assert picture.exists()


def test_cells_that_cannot_run_do_not_end_a_sweep(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "bouncing_ball", "--over", "k=0.5,1.5"]) == 0
    reported = capsys.readouterr().out
    assert "DECLARATION_ERROR" in reported
    assert "must be between 0 and 1, not 1.5" in reported


def test_a_sweep_in_which_no_cell_runs_fails() -> None:
    assert main(["sweep", "bouncing_ball", "--over", "k=1.5,2"]) == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "such as --over"),
        (["--over", "mu"], "is not of the form NAME=RANGE"),
        (["--over", "nu=1,2"], "no parameter 'nu'"),
        (["--over", "mu=lin:2:1:5"], "2 is above 1"),
        (["--over", "mu=log:-1:1:5"], "no logarithm"),
        (["--over", "mu=1", "--over", "mu=2"], "given twice"),
        (["--over", "mu=1", "--outputs", "nothing"], "no output 'nothing'"),
        (["--over", "mu=1", "--samples", "a.csv"], "exclude each other"),
        (["--samples", "none.csv"], "none.csv: no such file"),
        (["--samples", "/dev/zero"], "/dev/zero: not a file; name a CSV file"),
        (["--sobol", "8", "--over", "mu=1,2"], "no interval"),
        (["--over", "mu=1", "-o", "a.txt"], "the suffix must be"),
        (["--over", "mu=1", "-o", "here.nc"], "exists already"),
        (["--over", "mu=1", "-o", "here.nc/a.nc"], "is a file"),
        (["--over", "mu=1", "-o", "here.zarr"], "exists already"),
        (["--over", "mu=1", "-o", "file.zarr"], "file.zarr is no sweep store; name another, or"),
        (["--over", "mu=1", "-o", "here.zarr", "--resume"], "no sweep store"),
        (["--over", "mu=1", "--resume"], "-o STORE.zarr"),
        (["--over", "mu=1", "--plot", "a.txt"], "the suffix must be one of"),
        (["--over", "mu=1,2", "--over", "I_G=1,2", "--over", "L=1,2", "--plot", "a.png"], "one or"),
        (["--over", "mu=1", "--plot", "a.png"], "give one several values"),
        (["--over", "mu=lin:0:1:10000000", "--workers", "1000000"], "too many for"),
        (["--over", "mu=1", "--engine", "impulse"], "step"),
        (["--over", "mu=1", "--scheduler", "tcp://127.0.0.1:1"], "no scheduler answers"),
        (["--over", "mu=1", "--scheduler", "nowhere"], "no scheduler answers"),
    ],
)
def test_wrong_input_is_one_message(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("statechart.sweeps.workers._SCHEDULER_TIMEOUT", 1.0)
    (tmp_path / "here.nc").write_text("")
    (tmp_path / "file.zarr").write_text("")
    (tmp_path / "here.zarr").mkdir()
    (tmp_path / "here.zarr" / "notes.txt").write_text("")
    assert main(["sweep", STICK, *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert words in captured.err
    assert "Traceback" not in captured.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file.zarr", "here.nc", "here.zarr"]


_KILLED = """
import os, signal, sys
from statechart.cli import main
from statechart.sweeps import sweep
from statechart.sweeps.cells import run_block

sweep._BLOCK = sweep._WRITE_INTERVAL = 0.0
calls, number = [], getattr(signal, sys.argv.pop())

def run(task, rows):
    calls.append(1)
    if len(calls) == 5:
        os.kill(os.getpid(), number)
    return run_block(task, rows)

sweep.run_block = run
sys.exit(main.program())
"""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX")
@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM", "SIGHUP", "SIGKILL"])
def test_terminated_sweep_resumes(tmp_path: Path, whole: Path, number: str) -> None:
    store = tmp_path / "a.zarr"
    arguments = ["sweep", STICK, *OVER, "-o"]
    ended = subprocess.run(
        [sys.executable, "-c", _KILLED, *arguments, str(store), number],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in ended.stderr
    if number == "SIGKILL":
        assert ended.returncode == -signal.SIGKILL
    else:
        said = without_compilation(ended.stderr)
        assert (ended.returncode, said) == (1, "interrupted; --resume goes on\n")
        assert "4 of 18 cells" in ended.stdout or "5 of 18 cells" in ended.stdout
    with xr.open_zarr(store, chunks=None) as part:
        assert 4 <= (part["outcome"].to_numpy() != "").sum() <= 5
    assert main([*arguments, str(store), "--resume"]) == 0
    same(store, whole)


def same(one: Path, other: Path) -> None:
    with xr.open_zarr(one, chunks=None) as a, xr.open_zarr(other, chunks=None) as b:
        xr.testing.assert_identical(a.drop_vars("seconds").load(), b.drop_vars("seconds").load())


def test_processes_give_the_same_bits(tmp_path: Path, whole: Path) -> None:
    assert main(["sweep", STICK, *OVER, "-o", str(tmp_path / "two.zarr"), "--workers", "2"]) == 0
    same(whole, tmp_path / "two.zarr")


def test_no_more_processes_than_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int | None] = []

    @contextmanager
    def crew(count: int | None, address: str | None) -> Iterator[None]:
        asked.append(count)
        yield

    monkeypatch.setattr("statechart.sweeps.workers.crew", crew)
    for workers in (["--workers", "1000"], ["--workers", "1"], []):
        assert main(["sweep", STICK, "--over", "mu=1,2", "--outputs", "t_impact", *workers]) == 0
    assert asked == [2, 1, None]


_DEAD = """
import os, signal, sys
from statechart.cli import main
from statechart.sweeps import sweep
import dead

sweep._FIRST_BLOCKS, sweep._BLOCK, sweep.run_block = 1, 0.0, dead.run
if __name__ == "__main__":
    sys.exit(main.program())
"""
_RUN = """
import os, signal
from statechart.sweeps.cells import run_block

calls = []

def run(task, rows):
    calls.append(1)
    if len(calls) == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return run_block(task, rows)
"""


def test_a_killed_worker_loses_no_finished_cells(tmp_path: Path, whole: Path) -> None:
    (tmp_path / "dead.py").write_text(_RUN)
    (tmp_path / "main.py").write_text(_DEAD)
    store = tmp_path / "a.zarr"
    arguments = ["sweep", STICK, *OVER, "-o", str(store)]
    ended = subprocess.run(
        [sys.executable, tmp_path / "main.py", *arguments, "--workers", "1"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1].startswith("workers died: ")
    assert ended.stderr.endswith("; --resume goes on\n")
    assert "Traceback" not in ended.stderr
    with xr.open_zarr(store, chunks=None) as part:
        assert (part["outcome"].to_numpy() != "").sum() == 2
    assert main([*arguments, "--resume"]) == 0
    same(store, whole)
