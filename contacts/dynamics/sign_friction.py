"""Dry friction that formulas say by a sign: forces ``-limit sign(s) ds/dv`` of rates of change s.

Where s is zero the force is any up to the limit, as that of a locked coupling (Moreau 1988).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import sympy as sp

from contacts.scene.modes import SignFriction
from statechart.formulas.linear import Definition

if TYPE_CHECKING:
    from contacts.dynamics.mechanics import Mechanics


def sign_frictions(
    mechanics: Mechanics, controlled: Iterable[Definition]
) -> tuple[SignFriction, ...]:
    """Return the signs of speeds in the forces of a scene, where all are dry friction; else none.

    `controlled` are the values of what states of controllers set, in order.
    """
    if not mechanics.held_forces:
        return ()
    known: dict[sp.Symbol, sp.Expr] = {}
    for symbol, value in controlled:
        known[symbol] = value.xreplace(known)
    forces = [force.xreplace(known) for force in mechanics.generalised_forces]
    names = dict(zip(mechanics.variables, map(sp.Symbol, mechanics.variable_names), strict=True))
    at_rest = dict.fromkeys(mechanics.a, sp.S.Zero)
    found = []
    for sign in sorted(set().union(*(f.atoms(sp.sign) for f in forces)), key=sp.default_sort_key):
        (slip,) = sign.args
        if not slip.has(*mechanics.v):
            continue  # A switch of places or of time.
        size = sp.Dummy("sign", real=True)
        effects = [sp.diff(force.xreplace({sign: size}), size) for force in forces]
        row = tuple(sp.diff(slip, v) for v in mechanics.v)
        limit = next((-e / r for e, r in zip(effects, row, strict=True) if r != 0), None)
        kinked = slip.has(sp.sign, sp.Abs, sp.Max, sp.Min, *mechanics.controller_state.values())
        if limit is None or kinked or limit.has(sp.sign, size):
            return ()
        if any(sp.expand(e + limit * r) != 0 for e, r in zip(effects, row, strict=True)):
            return ()
        bias = mechanics.rate(slip).xreplace(at_rest)
        name = sp.sstr(sp.sign(slip).xreplace(names)).replace(" ", "")
        found.append(SignFriction(name, slip, bias, limit, row))
    return tuple(found)
