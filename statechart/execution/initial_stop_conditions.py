"""Stop conditions at the start of a flow on their boundary, such as ``n >= 5`` at n = 5."""

from __future__ import annotations

import math
from collections.abc import Iterator

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import Flow, Instant, flow_sizes
from statechart.automaton.margin_derivatives import UNDERFLOW, MarginDerivatives
from statechart.automaton.regions import Mode, StopCondition
from statechart.formulas.condition import AtomsAt
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape


class InitialStopConditions:
    """Evaluates stop conditions at the start of a flow, like guards (`charts.guard_watch`).

    On a margin within round-off, the first nonzero derivative decides: the flow locates falling
    ones, rising ones are ignored, and constant ones count if the relation is closed. For
    conjunctions a certificate is watched.
    """

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        self._derivatives = MarginDerivatives(
            automaton.variables, automaton.parameters, automaton.time
        )
        self._names = [margin.name for margin in automaton.stop_margins]

    def __bool__(self) -> bool:
        return bool(self._automaton.stops)

    def judge_start(self, mode: Mode, guards: Tape, at: Instant) -> tuple[str | None, Flow]:
        """Return the condition that ends the run here, or None, and the flow.

        The flow has tolerances for conditions that start on their boundary without falling, and
        watches only the atoms of certificates.
        """
        atoms, active = self._atoms(mode, guards, at), self._automaton.active(at.flow.mode)
        flow, tolerances, names = at.flow, dict[str, float](), self._names
        for stop, first in self._stops():
            condition = stop.condition
            places = range(first, first + len(condition.atoms))
            if condition.disjoint:
                for k in filter(atoms.near, places):
                    if atoms.rests(k) and atoms.holds(k):
                        return stop.name, flow
                    if atoms.way(k) >= 0.0:
                        known = flow.tolerances.get(names[k], 0.0)
                        tolerances[names[k]] = max(atoms.tolerances[k], known)
            elif atoms.truth(condition, first, active):
                return stop.name, flow
            else:
                chosen = atoms.certificate(condition, first, active)
                for k in places:
                    tolerances[names[k]] = atoms.tolerances[k] if k in chosen else math.inf
        if tolerances:
            flow = flow._replace(tolerances={**flow.tolerances, **tolerances})
        return None, flow

    def judge_fall(self, mode: Mode, guards: Tape, at: Instant) -> str | None:
        """Return the condition that is true at the fall of one of its margins, or None."""
        (fired,) = at.fired
        fallen = self._automaton.stop_of[fired]
        stop, first = next((stop, first) for stop, first in self._stops() if stop is fallen)
        if not stop.condition.disjoint:
            atoms, active = self._atoms(mode, guards, at), self._automaton.active(at.flow.mode)
            if not (
                atoms.truth(stop.condition, first, active)
                or atoms.touched(stop.condition, first, active)
            ):
                return None
        return stop.name

    def _stops(self) -> Iterator[tuple[StopCondition, int]]:
        first = 0
        for stop in self._automaton.stops:
            yield stop, first
            first += len(stop.margins)

    def _atoms(self, mode: Mode, guards: Tape, at: Instant) -> AtomsAt:
        """Return the atoms of stop conditions at an instant."""
        setup, clock, _, flow, state, _ = at
        time, first = clock.high, len(mode.margins) - len(self._names)
        sizes = flow_sizes(setup, flow, state)
        places = tuple(range(first, len(mode.margins)))
        terms = sizes_at(guards, places, state, sizes, setup.values, time)

        def way(k: int) -> float:
            moving, name = flow.moving, self._names[k]
            return self._derivatives.sign(setup, moving, name, state, sizes, time, setup.precision)

        return AtomsAt(
            guards.values(state, setup.values, time)[first:].tolist(),
            [max(setup.precision * term, UNDERFLOW) for term in terms],
            [not atom.strict for stop, _ in self._stops() for atom in stop.condition.atoms],
            way,
        )
