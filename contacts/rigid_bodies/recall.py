"""Controller variables along steps, integrated ahead: no motion of bodies changes them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from contacts.dynamics.controllers import flows_in
from contacts.dynamics.mechanics import Mechanics
from statechart.arrays import Array
from statechart.automaton.trace import Key
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape


class Recall:
    """The variables and clocks of the controllers of a scene, integrated over time."""

    def __init__(self, mechanics: Mechanics) -> None:
        self._mechanics = mechanics
        self._rates: dict[Key, Tape] = {}

    def along(
        self, states: Mapping[str, str], values: Array, remembered: Array, times: Array
    ) -> Array:
        """Return what is remembered (m, w) at instants (m,), from that at the first of them.

        By the rule of Runge and Kutta from each to the next.
        """
        result = np.empty((len(times), len(remembered)))
        result[0] = remembered
        if not len(remembered):
            return result
        rates = self._tape(states)
        if not len(rates.reads):
            # All of it flows at constant rates, as clocks do.
            # Added up one by one, so that it does not matter where steps begin.
            result[1:] = np.outer(np.diff(times), rates.at(remembered, values, 0.0))
            found: Array = np.cumsum(result, axis=0)
            return found
        for k, h in enumerate(np.diff(times).tolist()):
            t, w = float(times[k]), result[k]
            first = rates.at(w, values, t)
            second = rates.at(w + 0.5 * h * first, values, t + 0.5 * h)
            third = rates.at(w + 0.5 * h * second, values, t + 0.5 * h)
            last = rates.at(w + h * third, values, t + h)
            result[k + 1] = w + h / 6.0 * (first + 2.0 * second + 2.0 * third + last)
        return result

    def _tape(self, states: Mapping[str, str]) -> Tape:
        key = tuple(states.values())
        if key not in self._rates:
            mechanics = self._mechanics
            self._rates[key] = compile_tape(
                flows_in(mechanics, states),
                variables=tuple(mechanics.memory.values()),
                parameters=mechanics.parameters.ordered,
                time=mechanics.time,
                definitions=mechanics.controlled(states),
            )
        return self._rates[key]
