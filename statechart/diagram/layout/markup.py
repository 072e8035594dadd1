"""Labels and attributes of boxes and arrows in HTML-like markup, with all text escaped."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from statechart.diagram.legend import TIMES, Guards, events, fits, mark
from statechart.diagram.model import Chart, Link, Node, printable
from statechart.palette import CLOSED, FAINT, FRAME, INK, PAPER, RUN

SMALL, LABEL, STATE, TITLE = 9, 10, 12, 16
"""Sizes of type in points; a picture of 750 pt is a slide of 1000 px."""

FRAMES = {
    "shape": "box", "style": "rounded,filled", "label": "", "color": FRAME, "fillcolor": CLOSED,
}  # fmt: skip
"""Attributes of a frame."""

BULLS_EYE = "\N{FISHEYE}"
"""A final state, as in UML."""

START = {
    "shape": "circle", "style": "filled", "label": "", "width": "0.13", "fillcolor": INK,
    "color": INK, "tooltip": "start",
}  # fmt: skip
"""Attributes of the initial dot."""


@dataclass(frozen=True)
class Style:
    """Identifiers by names of nodes, place of guards, numbered reasons."""

    names: Mapping[str, str]
    guards: Guards
    reasons: tuple[str, ...]


def text(
    words: str, *, size: int = LABEL, bold: bool = False, italic: bool = False, colour: str = INK
) -> str:
    """Return text as part of an HTML-like label."""
    lines = printable(words).split("\n")
    # Graphviz expands \N, \G, ... in HTML-like labels, and refuses empty elements.
    body = "<BR/>".join(html.escape(line).replace("\\", "&#92;&#8203;") or " " for line in lines)
    body = f"<B>{body}</B>" if bold else body
    body = f"<I>{body}</I>" if italic else body
    return f'<FONT COLOR="{colour}" POINT-SIZE="{size}">{body}</FONT>'


def table(rows: Iterable[Sequence[str] | str], *, padding: int = 1, align: str = "") -> str:
    """Return rows of cells as a label; a row of text is one cell."""
    side = f' ALIGN="{align}" BALIGN="{align}" VALIGN="TOP"' if align else ""
    lines = []
    for row in rows:
        cells = [row] if isinstance(row, str) else row
        filled = [x if x.startswith("<TD") else f"<TD{side}>{x}</TD>" for x in cells]
        lines.append(f"<TR>{''.join(filled)}</TR>")
    body = "".join(lines)
    return f'<<TABLE BORDER="0" CELLSPACING="0" CELLPADDING="{padding}">{body}</TABLE>>'


def plain(words: str) -> str:
    """Return text as an attribute without markup."""
    import graphviz

    # The type marks <...> as literal text for graphviz.
    literal: str = graphviz.escape(printable(words))
    return literal


def state_attributes(node: Node, chart: Chart, style: Style) -> dict[str, str]:
    """Return the attributes of an atomic state, with its loops as lines."""
    faint = node.infeasible is not None
    ink = FAINT if faint else INK
    lines = (node.label + mark(node, style.reasons)).split("\n")
    rows = [text(line, size=STATE, bold=True, colour=ink) for line in lines]
    if node.final:
        rows = [text(BULLS_EYE, size=TITLE, colour=ink), *rows]
    fill = CLOSED if faint else PAPER
    if not faint and len(node.colours) == 1:
        fill = node.colours[0]
    elif not faint and len(node.colours) == len(rows):
        pairs = zip(rows, node.colours, strict=True)
        rows = [f'<TD BGCOLOR="{colour}" CELLPADDING="3">{row}</TD>' for row, colour in pairs]
    if node.visits:
        rows.append(text(f"{TIMES}{node.visits}", bold=True, colour=RUN))
    rows += _details(node, chart, style, ink)
    return {
        "shape": "circle" if node.history else "box",
        "style": "rounded,dashed,filled" if faint else "rounded,filled",
        "margin": "0.02" if node.history else "0.08,0.02" if node.final else "0.12,0.06",
        "label": table(rows),
        "color": fill if node.final else FAINT if faint else FRAME,
        "fillcolor": fill,
        "tooltip": plain(node.infeasible or node.name),
    }


def title_attributes(node: Node, chart: Chart, style: Style) -> dict[str, str]:
    """Return the attributes of the title of a composite state, with its actions and loops."""
    colour = FRAME if node.infeasible is None else FAINT
    rows = [text(node.label + mark(node, style.reasons), bold=True, colour=colour)]
    rows += _details(node, chart, style, INK)
    return {"shape": "plain", "label": table(rows, align="LEFT")}


def arrow_attributes(
    links: Sequence[Link], style: Style, *, narrow: bool = False, counted: bool = True
) -> dict[str, str] | None:
    """Return the attributes of an arrow's label, narrow ones stacked; None without words."""
    lines = _arrow_text(links if counted else [replace(x, visits=None) for x in links], style)
    if narrow:
        lines = [part for line in lines for part in line.replace(", ", ",\n").split("\n")]
    if not lines:
        return None
    rows = [text(line, colour=arrow(links)["color"]) for line in lines]
    return {"shape": "plain", "label": table(rows, padding=2)}


def arrow(links: Sequence[Link]) -> dict[str, str]:
    """Return the attributes of the line of an arrow."""
    tooltip = plain("\n".join(f"{x.event} [{x.guard}] / {x.reset}" for x in links))
    colour = RUN if any(link.visits for link in links) else INK
    return {"arrowsize": "0.7", "color": colour, "tooltip": tooltip}


def _details(node: Node, chart: Chart, style: Style, ink: str) -> list[str]:
    inline = style.guards == "inline"
    small = [*(node.invariants if inline else ()), *(node.actions if inline or fits(node) else ())]
    self_loops = (text(line, colour=ink) for line in _self_links(node, chart, style))
    return [*(text(line, size=SMALL, colour=ink) for line in small), *self_loops]


def _self_links(node: Node, chart: Chart, style: Style) -> list[str]:
    """Return lines for links from a state to itself, its superstates or substates.

    A sign precedes links that exit the state.
    """
    if chart.axes is not None:
        self_loops = [x for x in chart.links if x.source == x.target == node.name]
        return [f"↻ {line}" for line in [events(replace(x, region="") for x in self_loops)] if line]
    labels = {other.name: other.label for other in chart.nodes}
    lines: list[str] = []
    for (source, target), links in chart.bundles.items():
        if source == node.name and chart.nested(links[0]):
            to = "" if target == source else f" → {labels[target]}"
            for sign, internal in (("↻ ", False), ("", True)):
                shown = _arrow_text([link for link in links if link.internal is internal], style)
                lines += [sign + line + to for line in shown]
    return lines


def _arrow_text(links: Sequence[Link], style: Style) -> list[str]:
    if style.guards == "legend":
        return list(filter(None, [events(links)]))
    lines: list[str] = []
    for link in links:
        lines += filter(None, [events([link])])
        lines += [f"[{link.guard}]"] if link.guard else []
        lines += [f"/ {line}" for line in link.reset.split("\n")] if link.reset else []
    return lines
