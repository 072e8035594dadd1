import math
import pickle
from itertools import pairwise

import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

from statechart.errors import DeclarationError, FormulaError, StatechartError
from statechart.formulas.formula import Constants, order_parameters, parse
from statechart.formulas.relation import parse_relation
from statechart.formulas.tree import FUNCTIONS
from statechart.formulas.writer import to_text

# The right-hand sides are Python's own arithmetic, an implementation independent of the reader.
CASES = {
    "1 + 2*3": 1 + 2 * 3,
    "(1 + 2)*3": 9.0,
    "2 - 3 - 4": -5.0,
    "24/4/2": 3.0,
    "2**3**2": 2.0**9,
    "-2**2": -4.0,
    "2**-1": 0.5,
    "(-2)**2": 4.0,
    "--2": 2.0,
    "+x": 0.3,
    "-x*-y": 0.3 * 7,
    "1e-3 + 1.5E2 + .5 + 2.": 1e-3 + 1.5e2 + 0.5 + 2.0,
    "tip.V * x": 11 * 0.3,
    "sqrt(2)": math.sqrt(2),
    "hypot(3, 4) + atan2(1, -1)": 5 + math.atan2(1, -1),
    "min(x, y, 2) + max(x, y)": 0.3 + 7,
    "abs(-y) * sign(-y) + sign(0)": -7.0,
    "pi": math.pi,
    "exp(log(y))": math.exp(math.log(7)),
    "1/inf": 0.0,
    "atan(inf)": math.pi / 2,
    "-inf": -math.inf,
    "max(1, inf)": math.inf,
    " x \n + \t y ": 7.3,
    "floor(-y/2) + floor(x)": -4.0,
    "floor(x/0.1)": 3.0,
    "floor(3 - 1e-9)": 2.0,
    "mod(-y, 3)": 2.0,
    "mod(y, -3)": -2.0,
}
VALUES = {"x": 0.3, "y": 7.0, "tip.V": 11.0}


@pytest.mark.parametrize("text", CASES)
def test_value_follows_the_usual_precedence(text: str) -> None:
    assert parse(text).value(VALUES) == CASES[text]


@pytest.mark.parametrize("text", CASES)
def test_sympy_and_float_evaluation_agree(text: str) -> None:
    symbols = {name: sp.Symbol(f"q{i}", real=True) for i, name in enumerate(VALUES)}
    expression = parse(text).to_sympy(symbols)
    numbers = {symbols[name]: value for name, value in VALUES.items()}
    assert float(expression.subs(numbers)) == pytest.approx(CASES[text], rel=1e-15)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_agree_between_floats_and_sympy(name: str) -> None:
    arguments = ["a", "b", "c"][: FUNCTIONS[name].least]
    formula = parse(f"{name}({', '.join(arguments)})")
    values = {"a": 0.37, "b": -0.82, "c": 0.25}
    symbols = {key: sp.Symbol(key, real=True) for key in arguments}
    exact = formula.to_sympy(symbols).subs({symbols[key]: values[key] for key in arguments})
    assert formula.value(values) == pytest.approx(float(exact), rel=1e-15)


def test_sympy_numbers_are_exact() -> None:
    x = sp.Symbol("x")
    assert parse("x/3").to_sympy({"x": x}) == x / sp.Integer(3)
    assert parse("x**(1/2)").to_sympy({"x": x}) == sp.sqrt(x)
    assert parse("7").to_sympy({}) == sp.Integer(7)
    assert float(parse("0.1").to_sympy({})) == 0.1
    assert parse("2*pi").to_sympy({}) == 2 * sp.pi
    assert parse("inf").to_sympy({}) is sp.oo


@pytest.mark.parametrize(
    "name",
    [
        "I",
        "S",
        "N",
        "E",
        "O",
        "Q",
        "C",
        "beta",
        "gamma",
        "zeta",
        "Lambda",
        "lambda",
        "None",
        "print",
        "open",
        "re",
    ],
)
def test_reserved_python_and_sympy_names_are_allowed(name: str) -> None:
    symbol = sp.Symbol("q")
    formula = parse(f"2*{name} + 1")
    assert formula.names == {name}
    assert formula.to_sympy({name: symbol}) == 2 * symbol + 1
    assert formula.value({name: 3.0}) == 7.0


