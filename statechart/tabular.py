"""Texts for people: lines, and tables that a terminal may set to its width."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Rows of a text that belong under each other.

    Attributes
    ----------
    rows : sequence of sequence of str
        Those of one table are of one length.
    headed : bool
        Whether the first row is the head.
    """

    rows: Sequence[Sequence[str]]
    headed: bool = False


Block = str | Table
"""A part of a text: lines, or a table."""


def plain(blocks: Iterable[Block]) -> str:
    """Return a text as it is written to a file."""
    return "".join(block if isinstance(block, str) else table(block.rows) for block in blocks)


def apart(parts: Iterable[Sequence[Block]]) -> list[Block]:
    """Return parts of a text as one, an empty line between them."""
    result: list[Block] = []
    for part in parts:
        if part:
            result += [*(["\n"] if result else []), *part]
    return result


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        + "\n"
        for row in rows
    )
