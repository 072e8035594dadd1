"""A store belongs to one process at a time: the one that holds a lock on its folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from statechart.documents.files import made
from statechart.errors import DeclarationError, StatechartError

try:
    import fcntl
except ImportError:  # Windows, which locks no folders
    fcntl = None  # type: ignore[assignment]

_held: set[int] = set()


class Claim:
    """A folder that no other process takes meanwhile.

    Parameters
    ----------
    path : Path
        The folder.
    place : int
        The file descriptor that holds its lock.
    """

    def __init__(self, path: Path, place: int) -> None:
        self._path, self._place = path, place

    def check(self) -> None:
        """Raise `StatechartError` if the folder is gone, or another one is in its place."""
        try:
            here = os.path.samestat(os.fstat(self._place), self._path.stat())
        except OSError:
            here = False
        if not here:
            raise StatechartError(
                f"{self._path} was removed while it was written; begin the sweep anew"
            )


@contextmanager
def claimed(path: Path) -> Iterator[Claim | None]:
    """Hold a folder, which is made if it does not exist; None where no folder can be held.

    Where the work in it fails before anything is written, no folder is left. The lock ends with the
    process, however that ends.

    Raises
    ------
    DeclarationError
        If another process holds it.
    StatechartError
        If it cannot be made.
    """
    with ExitStack() as stack:
        try:
            if not path.exists() or path.is_dir():
                stack.enter_context(made(path))
        except OSError as error:
            raise StatechartError(f"cannot write {path}: {error.strerror or error}") from error
        if fcntl is None or not path.is_dir():
            yield None
            return
        place = os.open(path, os.O_RDONLY)
        _held.add(place)
        try:
            _lock(path, place)
            yield Claim(path, place)
        finally:
            if place in _held:
                _held.discard(place)
                os.close(place)


def _lock(path: Path, place: int) -> None:
    try:
        fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DeclarationError(
            f"another process is writing {path}",
            advice="wait until it has ended, or name another store",
        ) from None
    except OSError:  # a file system of a network without such locks
        pass


def _let_go() -> None:
    """Let a process that was forked hold nothing: it may outlive the one that holds."""
    while _held:
        os.close(_held.pop())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)
