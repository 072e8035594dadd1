"""Legend of a diagram: events, conditions and actions of states, reasons."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, NamedTuple

from statechart.diagram.model import Diagram, Link, Node

Guards = Literal["legend", "inline"]
"""Place of guards, resets and conditions: below the picture, or at every arrow and box."""

GUARDS: tuple[Guards, ...] = ("legend", "inline")

TIMES = "\N{MULTIPLICATION SIGN}"
"""Prefix of a count."""

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
# Lines and characters of actions in a box; longer ones are in the legend.
_MAX_LINES, _MAX_CHARACTERS = 3, 24


class Meaning(NamedTuple):
    """Guard and reset of an event; `route` is its arrow if there are several meanings."""

    event: str
    route: str
    guard: str
    reset: str


class Legend(NamedTuple):
    """Rows: events, (state, conditions, actions), numbered reasons."""

    events: tuple[Meaning, ...]
    states: tuple[tuple[str, str, str], ...]
    reasons: tuple[str, ...]


def legend(diagram: Diagram, guards: Guards = "legend") -> Legend:
    """Return the legend of a diagram; reasons only if `guards` are inline."""
    reasons = tuple(dict.fromkeys(n.infeasible for n in diagram.nodes if n.infeasible is not None))
    if guards == "inline":
        return Legend((), (), reasons)
    pieces = diagram.explained or diagram.pieces
    labels = {node.name: _flat(node.label) for piece in pieces for node in piece.nodes}
    shown = {link.cause for piece in diagram.pieces for link in piece.links}
    links = [
        (link, f"{labels[link.source]} → {labels[link.target]}", piece.title)
        for piece in pieces
        for link in piece.links
        if (link.guard or link.reset) and link.cause in shown
    ]
    meanings: dict[tuple[str, str], set[tuple[str, str]]] = {}
    for link, ends, _ in links:
        meanings.setdefault((link.cause, ends), set()).add((link.guard, link.reset))
    routes: dict[tuple[str, str, str], list[str]] = {}
    # Meanings of one event stand together; the regions tell those between the same states apart.
    order = {link.cause: k for k, (link, _, _) in reversed([*enumerate(links)])}
    for link, ends, title in sorted(links, key=lambda one: order[one[0].cause]):
        whose = f"{title}: " if title and len(meanings[link.cause, ends]) > 1 else ""
        routes.setdefault((link.cause, link.guard, link.reset), []).append(whose + ends)
    causes = [cause for cause, _, _ in routes]
    # Labels of charts of regions, and the states in names of modes.
    states = {word for node in diagram.nodes for word in (node.label, *node.name.split())}
    rows = (
        (_flat(n.label), ", ".join(n.invariants), "" if fits(n) else "\n".join(n.actions))
        for piece in pieces
        for n in piece.nodes
        if n.label in states
    )
    return Legend(
        tuple(
            Meaning(cause, ", ".join(dict.fromkeys(ends)) if causes.count(cause) > 1 else "", *does)
            for (cause, *does), ends in routes.items()
        ),
        tuple(dict.fromkeys(row for row in rows if row[1] or row[2])),
        reasons,
    )


def fits(node: Node) -> bool:
    """Return whether a box has room for the actions of a state."""
    lines = node.actions
    return len(lines) <= _MAX_LINES and all(len(line) <= _MAX_CHARACTERS for line in lines)


def mark(node: Node, reasons: tuple[str, ...]) -> str:
    """Return the superscript of the reason why a state is infeasible."""
    return "" if node.infeasible is None else superscript(reasons.index(node.infeasible) + 1)


def superscript(count: int) -> str:
    """Return a number as a superscript."""
    return str(count).translate(_SUPERSCRIPTS)


def events(links: Iterable[Link]) -> str:
    """Return the names of events on one arrow, with their counts."""
    counts: dict[str, int] = {}
    for link in links:
        counts[link.event] = counts.get(link.event, 0) + (link.visits or 0)
    return ", ".join(f"{event} {TIMES}{n}" if n else event for event, n in counts.items())


def _flat(label: str) -> str:
    return label.replace("\n", ", ")
