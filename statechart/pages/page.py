"""The page of a run as a file."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from statechart.documents.files import write_atomic
from statechart.errors import DeclarationError, StatechartError

_HERE = Path(__file__).parent
# In this order: the moving scene, then all that moves along.
_SCRIPTS = ("scene.js", "page.js")


def frame(page: str) -> str:
    """Return a page in a frame of a notebook, in which it is as it is on its own."""
    style = "box-sizing: border-box; width: 100%; height: 760px; border: 1px solid #8886"
    return f'<iframe srcdoc="{escape(page)}" sandbox="allow-scripts" style="{style}"></iframe>'


def html(shown: Mapping[str, Any]) -> str:
    """Return the page."""
    # Nothing in it can end the element that it stands in.
    data = json.dumps(shown, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = {
        "TITLE": escape(shown["title"]),
        "STYLE": (_HERE / "page.css").read_text(encoding="utf-8"),
        "SCRIPT": "".join((_HERE / name).read_text(encoding="utf-8") for name in _SCRIPTS),
        "DATA": data,
    }
    text = (_HERE / "page.html").read_text(encoding="utf-8")
    return re.sub(f"@({'|'.join(parts)})@", lambda found: parts[found[1]], text)


def write(shown: Mapping[str, Any], path: Path) -> None:
    """Write the page, whole or not at all."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise DeclarationError(f"a page is .html, not {path.suffix or path.name!r}")
    try:
        write_atomic(path, html(shown).encode())
    except OSError as error:
        raise StatechartError(f"cannot write {path}: {error.strerror or error}") from error
