"""Equations of motion in minimal coordinates: those that the constraints of a mode leave free.

The elimination gives positions of bodies in the free coordinates. Kinetic energy then gives the
mass matrix and the centripetal terms, virtual work the forces. Products of sines and cosines are
combined to functions of sums and differences of angles.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial

import sympy as sp

from contacts.dynamics.mechanics import Mechanics
from contacts.dynamics.parameters import MASS_UNIT
from contacts.scene.modes import Row
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
    parameters = {*symbols.values()}
    expressions: dict[sp.Symbol, sp.Expr] = {}
    for name, body in scene.bodies.items():
        if body.inertia is not None:
            expressions[symbols[f"{name}.inertia"]] = parse(body.inertia).to_sympy(symbols)
    for name in scene.contacts:
        law = scene.friction_of(name)
        for direction, (cone_n, cone_t) in mechanics.contact(name).friction.edges.items():
            if law is not None and cone_t in parameters:
                text = law.kinetic if direction else law.static
                at_rest = dict.fromkeys(law.slips, sp.S.Zero)
                expressions[cone_n] = sp.S.One
                expressions[cone_t] = parse(text).to_sympy({**symbols, **at_rest})
    return expressions


def motion(
    mechanics: Mechanics, elimination: Elimination, working: Collection[sp.Symbol]
) -> tuple[sp.Expr, ...]:
    """Return the equations of motion, each = 0, of the free coordinates, in order."""
    known, anchors = elimination.known, elimination.anchors
    gx, gy = mechanics.gravity
    rows: dict[int, list[sp.Expr]] = {
        i: [] for i, q in enumerate(mechanics.q) if q not in elimination.positions
    }

    def gradient_of(place: sp.Expr) -> Row:
        """Return the derivatives of a place by the free coordinates."""
        slopes = mechanics.gradient(place).items()
        return {i: slope.xreplace(anchors) for i, slope in slopes if i in rows}

    def gradient_and_drift(position: sp.Expr) -> tuple[Row, sp.Expr]:
        """Return the gradient of a position, and its acceleration at constant rates."""
        expression = _collect(position.xreplace(elimination.positions), mechanics.variables)
        drift = mechanics.drift(mechanics.rate(expression))
        return gradient_of(expression), drift.xreplace(anchors)

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
                terms.append(entry * mechanics.a[k])
            terms.append(mass * inner(direction, (drift_x, drift_y)) + inertia * turn * drift)
            terms.append(-mass * (gx * direction[0] + gy * direction[1]))
    moves = {
        i: {i: sp.S.One} if i in rows else gradient_of(elimination.positions[q])
        for i, q in enumerate(mechanics.q)
    }
    works = [(sp.S.One, mechanics.applied_forces)]
    works += [(f, row) for f, row in mechanics.constraint_rows.items() if f in working]
    for force, row in works:
        for i, entry in row.items():
            acting = -(force * entry).xreplace(known)
            for k, by in moves[i].items():
                rows[k].append(acting * by)
    return tuple(sp.Add(*terms) for terms in rows.values())


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
