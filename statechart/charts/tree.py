"""State tree of a region, with checked sources and targets of transitions.

Terms of SCXML (W3C Recommendation of 1 September 2015): a state without states is atomic, one with
states is compound, one with regions is parallel; its regions are compound states. Nodes are
numbered in document order, outer before inner.
"""

from __future__ import annotations

import enum
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from statechart.charts import transitions
from statechart.errors import DeclarationProblem, Loc, close_matches


class Sort(enum.Enum):
    """Kinds of nodes of the tree."""

    ATOMIC = enum.auto()
    COMPOUND = enum.auto()
    PARALLEL = enum.auto()
    SHALLOW = enum.auto()
    DEEP = enum.auto()


HISTORIES = (Sort.SHALLOW, Sort.DEEP)

ROOT = 0
"""The region itself."""


@dataclass(frozen=True, eq=False)
class Node:
    """A state, a region in a state, or a history."""

    name: str  # unique in the region; "" for the region itself
    sort: Sort
    parent: int  # -1 for the region itself
    children: tuple[int, ...]  # without histories
    histories: tuple[int, ...]
    initial: int  # default entry, also of an empty history; -1 where all regions are entered
    declared: transitions.Holder

    @property
    def final(self) -> bool:
        """True if entering it completes its parent."""
        return isinstance(self.declared, transitions.BaseState) and self.declared.final


@dataclass(frozen=True, eq=False)
class Arrow:
    """A transition between nodes; `target` is -1 if it exits no state."""

    declared: transitions.Transition
    source: int
    target: int


@dataclass(frozen=True, eq=False)
class Tree:
    """The states of a region and the transitions between them."""

    nodes: tuple[Node, ...]  # in document order
    arrows: tuple[Arrow, ...]  # inner states before outer ones

    @cached_property
    def flat(self) -> bool:
        """True if no state has substates."""
        return all(node.parent <= ROOT for node in self.nodes)

    @cached_property
    def above(self) -> tuple[tuple[int, ...], ...]:
        """The ancestors of every node, parent first."""
        paths: list[tuple[int, ...]] = []
        for node in self.nodes:
            paths.append((node.parent, *paths[node.parent]) if node.parent >= 0 else ())
        return tuple(paths)

    def holds(self, outer: int, inner: int) -> bool:
        """Return whether `inner` is a proper descendant of `outer`."""
        return outer in self.above[inner]

    def common(self, one: int, other: int) -> int:
        """Return the lowest common ancestor of two nodes, which may be one of them."""
        path = (one, *self.above[one])
        return next(node for node in (other, *self.above[other]) if node in path)

    def remembered_first(self, history: int) -> frozenset[int]:
        """Return the default entry of a history."""
        node = self.nodes[history]
        return frozenset((node.initial,) if node.initial >= 0 else self.nodes[node.parent].children)

    def done(self, active: Collection[int]) -> tuple[int, ...]:
        """Return the nodes that are done in a configuration, inner nodes first."""
        found: list[int] = []
        for index in self.inner_first:
            node = self.nodes[index]
            if index not in active and index != ROOT:
                continue
            if (
                node.children and all(child in found for child in node.children)
                if node.sort is Sort.PARALLEL
                else any(child in active and self.nodes[child].final for child in node.children)
            ):
                found.append(index)
        return tuple(found)

    @cached_property
    def inner_first(self) -> tuple[int, ...]:
        """The nodes in postorder."""
        last = list(range(len(self.nodes)))
        for index in reversed(range(1, len(self.nodes))):
            parent = self.nodes[index].parent
            last[parent] = max(last[parent], last[index])
        return tuple(sorted(range(len(self.nodes)), key=lambda node: (last[node], -node)))

    def are_orthogonal(self, one: int, other: int) -> bool:
        """Return whether two nodes are in different regions of one state."""
        meet = self.common(one, other)
        return meet not in (one, other) and self.nodes[meet].sort is Sort.PARALLEL


