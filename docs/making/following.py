"""Follows a page as its reader does: types its files in, and its commands into a shell.

    python docs/making/following.py PAGE [FOLDER]

A block that a line ending in "into `NAME`:" introduces is written to that file, one after "to the
end of `NAME`:" is added to it. Of a `console` block the lines after `$ ` are commands, the others
what they print; `...` stands for what differs from machine to machine, alone on a line for lines.
Only Python's own library is needed, so that an installation can be tried from anywhere.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

# What a command of a page may take, in seconds; the first one on a machine compiles.
_PATIENCE = 900

_FENCE = re.compile(r"^```(\S*)[^\n]*\n(.*?)^```$", re.M | re.S)
_TYPED = re.compile(r"(into|to the end of) `([\w./-]+)`:$")


@dataclass(frozen=True)
class Block:
    """A block of code on a page.

    Attributes
    ----------
    language : str
        What it is said to be.
    text : str
        What stands in it.
    before : str
        The last line before it that is not empty.
    line : int
        The first line of its text.
    """

    language: str
    text: str
    before: str
    line: int

    @property
    def typed(self) -> tuple[str, bool] | None:
        """The file that it is written to, and whether at its end; None for what is not."""
        found = _TYPED.search(self.before)
        return None if found is None else (found[2], found[1] != "into")


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page in order."""
    text = page.read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        before = text[: found.start()]
        last = before.rstrip().rpartition("\n")[2]
        yield Block(found[1], found[2], last, before.count("\n") + 2)


def followed(page: Path) -> bool:
    """Whether there is something on a page to follow."""
    return any(block.typed or block.language == "console" for block in blocks(page))


def shell(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder as its reader does."""
    return subprocess.run(
        ["bash", "-c", command],
        cwd=folder, capture_output=True, check=False, text=True, timeout=_PATIENCE,
    )  # fmt: skip


def follow(
    page: Path,
    folder: Path,
    change: Callable[[str], str] = str,
    run: Callable[[str, Path], subprocess.CompletedProcess[str]] = shell,
) -> None:
    """Do in a folder what a page says.

    Parameters
    ----------
    page : Path
        What to follow.
    folder : Path
        Where its files go and its commands run.
    change : callable
        Makes of a command the one that is run, such as a shorter one of the same kind.
    run : callable
        Runs a command in a folder.

    Raises
    ------
    AssertionError
        If a command prints something else, or fails where the page does not show how.
    """
    for block in blocks(page):
        if block.typed is not None:
            name, at_end = block.typed
            with (folder / name).open("a" if at_end else "w", encoding="utf-8") as file:
                file.write(block.text)
        elif block.language == "console":
            for command, expected in _commands(block.text):
                command = change(command)
                _check(command, run(command, folder), expected, f"{page.name}:{block.line}")


def _commands(text: str) -> Iterator[tuple[str, str]]:
    for part in re.split(r"^\$ ", text, flags=re.M)[1:]:
        command, _, expected = part.partition("\n")
        yield command, expected


def _check(command: str, done: subprocess.CompletedProcess[str], expected: str, place: str) -> None:
    told = f"{place}: $ {command}\n{done.stdout}{done.stderr}"
    if not expected.strip():
        assert done.returncode == 0, told
    else:
        assert re.fullmatch(_pattern(expected), done.stdout.rstrip() + "\n"), told


def _pattern(expected: str) -> str:
    lines = []
    for line in expected.rstrip().splitlines():
        parts = [re.escape(part) for part in line.split("...")]
        lines.append("(?:.*\n)*?" if line.strip() == "..." else ".*".join(parts) + "\n")
    return "".join(lines)


if __name__ == "__main__":
    given = [Path(argument).resolve() for argument in sys.argv[1:]]
    if len(given) == 1:
        with tempfile.TemporaryDirectory() as fresh:
            follow(given[0], Path(fresh))
    else:
        follow(*given)
