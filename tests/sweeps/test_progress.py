"""What a sweep says of itself on stderr."""

from __future__ import annotations

import io
import sys

import pytest

from statechart.sweeps import progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_lines_tell_cells_rate_and_time_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    # Of which five seconds are compilation.
    monkeypatch.setattr(progress, "working_time", lambda: max(now[0] - 5.0, 0.0))
    with progress.told(1000, 100, shown=True) as tell:
        for now[0], count in ((1.0, 50), (10.0, 50), (12.0, 300), (30.0, 100)):
            tell(count)
    assert capsys.readouterr().err.splitlines() == [
        "200 of 1000 cells, 20 a second, 0:00:40 left",
        "600 of 1000 cells, 20 a second, 0:00:20 left",
    ]


def test_a_terminal_gets_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("TERM", "xterm")
    with progress.told(1000, 100, shown=True) as tell:
        tell(200)
    assert "300/1000" in screen.getvalue()


def test_nothing_is_said_unless_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.told(10, 0, shown=False) as tell:
        tell(10)
    assert capsys.readouterr().err == ""
