"""Exit and entry sets of transitions of nested states: the algorithm of SCXML, appendix D.

Of the transitions that are enabled every innermost state takes the first one of its own, or else
of what holds it; of two that would leave the same states the inner one is taken, or else the one
of the state that comes first in the document. What is taken leaves its source and all up to the
innermost compound state that holds source and target, inner states first, and enters the states
on the way to its target, outer states first. An internal transition leaves what is in its source.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

from statechart.charts.tree import HISTORIES, ROOT, Sort, Tree

Nodes = frozenset[int]
Memory = Mapping[int, Nodes]
"""History -> what was active of its parent when that was last left."""


class Microstep(NamedTuple):
    """The exits and entries of transitions that are taken together."""

    taken: tuple[int, ...]  # places of the arrows, in the order of their updates
    exits: tuple[int, ...]  # nodes, in the order in which they are left and entered
    entries: tuple[int, ...]
    active: Nodes  # what is active then
    memory: Memory  # what is remembered then


def beginning(tree: Tree) -> Microstep:
    """Return the entering of a region."""
    found: set[int] = set()
    _descend(tree, tree.nodes[ROOT].initial, found, {})
    _ascend(tree, tree.nodes[ROOT].initial, ROOT, found, {})
    entries = tuple(sorted(found))
    return Microstep((), (), entries, frozenset(found), {})


def leaves(tree: Tree, active: Collection[int]) -> list[int]:
    """Return the atomic states of a configuration, in document order."""
    return [node for node in sorted(active) if tree.nodes[node].sort is Sort.ATOMIC]


def selected(
    tree: Tree, active: Nodes, memory: Memory, enabled: Collection[int]
) -> tuple[int, ...]:
    """Return which of the enabled arrows are taken together, in order."""
    chosen: dict[int, None] = {}
    by_source: dict[int, list[int]] = {}
    for place in sorted(enabled):
        by_source.setdefault(tree.arrows[place].source, []).append(place)
    for leaf in leaves(tree, active):
        holders = (leaf, *tree.above[leaf])
        first = next((by_source[node][0] for node in holders if node in by_source), None)
        if first is not None:
            chosen[first] = None
    kept: list[int] = []
    for one in chosen:
        mine = _exit_set(tree, active, memory, one)
        rivals = [other for other in kept if mine & _exit_set(tree, active, memory, other)]
        source = tree.arrows[one].source
        if all(tree.holds(tree.arrows[other].source, source) for other in rivals):
            kept = [other for other in kept if other not in rivals] + [one]
    return tuple(kept)


def microstep(tree: Tree, active: Nodes, memory: Memory, taken: Iterable[int]) -> Microstep:
    """Return what taking some arrows together does."""
    taken = tuple(taken)
    left = frozenset[int]().union(*(_exit_set(tree, active, memory, place) for place in taken))
    kept = dict(memory)
    for node in left:
        for history in tree.nodes[node].histories:
            if tree.nodes[history].sort is Sort.DEEP:
                kept[history] = frozenset(n for n in leaves(tree, active) if tree.holds(node, n))
            else:
                kept[history] = frozenset(n for n in active if tree.nodes[n].parent == node)
    entered: set[int] = set()
    for place in taken:
        arrow = tree.arrows[place]
        if arrow.target >= 0:
            # Histories are looked up before the exits (domain) and after them (entries).
            domain = _domain(tree, memory, place)
            _descend(tree, arrow.target, entered, kept)
            for target in _effective_targets(tree, kept, arrow.target):
                _ascend(tree, target, domain, entered, kept)
    return Microstep(
        taken,
        tuple(sorted(left, reverse=True)),
        tuple(sorted(entered)),
        (active - left) | entered,
        kept,
    )


def _exit_set(tree: Tree, active: Nodes, memory: Memory, place: int) -> Nodes:
    """Return the exit set of an arrow."""
    if tree.arrows[place].target < 0:
        return frozenset()
    domain = _domain(tree, memory, place)
    return frozenset(node for node in active if tree.holds(domain, node))


def _domain(tree: Tree, memory: Memory, place: int) -> int:
    """Return the innermost compound state that holds source and targets of an arrow."""
    arrow = tree.arrows[place]
    if arrow.declared.internal:
        return arrow.source
    ends = _effective_targets(tree, memory, arrow.target)
    return next(
        node
        for node in tree.above[arrow.source]
        if tree.nodes[node].sort is Sort.COMPOUND and all(tree.holds(node, end) for end in ends)
    )


def _effective_targets(tree: Tree, memory: Memory, target: int) -> Nodes:
    """Return what a target stands for: of a history, what is remembered."""
    node = tree.nodes[target]
    if node.sort not in HISTORIES:
        return frozenset((target,))
    return memory.get(target, tree.remembered_first(target))


def _descend(tree: Tree, state: int, found: set[int], memory: Memory) -> None:
    """Add a state and what is entered in it; of a history, what it stands for."""
    node = tree.nodes[state]
    if node.sort in HISTORIES:
        remembered = sorted(_effective_targets(tree, memory, state))
        for each in remembered:
            _descend(tree, each, found, memory)
        for each in remembered:
            _ascend(tree, each, node.parent, found, memory)
        return
    found.add(state)
    if node.sort is Sort.COMPOUND:
        _descend(tree, node.initial, found, memory)
        _ascend(tree, node.initial, state, found, memory)
    elif node.sort is Sort.PARALLEL:
        _enter_regions(tree, state, found, memory)


def _ascend(tree: Tree, state: int, outer: int, found: set[int], memory: Memory) -> None:
    """Add what holds a state, up to `outer`, with the regions beside it."""
    for node in tree.above[state]:
        if node == outer:
            return
        found.add(node)
        if tree.nodes[node].sort is Sort.PARALLEL:
            _enter_regions(tree, node, found, memory)


def _enter_regions(tree: Tree, parallel: int, found: set[int], memory: Memory) -> None:
    for child in tree.nodes[parallel].children:
        if not any(tree.holds(child, node) for node in found):
            _descend(tree, child, found, memory)
