"""Statechart of one region with states in states, and the names of modes and regions."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import (
    UNREACHED,
    HierarchicalEdge,
    Margin,
    Region,
    hierarchical_edges,
)
from statechart.automaton.trace import Role
from statechart.diagram.model import Chart, Link, Node

# Longer lists of names of regions are cut; a mode is named by at most so many lines.
_MAX_NAMES, _MAX_LINES = 8, 4
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

    The region may be without its directions of sliding. `prefix` begins the names of its nodes;
    `start` is the state that it starts in.
    """
    nesting = region.nesting
    leaves = region.innermost
    edges = hierarchical_edges(region)
    linked = {end for edge in edges for end in (edge.source, edge.target)}
    inner = {n: [s for s in leaves if n in _around(region, s)] for n in _superstates(region)}
    # A frame round a single direction of sliding would repeat what its label says.
    frames = {
        name
        for name, held in inner.items()
        if name not in leaves and (nesting.names or len(held) > 1 or name in linked - {*held})
    }
    colours = automaton.colours[region.name]
    begins = {*nesting.initial.values()}
    first = nesting.configurations.get(start or "", (start,))[0]
    initial = nesting.initial.get("")
    if initial is None or first not in _begun(region, initial):
        initial = first

    def node(name: str) -> Node:
        inside = next((outer for outer in _around(region, name) if outer in frames), None)
        leaf = name not in frames
        return Node(
            prefix + name,
            name,
            None if inside is None else prefix + inside,
            _conditions(automaton, region, name) if leaf else (),
            initial=name == initial,
            infeasible=UNREACHED if name in nesting.unreached else None,
            colours=(colours[name],) if leaf else (),
            default=name in begins and name != nesting.initial[""],
            parallel=name in nesting.parallel,
            actions=_actions(region, name),
            final=name in nesting.final,
        )

    def history(name: str) -> Node:
        """Return a history, a circle in Harel's statecharts and UML."""
        declared = nesting.histories[name]
        inside = prefix + declared.parent if declared.parent in frames else None
        refused = UNREACHED if declared.parent in nesting.unreached else None
        label = "H*" if declared.depth == "deep" else "H"
        return Node(prefix + name, label, inside, infeasible=refused, history=True)

    # Enclosing states come before a state, outer first.
    names = (n for s in leaves for n in reversed((s, *_around(region, s))) if n == s or n in frames)
    links = (
        Link(
            prefix + e.source, prefix + e.target, e.cause, e.guard, _reset(region, e),
            internal=e.internal,
        )
        for e in edges
    )  # fmt: skip
    nodes = (*map(node, dict.fromkeys(names)), *map(history, nesting.histories))
    return Chart(nodes, tuple(links), title)


def _begun(region: Region, name: str) -> set[str]:
    """Return the state with those that it begins with, where all of a parallel one do."""
    nesting, found = region.nesting, {name}
    if name in nesting.parallel:
        inner = [state for state, outer in region.superstates.items() if outer == name]
    else:
        inner = [nesting.initial[name]] if name in nesting.initial else []
    for state in inner:
        found |= _begun(region, state)
    return found


def _around(region: Region, name: str) -> list[str]:
    """Return the states that enclose one, inner first."""
    found: list[str] = []
    while (name := region.superstates.get(name, "")) and name not in found:
        found.append(name)
    return found


def group_alike(regions: Iterable[Region]) -> Iterable[list[Region]]:
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
    """Return the name of a mode, its states that are no default, and the state of every line."""
    shown = [(region, state) for region, state in states if state != region.default]
    if not shown:
        default = states[0][0].default
        return f"all {default}" if len(states) > 1 else default, (states[0],)
    if len(states) == 1:
        return shown[0][1], tuple(shown)
    if len(shown) <= _MAX_LINES:
        return "\n".join(f"{region.name} {state}" for region, state in shown), tuple(shown)
    groups: dict[str, list[tuple[Region, str]]] = {}
    for region, state in shown:
        groups.setdefault(state, []).append((region, state))
    lines = []
    for state, members in groups.items():
        total = sum(state in region.states for region, _ in states)
        alone = len(members) == 1
        lines.append(
            f"{members[0][0].name} {state}" if alone else f"{state}: {len(members)} of {total}"
        )
    return "\n".join(lines), tuple(members[0] for members in groups.values())


def abbreviate(names: list[str]) -> list[str]:
    """Return names for a line of text: of many the first ones, and how many there are."""
    if len(names) <= _MAX_NAMES:
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
        f"to {' or '.join(_state_lines(region, targets))}: {reset or 'nothing'}"
        for reset, targets in by_reset.items()
    )


def _state_lines(region: Region, states: list[str]) -> list[str]:
    """Return states, those that are all of a superstate by its name."""
    for name in _superstates(region):
        members = region.within(name)
        if len(members) > 1 and set(members) <= set(states):
            return [name, *_state_lines(region, [s for s in states if s not in members])]
    return states


def _actions(region: Region, state: str) -> tuple[str, ...]:
    """Return the lines of UML's compartment of internal activities, with rates for ``do /``."""
    nesting = region.nesting

    def updates(word: str, blocks: Mapping[str, Mapping[str, str | int | float]]) -> Iterator[str]:
        if block := blocks.get(state):
            yield f"{word} / " + ", ".join(f"{name} := {text}" for name, text in block.items())

    rates = (f"{name}' = {text}" for name, text in nesting.flows.get(state, {}).items())
    return (*updates("entry", nesting.entries), *updates("exit", nesting.exits), *rates)


def _conditions(automaton: Automaton, region: Region, state: str) -> tuple[str, ...]:
    """Return what holds while a state is active; of one without direction, what holds in both."""
    if automaton.laws is None or region.nesting.edges or region.nesting.configurations:
        return ()
    inner = [leaf for leaf, outer in region.superstates.items() if outer == state] or [state]
    found = [_condition(automaton, region, leaf) for leaf in inner]
    return tuple(words for words in found[0] if all(words in others for others in found))


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
