"""Graphviz in this process: source in; a picture, a layout or the sizes of boxes out."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

from statechart.errors import StatechartError

# DejaVu Sans comes with matplotlib, so it is there for png and pdf on a machine without fonts;
# Verdana has its metrics, so the text of an svg fits where a browser has only that.
FONT = "DejaVu Sans,Verdana,sans-serif"

INCH = 72.0
"""Points, in which places are given; widths and heights are in inches."""


def render(source: str, form: str) -> bytes:
    """Run Graphviz on DOT source."""
    import pygraphviz

    with tempfile.TemporaryFile() as output, _bundled_fonts():
        try:
            with _stderr_into(output.fileno()):
                graph = pygraphviz.AGraph(string=source)
                sharp = "-Gdpi=144" if form == "png" else ""
                data = graph.draw(format=form, prog="dot", args=sharp)
        except (ValueError, OSError, pygraphviz.DotError) as error:
            output.seek(0)
            remarks = output.read().decode(errors="replace").strip()
            raise StatechartError(f"Graphviz made no {form}: {error} {remarks}".strip()) from error
    return bytes(data)


def lay_out(source: str) -> dict[str, Any]:
    """Return the layout of a graph by Graphviz, as its JSON object."""
    found: dict[str, Any] = json.loads(render(source, "json"))
    return found


def measure_boxes(looks: Mapping[str, Mapping[str, str]]) -> dict[str, tuple[float, float]]:
    """Return the width and height in points of boxes, all by one call of Graphviz."""
    import graphviz

    graph = graphviz.Digraph(node_attr={"fontname": FONT})
    for name, attributes in looks.items():
        graph.node(name, **attributes)
    return {item["name"]: size_of(item) for item in lay_out(str(graph.source))["objects"]}


def size_of(item: Mapping[str, str], prefix: str = "") -> tuple[float, float]:
    """Return width and height of an object in points, with `prefix` "l" those of its label."""
    return INCH * float(item[f"{prefix}width"]), INCH * float(item[f"{prefix}height"])


@contextmanager
def _stderr_into(descriptor: int) -> Iterator[None]:
    """Hide messages of Graphviz and fontconfig about their own settings."""
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
