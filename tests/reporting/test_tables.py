import csv
import io
import json
import math
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents import files
from statechart.documents.files import write_atomic
from statechart.engines.taylor import Taylor
from statechart.errors import StatechartError
from statechart.execution.simulator import Simulator
from statechart.loading.load import load
from statechart.observation.observer import Observer
from statechart.observation.sampling import subdivide
from statechart.reporting import tables
from statechart.reporting.partial_report import PartialReport
from statechart.reporting.report import dumps, report
from statechart.reporting.tables import events_table, netcdf, samples_table, to_xarray, write_run
from statechart.study import study as study_file

resource = pytest.importorskip("resource")
FILES = {"run.json", "events.csv", "samples.csv", "trace.nc", "figure.svg", "figure.png"}


@pytest.fixture(scope="module")
def observer() -> Observer:
    scene = load(Path(__file__).parents[2] / "models" / "toppling_stick.yaml")
    assert isinstance(scene, Scene)
    return Observer(Simulator(automaton(scene), Taylor(2.2e-16)))


@pytest.fixture(scope="module")
def trace(observer: Observer) -> Trace:
    return observer.simulator.run(until=1000.0)


@contextmanager
def disk_full_after(size: int) -> Iterator[None]:
    """Let no file grow beyond `size` bytes, as on a disk without room."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, ignored)


def test_samples_table_has_every_variable_and_observable(observer: Observer, trace: Trace) -> None:
    table = samples_table(observer, trace)
    assert list(table.columns) == ["t", "j", "mode", *observer.names]
    assert table["mode"].unique().tolist() == ["tip:pin", "tip:slide-", "tip:slide+"]
    assert table["energy"].iloc[0] == pytest.approx(1.0, abs=1e-14)
    assert table["stick.angle"].iloc[-1] == pytest.approx(-math.pi / 2, abs=1e-14)


def test_events_table_has_a_row_per_jump(observer: Observer, trace: Trace) -> None:
    table = events_table(observer, trace)
    assert table["cause"].tolist() == ["slip", "reverse", "stop"]
    assert table["t"].tolist() == [jump.t for jump in trace.jumps]
    assert table["target"].tolist()[:2] == ["tip:slide-", "tip:slide+"]
    assert table["stick.x before"].iloc[1] == trace.jumps[1].before[0]


def test_csv_keeps_full_precision(observer: Observer, trace: Trace, tmp_path: Path) -> None:
    write_run(tmp_path / "run", observer, trace, lambda: report(observer, trace))
    with (tmp_path / "run" / "samples.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    table = samples_table(observer, trace)
    for name in ("t", "tip.V", "energy"):
        assert [float(row[name]) for row in rows] == table[name].tolist()


def test_netcdf_reads_back_equal(observer: Observer, trace: Trace, tmp_path: Path) -> None:
    data = to_xarray(observer, trace)
    (tmp_path / "trace.nc").write_bytes(netcdf(data))
    read = xr.load_dataset(tmp_path / "trace.nc", engine="scipy")
    xr.testing.assert_equal(read, data)
    assert read.attrs == data.attrs
    assert read.attrs["parameter.mu"] == 0.2
    assert read["mode"].values[0] == "tip:pin"
    assert read["tip.V"].attrs["long_name"] == "V of tip"


@pytest.mark.parametrize("mu", [0.2, math.inf])
def test_netcdf_holds_a_run_without_events(observer: Observer, mu: float) -> None:
    trace = observer.simulator.run({"mu": mu}, until=0.5)
    assert not trace.jumps
    data = to_xarray(observer, trace)
    read = xr.load_dataset(io.BytesIO(bytes(data.to_netcdf(engine="scipy"))), engine="scipy")
    assert read.sizes["event"] == 0
    assert read.attrs["parameter.mu"] == mu
    np.testing.assert_array_equal(read["stick.angle"], data["stick.angle"])


def test_reserved_names_get_an_underscore() -> None:
    assert tables._columns(["x", "t", "double"]) == {"x": "x", "t": "t_", "double": "double_"}


def test_run_folder_contains_all_files(observer: Observer, trace: Trace, tmp_path: Path) -> None:
    made = report(observer, trace)
    folder = tmp_path / "new" / "run"
    assert set(write_run(folder, observer, trace, lambda: made)) == FILES
    assert set(os.listdir(folder)) == FILES
    assert os.listdir(folder.parent) == ["run"]
    assert json.loads((folder / "run.json").read_text()) == made
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_an_existing_folder_keeps_its_other_files(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "run.json").write_text("old")
    write_run(tmp_path, observer, trace, lambda: report(observer, trace))
    assert set(os.listdir(tmp_path)) == FILES | {"notes.txt"}
    assert json.loads((tmp_path / "run.json").read_text())["model"] == "toppling_stick"


def test_an_existing_file_is_an_error_and_is_not_overwritten(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    (tmp_path / "run").write_text("mine")
    with pytest.raises(StatechartError, match="there is a file of this name"):
        write_run(tmp_path / "run", observer, trace, dict)
    with pytest.raises(StatechartError, match="cannot write"):
        write_run(tmp_path / "run" / "below", observer, trace, dict)
    assert os.listdir(tmp_path) == ["run"]
    assert (tmp_path / "run").read_text() == "mine"


@pytest.mark.parametrize("exists", [False, True])
def test_a_full_disk_keeps_complete_tables_and_names_the_missing_ones(
    observer: Observer, trace: Trace, tmp_path: Path, exists: bool
) -> None:
    made = report(observer, trace)
    folder = tmp_path / "run"
    if exists:
        folder.mkdir()
        for name in ("run.json", "trace.nc", "notes.txt"):
            (folder / name).write_text("old")
    # Room for run.json and events.csv, not for the samples.
    with disk_full_after(len(dumps(made)) + 100), pytest.raises(StatechartError) as caught:
        write_run(folder, observer, trace, lambda: made)
    assert str(caught.value) == (
        f"{folder} has only events.csv, run.json; could not be written: trace.nc, samples.csv, "
        "figure.svg, figure.png (File too large)"
    )
    assert os.listdir(tmp_path) == ["run"]
    # Leftovers of another run would be mistaken for this one's.
    notes = ["notes.txt"] if exists else []
    assert sorted(os.listdir(folder)) == ["events.csv", *notes, "run.json"]
    assert json.loads((folder / "run.json").read_text()) == made


def test_an_unwritable_place_leaves_no_folders_behind(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    pieces = PartialReport()
    with disk_full_after(10), pytest.raises(StatechartError, match=r"deep/run: .*nothing was wri"):
        write_run(
            tmp_path / "new" / "deep" / "run", observer, trace, lambda: {"model": "m"}, pieces
        )
    with disk_full_after(1), pytest.raises(StatechartError, match="too large"):
        study_file.save(tmp_path / "new" / "deep", SimpleNamespace(model_dump_json=lambda: "[1]"))
    assert os.listdir(tmp_path) == []


def test_leftovers_of_a_killed_process_are_removed_by_the_next(
    observer: Observer, trace: Trace, tmp_path: Path
) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    here, another = platform.node(), f"{platform.node()}x"
    gone, busy, far = f"{here}-{ended.pid}-", f"{here}-{os.getpid()}-", f"{another}-{ended.pid}-"
    left, *kept = (
        tmp_path / f".{name}"
        for name in (
            f"run.{gone}abcd_123", f"run.{busy}zzzzzzzz", f"run.{far}abcd_123", "run.settings",
            f"ran.{gone}abcd_123",
        )
    )  # fmt: skip
    for place in (left, *kept):
        place.mkdir()
        (place / "run.json").write_text("half")
    (tmp_path / f".trace.nc.{gone}0a1b2c3d").write_text("half")
    write_run(tmp_path / "run", observer, trace, dict)
    write_atomic(tmp_path / "trace.nc", netcdf(to_xarray(observer, trace)))
    names = {place.name for place in kept}
    assert set(os.listdir(tmp_path)) == names | {"run", "trace.nc"}


def test_leftovers_in_an_existing_folder_are_removed(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    (tmp_path / f".{tmp_path.name}.{platform.node()}-{ended.pid}-abcd_123").mkdir()
    with files.staging_folder(tmp_path, ["a"]) as place:
        (place / "a").write_text("whole")
    assert os.listdir(tmp_path) == ["a"]


def test_one_failing_file_does_not_stop_the_others(
    observer: Observer, trace: Trace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(error: BaseException) -> Callable[..., None]:
        def work(*arguments: object, **options: object) -> None:
            raise error

        return work

    monkeypatch.setattr("statechart.reporting.report.margins", failing(MemoryError()))
    monkeypatch.setattr("statechart.reporting.tables._data_set", failing(ValueError("a bug")))
    # The message is that of the signal; later parts are left out, too.
    monkeypatch.setattr("statechart.reporting.figure.figure", failing(KeyboardInterrupt()))
    pieces = PartialReport()
    names = write_run(
        tmp_path / "run", observer, trace, lambda: report(observer, trace, pieces=pieces), pieces
    )
    assert names == ("events.csv", "run.json", "samples.csv")
    assert pieces.text() == "trace.nc (a bug), margins (out of memory), figure (interrupted)"
    made = json.loads((tmp_path / "run" / "run.json").read_text())
    assert {"what": "trace.nc", "why": "a bug"} in made["left_out"]
    assert {"what": "margins", "why": "out of memory"} in made["left_out"]
    assert made["outputs"]


def test_tables_are_written_as_pandas_writes_them() -> None:
    numbers = np.array([0.1, np.nan, -0.0, 1e22, np.inf, 1 / 3])
    table = pd.DataFrame(
        {
            "t": numbers,
            "j": np.arange(6),
            "mode": pd.Categorical.from_codes(np.array([0, 1, 0, 1, 1, 0]), ["a:b", 'c, "d"']),
            "name": ["x", "", "y z", "a,b", 'q"', "-"],
        }
    )
    assert tables._csv(table) == table.to_csv(index=False).encode()


@pytest.mark.parametrize("per_step", [8, 1, 0.3])
def test_batches_divide_flows_as_single_runs_do(per_step: float) -> None:
    ends = [np.array([0.0, 0.3, 1.0]), np.array([0.0, 0.7]), np.array([0.0, 0.1, 1.1])]
    ends.append(np.linspace(0.0, 2.0, 9))
    arcs = [SimpleNamespace(times=times) for times in ends]
    together = subdivide(arcs, per_step)
    for arc, local in zip(arcs, together, strict=True):
        np.testing.assert_array_equal(subdivide([arc], per_step)[0], local)
        assert local[0] == 0.0
        assert local[-1] == arc.times[-1]
        assert (np.diff(local) > 0.0).all()
    assert [len(local) for local in together[:2]] == {8: [17, 9], 1: [3, 2], 0.3: [2, 2]}[per_step]
