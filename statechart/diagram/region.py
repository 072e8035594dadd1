"""A region as its own chart, states in states; how modes and regions are named on a picture."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from statechart.automaton.automaton import Automaton
from statechart.automaton.hierarchy import hierarchical_edges
from statechart.automaton.nesting import UNREACHED, HierarchicalEdge
from statechart.automaton.regions import Margin, Region
from statechart.automaton.trace import Role
from statechart.diagram.model import Chart, Link, Node

# Of more regions alike than this not all are named; a mode is named by so many lines.
_MOST_NAMES, _MOST_LINES = 8, 4
_NUMBER = re.compile(r"\d+(\.\d+)?")


def region_chart(
    automaton: Automaton,
    region: Region,
    *,
    prefix: str = "",
    title: str = "",
    start: str | None = None,
) -> Chart:
    """Return the chart of a region, with as few arrows as its superstates allow.

    Parameters
    ----------
    automaton : Automaton
        That the region is of.
    region : Region
        Perhaps without the directions of sliding.
    prefix : str
        What the names of its states begin with.
    title : str
        Of the chart.
    start : str, optional
        The state that it starts in.
    """
    leaves = region.innermost
    edges = hierarchical_edges(region)
    linked = {end for edge in edges for end in (edge.source, edge.target)}
    holding = {n: _held(region, leaves, n) for n in _superstates(region) if n not in leaves}
    # A frame round a single direction of sliding would repeat what its label says.
    frames = {
        name
        for name, held in holding.items()
        if region.nesting.names or len(held) > 1 or name in linked - {*held}
    }
    colours = automaton.colours[region.name]
    begun = region.nesting.configurations.get(start or "", (start,))[0]

    def node(name: str) -> Node:
        inside = next((outer for outer in _around(region, name) if outer in frames), None)
        leaf = name not in frames
        return Node(
            prefix + name,
            name,
            None if inside is None else prefix + inside,
            _conditions(automaton, region, name) if leaf else (),
            initial=name == begun,
            infeasible=UNREACHED if name in region.nesting.unreached else None,
            colours=(colours[name],) if leaf else (),
        )

    def remembered(name: str) -> Node:
        """Return a history as Harel draws it."""
        history = region.nesting.histories[name]
        inside = prefix + history.parent if history.parent in frames else None
        refused = UNREACHED if history.parent in region.nesting.unreached else None
        label = "H*" if history.depth == "deep" else "H"
        return Node(prefix + name, label, inside, infeasible=refused)

    # What holds a state comes before it, outer first.
    names = (n for s in leaves for n in reversed((s, *_around(region, s))) if n == s or n in frames)
    histories = (remembered(name) for name in region.nesting.histories)
    links = (
        Link(
            prefix + e.source,
            prefix + _begun(region, e.target),
            e.cause,
            e.guard,
            _reset(region, e),
        )
        for e in edges
    )
    return Chart((*map(node, dict.fromkeys(names)), *histories), tuple(links), title)


def _begun(region: Region, name: str) -> str:
    """Return the state that a state begins with where its declaration says so; else itself."""
    while name in region.nesting.initial:
        name = region.nesting.initial[name]
    return name


def _around(region: Region, name: str) -> list[str]:
    """Return the states that enclose one, inner first."""
    found: list[str] = []
    while (name := region.superstates.get(name, "")) and name not in found:
        found.append(name)
    return found


def _held(region: Region, leaves: Iterable[str], name: str) -> list[str]:
    """Return the innermost states in a state."""
    return [leaf for leaf in leaves if name in _around(region, leaf)]


def alike(regions: Iterable[Region]) -> Iterable[list[Region]]:
    """Return regions together whose charts are the same but for numbers."""
    found: dict[tuple[tuple[str, ...], tuple[tuple[str, ...], ...]], list[Region]] = {}
    for region in regions:
        edges = (
            (e.cause, e.source, e.target, _NUMBER.sub("#", e.guard), _NUMBER.sub("#", e.reset))
            for e in region.edges
        )
        found.setdefault((region.innermost, tuple(edges)), []).append(region)
    return found.values()


def mode_label(
    states: Sequence[tuple[Region, str]],
) -> tuple[str, tuple[tuple[Region, str], ...]]:
    """Return a mode's name, by what is not at its default, and whose state every line of it is."""
    told = [(region, state) for region, state in states if state != region.default]
    if not told:
        default = states[0][0].default
        return f"all {default}" if len(states) > 1 else default, (states[0],)
    if len(states) == 1:
        return told[0][1], tuple(told)
    if len(told) <= _MOST_LINES:
        return "\n".join(f"{region.name} {state}" for region, state in told), tuple(told)
    together: dict[str, list[tuple[Region, str]]] = {}
    for region, state in told:
        together.setdefault(state, []).append((region, state))
    lines = []
    for state, of in together.items():  # many names make boxes of which few are beside each other
        alike = sum(state in region.states for region, _ in states)
        alone = len(of) == 1
        lines.append(f"{of[0][0].name} {state}" if alone else f"{state}: {len(of)} of {alike}")
    return "\n".join(lines), tuple(of[0] for of in together.values())


def cut(names: list[str]) -> list[str]:
    """Return names for a line of text: of many the first ones, and how many there are."""
    if len(names) <= _MOST_NAMES:
        return names
    return [*names[:3], f"... {names[-1]} ({len(names)} in all)"]


def _superstates(region: Region) -> Iterator[str]:
    """Return what holds other states, outer first."""
    found = dict.fromkeys(region.superstates.values())
    return iter(sorted(found, key=lambda name: len(region.active(name))))


def _reset(region: Region, edge: HierarchicalEdge) -> str:
    """Return what an edge resets; where that depends on the choice, a line for every reset."""
    by_reset: dict[str, list[str]] = {}
    for choice in edge.choices:
        by_reset.setdefault(choice.reset, []).append(choice.target)
    if len(by_reset) == 1:
        return edge.reset
    return "\n".join(
        f"to {' or '.join(_together(region, targets))}: {reset or 'nothing'}"
        for reset, targets in by_reset.items()
    )


def _together(region: Region, states: list[str]) -> list[str]:
    """Return states, those that are all of a superstate by its name."""
    for name in _superstates(region):
        members = region.within(name)
        if len(members) > 1 and set(members) <= set(states):
            return [name, *_together(region, [s for s in states if s not in members])]
    return states


def _conditions(automaton: Automaton, region: Region, state: str) -> tuple[str, ...]:
    """Return what holds while a state is active; of one without direction, what holds in both."""
    if automaton.laws is None or region.nesting.edges or region.nesting.configurations:
        return ()
    leaves = [state] if state not in region.superstates.values() else _directions(region, state)
    told = [_condition(automaton, region, leaf) for leaf in leaves]
    return tuple(words for words in told[0] if all(words in others for others in told))


def _directions(region: Region, state: str) -> list[str]:
    return [leaf for leaf, outer in region.superstates.items() if outer == state]


def _condition(automaton: Automaton, region: Region, state: str) -> list[str]:
    built = region.build(Role(state))
    prefix = f"{region.name}."
    # A plain margin is the guard of a transition, which stands on its edge.
    conditions = [
        f"{m.name.removeprefix(prefix)} {_sense(automaton, m)} 0"
        for m in built.margins
        if m.kind != "plain"
    ]
    return [*conditions, *(m.name.removeprefix(prefix) for m in built.invariants)]


def _sense(automaton: Automaton, margin: Margin) -> str:
    """Return the sign of what the margin is named after, where that is its negative."""
    named = automaton.observables.get(margin.name)
    return "<=" if named is not None and margin.expression == -named else ">="
