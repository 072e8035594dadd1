"""Statecharts as pictures and as text.

`build` makes a `model` of a diagram, of an automaton and perhaps a run; `dot`, `mermaid` and
`scxml` render it as text, `graphml` the graph that it shows, `machine` the regions as what others'
tools run, `write` as files and pictures.
"""

from statechart.diagram.dot import dot
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram, Link, Node
from statechart.diagram.scxml import scxml
from statechart.diagram.write import write

__all__ = ["Diagram", "Link", "Node", "dot", "mermaid", "scxml", "write"]
