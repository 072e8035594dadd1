"""Equations of motion in minimal coordinates: those that the constraints of a mode leave free.

The elimination gives positions of bodies in the free coordinates. Kinetic energy then gives the
mass matrix and the centripetal terms, virtual work the forces. Products of sines and cosines are
combined to functions of sums and differences of angles.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from functools import partial

import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import MASS_UNIT
from statechart.automaton.reduction import Coordinates, Elimination
from statechart.formulas.formula import parse

_Pair = tuple[sp.Expr, sp.Expr]


def coordinates(mechanics: Mechanics) -> Coordinates:
    """Return the coordinates of a scene, and the joints by which its modes are reduced."""
    joints = (row for row in mechanics.joint_rows if row.closed is None)
    return Coordinates(
        mechanics.q,
        mechanics.v,
        mechanics.a,
        mechanics.rate,
        tuple(row.hold(mechanics.a) for row in joints),
        partial(motion, mechanics),
        _display_parameters(mechanics),
        mechanics.parameters.symbols.get(MASS_UNIT),
    )


def _display_parameters(mechanics: Mechanics) -> dict[sp.Symbol, sp.Expr]:
    """Return formulas of moments of inertia, and cones as (1, coefficient), for display."""
    symbols, scene = mechanics.parameters.symbols, mechanics.scene
    expressions: dict[sp.Symbol, sp.Expr] = {}
    for name, body in scene.bodies.items():
        if body.inertia is not None:
            expressions[symbols[f"{name}.inertia"]] = parse(body.inertia).to_sympy(symbols)
    for name in scene.contacts:
        law = scene.friction_of(name)
        for direction, (cone_n, cone_t) in mechanics.contact(name).friction.edges.items():
            if law is not None and cone_t in symbols.values():
                text = law.kinetic if direction else law.static
                at_rest = dict.fromkeys(law.slips, sp.S.Zero)
                expressions[cone_n] = sp.S.One
                expressions[cone_t] = parse(text).to_sympy({**symbols, **at_rest})
    return expressions


def motion(
    mechanics: Mechanics, elimination: Elimination, working: Collection[sp.Symbol]
) -> tuple[sp.Expr, ...]:
    """Return the equations of motion, each = 0, of the free coordinates, in order."""
    free = [i for i, q in enumerate(mechanics.q) if q not in elimination.positions]
    at_rest = dict.fromkeys(mechanics.a, sp.S.Zero)
    known = elimination.known
    gx, gy = mechanics.gravity
    rows: list[list[sp.Expr]] = [[] for _ in free]

    numbers = {mechanics.q[i]: k for k, i in enumerate(free)}

    def gradient_and_drift(position: sp.Expr) -> tuple[dict[int, sp.Expr], sp.Expr]:
        """Return the gradient of a position, and its acceleration at constant rates."""
        expression = _collect(position.xreplace(elimination.positions), mechanics.variables)
        gradient = {
            numbers[q]: sp.diff(expression, q).xreplace(elimination.anchors)
            for q in expression.free_symbols
            if q in numbers
        }
        drift = mechanics.rate(mechanics.rate(expression)).xreplace(at_rest)
        return gradient, drift.xreplace(elimination.anchors)

    for name, body in mechanics.scene.bodies.items():
        (x, y), angle = mechanics.body_frame(name)
        mass, inertia = mechanics.inertia(name, body)
        gradient_x, drift_x = gradient_and_drift(x)
        gradient_y, drift_y = gradient_and_drift(y)
        gradient, drift = gradient_and_drift(angle)
        # Few coordinates of a scene of many bodies move this one.
        moving = sorted(gradient_x.keys() | gradient_y.keys() | gradient.keys())
        zero = sp.S.Zero
        jacobian = {
            k: ((gradient_x.get(k, zero), gradient_y.get(k, zero)), gradient.get(k, zero))
            for k in moving
        }
        for i, (direction, turn) in jacobian.items():
            terms = rows[i]
            for k, (other, other_turn) in jacobian.items():
                entry = mass * inner(direction, other) + inertia * turn * other_turn
                terms.append(entry * mechanics.a[free[k]])
            terms.append(mass * inner(direction, (drift_x, drift_y)) + inertia * turn * drift)
            terms.append(-mass * (gx * direction[0] + gy * direction[1]))
    columns = _columns(mechanics, elimination, free)
    for works in (mechanics.applied_forces, *_constraint_forces(mechanics, working)):
        for terms, column in zip(rows, columns, strict=True):
            terms += [-works[i].xreplace(known) * by for i, by in column.items() if works[i] != 0]
    return tuple(sp.Add(*terms) for terms in rows)


def _columns(
    mechanics: Mechanics, elimination: Elimination, free: Iterable[int]
) -> list[dict[int, sp.Expr]]:
    columns: list[dict[int, sp.Expr]] = []
    for i in free:
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
    """Return the generalised forces of the contacts and joints that may do work."""
    jacobians = {row.force: row.jacobian for row in mechanics.joint_rows}
    for name in mechanics.scene.frictional:
        contact = mechanics.contact(name)
        if name not in mechanics.couples:
            jacobians[contact.V] = contact.jacobian_n
        jacobians[contact.H] = contact.jacobian_t
    return [tuple(j * f for j in row) for f, row in jacobians.items() if f in working]


def _collect(expression: sp.Expr, variables: Collection[sp.Symbol]) -> sp.Expr:
    terms: dict[sp.Expr, sp.Expr] = {}
    for term in sp.Add.make_args(sp.expand_mul(expression)):
        coefficient, varying = term.as_independent(*variables, as_Add=False)
        terms[varying] = terms.get(varying, sp.S.Zero) + coefficient
    return sp.Add(*(c * varying for varying, c in terms.items() if c != 0))


def inner(first: _Pair, second: _Pair) -> sp.Expr:
    """Return the inner product of two vectors.

    cos a cos b + sin a sin b becomes cos(a - b), and sin a cos b - cos a sin b becomes sin(a - b);
    the formulas for a + b apply, too.
    """
    products: dict[tuple[type, sp.Expr, type, sp.Expr], sp.Expr] = {}
    plain_terms: list[sp.Expr] = []
    for a_k, b_k in zip(first, second, strict=True):
        for u in sp.Add.make_args(a_k):
            for w in sp.Add.make_args(b_k):
                (a, f), (b, g) = _wave(u), _wave(w)
                if f is None or g is None:
                    plain_terms.append(u * w)
                    continue
                key = (f.func, f.args[0], g.func, g.args[0])
                products[key] = products.get(key, sp.S.Zero) + a * b
    return sp.Add(*plain_terms, *_combine_waves(products))


def _wave(term: sp.Expr) -> tuple[sp.Expr, sp.Expr | None]:
    """Return a term as a coefficient and its only sine or cosine; None if it is not unique."""
    factors = sp.Mul.make_args(term)
    waves = [f for f in factors if isinstance(f, sp.sin | sp.cos)]
    if len(waves) != 1:
        return term, None
    return sp.Mul(*(f for f in factors if f is not waves[0])), waves[0]


def _combine_waves(products: dict[tuple[type, sp.Expr, type, sp.Expr], sp.Expr]) -> list[sp.Expr]:
    """Return the terms of coefficients times two waves, combined by the addition formulas."""
    terms: list[sp.Expr] = []
    remaining = dict(products)
    for (f, a, g, b), coefficient in products.items():
        if (f, a, g, b) not in remaining:
            continue
        del remaining[f, a, g, b]
        partner = (_OTHER[f], a, _OTHER[g], b)
        partner_coefficient = remaining.get(partner)
        sign = _sign(coefficient, partner_coefficient)
        if sign:
            del remaining[partner]
            terms.append(_sum_of_angles(f, a, g, b, sign) * coefficient)
        else:
            terms.append(coefficient * f(a) * g(b))
    return terms


def _sign(first: sp.Expr, second: sp.Expr | None) -> int:
    if second is None:
        return 0
    if sp.expand(first - second) == 0:
        return 1
    return -1 if sp.expand(first + second) == 0 else 0


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
