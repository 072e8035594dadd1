"""Reports in parts: a part that fails or is interrupted does not stop the others."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from statechart import interrupts

T = TypeVar("T")

SOME = 4_000
"""Events, or rows of samples, in a short form; some tenths of a second."""

_NUMBERS = 2**17  # values in a short form, for any number of variables

_INTERRUPTED = "interrupted"


def short_length(width: int) -> int:
    """Return the number of rows of `width` values in a short form."""
    return max(1, min(SOME, _NUMBERS // max(width, 1)))


class PartialReport:
    """Runs the parts of a report; `failed` maps the parts that failed to their reason.

    SIGINT or SIGTERM ends the current part and skips the following ones; parts run by `keep` are
    then written in a short form.
    """

    def __init__(self, *, strict: bool = False) -> None:
        self.failed: dict[str, str] = {}
        self._strict = strict
        self._signals = interrupts.signal_count()

    @property
    def hurried(self) -> bool:
        """Return whether a signal to end has arrived, so that slow reports are skipped."""
        return not self._strict and interrupts.signal_count() > 0

    def attempt(self, name: str, work: Callable[[], T], otherwise: T) -> T:
        """Return `work()`; if it fails, record the reason and return `otherwise`."""
        if self._strict:
            return work()
        try:
            if self._over():
                raise KeyboardInterrupt
            with interrupts.let_through():
                return work()
        except KeyboardInterrupt:
            self.failed[name] = _INTERRUPTED
        except Exception as error:
            if os.environ.get("STATECHART_DEBUG") == "1":
                raise
            # In compiled code a signal becomes another error.
            self.failed[name] = _INTERRUPTED if self._over() else reason(error)
        return otherwise

    def keep(self, name: str, work: Callable[[bool], T], otherwise: T) -> T:
        """Return ``work(False)``, or the short form ``work(True)`` after a signal to end."""
        if not self.hurried:
            done = self.attempt(name, partial(work, False), otherwise)
            if self.failed.get(name) != _INTERRUPTED:
                return done
            del self.failed[name]
        self._signals, before = interrupts.signal_count(), self._signals
        try:
            with interrupts.deferred(firmly=True):
                return self.attempt(name, partial(work, True), otherwise)
        finally:
            self._signals = before

    def some(self, what: str, items: Sequence[T], width: int = 1) -> tuple[T, ...]:
        """Return at most `short_length` items, evenly chosen, and record the number of others."""
        chosen = tuple(items[:: max(1, -(-len(items) // short_length(width)))])
        if len(chosen) < len(items):
            self.leave(f"{len(items) - len(chosen)} of {len(items)} {what}")
        return chosen

    def leave(self, *names: str) -> None:
        """Record parts as interrupted."""
        self.failed |= dict.fromkeys(names, _INTERRUPTED)

    def text(self) -> str:
        """Return the failed parts with their reasons: ``a, b (disk full), c (interrupted)``."""
        why: dict[str, list[str]] = {}
        for name, reason in self.failed.items():
            why.setdefault(reason, []).append(name)
        return ", ".join(f"{', '.join(names)} ({reason})" for reason, names in why.items())

    def _over(self) -> bool:
        return interrupts.signal_count() > self._signals


def reason(error: Exception) -> str:
    """Return a short description of an error."""
    if isinstance(error, MemoryError):
        return "out of memory"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error) or type(error).__name__
