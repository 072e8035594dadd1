"""Equations of motion of a mode as text, JSON or LaTeX."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import NamedTuple

import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.automaton.laws import Setup, roles_in
from statechart.automaton.modes import build_mode
from statechart.automaton.reduction import Coordinates, Elimination, eliminate
from statechart.automaton.trace import Key
from statechart.errors import DeclarationError, close_matches
from statechart.formulas.writer import to_text
from statechart.tabular import ALL_DIGITS

# Integers below this are written without a decimal point.
_WHOLE = 1e6
# Longer formulas are not simplified, which takes too long.
_MAX_OPERATIONS = 400
# Fractions with a larger denominator are written as decimal numbers.
_MAX_DENOMINATOR = 12

Equation = tuple[sp.Expr, sp.Expr]
"""Left and right side."""


class EquationBlock(NamedTuple):
    """Equations under a title."""

    title: str
    equations: tuple[Equation, ...]


def format_equations(
    automaton: Automaton, setup: Setup, mode: str, form: str, digits: int = ALL_DIGITS
) -> str:
    """Return the equations of a mode as text, JSON or LaTeX; see `blocks`.

    A prime is a derivative with respect to time. Numbers have so many significant digits.
    """
    key = mode_named(automaton, mode)
    declared = automaton.declaration.parameters
    zeros = ((automaton.parameter_names[i], automaton.parameters[i]) for i in setup.zeros)
    made = blocks(automaton, key, frozenset(s for name, s in zeros if name not in declared))
    if digits < ALL_DIGITS:
        for k, (title, rows) in enumerate(made):
            rounded = ((_round_side(a, digits), _round_side(b, digits)) for a, b in rows)
            made[k] = EquationBlock(title, tuple(rounded))
    return _FORMS[form](automaton, key, made)


def _round_side(side: sp.Expr, digits: int) -> sp.Expr:
    numbers = {x: sp.Float(x, digits) for x in side.atoms(sp.Float)}
    whole = {x: y for x, y in numbers.items() if float(y).is_integer() and abs(y) < _WHOLE}
    return side.xreplace({**numbers, **{x: sp.Integer(int(y)) for x, y in whole.items()}})


def mode_named(automaton: Automaton, text: object) -> Key:
    """Parse the name of a mode: ``tip:pin``, ``A:free B:slide+``, or ``pin`` for one region."""
    example = automaton.label(tuple(r.states[0] for r in automaton.regions))
    if not isinstance(text, str):
        message = f"a mode is text, a state of every region, not {text!r}"
        raise DeclarationError(message, advice=f"such as {example!r}")
    states: dict[str, str] = {}
    for word in text.replace(",", " ").split():
        name, _, state = word.rpartition(":")
        if not name and len(automaton.regions) == 1:
            name = automaton.regions[0].name
        region = next((r for r in automaton.regions if r.name == name), None)
        if region is None or state not in region.states:
            known = [f"{r.name}:{s}" for r in automaton.regions for s in r.states]
            raise DeclarationError(
                f"mode {text!r}: there is no state {word!r}",
                advice=close_matches(word, known) or f"there are {', '.join(known)}",
            )
        states[name] = state
    missing = [region.name for region in automaton.regions if region.name not in states]
    if missing:
        advice = f"name one of every region, such as {example}"
        raise DeclarationError(f"mode {text!r}: no state of {', '.join(missing)}", advice=advice)
    return tuple(states[region.name] for region in automaton.regions)


def _lines(automaton: Automaton, block: EquationBlock) -> list[str]:
    names = {symbol: sp.Symbol(name) for symbol, name in _names(automaton).items()}

    def text(side: sp.Expr) -> str:
        return to_text(side.xreplace(names), full_prec=False)

    return [" = ".join(map(text, sides)) for sides in block.equations]


def _text(automaton: Automaton, key: Key, made: Sequence[EquationBlock]) -> str:
    lines = [f"{automaton.name}, {automaton.label(key)}"]
    for block in made:
        lines += [f"{block.title}:", *(f"  {line}" for line in _lines(automaton, block))]
    return "\n".join(lines) + "\n"


def _json(automaton: Automaton, key: Key, made: Sequence[EquationBlock]) -> str:
    mode = {region.name: state for region, state in zip(automaton.regions, key, strict=True)}
    equations = {block.title: _lines(automaton, block) for block in made}
    return json.dumps({"model": automaton.name, "mode": mode, **equations}, indent=2) + "\n"


def _latex(automaton: Automaton, key: Key, made: Sequence[EquationBlock]) -> str:
    sides = [side for block in made for equation in block.equations for side in equation]
    called = {symbol: symbol.name for side in sides for symbol in side.free_symbols}
    called |= _names(automaton)
    names = {symbol: _typeset(automaton, name) for symbol, name in called.items()}
    lines = [f"% {automaton.name}, {automaton.label(key)}"]
    for block in made:
        lines += [f"% {block.title}", r"\begin{align*}"]
        for equation in block.equations:
            pair = (sp.latex(side, symbol_names=names) for side in equation)
            lines.append(rf"  {' &= '.join(pair)} \\")
        lines.append(r"\end{align*}")
    return "\n".join(lines) + "\n"


_FORMS = {"text": _text, "latex": _latex, "json": _json}


def _names(automaton: Automaton) -> dict[sp.Symbol, str]:
    """Return symbol -> name, with primes for derivatives."""
    found: dict[sp.Symbol, str] = {e: n for n, e in automaton.observables.items() if e.is_Symbol}
    found |= dict(zip(automaton.parameters, automaton.parameter_names, strict=True))
    coordinates = automaton.coordinates
    moving = automaton.variables if coordinates is None else coordinates.positions
    called = dict(zip(automaton.variables, automaton.names, strict=True))
    for place, symbol in enumerate(moving):
        found[symbol] = called[symbol]
        if coordinates is None:
            found[automaton.rates[place]] = f"{called[symbol]}'"
        else:
            found[coordinates.rates[place]] = f"{called[symbol]}'"
            found[coordinates.accelerations[place]] = f"{called[symbol]}''"
    return found


def _typeset(automaton: Automaton, name: str) -> str:
    """Return a name in LaTeX, with dots for primes, and its owner if there are several."""
    plain = name.rstrip("'")
    owner, _, own = plain.rpartition(".")
    letter = r"\theta" if owner and own == "angle" else sp.latex(sp.Symbol(own))
    if len(own) > 1 and letter == own:
        letter = rf"\mathrm{{{own}}}"
    primes = len(name) - len(plain)
    letter = (letter, rf"\dot{{{letter}}}", rf"\ddot{{{letter}}}")[primes]
    owners = {n.rpartition(".")[0] for n in (*automaton.names, *automaton.observables)} - {""}
    bodies = {n.rpartition(".")[0] for n in automaton.names} - {""}
    others = bodies if owner in bodies else owners - bodies
    if not owner or len(others) < 2:
        return letter
    whose = rf"\mathrm{{{owner.replace('_', ' ')}}}"
    stem, below, index = letter.partition("_{")
    return rf"{stem}_{{{index[:-1]},{whose}}}" if below else rf"{letter}_{{{whose}}}"


def blocks(automaton: Automaton, key: Key, zeros: frozenset[sp.Symbol]) -> list[EquationBlock]:
    """Return the equations of a mode in the symbols of the automaton.

    Blocks: eliminated coordinates, equations of motion, constraints, and forces; of a chart, the
    rates of its variables.
    """
    if automaton.coordinates is None:
        mode = build_mode(automaton, roles_in(key), frozenset())
        known: dict[sp.Symbol, sp.Expr] = {}
        for symbol, value in mode.definitions:
            known[symbol] = value.xreplace(known)
        rates = zip(automaton.rates, mode.rates, strict=True)
        motion = tuple((rate, _short(_exact(e.xreplace(known)))) for rate, e in rates)
        return [EquationBlock("motion", motion)]
    rows = _equation_rows(automaton, automaton.coordinates, key, zeros)
    found: list[EquationBlock] = []
    if rows.elimination is not None:
        follows = ((q, _short(_exact(place))) for q, place in rows.elimination.positions.items())
        found.append(EquationBlock("eliminated", tuple(follows)))
    moving = tuple(_moving(row, automaton.coordinates) for row in rows.motion)
    if moving:
        found.append(EquationBlock("motion", moving))
    if rows.held:
        held = tuple((_short(place), sp.S.Zero) for place in rows.held)
        found.append(EquationBlock("held", held))
    forces = _force_equations(rows, automaton)
    return [*found, EquationBlock("forces", forces)] if forces else found


class _Equations(NamedTuple):
    """Equations of a mode, each = 0."""

    elimination: Elimination | None
    motion: list[sp.Expr]
    held: list[sp.Expr]
    forces: list[sp.Expr]


def _equation_rows(
    automaton: Automaton, coordinates: Coordinates, key: Key, zeros: frozenset[sp.Symbol]
) -> _Equations:
    states = [r.build(role) for r, role in zip(automaton.regions, roles_in(key), strict=True)]
    written = dict(coordinates.written)
    written |= {zero: sp.S.Zero for zero in zeros if zero not in written}
    for state in states:
        written |= {control: value.xreplace(written) for control, value in state.values.items()}
    holds = [*coordinates.joints, *(hold for state in states for hold in state.holds)]
    found = eliminate(coordinates, holds[len(coordinates.joints) :], written)
    replaced = {} if found is None else found.replaced
    equations = [
        *(e for hold in coordinates.joints for e in hold.equations),
        *(e for state in states for e in state.equations),
    ]
    absent = {e for e in equations if e.is_Symbol}
    kept = [hold for hold in holds if not all(e in replaced for e in hold.equations)]
    about = {e for hold in kept for e in hold.equations}
    rest = [automaton.equations[replaced[e]] if e in replaced else e for e in equations]
    rest = [e for e in rest if e not in about]
    motion = list(automaton.equations[: len(coordinates.positions)])
    if found is not None:
        working = [u for u in automaton.unknowns if u not in absent | found.forces]
        motion = list(coordinates.motion(found, working))
        known = {**found.known, **found.accelerations}
        rest = [e.xreplace(known) for e in rest]
    zero = dict.fromkeys(absent, sp.S.Zero)
    return _Equations(
        found,
        [_exact(row.xreplace(zero).xreplace(written)) for row in motion],
        [_exact(place.xreplace(written)) for hold in kept for place in hold.places],
        [_exact(row.xreplace(zero).xreplace(written)) for row in rest if row not in absent],
    )


def _moving(row: sp.Expr, coordinates: Coordinates) -> Equation:
    """Return an equation of motion with accelerations and centripetal terms on the left."""
    left: list[sp.Expr] = []
    rest = sp.expand_mul(row)
    for a in coordinates.accelerations:
        coefficient = rest.coeff(a)
        left.append(_short(coefficient) * a)
        rest -= sp.expand_mul(coefficient * a)
    scale = sp.Dummy("scale", positive=True)
    faster = {v: scale * v for v in coordinates.rates}
    terms = sp.Add.make_args(sp.expand_mul(rest))
    excess = [sp.expand(term.xreplace(faster) - scale**2 * term) for term in terms]
    centripetal = sp.Add(*(term for term, off in zip(terms, excess, strict=True) if off == 0))
    left.append(_short(centripetal))
    return sp.Add(*left), _short(-sp.expand_mul(rest - centripetal))


def _force_equations(rows: _Equations, automaton: Automaton) -> tuple[Equation, ...]:
    """Solve the equations for the forces, one by one where possible."""
    assert automaton.coordinates is not None
    unsolved = [row for row in rows.forces if row != 0]
    forces = [u for u in automaton.unknowns if u not in automaton.coordinates.accelerations]
    found: list[Equation] = []
    for row in list(unsolved):
        # The only force of its equation, or one proportional to others, as by a law of friction.
        inside = [force for force in forces if row.has(force)]
        rest = sp.expand(row.xreplace(dict.fromkeys(inside, sp.S.Zero)))
        share = rest == 0 and not row.has(*automaton.coordinates.accelerations)
        if inside and (len(inside) == 1 or share) and inside[-1] not in dict(found):
            last = inside[-1]
            slope = sp.diff(row, last)
            found.append((last, _short(-row.xreplace({last: sp.S.Zero}) / slope)))
            unsolved.remove(row)
    unsolved = [_exact(row.xreplace(dict(found))) for row in unsolved]
    unknown = [f for f in forces if any(row.has(f) for row in unsolved)]
    if unsolved and len(unsolved) == len(unknown):
        matrix, right = sp.linear_eq_to_matrix(unsolved, unknown)
        solution = matrix.LUsolve(right)
        found += [(force, _short(e)) for force, e in zip(unknown, solution, strict=True)]
    else:
        found += [(_short(row), sp.S.Zero) for row in unsolved]
    return tuple(found)


def _exact(expression: sp.Expr) -> sp.Expr:
    """Return an expression with decimal fractions for floats, whose terms cancel exactly."""
    return expression.xreplace({x: sp.Rational(str(x)) for x in expression.atoms(sp.Float)})


def _decimal(expression: sp.Expr) -> sp.Expr:
    """Return an expression with floats for fractions, except 1/2, 1/3, 2/3, ... and exponents."""
    if expression.is_Rational:
        short = expression.q <= _MAX_DENOMINATOR and math.gcd(expression.q, 10) == 1
        whole = short or abs(expression) == sp.S.Half
        return expression if whole else sp.Float(expression)
    if expression.is_Pow:
        return sp.Pow(_decimal(expression.base), expression.exp)
    return expression.func(*map(_decimal, expression.args)) if expression.args else expression


def _short(expression: sp.Expr) -> sp.Expr:
    """Return the shortest of some forms of an exact expression, with decimal numbers."""
    decimal = _decimal(expression)
    if decimal.count_ops() > _MAX_OPERATIONS:
        return decimal
    expanded = sp.expand(expression)
    forms = expression, sp.trigsimp(expanded), expanded
    # Exact factors would be large integers, as common denominators are.
    factored = [sp.factor_terms(_decimal(form)) for form in forms]
    return min(decimal, *factored, key=_length)


def _length(expression: sp.Expr) -> int:
    digits = sum(len(str(abs(whole))) - 1 for whole in expression.atoms(sp.Integer))
    return int(expression.count_ops()) + digits
