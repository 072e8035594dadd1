"""Declared nesting of states that the flattened region does not show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

UNREACHED = "no transition leads there from the start"
"""The reason why no run is in a state of `Nesting.unreached`."""


@dataclass(frozen=True)
class Choice:
    """A state that an edge may lead to, and what is reset on the way."""

    target: str  # A state that holds no others.
    reset: str  # As of an `Edge`.


@dataclass(frozen=True)
class HierarchicalEdge:
    """Edges of a region that a person draws as one."""

    cause: str  # As of an `Edge`.
    # States or superstates. The edge leaves every state in `source`.
    source: str
    target: str
    guard: str  # As of an `Edge`.
    # Where it leads: `target` itself, or one of the states in it, which the laws choose.
    choices: tuple[Choice, ...]
    on_zeno: bool = False  # As of an `Edge`.
    # Variable -> new value, of the values before.
    updates: Mapping[str, str | int | float] = field(default_factory=dict)
    events: tuple[str, ...] = ()  # Of other regions, that fire it.
    internal: bool = False  # Whether it leaves no state.

    @property
    def reset(self) -> str:
        """What it resets whatever is chosen, and "" where that depends on the choice."""
        resets = {choice.reset for choice in self.choices}
        return resets.pop() if len(resets) == 1 else ""


class History(NamedTuple):
    """A target that stands for what was last active."""

    # Whether it remembers states of `parent` alone, or those in them, too.
    depth: Literal["shallow", "deep"]
    parent: str  # Of which it remembers.
    initial: str  # What it stands for as long as nothing is remembered.


@dataclass(frozen=True, eq=False)
class Nesting:
    """What was declared of the states of a flattened region, beside its superstates."""

    names: tuple[str, ...] = ()  # States and superstates in the order of the document.
    # State of the region -> the innermost states that are active in it.
    configurations: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # Cause -> the causes that it stands for, where one jump takes several transitions.
    joint: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    # Superstate -> the state in it that it begins with; "" is the region.
    initial: Mapping[str, str] = field(default_factory=dict)
    # Superstates whose states are regions: all of them are active.
    parallel: frozenset[str] = frozenset()
    histories: Mapping[str, History] = field(default_factory=dict)  # Name -> history.
    # State -> updates when it is entered, or left.
    entries: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    exits: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)
    edges: tuple[HierarchicalEdge, ...] = ()  # As declared, of flat regions too.
    # States and superstates that no chain of transitions enters from the start.
    unreached: frozenset[str] = frozenset()
    # State -> rates of variables that it declares.
    flows: Mapping[str, Mapping[str, str | int | float]] = field(default_factory=dict)

    def active(self, state: str, superstates: Mapping[str, str]) -> tuple[str, ...]:
        """Return the states that are active with one of the region, and those that hold them."""
        found: dict[str, None] = {}
        for name in self.configurations.get(state, (state,)):
            found[name] = None
            while name in superstates:
                name = superstates[name]
                found[name] = None
        return tuple(found)
