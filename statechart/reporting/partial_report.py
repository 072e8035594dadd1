"""Work in pieces of which some may fail: the others are done all the same."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

from statechart import interrupts

T = TypeVar("T")

SOME = 4_000
"""Events, or rows of samples, in a short form: they take some tenths of a second."""

_NUMBERS = 2**17  # in a short form of many variables, which has the fewer rows

_INTERRUPTED = "interrupted"


def short_length(width: int) -> int:
    """Return how many rows of so many numbers a short form has."""
    return max(1, min(SOME, _NUMBERS // max(width, 1)))


class PartialReport:
    """Record of a work in parts: which of them are done, and which failed.

    A signal to end that comes now ends the piece at hand and leaves out those that follow; of those
    to `keep` it leaves a short form. `failed` says what could not be done, and why.
    """

    def __init__(self, *, strict: bool = False) -> None:
        self.failed: dict[str, str] = {}
        self._strict = strict
        self._signals = interrupts.arrived()

    @property
    def hurried(self) -> bool:
        """Return whether a signal to end has arrived, so that slow reports are skipped."""
        return not self._strict and interrupts.arrived() > 0

    def attempt(self, name: str, work: Callable[[], T], otherwise: T) -> T:
        """Do a piece of work; where it fails, note why and return `otherwise`."""
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
        """Do ``work(False)``; after a signal to end its short form, ``work(True)``, to its end."""
        if not self.hurried:
            done = self.attempt(name, partial(work, False), otherwise)
            if self.failed.get(name) != _INTERRUPTED:
                return done
            del self.failed[name]
        self._signals, before = interrupts.arrived(), self._signals
        try:
            with interrupts.held(firmly=True):
                return self.attempt(name, partial(work, True), otherwise)
        finally:
            self._signals = before

    def some(self, what: str, items: Sequence[T], width: int = 1) -> tuple[T, ...]:
        """Return at most `short_length` items, evenly chosen; say so where there are more."""
        chosen = tuple(items[:: max(1, -(-len(items) // short_length(width)))])
        if len(chosen) < len(items):
            self.leave(f"{len(items) - len(chosen)} of {len(items)} {what}")
        return chosen

    def leave(self, *names: str) -> None:
        """Note what there is no time for."""
        self.failed |= dict.fromkeys(names, _INTERRUPTED)

    def text(self) -> str:
        """Return what could not be done, and why, such as ``a, b (disk full), c (interrupted)``."""
        why: dict[str, list[str]] = {}
        for name, reason in self.failed.items():
            why.setdefault(reason, []).append(name)
        return ", ".join(f"{', '.join(names)} ({reason})" for reason, names in why.items())

    def _over(self) -> bool:
        return interrupts.arrived() > self._signals


def reason(error: Exception) -> str:
    """Return why something failed, in a few words."""
    if isinstance(error, MemoryError):
        return "out of memory"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error) or type(error).__name__
