"""Markdown of pages that are made."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def in_cell(text: object) -> str:
    """Return a text as it stands in a cell of a table."""
    return str(text).replace("|", "\\|").replace("\n", " ")


def write(path: Path, lines: Iterable[str]) -> None:
    """Write a page, unless it says the same already: then Sphinx need not read it again."""
    text = "\n".join(lines).rstrip() + "\n"
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
