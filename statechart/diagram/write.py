"""Output of a diagram to a file by its suffix, or as SVG text."""

from __future__ import annotations

import io
from pathlib import Path

from statechart.diagram.dot import dot
from statechart.diagram.layout.graphviz_program import render
from statechart.diagram.legend import Guards
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram, printable
from statechart.diagram.scxml import scxml
from statechart.documents.files import explain_os_errors, write_atomic
from statechart.errors import StatechartError

SUFFIXES = (".svg", ".png", ".pdf", ".dot", ".mmd", ".scxml", ".graphml")
"""Formats of `write`."""


def write(diagram: Diagram, path: Path, guards: Guards = "legend") -> None:
    """Write a diagram; svg, png and pdf need no Graphviz program and no installed fonts."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        message = f"cannot draw to {str(path)!r}: its suffix must be one of {', '.join(SUFFIXES)}"
        raise StatechartError(message)
    if not path.parent.is_dir():
        raise StatechartError(f"cannot write {str(path)!r}: there is no folder {path.parent}")
    with explain_os_errors("write", repr(str(path))):
        write_atomic(path, _data(diagram, suffix, guards))


def _data(diagram: Diagram, suffix: str, guards: Guards) -> bytes:
    match suffix:
        case ".dot":
            return dot(diagram, guards).encode()
        case ".mmd":
            return mermaid(diagram, guards).encode()
        case ".scxml":
            return scxml(diagram).encode()
        case ".graphml":
            return graphml(diagram).encode()
    return render(dot(diagram, guards), suffix.removeprefix("."))


def svg(diagram: Diagram) -> str:
    """Return a diagram as SVG."""
    return _data(diagram, ".svg", "legend").decode()


Diagram.svg = svg


def graphml(diagram: Diagram) -> str:
    """Return the graph of a diagram as GraphML (Brandes et al. 2002)."""
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
