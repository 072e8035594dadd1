"""Parameters that are formulas of each other, in the order in which they can be evaluated."""

from __future__ import annotations

import graphlib
from collections.abc import Collection, Mapping

from statechart.errors import FormulaError, close_matches
from statechart.formulas.formula import Formula, parse
from statechart.formulas.hints import meant
from statechart.formulas.tree import CONSTANTS, FUNCTIONS, names_in


def order_parameters(
    formulas: Mapping[str, Formula], given: Collection[str] = ()
) -> tuple[str, ...]:
    """Return the names so that each comes after those that its formula uses.

    Raises `FormulaError` if a name is not a parameter, or parameters depend on each other in a
    circle.
    """
    for name, formula in formulas.items():
        for used in names_in(formula.root):
            if used.name not in formulas and used.name not in given:
                formula._source.fail(
                    f"unknown name {used.name!r}",
                    used.offset,
                    meant(used.name, formulas, FUNCTIONS, CONSTANTS),
                    name=name,
                )
    uses = {name: sorted(formula.names.difference(given)) for name, formula in formulas.items()}
    try:
        return tuple(graphlib.TopologicalSorter(uses).static_order())
    except graphlib.CycleError as error:
        # graphlib lists each node before those that use it; readers follow "uses".
        cycle = list(reversed(error.args[1]))
        formulas[cycle[0]]._source.fail(
            f"parameters need each other: {' -> '.join(cycle)}",
            advice="give one of them a value of its own",
            name=cycle[0],
        )


class Constants:
    """Parameters that are formulas of each other, in the order in which they can be evaluated."""

    def __init__(self, formulas: Mapping[str, Formula]) -> None:
        self.formulas = formulas
        self._orders: dict[frozenset[str], tuple[str, ...]] = {}

    def values(self, overrides: Mapping[str, float]) -> dict[str, float]:
        """Return the value of every parameter.

        Raises `FormulaError` if an override names no parameter, or a formula has no value.
        """
        for name in overrides:
            if name not in self.formulas:
                raise FormulaError(
                    f"unknown parameter {name!r}",
                    advice=close_matches(name, self.formulas),
                    name=name,
                )
        given = frozenset(overrides)
        if given not in self._orders:
            left = {n: f for n, f in self.formulas.items() if n not in given}
            self._orders[given] = order_parameters(left, given)
        values = {name: parse(value).value({}) for name, value in overrides.items()}
        for name in self._orders[given]:
            try:
                values[name] = self.formulas[name].value(values)
            except FormulaError as error:
                error.name = name
                raise
        return {name: values[name] for name in self.formulas}
