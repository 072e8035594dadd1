"""Signals that end a run early and keep its results.

SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt where they arrive. Inside a loop that writes a
trace they would leave it half-written, and inside compiled code they raise another error. Such code
defers them (`deferred`), and the loop calls `check` between its steps. Compilation is long and has
no result to lose: `let_through` lets signals interrupt it.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
# A signal raises KeyboardInterrupt: everywhere, only inside `let_through`, nowhere.
_OPEN, _HELD, _FIRM = range(3)


class _State:
    """Counts of received and of reported signals, and the signals that are deferred."""

    count = reported = 0
    # Whether SIGINT comes to this module already; asking the process for that takes long.
    ours = False
    first = 0.0
    hold = _OPEN


_now = _State()


def listen() -> None:
    """Handle all three signals as SIGINT; ignored signals stay ignored."""
    for number in _SIGNALS:
        # A process that is to outlive its terminal (nohup) ignores SIGHUP.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _note)
            _now.ours = _now.ours or number == signal.SIGINT
    forget()


def forget() -> None:
    """Reset the counts of signals."""
    _now.count = _now.reported = 0


def signal_count() -> int:
    """Return the number of received signals."""
    return _now.count


def check() -> None:
    """Raise KeyboardInterrupt if a signal to end has arrived."""
    if _now.count:
        _now.reported = _now.count
        raise KeyboardInterrupt


@contextmanager
def deferred(*, firmly: bool = False) -> Iterator[None]:
    """Defer signals: only `check` raises.

    In a process that does not `listen` that holds for SIGINT, and for the main thread.
    """
    outer = _now.hold
    lent = (
        not _now.ours
        and threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    )
    if lent:
        forget()
        signal.signal(signal.SIGINT, _note)
        _now.ours = True
    _now.hold = max(outer, _FIRM if firmly else _HELD)
    try:
        yield
    finally:
        _now.hold = outer
        if lent:
            _now.ours = False
            signal.signal(signal.SIGINT, signal.default_int_handler)
            untold = _now.count > _now.reported
            forget()
            if untold:
                signal.raise_signal(signal.SIGINT)


@contextmanager
def let_through() -> Iterator[None]:
    """Let signals raise KeyboardInterrupt at once, inside `deferred`."""
    outer = _now.hold
    if outer == _FIRM:
        yield
        return
    _now.hold = _OPEN
    try:
        if _now.count > _now.reported:
            check()
        yield
    finally:
        _now.hold = outer


@contextmanager
def limit_time(seconds: float) -> Iterator[None]:
    """Raise KeyboardInterrupt this many seconds after the first signal, or at a further one."""
    if not (signal_count() and hasattr(signal, "setitimer")):
        yield
        return
    before = signal.signal(signal.SIGALRM, _note)
    # A timer of zero seconds is none.
    signal.setitimer(signal.ITIMER_REAL, max(_now.first + seconds - time.monotonic(), 1e-3))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _note(number: int, frame: FrameType | None) -> None:
    _now.count += 1
    if _now.count == 1:
        _now.first = time.monotonic()
    if _now.hold == _OPEN:
        _now.reported = _now.count
        raise KeyboardInterrupt