@given(st.floats(allow_nan=False))
def test_numbers_keep_every_bit(number: float) -> None:
    assert parse(number).value({}) == number
    assert parse(repr(number)).value({}) == number


@given(st.integers(-(10**30), 10**30))
def test_integers_stay_integers(number: int) -> None:
    assert parse(number).to_sympy({}) == sp.Integer(number)


@given(st.text(max_size=60))
def test_any_text_is_a_formula_or_a_formula_error(text: str) -> None:
    try:
        formula = parse(text)
    except FormulaError as caught:
        error = caught
    else:
        assert parse(formula.text) == formula
        return
    assert 0 <= error.offset <= len(text)


@given(st.text(alphabet="x1.e+-*/(), <=>^", max_size=40))
def test_anything_like_a_formula_has_a_value_or_an_error(text: str) -> None:
    try:
        value = parse(text).value({"x": 0.5, "e": 2.0})
    except FormulaError:
        return
    assert not math.isnan(value)


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("", 1, "ends early"),
        ("1 +", 4, "ends early"),
        ("2x", 2, "2*x"),
        ("a^2", 2, "**"),
        ("1 + sin", 5, "sin(...)"),
        ("1 + sni(x)", 5, "'sin'"),
        ("(1 + (2)", 1, "never closed"),
        ("atan2(x", 6, "never closed; put a formula with a comma in quotes"),
        ("1)", 2, "unexpected ')'"),
        ("x = 1", 3, "not an assignment"),
        ("x < 1", 3, "condition"),
        ("hypot(1)", 1, "takes 2"),
        ("min(1)", 1, "at least 2"),
        ("sqrt()", 6, "unexpected ')'"),
        ("1 + 1/0", 6, "division by zero"),
        ("1 + sqrt(-1)", 5, "no value"),
        ("inf - inf", 5, "no value"),
        ("0*inf", 2, "no value"),
        ("1e308*10", 6, "too large"),
        ("exp(1000)", 1, "too large"),
        ("0**-1", 2, "division by zero"),
        ("1e400", 1, "too large"),
        ("a b", 3, "unexpected 'b'"),
        ("x.", 2, "unexpected character '.'"),
        ("x$", 2, "unexpected character '$'"),
    ],
)
def test_reading_errors_point_at_the_place(text: str, column: int, words: str) -> None:
    with pytest.raises(FormulaError) as caught:
        parse(text)
    assert caught.value.offset == column - 1
    assert words in str(caught.value)


@pytest.mark.parametrize("wrong", [math.nan, True, None, [1], 10**400])
def test_values_that_are_neither_number_nor_text_are_refused(wrong: object) -> None:
    with pytest.raises(FormulaError):
        parse(wrong)  # type: ignore[arg-type]


def test_evaluation_errors_point_at_the_operation() -> None:
    formula = parse("1 + 2/(x - 1)")
    with pytest.raises(FormulaError, match="division by zero") as caught:
        formula.value({"x": 1.0})
    assert caught.value.offset == 5
    with pytest.raises(FormulaError, match="too large"):
        parse("exp(x)").value({"x": 1e4})
    with pytest.raises(FormulaError, match="no value at -1"):
        parse("log(x)").value({"x": -1.0})
    with pytest.raises(FormulaError, match="not a number"):
        parse("x").value({"x": math.nan})


def test_an_expression_without_a_real_value_is_refused() -> None:
    x = sp.Symbol("x", real=True)
    for text in ["1/(x - x)", "sqrt(x - x - 1)", "(sqrt(x - x - 1))**2", "inf*(x - x)"]:
        with pytest.raises(FormulaError, match="no real value"):
            parse(text).to_sympy({"x": x})


def test_an_unknown_name_is_reported_with_similar_ones() -> None:
    formula = parse("1 + frction")
    known = {"friction": sp.Symbol("a"), "g": sp.Symbol("b")}
    for use in (lambda: formula.to_sympy(known), lambda: formula.value({"friction": 1, "g": 2})):
        with pytest.raises(FormulaError) as caught:
            use()
        assert str(caught.value) == (
            "formula '1 + frction': unknown name 'frction'; "
            "did you mean 'friction'? known: friction, g"
        )
        assert caught.value.offset == 4


