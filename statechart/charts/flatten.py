"""Flattening of a hierarchical region into its reachable configurations.

The executor runs flat regions: one active state, and the transitions out of it. A configuration is
a set of active states with the contents of the histories of inactive ones. Its name joins its
atomic states by ``|``; contents of a history that differ from its default entry follow in brackets:
``rest[memory=left]``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, product
from math import prod
from typing import Literal, NamedTuple

from statechart.automaton.regions import (
    DONE,
    Choice,
    Edge,
    HierarchicalEdge,
    History,
    Nesting,
    updates_text,
)
from statechart.charts.transitions import BaseRegion, BaseState, Transition
from statechart.charts.tree import HISTORIES, ROOT, Sort, Tree, tree
from statechart.documents.declaration import TIME
from statechart.documents.fields import FiniteText
from statechart.documents.outputs import Event
from statechart.documents.quantities import Dimension
from statechart.errors import DeclarationProblem
from statechart.formulas.relation import conjunction

MAX_CONFIGURATIONS = 4096
"""Limit of configurations: orthogonal regions multiply."""


def flatten(name: str, region: BaseRegion, *loc: str | int) -> FlatRegion:
    """Flatten a declared region into at most `MAX_CONFIGURATIONS`; see `tree`."""
    return FlatRegion(name, tree(region, *loc), loc)


class FlatRegion:
    """A flattened region: configurations and the transitions between them.

    `initial` is the initial configuration, with the entry updates `begins`. `states` maps
    configurations to their active states, outer first, and `triggers` to the arrows out of them, by
    priority: inner states first, then in document order. Combined `transitions` are the last ones.
    `clocks` are the entry times of the sources of timed transitions, `counts` the periods passed
    since. `superstates` and `nesting` are as of a `statechart.automaton.regions.Region`.
    """

    def __init__(self, name: str, found: Tree, loc: tuple[str | int, ...]) -> None:
        self.name, self._tree, self._loc = name, found, loc
        self._named: dict[str, tuple[Nodes, Histories]] = {}
        self._taken: dict[tuple[str, tuple[int, ...]], FlatTransition] = {}
        self._clocks = {
            place: f"{name}.{arrow.declared.name}_clock"
            for place, arrow in enumerate(found.arrows)
            if arrow.declared.period is not None
        }
        self._counts = {
            place: f"{name}.{arrow.declared.name}_count"
            for place, arrow in ((place, found.arrows[place]) for place in self._clocks)
            if arrow.declared.every is not None or arrow.declared.internal or arrow.target < 0
        }
        self.clocks, self.counts = tuple(self._clocks.values()), tuple(self._counts.values())
        rank, places = found.inner_first.index, range(len(found.arrows))
        self._ranks = sorted(places, key=lambda place: (rank(found.arrows[place].source), place))
        # While its parent is active, only transitions that do not exit it can read a history.
        begin, nodes, self._remembered = initial_entry(found), found.nodes, set[int]()
        for arrow in found.arrows:
            if arrow.target >= 0 and nodes[arrow.target].sort in HISTORIES:
                parent, source = nodes[arrow.target].parent, arrow.source
                if found.holds(parent, source) or (arrow.declared.internal and source == parent):
                    self._remembered.add(arrow.target)
        self.initial = self._name_of(begin.active, {})
        self.begins = tuple(filter(None, (self._entry_updates(node) for node in begin.entries)))
        self.transitions = self._transitions()
        self.states = {name: self._contents(active) for name, (active, _) in self._named.items()}
        self.triggers = {name: self._triggers(active) for name, (active, _) in self._named.items()}
        self.superstates = {
            node.name: nodes[node.parent].name
            for node in nodes
            if node.parent > ROOT and node.sort not in HISTORIES
        }
        self.nesting = self._nesting()

    @property
    def timers(self) -> tuple[str, ...]:
        """The clocks, then the counts."""
        return (*self.clocks, *self.counts)

    @property
    def ordered(self) -> tuple[str, ...]:
        """The configurations, the initial one first."""
        return tuple(self.states)

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The transitions as labelled edges."""
        return tuple(
            Edge(t.name, t.source, t.target, t.trigger, t.reset(), on_zeno=t.on_zeno)
            for t in self.transitions
        )

    def flows(self, state: str) -> dict[str, FiniteText]:
        """Return the flows of a configuration; inner states override outer ones."""
        return dict(flow for content in self.states[state] for flow in content.flows.items())

    def active(self, state: str) -> tuple[str, ...]:
        """Return the states of a configuration and their ancestors."""
        return self.nesting.active(state, self.superstates)

    @cached_property
    def named(self) -> tuple[str, ...]:
        """The names of all states and superstates, which outputs and events may use."""
        return tuple(n.name for n in self._tree.nodes[1:] if n.sort not in HISTORIES)

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """The names of the declared transitions."""
        return tuple(dict.fromkeys(arrow.declared.name for arrow in self._tree.arrows))

    @cached_property
    def awaited(self) -> frozenset[str]:
        """The causes of the events that its transitions wait for."""
        events = (event for arrow in self._tree.arrows for event in arrow.declared.events)
        return frozenset(event.cause for event in events)

    @cached_property
    def done(self) -> tuple[str, ...]:
        """The states that can raise `done`, and the region itself if it can."""
        return tuple(dict.fromkeys(chain.from_iterable(self.nesting.done.values())))

    def shared(self, part: str) -> tuple[str, str, str] | None:
        """Return the first variable that two orthogonal states set in `part`, and the states."""
        owners: dict[str, list[int]] = {}
        for index, node in enumerate(self._tree.nodes):
            if not isinstance(node.declared, BaseState):
                continue
            for what in getattr(node.declared, part, ()):
                for other in owners.setdefault(what, []):
                    if self._tree.are_orthogonal(index, other):
                        return what, self._tree.nodes[other].name, node.name
                owners[what].append(index)
        return None

    def answer(self, state: str, enabled: Collection[int]) -> FlatTransition:
        """Return the transition that enabled arrows take together (`select_transitions`)."""
        return self._take(state, select_transitions(self._tree, *self._named[state], enabled))

    def _transitions(self) -> tuple[FlatTransition, ...]:
        """Enumerate the configurations breadth first, and the transitions between them."""
        if self._tree.flat:
            for node in self._tree.nodes[ROOT].children:
                self._name_of(frozenset((node,)), {})
        done: set[str] = set()
        while todo := [name for name in self._named if name not in done]:
            for name in todo:
                done.add(name)
                for taken in self._arrow_sets(*self._named[name]):
                    self._take(name, taken)
        keys = list(self._taken)
        if self._tree.flat:
            # Without hierarchy the order of declaration alone decides.
            keys.sort(key=lambda key: key[1])
        return tuple(self._taken[key] for key in keys)

    def _take(self, name: str, taken: tuple[int, ...]) -> FlatTransition:
        """Return the flat transition that takes arrows together out of a configuration."""
        if (name, taken) not in self._taken:
            step = microstep(self._tree, *self._named[name], taken)
            target = self._name_of(step.active, step.histories)
            self._taken[name, taken] = self._transition(name, target, step)
        return self._taken[name, taken]

    def _triggers(self, active: Nodes) -> tuple[Trigger, ...]:
        ranked = ((place, self._tree.arrows[place]) for place in self._ranks)
        out = ((place, arrow.declared) for place, arrow in ranked if arrow.source in active)
        return tuple(Trigger(place, one, one.events, self._guard(place)) for place, one in out)

    def _contents(self, active: Nodes) -> tuple[BaseState, ...]:
        holders = (self._tree.nodes[node].declared for node in sorted(active))
        return tuple(holder for holder in holders if isinstance(holder, BaseState))

    def _arrow_sets(self, active: Nodes, histories: Histories) -> Iterable[tuple[int, ...]]:
        """Yield the sets of arrows that may be taken together, single arrows first."""
        arrows = self._tree.arrows
        out = [i for i in self._ranks if arrows[i].source in active]
        yield from ((i,) for i in out)
        # The first enabled arrow of each atomic state decides the set.
        choices = [
            [(), *((i,) for i in out if arrows[i].declared.events and arrows[i].source in holders)]
            for leaf in atomic_states(self._tree, active)
            if (holders := {leaf, *self._tree.above[leaf]})
        ]
        if prod(map(len, choices)) > MAX_CONFIGURATIONS:
            raise self._too_many("sets of transitions that one event may fire together")
        together = (
            select_transitions(self._tree, active, histories, set(chain.from_iterable(one)))
            for one in product(*choices)
        )
        yield from dict.fromkeys(taken for taken in together if len(taken) > 1)

    def _transition(self, source: str, target: str, step: Microstep) -> FlatTransition:
        nodes, members = self._tree.nodes, [self._tree.arrows[k].declared for k in step.taken]
        blocks: list[Updates] = [getattr(nodes[n].declared, "exit", {}) for n in step.exits]
        for place, member in zip(step.taken, members, strict=True):
            count = self._counts.get(place)
            counted: Updates = {} if count is None else {count: f"{count} + 1"}
            blocks.append({**member.updates, **counted})
        blocks += [self._entry_updates(node) for node in step.entries]
        name, guard = "+".join(member.name for member in members), self._guard(step.taken[0])
        updates = tuple(filter(None, blocks))
        return FlatTransition(name, source, target, tuple(members), guard, updates)

    def _guard(self, place: int) -> str | None:
        """Return the relation that fires an arrow; None where an event does."""
        declared = self._tree.arrows[place].declared
        if declared.on is not None:
            return None
        clock, count = self._clocks.get(place), self._counts.get(place)
        if clock is None:
            return declared.guard
        if declared.every is not None:
            # A multiple of the period, since a sum of periods accumulates round-off.
            return f"{TIME} >= {clock} + ({count} + 1)*({declared.period})"
        over = f"{TIME} >= {clock} + ({declared.period})"
        if count is not None:
            # It fires once per entry of the source: the count is zero before and one after.
            over = f"(1 - {count})*({TIME} - {clock} - ({declared.period})) >= {count}"
        return conjunction((over,) if declared.guard is None else (over, declared.guard))

    @cached_property
    def restarts(self) -> tuple[Updates, Updates, Updates]:
        """Periods of `every`, by clock and count; timers restarted at the last tick; due timers."""
        timed = [
            (self._clocks[place], count, f"({period})")
            for place, count in self._counts.items()
            if (period := self._tree.arrows[place].declared.every) is not None
        ]
        counts = {count: 0 for _, count, _ in timed}
        return (
            {timer: period for clock, count, period in timed for timer in (clock, count)},
            {clock: f"{clock} + {count}*{period}" for clock, count, period in timed} | counts,
            {clock: f"{TIME} - {period}" for clock, _, period in timed} | counts,
        )

    def _entry_updates(self, node: int) -> Updates:
        began: dict[str, FiniteText] = {}
        for place, clock in self._clocks.items():
            if self._tree.arrows[place].source == node:
                began[clock] = TIME
                if place in self._counts:
                    began[self._counts[place]] = 0
        return {**getattr(self._tree.nodes[node].declared, "entry", {}), **began}

    def _name_of(self, active: Nodes, histories: Histories) -> str:
        """Register a configuration under its name, and return that."""
        found = self._tree
        shown = {
            history: remembered
            for history, remembered in sorted(histories.items())
            if (found.nodes[history].parent not in active or history in self._remembered)
            and remembered != self._default(history)
        }
        words = ", ".join(f"{found.nodes[h].name}={self._joined(r)}" for h, r in shown.items())
        name = self._joined(atomic_states(found, active)) + (f"[{words}]" if words else "")
        self._named.setdefault(name, (active, shown))
        if len(self._named) > MAX_CONFIGURATIONS:
            raise self._too_many("configurations")
        return name

    def _default(self, history: int) -> Nodes:
        """Return the contents of a history before its parent was ever exited."""
        nodes, first = self._tree.nodes, self._tree.remembered_first(history)
        deep = nodes[history].sort is Sort.DEEP
        return first if all(nodes[n].sort is Sort.ATOMIC or not deep for n in first) else Nodes()

    def _joined(self, nodes: Iterable[int]) -> str:
        return "|".join(self._tree.nodes[node].name for node in sorted(nodes))

    def _nesting(self) -> Nesting:
        nodes = self._tree.nodes
        states = {n.name: n.declared for n in nodes if isinstance(n.declared, BaseState)}
        names = tuple(n.name for n in nodes[1:] if n.sort not in HISTORIES)
        unreached = frozenset(names) - self._entered_names()
        entries = {name: state.entry for name, state in states.items() if state.entry}
        exits = {name: state.exit for name, state in states.items() if state.exit}
        # Only states of charts and of controllers have flows.
        flows = {name: found for name, s in states.items() if (found := getattr(s, "flows", {}))}
        final = frozenset(n.name for n in nodes if n.final)
        ended = {name: self._tree.done(active) for name, (active, _) in self._named.items()}
        done = {
            n: tuple(nodes[k].name or self.name for k in own) for n, own in ended.items() if own
        }
        flat = Nesting(
            names, entries=entries, exits=exits, edges=tuple(self._hierarchical_edges()),
            unreached=unreached, flows=flows, final=final, done=done,
        )  # fmt: skip
        if self._tree.flat:
            return flat
        atomic = {n: atomic_states(self._tree, active) for n, (active, _) in self._named.items()}
        histories = {}
        for node in (n for n in nodes if n.sort in HISTORIES):
            depth: Literal["deep", "shallow"] = "deep" if node.sort is Sort.DEEP else "shallow"
            initial = nodes[node.initial if node.initial >= 0 else node.parent].name
            histories[node.name] = History(depth, nodes[node.parent].name, initial)
        return replace(
            flat,
            configurations={n: tuple(nodes[k].name for k in own) for n, own in atomic.items()},
            initial={n.name: nodes[n.initial].name for n in nodes if n.sort is Sort.COMPOUND},
            parallel=frozenset(n.name for n in nodes if n.sort is Sort.PARALLEL),
            histories=histories,
        )

    def _entered_names(self) -> set[str]:
        """Return the names of the states reachable by transitions."""
        targets: dict[str, list[str]] = {}
        for transition in self.transitions:
            targets.setdefault(transition.source, []).append(transition.target)
        found = [self.initial]
        for configuration in found:
            found += (t for t in dict.fromkeys(targets.get(configuration, ())) if t not in found)
        nodes = self._tree.nodes
        return {nodes[node].name for name in found for node in self._named[name][0]}

    def _hierarchical_edges(self) -> Iterable[HierarchicalEdge]:
        for arrow in self._tree.arrows:
            declared = arrow.declared
            target = declared.target or declared.source
            reset = ", ".join(f"{name} := {update}" for name, update in declared.updates.items())
            ends = declared.name, declared.source, target, declared.trigger
            events = (".".join(filter(None, (e.region, e.cause))) for e in declared.events)
            guard, static = declared.guard if declared.events else None, declared.target is None
            yield HierarchicalEdge(
                *ends, (Choice(target, reset),), declared.on_zeno, declared.updates,
                tuple(events), guard, static, declared.internal or static,
            )  # fmt: skip

    def _too_many(self, what: str) -> DeclarationProblem:
        message = f"more than {MAX_CONFIGURATIONS} {what} of {self.name!r}"
        advice = "make regions of a state regions of the model: these are not multiplied"
        return DeclarationProblem(message, advice=advice, key=self._loc)


