"""Compiled kernels that numba keeps on disk."""

from __future__ import annotations

import hashlib
import importlib
import itertools
import os
import pickle
import sys
from types import FunctionType, SimpleNamespace

import numba
import numpy as np
import pytest
from numba import njit
from numba.core.caching import NullCache
from numba.core.runtime import _nrt_python, rtsys

from statechart.arrays import Array
from statechart.kernels import machine_code
from statechart.kernels.jit import is_cached, kernel, part

LOWER = """\
from statechart.kernels.jit import {decorator}

@{decorator}
def lower(x):
    return x + {number}
"""
UPPER = """\
from lower_kernels import lower
from statechart.kernels.jit import kernel

@kernel
def upper(x):
    return 2.0 * lower(x)
"""
CALLER = """\
from lower_kernels import lower
from statechart.kernels.jit import kernel

@kernel
def caller(whole):
    return lower(1) + lower(2) + lower(whole[0])
"""


def _sum_of_rows(values: Array, pair: tuple[Array, Array]) -> float:
    left, right = pair
    total = 0.0
    for i in range(values.shape[0]):
        row = values[i]
        for k in range(row.shape[0]):
            total += row[k] * left[k] - right[k:][0]
    return total


def _of_a_copy(values: Array, pair: tuple[Array, Array]) -> float:
    return values.copy()[0, 0] + pair[0][0]


def _of_those_chosen(values: Array, pair: tuple[Array, Array]) -> float:
    return pair[0][pair[1] > 0.0][0] + values[0, 0]


def _first_row(values: Array, pair: tuple[Array, Array]) -> Array:
    return values[0]


@pytest.mark.parametrize(
    ("function", "counts"),
    [(_sum_of_rows, False), (_of_a_copy, True), (_of_those_chosen, True), (_first_row, True)],
)
def test_references_are_counted_where_arrays_are_made_or_given_back(function, counts):
    compiled = kernel(function)
    compiled.made._cache = NullCache()
    values, pair = np.array([[1.0, 2.0], [3.0, 4.0]]), (np.array([5.0, 6.0]), np.ones(2))
    references = sys.getrefcount(values), sys.getrefcount(pair[0])
    assert np.array_equal(compiled(values, pair), function(values, pair))
    assert (sys.getrefcount(values), sys.getrefcount(pair[0])) == references
    (code,) = compiled.made.inspect_llvm().values()
    body = code[code.index("define ") :].partition("\n}")[0]
    assert ("@NRT_" in body) == counts


@part
def _halves(values: Array) -> tuple[Array, Array]:
    middle = values.shape[0] // 2
    return values[:middle], values[middle:]


@part
def _swapped(pair: tuple[Array, Array]) -> tuple[Array, Array]:
    return pair[1], pair[0].reshape((1, pair[0].shape[0]))[0]


def _kept_by_views(values: Array, count: int) -> Array:
    """Views outlive the names of what they look at, and are of what was given or of what is new."""
    right, left = _swapped(_halves(values))
    for k in range(count):
        new = np.full(values.shape[0], float(k))
        if k % 3 > 0:
            left, right = _halves(new)
        else:
            right, _ = _halves(left + right)
            left = values[: right.shape[0]]
    return np.append(left, right) if count > 0 else left


def _in_python(values: Array, count: int) -> Array:
    names = {"np": np, "_halves": _halves.py_func, "_swapped": _swapped.py_func}
    return FunctionType(_kept_by_views.__code__, names)(values, count)


@pytest.fixture
def counted_memory():
    _nrt_python.memsys_enable_stats()
    yield
    _nrt_python.memsys_disable_stats()


@pytest.mark.parametrize("count", range(5))
def test_views_of_arrays_that_are_new_keep_them(count, counted_memory):
    compiled = kernel(_kept_by_views)
    compiled._cache = NullCache()
    values = np.arange(8.0)
    compiled(values, count)
    held, made = sys.getrefcount(values), rtsys.get_allocation_stats()
    for _ in range(10):
        found = compiled(values, count)
        expected = _in_python(values, count)
        assert np.array_equal(found, expected)
        del found, expected
    now = rtsys.get_allocation_stats()
    assert now.alloc - made.alloc == now.free - made.free
    assert sys.getrefcount(values) == held


