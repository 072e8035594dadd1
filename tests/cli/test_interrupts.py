"""Signals that end a run, and unwritable streams: output and saved files."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import xarray as xr
from runs import without_compilation

from contacts.time_stepping.scene_stepper import SteppedScene
from statechart import interrupts
from statechart.cli.main import main
from statechart.errors import StatechartError
from statechart.kernels.jit import kernel
from statechart.reporting.partial_report import SOME, PartialReport, short_length
from statechart.reporting.tables import write_run
from statechart.running.runner import Runner, run

pytestmark = [
    pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="signals of POSIX"),
    pytest.mark.usefixtures("default_signals"),
]


def strike() -> None:
    signal.raise_signal(signal.SIGINT)


def striking(work: Callable[..., object], at: int) -> Callable[..., object]:
    """Return what a signal arrives in the middle of, at its so manieth call."""
    calls = []

    def struck(*arguments: object, **options: object) -> object:
        calls.append(1)
        if len(calls) == at:
            strike()
        return work(*arguments, **options)

    return struck


def test_these_tests_pass_where_a_shell_ignores_signals_in_the_background() -> None:
    one = f"{__file__}::test_a_deferred_signal_waits_for_the_next_check"
    command = f"trap '' INT TERM HUP; '{sys.executable}' -m pytest -q '{one}'"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_a_deferred_signal_waits_for_the_next_check() -> None:
    with interrupts.deferred():
        strike()
        assert interrupts.signal_count() == 1
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
    assert interrupts.signal_count() == 0


def test_a_deferred_signal_without_a_check_is_delivered_at_the_end() -> None:
    done = []

    def work() -> None:
        with interrupts.deferred():
            strike()
            done.append(1)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done
    with pytest.raises(KeyboardInterrupt):
        strike()


def test_long_work_lets_signals_through_unless_they_are_blocked() -> None:
    with interrupts.deferred():
        with pytest.raises(KeyboardInterrupt), interrupts.let_through():
            strike()
        with interrupts.let_through():
            pass  # that was reported
        with interrupts.deferred(firmly=True), interrupts.let_through():
            strike()
        with pytest.raises(KeyboardInterrupt), interrupts.let_through():
            raise AssertionError("the signal before was not reported")


def test_kernels_are_compiled_where_signals_are_let_through() -> None:
    @kernel(interpreted=False)
    def doubled(x: float) -> float:
        return 2.0 * x

    with interrupts.deferred():
        strike()
        with pytest.raises(KeyboardInterrupt):
            doubled(1.0)
        assert doubled(1.0) == 2.0


def test_after_a_signal_time_is_limited() -> None:
    def work() -> None:
        with interrupts.limit_time(0.0), interrupts.let_through():
            signal.pause()

    with interrupts.limit_time(0.0):
        pass  # without one it is not
    with interrupts.deferred():
        strike()
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        with pytest.raises(KeyboardInterrupt):
            work()
        assert interrupts.signal_count() == 2


def test_after_a_signal_only_required_files_are_written() -> None:
    pieces = PartialReport()
    with interrupts.deferred():
        assert pieces.attempt("a", lambda: 1, 0) == 1
        assert pieces.attempt("b", lambda: strike() or 1, 0) == 0
        assert pieces.attempt("c", lambda: 1, 0) == 0
        assert pieces.keep("d", lambda short: strike() or 1, 0) == 1
        assert pieces.attempt("e", lambda: 1 / 0, 0.0) == 0.0
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
    assert pieces.text() == "b, c, e (interrupted)"


def test_signals_shorten_deferred_blocks_without_ending_them() -> None:
    pieces = PartialReport()
    with interrupts.deferred():
        assert pieces.keep("a", lambda short: short or strike(), False) is True
        assert pieces.keep("b", lambda short: strike() or short, False) is True
        assert pieces.some("numbers", range(2 * SOME + 1)) == tuple(range(0, 2 * SOME + 1, 3))
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
    assert pieces.some("names", ["a", "b"]) == ("a", "b")
    # With more variables fewer rows have as many numbers.
    assert short_length(1) == short_length(30) == SOME
    assert [short_length(width) * width <= 2**17 for width in (33, 400, 2**17)] == [True] * 3
    assert short_length(2**20) == 1
    left = 2 * SOME + 1 - len(range(0, 2 * SOME + 1, 3))
    assert pieces.text() == f"{left} of {2 * SOME + 1} numbers (interrupted)"


def test_a_run_of_many_flows_is_saved_in_short_after_a_signal(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    result = run("bouncing_ball_chart")
    jumps = result.trace.jumps
    assert len(jumps) > 10
    monkeypatch.setattr("statechart.reporting.partial_report.SOME", 10)
    with interrupts.deferred():
        strike()
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        pieces = PartialReport()
        write_run(
            tmp_path, result.observer, result.trace, lambda: result.to_dict(pieces=pieces), pieces
        )
    report = json.loads((tmp_path / "run.json").read_text())
    assert report["outputs"] == result.to_dict()["outputs"]
    shown = [event["t"] for event in report["events"]]
    assert shown == [jump.t for jump in jumps[:: math.ceil(len(jumps) / 10)]]
    with xr.open_dataset(tmp_path / "trace.nc") as data:
        assert data["event_t"].values.tolist() == shown
    whats = [left["what"] for left in report["left_out"]]
    assert f"{len(jumps) - len(shown)} of {len(jumps)} events" in whats


@pytest.mark.parametrize("at", [2, 9])
def test_a_signal_in_the_middle_of_a_jump_leaves_the_trace_whole(
    monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    runner = Runner("bouncing_ball_chart")
    laws = type(runner.automaton.laws)
    monkeypatch.setattr(laws, "jump", striking(laws.jump, at))
    trace = runner.run().trace
    assert trace.outcome.name == "INTERRUPTED"
    assert trace.jumps
    assert trace.t_end == trace.jumps[-1].t == pytest.approx(trace.arcs[-1].duration
        + trace.arcs[-1].start.high, abs=1e-15)  # fmt: skip
    assert (trace.final == trace.jumps[-1].after).all()
    whole = run("bouncing_ball_chart").trace
    assert [jump.t for jump in trace.jumps] == [j.t for j in whole.jumps[: len(trace.jumps)]]


def test_a_signal_ends_time_stepping_between_its_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    runner = Runner("stick_slip_block", engine="impulse", step=1e-3)
    monkeypatch.setattr(SteppedScene, "steps", striking(SteppedScene.steps, 3))
    trace = runner.run(until=1e6).trace
    assert trace.outcome.name == "INTERRUPTED"
    assert 0.0 < trace.t_end < 10.0
    assert trace.arcs[-1].start.high + trace.arcs[-1].duration == pytest.approx(trace.t_end)


class Process:
    """The command line as a process of its own."""

    def __init__(self, folder: Path, *arguments: str, options: tuple[str, ...] = ()) -> None:
        command = [sys.executable, *options, "-m", "statechart.cli.main", *arguments]
        self._process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def signalled(self, number: int, line: str) -> tuple[int, str, str]:
        """Send a signal after a line of stderr that has `line`; return code, stdout, stderr.

        The first line of a run may come before anything has happened in it.
        """
        stderr = self._process.stderr
        assert stderr is not None
        assert any(line in said and ", 0 jumps" not in said for said in stderr)
        self._process.send_signal(number)
        out, err = self._process.communicate(timeout=120)
        return self._process.returncode, out, err


@pytest.mark.parametrize(
    ("number", "options"),
    [(signal.SIGTERM, ()), (signal.SIGHUP, ("--engine", "impulse", "--step", "1e-3"))],
    ids=["SIGTERM, events", "SIGHUP, steps"],
)
def test_sigint_reports_and_saves_the_run(
    tmp_path: Path, number: int, options: tuple[str, ...]
) -> None:
    process = Process(
        tmp_path, "run", "stick_slip_block", "--until", "1e6", "--output", "out", *options
    )
    code, out, err = process.signalled(number, "t = ")
    assert code == 1, (out, err)
    assert out.startswith("stick_slip_block: INTERRUPTED\n")
    assert err.splitlines()[-1].startswith("left out: ")
    assert "margins" in err.splitlines()[-1]
    report = json.loads((tmp_path / "out" / "run.json").read_text())
    assert report["outcome"] == "INTERRUPTED"
    assert report["events"]
    with xr.open_dataset(tmp_path / "out" / "trace.nc") as data:
        assert data.sizes["event"] == len(report["events"])
        assert data["t"][0] == 0.0
        assert data["t"].max() > 0.9 * report["t_end"]
    assert os.listdir(tmp_path) == ["out"]
    assert not [name for name in os.listdir(tmp_path / "out") if name.startswith(".")]


def test_signal_during_imports_prints_one_word(tmp_path: Path) -> None:
    process = Process(tmp_path, "validate", "dice", options=("-X", "importtime"))
    code, out, err = process.signalled(signal.SIGINT, "numpy")
    said = [line for line in err.splitlines() if not line.startswith("import time:")]
    assert (code, out, said) == (1, "", ["interrupted"])


@pytest.mark.parametrize("asked", ["schema chart", "--help", "--version"])
@pytest.mark.parametrize(
    ("redirected", "words"),
    [
        (">&-", "it is closed"),
        (">/dev/full", "No space left on device"),
    ],
)
def test_unprintable_results_give_one_sentence(
    tmp_path: Path, asked: str, redirected: str, words: str
) -> None:
    command = f"{sys.executable} -m statechart.cli.main {asked} {redirected}"
    done = subprocess.run(
        ["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (1, f"cannot write to stdout: {words}\n")


def test_without_stderr_only_results_are_printed(tmp_path: Path) -> None:
    command = f"{sys.executable} -m statechart.cli.main schema chart 2>&- | head -c 2"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("{\n", "")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (MemoryError(), "out of memory"),
        (RecursionError(), "Python's recursion limit"),
        (ImportError("libx.so: cannot map"), "a library cannot be loaded: libx.so: cannot map"),
    ],
)
@pytest.mark.parametrize("wrapped", [False, True])
def test_lack_of_system_resources_gives_one_sentence(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
    words: str,
    wrapped: bool,
) -> None:
    def lacking(arguments: object) -> int:
        if wrapped:
            raise SystemError("a result with an exception set") from error
        raise error

    if wrapped and isinstance(error, ImportError):
        return
    monkeypatch.delenv("STATECHART_DEBUG", raising=False)
    monkeypatch.setattr("statechart.cli.verbs.schema", lacking)
    assert main(["schema"]) == 1
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert said.err.startswith(words)


def test_a_run_that_cannot_be_saved_is_printed_all_the_same(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def full(*arguments: object) -> None:
        raise StatechartError("cannot write out: No space left on device; nothing was written")

    monkeypatch.setattr("statechart.reporting.tables.write_run", full)
    code = main(["run", "bouncing_ball_chart", "--samples", "--output", str(tmp_path / "out")])
    said = capsys.readouterr()
    assert code == 1
    assert said.out.startswith("bouncing_ball_chart: HORIZON")
    cause = "cannot write out: No space left on device; nothing was written\n"
    assert without_compilation(said.err) == cause


@pytest.mark.parametrize("verb", ["run", "trade"])
def test_an_empty_name_is_no_folder(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    verb: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([verb, "bouncing_ball_chart", "--output", ""]) == 2
    assert "--output: the name is empty" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_a_signal_in_a_callback_of_the_interpreter_prints_no_traceback() -> None:
    code = """
import signal, weakref
from statechart import interrupts
from statechart.cli.streams import be_quiet
interrupts.listen()
be_quiet()
class Thing: pass
thing = Thing()
kept = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGINT))
del thing
print(interrupts.signal_count())
kept = weakref.ref(last := Thing(), lambda _: 1 / 0)
del last
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "1\n"
    assert "KeyboardInterrupt" not in done.stderr
    assert "ZeroDivisionError" in done.stderr
