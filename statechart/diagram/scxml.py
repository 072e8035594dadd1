"""A diagram as SCXML (W3C State Chart XML, Recommendation of 1 September 2015)."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

from statechart.diagram.machine import NOTES, SCXML, Written, lost
from statechart.diagram.model import Chart, Diagram, Node, identifiers, printable


def scxml(diagram: Diagram) -> str:
    """Render a diagram as an SCXML document.

    One that was made of a model becomes a machine that runs (`statechart.diagram.machine`), with
    comments on what SCXML cannot say. Of others guards go to ``cond`` as the formulas they are;
    resets, which are no SCXML expressions, and all else go to attributes of the namespace `NOTES`,
    as its schema allows.
    """
    if diagram.machine is not None:
        root = Written(diagram.machine).root
        _annotate(root, title=diagram.title, notes="\n".join(diagram.notes))
        for place, sentence in enumerate(lost(diagram.machine)):
            # Two hyphens would end a comment.
            words = f" not said: {printable(sentence).replace('--', '- -')} "
            root.insert(place, ET.Comment(words))
        return _text(root)
    states = identifiers(diagram)
    root = ET.Element("scxml", {"xmlns": SCXML, "xmlns:diagram": NOTES, "version": "1.0"})
    initial = next((chart.initial for chart in diagram.charts if chart.initial), None)
    if initial is not None:
        root.set("initial", states[initial.name])
    _annotate(root, title=diagram.title, notes="\n".join(diagram.notes))
    for chart in diagram.charts:
        parent = root
        if len(diagram.charts) > 1:
            parent = ET.SubElement(root, "state")
            _annotate(parent, label=chart.title)
        _annotate(parent, path=" ".join(states[name] for name in chart.path))
        for node in chart.within(None):
            _state(parent, node, chart, states)
    return _text(root)


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _state(parent: ET.Element, node: Node, chart: Chart, states: dict[str, str]) -> None:
    leaving = [link for link in chart.links if link.source == node.name]
    inner = chart.within(node.name)
    # A <final> may hold neither transitions nor states.
    tag = "final" if node.final and not leaving and not inner else "state"
    element = ET.SubElement(parent, tag, {"id": states[node.name]})
    _annotate(
        element,
        name=node.name,
        label=node.label,
        invariants="\n".join(node.invariants),
        infeasible=node.infeasible,
        visits=node.visits,
    )
    for link in leaving:
        transition = ET.SubElement(element, "transition")
        if event := re.sub(r"[^\w-]+", ".", printable(link.event)).strip("."):
            transition.set("event", event)
        if link.guard:
            transition.set("cond", printable(link.guard))
        transition.set("target", states[link.target])
        _annotate(transition, reset=link.reset, visits=link.visits)
    for other in inner:
        _state(element, other, chart, states)


def _annotate(element: ET.Element, **values: str | int | None) -> None:
    for key, value in values.items():
        if value not in (None, ""):
            element.set(f"diagram:{key}", printable(str(value)))
