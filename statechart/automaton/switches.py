"""Switching surfaces of abs, sign, min, max, sat and atan2 in a mode (Filippov 1988).

A switch has a switching function sigma and a sign: +1 or -1 on the sides of the surface sigma = 0;
in a sliding mode the convex combination of both vector fields that keeps sigma = 0. Modes are built
for the signs that occur in a run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.automaton.margin_derivatives import time_derivative
from statechart.automaton.regions import Margin, Mode
from statechart.automaton.trace import Role
from statechart.formulas.linear import Definition, solve_linear
from statechart.formulas.tape import Tape
from statechart.formulas.writer import compile_tape, to_text

SIGN_OF, SLIDE_ON = "sign of ", "slide on "
"""Prefixes of margins: of a switching function, and of a sliding condition."""
SLIDES, RESTS = 0, 2
"""Signs of a sliding switch, and of one whose function is zero for any sign."""
MAX_ORDER = 2
"""Largest relative degree of a switching function with respect to its sign."""

_SHOWN = 80  # characters of a switching function in a name
_KINKS = (sp.Abs, sp.sign, sp.Max, sp.Min, sp.atan2)


@dataclass(frozen=True, eq=False)
class Switches:
    """The switches of a mode."""

    mode: Mode  # with abs, sign, min and max
    texts: tuple[str, ...]  # switching functions in the names of the model
    signs: tuple[sp.Symbol, ...]
    functions: tuple[sp.Expr, ...]  # in signs of earlier ones
    definitions: tuple[Definition, ...]  # of the mode, in the signs
    rates: tuple[sp.Expr, ...]
    margins: tuple[Margin, ...]
    derivatives: tuple[tuple[sp.Expr, ...], ...]  # of each function, up to the relative degree
    acts: tuple[bool, ...]  # whether signs act on the last derivative
    removable: tuple[bool, ...]  # whether a sign acts on the first derivative off the surface only
    tape: Tape  # functions, time derivatives, gradients; of variables and signs
    places: tuple[int, ...]  # indices of the first derivatives in the tape
    gradients: int  # index of the gradients
    automaton: Automaton
    signed_variables: tuple[int, ...]  # whose rates depend on signs

    def mode_with_signs(self, signs: Any) -> Mode:
        """Return the mode with these signs: 1, -1, `SLIDES` or `RESTS`."""
        count = len(self.mode.margins) - len(self.automaton.stop_margins)
        sliding = [i for i, n in enumerate(signs) if n == SLIDES]
        pairs = zip(self.signs, signs, strict=True)
        known = {s: sp.Integer(n if abs(n) == 1 else 0) for s, n in pairs if n != SLIDES}
        # A root of a switching function that stays zero has no slope.
        switches = zip(self.functions, signs, self.removable, strict=True)
        zero = [f for f, n, removable in switches if removable and n in (SLIDES, RESTS)]
        held = _solutions(zero, self.automaton.variables)
        on_surfaces = [(s, e.xreplace(held)) for s, e in self.definitions]
        definitions, sliding_shares = self._sliding(on_surfaces, sliding, known)
        known |= {self.signs[i]: share for i, share in zip(sliding, sliding_shares, strict=True)}
        own = [margin.replaced(known) for margin in self.margins]
        names = set[str]()
        margins = []
        for i, (function, sign) in enumerate(zip(self.functions, signs, strict=True)):
            sign_expression = function.xreplace(known)
            # A function that rests is expected to stay zero, but its rate may vary.
            for side in (1, -1) if sign == RESTS else (sign,):
                if abs(side) == 1 and self._moves(sign_expression):
                    margins.append(_margin(SIGN_OF + self.texts[i], side * sign_expression, names))
        for i, share in zip(sliding, sliding_shares, strict=True):
            margins += [
                _margin(f"{SLIDE_ON}{self.texts[i]}, {side}", 1 + sign * share, names)
                for sign, side in ((-1, "above"), (1, "below"))
            ]
        rates = tuple(rate.xreplace(known) for rate in self.rates)
        margins = [*own[:count], *margins, *own[count:]]
        new: Any = {"definitions": tuple(definitions), "rates": rates, "margins": tuple(margins)}
        return replace(self.mode, **new)

    def _moves(self, function: sp.Expr) -> bool:
        return not function.free_symbols <= {*self.automaton.parameters}

    def _sliding(
        self,
        on_surfaces: Sequence[Definition],
        sliding: Sequence[int],
        known: Mapping[sp.Symbol, sp.Expr],
    ) -> tuple[list[Definition], list[sp.Symbol]]:
        """Return the definitions of a sliding mode, and the symbols of its signs.

        Unknowns are affine in the signs: one sign is interpolated between its sides, several from
        the centre.
        """
        if not sliding:
            return [(s, e.xreplace(known)) for s, e in on_surfaces], []
        signs = [self.signs[i] for i in sliding]
        corners: list[dict[sp.Symbol, sp.Expr]] = []
        for i in signs:
            corners += [{**dict.fromkeys(signs, sp.S.Zero), i: sp.Integer(n)} for n in (1, -1)]
        if len(signs) > 1:
            corners.append(dict.fromkeys(signs, sp.S.Zero))
        definitions: list[Definition] = []
        corner_symbols: list[dict[sp.Symbol, sp.Expr]] = [{**known, **corner} for corner in corners]
        dependent = {*signs}
        blended = []
        for symbol, expression in on_surfaces:
            if not expression.free_symbols & dependent:
                definitions.append((symbol, expression.xreplace(known)))
                continue
            dependent.add(symbol)
            blended.append(symbol)
            for k, corner in enumerate(corner_symbols):
                corner_value = sp.Symbol(f"{symbol}_{k}", real=True)
                definitions.append((corner_value, expression.xreplace(corner)))
                corner[symbol] = corner_value
        shares = [sp.Symbol(f"share{k}", real=True) for k in range(len(signs))]

        def blend(values: Sequence[sp.Expr]) -> sp.Expr:
            """Return the combination of values at the corners."""
            middle = values[-1] if len(signs) > 1 else (values[0] + values[1]) / 2
            changes = zip(shares, values[0::2], values[1::2], strict=False)
            return sp.Add(middle, *(share * (up - down) / 2 for share, up, down in changes))

        equations = []
        for i in sliding:
            highest = self.derivatives[i][-1]
            values = []
            for k, corner in enumerate(corner_symbols):
                value = sp.Symbol(f"slope{i}_{k}", real=True)
                definitions.append((value, highest.xreplace(corner)))
                values.append(value)
            equations.append(blend(values))
        definitions += solve_linear(equations, shares)
        fixed: dict[sp.Symbol, sp.Expr] = {}
        for i in sliding:
            # The sliding condition holds exactly, not as the difference of both sides.
            highest = self.derivatives[i][-1]
            for symbol in blended:
                factor = sp.diff(highest, symbol)
                remainder = highest - factor * symbol
                used = set().union(*(e.free_symbols for e in fixed.values()))
                if symbol in used or remainder.free_symbols & {symbol, *fixed, *signs}:
                    continue
                if factor.is_number and factor != 0:
                    fixed[symbol] = -remainder.xreplace(known) / factor
                    break
        for symbol in (s for s in blended if s not in fixed):
            definitions.append((symbol, blend([corner[symbol] for corner in corner_symbols])))
        definitions += fixed.items()
        return definitions, shares


def _dependent(symbols: set[sp.Symbol], definitions: Mapping[sp.Symbol, sp.Expr]) -> set[sp.Symbol]:
    """Return symbols and the definitions that depend on them."""
    dependent = {*symbols}
    for symbol, expression in definitions.items():
        if expression.free_symbols & dependent:
            dependent.add(symbol)
    return dependent


def _solutions(
    functions: Sequence[sp.Expr], variables: Sequence[sp.Symbol]
) -> dict[sp.Expr, sp.Expr]:
    """Return variables on the surfaces of functions, where they have constant coefficients."""
    solved: dict[sp.Expr, sp.Expr] = {}
    for function in functions:
        reduced = function.xreplace(solved)
        for variable in variables:
            slope = sp.diff(reduced, variable) if variable in reduced.free_symbols else sp.S.Zero
            if slope.is_number and slope != 0:
                value = sp.expand(variable - reduced / slope)
                solved = {v: e.xreplace({variable: value}) for v, e in solved.items()}
                solved[variable] = value
                break
    return solved


def _margin(name: str, expression: sp.Expr, names: set[str]) -> Margin:
    """Return a margin with a name not in `names`."""
    unique, count = name, 1
    while unique in names:
        count += 1
        unique = f"{name} ({count})"
    names.add(unique)
    # Internal: no margin of a whole relation.
    return Margin(unique, expression, relation=unique)


def explicit_rates(mode: Mode) -> list[sp.Expr]:
    """Return the rates of the variables of a mode without unknowns."""
    values: dict[sp.Symbol, sp.Expr] = {}
    for symbol, expression in mode.definitions:
        values[symbol] = expression.xreplace(values)
    return [rate.xreplace(values) for rate in mode.rates]


def slides(role: Role) -> bool:
    """Return whether a flow slides along a switching surface."""
    signs: Any = role.share
    return SLIDES in signs


def is_of_switch(margin: str) -> bool:
    """Return whether a margin is of a switch."""
    return margin.startswith((SIGN_OF, SLIDE_ON))


def switches_of(automaton: Automaton, mode: Mode) -> Switches | None:
    """Return the switches of a mode, or None."""
    reader = _Reader(automaton, mode)
    # Guards end smooth pieces, too: a guard that stays on its boundary is evaluated at their start.
    guards = [margin.expression for margin in mode.margins if margin.kind == "plain"]
    needed = set[sp.Symbol]().union(*(e.free_symbols for e in (*mode.rates, *guards)))
    for symbol, e in reversed(mode.definitions):
        if symbol in needed:
            needed |= e.free_symbols
    read = {symbol: reader.read(e) for symbol, e in mode.definitions if symbol in needed}
    rates = tuple(reader.read(rate) for rate in mode.rates)
    reader.cuts = False
    margins = tuple(
        replace(m, expression=reader.read(m.expression)) if m.kind == "plain" else m
        for m in mode.margins
    )
    if not reader.signs:
        return None
    # Definitions that affect neither motion nor guards, as contact forces, add no switches.
    reader.adds = False
    definitions = tuple((s, read[s] if s in read else reader.read(e)) for s, e in mode.definitions)
    chains, acts, removable = reader.chains(dict(definitions), rates)
    functions = tuple(reader.functions)
    outputs, places = [*functions], []
    for chain in chains:
        places.append(len(outputs))
        outputs += chain
    gradients = len(outputs)
    outputs += [sp.diff(function, v) for function in functions for v in automaton.variables]
    tape = compile_tape(
        outputs, variables=(*automaton.variables, *reader.signs), time=automaton.time,
        parameters=automaton.parameters, definitions=definitions,
    )  # fmt: skip
    texts = tuple(reader.text(function) for function in functions)
    dependent = _dependent({*reader.signs}, dict(definitions))
    signed = tuple(k for k, rate in enumerate(rates) if rate.free_symbols & dependent)
    return Switches(
        mode, texts, tuple(reader.signs), functions, definitions, rates, margins, chains, acts,
        removable, tape, tuple(places), gradients, automaton, signed,
    )  # fmt: skip


class _Reader:
    """Rewrites nonsmooth formulas in the signs of their switches."""

    def __init__(self, automaton: Automaton, mode: Mode) -> None:
        self._automaton = automaton
        self._definitions = dict(mode.definitions)
        self._moving = {*automaton.variables, automaton.time}
        self.read = cache(self._rewritten)
        self._places: dict[sp.Expr, int] = {}
        self._backs: dict[sp.Expr, sp.Expr] = {}  # Opposite directions in angles, for texts
        self.signs: list[sp.Symbol] = []
        self.functions: list[sp.Expr] = []
        self.adds = self.cuts = True

    def _rewritten(self, node: sp.Expr) -> sp.Expr:
        """Return a formula with signs instead of nonsmooth functions."""
        if not node.has(*_KINKS):
            return node
        arguments = [self.read(argument) for argument in node.args]
        if node.is_Pow and not node.exp.is_Integer and node.base.is_nonnegative:
            # Stages of a step may be beyond the surface.
            return sp.Abs(arguments[0]) ** arguments[1]
        if not isinstance(node, _KINKS) or not any(map(self._moves, node.args)):
            return node.func(*arguments)
        if isinstance(node, sp.Abs | sp.sign):
            sign = self._sign(arguments[0])
            if sign is None:
                return node.func(*arguments)
            return sign * arguments[0] if isinstance(node, sp.Abs) else sign
        if isinstance(node, sp.atan2):
            return self._angle(*arguments)
        # Constants last, for simpler switching functions.
        ordered = sorted(arguments, key=sp.default_sort_key)
        extremum, *rest_of_arguments = sorted(ordered, key=self._moves, reverse=True)
        for other in rest_of_arguments:
            sign = self._sign(extremum - other)
            if sign is None:
                return node.func(*arguments)
            if isinstance(node, sp.Min):
                sign = -sign
            extremum = (1 + sign) / 2 * extremum + (1 - sign) / 2 * other
        return extremum

    def _angle(self, y: sp.Expr, x: sp.Expr) -> sp.Expr:
        """Return ``atan2(y, x)``, for negative x of the opposite direction: its cut is a switch."""
        angle = sp.atan2(y, x)
        if not self.cuts or x.is_nonnegative:
            return angle
        ahead, side = self._sign(x), self._sign(y)
        if ahead is None or side is None:
            return angle
        # Where y stays zero, with the sign 0, the angle of a negative x is pi.
        back, turn = sp.atan2(-y, -x), sp.pi * (1 + side - side**2)
        self._backs[back] = angle - turn
        return (1 + ahead) / 2 * angle + (1 - ahead) / 2 * (back + turn)

    def _sign(self, function: sp.Expr) -> sp.Expr | None:
        """Return the sign of a switching function up to orientation; None if it is not added."""
        function = self._expanded(function)
        factor, monic = function.as_coeff_Mul()
        if monic.could_extract_minus_sign():
            factor, monic = -factor, -monic
        place = self._places.get(monic)
        if place is None and not self.adds:
            return None
        if place is None:
            place = self._places[monic] = len(self.signs)
            self.signs.append(sp.Symbol(f"sign{place}", real=True))
            self.functions.append(monic)
        return self.signs[place] if factor > 0 else -self.signs[place]

    def _expanded(self, expression: sp.Expr) -> sp.Expr:
        """Return an expression with the definitions of the mode substituted."""
        while defined := {s for s in expression.free_symbols if s in self._definitions}:
            expression = expression.xreplace({s: self.read(self._definitions[s]) for s in defined})
        return expression

    def _moves(self, expression: sp.Expr) -> bool:
        symbols = self._expanded(expression).free_symbols
        return bool(symbols & self._moving) or any(s in symbols for s in self.signs)

    def chains(
        self, definitions: Mapping[sp.Symbol, sp.Expr], rates: Sequence[sp.Expr]
    ) -> tuple[tuple[tuple[sp.Expr, ...], ...], tuple[bool, ...], tuple[bool, ...]]:
        """Return the derivatives of each function, whether signs act on the last, and `removable`.

        Derivatives are those on the surface: there a sign does not act by `sign(s)*sqrt(abs(s))`.
        """
        variables = self._automaton.variables
        rooted = {
            s for e in (*definitions.values(), *rates) for a in e.atoms(sp.Abs)
            for s in a.free_symbols
        }  # fmt: skip
        chains, acts, removable = [], [], []
        for function, sign in zip(self.functions, self.signs, strict=True):
            values, of = definitions, dict(zip(variables, rates, strict=True))
            slope = self._slope(function, of, values)
            held = _solutions([function], variables) if sign in rooted else {}
            if held and slope.free_symbols & _dependent({sign}, values):
                on_surface = {s: e.xreplace(held) for s, e in definitions.items()}
                rates_there = {v: rate.xreplace(held) for v, rate in of.items()}
                reduced = self._slope(function, rates_there, on_surface)
                if not reduced.free_symbols & _dependent({sign}, on_surface):
                    values, of, slope = on_surface, rates_there, reduced
            removable.append(values is not definitions)
            sign_dependent = _dependent({*self.signs}, values)
            chain = [slope]
            while len(chain) < MAX_ORDER and not chain[-1].free_symbols & sign_dependent:
                chain.append(self._slope(chain[-1], of, values))
            chains.append(tuple(chain))
            acts.append(bool(chain[-1].free_symbols & sign_dependent))
        return tuple(chains), tuple(acts), tuple(removable)

    def _slope(
        self,
        expression: sp.Expr,
        rates: Mapping[sp.Symbol, sp.Expr],
        definitions: Mapping[sp.Symbol, sp.Expr],
    ) -> sp.Expr:
        while defined := {s for s in expression.free_symbols if s in definitions}:
            expression = expression.xreplace({s: definitions[s] for s in defined})
        return time_derivative(expression, rates, self._automaton.time)

    def text(self, function: sp.Expr) -> str:
        """Return a switching function in the names of the model, with angles as declared."""
        if function.atoms(sp.atan2) & self._backs.keys():
            function = sp.expand_mul(function.xreplace(self._backs))
        symbols = (*self._automaton.variables, *self._automaton.parameters)
        model_names = (*self._automaton.names, *self._automaton.parameter_names)
        names: dict[Any, Any] = dict(zip(symbols, map(sp.Symbol, model_names), strict=True))
        names |= {self._automaton.time: sp.Symbol("time")}
        for sign, inner in zip(self.signs, self.functions, strict=True):
            names[sign] = sp.Symbol(f"sign({to_text(inner.xreplace(names))})")
        return to_text(function.xreplace(names))[:_SHOWN]
