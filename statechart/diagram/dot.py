"""A diagram as DOT, laid out to read like a figure of a textbook."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Container, Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from statechart.diagram.model import Diagram, Link, Node, identifiers, printable

if TYPE_CHECKING:
    import graphviz

# DejaVu Sans comes with matplotlib, so it is there for png and pdf on a machine without fonts;
# Verdana has its metrics, so the text of an svg fits where a browser has only that.
_FONT = "DejaVu Sans,Verdana,sans-serif"
_INK, _RUN, _FAINT, _FRAME = "#1f2933", "#0b5fa5", "#7b8794", "#52606d"
_FILL, _FILL_RUN = "#f7f9fb", "#dcecf9"
_WIDTH = 110
# Edges a state, from which on their labels side by side would make a drawing too wide to read.
_CROWDED = 3


def dot(diagram: Diagram) -> str:
    """Render a diagram as DOT source.

    Links between the same two states share one edge, each with its own lines of label. Where
    a run is shown, what it visited is coloured and counted and what it did not is greyed, and so
    is an infeasible state with all that leads to it and away.

    Parameters
    ----------
    diagram : Diagram
        What to draw.

    Returns
    -------
    str
        Source of one directed graph, for the layout engine ``dot``.
    """
    states, groups = identifiers(diagram)
    graph = _sheet(diagram)
    for group, nodes in diagram.groups.items():
        # A frame round a single state would repeat what its label says.
        if group is None or len(nodes) == 1:
            for node in nodes:
                graph.node(states[node.name], **_box(node, diagram))
            continue
        with graph.subgraph(name=f"cluster_{groups[group]}") as frame:
            frame.attr(
                label=_table([_text(group, size=10, colour=_FRAME)]),
                style="rounded,dashed",
                color=_FRAME,
                # Most edges enter a group from above; below, they do not cross its name.
                labelloc="b",
                labeljust="l",
                margin="14",
                tooltip=_plain(group),
            )
            for node in nodes:
                frame.node(states[node.name], **_box(node, diagram))
    if diagram.initial is not None:
        # No identifier of a state begins with an underscore.
        graph.node(
            "_start", label="", shape="circle", width="0.13", style="filled", fillcolor=_INK,
            color=_INK, tooltip="start",
        )  # fmt: skip
        graph.edge("_start", states[diagram.initial.name], color=_INK)
    refused = {node.name for node in diagram.nodes if node.infeasible is not None}
    rank = {node.name: i for i, node in enumerate(diagram.nodes)}
    ordered = sorted(diagram.links, key=lambda link: (rank[link.source], rank[link.target]))
    for (source, target), links in groupby(ordered, key=lambda link: (link.source, link.target)):
        graph.edge(states[source], states[target], **_arrow(tuple(links), refused))
    return str(graph.source)


def _sheet(diagram: Diagram) -> graphviz.Digraph:
    """Return a graph with nothing on it but its title."""
    import graphviz

    pairs = {(link.source, link.target) for link in diagram.links if link.source != link.target}
    return graphviz.Digraph(
        graph_attr={
            "label": _title(diagram),
            "labelloc": "t",
            "fontname": _FONT,
            "fontcolor": _INK,
            "rankdir": "LR" if len(pairs) > _CROWDED * len(diagram.nodes) else "TB",
            "nodesep": "0.2",
            "ranksep": "0.5",
            # Else dot ranks a group by itself, puts its partners beside it, and the labels of the
            # flat edges between them on top of one another.
            "newrank": "true",
            "pad": "0.25",
            "bgcolor": "white",
        },
        node_attr={
            "shape": "box",
            "style": "rounded,filled",
            "fontname": _FONT,
            "fontsize": "12",
            "margin": "0.18,0.09",
        },
        edge_attr={"fontname": _FONT, "fontsize": "9", "arrowsize": "0.7"},
    )


def _title(diagram: Diagram) -> str:
    rows = [_text(diagram.title, size=16, bold=True)]
    rows += [
        _text(line, size=10, colour=_FRAME)
        for note in diagram.notes
        for line in textwrap.wrap(note, _WIDTH) or [""]
    ]
    run = textwrap.wrap(diagram.route, _WIDTH)
    rows += [_text(line, size=10, colour=_RUN) for line in run]
    return _table([*rows, _text(" ", size=6)])


def _box(node: Node, diagram: Diagram) -> dict[str, str]:
    visited = bool(node.visits)
    faint = node.infeasible is not None or node.visits == 0
    ink = _FAINT if faint else _INK
    rows = [_text(node.label, bold=True, colour=ink)]
    if visited:
        rows.append(_text(f"x{node.visits}", size=10, colour=_RUN))
    rows += [_text(line, size=9, colour=ink) for line in node.invariants]
    loops = [link for link in diagram.links if link.source == link.target == node.name]
    if loops:
        rows += [_text(" ", size=3), *_lines(loops, node.infeasible is not None, mark="↻ ")]
    if node.infeasible is not None:
        reason = "infeasible: " + node.infeasible
        rows += [
            _text(line, size=8, italic=True, colour=_FAINT) for line in textwrap.wrap(reason, 32)
        ]
    return {
        "label": _table(rows),
        "tooltip": _plain(node.infeasible or node.name),
        "color": _RUN if visited else _FAINT if faint else _FRAME,
        "fillcolor": _FILL_RUN if visited else _FILL,
        "style": "rounded,dashed,filled" if node.infeasible is not None else "rounded,filled",
        "penwidth": "1.8" if visited else "1",
        "peripheries": "2" if node.final else "1",
    }


def _arrow(links: Sequence[Link], refused: Container[str]) -> dict[str, str]:
    source, target = links[0].source, links[0].target
    faint = source in refused or target in refused
    label = {}
    # Other edges cross a label beside a loop, whatever dot is told: its lines are in the box.
    if source != target:
        label["label"] = _table(_lines(links, faint), padding=5)
    visited = any(link.visits for link in links)
    untaken = faint or all(link.visits == 0 for link in links)
    return label | {
        "tooltip": _plain("\n".join(f"{x.cause} [{x.guard}] / {x.reset}" for x in links)),
        "color": _RUN if visited else _FAINT if untaken else _FRAME,
        "penwidth": "1.8" if visited else "1",
    }


def _lines(links: Sequence[Link], faint: bool, mark: str = "") -> list[str]:
    rows: list[str] = []
    for link in links:
        ink = _RUN if link.visits else _FAINT if faint or link.visits == 0 else _INK
        count = f" x{link.visits}" if link.visits else ""
        rows.append(_text(f"{mark}{link.cause}{count}", size=9, bold=True, colour=ink))
        if link.guard:
            rows.append(_text(f"[{link.guard}]", size=9, colour=ink))
        if link.reset:
            rows.append(_text(f"/ {link.reset}", size=9, colour=ink))
    return rows


def _table(rows: Iterable[str], padding: int = 0) -> str:
    cells = "".join(f"<TR><TD>{row}</TD></TR>" for row in rows)
    table = f'<TABLE BORDER="0" CELLSPACING="0" CELLPADDING="1">{cells}</TABLE>'
    if padding:
        # Clear of its own edge, and legible where dot lets another edge pass behind it.
        table = table.replace("<TABLE", '<TABLE BGCOLOR="white"', 1)
        frame = f'<TABLE BORDER="0" CELLSPACING="0" CELLPADDING="{padding}">'
        table = f"{frame}<TR><TD>{table}</TD></TR></TABLE>"
    return f"<{table}>"


def _text(
    text: str,
    *,
    size: int | None = None,
    bold: bool = False,
    italic: bool = False,
    colour: str = _INK,
) -> str:
    """Text as part of an HTML-like label, every character of it literal."""
    lines = printable(text).split("\n")
    # Graphviz expands \N, \G, ... in HTML-like labels too, and refuses an empty element.
    body = "<BR/>".join(html.escape(line).replace("\\", "&#92;&#8203;") or " " for line in lines)
    body = f"<B>{body}</B>" if bold else body
    body = f"<I>{body}</I>" if italic else body
    points = f' POINT-SIZE="{size}"' if size else ""
    return f'<FONT COLOR="{colour}"{points}>{body}</FONT>'


def _plain(text: str) -> str:
    import graphviz

    # A plain copy would lose its type, by which graphviz knows that <...> is not markup.
    literal: str = graphviz.escape(printable(text))
    return literal
