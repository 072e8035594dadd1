"""Progress on stderr: bars on a terminal, elsewhere lines."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

T = TypeVar("T")


class Display:
    """Progress on stderr: a bar on a terminal, which `close` removes, elsewhere lines."""

    def __init__(self, total: float) -> None:
        self.drawn = possible()
        if not self.drawn:
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

        self._shown = Progress(
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.description}", markup=False),
            console=Console(file=sys.stderr),
            transient=True,
        )
        self._shown.start()
        self._task = self._shown.add_task("", total=total)

    def show(self, done: float, words: str) -> None:
        """Show the progress, with a remark, or the remark as a line."""
        if not self.drawn:
            sys.stderr.write(f"{words}\n")
            sys.stderr.flush()
            return
        self._shown.update(self._task, completed=done, description=words)

    def close(self) -> None:
        """Remove the bar from the terminal."""
        if self.drawn:
            self._shown.stop()


def possible() -> bool:
    """Return whether stderr is a terminal on which a progress bar can be drawn."""
    return sys.stderr.isatty()


def count_items(items: Iterable[T], total: int, words: str) -> Iterator[T]:
    """Yield items, with a bar where one is possible."""
    if not possible():
        yield from items
        return
    bar = Display(total)
    try:
        for done, item in enumerate(items):
            bar.show(done, words)
            yield item
    finally:
        bar.close()
