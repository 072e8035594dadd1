"""Charts as a value, and its renderers: DOT, Mermaid, SCXML, and pictures by suffix."""

from statechart.diagram.dot import dot
from statechart.diagram.mermaid import mermaid
from statechart.diagram.model import Diagram, Link, Node
from statechart.diagram.scxml import scxml
from statechart.diagram.write import write

__all__ = ["Diagram", "Link", "Node", "dot", "mermaid", "scxml", "write"]
