"""Stores of sweeps: interrupted ones resume, others' files stay untouched."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
import zarr

from statechart import sweep
from statechart.cli.main import main
from statechart.errors import DeclarationError, StatechartError
from statechart.sweeps import plan as plans
from statechart.sweeps import store as stores
from statechart.sweeps import sweep as sweeps
from statechart.sweeps.cells import CellBlock, run_block
from statechart.sweeps.plan import Task
from statechart.sweeps.store import create, lock_folder

pytestmark = pytest.mark.usefixtures("default_signals")

STICK = "toppling_stick"
GRID = {"mu": np.geomspace(0.05, 50.0, 7), "I_G": np.array([0.0, 0.01, 1 / 3, 1.0])}
LISTS = {"e": [0.3, 0.7], "k": [0.0, 8.0, 12.0]}


def same(one: xr.Dataset, other: xr.Dataset) -> None:
    """All but the seconds are the same, to the last bit."""
    one, other = one.drop_vars("seconds").load(), other.drop_vars("seconds").load()
    xr.testing.assert_identical(one, other)


def interrupting(at: int) -> Callable[[Task, np.ndarray], CellBlock]:
    calls: list[int] = []

    def run(task: Task, rows: np.ndarray) -> CellBlock:
        calls.append(1)
        if len(calls) == at:
            signal.raise_signal(signal.SIGINT)
        return run_block(task, rows)

    return run


@pytest.mark.parametrize("tile", [4096, 5])
def test_an_interrupted_sweep_resumes_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tile: int
) -> None:
    whole, store = sweep(STICK, GRID, store=tmp_path / "whole.zarr"), tmp_path / "a.zarr"
    monkeypatch.setattr(plans, "_CHUNK", tile)
    monkeypatch.setattr(sweeps, "_BLOCK", 0.0)
    monkeypatch.setattr(sweeps, "_WRITE_INTERVAL", 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "run_block", interrupting(9))
        part = sweep(STICK, GRID, store=store)
    done = part["outcome"].to_numpy() != ""
    assert done.sum() == 8 or done.sum() == 9
    assert (part.attrs["complete"], part.attrs["ended"]) == (0, "interrupted")
    # The finished part can be read.
    with xr.open_zarr(store, chunks=None) as read:
        np.testing.assert_array_equal(
            read["t_end"].to_numpy()[done], whole["t_end"].to_numpy()[done]
        )
    same(sweep(STICK, GRID, store=store, resume=True), whole)
    same(xr.open_zarr(store, chunks=None), xr.open_zarr(tmp_path / "whole.zarr", chunks=None))
    # All is done: nothing runs.
    monkeypatch.setattr(sweeps, "run_block", None)
    same(sweep(STICK, GRID, store=store, resume=True), whole)


def test_lists_of_an_interrupted_sweep_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, store = "bouncing_ball_hills", tmp_path / "a.zarr"
    whole = sweep(model, LISTS)
    monkeypatch.setattr(sweeps, "_BLOCK", 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "run_block", interrupting(4))
        sweep(model, LISTS, store=store)
    same(sweep(model, LISTS, store=store, resume=True), whole)


def test_a_signal_reaches_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "run_block", interrupting(1))
    assert sweep(STICK, {"mu": [0.2]}).attrs["complete"] == 0
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "exists already"),
        ({"resume": True, "over": {"mu": [0.2, 0.4]}}, "another sweep; it differs in swept"),
        ({"resume": True, "over": {"mu": [0.2, 0.25, 0.3]}}, "another sweep"),
        ({"resume": True, "until": 1.0}, "differs in asked"),
        ({"resume": True, "model": "bouncing_ball", "over": {"k": [0.5]}}, "differs in model"),
        ({"resume": True, "outputs": []}, "differs in outputs"),
    ],
)
def test_a_store_of_another_sweep_is_not_overwritten(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    store = tmp_path / "a.zarr"
    asked: dict[str, Any] = {"model": STICK, "over": {"mu": [0.2, 0.21, 0.3]}}
    sweep(**asked, store=store)
    before = sorted((p, p.stat().st_mtime_ns) for p in store.rglob("*"))
    with pytest.raises(DeclarationError, match=words):
        sweep(**{**asked, **changes}, store=store)
    assert sorted((p, p.stat().st_mtime_ns) for p in store.rglob("*")) == before


@pytest.mark.parametrize("content", ["notes.txt", "zarr.json", ".zgroup"])
def test_folders_that_are_no_store_are_not_overwritten(tmp_path: Path, content: str) -> None:
    store = tmp_path / "a.zarr"
    store.mkdir()
    (store / content).write_text("{}")
    with pytest.raises(DeclarationError, match="no sweep store"):
        sweep(STICK, {"mu": [0.2]}, store=store, resume=True)


def test_a_store_of_a_killed_process_is_created_again(tmp_path: Path) -> None:
    store = tmp_path / "a.zarr"
    whole = sweep(STICK, {"mu": [0.2]}, store=store).load()
    shutil.rmtree(store / "outcome")
    same(sweep(STICK, {"mu": [0.2]}, store=store, resume=True), whole)
    for part in store.iterdir():
        shutil.rmtree(part) if part.is_dir() else part.unlink()
    (store / "zarr.0a1b.partial").write_text('{"node')
    same(sweep(STICK, {"mu": [0.2]}, store=store, resume=True), whole)


def test_partial_files_of_a_killed_process_are_removed(tmp_path: Path) -> None:
    store = tmp_path / "a.zarr"
    sweep(STICK, {"mu": [0.2]}, store=store)
    (store / "t_end" / "c" / "0.0a1b.partial").write_text("half")
    sweep(STICK, {"mu": [0.2]}, store=store, resume=True)
    assert not list(store.rglob("*.partial"))


_RESUMING = """
import sys
from statechart import sweep
from statechart.cli.main import main
from statechart.errors import StatechartError
try:
    sweep("toppling_stick", {"mu": [0.2, 0.4, 0.6]}, store=sys.argv[1], resume=True)
