"""Random draws of tests, and their numbers."""

from __future__ import annotations

from typing import Any

import sympy as sp
from hypothesis import settings
from hypothesis import strategies as st

from statechart.formulas.tape import Tape
from statechart.formulas.writer import Max, Min, compile_tape


def examples(count: int) -> settings:
    """Return the settings of a test: `count` examples, or as many as the profile explores."""
    exploring = settings.get_current_profile_name() == "explore"
    return settings(max_examples=max(count, settings().max_examples) if exploring else count)


X, Y, P, Q, T = sp.symbols("x y p q t", real=True)
POSITIVE = [
    sp.exp,
    sp.cosh,
    lambda a: sp.sqrt(1 + a**2),
    lambda a: 2 + sp.sin(a),
    lambda a: sp.Abs(a) + sp.Rational(1, 3),
]
ANY = [
    sp.sin,
    sp.cos,
    sp.sinh,
    sp.tanh,
    sp.atan,
    sp.Abs,
    sp.sign,
    lambda a: -a,
    lambda a: a**2,
    lambda a: a**3,
    lambda a: a**5 / 7,
    lambda a: sp.tan(sp.sin(a)),
    lambda a: sp.asin(sp.sin(a) / 2),
    lambda a: sp.acos(sp.cos(a) / 3),
    lambda a: 1 / (1 + a**2) ** 2,
    lambda a: (1 + a**2) ** sp.Rational(-3, 2),
]


def operators(children: st.SearchStrategy[sp.Expr]) -> st.SearchStrategy[sp.Expr]:
    """Return formulas of formulas, finite wherever these are."""
    pair = st.tuples(children, children)
    bounded = st.one_of(
        st.tuples(st.sampled_from(ANY), children).map(lambda c: c[0](c[1])),
        pair.map(lambda c: c[0] + c[1]),
        pair.map(lambda c: c[0] - 3 * c[1]),
        pair.map(lambda c: c[0] * c[1]),
        pair.map(lambda c: Min(c[0], c[1])),
        pair.map(lambda c: Max(c[0], c[1])),
        pair.map(lambda c: sp.atan2(c[0], 2 + c[1] ** 2)),
        pair.map(lambda c: sp.sqrt(c[0] ** 2 + (1 + c[1] ** 2) ** 2)),
        pair.map(lambda c: c[0] / (2 + sp.cos(c[1]))),
    )
    positive = st.tuples(st.sampled_from(POSITIVE), children).map(lambda c: c[0](c[1]))
    return st.one_of(
        bounded,
        positive.map(sp.log),
        positive.map(sp.sqrt),
        st.tuples(positive, children).map(lambda c: c[0] ** (sp.sin(c[1]) + sp.Rational(1, 4))),
    )


expressions = st.recursive(
    st.sampled_from([X, Y, P, T, sp.Integer(2), sp.Rational(1, 3), sp.Float(0.7), sp.pi]),
    operators,
    max_leaves=6,
)


def tape_of(*outputs: sp.Expr, **options: Any) -> Tape:
    """Return a tape of expressions in X, Y, the parameter P and the time T."""
    return compile_tape(outputs, variables=[X, Y], parameters=[P], time=T, **options)
