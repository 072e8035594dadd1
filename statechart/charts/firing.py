"""When the transitions of a region fire: guards on their boundary, events of other regions.

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

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy as sp

from statechart.arrays import Array
from statechart.automaton.course import UNDERFLOW, along, size_of
from statechart.automaton.events import happened
from statechart.automaton.laws import Setup
from statechart.automaton.regions import Edge, Margin, Region
from statechart.automaton.trace import Jump, Key
from statechart.charts.flat_region import FlatRegion, FlatTransition
from statechart.formulas.formula import Relation, parse_relation
from statechart.formulas.writer import compile_tape

# Of its terms, a margin that is so small is zero, however exactly a run is computed.
_ROUNDED = 2.0**-40
# A few roundings, of an instant and of what it is compared with.
_OF_TIME = 8.0 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Guard:
    """A guard out of a state.

    Attributes
    ----------
    place : int
        Of its region among those that are watched.
    margin : str
        Name of its margin: region and transition.
    relation : Relation
        As declared.
    transition : int
        Place of its transition in the flattened region.
    """

    place: int
    margin: str
    relation: Relation
    transition: int


@dataclass(frozen=True, eq=False)
class Firing:
    """A transition that is due: its place and that of its region, and what is left to be heard."""

    place: int
    transition: int
    pending: Mapping[str, tuple[Jump, ...]]


def guards(place: int, name: str, transitions: Sequence[FlatTransition], state: str) -> list[Guard]:
    """Return the guards out of `state`, with names for their margins that differ."""
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
    """Return the margins of the guards out of `state`."""
    return tuple(
        Margin(guard.margin, guard.relation.margin(known))
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


class GuardWatch:
    """The guards of a mode, evaluated together at an instant.

    Parameters
    ----------
    watched : sequence of Guard
        Which.
    known : mapping
        Name -> expression in `inputs`, `parameters` and `time`.
    rates : mapping
        Input -> its rate, an expression of the same; inputs without one are constant.
    inputs, parameters : sequence of Symbol
        What the guards depend on.
    time : Symbol
        Time.
    timers : collection of Symbol
        Inputs that are instants of time, and as exact, or whole numbers.

    Attributes
    ----------
    guards : tuple of Guard
    timed, closed : (g,) array of bool
        Which depend on time alone, and which hold on their boundary, too.
    """

    def __init__(
        self,
        watched: Sequence[Guard],
        known: Mapping[str, sp.Expr],
        rates: Mapping[sp.Symbol, sp.Expr],
        *,
        inputs: Sequence[sp.Symbol],
        parameters: Sequence[sp.Symbol],
        time: sp.Symbol,
        timers: Collection[sp.Symbol] = (),
    ) -> None:
        self.guards = tuple(watched)
        sizes = {v: sp.Symbol(f"size_{v}", real=True) for v in inputs}
        outputs: list[sp.Expr] = []
        timed: list[bool] = []
        for guard in self.guards:
            margin = guard.relation.margin(known)
            timed.append(margin.free_symbols <= {time, *timers, *parameters})
            first = along(margin, rates, time)
            second = along(first, rates, time)
            outputs += [margin, first, second]
            outputs += [size_of(expression, sizes) for expression in (margin, first, second)]
        self._tape = compile_tape(
            outputs, variables=(*inputs, *sizes.values()), parameters=parameters, time=time
        )
        self.timed = np.array(timed, np.bool_)
        self.closed = np.array([g.relation.operator in ("<=", ">=") for g in watched], np.bool_)

    def at(self, setup: Setup, inputs: Array, sizes: Array, time: float) -> Array:
        """Return (g, 6): margin, its first and second derivative in time, sizes of their terms."""
        found = self._tape.values(np.concatenate([inputs, sizes]), setup.values, time)
        return found.reshape(-1, 6)

    def table(self, setup: Setup, inputs: Array, sizes: Array, times: Array) -> Array:
        """Return `at` for many instants: inputs (m, n), times (m,) to (m, g, 6)."""
        rows = np.hstack([inputs, np.broadcast_to(sizes, (len(inputs), len(sizes)))])
        return self._tape.table(rows, setup.values, times).reshape(len(inputs), -1, 6)

    def tolerances(self, rows: Array, relative: float) -> dict[str, float]:
        """Return margin -> how near zero it is on its boundary: `relative` to its terms.

        A guard of time alone is as exact as time, whatever the tolerance of the run.
        """
        sizes = np.where(np.isfinite(rows[:, 3]), rows[:, 3], 0.0)
        parts = np.where(self.timed, min(relative, _OF_TIME), relative) * sizes
        return {
            guard.margin: max(part, UNDERFLOW)
            for guard, part in zip(self.guards, parts.tolist(), strict=True)
        }

    def due(
        self,
        rows: Array,
        tolerances: Mapping[str, float],
        fired: Collection[str],
        relative: float,
        later: Callable[[Guard], float],
    ) -> dict[int, int]:
        """Return place -> the first transition whose guard is due.

        Parameters
        ----------
        rows : (g, 6) array
            From `at`. A rate that is not a number is not known: such a guard waits on its
            boundary until its margin falls.
        tolerances : mapping
            Of the margins.
        fired : collection of str
            The margins that were found to fall.
        relative : float
            Rates this small relative to their terms are zero.
        later : callable
            Guard -> the sign of the first derivative of its margin from the third on that is not
            zero; asked where the first two are.
        """
        found: dict[int, int] = {}
        for guard, row in zip(self.guards, rows.tolist(), strict=True):
            if guard.place in found:
                continue
            margin, first, second, _, slow, slower = row
            tolerance = tolerances[guard.margin]
            fell = guard.margin in fired
            if not (fell or margin <= tolerance):
                continue
            if not abs(first) <= relative * slow:
                rate = first
            elif not abs(second) <= relative * slower:
                rate = second
            else:
                rate = 0.0 if margin < -tolerance else later(guard)
            if fell:
                # What was found is a fall, or a touch too close to tell: then it must not rise.
                now = margin < -tolerance or not rate > 0.0
            else:
                strict = guard.relation.operator in "<>"
                falls = rate < 0.0 or (rate == 0.0 and not strict)
                now = margin < -tolerance or falls
            if now:
                found[guard.place] = guard.transition
        return found

    def early(self, rows: Array, place: int, transition: int, fired: Collection[str]) -> str:
        """Say that a transition is taken before its guard is true, and not by rounding.

        Two that follow each other within the tolerance are taken at once, with nothing in between.
        """
        for guard, row in zip(self.guards, rows.tolist(), strict=True):
            margin, size = row[0], row[3]
            taken = guard.place == place and guard.transition == transition
            if taken and guard.margin not in fired and margin > _ROUNDED * size:
                return (
                    f"{guard.margin} is taken for true, {margin:.2g} short of it: that is within "
                    "the tolerance of the run"
                )
        return ""


class Listening:
    """Regions that wait for events of each other.

    Parameters
    ----------
    regions : sequence of Region
        All, in the order of the keys.
    declared : mapping
        Those of them that may wait, flattened.
    """

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
        """Return the transition to take.

        Parameters
        ----------
        names : sequence of str
            Regions that are asked, in their order.
        mode : Key
            Their states.
        pending : mapping
            Region -> jumps of this instant that it has not heard of.
        guarded : mapping
            Place in `names` -> transition that is due by its guard (`Watch.due`).
        """
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
