"""The one value every renderer of a chart reads: states and labelled links, no drawing."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from statechart.errors import StatechartError

if TYPE_CHECKING:
    import networkx as nx

    from statechart.diagram.machine import Machine

# Words that Mermaid's lexer takes for its own wherever a state's id could stand (its
# `stateDiagram.jison`), in any case; DOT and SCXML reserve none that matters here.
_RESERVED = {
    "acctitle", "accdescr", "as", "class", "classdef", "click", "default", "direction", "end",
    "hide", "note", "scale", "state", "statediagram", "style",
}  # fmt: skip
_PATH_SHOWN = 12


@dataclass(frozen=True, slots=True)
class Node:
    """A state (mode) of a chart.

    Parameters
    ----------
    name : str
        The mode's own name, unique in the diagram, such as ``tip:slide+``.
    label : str
        What the reader sees.
    group : str or None
        Name of the state that encloses this one, if any (``slide`` of ``slide+``).
    invariants : tuple of str
        Conditions that hold while the state is active.
    initial, final : bool
        Whether the chart starts here; whether it ends here.
    visits : int or None
        How often a run entered the state; None if no run is shown.
    infeasible : str or None
        Why no motion can be in this state; None if some can.
    """

    name: str
    label: str
    group: str | None = None
    invariants: tuple[str, ...] = ()
    initial: bool = False
    final: bool = False
    visits: int | None = None
    infeasible: str | None = None


@dataclass(frozen=True, slots=True)
class Link:
    """A transition between two states.

    Parameters
    ----------
    source, target : str
        Names of nodes.
    cause : str
        The kind of event, such as ``touchdown``.
    guard, reset : str
        The condition it fires on, what it assigns; empty where there is none.
    visits : int or None
        How often a run took it; None if no run is shown.
    """

    source: str
    target: str
    cause: str
    guard: str
    reset: str
    visits: int | None = None


@dataclass(frozen=True, slots=True)
class Diagram:
    """A chart ready to be rendered.

    Parameters
    ----------
    title : str
        Heading.
    nodes : tuple of Node
        States, in the order they are to be listed.
    links : tuple of Link
        Transitions; several between the same two states are allowed.
    notes : tuple of str
        Lines shown below the title.
    path : tuple of str
        Names of nodes in the order a run took them.
    graph : MultiDiGraph or None
        The part of the product automaton that is shown, where it was made of one.
    machine : Machine or None
        The regions that it was made of, for the format that runs.

    Raises
    ------
    StatechartError
        If two nodes share a name, more than one is initial, or a link or the path names no node.
    """

    title: str
    nodes: tuple[Node, ...]
    links: tuple[Link, ...]
    notes: tuple[str, ...] = ()
    path: tuple[str, ...] = ()
    graph: nx.MultiDiGraph | None = field(default=None, compare=False, repr=False)
    machine: Machine | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        names = [node.name for node in self.nodes]
        known = set(names)
        if len(known) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise StatechartError(f"diagram {self.title!r} has two states called {twice[0]!r}")
        if sum(node.initial for node in self.nodes) > 1:
            raise StatechartError(f"diagram {self.title!r} has more than one initial state")
        ends = [end for link in self.links for end in (link.source, link.target)]
        for name in (*ends, *self.path):
            if name not in known:
                raise StatechartError(
                    f"diagram {self.title!r} refers to {name!r}, which is none of its states"
                )

    @property
    def initial(self) -> Node | None:
        """The state the chart starts in, if one is declared."""
        return next((node for node in self.nodes if node.initial), None)

    @property
    def route(self) -> str:
        """The path in words, cut where it gets long; empty without a path."""
        labels = {node.name: " ".join(node.label.split()) for node in self.nodes}
        shown = [labels[name] for name in self.path[:_PATH_SHOWN]]
        rest = len(self.path) - len(shown)
        return " → ".join([*shown, f"… ({rest} more)"] if rest else shown)

    @property
    def groups(self) -> dict[str | None, tuple[Node, ...]]:
        """Nodes by the state that encloses them (None: the chart itself), in order."""
        members: dict[str | None, list[Node]] = {}
        for node in self.nodes:
            members.setdefault(node.group, []).append(node)
        return {group: tuple(nodes) for group, nodes in members.items()}


def identifiers(diagram: Diagram) -> tuple[dict[str, str], dict[str, str]]:
    """Give states and groups unique ASCII identifiers that DOT, Mermaid and XML all accept.

    Parameters
    ----------
    diagram : Diagram
        The chart; a state ``tip:slide+`` becomes ``tip_slide_plus``.

    Returns
    -------
    tuple of two dicts of str to str
        Identifier by name, of the states and of the groups; none occurs twice, whatever the case
        of its letters, and none begins with an underscore.
    """
    taken: set[str] = set()
    groups = [group for group in diagram.groups if group is not None]
    return named([node.name for node in diagram.nodes], taken), named(groups, taken)


def named(names: Iterable[str], taken: set[str]) -> dict[str, str]:
    """Return name -> identifier as `identifiers` gives them.

    Parameters
    ----------
    names : iterable of str
        Each once.
    taken : set of str
        Identifiers that are taken, in small letters; those given are added.
    """

    def claim(name: str) -> str:
        spelled = name.replace("+", "_plus").replace("-", "_minus")
        stem = re.sub(r"\W+", "_", spelled, flags=re.ASCII).strip("_")
        if not stem or stem[0].isdigit() or stem.lower() in _RESERVED:
            stem = f"s_{stem}"
        identifier, count = stem, 1
        while identifier.lower() in taken:
            count += 1
            identifier = f"{stem}_{count}"
        taken.add(identifier.lower())
        return identifier

    return {name: claim(name) for name in names}


def printable(text: str) -> str:
    """Replace what no text format can hold (control characters, lone surrogates) by U+FFFD."""
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\t", " ")
    return re.sub("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]", "\ufffd", text)