Updates = Mapping[str, FiniteText]


@dataclass(frozen=True, eq=False)
class FlatTransition:
    """Transitions taken together, from one configuration to another."""

    name: str  # names of the members, joined by ``+``
    source: str  # configurations
    target: str
    members: tuple[Transition, ...]  # in the order of their updates
    guard: str | None  # relation that fires it, for timed transitions too
    # Updates in order: exits, transitions, entries. A block reads the values after the block
    # before it.
    blocks: tuple[Updates, ...]

    @property
    def on_zeno(self) -> bool:
        """True if the accumulation of jumps fires it."""
        return self.members[0].on_zeno

    @property
    def trigger(self) -> str:
        """The trigger as text."""
        return " and ".join(dict.fromkeys(member.trigger for member in self.members))

    def reset(self) -> str:
        """Return the updates of declared variables as text."""
        return ", ".join(filter(None, map(updates_text, self.blocks)))


class Trigger(NamedTuple):
    """An arrow out of a configuration with its events or guard."""

    place: int  # among the arrows of the region
    declared: Transition
    events: tuple[Event, ...]
    guard: str | None  # relation that fires it; None where events do


def causes_of(regions: Mapping[str, FlatRegion]) -> dict[str, tuple[str, ...]]:
    """Return the events that regions raise, by owner: names of transitions, and `done`."""
    found = {name: region.causes for name, region in regions.items()}
    for owner in chain.from_iterable(region.done for region in regions.values()):
        found[owner] = (*found.get(owner, ()), DONE)
    return found


