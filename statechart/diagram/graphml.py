"""The graph that a diagram shows as GraphML, for programs that analyse or lay out graphs."""

from __future__ import annotations

import io

from statechart.diagram.model import Diagram, printable
from statechart.errors import StatechartError


def graphml(diagram: Diagram) -> str:
    """Return a diagram's graph as GraphML (Brandes et al. 2002), by networkx's own writer.

    Raises
    ------
    StatechartError
        If the diagram was not made of an automaton.
    """
    import networkx as nx

    shown = diagram.graph
    if shown is None:
        raise StatechartError(f"diagram {diagram.title!r} shows no graph of an automaton")
    labels = shown.nodes(data="label")
    graph = nx.relabel_nodes(shown, {key: printable(label) for key, label in labels})
    for data in (graph.graph, *graph.nodes.values(), *graph.edges.values()):
        data.update({k: printable(v) for k, v in data.items() if isinstance(v, str)})
    file = io.BytesIO()
    nx.write_graphml_xml(graph, file)
    return file.getvalue().decode()
