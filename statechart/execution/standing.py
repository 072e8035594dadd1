"""Stop conditions on whose boundary a state stands still: ``n >= 5`` where n is 5, and counts."""

from __future__ import annotations

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.formulas.formula import parse_relation
from statechart.formulas.tape import Tape


class StandingStops:
    """What ends a run though no margin falls: it is zero, stays so, and its relation counts that.

    Where a margin changes in the mode, the way that it goes decides, as everywhere.

    Parameters
    ----------
    automaton : Automaton
        What is run.
    """

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        stops = automaton.declaration.stop.conditions if automaton.stops else {}
        self._counted = {
            name for name, text in stops.items() if parse_relation(text).operator in ("<=", ">=")
        }
        self._tapes: dict[Mode, tuple[tuple[str, ...], Tape]] = {}

    def __bool__(self) -> bool:
        return bool(self._counted)

    def met(self, mode: Mode, state: Array, values: Array) -> str | None:
        """Return the condition that the state stands on the boundary of.

        Parameters
        ----------
        mode : Mode
            Where the state is.
        state, values : array
            Variables and parameters.
        """
        found = self._tapes.get(mode)
        if found is None:
            found = self._tapes[mode] = self._standing(mode)
        names, tape = found
        margins = tape.values(state, values, 0.0).tolist() if names else ()
        return next((n for n, margin in zip(names, margins, strict=True) if margin == 0.0), None)

    def _standing(self, mode: Mode) -> tuple[tuple[str, ...], Tape]:
        """Return the conditions whose margins do not change in a mode, and these on tape."""
        automaton = self._automaton
        still, solved = set(automaton.parameters), dict(mode.definitions)
        still |= {
            variable
            for place, (variable, rate) in enumerate(
                zip(automaton.variables, mode.rates, strict=True)
            )
            if solved.get(rate, rate).is_zero and place not in mode.eliminated
        }
        margins = {
            margin.name: margin.expression
            for margin in mode.margins[len(mode.margins) - len(automaton.stops) :]
            if margin.name in self._counted and margin.expression.free_symbols <= still
        }
        return tuple(margins), automaton.tape(tuple(margins.values()))