def timer_dimension(regions: Iterable[FlatRegion], name: str) -> Dimension:
    """Return the dimension of a clock or counter; empty for another variable."""
    for region in regions:
        if name in region.timers:
            return "time" if name in region.clocks else "1"
    return ""


Nodes = frozenset[int]
Histories = Mapping[int, Nodes]
"""History -> the active descendants of its parent when that was last exited."""


class Microstep(NamedTuple):
    """Exits and entries of transitions taken together."""

    taken: tuple[int, ...]  # places of the arrows, in the order of their updates
    exits: tuple[int, ...]  # nodes in order of exit
    entries: tuple[int, ...]  # nodes in order of entry
    active: Nodes  # configuration afterwards
    histories: Histories  # contents of the histories afterwards


def initial_entry(tree: Tree) -> Microstep:
    """Return the entry into the initial configuration."""
    entered: set[int] = set()
    _add_descendants(tree, tree.nodes[ROOT].initial, entered, {})
    _add_ancestors(tree, tree.nodes[ROOT].initial, ROOT, entered, {})
    return Microstep((), (), tuple(sorted(entered)), frozenset(entered), {})


def atomic_states(tree: Tree, active: Collection[int]) -> list[int]:
    """Return the atomic states of a configuration, in document order."""
    return [node for node in sorted(active) if tree.nodes[node].sort is Sort.ATOMIC]