@pytest.mark.parametrize(
    ("text", "when_false", "at_edge", "when_true"),
    [("x <= 2", 3, 2, 1), ("x < 2", 3, 2, 1), ("x >= 2", 1, 2, 3), ("2 < x", 1, 2, 3)],
)
def test_margin_falls_through_zero_as_a_relation_becomes_true(
    text: str, when_false: float, at_edge: float, when_true: float
) -> None:
    x = sp.Symbol("x")
    margin = parse_relation(text).margin({"x": x})
    assert margin.subs(x, when_false) > 0
    assert margin.subs(x, at_edge) == 0
    assert margin.subs(x, when_true) < 0


def test_relation_knows_its_names_and_text() -> None:
    relation = parse_relation("a.x + b <= max(c, 1)")
    assert relation.names == {"a.x", "b", "c"}
    assert [one.operator for one in relation.comparisons] == ["<="]
    assert relation.text == "a.x + b <= max(c, 1)"
    with pytest.raises(FormulaError, match="unknown name 'c'") as caught:
        relation.require({"a.x", "b"})
    assert caught.value.offset == 15


@pytest.mark.parametrize("text", ["x", "x = 0", "0 < x < 1", "< 1", "x <", ""])
def test_texts_that_are_no_relation_are_refused(text: str) -> None:
    with pytest.raises(FormulaError):
        parse_relation(text)


def test_parameters_are_ordered_and_evaluated() -> None:
    formulas = {"a": parse("b + c"), "b": parse("2*c"), "c": parse(3), "mu": parse("inf")}
    order = order_parameters(formulas)
    assert order.index("c") < order.index("b") < order.index("a")
    assert Constants(formulas).values({}) == {"a": 9, "b": 6, "c": 3, "mu": math.inf}
    assert list(Constants(formulas).values({})) == ["a", "b", "c", "mu"]
    assert Constants(formulas).values({"c": 1, "mu": 0.5}) == {"a": 3, "b": 2, "c": 1, "mu": 0.5}
    assert Constants(formulas).values({"b": 1})["a"] == 4


def test_cyclic_parameters_name_the_cycle() -> None:
    formulas = {"z": parse("a"), "a": parse("b + 1"), "b": parse("c"), "c": parse("2*a")}
    with pytest.raises(FormulaError) as caught:
        order_parameters(formulas)
    cycle = caught.value.message.split(": ")[-1].split(" -> ")
    assert cycle[0] == cycle[-1] == caught.value.name
    assert sorted(cycle[1:]) == ["a", "b", "c"]
    assert all(b in formulas[a].names for a, b in pairwise(cycle))
    with pytest.raises(FormulaError, match="x -> x"):
        order_parameters({"x": parse("x + 1")})


def test_an_override_of_one_parameter_breaks_a_cycle() -> None:
    assert Constants({"a": parse("b"), "b": parse("a")}).values({"a": 2}) == {"a": 2, "b": 2}


def test_wrong_parameters_are_named() -> None:
    with pytest.raises(FormulaError, match=r"unknown parameter 'nu'.*known: mu"):
        Constants({"mu": parse(1)}).values({"nu": 1})
    with pytest.raises(FormulaError, match="unknown name 'm'") as caught:
        Constants({"mu": parse("m")}).values({})
    assert caught.value.name == "mu"
    with pytest.raises(FormulaError, match="division by zero") as caught:
        Constants({"a": parse("1/b"), "b": parse(0)}).values({})
    assert caught.value.name == "a"
    with pytest.raises(FormulaError):
        Constants({"a": parse(1)}).values({"a": math.nan})


def test_errors_are_one_tree_and_can_be_sent_to_another_process() -> None:
    with pytest.raises(FormulaError) as caught:
        parse("1 +")
    assert isinstance(caught.value, DeclarationError | StatechartError)
    copy = pickle.loads(pickle.dumps(caught.value))
    assert str(copy) == str(caught.value)
    assert copy.offset == 3


@pytest.mark.parametrize(
    "text", ["sqrt(abs(x))", "max(2, x, y)", "sin(x) + min(x, y)", "abs(y)**(3/2)*sign(x)"]
)
def test_to_text_writes_formulas_that_parse(text: str) -> None:
    symbols = {name: sp.Symbol(name, real=True) for name in "xy"}
    assert to_text(parse(text).to_sympy(symbols)) == text
