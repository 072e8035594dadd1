"""Output: texts on stdout, with tables that fit the width of a terminal, and warnings."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable

from statechart.tabular import Block, Table, plain


def show(blocks: Iterable[Block]) -> None:
    """Print a text."""
    if not sys.stdout.isatty():
        print(plain(blocks), end="")
        return
    from rich.console import Console

    console = Console(markup=False, emoji=False, highlight=False)
    for block in blocks:
        if isinstance(block, Table):
            console.print(_ruled(block))
        else:
            console.print(block, end="", soft_wrap=True)


def _ruled(table: Table) -> object:
    from rich.table import Table as Ruled
    from rich.text import Text

    rows = [[Text(cell) for cell in row] for row in table.rows]
    head = rows.pop(0) if table.headed else [Text()] * len(rows[0])
    ruled = Ruled(box=None, show_header=table.headed, pad_edge=False, header_style="bold")
    for cell in head:
        ruled.add_column(cell, overflow="fold")
    for row in rows:
        ruled.add_row(*row)
    return ruled


def warn(warnings: Iterable[str]) -> None:
    """Print warnings to stderr."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


def print_json(value: object) -> None:
    """Print plain data as JSON."""
    # Floats are printed with the fewest digits that read back as the same float.
    print(json.dumps(value, indent=2, allow_nan=False))
