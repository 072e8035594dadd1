"""Follows a page as its reader does: writes its files, and runs its commands in a shell.

    python docs/making/following.py PAGE [FOLDER]

A block that a line ending in "into `NAME`:" introduces is written to that file; one after "to the
end of `NAME`:" is added to it. In a `console` block the lines after `$ ` are commands, the others
are what they print. Words must agree; numbers may differ in their last digits, and by 1e-8, since
machines round differently. `...` alone on a line stands for any lines. Parts that differ from run
to run, such as times, stand in a comment on the line before the block, which readers do not see:
``<!-- varies: `1.2 s`, `0.31` -->``. Only Python's own library is needed, so that an installation
can be tried from anywhere.
"""

from __future__ import annotations

import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

# Longest time of a command in seconds; the first one on a machine compiles.
_PATIENCE = 900

# Numbers of two machines agree within these, relative and absolute.
_RELATIVE, _ABSOLUTE = 2e-6, 1e-8
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?!\w|\.\d|\.\.\.)")

_FENCE = re.compile(r"^```(\S*)[^\n]*\n(.*?)^```$", re.M | re.S)
_TYPED = re.compile(r"(into|to the end of) `([\w./-]+)`:$")
_VARIES = re.compile(r"<!-- varies: (.*) -->$")


@dataclass(frozen=True)
class Block:
    """A block of code on a page.

    Attributes
    ----------
    language : str
        The language after the fence.
    text : str
        Its text.
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

    @property
    def varying(self) -> tuple[str, ...]:
        """The parts of its text that differ from run to run."""
        found = _VARIES.search(self.before)
        return () if found is None else tuple(re.findall(r"`([^`]+)`", found[1]))


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page in order."""
    text = page.read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        before = text[: found.start()]
        last = before.rstrip().rpartition("\n")[2]
        yield Block(found[1], found[2], last, before.count("\n") + 2)


def followed(page: Path) -> bool:
    """Return whether a page has files to write or commands to run."""
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
                command, place = change(command), f"{page.name}:{block.line}"
                _check(command, run(command, folder), expected, block.varying, place)


def _commands(text: str) -> Iterator[tuple[str, str]]:
    for part in re.split(r"^\$ ", text, flags=re.M)[1:]:
        command, _, expected = part.partition("\n")
        yield command, expected


def _check(
    command: str,
    done: subprocess.CompletedProcess[str],
    expected: str,
    varying: Sequence[str],
    place: str,
) -> None:
    printed = f"{place}: $ {command}\n{done.stdout}{done.stderr}"
    if not expected.strip():
        assert done.returncode == 0, printed
    else:
        lines = expected.rstrip().splitlines(), done.stdout.rstrip().splitlines()
        assert _agree(*lines, varying), printed


def _agree(expected: list[str], printed: list[str], varying: Sequence[str]) -> bool:
    """Return whether the expected lines are printed in order; `...` stands for any between."""
    reached = {0}  # numbers of printed lines that the expected ones so far may account for
    for line in expected:
        if line.strip() == "...":
            reached = set(range(min(reached), len(printed) + 1)) if reached else reached
        else:
            here = [n for n in reached if n < len(printed)]
            reached = {n + 1 for n in here if _same_line(line, printed[n], varying)}
    return len(printed) in reached


def _same_line(expected: str, printed: str, varying: Sequence[str]) -> bool:
    """Return whether two lines have the same words and nearly the same numbers."""
    parts = re.split("|".join([*map(re.escape, varying), "(?!)"]), expected.strip())
    numbers = [number for part in parts for number in _NUMBER.findall(part)]
    pattern = ".+".join(map(_pattern, parts))
    found = re.fullmatch(pattern, printed.strip())
    return found is not None and all(
        math.isclose(float(one), float(other), rel_tol=_RELATIVE, abs_tol=_ABSOLUTE)
        for one, other in zip(numbers, found.groups(), strict=True)
    )


def _pattern(text: str) -> str:
    """Pattern of a text with a group for each number; columns may be wider or narrower."""
    words = re.split(rf"({_NUMBER.pattern})", text)
    spaced = [r"\s+".join(re.escape(word) for word in re.split(r"\s+", part)) for part in words]
    spaced[1::2] = [f"({_NUMBER.pattern})"] * (len(words) // 2)
    return "".join(spaced)


if __name__ == "__main__":
    given = [Path(argument).resolve() for argument in sys.argv[1:]]
    if len(given) == 1:
        with tempfile.TemporaryDirectory() as fresh:
            follow(given[0], Path(fresh))
    else:
        follow(*given)
