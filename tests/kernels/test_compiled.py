"""Compiled kernels, and their machine code on disk."""

from __future__ import annotations

import gc
import importlib
import sys
import threading
import time
from pathlib import Path
from types import FunctionType
from typing import NamedTuple

import numpy as np
import pytest
from filelock import FileLock
from numba.core.runtime import _nrt_python, rtsys

from statechart.arrays import Array
from statechart.kernels import cache
from statechart.kernels.jit import Kernel, kernel

LOWER = """\
from statechart.kernels.jit import kernel

@kernel
def lower(x):
    return x + {number}
"""
UPPER = """\
from lower_kernels import lower
from statechart.kernels.jit import kernel

@kernel(interpreted=False)
def upper(x):
    return 2.0 * lower(x)
"""
CALLER = """\
from lower_kernels import lower
from statechart.kernels.jit import kernel

@kernel(interpreted=False)
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


class _Named(NamedTuple):
    rows: Array
    others: Array


def _numbers_of_a_tuple(values: Array, pair: tuple[Array, Array]) -> float:
    named = _Named(values, pair[0])
    total, factor = named.rows[0]
    for i in range(named.rows.shape[0]):
        left, right = named.rows[i]
        total += left * factor - right
    return total + named.others[0]


def _of_a_copy(values: Array, pair: tuple[Array, Array]) -> float:
    return values.copy()[0, 0] + pair[0][0]


def _of_those_chosen(values: Array, pair: tuple[Array, Array]) -> float:
    return pair[0][pair[1] > 0.0][0] + values[0, 0]


def _first_row(values: Array, pair: tuple[Array, Array]) -> Array:
    return values[0]


@pytest.mark.parametrize(
    ("function", "counts"),
    [
        (_sum_of_rows, False),
        (_numbers_of_a_tuple, False),
        (_of_a_copy, True),
        (_of_those_chosen, True),
        (_first_row, True),
    ],
)
def test_references_are_counted_when_arrays_are_created_or_returned(function, counts):
    compiled = Kernel(function, interpreted=False)
    compiled.cache._folders.clear()  # loaded code has no text
    values, pair = np.array([[1.0, 2.0], [3.0, 4.0]]), (np.array([5.0, 6.0]), np.ones(2))
    references = sys.getrefcount(values), sys.getrefcount(pair[0])
    assert np.array_equal(compiled(values, pair), function(values, pair))
    gc.collect()  # exceptions within the compiler may hold arguments
    assert (sys.getrefcount(values), sys.getrefcount(pair[0])) == references
    (code,) = compiled.compiled.inspect_llvm().values()
    body = code[code.index("define ") :].partition("\n}")[0]
    assert ("@NRT_" in body) == counts


@kernel
def _halves(values: Array) -> _Named:
    middle = values.shape[0] // 2
    return _Named(values[:middle], values[middle:])


@kernel
def _swapped(pair: tuple[Array, Array]) -> tuple[Array, Array]:
    return pair[1], pair[0].reshape((1, pair[0].shape[0]))[0]


def _kept_by_views(values: Array, count: int) -> Array:
    """Views outlive the names of their arrays, which are arguments or new."""
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
def test_views_keep_new_arrays_alive(count, counted_memory):
    compiled = Kernel(_kept_by_views, interpreted=False)
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
    """Return a function that writes both files and imports `upper` as a new process would."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def imported(number="10.0"):
        (tmp_path / "upper_kernels.py").write_text(UPPER)
        (tmp_path / "lower_kernels.py").write_text(LOWER.format(number=number))
        forget()
        importlib.invalidate_caches()
        return importlib.import_module("upper_kernels").upper

    yield imported
    forget()


def forget():
    for name in ("upper_kernels", "lower_kernels"):
        sys.modules.pop(name, None)


def files(tmp_path):
    return list(tmp_path.glob("**/*.kernel"))


@pytest.fixture
def compilations(monkeypatch):
    """Names of the functions that are compiled for calls from Python."""
    found: list[str] = []
    save = cache.CodeCache.save

    def saved(kept, key, data):
        found.append(kept._name)
        save(kept, key, data)

    monkeypatch.setattr(cache.CodeCache, "save", saved)
    return found


