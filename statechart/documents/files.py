"""Bounded reading and atomic writing of files.

Names of temporary files contain machine and process: the next writer removes those of killed
processes.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from statechart.errors import DeclarationError, StatechartError

_FILES = (
    ".html", ".htm", ".nc", ".csv", ".gif", ".json", ".mp4", ".pdf", ".png", ".svg", ".txt",
    ".xlsx", ".yaml",
)  # fmt: skip


def read_bounded(path: Path, most: int, advice: str) -> bytes:
    """Return at most `most` + 1 bytes of a regular file, or raise `DeclarationError`."""
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
    """Write a file atomically; after an `OSError`, as of a full disk, it is unchanged."""
    _sweep(path.parent, path.name)
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=_prefix(path.name))
    try:
        with os.fdopen(descriptor, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
            os.chmod(temporary, 0o666 & ~_umask())
            os.replace(temporary, path)
    except BaseException:
        with suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


@contextmanager
def explain_os_errors(verb: str, path: Path | str, advice: str = "") -> Iterator[None]:
    """Raise `StatechartError` with `advice` for an `OSError`: "cannot `verb` `path`"."""
    try:
        yield
    except OSError as error:
        reason = f"{error.strerror or error}{advice and '; '}{advice}"
        raise StatechartError(f"cannot {verb} {path}: {reason}") from error


def obstacle(path: Path) -> str:
    """Return why a path cannot be created, or an empty text; its folders need not exist.

    A trial write, since permissions do not show read-only disks, and mean nothing to root.
    """
    place = next(known for known in (path, *path.parents) if os.path.exists(known))
    if not place.is_dir():
        return f"{place} is a file"
    try:
        with tempfile.TemporaryFile(dir=place):
            return ""
    except OSError:
        return f"{place} is not writable"


def check_folder_name(folder: Path | str, option: str = "") -> None:
    """Raise `DeclarationError` for a new folder of results with the name of a file."""
    path = Path(folder)
    if path.suffix.lower() in _FILES and not path.is_dir():
        message = f"{option}{folder}: the results are several files, in a folder"
        raise DeclarationError(message, advice=f"write {option}{path.with_suffix('')}")


@contextmanager
def new_folder(folder: Path) -> Iterator[None]:
    """Create a folder and its parents; remove the new ones if the work in it fails."""
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
def staging_folder(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    """Stage files that appear in `folder` at the end, and not at all after an error.

    A new folder appears atomically. In an existing one, files are replaced one by one, and files of
    `names` that were not written are removed. Raises `OSError` if that fails.
    """
    # Inside an existing folder, whose parent may be read-only or on another disk.
    exists = folder.exists()
    place = folder if exists else folder.parent
    with new_folder(place):
        for left in {place, folder.parent}:
            _sweep(left, folder.name)
        temporary = Path(tempfile.mkdtemp(dir=place, prefix=_prefix(folder.name)))
        try:
            yield temporary
            if exists:
                for name in sorted({*names}):
                    if (temporary / name).exists():
                        os.replace(temporary / name, folder / name)
                    else:
                        (folder / name).unlink(missing_ok=True)
            else:
                os.chmod(temporary, 0o777 & ~_umask())
                os.replace(temporary, folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _prefix(name: str, process: object = None) -> str:
    return f".{name}.{platform.node()}-{process or os.getpid()}-"


def _sweep(place: Path, name: str) -> None:
    """Remove the temporary files and folders of `name` of ended processes (POSIX)."""
    if os.name != "posix" or not place.is_dir():
        return
    pattern = re.compile(re.escape(_prefix(name, "PID")).replace("PID", "([0-9]+)") + "[a-z0-9_]+")
    for found in os.listdir(place):
        match = pattern.fullmatch(found)
        if match is None or _is_alive(int(match[1])) or (place / found).is_symlink():
            continue
        with suppress(OSError):
            remove = shutil.rmtree if (place / found).is_dir() else os.unlink
            remove(place / found)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (OSError, OverflowError) as error:
        return not isinstance(error, ProcessLookupError)  # else another user's
    return True


def _umask() -> int:
    umask = os.umask(0)
    os.umask(umask)
    return umask
