"""Machine code of kernels on disk.

A file holds the code of one kernel for one signature. Its name depends on the content of all files
whose kernels it can see, so that an edit in one file never runs with old code of another; where the
files lie, and since when, does not matter. A file that was cut off or damaged, or that cannot be
written, does not end a run: the code is compiled again.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

_DIGEST = 16  # bytes: damage is an accident, not an attack

_PATIENCE = 300.0  # seconds until another process that compiles is thought to have stopped


class Compilable:
    """A function that is compiled into each kernel that calls it."""

    py_func: Callable[..., Any]

    @property
    def inner(self) -> Any:
        """Numba's dispatcher for calls from kernels."""
        raise NotImplementedError


class CodeCache:
    """Files of one kernel."""

    def __init__(self, function: Any) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._folders: list[Path] = []
        beside, user = Path(function.__code__.co_filename).parent, Path.home() / ".cache"
        stamps: dict[str, bytes] = {}
        # A function without a file is not kept.
        with suppress(OSError):
            for name in ("jit", "compiler", "lowering", "cache"):
                stamps[name] = _content(Path(__file__).with_name(f"{name}.py"))
            _collect(function, stamps)
            self._folders = [beside / "__pycache__", user / "statechart"]
        self._stamp = _hex(repr((sys.version_info[:2], sorted(stamps.items()))))
        if "NUMBA_CACHE_DIR" in os.environ:
            self._folders[:0] = [Path(os.environ["NUMBA_CACHE_DIR"])]

    def is_filled(self) -> bool:
        """Return whether code for some signature lies on disk."""
        return any(any(folder.glob(self._file("*"))) for folder in self._folders)

    def load(self, key: str) -> bytes | None:
        """Return the code stored under a key; remove a damaged file."""
        for folder in self._folders:
            # A folder that cannot be read has nothing.
            with suppress(OSError):
                file = folder / self._file(_hex(key))
                data = file.read_bytes()
                if data[:_DIGEST] == _digest(data[_DIGEST:]):
                    return data[_DIGEST:]
                file.unlink()
        return None

    def save(self, key: str, data: bytes) -> None:
        """Store code under a key, in the first folder that can be written."""
        for folder in self._folders:
            with suppress(OSError):
                folder.mkdir(parents=True, exist_ok=True)
                file = folder / self._file(_hex(key))
                new = file.with_suffix(f".{os.getpid()}")
                try:
                    new.write_bytes(_digest(data) + data)
                    for old in folder.glob(f"{self._name}.{_hex(key)}.*.kernel"):
                        old.unlink()
                    new.replace(file)
                finally:
                    new.unlink(missing_ok=True)
                return

    @contextmanager
    def turn(self) -> Iterator[None]:
        """Let one process compile at a time, as far as files can be locked."""
        from filelock import FileLock  # slow import

        with ExitStack() as stack:
            for folder in self._folders:
                # A folder that cannot be written, no locks, or a process that has stopped.
                with suppress(OSError, NotImplementedError):
                    folder.mkdir(parents=True, exist_ok=True)
                    lock = FileLock(folder / f"{self._name}.lock", timeout=_PATIENCE)
                    stack.enter_context(lock)
                    break
            yield

    def _file(self, key: str) -> str:
        return f"{self._name}.{key}.{self._stamp}.kernel"


def _collect(function: Any, stamps: dict[str, bytes]) -> None:
    """Add the digest of the file of a function, and of those whose kernels that can see."""
    if function.__module__ in stamps:
        return
    stamps[function.__module__] = _content(Path(function.__code__.co_filename))
    for value in function.__globals__.values():
        if isinstance(value, Compilable):
            _collect(value.py_func, stamps)


def _content(file: Path) -> bytes:
    found = file.stat()
    return _content_since(file, found.st_mtime, found.st_size)


@cache
def _content_since(file: Path, changed: float, size: int) -> bytes:
    """Return the digest of a file that was last changed then."""
    return _digest(file.read_bytes())


def _digest(data: bytes) -> bytes:
    from hashlib import blake2b  # slow import

    return blake2b(data, digest_size=_DIGEST).digest()


def _hex(text: str) -> str:
    return _digest(text.encode()).hex()
