"""Progress lines of a sweep on stderr."""

from __future__ import annotations

import io
import sys

import pytest

from statechart.sweeps import sweep as sweeps


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_lines_have_cells_rate_and_time_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(sweeps.time, "monotonic", lambda: now[0])
    # Five seconds of these are compilation.
    monkeypatch.setattr(sweeps, "working_time", lambda: max(now[0] - 5.0, 0.0))
    shown = sweeps._Progress(1000, 100)
    for now[0], count in ((1.0, 50), (10.0, 50), (12.0, 300), (30.0, 100)):
        shown.advance(count)
    shown.close()
    assert capsys.readouterr().err.splitlines() == [
        "200 of 1000 cells, 10 a second, 0:01:20 left",
        "600 of 1000 cells, 20 a second, 0:00:20 left",
    ]


def test_the_start_of_processes_is_no_part_of_the_rate(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(sweeps.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(sweeps, "working_time", lambda: now[0])
    shown = sweeps._Progress(1000, 0)
    for now[0], count in ((11.0, 10), (22.0, 440)):
        shown.advance(count)
    assert capsys.readouterr().err.splitlines() == [
        "10 of 1000 cells",
        "450 of 1000 cells, 40 a second, 0:00:14 left",
    ]


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TERM", "xterm")
    shown = sweeps._Progress(1000, 100)
    shown.advance(200)
    shown.close()
    assert "300 of 1000 cells" in screen.getvalue()