def select_transitions(
    tree: Tree, active: Nodes, histories: Histories, enabled: Collection[int]
) -> tuple[int, ...]:
    """Return the optimal transition set (SCXML, `removeConflictingTransitions`).

    Every atomic state takes the first arrow of its own, or else of its innermost ancestor with one.
    Of two arrows with intersecting exit sets the inner one is taken, or else that of the state
    first in document order.
    """
    chosen: dict[int, None] = {}
    by_source: dict[int, list[int]] = {}
    for place in sorted(enabled):
        by_source.setdefault(tree.arrows[place].source, []).append(place)
    for leaf in atomic_states(tree, active):
        holders = (leaf, *tree.above[leaf])
        first = next((by_source[node][0] for node in holders if node in by_source), None)
        if first is not None:
            chosen[first] = None
    filtered: list[int] = []
    for one in chosen:
        exits = _exit_set(tree, active, histories, one)
        rivals = [other for other in filtered if exits & _exit_set(tree, active, histories, other)]
        source = tree.arrows[one].source
        if all(tree.holds(tree.arrows[other].source, source) for other in rivals):
            filtered = [other for other in filtered if other not in rivals] + [one]
    return tuple(filtered)


def microstep(tree: Tree, active: Nodes, histories: Histories, taken: Iterable[int]) -> Microstep:
    """Return the microstep of arrows taken together (SCXML, appendix D).

    An arrow exits its source and ancestors below the innermost compound state that contains source
    and target, inner states first, and enters the states on the way to its target, outer states
    first. An internal arrow exits the states inside its source.
    """
    taken = tuple(taken)
    exited = frozenset[int]().union(*(_exit_set(tree, active, histories, place) for place in taken))
    updated = dict(histories)
    for node in exited:
        for history in tree.nodes[node].histories:
            deep = tree.nodes[history].sort is Sort.DEEP
            updated[history] = frozenset(
                n
                for n in (atomic_states(tree, active) if deep else active)
                if (tree.holds(node, n) if deep else tree.nodes[n].parent == node)
            )
    entered: set[int] = set()
    for place in taken:
        arrow = tree.arrows[place]
        if arrow.target >= 0:
            # Histories are read before the exits (domain) and after them (entries).
            domain = _domain(tree, histories, place)
            _add_descendants(tree, arrow.target, entered, updated)
            for target in _effective_targets(tree, updated, arrow.target):
                _add_ancestors(tree, target, domain, entered, updated)
    exits, entries = tuple(sorted(exited, reverse=True)), tuple(sorted(entered))
    return Microstep(taken, exits, entries, (active - exited) | entered, updated)


