"""DOT source of a diagram: a page of charts with their legend."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from statechart.diagram.layout.block import LayoutBlock, side_by_side, stacked, text_block
from statechart.diagram.layout.flow import flow
from statechart.diagram.layout.graphviz_program import FONT, INCH
from statechart.diagram.layout.grid import grid
from statechart.diagram.layout.markup import SMALL, TITLE, Style, plain, table, text
from statechart.diagram.layout.ring import ring
from statechart.diagram.legend import Guards, Legend, legend, superscript
from statechart.diagram.model import Chart, Diagram, identifiers
from statechart.palette import FRAME, PAPER, RUN

# Width in points of a page (a slide of 1000 pixels), and of tables.
_WIDTH, _WIDE = 740.0, 800.0
# Characters per line of notes, and of a cell of the legend.
_LINE, _CELL = 110, 44
_GAP, _TITLE_GAP = 18.0, 4.0
# Largest picture in inches: 2000 pixels at 144 per inch.
_LARGEST = "13.88,13.88"


def dot(diagram: Diagram, guards: Guards = "legend") -> str:
    """Render a diagram as DOT source.

    Links between two states share one arrow. All positions are fixed (layout ``nop2``, as ``neato
    -n2``).
    """
    below = legend(diagram, guards)
    style = Style(identifiers(diagram), guards, below.reasons)
    several = len(diagram.charts) > 1
    charts = []
    for k, chart in ((k, chart) for k, chart in enumerate(diagram.charts) if chart.nodes):
        title = chart.title if several else ""
        charts.append(_add_title(_lay_out(chart, style, f"_{k}_"), title, f"_{k}_title"))
    heading = [_heading(diagram)] if diagram.title else []
    rows = [*heading, *_legend_rows(charts, _WIDTH), *_legend_rows(_tables(below), _WIDE)]
    return _source(stacked(rows, _GAP), diagram.title)


def _lay_out(chart: Chart, style: Style, prefix: str) -> LayoutBlock:
    if chart.axes is not None:
        return grid(chart, style, prefix)
    return ring(chart, style, prefix) or flow(chart, style, prefix)


def _heading(diagram: Diagram) -> LayoutBlock:
    rows = [text(diagram.title, size=TITLE, bold=True)]
    notes = (line for note in diagram.notes for line in textwrap.wrap(note, _LINE) or [""])
    rows += [text(line, colour=FRAME) for line in notes]
    rows += [text(route, colour=RUN) for route in diagram.routes]
    return text_block("_title", table(rows))


def _add_title(block: LayoutBlock, title: str, name: str) -> LayoutBlock:
    if not title:
        return block
    above = text_block(name, table([text(title, bold=True, colour=FRAME)]))
    return stacked([above, block], _TITLE_GAP)


def _tables(below: Legend) -> list[LayoutBlock]:
    """Return the tables of the legend: events, states, reasons."""
    events = _table("_events", ("event", "from → to", "when", "does"), below.events)
    reasons = [(f"{superscript(k)} {reason}",) for k, reason in enumerate(below.reasons, 1)]
    others = [
        *_table("_states", ("state", "while", "does"), below.states),
        *_table("_reasons", ("not possible where the run starts",), reasons),
    ]
    return [*events, *([stacked(others, _GAP, centred=False)] if others else [])]


def _table(name: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[LayoutBlock]:
    """Return a table without empty columns, if it has rows."""
    used_columns = [column for column in range(len(heads)) if any(row[column] for row in rows)]
    if not used_columns:
        return []
    lines = [[text(heads[k], size=SMALL, italic=True, colour=FRAME) for k in used_columns]]
    lines += [[text(_wrap_text(row[k]), size=SMALL) for k in used_columns] for row in rows]
    # Graphviz has no spacing of columns only.
    gap = text("   ", size=SMALL)
    lines = [[part for cell in row for part in (cell, gap)][:-1] for row in lines]
    return [text_block(name, table(lines, padding=2, align="LEFT"))]


def _wrap_text(words: str) -> str:
    return "\n".join(textwrap.fill(line, _CELL) for line in words.split("\n"))


def _legend_rows(blocks: Iterable[LayoutBlock], wide: float) -> list[LayoutBlock]:
    """Return rows of blocks no wider than a page."""
    rows: list[list[LayoutBlock]] = []
    for block in blocks:
        width = block.size[0] + sum(b.size[0] + _GAP for b in rows[-1]) if rows else 0.0
        if not rows or width > wide:
            rows.append([])
        rows[-1].append(block)
    return [side_by_side(row, _GAP) for row in rows]


def _source(page: LayoutBlock, title: str) -> str:
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
        width, height = (f"{side / INCH:.4f}" for side in box.size)
        place = f"{box.centre[0]:.2f},{box.centre[1]:.2f}"
        attributes = {**box.attributes, "width": width, "height": height}
        if attributes["shape"] == "plain":
            # A box as large as its text.
            attributes |= {"shape": "none", "margin": "0"}
        graph.node(box.name, pos=place, **attributes)
    for arrow in page.arrows:
        graph.edge(arrow.source, arrow.target, pos=arrow.curve, **arrow.attributes)
    return str(graph.source)
