"""Stop conditions where a flow begins on their boundary: ``n >= 5`` where n is 5, a speed of 0."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import Flow, Instant, Setup
from statechart.automaton.margin_derivatives import UNDERFLOW, MarginDerivatives
from statechart.automaton.regions import Mode, StopCondition
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape


class StandingStops:
    """Judges stop conditions where a flow begins, as guards are (`statechart.charts.guard_watch`).

    Within the rounding of its terms a margin is on its boundary, and the way that it goes in the
    mode decides: one that falls is found by the flow, one that rises is let go, and where it stays
    the relation says whether that counts. Of a relation with *and* a certificate is watched.
    """

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        self._derivatives = MarginDerivatives(
            automaton.variables, automaton.parameters, automaton.time
        )

    def __bool__(self) -> bool:
        return bool(self._automaton.stops)

    def judged(self, mode: Mode, guards: Tape, at: Instant) -> tuple[str | None, Flow]:
        """Return the condition that ends the run here, and the flow that begins where none does.

        The flow has room for the conditions that begin on their boundary and do not fall; it is
        without those that its certificates do not need.
        """
        atoms = _Atoms(self._automaton, self._derivatives, mode, guards, at)
        flow, tolerances = at.flow, dict[str, float]()
        for stop, first in self._stops():
            if stop.condition.disjoint:
                for k, atom in enumerate(stop.condition.atoms, first):
                    if not atoms.near(k):
                        continue
                    way = atoms.way(k)
                    if way == 0.0 and not atom.strict:
                        return stop.name, flow
                    if way >= 0.0:
                        known = flow.tolerances.get(atoms.names[k], 0.0)
                        tolerances[atoms.names[k]] = max(atoms.room[k], known)
                continue
            of = partial(atoms.holds, stop, first)
            active = self._automaton.active(flow.mode)
            truth = stop.condition.truth(of, active)
            if truth:
                return stop.name, flow
            places = range(len(stop.condition.atoms))
            certificate = frozenset(places)
            if truth is not None:
                certificate = stop.condition.certificate(of, active, partial(atoms.rests, first))
            for k in places:
                name = atoms.names[first + k]
                tolerances[name] = atoms.room[first + k] if k in certificate else math.inf
        if tolerances:
            flow = flow._replace(tolerances={**flow.tolerances, **tolerances})
        return None, flow

    def met(self, mode: Mode, guards: Tape, at: Instant) -> str | None:
        """Return the condition that holds where a flow came to the fall of one of its margins."""
        (fired,) = at.fired
        atoms = _Atoms(self._automaton, self._derivatives, mode, guards, at)
        stop, first = next(
            (stop, first) for stop, first in self._stops() if stop is self._automaton.stop_of[fired]
        )
        active = self._automaton.active(at.flow.mode)
        holds = stop.condition.disjoint or any(
            stop.condition.truth(partial(of, stop, first), active)
            for of in (atoms.holds, atoms.touches)
        )
        return stop.name if holds else None

    def _stops(self) -> Iterator[tuple[StopCondition, int]]:
        """Yield stop conditions and the places of their first atoms."""
        first = 0
        for stop in self._automaton.stops:
            yield stop, first
            first += len(stop.margins)


class _Atoms:
    """The atoms of stop conditions at an instant."""

    def __init__(
        self,
        automaton: Automaton,
        derivatives: MarginDerivatives,
        mode: Mode,
        guards: Tape,
        at: Instant,
    ) -> None:
        setup, clock, _, flow, state, _ = at
        self._derivatives, self._at = derivatives, at
        time, count = clock.high, len(automaton.stop_margins)
        first = len(mode.margins) - count
        self._values = guards.values(state, setup.values, time)[first:].tolist()
        self._flow_sizes = flow_sizes(setup, flow, state)
        places = tuple(range(first, len(mode.margins)))
        terms = sizes_at(guards, places, state, self._flow_sizes, setup.values, time)
        self.room = [max(setup.precision * term, UNDERFLOW) for term in terms]
        self.names = [margin.name for margin in automaton.stop_margins]

    def near(self, k: int) -> bool:
        """Return whether an atom is on its boundary."""
        return bool(abs(self._values[k]) <= self.room[k])

    def way(self, k: int) -> float:
        """Return the sign of the first derivative of an atom's margin that is not zero."""
        setup, clock, _, flow, state, _ = self._at
        return self._derivatives.sign(
            setup, flow.moving, self.names[k], state, self._flow_sizes, clock.high, setup.precision
        )

    def holds(self, stop: StopCondition, first: int, k: int) -> bool | None:
        """Return whether atom k of a condition holds from here on; None if it has no value."""
        place, strict = first + k, stop.condition.atoms[k].strict
        value = self._values[place]
        if not self.near(place):
            return None if math.isnan(value) else value < 0.0
        way = self.way(place)
        return way < 0.0 or (way == 0.0 and not strict)

    def rests(self, first: int, k: int) -> bool:
        """Return whether atom k of a condition stays on its boundary."""
        return self.near(first + k) and self.way(first + k) == 0.0

    def touches(self, stop: StopCondition, first: int, k: int) -> bool:
        """Return whether atom k of a condition holds at this very instant."""
        place, strict = first + k, stop.condition.atoms[k].strict
        return bool(self._values[place] <= (-1.0 if strict else 1.0) * self.room[place])


def flow_sizes(setup: Setup, flow: Flow, state: Array) -> Array:
    """Return how large what the variables were summed from is, or they are."""
    found = np.abs(state)
    for sizes in (setup.sizes, flow.sizes if flow.summed is None else flow.summed):
        if sizes is not None:
            found = np.maximum(found, sizes)
    return found
