"""Mermaid text of a diagram (``stateDiagram-v2``)."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from statechart.diagram.legend import TIMES, Guards, Legend, events, fits, legend
from statechart.diagram.model import Chart, Diagram, Link, Node, identifiers, printable
from statechart.palette import CLOSED, FAINT, FRAME, INK

# Characters that Mermaid's lexer acts on in a label (`stateDiagram.jison`): separators, comments,
# entities, quotes, and two phrases it looks for anywhere in a line.
_SPECIAL = re.compile(r"[^\w \n→….,()*/+=^'|!?-]|(?i:(?<=d)irection(?=\s))|(?i:(?<=e)nd note)")

_BLANK = "#160;"  # the grammar has no empty label


def mermaid(diagram: Diagram, guards: Guards = "legend") -> str:
    """Render a diagram as Mermaid text; a product of two regions as two charts."""
    states = identifiers(diagram)
    title = json.dumps(printable(diagram.title).replace("\n", " "), ensure_ascii=False)
    lines = ["---", f"title: {title}", "---", "stateDiagram-v2"]
    pieces = diagram.pieces
    for k, piece in enumerate(pieces, 1):
        if len(pieces) > 1 and not piece.frames:
            name = _unused_name(f"chart{k}", states)
            lines.append(f'    state "{_escape(piece.title)}" as {name} {{')
            lines += [*_indent(_indent(_chart(piece, states, guards))), "    }"]
        else:
            # Mermaid fails at arrows into a composite state without outside links.
            shown = _add_title(piece) if len(pieces) > 1 else piece
            lines += _indent(_chart(shown, states, guards))
    lines = _fork(lines, _unused_name("begin", states))
    notes = [*diagram.notes, *diagram.routes, *_table_rows(legend(diagram, guards))]
    if notes:
        # A note beside a state would push the others apart.
        name = _unused_name("legend", states)
        lines.append(f'    state "{_escape(diagram.title)}" as {name}')
        lines += [f"    {name} : {_escape(note)}" for note in notes]
    coloured = [n for p in pieces for n in (*p.leaves, *p.frames) if n.colours or n.infeasible]
    lines += _classes(coloured, states)
    return "\n".join(lines) + "\n"


def _fork(lines: list[str], name: str) -> list[str]:
    """Return lines in which regions that start together are entered from one bar (UML's fork)."""
    starts = [line for line in lines if line.startswith("    [*] --> ")]
    if len(starts) < 2:
        return lines
    entered = [line.replace("[*]", name) if line in starts else line for line in lines]
    # Mermaid takes the shape of a state from the first line that names it.
    first = lines.index("stateDiagram-v2") + 1
    bar = [f"    state {name} <<fork>>", f"    [*] --> {name}"]
    return [*entered[:first], *bar, *entered[first:]]


def _unused_name(name: str, states: dict[str, str]) -> str:
    taken = {identifier.lower() for identifier in states.values()}
    while name in taken:
        name += "_"
    return name


def _add_title(chart: Chart) -> Chart:
    """Return a chart with its title prefixed to the labels of its outermost states."""
    nodes = list(chart.nodes)
    for k, node in enumerate(nodes):
        if node.inside is None and not node.label.startswith(chart.title):
            nodes[k] = replace(node, label=f"{chart.title} {node.label}")
    return replace(chart, nodes=tuple(nodes))


def _chart(chart: Chart, states: dict[str, str], guards: Guards) -> list[str]:
    lines = _substates(None, chart, states, guards)
    arrows: dict[tuple[str, str], list[Link]] = {}
    for link in chart.links:
        source, target = link.source, chart.entered(link.target)
        if chart.nested(replace(link, target=target)) and source != target:
            # Mermaid refuses arrows between a state and its superstate.
            link = replace(link, cause=f"{link.cause} → {chart.node(target).label}")
            target = source
        arrows.setdefault((source, target), []).append(link)
    lines += [
        f"{states[source]} --> {states[target]}{_label(links, guards)}"
        for (source, target), links in arrows.items()
    ]
    return lines


def _substates(
    outer: str | None, chart: Chart, states: dict[str, str], guards: Guards
) -> list[str]:
    """Return the substates of a state, with the initial arrow."""
    inner = chart.within(outer)
    parts = [_state(node, chart, states, guards) for node in inner]
    if outer is not None and chart.node(outer).parallel:
        # Histories would become separate regions.
        both = list(zip(inner, parts, strict=True))
        lines = [line for node, part in both if node.history for line in part]
        regions = [part for node, part in both if not node.history]
        return lines + [line for part in regions for line in ("--", *part)][1:]
    entered = [node.name for node in chart.nodes if node.initial or node.starting]
    first = {name for start in entered for name in (start, *chart.around(start))}
    starts = [n for n in inner if n.name in first] or [n for n in inner if n.default]
    lines = [line for part in parts for line in part]
    lines += [
        f"[*] --> {states[node.name]}" + (f" : {_escape(node.starting)}" if node.starting else "")
        for node in starts
    ]
    return [*lines, *(f"{states[node.name]} --> [*]" for node in inner if node.final)]


def _state(node: Node, chart: Chart, states: dict[str, str], guards: Guards) -> list[str]:
    identifier = states[node.name]
    label = _escape(node.label) + (f" {TIMES}{node.visits}" if node.visits else "")
    details = list(map(_escape, node.invariants if guards == "inline" else ()))
    details += map(_escape, node.actions if guards == "inline" or fits(node) else ())
    if chart.within(node.name):
        label = "<br/>".join([label, *details])
        block = _indent(_substates(node.name, chart, states, guards))
        return [f'state "{label}" as {identifier} {{', *block, "}"]
    if node.infeasible is not None:
        details.append(f"infeasible#58; {_escape(node.infeasible)}")
    return [f'state "{label}" as {identifier}', *(f"{identifier} : {line}" for line in details)]


def _label(links: list[Link], guards: Guards) -> str:
    parts: list[str] = []
    for group in [links] if guards == "legend" else [[link] for link in links]:
        parts += filter(None, [events(group)])
        if guards == "inline":
            parts += [f"[{link.guard}]" for link in group if link.guard]
            parts += [f"/ {link.reset}" for link in group if link.reset]
    return f" : {'<br/>'.join(map(_escape, parts))}" if parts else ""


def _table_rows(table: Legend) -> list[str]:
    lines = []
    for event in table.events:
        head = f"{event.event}, {event.route}:" if event.route else f"{event.event}:"
        lines.append(" / ".join(filter(None, [f"{head} {event.guard}", event.reset])))
    lines += [f"{state} while {words}" for state, words, _ in table.states if words]
    return [*lines, *(f"{state}: {words}" for state, _, words in table.states if words)]


def _classes(nodes: Sequence[Node], states: dict[str, str]) -> list[str]:
    """Return the class definitions of colours; infeasible states are grey."""
    kinds: dict[str, list[str]] = {}
    for node in nodes:
        style = f"fill:{node.colours[0]},stroke:{FRAME},color:{INK}" if node.colours else ""
        if node.infeasible is not None:
            style = f"fill:{CLOSED},stroke:{FAINT},color:{FAINT},stroke-dasharray:4"
        if style:
            kinds.setdefault(style, []).append(states[node.name])
    lines: list[str] = []
    for k, (style, names) in enumerate(kinds.items(), 1):
        lines += [f"    classDef kind{k} {style}", f"    class {','.join(names)} kind{k}"]
    return lines


def _indent(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def _escape(text: str) -> str:
    text = printable(text).strip()
    encoded = _SPECIAL.sub(lambda match: f"#{ord(match[0][0])};{match[0][1:]}", text)
    return encoded.replace("\n", "<br/>") or _BLANK
