"""Parsing of relations, and equivalence of their smooth atoms with their text."""

from __future__ import annotations

import random
import weakref

import pytest
import sympy as sp

from statechart.errors import FormulaError
from statechart.formulas.condition import MAX_ATOMS, And, AtomsAt, Or
from statechart.formulas.relation import conjunction, parse_relation
from statechart.formulas.tree import evaluate

NAMES = ("a", "b", "c", "x", "y")
SYMBOLS = {name: sp.Symbol(name, real=True) for name in NAMES}
ACTIVE = {("gate", "open")}


def active(region: str, state: str) -> bool:
    return (region, state) in ACTIVE


def python_truth(text: str, values: dict[str, float]) -> bool:
    """Let Python evaluate the relation as it is written."""
    return bool(eval(text, {"__builtins__": {}, "min": min, "max": max, "abs": abs}, values))


def truth(text: str, values: dict[str, float]) -> bool:
    condition = parse_relation(text).condition(SYMBOLS)
    at = {SYMBOLS[name]: value for name, value in values.items()}

    def of(k: int) -> bool:
        margin = float(condition.atoms[k].expression.xreplace(at))
        return margin < 0 or (margin == 0 and not condition.atoms[k].strict)

    found = condition.truth(of, active)
    assert found is not None
    # A certificate decides alone: other atoms may be anything.
    certificate = condition.certificate(of, active, lambda _: False)
    for other in (True, False, None):
        others = dict.fromkeys(range(len(condition.atoms)), other)
        others |= {k: of(k) for k in certificate}
        assert condition.truth(others.__getitem__, active) is found
    return found


def formula(random: random.Random, depth: int) -> str:
    kind = random.choice(["leaf", "min", "max", "abs", "sum", "scaled", "product", "square"])
    if depth == 0 or kind == "leaf":
        return random.choice([*NAMES, str(random.randint(-3, 3))])
    first, second = formula(random, depth - 1), formula(random, depth - 1)
    match kind:
        case "min" | "max":
            return f"{kind}({first}, {second})"
        case "abs":
            return f"abs({first})"
        case "sum":
            return f"({first} {random.choice('+-')} {second})"
        case "scaled":
            return f"{random.choice(['2', '-1', '-3'])}*({first})"
        case "product":
            return f"a*({first})"
    return f"({first})**2"


def relation(random: random.Random, depth: int) -> str:
    kind = random.choice(["and", "or", "not", "leaf", "leaf"])
    if depth == 0 or kind == "leaf":
        sign = random.choice(["<", "<=", ">", ">=", "==", "!="])
        return f"{formula(random, 2)} {sign} {formula(random, 1)}"
    first, second = relation(random, depth - 1), relation(random, depth - 1)
    return f"(not ({first}))" if kind == "not" else f"({first} {kind} {second})"


def test_smooth_atoms_are_equivalent_to_the_relation():
    chosen, compared = random.Random(43), 0
    for _ in range(60):
        text = relation(chosen, 2)
        for _ in range(8):
            # Small whole numbers: sides are often equal, and all arithmetic is exact.
            values = {name: float(chosen.randint(-2, 2)) for name in NAMES}
            try:
                found = truth(text, values)
            except FormulaError:
                break  # too many atoms
            assert found is python_truth(text, values), (text, values)
            compared += 1
    assert compared > 350


@pytest.mark.parametrize(
    ("text", "atoms"),
    [
        ("max(a, b) <= c", 2),
        ("min(a, b) - c <= 0", 2),
        ("abs(x) >= 1", 2),
        ("-max(a, b) + 2*abs(x) < y", 4),
        ("max(a, 1) <= 2", 1),
        ("sin(max(a, b)) <= c", 4),
        ("max(a, abs(x)) < x", 1),
    ],
)
def test_kinked_relations_become_smooth_atoms(text, atoms):
    condition = parse_relation(text).condition(SYMBOLS)
    assert len(condition.atoms) == atoms
    assert not any(atom.expression.has(sp.Max, sp.Min, sp.Abs) for atom in condition.atoms)


def test_too_many_atoms_are_refused():
    text = " + ".join(f"abs(x - {k}*y - {k * k})" for k in range(8)) + " <= 9"
    with pytest.raises(FormulaError, match=f"more than {MAX_ATOMS} comparisons"):
        parse_relation(text).condition(SYMBOLS)


def test_sums_of_kinks_in_one_variable_have_few_atoms():
    text = " + ".join(f"abs(x - {k})" for k in range(8)) + " <= 20"
    assert len(parse_relation(text).condition(SYMBOLS).atoms) < MAX_ATOMS
    assert truth(text, dict.fromkeys(NAMES, 3.0))
    assert not truth(text, dict.fromkeys(NAMES, 9.0))


