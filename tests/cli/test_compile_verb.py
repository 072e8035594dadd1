"""`statechart compile`: kernels are compiled by short runs, with one line of progress."""

from __future__ import annotations

import sys

import pytest

import statechart
from statechart.cli import ahead_of_time
from statechart.cli.main import main
from statechart.compiling import StderrLine
from statechart.kernels.jit import Kernel
from statechart.kernels.jit import ahead_of_time as compiling_ahead


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(ahead_of_time, "_RUNS", (("bouncing_ball", {"engine": "taylor"}),))
    monkeypatch.setattr(statechart, "sweep", lambda *_: None)


def test_compile_shows_its_first_and_its_last_line(short, capsys):
    assert main(["compile"]) == 0
    out, err = capsys.readouterr()
    first, last = err.splitlines()
    assert (out, first) == ("", "compiling numerical kernels: part 1 of 2")
    assert last.startswith("compiled numerical kernels in ")


def test_quiet_compile_shows_nothing(short, capsys):
    assert main(["compile", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


def test_a_terminal_shows_progress_in_one_line(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    line = StderrLine()
    line("kernels", "compiling: 1 of 2", False)
    line("kernels", "compiling: 2 of 2", False)
    line("kernels", "compiled", True)
    err = capsys.readouterr().err
    assert err == "\r\x1b[2Kcompiling: 1 of 2\r\x1b[2Kcompiling: 2 of 2\r\x1b[2K"


def test_file_gets_one_progress_line_per_subject(capsys):
    line = StderrLine()
    for subject, text in (("kernels", "1"), ("kernels", "2"), ("a mode", "3"), ("kernels", "4")):
        line(subject, text, False)
    assert capsys.readouterr().err == "1\n3\n"


def test_kernels_are_compiled_at_once_while_compiling_ahead(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def twice(x):
        return 2.0 * x

    kernel = Kernel(twice, interpreted=True)
    assert kernel(1.0) == 2.0
    assert "compiled" not in kernel.__dict__
    with compiling_ahead():
        assert kernel(1.0) == 2.0
    assert kernel.compiled.overloads
