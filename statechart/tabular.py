"""Plain-text output: lines, and tables that a terminal may fit to its width."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, TypeVar

T = TypeVar("T")

FEW = 10
"""Items shown from each end of a list that has more than twice as many."""

DIGITS, ALL_DIGITS = 7, 17
"""Significant digits of numbers for people, and those that tell all floats apart."""
MAX_LISTED = 6
"""Values of a list that are written out; a longer one is summarised."""
_NUMERIC_CELL = re.compile(r"(-?\d+)(\.\d+)?(e[+-]?\d+)?")

# Largest number written in full; larger ones are rounded to two digits.
_COUNTED = 10**9


@dataclass(frozen=True)
class Table:
    """Rows of aligned columns in a text."""

    rows: Sequence[Sequence[str]]  # Those of one table are of one length.
    headed: bool = False  # Whether the first row is the head.


TextBlock = str | Table
"""A part of a text: lines, or a table."""


def write_plain(blocks: Iterable[TextBlock]) -> str:
    """Return blocks as plain text for a file."""
    return "".join(block if isinstance(block, str) else table(block.rows) for block in blocks)


def join_blocks(parts: Iterable[Sequence[TextBlock]]) -> list[TextBlock]:
    """Return parts of a text as one, an empty line between them."""
    result: list[TextBlock] = []
    for part in parts:
        if part:
            result += [*(["\n"] if result else []), *part]
    return result


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines with aligned columns; a row of one cell widens none of several."""
    full = [row for row in rows if any(row[1:])] or rows
    widths = [max(map(len, column)) for column in zip(*full, strict=True)]
    return "".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        + "\n"
        for row in rows
    )


def number(value: Any, digits: int = DIGITS) -> str:
    """Return a value as rounded text, a list of more than a few values in summary."""
    if value is None:
        return "none"
    if isinstance(value, float):
        # Adding zero takes the sign of a negative zero.
        return repr(value) if digits >= ALL_DIGITS else f"{value + 0.0:.{digits}g}"
    if not isinstance(value, list):
        return str(value)
    if len(value) <= MAX_LISTED:
        return f"[{', '.join(number(part, digits) for part in value)}]"
    known = [x for x in value if isinstance(x, int | float) and math.isfinite(x)]
    ends = [number(x, digits) for x in (value[0], value[-1])]
    low, high = (number(best(known), digits) for best in (min, max)) if known else ends
    return f"{len(value)} values: {' ... '.join(ends)}, min {low}, max {high}"


def align_numbers(texts: Sequence[str]) -> list[str]:
    """Return the texts of a column with the decimal points of its numbers below each other."""
    found = [_NUMERIC_CELL.fullmatch(text) for text in texts]
    width = max((len(one[1]) for one in found if one), default=0)
    return [
        text if one is None else " " * (width - len(one[1])) + text
        for text, one in zip(texts, found, strict=True)
    ]


def readable_count(number: int) -> str:
    """Return a count as text, a huge one as a power, such as about 1.4e143."""
    # A float ends at 1e308, and Python writes no integer of more than 4300 digits.
    return str(number) if number < _COUNTED else f"about {Decimal(number):.1e}".replace("e+", "e")


def pluralise(count: int, noun: str) -> str:
    """Return a number with its noun: ``1 step``, ``2 steps``."""
    return f"{readable_count(count)} {noun}{'' if count == 1 else 's'}"


def abridge(items: Sequence[T], half: int = FEW) -> list[T | int]:
    """Return the first and last of many items, and between them the number of omitted ones."""
    left_out = len(items) - 2 * half
    if left_out <= 0:
        return list(items)
    return [*items[:half], left_out, *items[-half:]]
