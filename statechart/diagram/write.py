"""A diagram into a file, in the format that its suffix names."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from xml.sax.saxutils import escape

from statechart.diagram.dot import dot
from statechart.diagram.graphml import graphml
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram
from statechart.diagram.scxml import scxml
from statechart.documents.files import write_atomic
from statechart.errors import StatechartError

_TEXTS = {".dot": dot, ".mmd": mermaid, ".scxml": scxml, ".graphml": graphml}
_PICTURES = {".svg": "svg", ".png": "png", ".pdf": "pdf"}

SUFFIXES = (*_PICTURES, *_TEXTS)
"""What `write` can write."""


def write(diagram: Diagram, path: Path) -> None:
    """Write a diagram; svg, png and pdf need no Graphviz program and no installed fonts.

    Parameters
    ----------
    diagram : Diagram
        What to write.
    path : Path
        File whose suffix names the format, one of `SUFFIXES`. An existing file is replaced, or
        left as it was if anything fails.

    Raises
    ------
    StatechartError
        If the suffix is not known, the picture cannot be laid out, or the file not written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise StatechartError(
            f"cannot draw to {str(path)!r}: its suffix must be one of {', '.join(SUFFIXES)}"
        )
    if not path.parent.is_dir():
        raise StatechartError(f"cannot write {str(path)!r}: there is no folder {path.parent}")
    if suffix in _TEXTS:
        data = _TEXTS[suffix](diagram).encode()
    else:
        data = _picture(dot(diagram), _PICTURES[suffix])
    try:
        write_atomic(path, data)
    except OSError as error:
        raise StatechartError(f"cannot write {str(path)!r}: {error.strerror or error}") from error


def _picture(source: str, form: str) -> bytes:
    import pygraphviz

    arguments = "-Gdpi=144" if form == "png" else ""
    with tempfile.TemporaryFile() as said, _bundled_fonts():
        try:
            with _stderr_into(said.fileno()):
                graph = pygraphviz.AGraph(string=source)
                data = graph.draw(format=form, prog="dot", args=arguments)
        except (ValueError, OSError, pygraphviz.DotError) as error:
            said.seek(0)
            remarks = said.read().decode(errors="replace").strip()
            raise StatechartError(f"Graphviz made no {form}: {error} {remarks}".strip()) from error
    return bytes(data)


@contextmanager
def _stderr_into(descriptor: int) -> Iterator[None]:
    """Keep what Graphviz and fontconfig say about their own settings out of the user's sight."""
    sys.stderr.flush()
    kept = os.dup(2)
    os.dup2(descriptor, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


@contextmanager
def _bundled_fonts() -> Iterator[None]:
    """Let Graphviz use the fonts that matplotlib carries: a picture is the same on every machine.

    The first drawing of a process fixes its fonts (fontconfig is initialised once), which is why
    the variable need not stay. A setting of the user's own is respected.
    """
    package = find_spec("matplotlib")
    if "FONTCONFIG_FILE" in os.environ or package is None or package.origin is None:
        yield
        return
    fonts = Path(package.origin).parent / "mpl-data" / "fonts" / "ttf"
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "fonts.conf"
        settings.write_text(
            '<?xml version="1.0"?><!DOCTYPE fontconfig SYSTEM "fonts.dtd"><fontconfig>'
            f"<dir>{escape(str(fonts))}</dir><cachedir>{escape(folder)}</cachedir>"
            "<config><rescan><int>0</int></rescan></config></fontconfig>",
            encoding="utf-8",
        )
        os.environ["FONTCONFIG_FILE"] = str(settings)
        try:
            yield
        finally:
            del os.environ["FONTCONFIG_FILE"]
