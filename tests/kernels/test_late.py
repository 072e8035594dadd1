"""Kernels that are compiled when they are entered."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from numba import float64, int64

from statechart import interrupts

KERNELS = """\
from statechart.kernels.jit import kernel, late, part

@late
def rare(x, values) -> tuple[float, int]:
    values[0] += x
    return x + 1.0, len(values)

@late
def other(x) -> None:
    pass

@late
def wrong(x) -> int:
    return 0.5 * x

@part
def middle(x, values):
    if x > 2.0:
        wrong(x)
    if x > 1.0:
        more, count = rare(x, values)
        return more + count
    if x < 0.0:
        other(x)
    return 0.0

@kernel
def upper(x, values):
    return middle(x, values) + middle(0.5 * x, values)
"""
FROM_DISK = """\
import numpy as np
from late_kernels import rare, upper
print(upper(1.5, np.zeros(3)))
print(*("hit" if made.stats.cache_hits else "missed" for made in (upper.made, rare.made)))
"""


@pytest.fixture
def counted():
    return np.zeros(3)


def test_what_is_not_entered_is_not_compiled(kernels):
    module = kernels()
    assert module.upper(0.5, np.zeros(1)) == 0.0
    assert not module.rare.made.overloads
    assert module.upper(1.5, np.zeros(1)) == 3.5
    assert len(module.rare.made.overloads) == 1
    assert not module.other.made.overloads


def test_arrays_are_written_in_place(kernels, counted):
    assert kernels().upper(1.5, counted) == 5.5
    assert counted.tolist() == [1.5, 0.0, 0.0]


@pytest.mark.parametrize(("first", "found"), [(1.5, "hit hit"), (0.5, "hit missed")])
def test_a_kernel_from_the_disk_enters_another(kernels, counted, tmp_path, first, found):
    """Which lies there, too, or does not."""
    kernels().upper(first, counted)
    done = subprocess.run(
        [sys.executable, "-c", FROM_DISK],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert done.stdout.split("\n")[:2] == ["5.5", found]


def test_one_that_returns_what_it_does_not_say_is_told(kernels, counted):
    module = kernels()
    message = f"wrong returns {float64}, and says that it is {int64}"
    for _ in range(2):
        with pytest.raises(TypeError, match=message):
            module.upper(2.5, counted)
    assert module.upper(1.5, counted) == 5.5


def test_a_signal_ends_a_compilation_within_a_run(kernels, counted, monkeypatch):
    module = kernels()

    def stopped():
        raise KeyboardInterrupt

    assert module.upper(0.5, counted) == 0.0
    monkeypatch.setattr(interrupts, "let_through", stopped)
    with pytest.raises(KeyboardInterrupt):
        module.upper(1.5, counted)
    monkeypatch.undo()
    assert module.upper(1.5, counted) == 5.5


def test_python_runs_it_as_it_is_written(kernels, counted):
    module = kernels()
    assert module.upper.as_written(1.5, counted) == 5.5
    assert not module.rare.made.overloads
