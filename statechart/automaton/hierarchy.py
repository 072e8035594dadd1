"""States in states (Harel 1987): the superstates of a region, and its edges as a person draws them.

The executor knows flat edges, one for each state that is left. Drawn by a person, an edge that
leaves every state of a superstate leaves the superstate, and edges that enter all of its states
under one guard are one that enters it, with a choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from statechart.automaton.nesting import Choice, HierarchicalEdge
from statechart.automaton.regions import Edge, Region


def hierarchical_edges(region: Region) -> tuple[HierarchicalEdge, ...]:
    """Return the edges of a region with as few arrows as its superstates allow.

    Edges out of all states of a superstate into one state are one; then those from one source, by
    one cause and guard, into all states of a superstate. `flat_edges` undoes it. Of a region that
    was declared with nested states they are those of its declaration.
    """
    if region.nesting.configurations:
        return region.nesting.edges
    superstates = _outermost_first(region)
    leaves = {name: region.within(name) for name in (*region.states, *superstates)}
    alike: dict[tuple[str, str, str, str, bool], list[str]] = {}
    for e in region.edges:
        key = (e.cause, e.target, e.guard, e.reset, e.on_zeno)
        alike.setdefault(key, []).append(e.source)
    fans: dict[tuple[str, str, str, bool], dict[str, str]] = {}
    for (cause, target, guard, reset, on_zeno), sources in alike.items():
        for source in _covered(sources, superstates, leaves):
            fans.setdefault((cause, source, guard, on_zeno), {})[target] = reset
    return tuple(
        HierarchicalEdge(
            cause,
            source,
            target,
            guard,
            tuple(Choice(leaf, targets[leaf]) for leaf in leaves[target]),
            on_zeno,
        )
        for (cause, source, guard, on_zeno), targets in fans.items()
        for target in _covered(list(targets), superstates, leaves)
    )


def flat_edges(region: Region, edges: Iterable[HierarchicalEdge]) -> tuple[Edge, ...]:
    """Return the edges that the executor knows, those of a superstate for each of its states."""
    return tuple(
        Edge(edge.cause, source, choice.target, edge.guard, choice.reset, edge.on_zeno)
        for edge in edges
        for source in region.within(edge.source)
        for choice in edge.choices
    )


def _outermost_first(region: Region) -> list[str]:
    found = dict.fromkeys(region.superstates.values())
    return sorted(found, key=lambda name: len(region.active(name)))


def _covered(
    states: Sequence[str], superstates: Sequence[str], leaves: Mapping[str, tuple[str, ...]]
) -> list[str]:
    """Return states, those that are all of a superstate as the superstate, where they are many."""
    left, found = dict.fromkeys(states), dict[str, None]()
    for name in superstates:
        members = leaves[name]
        if len(members) > 1 and left.keys() >= set(members):
            found[name] = None
            left = dict.fromkeys(state for state in left if state not in members)
    return [*found, *left]
