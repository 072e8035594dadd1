"""Work of several pieces of which some may fail: the others are done all the same."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TypeVar

from statechart import interrupts

__all__ = ["Pieces"]

T = TypeVar("T")


class Pieces:
    """What is done of a piece of work.

    A signal to end that comes now ends the piece at hand and leaves out those that follow, except
    those that are `kept`.

    Attributes
    ----------
    failed : dict of str to str
        What could not be done, and why.
    """

    def __init__(self) -> None:
        self.failed: dict[str, str] = {}
        self._signals = interrupts.arrived()

    def attempt(self, name: str, work: Callable[[], T], otherwise: T) -> T:
        """Do a piece of work; where it fails, note why and return `otherwise`."""
        try:
            if self._over():
                raise KeyboardInterrupt
            with interrupts.let_through():
                return work()
        except KeyboardInterrupt:
            self.failed[name] = "interrupted"
        except Exception as error:
            if os.environ.get("STATECHART_DEBUG") == "1":
                raise
            # In compiled code a signal becomes another error.
            self.failed[name] = "interrupted" if self._over() else reason(error)
        return otherwise

    def keep(self, name: str, work: Callable[[], T], otherwise: T) -> T:
        """Do a piece of work as `attempt` does, whatever signals come."""
        self._signals, before = interrupts.arrived(), self._signals
        try:
            with interrupts.held(firmly=True):
                return self.attempt(name, work, otherwise)
        finally:
            self._signals = before

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
