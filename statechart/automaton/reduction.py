"""Minimal coordinates: holonomic constraints of a mode, solved in closed form.

With coordinates phi(z, t), the independent ones z satisfy Lagrange's equations of the second kind,
in which constraint forces do no work. The constraint forces follow from the equations of the
eliminated coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from statechart.automaton.regions import Hold

# Least gradient of a constraint in an eliminated coordinate; those of mechanics are 1.
_MIN_PIVOT = 0.5

Known = Mapping[sp.Symbol, sp.Expr]


@dataclass(frozen=True, eq=False)
class Elimination:
    """Eliminated coordinates of a mode."""

    positions: Known  # eliminated coordinate -> expression of the others, parameters, time, anchors
    rates: Known  # its rate and acceleration -> expressions of the remaining variables
    accelerations: Known
    anchors: Known  # constant of a flow -> expression of the variables
    replaced: Mapping[sp.Expr, int]  # constraint equation -> index of the coordinate that it pairs
    forces: frozenset[sp.Symbol]  # constraint forces
    # Gradients may grow without bound: forces and accelerations are then solved together, since
    # their difference would cancel.
    steep: bool

    @property
    def known(self) -> dict[sp.Symbol, sp.Expr]:
        """Substitutions of positions and rates in equations, without anchors."""
        without_anchors = {q: e for q, e in self.positions.items() if not e.has(*self.anchors)}
        return {**without_anchors, **self.rates}


@dataclass(frozen=True, eq=False)
class Coordinates:
    """The coordinates of a mechanical automaton.

    Its first unknowns are the accelerations, and its first equations those of motion.
    """

    positions: tuple[sp.Symbol, ...]
    rates: tuple[sp.Symbol, ...]
    accelerations: tuple[sp.Symbol, ...]
    rate: Callable[[sp.Expr], sp.Expr]  # total derivative with respect to time
    joints: tuple[Hold, ...]  # holds of every mode
    # (elimination, applied forces) -> equations of motion (each = 0) of the remaining coordinates
    motion: Callable[[Elimination, Collection[sp.Symbol]], Sequence[sp.Expr]]
    written: Known  # undeclared parameters -> expressions shown to users
    mass_unit: sp.Symbol | None = None  # parameter by which modes are scaled, unless it is 0

    def remaining(self, elimination: Elimination) -> tuple[int, ...]:
        """Return the indices of the remaining coordinates."""
        return tuple(i for i, q in enumerate(self.positions) if q not in elimination.positions)


def eliminate(
    coordinates: Coordinates,
    mode_holds: Iterable[Hold],
    substitution: Known,
    laws: Collection[sp.Expr] = (),
) -> Elimination | None:
    """Solve constraints for coordinates in closed form; None if one has no such solution.

    Partial elimination is not possible: the projection of a kinematic loop or a circle would move
    eliminated coordinates.
    """
    positions: dict[sp.Symbol, sp.Expr] = {}
    anchors: dict[sp.Symbol, sp.Expr] = {}
    replaced: dict[sp.Expr, int] = {}
    forces: set[sp.Symbol] = set()
    holds = (*coordinates.joints, *mode_holds)
    for hold in holds:
        # Friction depends on the force, or other rows imply the constraint.
        equations = (e.xreplace(substitution) for e in (*hold.equations, *laws))
        if any(e.has(*hold.forces) for e in equations):
            return None
        expressions = positions
        solved: list[sp.Symbol] = []
        for place in hold.places:
            pivot = _pivot(place.xreplace(substitution).xreplace(expressions), coordinates)
            if pivot is None:
                return None
            symbol, value = pivot
            expressions = {q: e.xreplace({symbol: value}) for q, e in expressions.items()}
            expressions[symbol] = value
            solved.append(symbol)
        positions = expressions
        places = (coordinates.positions.index(symbol) for symbol in solved)
        replaced |= dict(zip(hold.equations, places, strict=True))
        anchors |= hold.anchors
        forces |= {*hold.forces}
    if not positions:
        return None
    first = {q: coordinates.rate(e) for q, e in positions.items()}
    rate = dict(zip(coordinates.positions, coordinates.rates, strict=True))
    follows = dict(zip(coordinates.positions, coordinates.accelerations, strict=True))
    rates = {rate[q]: e.xreplace(anchors) for q, e in first.items()}
    second = {follows[q]: coordinates.rate(e).xreplace(anchors) for q, e in first.items()}
    steep = any(hold.steep for hold in holds)
    return Elimination(positions, rates, second, anchors, replaced, frozenset(forces), steep)


def _pivot(place: sp.Expr, coordinates: Coordinates) -> tuple[sp.Symbol, sp.Expr] | None:
    """Return the coordinate for which a constraint (= 0) is best solved, and its solution."""
    best: tuple[float, sp.Symbol, sp.Expr] | None = None
    for coordinate in coordinates.positions:
        if not place.has(coordinate):
            continue
        pivot = sp.diff(place, coordinate)
        if pivot.is_number and abs(pivot) >= max(_MIN_PIVOT, best[0] if best else 0.0):
            value = place.xreplace({coordinate: sp.S.Zero}) / -pivot
            best = float(abs(pivot)), coordinate, sp.expand_mul(value)
    return None if best is None else best[1:]
