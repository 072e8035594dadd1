"""Symbolic linear systems against numpy, and their pivots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from strategies import examples

from statechart.errors import SingularMode
from statechart.formulas.linear import Definition, solve_linear
from statechart.formulas.writer import compile_tape


def values(
    definitions: Sequence[Definition], known: Mapping[sp.Symbol, float]
) -> dict[sp.Symbol, float]:
    """Run a straight-line program in floats."""
    symbols = [symbol for symbol, _ in definitions]
    tape = compile_tape(
        symbols,
        variables=(),
        parameters=list(known),
        time=sp.Symbol("time", real=True),
        definitions=definitions,
    )
    found = tape.values(np.zeros(0), np.array(list(known.values()), dtype=float), 0.0)
    return {**known, **dict(zip(symbols, map(float, found), strict=True))}


def system(size: int, prefix: str = "u") -> tuple[sp.Symbol, ...]:
    return tuple(sp.Symbol(f"{prefix}{i}", real=True) for i in range(size))


@examples(40)
@given(st.integers(1, 8), st.integers(0, 2**32 - 1), st.floats(0.2, 1.0), st.floats(0.0, 1.0))
def test_random_systems_agree_with_numpy(
    size: int, seed: int, density: float, plain: float
) -> None:
    random = np.random.default_rng(seed)
    matrix = random.uniform(-2.0, 2.0, (size, size)) * (random.random((size, size)) < density)
    # A permuted diagonal keeps the structure regular.
    matrix[np.arange(size), random.permutation(size)] += np.where(random.random(size) < 0.5, 5, -5)
    right = random.uniform(-2.0, 2.0, size)
    known: dict[sp.Symbol, float] = {}

    def entry(value: float) -> sp.Expr:
        if value == 0.0:
            return sp.S.Zero
        if random.random() < plain:
            return sp.Float(value)
        symbol = sp.Symbol(f"p{len(known)}", real=True)
        known[symbol] = value
        return symbol

    unknowns = system(size)
    equations = [
        sum((entry(c) * u for c, u in zip(row, unknowns, strict=True)), start=-entry(b))
        for row, b in zip(matrix, right, strict=True)
    ]
    condition = np.linalg.cond(matrix)
    if condition > 1e4:
        return
    found = values(solve_linear(equations, unknowns), known)
    expected = np.linalg.solve(matrix, right)
    # Pivots are chosen before their numbers are known: rounding is that of the largest term met.
    largest = max(map(abs, [1.0, *found.values(), *expected.tolist()]))
    scale = 1e-12 * condition * largest
    assert [found[u] for u in unknowns] == pytest.approx(expected, abs=scale)


def test_entries_may_be_expressions_and_equations_need_no_order() -> None:
    u, v, w = system(3)
    a, b = sp.symbols("a b", real=True)
    equations = [sp.sin(a) * u + v * b - 1, w - u, v * sp.cos(a) - u * b**2 + w]
    found = values(solve_linear(equations, (u, v, w)), {a: 0.7, b: 1.3})
    for equation in equations:
        assert float(equation.subs(found)) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize(
    "make",
    [
        lambda u, v, w, p: [u - 1, v - 2],
        lambda u, v, w, p: [u + v, u + v - 1, w],
        lambda u, v, w, p: [u + v + w, 2 * u + 2 * v + 2 * w - 1, u - v],
        lambda u, v, w, p: [p * u + p * v - 1, p * u + p * v, w],
        lambda u, v, w, p: [sp.S.Zero, v, w],
        lambda u, v, w, p: [u * p - 1, u * p - 2, v + w],
    ],
)
def test_a_system_that_leaves_an_unknown_free_is_refused(
    make: object,
) -> None:
    unknowns = system(3)
    parameter = sp.Symbol("p", real=True)
    with pytest.raises(SingularMode):
        solve_linear(make(*unknowns, parameter), unknowns)  # type: ignore[operator]


def test_a_point_mass_is_an_ordinary_value() -> None:
    # A stick pinned at its end: with I = 0 the rotation has no inertia of its own, and the
    # angular acceleration is still g sin / L.
    ax, ay, alpha, normal, tangential = unknowns = system(5)
    mass, inertia, length, gravity, sine, cosine = known = system(6, "k")
    equations = [
        mass * ax - tangential,
        mass * ay - normal + mass * gravity,
        inertia * alpha - normal * length * sine + tangential * length * cosine,
        ax - length * cosine * alpha,
        ay + length * sine * alpha,
    ]
    definitions = solve_linear(equations, unknowns)
    lean = 0.4
    for moment in (1.0, 1e-18, 0.0):
        numbers = (2.0, moment, 1.5, 9.81, np.sin(lean), np.cos(lean))
        found = values(definitions, dict(zip(known, numbers, strict=True)))
        expected = 2.0 * 9.81 * 1.5 * np.sin(lean) / (moment + 2.0 * 1.5**2)
        assert found[alpha] == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("moment", [1.0, 1e-6, 1e-12, 1e-18])
def test_a_small_force_is_no_difference_of_large_ones(moment: float) -> None:
    # A stick whose end slides: its normal force is a weight times I / (I + m L^2 s (s + mu c)).
    ax, ay, alpha, normal, tangential = unknowns = system(5)
    mass, inertia, length, gravity, sine, cosine, mu = known = system(7, "k")
    equations = [
        mass * ax - tangential,
        mass * ay - normal + mass * gravity,
        inertia * alpha - normal * length * sine + tangential * length * cosine,
        ay + length * sine * alpha,
        tangential + mu * normal,
    ]
    definitions = solve_linear(equations, unknowns, 3)
    s, c = np.sin(0.4), np.cos(0.4)
    numbers = (2.0, moment, 1.5, 9.81, s, c, 0.3)
    found = values(definitions, dict(zip(known, numbers, strict=True)))
    expected = 2.0 * 9.81 * moment / (moment + 2.0 * 1.5**2 * s * (s + 0.3 * c))
    assert found[normal] == pytest.approx(expected, rel=1e-14, abs=0.0)


def test_elimination_avoids_vanishing_pivots() -> None:
    # The determinants are a^2 + b^2 and one of a 3 x 3 system: single entries may be zero.
    a, b, c = sp.symbols("a b c", real=True)
    u, v, w = system(3)
    two = solve_linear([a * u + b * v - 1, -b * u + a * v], (u, v))
    for one, other in ((0.0, 2.0), (2.0, 0.0)):
        found = values(two, {a: one, b: other})
        assert (found[u], found[v]) == pytest.approx(
            (one / (one**2 + other**2), other / (one**2 + other**2))
        )
    three = [a * u + b * v + c * w - 1, b * u + c * v + a * w - 2, c * u + a * v + b * w - 3]
    definitions = solve_linear(three, (u, v, w))
    for numbers in ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 2.0, 1.0)):
        at = dict(zip((a, b, c), numbers, strict=True))
        found = values(definitions, at)
        for equation in three:
            assert float(equation.subs(found)) == pytest.approx(0.0, abs=1e-14)


def test_a_chart_without_unknowns_needs_no_solution() -> None:
    assert solve_linear([], ()) == ()


def test_coupled_masses_and_constraints_have_no_vanishing_pivots() -> None:
    # A mass matrix and constraints of which every entry but the masses may be zero at a state.
    count, held = 5, 3
    unknowns = system(count + held)
    masses = sp.Matrix(count, count, lambda i, k: sp.Symbol(f"m{min(i, k)}{max(i, k)}", real=True))
    rows = sp.Matrix(held, count, lambda i, k: sp.Symbol(f"j{i}{k}", real=True))
    a, f = sp.Matrix(unknowns[:count]), sp.Matrix(unknowns[count:])
    equations = [*(masses * a - rows.T * f - sp.ones(count, 1)), *(rows * a)]
    definitions = solve_linear(equations, unknowns, len(unknowns))
    random = np.random.default_rng(1)
    for hidden in range(8):
        root = random.uniform(-1.0, 1.0, (count, count))
        mass = root @ root.T + np.eye(count) if hidden else np.eye(count)
        jacobian = random.uniform(-1.0, 1.0, (held, count))
        jacobian *= random.random((held, count)) < 0.6
        jacobian[range(held), range(held)] = 1.0
        numbers = {masses[i, k]: mass[i, k] for i in range(count) for k in range(i, count)}
        numbers |= {rows[i, k]: jacobian[i, k] for i in range(held) for k in range(count)}
        found = values(definitions, numbers)
        matrix = np.block([[mass, -jacobian.T], [jacobian, np.zeros((held, held))]])
        expected = np.linalg.solve(matrix, [1.0] * count + [0.0] * held)
        assert [found[u] for u in unknowns] == pytest.approx(expected, abs=1e-12)
