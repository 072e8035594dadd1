"""Kernels that numba compiles once and keeps on disk, across several files.

numba's cache looks only at the file of the function that is called: where that calls kernels of
another file, an edit there would silently run the old code. Here a kernel's cache is as old as the
newest of all files whose kernels it can see.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core.dispatcher import Dispatcher

__all__ = ["is_cached", "kernel", "part"]

F = TypeVar("F", bound=Callable[..., Any])


def kernel(function: F) -> F:
    """Compile a function when it is first called, from Python or from other kernels; cached."""
    # Without what C would need to call it, it compiles sooner.
    compiled = njit(cache=True, error_model="numpy", no_cfunc_wrapper=True)(function)
    stamps: dict[str, tuple[float, int]] = {}
    _collect(function, stamps)
    compiled._cache._cache_file._source_stamp = tuple(sorted(stamps.items()))
    return compiled


def part(function: F) -> F:
    """Compile a function that only kernels call."""
    return njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


def is_cached(compiled: Any) -> bool:
    """Whether a kernel lies compiled on disk, for the files as they are."""
    return bool(compiled._cache._cache_file._load_index())


def _collect(function: Callable[..., Any], stamps: dict[str, tuple[float, int]]) -> None:
    file = function.__code__.co_filename
    if file in stamps:
        return
    found = Path(file).stat()
    stamps[file] = found.st_mtime, found.st_size
    for value in function.__globals__.values():
        if isinstance(value, Dispatcher):
            _collect(value.py_func, stamps)
