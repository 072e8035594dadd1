"""A chart as boxes in boxes, laid out by Graphviz' ``dot`` (Gansner et al. 1993).

The words on an arrow are a node of their own between its ends, so that dot makes room for them and
leads no other line through them.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from statechart.diagram.layout.block import (
    Arrow,
    Block,
    Box,
    Look,
    Point,
    bounded,
    covered,
    crossings,
)
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.layout.markup import (
    FONT,
    FRAMES,
    Style,
    arrow,
    arrow_look,
    frame_look,
    nested,
    state_look,
)
from statechart.diagram.layout.start import begun
from statechart.diagram.legend import drawn_once
from statechart.diagram.model import Chart, Link
from statechart.palette import FAINT

if TYPE_CHECKING:
    import graphviz

# Width and height that a chart may take of a slide.
_ROOM = (740.0, 430.0)
# Ways to go from rank to rank, and space between neighbours in inches.
_WAYS = [(way, gap) for way in ("TB", "LR") for gap in (0.25, 0.5)]
_INCH = 72.0


def flow(chart: Chart, style: Style, prefix: str) -> Block:
    """Lay a chart out, the way that fits a slide best of those that lead no line through text."""
    looks = _looks(chart, style, prefix)
    laid = (_read(chart, style, prefix, looks, *way) for way in _WAYS)
    return min(laid, key=_badness)


def _badness(block: Block) -> tuple[float, ...]:
    """Return lines through text, by how much a block must shrink to fit, and crossings."""
    width, height = block.size
    shrink = max(width / _ROOM[0], height / _ROOM[1], 1.0)
    return covered(block), round(4 * shrink), crossings(block), height


def _looks(chart: Chart, style: Style, prefix: str) -> dict[str, Look]:
    """Return how boxes look, by identifier: states, the names of frames, words on arrows."""
    leaves = {node.name for node in chart.leaves}
    found: dict[str, Look] = {}
    for node in chart.nodes:
        if node.name in leaves:
            found[style.names[node.name]] = state_look(node, chart, style)
        else:
            found[f"{prefix}in_{style.names[node.name]}"] = frame_look(node, chart, style)
    for k, links in enumerate(_arrows(chart).values()):
        look = arrow_look(links, style)
        if look is not None:
            found[f"{prefix}{k}"] = look
    return found


def _arrows(chart: Chart) -> dict[tuple[str, str], list[Link]]:
    return {e: links for e, links in drawn_once(chart).items() if not nested(chart, links[0])}


def _source(
    chart: Chart, style: Style, prefix: str, looks: dict[str, Look], way: str, gap: float
) -> str:
    import graphviz

    graph = graphviz.Digraph(
        graph_attr={
            "rankdir": way,
            "nodesep": str(gap),
            "ranksep": "0.22",
            "compound": "true",
            "fontname": FONT,
        },
        node_attr={"fontname": FONT},
    )
    held: dict[str | None, list[str]] = {}
    for k, (source, target) in enumerate(_arrows(chart)):
        if f"{prefix}{k}" in looks:
            held.setdefault(_common(chart, source, target), []).append(f"{prefix}{k}")

    def fill(part: graphviz.Digraph, inside: str | None) -> None:
        for node in chart.within(inside):
            name = style.names[node.name]
            if name in looks:
                part.node(name, **looks[name])
                continue
            with part.subgraph(name=f"cluster_{name}") as frame:
                label = looks[f"{prefix}in_{name}"]["label"]
                frame.attr(label=label, labeljust="l", labelloc="t", margin="14")
                fill(frame, node.name)
        for name in held.get(inside, []):
            part.node(name, **looks[name])

    fill(graph, None)
    for k, (source, target) in enumerate(_arrows(chart)):
        tail, head = _end(chart, style, source, "tail"), _end(chart, style, target, "head")
        if (label := f"{prefix}{k}") in looks:
            graph.edge(head_name=label, arrowhead="none", id=f"{k} to", **tail)
            graph.edge(tail_name=label, arrowsize="0.7", id=f"{k} on", **head)
        else:
            graph.edge(**tail, **head, arrowsize="0.7", id=f"{k} to")
    return str(graph.source)


def _end(chart: Chart, style: Style, name: str, end: str) -> dict[str, str]:
    """Return what an edge says of an end; a frame is cut off at by an edge to a state in it."""
    leaf, found = name, {}
    while inner := chart.within(leaf):
        leaf = inner[0].name
    found[f"{end}_name"] = style.names[leaf]
    if leaf != name:
        found[f"l{end}"] = f"cluster_{style.names[name]}"
    return found


def _common(chart: Chart, one: str, other: str) -> str | None:
    """Return the innermost state that encloses both."""
    around = chart.around(other)
    return next((name for name in chart.around(one) if name in around), None)


def _read(
    chart: Chart, style: Style, prefix: str, looks: dict[str, Look], way: str, gap: float
) -> Block:
    """Return what dot made of a chart."""
    laid = json.loads(render(_source(chart, style, prefix, looks, way, gap), "json"))
    left, low, right, high = map(float, laid["bb"].split(","))
    refused = {style.names[node.name] for node in chart.frames if node.infeasible is not None}
    frames, boxes = [], []
    for item in laid["objects"]:
        name = item["name"]
        if "bb" in item:
            name = name.removeprefix("cluster_")
            x0, y0, x1, y1 = map(float, item["bb"].split(","))
            look = {**FRAMES, "color": FAINT} if name in refused else FRAMES
            frames.append(Box(name, ((x0 + x1) / 2, (y0 + y1) / 2), (x1 - x0, y1 - y0), look))
            title, size = f"{prefix}in_{name}", (item["lwidth"], item["lheight"])
            boxes.append(Box(title, _point(item["lp"]), _inches(*size), looks[title]))
        else:
            size = _inches(item["width"], item["height"])
            boxes.append(Box(name, _point(item["pos"]), size, looks[name]))
    frames.sort(key=lambda box: -box.size[0] * box.size[1])
    courses = {edge["id"]: edge["pos"] for edge in laid.get("edges", [])}
    arrows = []
    for k, ((source, target), links) in enumerate(_arrows(chart).items()):
        course = ";".join(courses[half] for half in (f"{k} to", f"{k} on") if half in courses)
        ends = style.names[source], style.names[target]
        arrows.append(Arrow(*ends, course, arrow(links)))
    block = Block((right - left, high - low), (*frames, *boxes), tuple(arrows))
    if chart.initial is None:
        return bounded(block.boxes, block.arrows)
    return begun(block, style.names[chart.initial.name], f"{prefix}start")


def _inches(width: str, height: str) -> Point:
    return _INCH * float(width), _INCH * float(height)


def _point(place: str) -> Point:
    x, y = map(float, place.split(","))
    return x, y
