"""Stop conditions where a flow begins on their boundary: ``n >= 5`` where n is 5, a speed of 0."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.course import UNDERFLOW, Courses
from statechart.automaton.laws import Flow, Instant, Setup
from statechart.automaton.regions import Mode
from statechart.formulas.formula import parse_relation
from statechart.formulas.series import sizes_at
from statechart.formulas.tape import Tape


class StandingStops:
    """Judges stop conditions where a flow begins, as guards are (`statechart.charts.firing`).

    Within the rounding of its terms a margin is on its boundary, and the way that it goes in the
    mode decides: one that falls is found by the flow, one that rises is let go, and where it stays
    the relation says whether that counts.

    Parameters
    ----------
    automaton : Automaton
        What is run.
    """

    def __init__(self, automaton: Automaton) -> None:
        stops = automaton.declaration.stop.conditions if automaton.stops else {}
        self._strict = [parse_relation(text).operator in "<>" for text in stops.values()]
        self._courses = Courses(automaton.variables, automaton.parameters, automaton.time)

    def __bool__(self) -> bool:
        return bool(self._strict)

    def judged(self, mode: Mode, guards: Tape, at: Instant) -> tuple[str | None, Flow]:
        """Return the condition that ends the run here, and the flow that begins where none does.

        Parameters
        ----------
        mode : Mode
            Of the flow that begins.
        guards : Tape
            Outputs: its margins.
        at : Instant
            Where it begins.

        Returns
        -------
        met : str or None
        flow : Flow
            With room for the conditions that begin on their boundary and do not fall.
        """
        setup, clock, _, flow, state, _ = at
        time, first = clock.high, len(mode.margins) - len(self._strict)
        values = guards.values(state, setup.values, time)[first:].tolist()
        sizes = _sizes(setup, flow, state)
        places = tuple(range(first, len(mode.margins)))
        terms = sizes_at(guards, places, state, sizes, setup.values, time)
        names = [margin.name for margin in mode.margins[first:]]
        tolerances: dict[str, float] = {}
        for name, value, term, strict in zip(names, values, terms, self._strict, strict=True):
            near = max(setup.precision * term, UNDERFLOW)
            if not abs(value) <= near:
                continue
            way = self._courses.sign(setup, flow.roles, name, state, sizes, time, setup.precision)
            if way == 0.0 and not strict:
                return name, flow
            if way >= 0.0:
                tolerances[name] = max(near, flow.tolerances.get(name, 0.0))
        if tolerances:
            flow = flow._replace(tolerances={**flow.tolerances, **tolerances})
        return None, flow


def _sizes(setup: Setup, flow: Flow, state: Array) -> Array:
    """Return how large what the variables were summed from is, or they are."""
    found = np.abs(state)
    for sizes in (setup.sizes, flow.sizes if flow.summed is None else flow.summed):
        if sizes is not None:
            found = np.maximum(found, sizes)
    return found
