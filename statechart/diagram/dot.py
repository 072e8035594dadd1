"""A diagram as DOT: charts laid out one by one, put on a page with their legend."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from statechart.diagram.layout.block import Block, Box, Point
from statechart.diagram.layout.flow import flow
from statechart.diagram.layout.grid import grid
from statechart.diagram.layout.markup import FONT, SMALL, TITLE, Style, plain, table, text
from statechart.diagram.layout.measure import measured
from statechart.diagram.layout.ring import ring
from statechart.diagram.legend import Guards, Legend, legend, number
from statechart.diagram.model import Chart, Diagram, identifiers
from statechart.palette import FRAME, PAPER, RUN

# Width of a page in points, where its charts allow it: a slide of 1000 pixels. Tables, in small
# letters, may take more.
_WIDTH, _WIDE = 740.0, 800.0
# Characters a line of what is below the title, and of a cell of the legend.
_LINE, _CELL = 110, 44
_GAP = 18.0
# 2000 pixels at 144 a inch, which no picture is larger than.
_LARGEST = "13.88,13.88"


def dot(diagram: Diagram, guards: Guards = "legend") -> str:
    """Render a diagram as DOT source.

    Links between the same two states share one arrow. All places are fixed, so that programs of
    Graphviz draw what was laid out (layout ``nop2``).

    Raises
    ------
    StatechartError
        If Graphviz cannot lay it out.
    """
    below = legend(diagram, guards)
    style = Style(identifiers(diagram), guards, below.reasons)
    several = len(diagram.charts) > 1
    charts = [
        _titled(_laid(chart, style, f"_{k}_"), chart.title if several else "", f"_{k}_title")
        for k, chart in enumerate(diagram.charts)
        if chart.nodes
    ]
    heading = [_heading(diagram)] if diagram.title else []
    rows = [*_rows(heading), *_rows(charts), *_rows(_tables(below), _WIDE)]
    return _source(_stacked(rows, _GAP), diagram.title)


def _laid(chart: Chart, style: Style, prefix: str) -> Block:
    if chart.axes is not None:
        return grid(chart, style, prefix)
    return ring(chart, style, prefix) or flow(chart, style, prefix)


def _heading(diagram: Diagram) -> Block:
    rows = [text(diagram.title, size=TITLE, bold=True)]
    rows += [
        text(line, colour=FRAME)
        for note in diagram.notes
        for line in textwrap.wrap(note, _LINE) or [""]
    ]
    rows += [text(route, colour=RUN) for route in diagram.routes]
    return _written("_title", table(rows))


def _titled(block: Block, title: str, name: str) -> Block:
    if not title:
        return block
    above = _written(name, table([text(title, bold=True, colour=FRAME)]))
    return _stacked([above, block], 4.0)


def _tables(said: Legend) -> list[Block]:
    """Return the legend: events, and beside them states and reasons."""
    events = []
    if said.events:
        columns = [
            ("event", [event.event for event in said.events]),
            ("from → to", [event.route for event in said.events]),
            ("when", [event.guard for event in said.events]),
            ("does", [event.reset for event in said.events]),
        ]
        kept = [(head, cells) for head, cells in columns if any(cells)]
        rows = list(zip(*(cells for _, cells in kept), strict=True))
        events.append(_table("_events", [head for head, _ in kept], rows))
    others = []
    if said.states:
        others.append(_table("_states", ["state", "while"], said.states))
    if said.reasons:
        rows = [(f"{number(k)} {reason}",) for k, reason in enumerate(said.reasons, 1)]
        others.append(_table("_reasons", ["not possible where the run starts"], rows))
    return [*events, *([_stacked(others, _GAP, centred=False)] if others else [])]


def _table(name: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Block:
    lines = [[text(word, size=SMALL, italic=True, colour=FRAME) for word in head]]
    lines += [[text(_wrapped(cell), size=SMALL) for cell in row] for row in rows]
    # Graphviz knows no space between columns alone.
    lines = [
        [part for cell in row for part in (cell, text("   ", size=SMALL))][:-1] for row in lines
    ]
    return _written(name, table(lines, padding=2, align="LEFT"))


def _wrapped(words: str) -> str:
    lines = (textwrap.wrap(line, _CELL) or [""] for line in words.split("\n"))
    return "\n".join(line for part in lines for line in part)


def _written(name: str, label: str) -> Block:
    look = {"shape": "plain", "label": label}
    size = measured({name: look})[name]
    return Block(size, (Box(name, (size[0] / 2, size[1] / 2), size, look),))


def _rows(blocks: Iterable[Block], wide: float = _WIDTH) -> list[Block]:
    """Put blocks beside each other, as many as a page is wide; return the rows."""
    rows: list[list[Block]] = []
    for block in blocks:
        width = block.size[0] + sum(b.size[0] + _GAP for b in rows[-1]) if rows else 0.0
        if not rows or width > wide:
            rows.append([])
        rows[-1].append(block)
    return [_beside(row) for row in rows]


def _beside(blocks: Sequence[Block]) -> Block:
    """Put blocks side by side, their tops at one height."""
    height = max(block.size[1] for block in blocks)
    placed, x = [], 0.0
    for block in blocks:
        placed.append(block.moved((x, height - block.size[1])))
        x += block.size[0] + _GAP
    return _joined((x - _GAP, height), placed)


def _stacked(blocks: Sequence[Block], gap: float, *, centred: bool = True) -> Block:
    """Put blocks below each other."""
    width = max(block.size[0] for block in blocks)
    placed, y = [], 0.0
    for block in reversed(blocks):
        placed.append(block.moved(((width - block.size[0]) / 2 if centred else 0.0, y)))
        y += block.size[1] + gap
    return _joined((width, y - gap), placed[::-1])


def _joined(size: Point, blocks: Sequence[Block]) -> Block:
    return Block(
        size,
        tuple(box for block in blocks for box in block.boxes),
        tuple(arrow for block in blocks for arrow in block.arrows),
    )


def _source(page: Block, title: str) -> str:
    import graphviz

    graph = graphviz.Digraph(
        graph_attr={
            "layout": "nop2",
            "bb": f"0,0,{page.size[0]:.2f},{page.size[1]:.2f}",
            "outputorder": "nodesfirst",
            "size": _LARGEST,
            "pad": "0.2",
            "bgcolor": PAPER,
            "tooltip": plain(title),
        },
        node_attr={"fontname": FONT, "fixedsize": "true"},
    )
    for box in page.boxes:
        width, height = (f"{side / 72:.4f}" for side in box.size)
        place = f"{box.centre[0]:.2f},{box.centre[1]:.2f}"
        look = {**box.look, "width": width, "height": height}
        if look["shape"] == "plain":
            # A box as large as its text, which a fixed size would make nothing of.
            look |= {"shape": "none", "margin": "0"}
        graph.node(box.name, pos=place, **look)
    for arrow in page.arrows:
        graph.edge(arrow.source, arrow.target, pos=arrow.course, **arrow.look)
    return str(graph.source)