def test_operators_have_python_precedence():
    term = parse_relation("not a <= 0 and b <= 0 or in(gate.open)").root
    assert [type(term), type(term.parts[0])] == [Or, And]
    assert truth("in(gate.open) and (not in(gate.shut))", dict.fromkeys(NAMES, 0.0))
    assert conjunction(["a <= 0"]) == "a <= 0"
    assert conjunction(["a <= 0", "b > 1 or c > 1"]) == "a <= 0 and (b > 1 or c > 1)"


def test_parentheses_hold_formulas_and_relations():
    values = {"a": 1.0, "b": 2.0, "c": 3.0, "x": 0.5, "y": -1.0}
    for text in ["(a + b)*2 <= 6", "((a)) <= 1", "((a <= 1) and (b) > 1)", "(max(a, (b)) > 1)"]:
        assert truth(text, values) is python_truth(text, values)


def test_the_margin_of_a_tree_falls_as_it_begins_to_hold():
    margin = parse_relation("x <= 0 and (y <= 1 or a == 2)").margin(SYMBOLS)
    at = {SYMBOLS["x"]: 1, SYMBOLS["y"]: 4, SYMBOLS["a"]: 7}
    assert margin.xreplace(at) == 3
    assert margin.xreplace({**at, SYMBOLS["y"]: 0}) == 1
    assert margin.xreplace({**at, SYMBOLS["y"]: 0, SYMBOLS["x"]: -2}) == -1


@pytest.mark.parametrize(
    ("text", "message", "offset"),
    [
        ("0 <= x <= 1", "two sides; write 0 <= x and x <= 1", 7),
        ("x <= 0 && y <= 0", "unexpected character '&'; where both must hold, write `and`", 7),
        ("x <= 0 || y <= 0", "unexpected character '|'; where one is enough, write `or`", 7),
        ("!(x <= 0)", "unexpected character '!'; write `not`", 0),
        ("x <= 0 and y", "a comparison is missing; write it as x <= 0, or in(REGION.STATE)", 12),
        ("x <= 0 and", "the formula ends early", 10),
        ("x + (y <= 0) > 1", "unexpected '<='", 7),
        ("(x <= 0) + 1 > 0", "a relation is not a number; it is true or false", 9),
        ("in(gate)", "`in` asks for a state of a region; write in(REGION.STATE)", 0),
        ("(x <= 0 and y <= 0", "this parenthesis is never closed", 0),
        ("x <= and", "unexpected 'and'; comparisons stand on both sides", 5),
    ],
)
def test_mistakes_have_a_place_and_advice(text, message, offset):
    with pytest.raises(FormulaError) as caught:
        parse_relation(text)
    assert message in str(caught.value)
    assert caught.value.offset == offset


def test_states_and_equalities_are_checked():
    relation = parse_relation("x == 1 or in(gate.shutt)")
    with pytest.raises(FormulaError, match="no state 'shutt'; did you mean 'shut'") as caught:
        relation.require_states({"gate": ("open", "shut")})
    assert caught.value.offset == 10
    for asked, known, written in (
        (
            "in(hook.broken)",
            ("closed", "off"),
            r"'hook' has no state 'broken'; write in\(hook.off\)",
        ),
        (
            "in(foot.stick)",
            ("free", "slide", "pin"),
            r"write in\(foot.pin\); known: free, pin, slide",
        ),
        ("in(foot.open)", ("free", "slide"), r"write in\(foot.free\)"),
    ):
        with pytest.raises(FormulaError, match=written):
            parse_relation(asked).require_states({asked[3:7]: known})
    with pytest.raises(FormulaError, match="no region 'gate'"):
        relation.require_states({"door": ("open",)})
    with pytest.raises(FormulaError, match="== compares 'x', which changes between events"):
        relation.require_still({"x"})
    relation.require_still({"y"})


def test_undefined_atom_is_ignored_if_another_decides():
    condition = parse_relation("x >= 0 and sqrt(x) >= 1").condition(SYMBOLS)
    known = {0: False, 1: None}
    assert condition.truth(known.__getitem__, active) is False
    assert condition.certificate(known.__getitem__, active, lambda _: False) == {0}
    assert condition.truth({0: True, 1: None}.__getitem__, active) is None


def test_formulas_of_comparisons_keep_their_places():
    relation = parse_relation("a <= 1 and b > 2*c")
    assert [one.text for one in relation.comparisons] == ["a <= 1", "b > 2*c"]
    last = relation.comparisons[1].right
    assert evaluate(last.root, {"c": 3.0}, None) == 6.0
    with pytest.raises(FormulaError) as caught:
        relation.require({"a", "b"})
    assert caught.value.offset == 17


def test_truths_of_atoms_are_freed_without_the_garbage_collector():
    atoms = AtomsAt([0.0], [1e-12], [True], lambda k: -1.0)
    assert atoms.holds(0)
    alive = weakref.ref(atoms)
    del atoms
    assert alive() is None
