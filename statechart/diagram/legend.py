"""What the arrows and boxes of a diagram stand for, each thing said once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from statechart.diagram.model import Chart, Diagram, Link, Node

Guards = Literal["legend", "inline"]
"""Where guards, resets and conditions stand: once below the picture, or at every arrow and box."""

GUARDS: tuple[Guards, ...] = ("legend", "inline")

TIMES = "\N{MULTIPLICATION SIGN}"
"""Before how often something happened."""

# Digits of footnotes.
_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")


@dataclass(frozen=True)
class Meaning:
    """When an event happens and what it does.

    Attributes
    ----------
    event : str
        Its name, as on arrows.
    route : str
        Which of its arrows is meant, where that makes a difference; else empty.
    guard, reset : str
        As of a `Link`.
    """

    event: str
    route: str
    guard: str
    reset: str


@dataclass(frozen=True)
class Legend:
    """A diagram's table: events, conditions of states, reasons in the order of their numbers."""

    events: tuple[Meaning, ...]
    states: tuple[tuple[str, str], ...]
    reasons: tuple[str, ...]


def legend(diagram: Diagram, guards: Guards = "legend") -> Legend:
    """Return the table below a diagram; reasons alone where `guards` stand at their arrows."""
    said = (node.infeasible for node in diagram.nodes)
    reasons = tuple(dict.fromkeys(reason for reason in said if reason is not None))
    if guards == "inline":
        return Legend((), (), reasons)
    pieces = diagram.explained or diagram.pieces
    named = {node.name: node.label for piece in pieces for node in piece.nodes}
    shown = {link.cause for piece in diagram.pieces for link in piece.links}
    routes: dict[tuple[str, str, str], list[Link]] = {}
    for piece in pieces:
        for link in piece.links:
            if (link.guard or link.reset) and link.cause in shown:
                routes.setdefault((link.cause, link.guard, link.reset), []).append(link)
    often = [cause for cause, _, _ in routes]
    # Labels of regions' own charts; the name of a mode is the states of its regions.
    states = {word for node in diagram.nodes for word in (node.label, *node.name.split())}
    return Legend(
        tuple(
            Meaning(cause, _route(links, named) if often.count(cause) > 1 else "", guard, reset)
            for (cause, guard, reset), links in routes.items()
        ),
        tuple(
            dict.fromkeys(
                _condition(node)
                for piece in pieces
                for node in piece.nodes
                if node.invariants and node.label in states
            )
        ),
        reasons,
    )


def mark(node: Node, reasons: tuple[str, ...]) -> str:
    """Return the number under which the legend says why a state is impossible; a superscript."""
    return "" if node.infeasible is None else number(reasons.index(node.infeasible) + 1)


def number(count: int) -> str:
    """Return a number as a superscript."""
    return str(count).translate(_SUPERSCRIPTS)


def events(links: Iterable[Link]) -> str:
    """Return the names of events on one arrow, with how often a run took each."""
    told: dict[str, int] = {}
    for link in links:
        told[link.event] = told.get(link.event, 0) + (link.visits or 0)
    return ", ".join(f"{event} {TIMES}{count}" if count else event for event, count in told.items())


def _route(links: list[Link], named: dict[str, str]) -> str:
    ends = (f"{_flat(named[x.source])} → {_flat(named[x.target])}" for x in links)
    return ", ".join(dict.fromkeys(ends))


def _condition(node: Node) -> tuple[str, str]:
    return _flat(node.label), ", ".join(node.invariants)


def _flat(label: str) -> str:
    return ", ".join(label.split("\n"))


def drawn_once(chart: Chart) -> dict[tuple[str, str], list[Link]]:
    """Return the links of a chart by their ends: those of the same two states share an arrow."""
    found: dict[tuple[str, str], list[Link]] = {}
    for link in chart.links:
        found.setdefault((link.source, link.target), []).append(link)
    return found
