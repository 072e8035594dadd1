"""Layered layout of a chart by Graphviz' ``dot`` (Gansner et al. 1993).

Labels of arrows and initial dots are nodes, so that dot leads no line through them. Orthogonal
regions are separated by a dashed line (UML 2.5, 14.2.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from statechart.diagram.layout import markup
from statechart.diagram.layout.block import (
    Arrow,
    Attributes,
    Box,
    LayoutBlock,
    bounding_block,
    count_overlaps,
    polyline,
    samples,
)
from statechart.diagram.layout.graphviz_program import FONT, lay_out, size_of
from statechart.diagram.model import Chart, Node
from statechart.palette import FAINT, FRAME

if TYPE_CHECKING:
    import graphviz

# Width and height of a chart on a slide, in points.
_SLIDE = (740.0, 430.0)
# Rank directions, and spacing in inches.
_WAYS = [(way, gap) for way in ("TB", "LR") for gap in ("0.25", "0.5")]
# Side of the titles of frames, which lines may cross, and ranks to an arrow's end at a frame: with
# two, its label is above the frame, and the arrow leads around no corner.
_TRIES = (("l", "1"), ("r", "1"), ("l", "2"), ("r", "2"))
# Depth in points from which an arrow is over a frame, whose corners are rounded.
_INSIDE = 5.0
# Regions in a state have no frame.
_REGION = {"shape": "box", "style": "invis", "label": ""}
_DIVIDER = {"style": "dashed", "arrowhead": "none", "color": FRAME, "tooltip": " "}


def flow(chart: Chart, style: markup.Style, prefix: str) -> LayoutBlock:
    """Return the layout with the fewest lines through text and frames, and the best fit."""
    drawn = _Flow(chart, style, prefix)
    best: LayoutBlock | None = None
    for side, ranks in _TRIES:
        found = [drawn.block(way, gap, side, ranks) for way, gap in _WAYS]
        best = min([best, *found] if best else found, key=drawn.badness)
        if drawn.badness(best)[:2] == (0, 0):
            break
    assert best is not None
    return best


class _Flow:
    """A chart in DOT; `looks` are attributes of boxes by identifier (text with an underscore)."""

    def __init__(self, chart: Chart, style: markup.Style, prefix: str) -> None:
        self.chart, self.names, self.prefix = chart, style.names, prefix
        leaves = {node.name for node in chart.leaves}
        self.looks: dict[str, Attributes] = {}
        self.starts: dict[str, Node] = {}
        for k, node in enumerate(chart.nodes):
            if node.name in leaves:
                self.looks[self.names[node.name]] = markup.state_attributes(node, chart, style)
            else:
                self.looks[self.title(node)] = markup.title_attributes(node, chart, style)
            if node.initial or node.default or node.starting:
                self.starts[f"{prefix}start{k}"] = node
            if node.starting:
                words = markup.table([markup.text(node.starting, size=markup.SMALL, colour=FRAME)])
                self.looks[f"{prefix}start{k}_of"] = {"shape": "plain", "label": words}
        self.words: dict[str | None, list[str]] = {}
        self.edges: dict[str, tuple[str, str, Attributes]] = {}
        for k, ((source, target), links) in enumerate(chart.arrows.items()):
            self.edges[str(k)] = source, target, markup.arrow(links)
            attributes = markup.arrow_attributes(links, style)
            if attributes is not None:
                self.looks[f"{prefix}{k}"] = attributes
                around = chart.around(target)
                common = next((name for name in chart.around(source) if name in around), None)
                self.words.setdefault(common, []).append(f"{prefix}{k}")

    def title(self, node: Node) -> str:
        """Return the identifier of the title of a frame."""
        return f"{self.prefix}in_{self.names[node.name]}"

    def source(self, way: str, gap: str, side: str, ranks: str) -> str:
        """Return the chart as DOT; labels and initial dots are nodes."""
        import graphviz

        graph = graphviz.Digraph(
            graph_attr={
                "rankdir": way, "nodesep": gap, "ranksep": "0.22", "compound": "true",
                "fontname": FONT,
            },
            node_attr={"fontname": FONT},
            edge_attr={"arrowsize": "0.7"},
        )  # fmt: skip
        self._fill(graph, None, side)
        for k, (source, target, _) in self.edges.items():
            tail, head = self._end(source, "tail"), self._end(target, "head", ranks)
            if (words := f"{self.prefix}{k}") in self.looks:
                graph.edge(head_name=words, arrowhead="none", id=f"{k} to", **tail)
                graph.edge(tail_name=words, id=f"{k} on", **head)
            else:
                graph.edge(id=f"{k} to", **(tail | head))
        for name, node in self.starts.items():
            first = {"tail_name": name, "weight": "4", "id": f"{name} to"}
            if (words := f"{name}_of") in self.looks:
                graph.edge(head_name=words, arrowhead="none", **first)
                first = {"tail_name": words, "weight": "4", "id": f"{name} on"}
            graph.edge(**first, **self._end(node.name, "head"))
        return str(graph.source)

    def _fill(self, part: graphviz.Digraph, inside: str | None, side: str) -> None:
        for name, node in self.starts.items():
            begins = any(n.default for n in self.chart.within(node.inside))
            if inside == (None if node.initial and begins else node.inside):
                part.node(name, **markup.START)
                if (words := f"{name}_of") in self.looks:
                    part.node(words, **self.looks[words])
        for node in self.chart.within(inside):
            name = self.names[node.name]
            if name in self.looks:
                part.node(name, **self.looks[name])
                continue
            with part.subgraph(name=f"cluster_{name}") as frame:
                label = self.looks[self.title(node)]["label"]
                frame.attr(label=label, labeljust=side, labelloc="t", margin="14")
                self._fill(frame, node.name, side)
        for name in self.words.get(inside, []):
            part.node(name, **self.looks[name])

    def _end(self, name: str, end: str, ranks: str = "1") -> dict[str, str]:
        """Return an end of an edge, clipped at a frame that is some ranks away."""
        leaf = name
        while inner := self.chart.within(leaf):
            leaf = inner[0].name
        found = {f"{end}_name": self.names[leaf]}
        if leaf != name:
            found |= {f"l{end}": f"cluster_{self.names[name]}", "minlen": ranks}
        return found

    def block(self, way: str, gap: str, side: str, ranks: str) -> LayoutBlock:
        """Return the chart laid out by dot; see `_WAYS` and `_TRIES`."""
        laid = lay_out(self.source(way, gap, side, ranks))
        items = {item["name"].removeprefix("cluster_"): item for item in laid["objects"]}
        frames = sorted(
            (self._frame(node, items) for node in self.chart.frames),
            key=lambda box: -box.size[0] * box.size[1],
        )
        boxes = []
        for name, item in ((name, item) for name, item in items.items() if "bb" not in item):
            look = self.looks.get(name, markup.START)
            boxes.append(Box(name, _point(item["pos"]), size_of(item), look))
        for node in self.chart.frames:
            item, name = items[self.names[node.name]], self.title(node)
            boxes.append(Box(name, _point(item["lp"]), size_of(item, "l"), self.looks[name]))
        courses = {edge["id"]: edge["pos"] for edge in laid.get("edges", [])}
        names = self.names
        ends = {k: (names[s], names[t], look) for k, (s, t, look) in self.edges.items()}
        ends |= {k: (k, names[node.name], markup.arrow(())) for k, node in self.starts.items()}
        arrows = []
        for k, (source, target, look) in ends.items():
            halves = (courses[half] for half in (f"{k} to", f"{k} on") if half in courses)
            arrows.append(Arrow(source, target, ";".join(halves), look))
        places = {box.name: box for box in (*frames, *boxes)}
        for node in self.chart.frames:
            if node.parallel:
                arrows += self._dividers(node, places)
        return bounding_block((*frames, *boxes), arrows)

    def badness(self, block: LayoutBlock) -> tuple[float, ...]:
        """Return the cost of a block: lines through text, over frames, scale to fit, height."""
        width, height = block.size
        shrink = max(width / _SLIDE[0], height / _SLIDE[1], 1.0)
        return count_overlaps(block), self.crossings(block), round(4 * shrink), height

    def crossings(self, block: LayoutBlock) -> int:
        """Return the number of arrows over frames that hold neither of their ends."""
        frames = {box.name: box for box in block.boxes if not box.attributes["label"]}
        found = 0
        for (source, target, _), one in zip(self.edges.values(), block.arrows, strict=False):
            places = samples(one.curve)
            for node in self.chart.frames:
                if node.name in self.chart.around(source) + self.chart.around(target):
                    continue
                frame = frames[self.names[node.name]]
                off = np.abs(places - frame.centre) - np.array(frame.size) / 2
                found += bool((off < -_INSIDE).all(axis=1).any())
        return found

    def _frame(self, node: Node, items: dict[str, Any]) -> Box:
        name = self.names[node.name]
        x0, y0, x1, y1 = map(float, items[name]["bb"].split(","))
        attributes: Attributes = (
            markup.FRAMES if node.infeasible is None else {**markup.FRAMES, "color": FAINT}
        )
        if node.inside is not None and self.chart.node(node.inside).parallel:
            attributes = _REGION
        return Box(name, ((x0 + x1) / 2, (y0 + y1) / 2), (x1 - x0, y1 - y0), attributes)

    def _dividers(self, node: Node, places: dict[str, Box]) -> list[Arrow]:
        """Return the dashed lines between the regions of a state, below its title."""
        frame = places[self.names[node.name]]
        names = (self.names[inner.name] for inner in self.chart.within(node.name))
        regions = [places[name] for name in names if name in places]
        # Regions may differ more in height than in place: the axis with space between them.
        axis = max((0, 1), key=lambda k: min(_gaps(regions, k), default=0.0))
        regions.sort(key=lambda box: box.centre[axis])
        low, high = (frame.centre[1 - axis] + k * frame.size[1 - axis] / 2 for k in (-1, 1))
        if axis == 0:
            title = places[self.title(node)]
            high = title.centre[1] - title.size[1] / 2
        found = []
        for one, other in pairwise(regions):
            end = one.centre[axis] + one.size[axis] / 2
            at = (end + other.centre[axis] - other.size[axis] / 2) / 2
            line = [(at, side) if axis == 0 else (side, at) for side in (low, high)]
            first, second = (f"{self.prefix}in_{box.name}" for box in (one, other))
            found.append(Arrow(first, second, polyline(line, head=False), _DIVIDER))
        return found


def _gaps(boxes: Sequence[Box], axis: int) -> list[float]:
    """Return the space between neighbours along an axis, negative where they overlap."""
    ends = sorted(
        (b.centre[axis] - b.size[axis] / 2, b.centre[axis] + b.size[axis] / 2) for b in boxes
    )
    return [other[0] - one[1] for one, other in pairwise(ends)]


def _point(place: str) -> tuple[float, float]:
    x, y = map(float, place.split(","))
    return x, y
