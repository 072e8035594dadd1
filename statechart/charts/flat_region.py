"""A region as the executor knows it: one state at a time, and the transitions out of each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from statechart.automaton.nesting import Nesting
from statechart.automaton.regions import Edge
from statechart.charts.microstep import Memory, Nodes, selected
from statechart.charts.transitions import BaseState, Transition
from statechart.charts.tree import HISTORIES, Tree
from statechart.documents.fields import FiniteText
from statechart.documents.outputs import Event
from statechart.documents.quantities import Dimension

Updates = Mapping[str, FiniteText]


@dataclass(frozen=True, eq=False)
class FlatTransition:
    """Transitions that are taken together, from one configuration to another."""

    name: str  # those of the transitions, joined by ``+``
    source: str  # configurations
    target: str
    members: tuple[Transition, ...]  # as declared, in the order of their updates
    guard: str | None  # what fires it, also where that is a time
    # Updates in their order: of states left, of transitions, of states entered. Those of one block
    # see the values that the blocks before it left.
    blocks: tuple[Updates, ...]

    @property
    def on_zeno(self) -> bool:
        """Whether the accumulation of jumps fires it."""
        return self.members[0].on_zeno

    @property
    def events(self) -> tuple[Event, ...]:
        """Those of other regions that fire it."""
        return tuple(dict.fromkeys(event for member in self.members for event in member.events))

    @property
    def trigger(self) -> str:
        """Its trigger, in words."""
        return " and ".join(dict.fromkeys(member.trigger for member in self.members))

    def reset(self, apart: Collection[str] = ()) -> str:
        """Return what it sets, in words, apart from some variables."""
        updates = (update for block in self.blocks for update in block.items())
        return ", ".join(f"{name} := {to}" for name, to in updates if name not in apart)


class Shared(NamedTuple):
    """A variable that two states both give a flow or value."""

    what: str
    one: str
    other: str


@dataclass(frozen=True, eq=False)
class FlatRegion:
    """A region as the executor knows it."""

    name: str
    initial: str  # the configuration that it starts in
    begins: tuple[Updates, ...]  # updates of the states entered there
    # Configuration -> what is declared of the states active in it, outer ones first.
    states: Mapping[str, tuple[BaseState, ...]]
    # From each configuration in the order in which they are asked: inner ones first, then as
    # declared; those taken together after those alone.
    transitions: tuple[FlatTransition, ...]
    # Variables of transitions that wait for times: when their sources were entered, and how many
    # periods have passed since of those that repeat.
    clocks: tuple[str, ...]
    counts: tuple[str, ...]
    superstates: Mapping[str, str]  # as of a `statechart.automaton.regions.Region`
    nesting: Nesting  # what else was declared of the hierarchy
    _tree: Tree
    _configurations: Mapping[str, tuple[Nodes, Memory]]
    _places: Mapping[tuple[str, tuple[int, ...]], int]

    @property
    def timers(self) -> tuple[str, ...]:
        """The variables that transitions wait for times by: clocks, then counts."""
        return (*self.clocks, *self.counts)

    @property
    def ordered(self) -> tuple[str, ...]:
        """The configurations; the first is where the region starts."""
        return tuple(self.states)

    @property
    def edges(self) -> tuple[Edge, ...]:
        """The transitions as text for people, in their order."""
        return tuple(
            Edge(t.name, t.source, t.target, t.trigger, t.reset(self.timers), on_zeno=t.on_zeno)
            for t in self.transitions
        )

    def active(self, state: str) -> tuple[str, ...]:
        """Return what is active with a configuration: its states, and those that hold them."""
        return self.nesting.active(state, self.superstates)

    @cached_property
    def named(self) -> tuple[str, ...]:
        """States and superstates, as declared: what outputs and events may ask for."""
        return tuple(n.name for n in self._tree.nodes[1:] if n.sort not in HISTORIES)

    @cached_property
    def causes(self) -> tuple[str, ...]:
        """The names of the transitions, as declared."""
        return tuple(dict.fromkeys(arrow.declared.name for arrow in self._tree.arrows))

    @cached_property
    def waiting(self) -> Mapping[str, tuple[tuple[int, tuple[Event, ...]], ...]]:
        """Configuration -> arrows out of it that wait for events of other regions."""
        heard = [(i, arrow) for i, arrow in enumerate(self._tree.arrows) if arrow.declared.events]
        return {
            name: tuple((i, arrow.declared.events) for i, arrow in heard if arrow.source in active)
            for name, (active, _) in self._configurations.items()
        }

    def shared(self, given: Callable[[BaseState], Collection[str]]) -> Shared | None:
        """Return what two states that are active side by side both give, the first of it."""
        owners: dict[str, list[int]] = {}
        for index, node in enumerate(self._tree.nodes):
            if not isinstance(node.declared, BaseState):
                continue
            for what in given(node.declared):
                for other in owners.setdefault(what, []):
                    if self._tree.beside(index, other):
                        return Shared(what, self._tree.nodes[other].name, node.name)
                owners[what].append(index)
        return None

    def answer(self, state: str, enabled: Collection[int]) -> int:
        """Return the place of the transition taken where an event enables some arrows."""
        active, memory = self._configurations[state]
        return self._places[state, selected(self._tree, active, memory, enabled)]


def timed(regions: Iterable[FlatRegion], name: str) -> Dimension:
    """Return what a variable measures by which transitions wait; empty for another."""
    for region in regions:
        if name in region.timers:
            return "time" if name in region.clocks else "1"
    return ""
