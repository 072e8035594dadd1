"""The equations of motion of the coordinates that a mode leaves, when others follow from them.

Bodies are where the elimination puts them; the kinetic energy of that gives mass matrix and
centripetal terms, and virtual work the forces. Products of sines and cosines are joined to those
of differences of angles (a body that turns about a point has the square of its arm, no more).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import partial

import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import MASS_UNIT
from statechart.automaton.reduction import Coordinates, Elimination
from statechart.formulas.formula import parse

_Terms = dict[sp.Expr, sp.Expr]
_Pair = tuple[sp.Expr, sp.Expr]


def coordinates(mechanics: Mechanics) -> Coordinates:
    """Return the coordinates of a scene, and what their modes are reduced by."""
    joints = (row for row in mechanics.joint_rows if row.closed is None)
    return Coordinates(
        mechanics.q,
        mechanics.v,
        mechanics.a,
        mechanics.time,
        tuple(row.hold(mechanics.a) for row in joints),
        partial(motion, mechanics),
        _written(mechanics),
        mechanics.parameters.symbols.get(MASS_UNIT),
    )


def _written(mechanics: Mechanics) -> dict[sp.Symbol, sp.Expr]:
    """Return how a person writes moments of inertia, and cones: 1 and the coefficient."""
    symbols, scene = mechanics.parameters.symbols, mechanics.scene
    found: dict[sp.Symbol, sp.Expr] = {}
    for name, body in scene.bodies.items():
        if body.inertia is not None:
            found[symbols[f"{name}.inertia"]] = parse(body.inertia).to_sympy(symbols)
    for name in scene.contacts:
        law = scene.friction_of(name)
        for direction, (cone_n, cone_t) in mechanics.contact(name).symbols.friction.edges.items():
            if law is not None and cone_t in symbols.values():
                text = law.kinetic if direction else law.static
                at_rest = dict.fromkeys(law.slips, sp.S.Zero)
                found[cone_n] = sp.S.One
                found[cone_t] = parse(text).to_sympy({**symbols, **at_rest})
    return found


def motion(
    mechanics: Mechanics, elimination: Elimination, working: Collection[sp.Symbol]
) -> tuple[sp.Expr, ...]:
    """Return the equations of motion, each = 0, of the coordinates that are left, in order."""
    left = [i for i, q in enumerate(mechanics.q) if q not in elimination.positions]
    at_rest = dict.fromkeys(mechanics.a, sp.S.Zero)
    known = elimination.known
    gx, gy = mechanics.gravity
    rows: list[list[sp.Expr]] = [[] for _ in left]

    numbers = {mechanics.q[i]: k for k, i in enumerate(left)}

    def along(place: sp.Expr) -> tuple[dict[int, sp.Expr], sp.Expr]:
        """Return the gradient of a place, and its acceleration at constant rates."""
        here = _collected(place.xreplace(elimination.positions), mechanics.variables)
        gradient = {
            numbers[q]: sp.diff(here, q).xreplace(elimination.anchors)
            for q in here.free_symbols
            if q in numbers
        }
        drift = mechanics.rate(mechanics.rate(here)).xreplace(at_rest)
        return gradient, drift.xreplace(elimination.anchors)

    for name, body in mechanics.scene.bodies.items():
        (x, y), angle = mechanics.body_frame(name)
        mass, inertia = mechanics.inertia(name, body)
        (gradient_x, drift_x), (gradient_y, drift_y) = along(x), along(y)
        gradient, drift = along(angle)
        moves = gradient_x.keys() | gradient_y.keys() | gradient.keys()
        # Most coordinates of a scene of many bodies do not move this one.
        by = [
            (k, tuple(found.get(k, sp.S.Zero) for found in (gradient_x, gradient_y, gradient)))
            for k in sorted(moves)
        ]
        for i, (along_x, along_y, turn) in by:
            place, terms = (along_x, along_y), rows[i]
            for k, (*other, turned) in by:
                entry = mass * inner(place, (other[0], other[1])) + inertia * turn * turned
                terms.append(entry * mechanics.a[left[k]])
            terms.append(mass * inner(place, (drift_x, drift_y)) + inertia * turn * drift)
            terms.append(-mass * (gx * place[0] + gy * place[1]))
    columns = _columns(mechanics, elimination, left)
    for works in (mechanics.applied_forces, *_constraint_forces(mechanics, working)):
        for terms, column in zip(rows, columns, strict=True):
            terms += [-works[i].xreplace(known) * by for i, by in column.items() if works[i] != 0]
    return tuple(sp.Add(*terms) for terms in rows)


def _columns(
    mechanics: Mechanics, elimination: Elimination, left: Iterable[int]
) -> list[dict[int, sp.Expr]]:
    """Return, for every coordinate that is left, how each coordinate moves with it."""
    columns: list[dict[int, sp.Expr]] = []
    for i in left:
        column: dict[int, sp.Expr] = {i: sp.S.One}
        for q, place in elimination.positions.items():
            by = sp.diff(place, mechanics.q[i])
            if by != 0:
                column[mechanics.q.index(q)] = by.xreplace(elimination.anchors)
        columns.append(column)
    return columns


def _constraint_forces(
    mechanics: Mechanics, working: Collection[sp.Symbol]
) -> list[tuple[sp.Expr, ...]]:
    """Return what those forces of contacts and joints that may do work do to every coordinate."""
    jacobians = {row.force: row.jacobian for row in mechanics.joint_rows}
    for name in mechanics.scene.frictional:
        contact = mechanics.contact(name)
        if name not in mechanics.couples:
            jacobians[contact.symbols.V] = contact.jacobian_n
        jacobians[contact.symbols.H] = contact.jacobian_t
    return [tuple(j * f for j in row) for f, row in jacobians.items() if f in working]


def _terms(expression: sp.Expr, variables: Collection[sp.Symbol]) -> _Terms:
    """Return a sum as what depends on variables -> its coefficient."""
    found: _Terms = {}
    for term in sp.Add.make_args(sp.expand_mul(expression)):
        coefficient, varying = term.as_independent(*variables, as_Add=False)
        found[varying] = found.get(varying, sp.S.Zero) + coefficient
    return found


def _collected(expression: sp.Expr, variables: Collection[sp.Symbol]) -> sp.Expr:
    terms = _terms(expression, variables)
    return sp.Add(*(c * varying for varying, c in terms.items() if c != 0))


def inner(one: _Pair, other: _Pair) -> sp.Expr:
    """Return the inner product of two vectors.

    cos a cos b + sin a sin b becomes cos(a - b), and sin a cos b - cos a sin b becomes
    sin(a - b), with their coefficients; likewise for the sum of angles.
    """
    products: dict[tuple[type, sp.Expr, type, sp.Expr], sp.Expr] = {}
    rest: list[sp.Expr] = []
    for left, right in zip(one, other, strict=True):
        for u in sp.Add.make_args(left):
            for w in sp.Add.make_args(right):
                (a, f), (b, g) = _wave(u), _wave(w)
                if f is None or g is None:
                    rest.append(u * w)
                    continue
                key = (f.func, f.args[0], g.func, g.args[0])
                products[key] = products.get(key, sp.S.Zero) + a * b
    return sp.Add(*rest, *_joined(products))


def _wave(term: sp.Expr) -> tuple[sp.Expr, sp.Expr | None]:
    """Return a term as a coefficient and a sine or cosine; None where it has none, or more."""
    factors = sp.Mul.make_args(term)
    waves = [f for f in factors if isinstance(f, sp.sin | sp.cos)]
    if len(waves) != 1:
        return term, None
    return sp.Mul(*(f for f in factors if f is not waves[0])), waves[0]


def _joined(products: dict[tuple[type, sp.Expr, type, sp.Expr], sp.Expr]) -> list[sp.Expr]:
    """Return the sum of coefficient times two waves, pairs of them joined to one."""
    found: list[sp.Expr] = []
    left = dict(products)
    for (f, a, g, b), one in products.items():
        if (f, a, g, b) not in left:
            continue
        del left[f, a, g, b]
        partner = (_OTHER[f], a, _OTHER[g], b)
        other = left.get(partner)
        sign = _sign(one, other)
        if sign:
            del left[partner]
            found.append(_sum_of_angles(f, a, g, b, sign) * one)
        else:
            found.append(one * f(a) * g(b))
    return found


def _sign(one: sp.Expr, other: sp.Expr | None) -> int:
    """Return 1 where two coefficients are equal, -1 where their sum is zero, else 0."""
    if other is None:
        return 0
    if sp.expand(one - other) == 0:
        return 1
    return -1 if sp.expand(one + other) == 0 else 0


def _sum_of_angles(f: type, a: sp.Expr, g: type, b: sp.Expr, sign: int) -> sp.Expr:
    """Return f(a) g(b) + sign f'(a) g'(b), where f' is the other of sine and cosine."""
    if f is g:
        # cos cos + sin sin, or its negative where the sines come first.
        if sign > 0:
            return sp.cos(a - b)
        return sp.cos(a + b) if f is sp.cos else -sp.cos(a + b)
    if sign > 0:
        return sp.sin(a + b)
    return sp.sin(a - b) if f is sp.sin else sp.sin(b - a)


_OTHER = {sp.sin: sp.cos, sp.cos: sp.sin}
