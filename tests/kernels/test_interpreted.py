"""Interpreted kernels: the same bits as compiled ones, and no import of numba."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest

from contacts.event_driven import compiled_laws
from statechart import Runner
from statechart.kernels import jit
from statechart.kernels.jit import Kernel, kernel
from statechart.kernels.tapes import HYPOT, POW, SQRT, tape_values

COMPILED = ("enclosed_defect",)


@kernel
def _inner(x):
    return math.sqrt(x)


@kernel
def _roots(values, result):
    for i in range(len(values)):
        result[i] = _inner(values[i])
    return result[0], len(values)


@kernel
def _root(values, result):
    result[0] = _inner(values[0])
    return result[0]


@pytest.fixture
def interpreted(monkeypatch):
    """Let Python interpret all kernels that it may, and fail where one is compiled."""
    call = Kernel.__call__

    def checked(kernel, *arguments):
        kernel._spent, kernel._hot = 0.0, kernel.py_func.__name__ in COMPILED
        result = call(kernel, *arguments)
        assert not kernel._hot or kernel.py_func.__name__ in COMPILED, f"{kernel} was compiled"
        return result

    for name in ("LOADING", "HOT", "LINKING"):
        monkeypatch.setattr(jit, name, 1e9)
    monkeypatch.setattr(Kernel, "__call__", checked)
    monkeypatch.setattr(compiled_laws, "is_ready", lambda loop: False)


@pytest.fixture
def compiled(monkeypatch):
    """Let Python interpret no kernel."""
    for name in ("LOADING", "HOT", "LINKING"):
        monkeypatch.setattr(jit, name, -1.0)


def reported(model, until, certify):
    """Return everything that a run reports, except its cost."""
    result = Runner(model, once=True).run(until=until, certify=certify, throw=False)
    found = result.to_dict(explain=True)
    for name in ("timings", "counts"):
        found.pop(name, None)
    return found, result.trace.motion, result.trace.final.tobytes()


@pytest.mark.parametrize(
    ("model", "until", "certify"),
    [
        ("toppling_stick", 10.0, False),
        ("toppling_stick", 1.0, True),
        ("bouncing_ball", 0.6, True),
        ("four_legged_table", 0.1, False),
        ("sliding_ladder", 0.3, False),
        ("raibert_hopper", 0.3, False),
        ("simplest_walker", 1.0, False),
        ("woodpecker", 0.02, False),
    ],
)
def test_interpreted_kernels_are_bit_identical(model, until, certify, request):
    request.getfixturevalue("interpreted")
    by_python = reported(model, until, certify)
    request.getfixturevalue("monkeypatch").undo()
    request.getfixturevalue("compiled")
    assert by_python == reported(model, until, certify)


@pytest.mark.parametrize("op", [SQRT, HYPOT, POW])
def test_operations_give_the_same_bits(op, interpreted, request):
    rng = np.random.default_rng(0)
    code, outputs = np.array([[op, 0, 1]], np.int32), np.array([3], np.int32)
    states = 10.0 ** rng.uniform(-5.0, 5.0, (200, 2))
    by_python, by_machine = np.empty((200, 1)), np.empty((200, 1))
    for state, result in zip(states, by_python, strict=True):
        tape_values(code, np.empty(0), outputs, state, np.empty(0), 0.0, result)
    request.getfixturevalue("monkeypatch").undo()
    request.getfixturevalue("compiled")
    for state, result in zip(states, by_machine, strict=True):
        tape_values(code, np.empty(0), outputs, state, np.empty(0), 0.0, result)
    assert by_python.tobytes() == by_machine.tobytes()


def test_results_are_pythons_numbers_and_arrays_are_filled(interpreted):
    result = np.zeros(2)
    root, count = _roots(np.array([4.0, 9.0]), result)
    assert (type(root), type(count)) == (float, int)
    assert result.tolist() == [2.0, 3.0]


@pytest.fixture
def cold():
    """A kernel that no test has called."""
    return Kernel(_roots.py_func, interpreted=True)


def test_a_kernel_that_raises_an_error_when_interpreted_is_compiled(cold):
    result = np.zeros(2)
    cold(np.array([4.0, -1.0]), result)
    assert result[0] == 2.0
    assert math.isnan(result[1])
    assert cold._hot


def test_hot_kernel_is_compiled_and_restarted(cold, monkeypatch):
    monkeypatch.setattr(jit, "HOT", 1e-9)
    result = np.zeros(400)
    assert cold(np.full(400, 16.0), result) == (4.0, 400)
    assert set(result.tolist()) == {4.0}
    assert cold._hot


def test_a_kernel_on_disk_is_loaded_during_its_first_call(cold, monkeypatch):
    monkeypatch.setattr(jit, "numba_is_imported", lambda: True)
    monkeypatch.setattr(jit, "LINKING", 1e-9)
    result = np.zeros(400)
    cold.is_cached = False
    assert cold(np.full(400, 16.0), result) == (4.0, 400)
    assert not cold._hot
    cold.is_cached, cold._spent = True, 0.0
    assert cold(np.full(400, 25.0), result) == (5.0, 400)
    assert set(result.tolist()) == {5.0}
    assert cold._hot


@pytest.mark.parametrize(
    ("verb", "model"),
    [
        ("validate", "toppling_stick"),
        ("draw -o {}/chart.svg", "toppling_stick"),
        ("run", "toppling_stick"),
        ("validate", "dice"),
        ("modes", "dice"),
        ("modes", "toppling_stick"),
        ("run --certify", "toppling_stick"),
    ],
)
def test_short_verbs_import_no_compiler_and_use_one_thread(verb, model, tmp_path, monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    name, *options = verb.format(tmp_path).split()
    # Independent of the speed of the machine, which `benchmarks/cold_start.py` measures.
    slow = "clock = time.thread_time; time.thread_time = lambda: clock() / 8; "
    script = (
        f"import os, sys, time; {'' if options == ['--certify'] else slow}"
        "from statechart.cli.main import program; code = program(); "
        "print([n for n in ('numba', 'scipy', 'heyoka', 'networkx', 'scipy.linalg') "
        "if n in sys.modules], file=sys.stderr); "
        "tasks = '/proc/self/task'; "
        "print(len(os.listdir(tasks)) if os.path.isdir(tasks) else 1, file=sys.stderr); "
        "sys.exit(code)"
    )
    # The first certificate imports more than one that finds its code on disk.
    for _ in range(2 if options else 1):
        done = subprocess.run(
            [sys.executable, "-c", script, name, model, *options],
            capture_output=True,
            text=True,
            check=True,
        )
    # A run searches for events with heyoka, and a certificate is compiled.
    expected = ["heyoka"] if name == "run" else []
    found, threads = done.stderr.splitlines()[-2:]
    if options == ["--certify"]:
        expected = ["numba", "scipy", "heyoka", "scipy.linalg"]
    assert found == str(expected)
    assert threads == "1"
