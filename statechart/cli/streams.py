"""Standard streams of the process; write errors are reported in one sentence."""

from __future__ import annotations

import errno
import io
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TextIO

from statechart.errors import StatechartError


def take_streams() -> None:
    """Replace stdout and stderr by streams that explain their errors."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # Else the next file that is opened would get the output.
            os.open(os.devnull, os.O_RDWR)
    sys.stdout, sys.stderr = _Out(sys.stdout), _Err(sys.stderr)


def be_quiet() -> None:
    """Keep warnings and logs of libraries, and interrupted callbacks, off stderr."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    report = sys.unraisablehook

    def report_others(unraisable: sys.UnraisableHookArgs) -> None:
        # A signal in a callback of the interpreter raises nothing; it is counted all the same.
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            report(unraisable)

    sys.unraisablehook = report_others


class _Stream(io.TextIOBase):
    """A standard stream that may be closed."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return "utf-8" if self._stream is None else self._stream.encoding


class _Out(_Stream):
    """Stdout; an error of writing it is a `StatechartError`, once."""

    def write(self, text: str) -> int:
        stream = self._stream
        with self._explained():
            if stream is None:
                raise OSError(errno.EBADF, "it is closed")
            return stream.write(text)
        raise AssertionError

    def flush(self) -> None:
        if self._stream is not None:
            with self._explained():
                self._stream.flush()

    def fileno(self) -> int:
        return 1

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except BrokenPipeError:
            raise
        except OSError as error:
            # The rest of its buffer would fail again at the end of the process.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            raise StatechartError(f"cannot write to stdout: {error.strerror or error}") from None


class _Err(_Stream):
    """Stderr; errors of writing it are ignored."""

    def write(self, text: str) -> int:
        with suppress(OSError):
            if self._stream is not None:
                self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            if self._stream is not None:
                self._stream.flush()