except StatechartError as error:
    print(type(error).__name__, error)
"""


@pytest.mark.parametrize("begun", [True, False])
def test_store_being_written_is_not_touched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, begun: bool
) -> None:
    store, over, said = tmp_path / "a.zarr", {"mu": [0.2, 0.4, 0.6]}, []
    if begun:
        with monkeypatch.context() as patched:
            patched.setattr(sweeps, "_BLOCK", 0.0)
            patched.setattr(sweeps, "run_block", interrupting(2))
            sweep(STICK, over, store=store)

    def run(task: Task, rows: np.ndarray) -> CellBlock:
        if not said:
            command = [sys.executable, "-c", _RESUMING, str(store)]
            said.append(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        return run_block(task, rows)

    monkeypatch.setattr(sweeps, "run_block", run)
    same(sweep(STICK, over, store=store, resume=True), sweep(STICK, over))
    assert said[0].startswith(f"DeclarationError another process is writing {store}; ")
    # The lock ends with the sweep.
    same(sweep(STICK, over, store=store, resume=True), sweep(STICK, over))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes that are forked")
def test_forked_process_does_not_hold_the_lock(tmp_path: Path) -> None:
    heard, said = os.pipe()
    with lock_folder(tmp_path / "a.zarr"):
        child = os.fork()
        if child == 0:
            os.write(said, b".")
            time.sleep(30.0)
            os._exit(0)
        os.read(heard, 1)
    try:
        with lock_folder(tmp_path / "a.zarr"):
            pass
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


@pytest.mark.parametrize("replaced", [True, False])
def test_a_store_removed_during_the_sweep_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, replaced: bool
) -> None:
    store = tmp_path / "a.zarr"

    def run(task: Task, rows: np.ndarray) -> CellBlock:
        if store.exists():
            shutil.rmtree(store)
            if replaced:
                store.mkdir()
        return run_block(task, rows)

    monkeypatch.setattr(sweeps, "run_block", run)
    with pytest.raises(StatechartError, match=r"a\.zarr was removed while it was written"):
        sweep(STICK, {"mu": [0.2]}, store=store)
    assert not list(store.rglob("*"))


@pytest.mark.parametrize(
    ("part", "cut"),
    [
        *((part, cut) for part in ("zarr.json", "c/0") for cut in ("outcome", "mu", "sequence")),
        ("zarr.json", "seconds"),
        ("c/0", "t_end"),
        ("zarr.json", "unfinished/modes"),
        ("c/0", "unfinished/sequence"),
    ],
)
@pytest.mark.parametrize("half", [True, False], ids=["half", "empty"])
def test_a_store_with_files_that_are_cut_off_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str, cut: str, half: bool
) -> None:
    store, over = tmp_path / "a.zarr", {"mu": [0.2, 0.4, 0.6]}
    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "_BLOCK", 0.0)
        patched.setattr(sweeps, "run_block", interrupting(2))
        sweep(STICK, over, store=store)
    file = store / cut / part
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2] if half else b"")
    with pytest.raises(DeclarationError, match=rf"is damaged: .*{Path(cut).name} cannot be read"):
        sweep(STICK, over, store=store, resume=True)


@pytest.mark.parametrize("gone", ["unfinished", "mu/c", "unfinished/sequence/c", "t_end"])
def test_a_store_that_lacks_a_part_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gone: str
) -> None:
    store, over = tmp_path / "a.zarr", {"mu": [0.2, 0.4, 0.6]}
    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "_BLOCK", 0.0)
        patched.setattr(sweeps, "run_block", interrupting(2))
        sweep(STICK, over, store=store)
    shutil.rmtree(store / gone)
    with pytest.raises(DeclarationError, match="is damaged"):
        sweep(STICK, over, store=store, resume=True)


def test_a_truncated_complete_store_is_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "a.zarr"
    asked = ["sweep", STICK, "--over", "mu=0.2,0.4", "--outputs", "t_impact", "-o", str(store)]
    assert main(asked) == 0
    (store / "t_impact" / "c" / "0").write_bytes(b"")
    capsys.readouterr()
    assert main([*asked, "--resume"]) == 2
    assert capsys.readouterr().err.endswith(
        f"{store} is damaged: t_impact cannot be read; remove it, and begin the sweep anew\n"
    )


@pytest.mark.parametrize(
    ("model", "over", "tile"),
    [(STICK, {"mu": [0.2, 0.4], "I_G": [0.0, 1.0]}, 4096), ("bouncing_ball_hills", LISTS, 2)],
)
def test_a_store_that_lost_a_chunk_is_refused_with_its_name(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    model: str,
    over: dict[str, list[float]],
    tile: int,
) -> None:
    monkeypatch.setattr(plans, "_CHUNK", tile)
    store = tmp_path / "a.zarr"
    sweep(model, over, store=store)
    chunks = [file for file in sorted(store.rglob("c/**/*")) if file.is_file()]
    held = {file.relative_to(store).parts[0] for file in chunks}
    # Chunks of fill values only exist as well.
    assert held == {one.name for one in store.iterdir() if one.is_dir()}
    for file in chunks:
        content = file.read_bytes()
        file.unlink()
        with pytest.raises(DeclarationError, match="is damaged") as caught:
            sweep(model, over, store=store, resume=True)
        array, *_ = file.relative_to(store).parts
        named = array if array in {*over, "sequence"} else file.relative_to(store)
        assert f"{store} is damaged: {named} " in str(caught.value)
        file.write_bytes(content)
    sweep(model, over, store=store, resume=True)


def test_missing_texts_read_as_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, store = sweep(STICK, GRID), tmp_path / "a.zarr"
    monkeypatch.setattr(sweeps, "_BLOCK", 0.0)
    with monkeypatch.context() as patched:
        patched.setattr(sweeps, "run_block", interrupting(9))
        sweep(STICK, GRID, store=store)
    for name in ("sequence", "unfinished/sequence"):
        array = zarr.open_array(store, path=name)
        array.resize((array.shape[0] + 3,))
    same(sweep(STICK, GRID, store=store, resume=True), whole)


@pytest.mark.parametrize("left", ["modes", "zarr.json"])
def test_leftovers_of_a_process_killed_at_its_end_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left: str
) -> None:
    whole, store = sweep(STICK, GRID), tmp_path / "a.zarr"
    sweep(STICK, GRID, store=store)
    (store / "unfinished").mkdir()
    shutil.copy(store / "zarr.json", store / "unfinished" / "zarr.json")
    if left == "modes":
        shutil.copytree(store / "modes", store / "unfinished" / "modes")
    same(sweep(STICK, GRID, store=store, resume=True), whole)
    assert not (store / "unfinished").exists()


def test_a_store_that_cannot_be_made_leaves_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(group: zarr.Group, plan: plans.Plan) -> None:
        create(group, plan)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(stores, "create", failing)
    with pytest.raises(StatechartError, match="No space left on device"):
        sweep(STICK, GRID, store=tmp_path / "a.zarr")
    assert not list(tmp_path.iterdir())


def test_a_store_that_cannot_be_made_leaves_no_folders(tmp_path: Path) -> None:
    with pytest.raises(StatechartError, match="cannot write"):
        sweep("bouncing_ball", {"k": [0.2, 0.3]}, store=tmp_path / "new" / ("long" * 100))
    assert not any(tmp_path.iterdir())
