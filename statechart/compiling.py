"""Compilation in this process: said while it lasts, and no part of the time that work takes.

numba compiles a kernel and all below it when it is first called, heyoka the equations of a mode
when it is first entered, both in the middle of a run. What that takes has nothing to do with the
run, and the next one does not take it: budgets, costs and progress are told by `working_time`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from statechart.tabular import several

_AFTER = 1.0  # seconds before it is said that something is compiled, and between one and the next


class _State:
    """What is being compiled; since when, and when that was last said."""

    name, done, total = "", 0, 0
    depth = 0
    began = said = 0.0
    told = False
    spent = 0.0
    say: Callable[[str], None] | None = None


_now = _State()


def announce(say: Callable[[str], None] | None) -> None:
    """Let what is compiled for more than about a second be said by `say`, line by line."""
    _now.say = say


def announced() -> bool:
    """Whether what is compiled is said."""
    return _now.say is not None


def working_time() -> float:
    """Return seconds of a clock that stands still while something is compiled."""
    now = time.perf_counter()
    return now - _now.spent - (now - _now.began if _now.depth else 0.0)


def begin(name: str, count: Callable[[], int]) -> None:
    """Begin to compile a function, for itself or for the one that was begun before."""
    _now.depth += 1
    if _now.depth > 1:
        return
    _now.began = _now.said = time.perf_counter()
    _now.name, _now.done, _now.told = name, 0, False
    _now.total = count() if _now.say is not None else 0


def beside(name: str) -> None:
    """Say that another process compiles a function, while this one goes on."""
    _say(f"another process compiles {name} for the next run; this one goes on without")


@contextmanager
def whole(name: str) -> Iterator[None]:
    """Compile what tells nothing of how far it is."""
    begin(name, lambda: 1)
    try:
        yield
    finally:
        end()


def end(counts: bool = True) -> None:
    """End what was begun last; whether it `counts` as one of those to be compiled."""
    _now.depth -= 1
    _now.done += counts
    now = time.perf_counter()
    if _now.depth == 0:
        _now.spent += now - _now.began
        if _now.told or now - _now.began >= _AFTER:
            _say(f"compiled {_now.name} in {now - _now.began:.0f} s; this happens once")
    elif now - _now.said >= _AFTER:
        _now.said, _now.told = now, True
        # What was counted on as compiled may be of no use, since another process compiled what it
        # calls; the outermost function is still to come.
        total = max(_now.total, _now.done + 1)
        _say(
            f"compiling {_now.name}: {_now.done} of {several(total, 'function')}, "
            f"{now - _now.began:.0f} s"
        )


def _say(line: str) -> None:
    if _now.say is not None:
        _now.say(line)
