"""Diagrams of statecharts.

`build` creates the `model` of a diagram from an automaton and optionally a run. `mermaid` and
`scxml` render it as text, `dot` as a page of charts with their `layout` and `legend`; `write`
writes files of all formats.
"""

from statechart.diagram.dot import dot
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Chart, Diagram, Link, Node
from statechart.diagram.scxml import scxml
from statechart.diagram.write import write

__all__ = ["Chart", "Diagram", "Link", "Node", "dot", "mermaid", "scxml", "write"]
