"""The one value every renderer of a chart reads: states and labelled links, no drawing."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
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
# The path of a run is told on one line, of so many characters at most.
_LONGEST_ROUTE = 110


@dataclass(frozen=True, slots=True)
class Node:
    """A state (mode) of a chart.

    Parameters
    ----------
    name : str
        The state's own name, unique in the diagram, such as ``tip:slide+``.
    label : str
        What the reader sees.
    inside : str or None
        Name of the state that encloses this one, if any (``tip:slide`` of ``tip:slide+``).
    invariants : tuple of str
        Conditions that hold while the state is active.
    initial, final : bool
        Whether the chart starts here; whether it ends here.
    visits : int or None
        How often a run entered the state; None if no run is shown.
    infeasible : str or None
        Why no motion can be in this state; None if some can.
    colours : tuple of str
        Of every line of the label, or of all of them together; none where it has no own colour.
    """

    name: str
    label: str
    inside: str | None = None
    invariants: tuple[str, ...] = ()
    initial: bool = False
    final: bool = False
    visits: int | None = None
    infeasible: str | None = None
    colours: tuple[str, ...] = ()


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
    region : str
        Whose transition it is, where the chart is of several regions.
    """

    source: str
    target: str
    cause: str
    guard: str
    reset: str
    visits: int | None = None
    region: str = ""

    @property
    def event(self) -> str:
        """Whose event, and which."""
        return f"{self.region} {self.cause}".strip()


@dataclass(frozen=True, slots=True)
class Chart:
    """States and the links between them, drawn as one piece.

    Parameters
    ----------
    nodes : tuple of Node
        States, in the order they are to be listed.
    links : tuple of Link
        Transitions; several between the same two states are allowed.
    title : str
        What it shows; empty where the diagram is this chart alone.
    path : tuple of str
        Names of nodes in the order a run took them.
    axes : tuple of two Charts or None
        Of a product of two regions, their charts: nodes are those of the product of the states
        that hold no others, row by row. A row goes through the states of the second.
    """

    nodes: tuple[Node, ...]
    links: tuple[Link, ...]
    title: str = ""
    path: tuple[str, ...] = ()
    axes: tuple[Chart, Chart] | None = None

    @property
    def initial(self) -> Node | None:
        """The state the chart starts in, if one is declared."""
        return next((node for node in self.nodes if node.initial), None)

    @property
    def route(self) -> str:
        """The path in words, cut to one line; empty without a path."""
        labels = {node.name: ", ".join(node.label.split("\n")) for node in self.nodes}
        told, length = list[str](), 0
        for name in self.path:
            length += len(labels[name]) + len(" → ")
            if told and length > _LONGEST_ROUTE:
                break
            told.append(labels[name])
        rest = len(self.path) - len(told)
        return " → ".join([*told, f"… ({rest} more)"] if rest else told)

    @property
    def leaves(self) -> tuple[Node, ...]:
        """States that hold no others."""
        holding = {node.inside for node in self.nodes}
        return tuple(node for node in self.nodes if node.name not in holding)

    @property
    def frames(self) -> tuple[Node, ...]:
        """States that hold others."""
        holding = {node.inside for node in self.nodes}
        return tuple(node for node in self.nodes if node.name in holding)

    def node(self, name: str) -> Node:
        """Return a state by its name."""
        return next(node for node in self.nodes if node.name == name)

    def within(self, name: str | None) -> tuple[Node, ...]:
        """Return the states right inside another, or inside none."""
        return tuple(node for node in self.nodes if node.inside == name)

    def around(self, name: str) -> tuple[str, ...]:
        """Return the states that enclose one, inner first."""
        inside = {node.name: node.inside for node in self.nodes}
        found: list[str] = []
        while (outer := inside[found[-1] if found else name]) is not None:
            found.append(outer)
        return tuple(found)


