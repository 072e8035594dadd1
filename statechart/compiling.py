"""Progress of compilation, and a clock that leaves compilation out.

numba compiles a kernel and its callees at its first call, heyoka the equations of a mode when a run
first enters it. The next run does not pay for it, so budgets, costs and rates use `working_time`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from statechart.tabular import pluralise

_AFTER = 1.0  # seconds before a compilation is reported, and between two reports
_ONCE = "this happens once"  # numba's kernels and heyoka's modules are cached on disk

KERNELS = "numerical kernels"
"""The name of numba's work in messages."""

Say = Callable[[str, str, bool], None]
"""Takes the subject of a compilation, a line, and True for its last line."""


class _State:
    """State of the current compilation: start, last report, numbers of functions."""

    name, done, total = "", 0, 0
    depth = 0
    began = reported_at = 0.0
    announced = False
    spent = 0.0
    say: Say | None = None


_now = _State()


class StderrLine:
    """Write the progress of compilation to stderr as one line.

    A terminal shows it in place while it lasts; elsewhere the first line about each subject is
    written.
    """

    def __init__(self) -> None:
        self._written: set[str] = set()

    def __call__(self, subject: str, line: str, last: bool) -> None:
        """Write a line."""
        if sys.stderr.isatty():
            sys.stderr.write("\r\x1b[2K" + line * (not last))
        elif subject not in self._written:
            self._written.add(subject)
            sys.stderr.write(f"{line}\n")
        sys.stderr.flush()


def announce(say: Say | None) -> None:
    """Report compilations of more than a second to `say`; None reports none."""
    _now.say = say


def announced() -> bool:
    """Return whether compilations are reported."""
    return _now.say is not None


def working_time() -> float:
    """Return seconds of a clock that stops during compilation."""
    now = time.perf_counter()
    return now - _now.spent - (now - _now.began if _now.depth else 0.0)


def begin(name: str, count: Callable[[], int]) -> None:
    """Start the clock of a compilation, possibly inside another."""
    _now.depth += 1
    if _now.depth > 1:
        return
    _now.began = _now.reported_at = time.perf_counter()
    _now.name, _now.done, _now.announced = name, 0, False
    _now.total = count() if _now.say is not None else 0


@contextmanager
def whole(name: str, count: Callable[[], int] = lambda: 1) -> Iterator[None]:
    """Time a compilation of `count` functions, possibly inside another."""
    begin(name, count)
    try:
        yield
    finally:
        end()


def end(counts: bool = True) -> None:
    """Stop the clock of the latest compilation; add it to the expected ones if it `counts`."""
    _now.depth -= 1
    _now.done += counts
    now = time.perf_counter()
    if _now.depth == 0:
        _now.spent += now - _now.began
        if _now.announced or now - _now.began >= _AFTER:
            _report(f"compiled {_now.name} in {now - _now.began:.0f} s; {_ONCE}", last=True)
    elif now - _now.reported_at >= _AFTER:
        _now.reported_at, _now.announced = now, True
        # Cached code may be useless since another process compiled its callees; the outermost
        # function follows.
        total = max(_now.total, _now.done + 1)
        _report(
            f"compiling {_now.name}: {_now.done} of {pluralise(total, 'function')}, "
            f"{now - _now.began:.0f} s; {_ONCE}",
            last=False,
        )


def _report(line: str, *, last: bool) -> None:
    if _now.say is not None:
        _now.say(_now.name, line, last)
