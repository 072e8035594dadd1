"""Statecharts as pictures and as text.

`build` makes the `model` of a diagram from an automaton and perhaps a run, region by region.
`mermaid` and `scxml` render it as text. `dot` puts charts, each with its `layout`, on a page with
their `legend`; `write` makes files of all formats.
"""

from statechart.diagram.dot import dot
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Chart, Diagram, Link, Node
from statechart.diagram.scxml import scxml
from statechart.diagram.write import write

__all__ = ["Chart", "Diagram", "Link", "Node", "dot", "mermaid", "scxml", "write"]