def tree(region: transitions.BaseRegion, *loc: str | int) -> Tree:
    """Return the tree of a declared region; raise `DeclarationProblem` if it is inconsistent."""
    entries: list[tuple[str, transitions.Holder, Loc]] = [
        ("", region, loc),
        *transitions.nested(region, *loc),
    ]
    places: dict[str, int] = {}
    for index, (name, holder, at) in enumerate(entries):
        if name in places:
            message = f"a second state {name!r} of the region"
            advice = "names of states are unique in a region; choose another"
            raise DeclarationProblem(message, advice=advice, key=at)
        places[name] = index
        if isinstance(holder, transitions.BaseState):
            _check_state(name, holder, at)
    by_place = {at: index for index, (_, _, at) in enumerate(entries)}
    parents = [-1 if at == loc else by_place[at[:-2]] for _, _, at in entries]
    sorts = [_sort(holder) for _, holder, _ in entries]
    members: list[list[int]] = [[] for _ in entries]
    for index, parent in enumerate(parents[1:], 1):
        members[parent].append(index)
    nodes = []
    for index, (name, holder, at) in enumerate(entries):
        if sorts[index] in HISTORIES and parents[index] == ROOT:
            message = f"the history {name!r} is not inside a state that has states"
            advice = "put it among the states of that state, or of a region in a state"
            raise DeclarationProblem(message, advice=advice, loc=(*at, "history"))
        states = tuple(i for i in members[index] if sorts[i] not in HISTORIES)
        histories = tuple(i for i in members[index] if sorts[i] in HISTORIES)
        nodes.append(Node(name, sorts[index], parents[index], states, histories, -1, holder))
    unnamed = Tree(tuple(nodes), ())
    nodes = [_with_initial(unnamed, index, places, at) for index, (_, _, at) in enumerate(entries)]
    bare = Tree(tuple(nodes), ())
    written = list(transitions.declared_transitions(region, *loc))
    arrows = [_arrow(bare, places, *found, by_place) for found in written]
    _check_distinct(arrows, [at for _, at in written])
    return Tree(tuple(nodes), tuple(arrows))


def _sort(holder: transitions.Holder) -> Sort:
    if isinstance(holder, transitions.BaseState):
        if holder.history is not None:
            return Sort.SHALLOW if holder.history == "shallow" else Sort.DEEP
        if holder.regions:
            return Sort.PARALLEL
        if not holder.states:
            return Sort.ATOMIC
    return Sort.COMPOUND


def _check_none(keys: Sequence[str], at: Loc, reason: str, advice: str) -> None:
    if keys:
        message = f"{reason}: it has no {keys[0]!r}"
        raise DeclarationProblem(message, advice=advice, key=(*at, keys[0]))


def _check_state(name: str, state: transitions.BaseState, at: Loc) -> None:
    """Check the keys of a state that describe its substates."""
    if state.history is not None:
        _check_none(
            sorted(state.model_fields_set - {"history", "initial"}), at,
            f"the history {name!r} is only a target of transitions, and no state",
            "write nothing but history, and initial: the state to enter the first time",
        )  # fmt: skip
        return
    if state.final:
        keys = ("initial", "regions", "states", "transitions")
        _check_none(
            [key for key in keys if getattr(state, key)], at,
            f"{name!r} is final, and holds no states",
            "leave final out, or give it a final state among others",
        )  # fmt: skip
        return
    if state.regions and any(inner.history is None for inner in state.states.values()):
        message = f"{name!r} has states and regions"
        advice = "put the states into a region of their own; only histories stand beside regions"
        raise DeclarationProblem(message, advice=advice, key=(*at, "regions"))
    if state.states and not state.regions and state.initial is None:
        advice = f"write initial: {next(iter(state.states))}"
        raise DeclarationProblem(f"{name!r} has states, and no initial one", advice=advice, key=at)
    if (state.regions or not state.states) and state.initial is not None:
        message = f"{name!r} has `initial`, but no `states` of its own"
        advice = "write it in its regions" if state.regions else "add states, or remove it"
        raise DeclarationProblem(message, advice=advice, key=(*at, "initial"))


def _with_initial(bare: Tree, index: int, places: Mapping[str, int], at: Loc) -> Node:
    node = bare.nodes[index]
    if node.sort in (Sort.ATOMIC, Sort.PARALLEL):
        return node
    holder = node.parent if node.sort in HISTORIES else index
    initial = node.declared.initial
    if initial is None and bare.nodes[holder].sort is Sort.PARALLEL:
        return node
    if initial is None:
        found = places[str(bare.nodes[holder].declared.initial)]
    else:
        inside = [n.name for i, n in enumerate(bare.nodes) if bare.holds(holder, i)]
        if initial not in inside:
            where = f" in {bare.nodes[holder].name!r}" if holder != ROOT else ""
            message = f"no state {initial!r}{where}"
            advice = close_matches(initial, inside)
            raise DeclarationProblem(message, advice=advice, loc=(*at, "initial"))
        found = places[initial]
        if bare.nodes[found].sort in HISTORIES:
            message = f"{initial!r} is a history, which cannot be initial"
            raise DeclarationProblem(message, advice="write a state", loc=(*at, "initial"))
    return replace(node, initial=found)


