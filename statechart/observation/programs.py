"""Formulas over an automaton's observables as programs, compiled once each for all runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeAlias

import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Mode
from statechart.automaton.trace import Key
from statechart.formulas.formula import parse
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape
from statechart.observation.flows import Where, places_in

FormulaLike: TypeAlias = "str | int | float | sp.Expr"
"""Text over the observables' names, or an expression in the automaton's own symbols."""


@dataclass(frozen=True, eq=False)
class Active:
    """What is integrated in one mode: places among the formulas, and whether it is solved for."""

    places: list[int]
    expressions: tuple[sp.Expr, ...]
    needed: bool


class Programs:
    """Makes programs of formulas, and keeps them.

    Attributes
    ----------
    solved : tuple of sympy.Symbol
        What a mode solves for, or sets.
    """

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        self._expressions: dict[str | int | float, sp.Expr] = {}
        self.solved = (*automaton.unknowns, *automaton.controls)
        given = (*automaton.variables, *automaton.parameters, automaton.time)
        self._given: frozenset[sp.Basic] = frozenset(given)
        self._needs: dict[tuple[sp.Expr, ...], bool] = {}
        self._tapes: dict[tuple[tuple[sp.Expr, ...], Mode | None, bool], Tape] = {}
        self._actives: dict[tuple[Key, tuple[Where, ...], tuple[sp.Expr, ...]], Active] = {}

    def expression(self, formula: FormulaLike) -> sp.Expr:
        """Return a formula in the automaton's symbols.

        Raises
        ------
        FormulaError
            If it cannot be read, or uses a name that is no observable.
        """
        if isinstance(formula, sp.Expr):
            return formula
        if formula not in self._expressions:
            self._expressions[formula] = parse(formula).to_sympy(self._automaton.observables)
        return self._expressions[formula]

    def expressions(self, formulas: Iterable[FormulaLike]) -> tuple[sp.Expr, ...]:
        """Return formulas in the automaton's symbols."""
        return tuple([self.expression(formula) for formula in formulas])

    def active(
        self, key: Key, where: tuple[Where, ...], expressions: tuple[sp.Expr, ...]
    ) -> Active:
        """Return what is integrated in the mode `key`."""
        known = self._actives.get((key, where, expressions))
        if known is not None:
            return known
        places = places_in(self._automaton.told(key), key, where)
        chosen = tuple([expressions[i] for i in places])
        found = Active(places, chosen, self.needed(chosen))
        self._actives[key, where, expressions] = found
        return found

    def needed(self, expressions: tuple[sp.Expr, ...]) -> bool:
        """Tell whether the expressions use what a mode solves for."""
        found = self._needs.get(expressions)
        if found is None:
            found = any(e.free_symbols - self._given for e in expressions)
            self._needs[expressions] = found
        return found

    def tape(
        self, expressions: tuple[sp.Expr, ...], mode: Mode | None, *, known: bool = False
    ) -> Tape:
        """Return the program for expressions in a mode, or in any that they do not depend on.

        `known`: over states with the unknowns and controls appended.
        """
        key = (expressions, mode, known)
        tape = self._tapes.get(key)
        if tape is None:
            automaton = self._automaton
            tape = self._tapes[key] = compile_tape(
                expressions,
                variables=(*automaton.variables, *(self.solved if known else ())),
                parameters=automaton.parameters,
                time=automaton.time,
                definitions=mode.definitions if mode else (),
            )
        return tape