@dataclass(frozen=True, slots=True, repr=False)
class Diagram:
    """What is drawn of a statechart, ready to be rendered; it shows itself in notebooks.

    Parameters
    ----------
    title : str
        Heading; where it is empty, notes and paths are not shown either.
    charts : tuple of Chart
        Its pieces, beside and below each other.
    notes : tuple of str
        Lines shown below the title.
    shows : callable or None
        Makes a graph of the part of the product automaton that is shown, where there is one.
    machine : Machine or None
        The regions that it was made of, for the format that runs.
    explained : tuple of Chart
        Whose events, guards and conditions the legend tells, where not those shown.

    Raises
    ------
    StatechartError
        If two nodes share a name, more than one of a chart is initial, states enclose each other,
        or a link, a path or what encloses a node names no node of its chart.
    """

    title: str
    charts: tuple[Chart, ...]
    notes: tuple[str, ...] = ()
    shows: Callable[[], nx.MultiDiGraph] | None = field(default=None, compare=False)
    machine: Machine | None = field(default=None, compare=False)
    explained: tuple[Chart, ...] = ()

    def __repr__(self) -> str:
        states, links = len(self.nodes), len(self.links)
        return (
            f"<diagram of {self.title}: {states} state{'s' if states != 1 else ''}, "
            f"{links} transition{'s' if links != 1 else ''}>"
        )

    def __post_init__(self) -> None:
        names = [node.name for node in self.nodes]
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise StatechartError(f"diagram {self.title!r} has two states called {twice[0]!r}")
        for chart in (*self.charts, *self.pieces):
            self._check(chart)

    def _check(self, chart: Chart) -> None:
        if sum(node.initial for node in chart.nodes) > 1:
            raise StatechartError(f"diagram {self.title!r} has more than one initial state")
        inside = {node.name: node.inside for node in chart.nodes}
        ends = [end for link in chart.links for end in (link.source, link.target)]
        for name in (*ends, *chart.path, *filter(None, inside.values())):
            if name not in inside:
                raise StatechartError(
                    f"diagram {self.title!r} refers to {name!r}, which is none of its states"
                )
        for name in inside:
            outer, steps = inside[name], 0
            while outer is not None:
                outer, steps = inside[outer], steps + 1
                if steps > len(inside):
                    raise StatechartError(f"in diagram {self.title!r} {name!r} encloses itself")

    @property
    def graph(self) -> nx.MultiDiGraph | None:
        """The part of the product automaton that is shown, where there is one."""
        return None if self.shows is None else self.shows()

    @property
    def nodes(self) -> tuple[Node, ...]:
        """States of all charts."""
        return tuple(node for chart in self.charts for node in chart.nodes)

    @property
    def links(self) -> tuple[Link, ...]:
        """Transitions of all charts."""
        return tuple(link for chart in self.charts for link in chart.links)

    @property
    def pieces(self) -> tuple[Chart, ...]:
        """Charts as people draw them: of a product, those of its two regions."""
        return tuple(piece for chart in self.charts for piece in chart.axes or (chart,))

    @property
    def routes(self) -> tuple[str, ...]:
        """The paths of charts in words, each on one line."""
        return tuple(chart.route for chart in self.charts if len(chart.path) > 1)

    def _repr_svg_(self) -> str:
        from statechart.diagram.dot import dot
        from statechart.diagram.layout.graphviz_program import render

        return render(dot(self), "svg").decode()

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        return {"image/svg+xml": self._repr_svg_(), "text/plain": repr(self.title)}


def identifiers(diagram: Diagram) -> dict[str, str]:
    """Give states unique ASCII identifiers that DOT, Mermaid and XML all accept."""
    pieces = (node for piece in diagram.pieces for node in piece.nodes)
    return named(dict.fromkeys(node.name for node in (*diagram.nodes, *pieces)), set())


def signs_spelled(name: str) -> str:
    """Return a name of a state with its sign, that of sliding, in letters."""
    return name.replace("+", "_plus").replace("-", "_minus")


def named(names: Iterable[str], taken: set[str]) -> dict[str, str]:
    """Return name -> identifier as `identifiers` gives them."""

    def claim(name: str) -> str:
        stem = re.sub(r"\W+", "_", signs_spelled(name), flags=re.ASCII).strip("_")
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
