"""Data model of a diagram: states and labelled links."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

from statechart.automaton.regions import Region
from statechart.tabular import pluralise

if TYPE_CHECKING:
    import networkx as nx

# Reserved words of Mermaid (`stateDiagram.jison`), in any case; DOT and SCXML have none here.
_RESERVED = {
    "acctitle", "accdescr", "as", "class", "classdef", "click", "default", "direction", "end",
    "hide", "note", "scale", "state", "statediagram", "style",
}  # fmt: skip
_LONGEST_ROUTE = 110  # characters of the path of a run


@dataclass(frozen=True, slots=True)
class Node:
    """A state (mode) of a chart.

    Its `name` is unique in the diagram, such as ``tip:slide+``, and `inside` the name of the state
    that encloses it (``tip:slide``). The chart starts in the one `initial` state; `default` is the
    state in which the enclosing one begins. The states inside a `parallel` one are its regions.
    `invariants` hold while the state is active; `actions` are its ``entry /``, ``exit /`` and
    rates. `visits` counts how often a run entered it (None: no run is shown), `infeasible` is why
    no motion can be in it. With a `final` state the enclosing one is done; a `history` is only a
    target. Where the regions of a chart start in different states, `starting` names those that
    start here. `colours` belong to the lines of the label, a single one to the box.
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
    default: bool = False
    parallel: bool = False
    actions: tuple[str, ...] = ()
    history: bool = False
    starting: str = ""


@dataclass(frozen=True, slots=True)
class Link:
    """A transition between two nodes: its cause, such as ``touchdown``, its guard and reset.

    `visits` counts the jumps of a run; `region` is set in charts of several regions. An `internal`
    transition does not exit its source.
    """

    source: str
    target: str
    cause: str
    guard: str
    reset: str
    visits: int | None = None
    region: str = ""
    internal: bool = False

    @property
    def event(self) -> str:
        """The cause, prefixed by the region if any."""
        return f"{self.region} {self.cause}".strip()


@dataclass(frozen=True, slots=True)
class Chart:
    """States and the links between them, drawn as one piece.

    `path` are the nodes in the order of a run. The chart of a product of two regions has their
    charts as `axes`; its nodes are all pairs of innermost states, row by row (second region).
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
        """The path as one line of text; empty without a path."""
        labels = {node.name: node.label.replace("\n", ", ") for node in self.nodes}
        shown, length = list[str](), 0
        for name in self.path:
            length += len(labels[name]) + len(" → ")
            if shown and length > _LONGEST_ROUTE:
                break
            shown.append(labels[name])
        rest = len(self.path) - len(shown)
        return " → ".join([*shown, f"… ({rest} more)"] if rest else shown)

    @property
    def leaves(self) -> tuple[Node, ...]:
        """Innermost states."""
        holding = {node.inside for node in self.nodes}
        return tuple(node for node in self.nodes if node.name not in holding)

    @property
    def frames(self) -> tuple[Node, ...]:
        """Superstates."""
        holding = {node.inside for node in self.nodes}
        return tuple(node for node in self.nodes if node.name in holding)

    def node(self, name: str) -> Node:
        """Return a state by its name."""
        return next(node for node in self.nodes if node.name == name)

    def within(self, name: str | None) -> tuple[Node, ...]:
        """Return the substates of a state, or the outermost states."""
        return tuple(node for node in self.nodes if node.inside == name)

    def around(self, name: str) -> tuple[str, ...]:
        """Return the superstates of a state, inner first."""
        inside = {node.name: node.inside for node in self.nodes}
        found: list[str] = []
        while (outer := inside[found[-1] if found else name]) is not None:
            found.append(outer)
        return tuple(found)

    def entered(self, name: str) -> str:
        """Return the innermost default state of a state."""
        while begins := [node.name for node in self.within(name) if node.default]:
            name = begins[0]
        return name

    def nested(self, link: Link) -> bool:
        """Return whether a link is between a state and its superstate, without an arrow."""
        source, target = link.source, link.target
        return source == target or source in self.around(target) or target in self.around(source)

    @property
    def bundles(self) -> dict[tuple[str, str], list[Link]]:
        """The links by their ends."""
        found: dict[tuple[str, str], list[Link]] = {}
        for link in self.links:
            found.setdefault((link.source, link.target), []).append(link)
        return found

    @property
    def arrows(self) -> dict[tuple[str, str], list[Link]]:
        """The links between two boxes, by their ends."""
        return {e: links for e, links in self.bundles.items() if not self.nested(links[0])}


@dataclass(frozen=True, eq=False)
class Machine:
    """The regions of an automaton at its initial state, for SCXML.

    `start` is the state of each region; `values` are parameters, variables and ``time``.
    """

    regions: tuple[Region, ...]
    start: tuple[str, ...]
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True, repr=False)
class Diagram:
    """A statechart, or a part of it; notebooks show it.

    Parameters
    ----------
    title : str
        Heading; if empty, notes and paths are not shown either.
    charts : tuple of Chart
        Its charts.
    notes : tuple of str
        Lines below the title.
    shows : callable or None
        Returns the graph of the shown part of the product automaton, if any.
    machine : Machine or None
        The regions, for SCXML.
    explained : tuple of Chart
        Charts of the legend, if not those shown.
    """

    title: str
    charts: tuple[Chart, ...]
    notes: tuple[str, ...] = ()
    shows: Callable[[], nx.MultiDiGraph] | None = field(default=None, compare=False)
    machine: Machine | None = field(default=None, compare=False)
    explained: tuple[Chart, ...] = ()

    svg: ClassVar[Callable[[Any], str]]
    """Return the diagram as SVG; set by `statechart.diagram.write`."""

    def __repr__(self) -> str:
        states, links = pluralise(len(self.nodes), "state"), len(self.links)
        return f"<diagram of {self.title}: {states}, {pluralise(links, 'transition')}>"

    @property
    def graph(self) -> nx.MultiDiGraph | None:
        """The shown part of the product automaton, if any."""
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
        """The charts, with a product replaced by those of its two regions."""
        return tuple(piece for chart in self.charts for piece in chart.axes or (chart,))

    @property
    def routes(self) -> tuple[str, ...]:
        """The paths of charts, one line of text each."""
        return tuple(chart.route for chart in self.charts if len(chart.path) > 1)

    def _repr_svg_(self) -> str:
        return self.svg()

    def _repr_mimebundle_(self, **_: object) -> dict[str, str]:
        return {"image/svg+xml": self.svg(), "text/plain": repr(self.title)}


def identifiers(diagram: Diagram) -> dict[str, str]:
    """Return name -> unique ASCII identifier, valid in DOT, Mermaid and XML."""
    pieces = (node for piece in diagram.pieces for node in piece.nodes)
    return unique_identifiers(dict.fromkeys(node.name for node in (*diagram.nodes, *pieces)), set())


def spell_signs(name: str) -> str:
    """Return the name of a state with its sign of sliding in letters."""
    return name.replace("+", "_plus").replace("-", "_minus")


def unique_identifiers(names: Iterable[str], taken: set[str]) -> dict[str, str]:
    """Return name -> identifier, as `identifiers`."""

    def claim(name: str) -> str:
        stem = re.sub(r"\W+", "_", spell_signs(name), flags=re.ASCII).strip("_")
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
    """Replace control characters and lone surrogates by U+FFFD."""
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\t", " ")
    return re.sub("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]", "\ufffd", text)
