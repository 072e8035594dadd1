"""Minimal coordinates: holonomic constraints of a mode, solved in closed form.

Where the coordinates are phi(z, t), the others z move by fewer equations, in which the forces that
hold the rest do no work (J. L. Lagrange's equations of the second kind). These forces follow from
the equations of the coordinates that were eliminated.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from statechart.automaton.regions import Hold

# A coordinate is eliminated where a unit of it moves what is held by so many at least: the ones of
# mechanics are 1.
_MIN_PIVOT = 0.5

Known = Mapping[sp.Symbol, sp.Expr]


@dataclass(frozen=True, eq=False)
class Elimination:
    """Coordinates that follow from the others in a mode."""

    # Coordinate eliminated -> expression of those left, of parameters, time and anchors.
    positions: Known
    # Its rate and its acceleration -> expression of variables and accelerations that are left.
    rates: Known
    accelerations: Known
    anchors: Known  # Constant of a flow -> the expression of the variables that is constant in it.
    # Equation for accelerations -> place of the coordinate whose equation stands for it now.
    replaced: Mapping[sp.Expr, int]
    forces: frozenset[sp.Symbol]  # Those that hold the coordinates eliminated.
    # They may move without bound when the others move: forces are then lost in the
    # difference of accelerations, so that these are found together.
    steep: bool

    @property
    def known(self) -> dict[sp.Symbol, sp.Expr]:
        """Expressions that replace positions and rates in equations, without anchors."""
        without_anchors = {q: e for q, e in self.positions.items() if not e.has(*self.anchors)}
        return {**without_anchors, **self.rates}


@dataclass(frozen=True, eq=False)
class Coordinates:
    """The coordinates of an automaton whose equations are those of mechanics."""

    # Coordinate by coordinate; the first unknowns of the automaton are the accelerations, and its
    # first equations are theirs.
    positions: tuple[sp.Symbol, ...]
    rates: tuple[sp.Symbol, ...]
    accelerations: tuple[sp.Symbol, ...]
    time: sp.Symbol
    joints: tuple[Hold, ...]  # Holds of every mode.
    # From an `Elimination` and the forces that may do work beside it to the equations of motion
    # (each = 0) of the coordinates that are left, in their order.
    motion: Callable[[Elimination, Collection[sp.Symbol]], Sequence[sp.Expr]]
    written: Known  # Parameters that the document does not declare -> how a person writes them.
    # Parameter: the unit of mass in which modes are solved; where it is 0, in that of the model.
    mass_unit: sp.Symbol | None = None

    def remaining(self, elimination: Elimination) -> tuple[int, ...]:
        """Return the places of the coordinates that are left."""
        return tuple(i for i, q in enumerate(self.positions) if q not in elimination.positions)

    def rate(self, expression: sp.Expr) -> sp.Expr:
        """Return the total derivative with respect to time."""
        first = zip(self.positions, self.rates, strict=True)
        second = zip(self.rates, self.accelerations, strict=True)
        used = expression.free_symbols
        terms = [sp.diff(expression, x) * dx for x, dx in (*first, *second) if x in used]
        return sp.Add(sp.diff(expression, self.time), *terms)


def eliminated(
    coordinates: Coordinates,
    mode_holds: Iterable[Hold],
    substitution: Known,
    laws: Collection[sp.Expr] = (),
) -> Elimination | None:
    """Solve constraints for coordinates in closed form; None where some have no such solution.

    A loop that its last joint closes, or a circle, would have to be kept on what it holds by a
    projection that then moves what was eliminated.
    """
    positions: dict[sp.Symbol, sp.Expr] = {}
    anchors: dict[sp.Symbol, sp.Expr] = {}
    replaced: dict[sp.Expr, int] = {}
    forces: set[sp.Symbol] = set()
    holds = (*coordinates.joints, *mode_holds)
    for hold in holds:
        # Friction depends on it, or other rows imply it.
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
    return Elimination(
        positions,
        {rate[q]: e.xreplace(anchors) for q, e in first.items()},
        {follows[q]: coordinates.rate(e).xreplace(anchors) for q, e in first.items()},
        anchors,
        replaced,
        frozenset(forces),
        any(hold.steep for hold in holds),
    )


def _pivot(place: sp.Expr, coordinates: Coordinates) -> tuple[sp.Symbol, sp.Expr] | None:
    """Return the coordinate that a place (= 0) is best solved for, and its expression."""
    best: tuple[float, sp.Symbol, sp.Expr] | None = None
    for coordinate in coordinates.positions:
        if not place.has(coordinate):
            continue
        pivot = sp.diff(place, coordinate)
        if pivot.is_number and abs(pivot) >= max(_MIN_PIVOT, best[0] if best else 0.0):
            value = place.xreplace({coordinate: sp.S.Zero}) / -pivot
            best = float(abs(pivot)), coordinate, sp.expand_mul(value)
    return None if best is None else best[1:]
