"""Files read up to a bound, and whole files or none: nothing half-written is ever left behind.

What a killed process leaves is removed by the next one that writes there. It is told from the work
of a process that lives by a lock on it.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from statechart.errors import DeclarationError

_RANDOM = "[a-z0-9_]{8}"  # as `tempfile` writes it
_PART = ".part"
# Windows has none: what is left behind stays there.
_LOCKS = find_spec("fcntl") is not None


def read_bounded(path: Path, most: int, advice: str) -> bytes:
    """Return the first `most` + 1 bytes of a regular file, or all where it is shorter.

    Raises `DeclarationError` if it is missing, no regular file, or cannot be read.
    """
    source = str(path)
    try:
        if path.is_dir():
            raise DeclarationError("this is a folder", advice=advice, source=source)
        if path.exists() and not path.is_file():
            raise DeclarationError("not a file", advice=advice, source=source)
        with path.open("rb") as stream:
            return stream.read(most + 1)
    except FileNotFoundError:
        raise DeclarationError("no such file", source=source) from None
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise DeclarationError(f"cannot be read: {why}", source=source) from None


def write_atomic(path: Path, data: bytes) -> None:
    """Write `data` to `path` so that a reader sees the old file or the new one, never a part.

    Raises `OSError` if the folder is missing or not writable, or the disk is full; `path` is then
    as it was.
    """
    _sweep(path.parent, re.compile(rf"\.{re.escape(path.name)}\.{_RANDOM}{re.escape(_PART)}"))
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=_PART)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            _lock(descriptor)
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
            os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, path)
    except BaseException:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


def obstacle(path: Path) -> str:
    """Return why nothing can be made at a path, whose folders need not exist yet, or nothing.

    It is tried in the folder that exists: permissions do not tell of read-only disks, of what no
    file can be made in, nor anything at all to root.
    """
    place = next(known for known in (path, *path.parents) if os.path.exists(known))
    if not place.is_dir():
        return f"{place} is a file"
    try:
        with tempfile.TemporaryFile(dir=place):
            return ""
    except OSError:
        return f"{place} is not writable"


@contextmanager
def made(folder: Path) -> Iterator[None]:
    """Make a folder and its parents; where the work in it fails, remove those that were made."""
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for place in missing:
            with suppress(OSError):
                place.rmdir()
        raise


@contextmanager
def aside(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    """Make a place for files that appear in `folder` at the end, and not at all after an error.

    A new folder appears at once. In one that exists, files are replaced one by one; those of
    `names` that were not written this time are of another time, and removed; others are left alone.
    Raises `OSError` if that cannot be done; what was there is as it was.
    """
    names = set(names)
    # Inside a folder that exists: its parent may be read-only, or on another disk.
    exists = folder.exists()
    place = folder if exists else folder.parent
    with made(place):
        for left in {place, folder.parent}:
            _sweep(left, re.compile(rf"\.{re.escape(folder.name)}\.{_RANDOM}"), names)
        temporary, descriptor = _locked_folder(place, f".{folder.name}.")
        try:
            yield temporary
            if exists:
                for name in sorted(names):
                    if (temporary / name).exists():
                        os.replace(temporary / name, folder / name)
                    else:
                        (folder / name).unlink(missing_ok=True)
            else:
                os.chmod(temporary, 0o777 & ~_umask())
                os.replace(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
            if descriptor is not None:
                os.close(descriptor)


def _locked_folder(place: Path, prefix: str) -> tuple[Path, int | None]:
    while True:
        temporary = Path(tempfile.mkdtemp(dir=place, prefix=prefix))
        if not _LOCKS:
            return temporary, None
        with suppress(FileNotFoundError):
            descriptor = os.open(temporary, os.O_RDONLY)
            _lock(descriptor)
            # Before it was locked another process may have taken it for left behind.
            if temporary.exists():
                return temporary, descriptor
            os.close(descriptor)


def _sweep(place: Path, pattern: re.Pattern[str], names: set[str] | None = None) -> None:
    """Remove what a killed process left: files, or folders that hold nothing but `names`."""
    if not _LOCKS or not place.is_dir():
        return
    for name in os.listdir(place):
        found = place / name
        if not pattern.fullmatch(name) or found.is_symlink() or found.is_dir() == (names is None):
            continue
        with suppress(OSError):
            # Another's folder may bear such a name: what is in it tells.
            if names is not None and not all(map(_ours(names), os.listdir(found))):
                continue
            descriptor = os.open(found, os.O_RDONLY)
            try:
                if _lock(descriptor):
                    remove: Callable[[Path], None] = os.unlink if names is None else shutil.rmtree
                    remove(found)
            finally:
                os.close(descriptor)


def _ours(names: set[str]) -> Callable[[str], bool]:
    temporary = re.compile(rf"\.(.+)\.{_RANDOM}({re.escape(_PART)})?")

    def ours(name: str) -> bool:
        part = temporary.fullmatch(name)
        return (part.group(1) if part else name) in names

    return ours


def _lock(descriptor: int) -> bool:
    """Lock a file or folder as long as the descriptor is open; False if another process has."""
    if not _LOCKS:
        return False
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by another process, or a file system without locks
        return False
    return True


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask
