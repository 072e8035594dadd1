"""Firing of transitions: guards on their boundary, events of other regions.

A transition fires when its guard becomes true, or at once if its state is entered with the guard
true. On the boundary of an atom, within round-off of the state, the first nonzero time derivative
of the margin in the entered state decides: a ball at x = 0 that rises does not bounce again on
``x <= 0``, one that is about to fall does. If all derivatives vanish, the relation decides:
``n >= 3`` fires at n = 3, ``n > 3`` does not. A guard of several atoms that the flow reaches fires
even if it is true at that instant only, as ``abs(x) <= 0``.

A transition on an event fires at the instant of the event if its guard is true then. A region
processes the events of an instant in their order, before its guards; an event that its state does
not wait for is discarded. Several states entered in one jump raise several events.

Transitions due at one instant are taken one after another, each evaluated at the state after the
one before: regions in order, in a region inner states first, then in document order. Transitions
that one event, or guards at one instant, fire in orthogonal regions of a state are one microstep
(SCXML).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np
import sympy as sp

from statechart.arrays import EPS, Array, Bools
from statechart.automaton.laws import UNBOUNDED, Flow, Instant, Setup
from statechart.automaton.margin_derivatives import (
    UNDERFLOW,
    MarginDerivatives,
    tape_with_sizes,
    time_derivative,
)
from statechart.automaton.regions import (
    Claim,
    Edge,
    Margin,
    Raised,
    Region,
    margins_of,
    raised_events,
)
from statechart.automaton.trace import Jump, Key
from statechart.charts.flatten import FlatRegion, FlatTransition, Updates
from statechart.documents.outputs import Event
from statechart.errors import NonFinite
from statechart.formulas.condition import Active, AtomsAt, Condition
from statechart.formulas.formula import parse
from statechart.formulas.linear import free_symbols
from statechart.formulas.relation import Relation, parse_relation
from statechart.formulas.tape import Tape
from statechart.kernels.tapes import tape_values

# A margin is zero below this fraction of its terms, for any tolerance of the run.
_ZERO_MARGIN = 2.0**-40
_TIME_ROUND_OFF = 8.0 * EPS
_NO_VALUES: Mapping[sp.Symbol, sp.Expr] = MappingProxyType({})
_Setup = TypeVar("_Setup")


class GuardWatch:
    """The guards of a mode, evaluated together at an instant.

    `rates` are expressions of inputs, parameters and time; inputs without one are constant.
    `timers` are inputs as exact as time: instants or whole numbers. `substitutions` replaces
    symbols of conditions in the mode.

    `margins` names the atoms of all guards, `firsts` is the place of the first atom of each guard.
    `timed` atoms depend smoothly on time alone, `scheduled` atoms so between jumps; `closed` atoms
    include their boundary. `single` is true if every guard has one atom. `of_state` are the names
    of guards that read more than time.
    """

    def __init__(
        self,
        watched: Sequence[Guard],
        condition_of: Callable[[Guard], Condition],
        rates: Mapping[sp.Symbol, sp.Expr],
        *,
        inputs: Sequence[sp.Symbol],
        parameters: Sequence[sp.Symbol],
        time: sp.Symbol,
        timers: Collection[sp.Symbol] = (),
        substitutions: Mapping[sp.Symbol, sp.Expr] = _NO_VALUES,
    ) -> None:
        self.guards = tuple(watched)
        self.conditions = tuple(map(condition_of, self.guards))
        self.single = all(condition.single for condition in self.conditions)
        self.atoms: list[_AtomTapes] = []
        names: list[str] = []
        firsts: list[int] = []
        kinds: list[tuple[bool, bool, bool]] = []
        self.of_state = set[str]()
        order = {v: place for place, v in enumerate(rates)}
        for guard, condition in zip(self.guards, self.conditions, strict=True):
            firsts.append(len(names))
            names += condition.names(guard.name)
            for atom in condition.atoms:
                margin = atom.expression.xreplace(substitutions)
                near = free_symbols(margin) & order.keys()
                near |= order.keys() & set().union(*(free_symbols(rates[v]) for v in near))
                moving = tuple((v, rates[v]) for v in sorted(near, key=order.__getitem__))
                found = _atom_tapes(margin, moving, tuple(inputs), tuple(parameters), time)
                self.atoms.append(found)
                alone = free_symbols(margin) <= {time, *timers, *parameters}
                scheduled = all(r == 0 for _, r in moving) and not found.kinked
                kinds.append((alone and not found.kinked, scheduled, not atom.strict))
                if not alone:
                    self.of_state.add(guard.name)
        self.margins, self.firsts = tuple(names), tuple(firsts)
        self.timed, self.scheduled, self.closed = np.array(kinds, np.bool_).reshape(-1, 3).T

    def at(self, setup: Setup, inputs: Array, sizes: Array, time: float) -> Array:
        """Return (a, 2): margins, and the sizes of their terms."""
        state, found = np.concatenate([inputs, sizes]), np.empty((len(self.atoms), 2))
        for row, atom in zip(found, self.atoms, strict=True):
            tape_values(*atom.margin.program, state, setup.values, time, row)
        return found

    def rate(
        self, k: int, order: int, setup: Setup, inputs: Array, sizes: Array, time: float
    ) -> Array:
        """Return (2,): the first or second time derivative of a margin, and its terms' size."""
        tape = self.atoms[k].tape(order)
        return tape.values(np.concatenate([inputs, sizes]), setup.values, time)

    def table(
        self, setup: Setup, inputs: Array, sizes: Array, times: Array, *, order: int = 0
    ) -> Array:
        """Return `at` (order 0) or `rate` (m, a, 2) of all atoms for inputs (m, n)."""
        rows = np.hstack([inputs, np.broadcast_to(sizes, (len(inputs), len(sizes)))])
        tables = [atom.tape(order).table(rows, setup.values, times) for atom in self.atoms]
        return np.stack(tables, axis=1) if tables else np.zeros((len(inputs), 0, 2))

    def tolerances(self, rows: Array, relative: float) -> dict[str, float]:
        """Return margin -> its tolerance: `relative` times its terms, round-off for time alone."""
        sizes = np.where(np.isfinite(rows[:, 1]), rows[:, 1], 0.0)
        parts = np.where(self.timed, min(relative, _TIME_ROUND_OFF), relative) * sizes
        return {
            margin: max(part, UNDERFLOW)
            for margin, part in zip(self.margins, parts.tolist(), strict=True)
        }

    @cached_property
    def singles(self) -> list[int]:
        """The places of the atoms of single-atom guards."""
        return [first for _, condition, first in self.placed if condition.single]

    @cached_property
    def placed(self) -> list[tuple[Guard, Condition, int]]:
        """The guards, their conditions, and the places of their first atoms."""
        return [*zip(self.guards, self.conditions, self.firsts, strict=True)]

    def valueless(self, rows: Array) -> str | None:
        """Return the first single-atom guard whose margin is NaN, or None."""
        return next((self.margins[k] for k in self.singles if math.isnan(rows[k, 0])), None)

    def truths(self, atoms: Bools, active: Callable[[str, str], Bools]) -> Bools:
        """Return the truth (m, g) of the guards from their atoms (m, a); `active` returns (m,)."""
        found = [
            condition.truths(atoms[:, first : first + len(condition.atoms)], active)
            for condition, first in zip(self.conditions, self.firsts, strict=True)
        ]
        return np.stack(found, axis=1) if found else np.zeros((len(atoms), 0), np.bool_)

    def holding(self, rows: Array, relative: float, active: Active) -> set[tuple[int, int]]:
        """Return place and trigger of the guards that are true at an instant.

        On the boundary, within `relative` of the terms, `<=` and `>=` are true, `<` and `>` false.
        """
        bounds = np.array([*self.tolerances(rows, relative).values()])
        atoms: list[bool] = (rows[:, 0] <= np.where(self.closed, bounds, -bounds)).tolist()
        return {
            (guard.place, guard.trigger)
            for guard, condition, first in self.placed
            if condition.truth(atoms[first : first + len(condition.atoms)].__getitem__, active)
        }

    def early(self, rows: Array, due: Collection[tuple[int, int]], fired: Collection[str]) -> str:
        """Return a warning if a transition fires before its guard is true by more than round-off.

        Two transitions within the tolerance of each other are taken at one instant.
        """
        for guard, condition, first in self.placed:
            if (guard.place, guard.trigger) not in due or not condition.single:
                continue
            margin, size = rows[first]
            if guard.name not in fired and margin > _ZERO_MARGIN * size:
                short = f"it is {margin:.2g} short of it, within the tolerance of the run"
                return f"{guard.name} counts as true: {short}"
        return ""


@dataclass(frozen=True)
class _AtomTapes:
    """The margin of an atom and its time derivatives, compiled on first use.

    Modes share it if the variables of the margin have the same flow.
    """

    expression: sp.Expr
    flow: tuple[tuple[sp.Symbol, sp.Expr], ...]
    inputs: tuple[sp.Symbol, ...]
    parameters: tuple[sp.Symbol, ...]
    time: sp.Symbol

    @cached_property
    def margin(self) -> Tape:
        return self.tape(0)

    def tape(self, order: int) -> Tape:
        expression = self.expression if order == 0 else self._rate if order == 1 else self._bend
        return tape_with_sizes((expression,), self.inputs, self.parameters, self.time)

    @cached_property
    def rests(self) -> bool:
        return bool(self._rate == 0)

    @cached_property
    def kinked(self) -> bool:
        """True if the rate may jump: a control has abs, sign, min, max or sat."""
        return bool(self._rate.has(sp.sign))

    @cached_property
    def _rate(self) -> sp.Expr:
        return time_derivative(self.expression, dict(self.flow), self.time)

    @cached_property
    def _bend(self) -> sp.Expr:
        return time_derivative(self._rate, dict(self.flow), self.time)


_atom_tapes = lru_cache(4096)(_AtomTapes)


class GuardTruths:
    """Truth of the guards of a mode at an instant, and the atoms that certify it.

    `inputs` are those of the watch, the state first, with terms of `sizes`; `rows` (a, 2) are from
    `GuardWatch.at`. An atom with a NaN rate fires on its boundary only when its margin falls. The
    tolerances of the flow are infinite for margins that it did not watch.
    """

    def __init__(
        self,
        watch: GuardWatch,
        at: Instant,
        inputs: Array,
        sizes: Array,
        derivatives: MarginDerivatives,
        active: Active,
    ) -> None:
        setup, time, fired, tolerances = at.setup, at.clock.high, at.fired, at.flow.tolerances
        relative = setup.precision
        self.rows = rows = watch.at(setup, inputs, sizes, time)
        self._watch, self._flow, self._active = watch, at.flow, active
        own = [tolerances[margin] for margin in watch.margins]
        if math.inf in own:
            fresh = watch.tolerances(rows, relative).values()
            own = [one if one < math.inf else new for one, new in zip(own, fresh, strict=True)]

        self._fell = [k for k, margin in enumerate(watch.margins) if margin in fired]
        # An unbounded flow ends on the boundary of these atoms, where their rates do not exist.
        final = self._fell if UNBOUNDED in fired else ()

        def later(k: int) -> float:
            """Return the sign of the first nonzero derivative."""
            state, margin = at.state, watch.margins[k]
            own_sizes = sizes[: len(state)]
            return derivatives.sign(setup, at.flow.moving, margin, state, own_sizes, time, relative)

        def direction(k: int) -> float:
            if k in final:
                return 0.0
            if watch.atoms[k].kinked:
                return later(k)
            for order in (1, 2):
                value, size = watch.rate(k, order, setup, inputs, sizes, time).tolist()
                if math.isnan(value):
                    return later(k)
                if value != 0.0 and not abs(value) <= relative * size:
                    return float(value)
            return 0.0 if watch.atoms[k].rests else later(k)

        self._atoms = AtomsAt(
            rows[:, 0].tolist(), own, watch.closed.tolist(), direction,
            fell=self._fell, alone=watch.singles, still=lambda k: watch.atoms[k].rests,
        )  # fmt: skip

    def due(self) -> set[tuple[int, int]]:
        """Return place and trigger of the guards that are true.

        A guard of several atoms that the flow reached may be true at this instant only.
        """
        atoms, active = self._atoms, self._active
        found = set()
        for guard, condition, first in self._watch.placed:
            reached = any(first <= k < first + len(condition.atoms) for k in self._fell)
            if atoms.truth(condition, first, active) or (
                reached and not condition.single and atoms.touched(condition, first, active)
            ):
                found.add((guard.place, guard.trigger))
        return found

    def continued(self) -> tuple[None, Flow] | None:
        """Return the flow if it goes on and other atoms certify it: it watches these only."""
        if self._watch.single:
            return None
        found = dict(self._flow.tolerances)
        for _, condition, first in self._watch.placed:
            if condition.single:
                continue
            chosen = self._atoms.certificate(condition, first, self._active)
            for k in range(first, first + len(condition.atoms)):
                known = self._atoms.tolerances[k] if k in chosen else math.inf
                found[self._watch.margins[k]] = known
        if found == self._flow.tolerances:
            return None
        return None, self._flow._replace(tolerances=found)


@dataclass(frozen=True, eq=False)
class Guard:
    """A guard of a transition out of a state."""

    place: int  # of its region
    name: str  # region and transition
    relation: Relation
    trigger: int  # place of its `Trigger` in the region


class Firing(NamedTuple):
    """A transition to take, and the events that are pending after it."""

    place: int  # of its region
    taken: FlatTransition
    pending: Mapping[str, tuple[Raised, ...]]
    due: frozenset[tuple[int, int]]  # guards that fired it: place and trigger


def guards(place: int, region: FlatRegion, state: str) -> list[Guard]:
    """Return the guards that fire transitions out of `state`, with distinct names."""
    found = [t for t in region.triggers[state] if t.guard is not None]
    names = Counter(trigger.declared.name for trigger in found)
    made = []
    for trigger in found:
        name = f"{region.name}.{trigger.declared.name}"
        if names[trigger.declared.name] > 1:
            name += f" to {region.answer(state, (trigger.place,)).target}"
        made.append(Guard(place, name, parse_relation(str(trigger.guard)), trigger.place))
    return made


def guards_at_events(place: int, region: FlatRegion, state: str) -> list[Guard]:
    """Return the guards of transitions out of `state` that events fire."""
    return [
        Guard(place, t.declared.name, parse_relation(t.declared.guard), t.place)
        for t in region.triggers[state]
        if t.events and t.declared.guard is not None
    ]


def guard_margins(
    declared: FlatRegion, state: str, known: Mapping[str, sp.Expr]
) -> tuple[Margin, ...]:
    """Return the margins of the guards out of `state`, one per atom."""
    own = guards(0, declared, state)
    return tuple(m for g in own for m in margins_of(g.name, g.relation, known)[1])


def guard_claims(declared: FlatRegion, state: str) -> tuple[Claim, ...]:
    """Return the claims that no guard out of `state` is true while it is active."""
    own = guards(0, declared, state)
    return tuple(Claim(guard.name, (guard.relation.text,), holds=False) for guard in own)


def values_after(
    blocks: Iterable[Updates], variables: Mapping[str, sp.Expr], known: Mapping[str, sp.Expr]
) -> list[sp.Expr]:
    """Return the values of variables after updates; a block reads the values after the last."""
    values = dict(variables)
    for block in blocks:
        now = {**known, **values}
        values |= {name: parse(text).to_sympy(now) for name, text in block.items()}
    return list(values.values())


def check_updated(cause: str, names: Iterable[str], values: Array) -> None:
    """Raise `NonFinite` if a transition sets a variable to a non-finite value."""
    for name, value in zip(names, values.tolist(), strict=True):
        if not math.isfinite(value):
            raise NonFinite(f"{cause} sets {name} to {value}")


def restart_periods(
    regions: Mapping[str, FlatRegion],
    updated: Callable[[_Setup, str, tuple[Updates, ...], Array], Array],
    setups: tuple[_Setup, _Setup],
    state: Array,
) -> Array:
    """Return the state at a change of parameters between two setups.

    A new period of `every` begins with the last tick, but ends no earlier than now. `updated`
    returns the state after updates of a region with a setup.
    """
    old, new = setups
    for name, region in regions.items():
        periods, last, due = ((updates,) for updates in region.restarts)
        if region.counts:
            same = updated(old, name, periods, state) == updated(new, name, periods, state)
            restarted = np.maximum(updated(old, name, last, state), updated(new, name, due, state))
            state = np.where(same, state, restarted)
    return state


def transition_outcomes(region: Region) -> Callable[[FlatTransition], Mapping[str, str]]:
    """Return a function: taken transition -> outcome of every transition out of its source."""
    leaving: dict[str, list[Edge]] = {}
    for edge in region.edges:
        leaving.setdefault(edge.source, []).append(edge)

    @cache
    def of(taken: FlatTransition) -> Mapping[str, str]:
        label = f"{taken.name}->{taken.target}"
        others = {
            f"{other.cause}->{other.target}": f"not due, or declared later: {other.guard}"
            for other in leaving.get(taken.source, ())
        }
        return others | {label: "taken"}

    return of


def _answers(event: Raised, awaited: Iterable[Event], region: FlatRegion) -> bool:
    return any(event.answers(one, region.name, region.done) for one in awaited)


class EventQueues:
    """Event queues of the regions in `declared` that wait for events of `regions`."""

    def __init__(self, regions: Sequence[Region], declared: Mapping[str, FlatRegion]) -> None:
        self._regions, self._declared = regions, declared
        # Region -> the events that it waits for in some state.
        self._waiting = {
            name: region.awaited for name, region in declared.items() if region.awaited
        }

    def pending_after(
        self, pending: Mapping[str, tuple[Raised, ...]], jump: Jump
    ) -> dict[str, tuple[Raised, ...]]:
        """Return the pending events after `jump`."""
        if not self._waiting:
            return {}
        new = raised_events(self._regions, jump)
        return {
            name: (*pending.get(name, ()), *(event for event in new if event.cause in causes))
            for name, causes in self._waiting.items()
        }

    def sources(self, mode: Key) -> set[str | None]:
        """Return the regions for whose events regions wait in `mode`; None is any region."""
        return {
            event.region
            for region, state in zip(self._declared.values(), mode, strict=True)
            for trigger in region.triggers[state]
            for event in trigger.events
        }

    def first(
        self,
        mode: Key,
        pending: Mapping[str, tuple[Raised, ...]],
        guarded: Collection[tuple[int, int]],
        holding: Callable[[], Collection[tuple[int, int]]],
    ) -> Firing | None:
        """Return the next transition to take, or None.

        `guarded` are the guards that are due; `holding` returns the true guards at events.
        """
        declared = zip(self._declared.items(), mode, strict=True)
        for place, ((name, region), state) in enumerate(declared):
            queue = pending.get(name, ())
            for k, event in enumerate(queue):
                enabled = [t for t in region.triggers[state] if _answers(event, t.events, region)]
                if any(trigger.declared.guard is not None for trigger in enabled):
                    true = holding()
                    enabled = [
                        t for t in enabled if t.declared.guard is None or (place, t.place) in true
                    ]
                if enabled:
                    taken = region.answer(state, [trigger.place for trigger in enabled])
                    # Alternative events of a transition at one instant fire it once.
                    consumed = [e for trigger in enabled for e in trigger.events]
                    rest = queue[k + 1 :]
                    later = tuple(other for other in rest if not _answers(other, consumed, region))
                    return Firing(place, taken, {**pending, name: later}, frozenset())
            due = frozenset(one for one in guarded if one[0] == place)
            if due:
                taken = region.answer(state, [trigger for _, trigger in due])
                return Firing(place, taken, {**pending, name: ()} if queue else pending, due)
        return None
