"""Statecharts as pictures and as text.

`build` makes a `model` of a diagram, of an automaton and perhaps a run; a `region` is a chart of
its own. `mermaid` and `scxml` render it as text, `graphml` the graph that it shows, `machine` the
regions as what others' tools run. `dot` puts charts, each with its `layout`, on a page with their
`legend`; `write` makes files.
"""

from statechart.diagram.dot import dot
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Chart, Diagram, Link, Node
from statechart.diagram.scxml import scxml
from statechart.diagram.write import write

__all__ = ["Chart", "Diagram", "Link", "Node", "dot", "mermaid", "scxml", "write"]