def _exit_set(tree: Tree, active: Nodes, histories: Histories, place: int) -> Nodes:
    if tree.arrows[place].target < 0:
        return frozenset()
    domain = _domain(tree, histories, place)
    return frozenset(node for node in active if tree.holds(domain, node))


def _domain(tree: Tree, histories: Histories, place: int) -> int:
    """Return the transition domain: the innermost compound state with source and targets."""
    arrow = tree.arrows[place]
    if arrow.declared.internal:
        return arrow.source
    ends = _effective_targets(tree, histories, arrow.target)
    return next(
        node
        for node in tree.above[arrow.source]
        if tree.nodes[node].sort is Sort.COMPOUND and all(tree.holds(node, end) for end in ends)
    )


def _effective_targets(tree: Tree, histories: Histories, target: int) -> Nodes:
    """Return a target, or the contents of a history."""
    node = tree.nodes[target]
    if node.sort not in HISTORIES:
        return frozenset((target,))
    return histories.get(target, tree.remembered_first(target))


def _add_descendants(tree: Tree, state: int, found: set[int], histories: Histories) -> None:
    """Add a state and the descendants that it enters (SCXML, `addDescendantStatesToEnter`)."""
    node = tree.nodes[state]
    if node.sort in HISTORIES:
        remembered = sorted(_effective_targets(tree, histories, state))
        for each in remembered:
            _add_descendants(tree, each, found, histories)
        for each in remembered:
            _add_ancestors(tree, each, node.parent, found, histories)
        return
    found.add(state)
    if node.sort is Sort.COMPOUND:
        _add_descendants(tree, node.initial, found, histories)
        _add_ancestors(tree, node.initial, state, found, histories)
    elif node.sort is Sort.PARALLEL:
        _enter_regions(tree, state, found, histories)


def _add_ancestors(
    tree: Tree, state: int, outer: int, found: set[int], histories: Histories
) -> None:
    """Add the ancestors of a state below `outer` with their regions."""
    for node in tree.above[state]:
        if node == outer:
            return
        found.add(node)
        if tree.nodes[node].sort is Sort.PARALLEL:
            _enter_regions(tree, node, found, histories)


def _enter_regions(tree: Tree, parallel: int, found: set[int], histories: Histories) -> None:
    for child in tree.nodes[parallel].children:
        if not any(tree.holds(child, node) for node in found):
            _add_descendants(tree, child, found, histories)
