"""How far a sweep is, on stderr: a bar with rate and time left, or lines where there is none."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from statechart.compiling import working_time
from statechart.tabular import several

# Seconds between lines, where stderr is no terminal.
_EVERY = 10.0


@contextmanager
def told(total: int, done: int, *, shown: bool) -> Iterator[Callable[[int], None]]:
    """Make what takes how many more cells are done."""
    if not shown:
        yield lambda count: None
    elif sys.stderr.isatty():
        with _bar(total, done) as tell:
            yield tell
    else:
        yield _Lines(total, done)


@contextmanager
def _bar(total: int, done: int) -> Iterator[Callable[[int], None]]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        """Cells a second."""

        def render(self, task: Task) -> Text:
            return Text("" if task.speed is None else f"{task.speed:.3g} cells/s")

    columns = (
        BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn(), TextColumn("left"),
    )  # fmt: skip
    with Progress(*columns, console=Console(file=sys.stderr), transient=True) as progress:
        task = progress.add_task("cells", total=total, completed=done)
        yield lambda count: progress.advance(task, count)


class _Lines:
    """Writes a line every few seconds; the rate is that since the last one, but for compilation."""

    def __init__(self, total: int, done: int) -> None:
        self._total, self._done, self._told = total, done, done
        self._shown, self._worked = time.monotonic(), working_time()

    def __call__(self, count: int) -> None:
        self._done += count
        now = time.monotonic()
        if now - self._shown < _EVERY:
            return
        worked = working_time()
        rate = (self._done - self._told) / (worked - self._worked)
        left = timedelta(seconds=round((self._total - self._done) / rate))
        self._shown, self._worked, self._told = now, worked, self._done
        cells = f"{self._done} of {several(self._total, 'cell')}"
        line = f"{cells}, {rate:.3g} a second, {left} left\n"
        sys.stderr.write(line)
        sys.stderr.flush()
