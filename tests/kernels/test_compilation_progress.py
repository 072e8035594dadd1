"""Progress of compilation, and clocks that leave it out."""

from __future__ import annotations

import heyoka
import pytest

from statechart import compiling, run
from statechart.engines.engine import TimeBudget
from statechart.errors import OutOfBudget

KERNELS = """\
from statechart.kernels.jit import kernel

@kernel
def smallest_part(x):
    return x + 1.0

@kernel
def larger_part(x):
    return smallest_part(x) + smallest_part(2.0)

@kernel(interpreted=False)
def lower_kernel(x):
    return larger_part(x)

@kernel(interpreted=False)
def upper_kernel(x):
    return lower_kernel(x) + larger_part(x)
"""


class Clock:
    """A clock with a settable time."""

    def __init__(self) -> None:
        self.now = 100.0

    def perf_counter(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch):
    found = Clock()
    monkeypatch.setattr(compiling, "time", found)
    monkeypatch.setattr(compiling, "_now", compiling._State())
    return found


@pytest.fixture
def lines(clock):
    """Return the messages; every function takes a second."""
    said: list[str] = []
    compiling.announce(lambda subject, line, last: said.append(line))
    return said


def slow(monkeypatch, clock, seconds):
    """Let the end of every function that is compiled come so many seconds later."""
    end = compiling.end

    def later(counts=True):
        clock.now += seconds
        end(counts)

    monkeypatch.setattr(compiling, "end", later)


def test_compilation_shows_its_progress(kernels, clock, lines, monkeypatch):
    slow(monkeypatch, clock, 1.0)
    assert kernels().upper_kernel(1.0) == 10.0
    assert lines == [
        "compiling numerical kernels: 1 of 4 functions, 1 s; this happens once",
        "compiling numerical kernels: 2 of 4 functions, 2 s; this happens once",
        "compiling numerical kernels: 3 of 4 functions, 3 s; this happens once",
        "compiled numerical kernels in 4 s; this happens once",
    ]


def test_cached_kernels_do_not_count_as_progress(kernels, clock, lines, monkeypatch):
    module = kernels()
    module.lower_kernel(1.0)
    slow(monkeypatch, clock, 1.0)
    module.upper_kernel(1.0)
    assert lines[0] == "compiling numerical kernels: 1 of 2 functions, 1 s; this happens once"
    lines.clear()
    kernels().upper_kernel(1.0)
    assert not lines


def test_compilations_below_a_second_are_silent(kernels, clock, lines, monkeypatch):
    slow(monkeypatch, clock, 0.2)
    kernels().upper_kernel(1.0)
    assert not lines


def test_compiled_equations_of_a_mode_are_announced(clock, lines, monkeypatch):
    compiled = heyoka.taylor_adaptive

    def slowly(*system, **options):
        clock.now += 3.0
        return compiled(*system, **options)

    monkeypatch.setattr(heyoka, "taylor_adaptive", slowly)
    began = compiling.working_time()
    run("bouncing_ball", until=0.1, engine="taylor")
    assert lines == ["compiled the equations of a mode (2 variables) in 3 s; this happens once"]
    assert compiling.working_time() == began


def test_a_failure_ends_the_progress_line(tmp_path, kernels, clock, lines):
    module = kernels()
    with pytest.raises(Exception, match="upper_kernel"):
        module.upper_kernel("text")
    began = compiling.working_time()
    clock.now += 3.0
    assert compiling.working_time() == began + 3.0


def test_compile_time_does_not_count_as_working_time(kernels, clock, monkeypatch):
    time_budget = TimeBudget(2.5)
    time_budget.begin()
    slow(monkeypatch, clock, 10.0)
    kernels().upper_kernel(1.0)
    time_budget.check(0.0)
    clock.now += 2.0
    compiling.begin("other", lambda: 1)
    clock.now += 10.0
    time_budget.check(0.0)
    compiling.end()
    time_budget.check(0.0)
    clock.now += 1.0
    with pytest.raises(OutOfBudget):
        time_budget.check(0.0)