def _arrow(
    bare: Tree,
    places: Mapping[str, int],
    declared: transitions.Transition,
    at: Loc,
    by_place: Mapping[Loc, int],
) -> Arrow:
    scope = by_place[at[:-2]]
    states = [name for name in places if name]
    for name, key in ((declared.source, "from"), (declared.target, "to")):
        if name is not None and name not in states:
            several = key == "from" and not name.isidentifier()
            advice = transitions.SEVERAL_SOURCES if several else close_matches(name, states)
            raise DeclarationProblem(f"no state {name!r}", advice=advice, loc=(*at, key))
    source = places[declared.source]
    if bare.nodes[source].sort in HISTORIES:
        message = f"{declared.source!r} is a history, which nothing leaves"
        advice = "let it leave the state that holds it"
        raise DeclarationProblem(message, advice=advice, loc=(*at, "from"))
    if bare.nodes[source].final:
        message = f"{declared.source!r} is final, and nothing leaves it"
        advice = "let it leave the state that holds it, with on: STATE.done"
        raise DeclarationProblem(message, advice=advice, loc=(*at, "from"))
    if scope not in (source, *bare.above[source]):
        message = f"{declared.source!r} is not in {bare.nodes[scope].name!r}"
        advice = "declare a transition where its source is, or further out"
        raise DeclarationProblem(message, advice=advice, loc=(*at, "from"))
    target = -1 if declared.target is None else places[declared.target]
    inside = target >= 0 and bare.holds(source, target)
    if declared.internal and not (inside and bare.nodes[source].sort is Sort.COMPOUND):
        raise DeclarationProblem(
            f"{declared.name!r} is internal, and leads to no state in {declared.source!r}",
            advice="write from: a state with states, and to: one of these; without `to` nothing is "
            "left, either",
            key=(*at, "internal"),
        )
    if target < 0:
        return Arrow(declared, source, -1)
    if bare.are_orthogonal(source, target):
        meet = bare.common(source, target)
        raise DeclarationProblem(
            f"{declared.source!r} and {declared.target!r} are in regions of "
            f"{bare.nodes[meet].name!r}, which are active side by side",
            advice=f"leave it as a whole with from: {bare.nodes[meet].name}, or give each region "
            "a transition of its own",
            loc=(*at, "to"),
        )
    return Arrow(declared, source, target)


def _check_distinct(arrows: list[Arrow], locs: list[Loc]) -> None:
    """Check that transitions are distinct, and that no earlier one shadows another."""
    named: set[tuple[str, int, int]] = set()
    timed: set[str] = set()
    firing: dict[tuple[int, str, str | None], str] = {}
    for arrow, at in zip(arrows, locs, strict=True):
        declared = arrow.declared
        key = (declared.name, arrow.source, arrow.target)
        if key in named:
            message = (
                f"a second transition {declared.name!r} from {declared.source!r} "
                f"to {declared.target!r}"
            )
            raise DeclarationProblem(message, advice="give it another name", loc=(*at, "name"))
        named.add(key)
        if declared.period is not None:
            if declared.name in timed:
                message = f"a second transition {declared.name!r} that waits for a time"
                advice = "give it another name: each has a clock of its name"
                raise DeclarationProblem(message, advice=advice, loc=(*at, "name"))
            timed.add(declared.name)
        words = [f"on {e.region}.{e.cause}" for e in declared.events] or [declared.trigger]
        # An unguarded transition on an event shadows every later one on it.
        guard = declared.guard if declared.events else None
        first = [
            firing.get((arrow.source, word, None)) or firing.get((arrow.source, word, guard))
            for word in words
        ]
        if all(first):
            raise DeclarationProblem(
                f"{declared.name!r} never fires: {first[0]!r}, declared before it, is "
                f"taken from {declared.source!r} whenever it could be ({declared.trigger})",
                advice="let guards or events of the two differ, or leave one out",
                loc=(*at, "name"),
            )
        keys = ((arrow.source, word, guard) for word in words)
        firing = dict.fromkeys(keys, declared.name) | firing
