import numpy as np
import pytest
import sympy as sp
from crossings import first_crossing
from hypothesis import example, given
from hypothesis import strategies as st
from strategies import P, Q, T, X, Y, examples, expressions, tape_of

from statechart.errors import DeclarationError, StatechartError
from statechart.formulas.writer import Max, Min, compile_tape
from statechart.kernels.search import search
from statechart.kernels.tapes import OPCODES, tape_table, tape_values

POSITIVE = sp.Symbol("p", positive=True)

numbers = st.floats(-2.0, 2.0)


@examples(200)
@given(expressions, numbers, numbers, numbers, numbers)
@example(Min(X, sp.atan(sp.log(sp.sqrt(T**2 + 1)) / (2 + (sp.pi - 3 * T) ** 2))), 1, 0, 0, 4e-85)
def test_values_agree_with_sympy(expression, x, y, p, t):
    # SymPy cannot always compare fractions.
    exact = expression.subs(
        {s: sp.Float(v, 60) for s, v in ((X, x), (Y, y), (P, p), (T, t))}
    ).evalf(30)
    if not (exact.is_Float or exact.is_Integer or exact.is_zero) or not abs(exact) < 1e6:
        return  # undefined there, or out of reach of a comparison
    got = tape_of(expression).values([x, y], [p], t)[0]
    around = [
        tape_of(expression).values([x + dx, y + dy], [p + dp], t + dt)[0]
        for dx, dy, dp, dt in np.eye(4) * 1e-13
    ]
    slack = 1e-11 * (1 + abs(float(exact))) + 10 * np.max(np.abs(np.array(around) - got))
    assert abs(got - float(exact)) <= slack


def test_tape_table_matches_single_evaluations():
    tape = tape_of(X * sp.sin(Y) + P * T, sp.sqrt(X), P**2)
    generator = np.random.default_rng(0)
    states, times = generator.uniform(0, 2, (77, 2)), generator.uniform(0, 2, 77)
    table = tape.table(states, [0.3], times)
    rows = [tape.values(s, [0.3], t) for s, t in zip(states, times, strict=True)]
    assert table.shape == (77, 3)
    np.testing.assert_array_equal(table, rows)


def names(tape):
    known = list(OPCODES)
    return [known[op] for op in tape.code[:, 0]]


def test_shared_subexpressions_are_computed_once():
    shared = sp.sin(X * Y + P)
    assert names(tape_of(shared + 1, shared**2, 3 * shared, shared)).count("sin") == 1


def test_quotients_differences_and_powers_take_one_operation():
    assert names(tape_of(X / Y)) == ["div"]
    assert names(tape_of(X - Y)) == ["sub"]
    assert names(tape_of(-X)) == ["neg"]
    assert names(tape_of(X**2)) == ["square"]
    assert names(tape_of(X**7)) == ["powi"]
    assert names(tape_of(sp.sqrt(X))) == ["sqrt"]
    assert names(tape_of(sp.sqrt(X**2 + Y**2))) == ["hypot"]
    assert names(tape_of(X - 2 * Y)) == ["mul", "sub"]


def test_tape_evaluates_parameters_first():
    tape = tape_of(X * sp.sin(P) + sp.sqrt(2) * P, T)
    assert tape.n_fixed == 2
    assert sorted(names(tape)[:2]) == ["mul", "sin"]
    parameters_only = set(range(3, 3 + 1 + len(tape.constants) + tape.n_fixed))
    assert set(tape.code[: tape.n_fixed, 1].tolist()) <= parameters_only


def test_constants_are_folded():
    tape = tape_of(X * sp.sqrt(2) * sp.sin(1))
    assert set(names(tape)) == {"mul"}
    assert tape.values([3.0, 0.0], [0.0], 0.0)[0] == pytest.approx(
        3 * 2**0.5 * np.sin(1), rel=1e-15
    )


def test_only_the_definitions_needed_are_compiled():
    a, b, c = sp.symbols("a b c")
    definitions = [(a, X + 1), (b, sp.exp(Y)), (c, a**2 + a)]
    tape = tape_of(c * a, definitions=definitions)
    assert "exp" not in names(tape)
    assert tape.reads.tolist() == [0]
    assert tape.values([2.0, 0.0], [0.0], 0.0)[0] == 36.0