def test_an_edit_in_another_file_invalidates_cached_code(upper, tmp_path, compilations):
    first = upper()
    assert not first.is_cached
    assert first(1.0) == 22.0
    again = upper()
    assert again.is_cached  # written anew, and newer, but the text is the same
    assert again(1.0) == 22.0
    assert len(compilations) == 1
    edited = upper("10.25")
    assert not edited.is_cached
    assert edited(1.0) == 22.5
    # The code of a source that is gone does not stay.
    assert len(files(tmp_path)) == 1


def test_a_copied_tree_finds_its_code(upper, tmp_path, compilations, monkeypatch):
    upper()(1.0)
    copy = tmp_path / "copy"
    (copy / "__pycache__").mkdir(parents=True)
    for file in (*tmp_path.glob("*.py"), *files(tmp_path)):
        (copy / file.relative_to(tmp_path)).write_bytes(file.read_bytes())
    monkeypatch.syspath_prepend(copy)
    forget()
    importlib.invalidate_caches()
    found = importlib.import_module("upper_kernels").upper
    assert Path(found.py_func.__code__.co_filename).parent == copy
    assert found(1.0) == 22.0
    assert len(compilations) == 1


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        # One bit of the machine code: it would be run as it is.
        lambda data: data[:-200] + bytes([data[-200] ^ 1]) + data[-199:],
        # Another version's, whole and of no use.
        lambda data: cache._digest(b"cpathlib\nGone\n.") + b"cpathlib\nGone\n.",
    ],
    ids=["empty", "short", "bit", "other"],
)
def test_damaged_cache_file_is_rebuilt(upper, tmp_path, damage, compilations):
    upper()(1.0)
    (file,) = files(tmp_path)
    file.write_bytes(damage(file.read_bytes()))
    for _ in range(2):
        assert upper()(1.0) == 22.0
    assert len(compilations) == 2


def test_a_process_waits_for_another_that_compiles_the_kernel(upper, tmp_path, compilations):
    upper()(1.0)
    (file,) = files(tmp_path)
    kept = file.read_bytes()
    file.unlink()
    lock = FileLock(next(tmp_path.glob("**/*.lock")), thread_local=False)
    lock.acquire()

    def end():
        time.sleep(0.3)
        file.write_bytes(kept)
        lock.release()

    other = threading.Thread(target=end)
    other.start()
    assert upper()(1.0) == 22.0
    other.join()
    assert len(compilations) == 1


def test_stopped_process_is_not_awaited(upper, tmp_path, compilations, monkeypatch):
    upper()(1.0)
    files(tmp_path)[0].unlink()
    monkeypatch.setattr(cache, "_PATIENCE", 0.05)
    with FileLock(next(tmp_path.glob("**/*.lock"))):
        assert upper()(1.0) == 22.0
    assert len(compilations) == 2


def test_a_failed_compilation_releases_waiting_processes(upper, tmp_path):
    with pytest.raises(Exception, match="upper"):
        upper()("text")
    for file in tmp_path.glob("**/*.lock"):
        FileLock(file).acquire(blocking=False).lock.release()


def test_integer_literals_share_a_signature(upper, tmp_path):
    (tmp_path / "caller_kernels.py").write_text(CALLER)
    upper()
    caller = importlib.import_module("caller_kernels").caller
    sys.modules.pop("caller_kernels")
    lower = caller.py_func.__globals__["lower"]
    assert caller(np.array([3], np.int32)) == 36.0
    assert [signature[0].name for signature in lower.inner.overloads] == ["int64"]


def test_a_kernel_with_a_read_only_source_is_cached_for_the_user(
    upper, tmp_path, compilations, monkeypatch
):
    monkeypatch.setattr(cache.Path, "home", lambda: tmp_path / "home")
    (tmp_path / "__pycache__").write_text("in the way")
    assert upper()(1.0) == 22.0
    assert [file.parent for file in files(tmp_path)] == [tmp_path / "home/.cache/statechart"]
    assert upper()(1.0) == 22.0
    assert len(compilations) == 1


def test_a_kernel_runs_where_its_cache_cannot_be_written(upper, tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache.Path, "write_bytes", full)
    assert upper()(1.0) == 22.0
    assert not files(tmp_path)
