"""How large boxes are, as Graphviz draws them."""

from __future__ import annotations

import json
from collections.abc import Mapping

from statechart.diagram.layout.block import Look, Point
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.layout.markup import FONT


def measured(looks: Mapping[str, Look]) -> dict[str, Point]:
    """Return the width and height in points of boxes, all by one call of Graphviz."""
    import graphviz

    graph = graphviz.Digraph(node_attr={"fontname": FONT})
    for name, look in looks.items():
        graph.node(name, **look)
    laid = json.loads(render(str(graph.source), "json"))
    return {
        item["name"]: (72 * float(item["width"]), 72 * float(item["height"]))
        for item in laid["objects"]
    }