def test_long_chains_of_definitions_compile():
    links = sp.symbols("d:3000", real=True)
    definitions = [(links[0], X)]
    definitions += [(links[k], links[k - 1] / 2 + 1) for k in range(1, 3000)]
    assert tape_of(links[-1], definitions=definitions).values([5, 0], [0], 0)[0] == 2.0


def test_large_friction_does_not_overflow():
    tape = tape_of(1 / sp.sqrt(1 + P**2))
    assert tape.values([0.0, 0.0], [1e300], 0.0)[0] == 1e-300


@pytest.mark.parametrize(
    ("expression", "word"),
    [
        (sp.Symbol("z") + X, "z"),
        (sp.gamma(X), "gamma"),
        (sp.oo * X, "finite"),
        (sp.I * X, "I"),
        (sp.asin(2) * X, "finite"),
        (sp.Piecewise((X, X > 0), (0, True)), "Piecewise"),
    ],
)
def test_functions_without_an_operation_are_refused_by_name(expression, word):
    with pytest.raises(StatechartError, match=word):
        tape_of(expression)


@pytest.mark.parametrize("constant", [sp.Float("1e300") ** 2, sp.Integer(10) ** 600])
def test_a_product_of_numbers_that_overflows_is_wrong_input(constant):
    with pytest.raises(DeclarationError, match=r"1.000000E\+600, which is too large for a float; "):
        tape_of(constant * X)


def test_a_definition_cannot_use_a_later_one():
    a, b = sp.symbols("a b")
    with pytest.raises(StatechartError, match="b"):
        tape_of(a, definitions=[(a, b + 1), (b, X)])


def test_a_duplicate_symbol_is_refused():
    with pytest.raises(StatechartError, match="twice: x"):
        compile_tape([X], variables=[X], parameters=[X], time=T)


def test_wrong_shapes_are_refused():
    tape = tape_of(X)
    with pytest.raises(ValueError, match="state"):
        tape.values([1.0], [1.0], 0.0)
    with pytest.raises(ValueError, match="parameters"):
        tape.values([1.0, 2.0], [], 0.0)
    with pytest.raises(ValueError, match="times"):
        tape.table([[1.0, 2.0]], [1.0], [0.0, 1.0])


def test_tapes_share_compiled_code(monkeypatch):
    kernels = (tape_values, tape_table, search)
    for kernel in kernels:
        monkeypatch.setattr(kernel, "_hot", True)

    def compiled():
        return [len(kernel.compiled.signatures) for kernel in kernels]

    coeffs = np.ones((1, 2, 3))
    first = tape_of(X + 1)
    first.values([1, 2], [3], 0)
    first.table([[1, 2]], [3], [0])
    first_crossing(first, [0.0], [0, 1], coeffs, [3], 0)
    before = compiled()
    assert before == [1, 1, 1]
    second = compile_tape([sp.sin(X) * T + 3, P - X], variables=[X], parameters=[P, Q], time=T)
    frozen = np.ones((3, 2, 5))[:, 1:, ::2]
    frozen.flags.writeable = False
    second.values(np.float32([1]), (3, 4), 1)
    second.table(frozen[0, :, :1], np.array([3, 4]), [0])
    first_crossing(second, [0, 0], range(4), frozen, (3, 4), 1)
    assert compiled() == before


@pytest.mark.parametrize(
    ("extremum", "expected"),
    [
        (Max(X, X + 1), X + 1),
        (Min(X, X + 1), X),
        (Max(POSITIVE, 2 * POSITIVE), 2 * POSITIVE),
        (Min(X, sp.oo), X),
        (Max(X, Max(Y, X)), Max(X, Y)),
        (Max(X, Y).xreplace({Y: X - 1}), X),
    ],
)
def test_an_extremum_omits_terms_that_a_sign_excludes(extremum, expected):
    assert extremum == expected


def test_an_extremum_of_terms_of_unknown_order_keeps_both():
    assert {*Min(X * Y, X + Y).args} == {X * Y, X + Y}
