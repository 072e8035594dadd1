"""A diagram as Mermaid text (``stateDiagram-v2``), for Markdown pages."""

from __future__ import annotations

import json
import re

from statechart.diagram.model import Diagram, Link, Node, identifiers, printable

# What Mermaid's lexer acts on inside a label (`stateDiagram.jison`): separators, comments,
# entities, quotes, and two phrases it looks for anywhere in a line.
_SPECIAL = re.compile(r"[^\w \n→….,()*/+=^'|!?-]|(?i:(?<=d)irection(?=\s))|(?i:(?<=e)nd note)")


_BLANK = "#160;"  # the grammar has no empty label


def mermaid(diagram: Diagram) -> str:
    """Render a diagram as Mermaid text.

    Parameters
    ----------
    diagram : Diagram
        What to draw.

    Returns
    -------
    str
        A ``stateDiagram-v2``, ending with a newline.
    """
    states, groups = identifiers(diagram)
    lines = [
        "---",
        f"title: {json.dumps(printable(diagram.title).replace(chr(10), ' '), ensure_ascii=False)}",
        "---",
        "stateDiagram-v2",
    ]
    for group, nodes in diagram.groups.items():
        block = [line for node in nodes for line in _state(node, states[node.name])]
        if group is not None:
            block = [f'state "{_escape(group)}" as {groups[group]} {{', *_indent(block), "}"]
        lines += _indent(block)
    if diagram.initial is not None:
        lines.append(f"    [*] --> {states[diagram.initial.name]}")
    lines += [
        f"    {states[link.source]} --> {states[link.target]}{_label(link)}"
        for link in diagram.links
    ]
    lines += [f"    {states[node.name]} --> [*]" for node in diagram.nodes if node.final]
    notes = [*diagram.notes, *filter(None, [diagram.route])]
    if notes and diagram.nodes:
        anchor = diagram.initial or diagram.nodes[0]
        lines.append(f"    note right of {states[anchor.name]}")
        lines += [f"        {_escape(note)}" for note in notes]
        lines.append("    end note")
    lines += _classes(diagram, states)
    return "\n".join(lines) + "\n"


def _state(node: Node, identifier: str) -> list[str]:
    label = _escape(node.label) + _count(node.visits)
    details = [_escape(line) for line in node.invariants]
    if node.infeasible is not None:
        details.append(f"infeasible#58; {_escape(node.infeasible)}")
    return [
        f'state "{label}" as {identifier}',
        *(f"{identifier} : {line}" for line in details),
    ]


def _label(link: Link) -> str:
    parts = [_escape(link.cause) + _count(link.visits)] if link.cause or link.visits else []
    if link.guard:
        parts.append(f"[{_escape(link.guard)}]")
    if link.reset:
        parts.append(f"/ {_escape(link.reset)}")
    return f" : {'<br/>'.join(parts)}" if parts else ""


def _classes(diagram: Diagram, states: dict[str, str]) -> list[str]:
    kinds = {
        "visited": [n for n in diagram.nodes if n.visits],
        "infeasible": [n for n in diagram.nodes if n.infeasible is not None],
    }
    styles = {
        "visited": "fill:#dcecf9,stroke:#0b5fa5,stroke-width:2px",
        "infeasible": "color:#8d99a6,stroke:#8d99a6,stroke-dasharray:4",
    }
    lines: list[str] = []
    for kind, nodes in kinds.items():
        if nodes:
            lines.append(f"    classDef {kind} {styles[kind]}")
            lines.append(f"    class {','.join(states[node.name] for node in nodes)} {kind}")
    return lines


def _count(visits: int | None) -> str:
    return f" x{visits}" if visits else ""


def _indent(lines: list[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def _escape(text: str) -> str:
    """Text on one line, every character of it literal."""
    encoded = _SPECIAL.sub(
        lambda match: f"#{ord(match[0][0])};{match[0][1:]}", printable(text).strip()
    )
    return encoded.replace("\n", "<br/>") or _BLANK
