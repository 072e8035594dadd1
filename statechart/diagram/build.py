"""From an automaton, and the run it made, to a diagram."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from statechart.automaton.automaton import Automaton
from statechart.automaton.feasibility import Feasibility
from statechart.automaton.product import graph, visited
from statechart.automaton.regions import Margin, Region
from statechart.automaton.trace import Key, Role, Trace
from statechart.diagram.model import Diagram, Link, Node

if TYPE_CHECKING:
    import networkx as nx

# Two contacts have nine modes as users count, and a product of more than this cannot be read.
_MOST_MODES = 16
# Of more regions alike than this not all are named.
_MOST_NAMES = 8
_NUMBER = re.compile(r"\d+(\.\d+)?")


def needs_run(automaton: Automaton) -> bool:
    """Return whether the product is too large to draw, so that only what a run visited is."""
    return len(automaton.regions) > 1 and automaton.modes_declared > _MOST_MODES


def build(
    automaton: Automaton,
    start: Key,
    trace: Trace | None = None,
    found: Feasibility | None = None,
) -> Diagram:
    """Return the diagram of an automaton, and the graph that it shows.

    One region is drawn as its own chart. Several are drawn as their product, without the
    directions of sliding; where that has too many modes, what the run visited is drawn instead,
    and beside it the chart of every region.

    Parameters
    ----------
    automaton : Automaton
        What to draw.
    start : Key
        The mode that it starts in.
    trace : Trace, optional
        A run, whose path and counts are shown; needed where `needs_run`.
    found : Feasibility, optional
        Which modes are possible where the run starts; the others are marked, with the reason.
    """
    if not needs_run(automaton):
        single = len(automaton.regions) == 1
        modes = graph(automaton, trace=trace, found=found, directions=single)
        return _whole(automaton, start, trace, modes)
    if trace is None:
        raise ValueError("a product of so many modes is drawn as a run visited it")
    return _visited(automaton, trace, graph(automaton, within=0, trace=trace, found=found))


def _whole(
    automaton: Automaton, start: Key, trace: Trace | None, modes: nx.MultiDiGraph
) -> Diagram:
    """Draw all modes; directions of sliding are told apart where there is one region."""
    single = len(automaton.regions) == 1
    initial = start if single else _declared(automaton, start)
    rank = {key: 0 if single else place for place, key in enumerate(modes)}
    edges = sorted(
        modes.edges(keys=True, data=True),
        key=lambda edge: (rank[edge[0]] if edge[3]["guard"] else len(rank), edge[2]),
    )
    nodes = tuple(_node(automaton, key, data, key == initial) for key, data in modes.nodes.items())
    return Diagram(
        automaton.name,
        nodes,
        tuple(
            Link(
                _name(source),
                _name(target),
                # Of one region only a jump that it does not declare says whose it is.
                data["event"] if single and data["guard"] else f"{data['region']} {data['event']}",
                data["guard"],
                data["reset"],
                data.get("visits"),
            )
            for source, target, _, data in edges
        ),
        _notes(automaton, any(node.infeasible for node in nodes)),
        () if trace is None else tuple(map(_name, visited(automaton, trace, directions=single))),
        modes,
    )


def _visited(automaton: Automaton, trace: Trace, modes: nx.MultiDiGraph) -> Diagram:
    """Draw the modes that a run visited, and the chart of every region, those alike once."""
    changing = {
        region.name
        for region, states in zip(automaton.regions, zip(*modes, strict=True), strict=True)
        if len(set(states)) > 1
    } or {region.name for region in automaton.regions}
    nodes = [
        Node(
            _name(key),
            _lines(
                (region, state)
                for region, state in zip(automaton.regions, key, strict=True)
                if region.name in changing
            ),
            group="modes of the run",
            initial=key == trace.start_mode,
            visits=visits,
        )
        for key, visits in modes.nodes(data="visits")
    ]
    resting: dict[str, list[str]] = {}
    for region, state in zip(automaton.regions, trace.start_mode, strict=True):
        if region.name not in changing:
            resting.setdefault(state, []).append(region.name)
    # Jumps that differ in their regions alone are one link.
    taken: dict[tuple[Key, Key, str], Counter[str]] = {}
    for source, target, data in modes.edges(data=True):
        if data["visits"]:
            made = taken.setdefault((source, target, data["event"]), Counter())
            made[data["region"]] += data["visits"]
    links = [
        Link(_name(one), _name(other), f"{', '.join(_cut([*made]))} {event}", "", "", made.total())
        for (one, other, event), made in taken.items()
    ]
    for regions in _alike(automaton.regions):
        region = regions[0]
        group = ", ".join(_cut([r.name for r in regions]))
        if any(other.edges != region.edges for other in regions):
            group += f"; numbers of {region.name}"
        nodes += [Node(f"{region.name}:{s}", s, group=group) for s in region.states]
        links += [
            Link(
                f"{region.name}:{edge.source}", f"{region.name}:{edge.target}",
                edge.cause, edge.guard, edge.reset,
            )
            for edge in region.edges
        ]  # fmt: skip
    notes = [
        *_notes(automaton),
        "too many modes to draw: those that a run visited, and the chart of every region",
        *(f"always {state}: {', '.join(_cut(names))}" for state, names in resting.items()),
    ]
    path = tuple(map(_name, visited(automaton, trace)))
    return Diagram(automaton.name, tuple(nodes), tuple(links), tuple(notes), path, modes)


def _alike(regions: Iterable[Region]) -> Iterable[list[Region]]:
    """Return regions together whose charts are the same but for numbers."""
    found: dict[tuple[tuple[str, ...], tuple[tuple[str, ...], ...]], list[Region]] = {}
    for region in regions:
        edges = (
            (e.cause, e.source, e.target, _NUMBER.sub("#", e.guard), _NUMBER.sub("#", e.reset))
            for e in region.edges
        )
        found.setdefault((region.states, tuple(edges)), []).append(region)
    return found.values()


def _cut(names: list[str]) -> list[str]:
    """Return names for a line of text: of many the first ones, and how many there are."""
    if len(names) <= _MOST_NAMES:
        return names
    return [*names[:3], f"... {names[-1]} ({len(names)} in all)"]


def _declared(automaton: Automaton, key: Key) -> Key:
    return tuple(r.declared(state) for r, state in zip(automaton.regions, key, strict=True))


def _sense(automaton: Automaton, margin: Margin) -> str:
    """Return the sign of what the margin is named after, where that is its negative."""
    named = automaton.observables.get(margin.name)
    return "<=" if named is not None and margin.expression == -named else ">="


def _node(automaton: Automaton, key: Key, data: Mapping[str, Any], initial: bool) -> Node:
    visits = data.get("visits")
    parts: dict[str, Any] = {"label": _lines(zip(automaton.regions, key, strict=True))}
    if len(key) == 1:
        (region,), (state,) = automaton.regions, key
        parts = {"label": state, "invariants": _conditions(automaton, region, state)}
        if region.declared(state) != state:
            parts["group"] = region.declared(state)
    return Node(
        _name(key),
        **parts,
        initial=initial,
        visits=visits,
        # What a run visited became possible on its way.
        infeasible=None if visits else data.get("reason") or None,
    )


def _conditions(automaton: Automaton, region: Region, state: str) -> tuple[str, ...]:
    built = region.build(Role(state))
    prefix = f"{region.name}."
    # A plain margin is the guard of a transition, which stands on its edge.
    conditions = [
        f"{m.name.removeprefix(prefix)} {_sense(automaton, m)} 0"
        for m in built.margins
        if m.kind != "plain"
    ]
    return (*conditions, *(m.name.removeprefix(prefix) for m in built.invariants))


def _notes(automaton: Automaton, refused: bool = False) -> tuple[str, ...]:
    notes = [automaton.declaration.doc] if automaton.declaration.doc else []
    if automaton.stops:
        notes.append(f"stops when: {', '.join(automaton.stops)}")
    if refused:
        notes.append("infeasible: no velocity agrees with the mode where the run starts")
    return tuple(notes)


def _name(key: Key) -> str:
    return " ".join(key)


def _lines(states: Iterable[tuple[Region, str]]) -> str:
    return "\n".join(f"{region.name}: {state}" for region, state in states)