@pytest.fixture
def upper(tmp_path, monkeypatch):
    """Return what writes both files, imports them as a new process would, and gives `upper`."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def imported(decorator, number):
        (tmp_path / "upper_kernels.py").write_text(UPPER)
        (tmp_path / "lower_kernels.py").write_text(LOWER.format(decorator=decorator, number=number))
        for name in ("upper_kernels", "lower_kernels"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("upper_kernels").upper

    yield imported
    for name in ("upper_kernels", "lower_kernels"):
        sys.modules.pop(name, None)


def test_numba_still_has_the_stamp_that_kernels_replace():
    compiled = njit(cache=True)(lambda x: x)
    file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    assert hasattr(file, "_source_stamp"), (
        "this numba keeps the age of a cached kernel's source elsewhere: find where, and let "
        "statechart.kernels.machine_code replace it there"
    )


@pytest.mark.parametrize("decorator", ["kernel", "part"])
def test_an_edit_in_another_file_is_seen(upper, decorator):
    first = upper(decorator, "10.0")
    assert not is_cached(first)
    assert first(1.0) == 22.0
    again = upper(decorator, "10.0")
    assert is_cached(again)  # written anew, and newer, but the text is the same
    edited = upper(decorator, "10.25")
    assert edited(1.0) == 22.5


def test_an_unchanged_kernel_comes_from_the_disk(upper, tmp_path):
    upper("kernel", "10.0")(1.0)
    found = again()
    assert is_cached(found)
    assert found(1.0) == 22.0
    assert found.made.stats.cache_hits


def again():
    """Import the files as they are once more, as a new process would."""
    for name in ("upper_kernels", "lower_kernels"):
        sys.modules.pop(name)
    return importlib.import_module("upper_kernels").upper


def signed(data):
    """Return what another version would have left, with its digest."""
    return data + hashlib.blake2b(data, digest_size=16).digest()


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [
        ("nbi", lambda data: b""),
        ("nbi", lambda data: data[: len(data) // 2]),
        ("nbc", lambda data: data[:-1]),
        # One bit of the machine code: it would be run as it is.
        ("nbc", lambda data: data[:-200] + bytes([data[-200] ^ 1]) + data[-199:]),
        ("nbc", lambda data: pickle.dumps(7)),
        ("nbi", lambda data: signed(pickle.dumps(numba.__version__) + b"cgone.away\nName\n.")),
        ("nbc", lambda data: signed(b"cpathlib\nGone\n.")),
    ],
    ids=["empty index", "half an index", "short", "bit", "other", "no such module", "no such name"],
)
def test_a_damaged_file_of_the_cache_is_made_again(upper, tmp_path, suffix, damage):
    upper("kernel", "10.0")(1.0)
    (file,) = tmp_path.glob(f"**/upper*.{suffix}")
    file.write_bytes(damage(file.read_bytes()))
    found = again()
    assert is_cached(found) == (suffix == "nbc")
    assert found(1.0) == 22.0
    assert not found.made.stats.cache_hits
    after = again()
    assert after(1.0) == 22.0
    assert after.made.stats.cache_hits


@pytest.mark.parametrize("damaged", ["lower", "upper"])
def test_what_calls_a_kernel_that_was_compiled_again_is_compiled_again(upper, tmp_path, damaged):
    upper("kernel", "10.0")(1.0)
    for file in tmp_path.glob(f"**/{damaged}*.nbc"):
        file.write_bytes(b"")
    found = again()
    assert found(1.0) == 22.0
    assert not found.made.stats.cache_hits
    assert bool(lower_of(found).made.stats.cache_hits) == (damaged == "upper")
    after = again()
    assert after(1.0) == 22.0
    assert after.made.stats.cache_hits
    assert lower_of(after).made.stats.cache_hits


def lower_of(upper):
    return upper.py_func.__globals__["lower"]


@pytest.fixture
def taken(upper, tmp_path):
    """Another process's lock on `upper`, which was compiled; how to let it go, and keep that."""
    fcntl = pytest.importorskip("fcntl")
    upper("kernel", "10.0")(1.0)
    (index,) = tmp_path.glob("**/upper*.nbi")
    kept = index.read_bytes()
    index.unlink()
    place = os.open(index.with_suffix(".lock"), os.O_RDWR)
    fcntl.flock(place, fcntl.LOCK_EX)
    yield lambda: (index.write_bytes(kept), fcntl.flock(place, fcntl.LOCK_UN))
    os.close(place)


def test_what_another_process_compiles_is_waited_for(taken, monkeypatch):
    waits = []

    def sleep(seconds):
        waits.append(seconds)
        if len(waits) == 3:
            taken()

    monkeypatch.setattr(machine_code, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: 0.0))
    found = again()
    assert found(1.0) == 22.0
    assert len(waits) == 3
    assert found.made.stats.cache_hits


def test_a_process_that_has_stopped_is_not_waited_for(taken, monkeypatch):
    clock = itertools.count(0.0, 50.0)
    silent = SimpleNamespace(sleep=lambda seconds: None, monotonic=lambda: next(clock))
    monkeypatch.setattr(machine_code, "time", silent)
    found = again()
    assert found(1.0) == 22.0
    assert not found.made.stats.cache_hits


def test_what_fails_to_compile_keeps_nobody_waiting(taken, upper, tmp_path):
    taken()
    fcntl = importlib.import_module("fcntl")
    with pytest.raises(Exception, match="upper"):
        again()("text")
    for file in tmp_path.glob("**/*.lock"):
        with file.open("r+") as place:
            fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)


@pytest.mark.parametrize("decorator", ["kernel", "part"])
def test_literals_and_widths_of_integers_are_no_other_signature(upper, tmp_path, decorator):
    (tmp_path / "caller_kernels.py").write_text(CALLER)
    function = upper(decorator, "10.0")
    caller = importlib.import_module("caller_kernels").caller
    sys.modules.pop("caller_kernels")
    lower = lower_of(function)
    assert caller(np.array([3], np.int32)) == 36.0
    assert [signature[0].name for signature in lower.made.overloads] == ["int64"]


def test_a_kernel_runs_where_its_cache_cannot_be_written(upper, tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.os.replace", full)
    assert upper("kernel", "10.0")(1.0) == 22.0
    assert not list(tmp_path.glob("**/upper*.nb*"))


def test_a_kernel_runs_where_no_folder_can_hold_a_cache(upper, monkeypatch):
    monkeypatch.setattr("numba.core.caching.CacheImpl._locator_classes", [])
    found = upper("kernel", "10.0")
    assert found(1.0) == 22.0
    assert not is_cached(found)
