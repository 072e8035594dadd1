"""Firing of transitions: guards on their boundary, events of other regions.

A transition fires at the instant its guard becomes true, and at once where its state is entered
with the guard true. On the guard's boundary, within the rounding of the state, the way the margin
goes in the entered state decides, by its first derivative in time that is not zero: a ball at
x = 0 that rises does not bounce again on ``x <= 0``, one that is about to fall does; where the
margin stays at zero the relation itself decides, so that ``n >= 3`` fires at n = 3 and ``n > 3``
does not.

A transition on an event fires at the instant of the event. A region hears the events of an instant
one by one in their order, before its guards are judged; one that its state does not wait for has
passed.

Transitions due at one instant are taken one after another, each judged by the state that those
before it left: regions in their order, in a region those of inner states first, then the first one
declared. What one event fires in the regions inside a state is taken together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from statechart.automaton.events import happened
from statechart.automaton.regions import Claim, Edge, Margin, Region, margins_of
from statechart.automaton.trace import Jump, Key
from statechart.charts.flat_region import FlatRegion, FlatTransition
from statechart.formulas.relation import Relation, parse_relation


@dataclass(frozen=True, eq=False)
class Guard:
    """A guard out of a state."""

    place: int  # of its region among those that are watched
    name: str  # region and transition
    relation: Relation
    transition: int  # place of its transition in the flattened region


@dataclass(frozen=True, eq=False)
class Firing:
    """A transition that is due: its place and that of its region, and what is left to be heard."""

    place: int
    transition: int
    pending: Mapping[str, tuple[Jump, ...]]


def guards(place: int, name: str, transitions: Sequence[FlatTransition], state: str) -> list[Guard]:
    """Return the guards out of `state`, with names that differ."""
    found = [
        (index, transition, parse_relation(transition.guard))
        for index, transition in enumerate(transitions)
        if transition.source == state and transition.guard is not None
    ]
    names = [transition.name for _, transition, _ in found]
    return [
        Guard(
            place,
            f"{name}.{transition.name}"
            + (f" to {transition.target}" if names.count(transition.name) > 1 else ""),
            relation,
            index,
        )
        for index, transition, relation in found
    ]


def guard_margins(
    name: str, declared: FlatRegion, state: str, known: Mapping[str, sp.Expr]
) -> tuple[Margin, ...]:
    """Return the margins of the guards out of `state`, one for each atom."""
    return tuple(
        margin
        for guard in guards(0, name, declared.transitions, state)
        for margin in margins_of(guard.name, guard.relation, known)[1]
    )


def guard_claims(name: str, declared: FlatRegion, state: str) -> tuple[Claim, ...]:
    """Return that no guard out of `state` holds while it is active."""
    return tuple(
        Claim(guard.name, (guard.relation.text,), holds=False)
        for guard in guards(0, name, declared.transitions, state)
    )


def considered(region: Region) -> tuple[dict[str, str], ...]:
    """Return, for each transition of a region that is taken, what else could have been, and why."""
    leaving: dict[str, list[Edge]] = {}
    for edge in region.edges:
        leaving.setdefault(edge.source, []).append(edge)
    return tuple(
        {
            f"{other.cause}->{other.target}": "taken"
            if other is edge
            else f"not due, or declared later: {other.guard}"
            for other in leaving[edge.source]
        }
        for edge in region.edges
    )


class Listening:
    """Regions that wait for events of each other; `declared` are those of them that may wait."""

    def __init__(self, regions: Sequence[Region], declared: Mapping[str, FlatRegion]) -> None:
        self._regions = regions
        self._waiting = {
            name: region for name, region in declared.items() if any(region.waiting.values())
        }

    def heard(
        self, pending: Mapping[str, tuple[Jump, ...]], jump: Jump
    ) -> dict[str, tuple[Jump, ...]]:
        """Return what is pending once `jump` has happened; a region does not hear itself."""
        return {
            name: (*pending.get(name, ()), *((jump,) if name != jump.region else ()))
            for name in self._waiting
        }

    def waits(self, names: Sequence[str], mode: Key) -> bool:
        """Tell whether some of the regions wait for an event in their states."""
        asked = zip(names, mode, strict=True)
        return any(n in self._waiting and self._waiting[n].waiting[state] for n, state in asked)

    def first(
        self,
        names: Sequence[str],
        mode: Key,
        pending: Mapping[str, tuple[Jump, ...]],
        guarded: Mapping[int, int],
    ) -> Firing | None:
        """Return the transition to take."""
        for place, (name, state) in enumerate(zip(names, mode, strict=True)):
            queue = pending.get(name, ())
            for k, jump in enumerate(queue):
                enabled = [
                    arrow
                    for arrow, events in self._waiting[name].waiting[state]
                    if any(happened(self._regions, jump, event) for event in events)
                ]
                if enabled:
                    transition = self._waiting[name].answer(state, enabled)
                    return Firing(place, transition, {**pending, name: queue[k + 1 :]})
            if place in guarded:
                left = {**pending, name: ()} if queue else pending
                return Firing(place, guarded[place], left)
        return None
