"""Guards and stop conditions with several comparisons fire when they first hold."""

from __future__ import annotations

import math

import pytest

import statechart
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NonFinite
from statechart.loading.load import interpret

ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy"])

CHART = """
kind: chart
name: watched
parameters: {k: -1}
variables: {x: 1, c: 1, s: 0, n: 0, count: 0}
regions:
  m: {initial: a, states: {a: {flows: {x: -1, c: -s, s: c}}}}
  clock: {initial: w, states: {w: {}}, transitions: [
    {name: tick, from: w, every: 1, updates: {count: count + 1}}]}
  gate:
    initial: shut
    states: {shut: {}, open: {initial: slow, states: {slow: {}, fast: {}}}}
    transitions:
      - {name: opens, from: shut, to: open, guard: c <= 0}
      - {name: hurries, from: slow, to: fast, after: 0.25}
"""
GUARD = """
  e: {initial: w, states: {w: {}, d: {}}, transitions: [
    {name: hit, from: w, to: d, guard: "RELATION"}]}
stop: {time: 7}
"""
STOP = """
stop: {time: 7, conditions: {hit: "RELATION"}}
"""
PI = math.pi

FIRST = {
    # An operand that stays at zero, as a number, a variable or a difference.
    "max(x, n) <= 0": 1.0,
    "max(c, n) <= 0": PI / 2,
    "max(c, x - (1 - time)) <= 0": PI / 2,
    "not min(-c, n) < 0": PI / 2,
    "min(1.5 - time, count - 3) >= 0 or min(time - 3.5, count - 3) >= 0": 3.5,
    # Corners in sums, scaled, in products and in other functions.
    "abs(x) + abs(x + 2) <= 2": 1.0,
    "k*max(x, n) >= 0": 1.0,
    "2 - 3*max(-x, n) <= 0.5": 1.5,
    "exp(max(x, n)) <= 1": 1.0,
    # Roots, which have no derivative where they are zero.
    "sqrt(abs(x)) <= 0": 1.0,
    "sqrt(max(x, 0)) <= 0": 1.0,
    "2*sqrt(abs(x)) - 1 <= 0": 0.75,
    "abs(x + 1)**(1/3) <= time": 1.0,
    "sqrt(abs(x)) >= 1.5 and x < 0": 3.25,
    # Parts that hold at different times, one after another.
    "x <= 0 and c <= 0": PI / 2,
    "x <= 0 and c >= 0 and s <= 0": 3 * PI / 2,
    "(x <= -1 and s >= 0.5) or (x <= -3 and c < -0.5)": 2.0,
    "not (x > -2 or s > 0)": PI,
    "x <= -1 and not (c <= 0 and x >= -3)": 4.0,
    # At one instant only, and never.
    "abs(x + 0.5) <= 0": 1.5,
    "time >= 2.5 and time <= 2.5": 2.5,
    "abs(x) < 0": None,
    "max(c, n) < 0": None,
    "sin(abs(s)) < abs(n)": None,
    # Values that only jumps change, and states of regions.
    "count == 3": 3.0,
    "count != 0 and x <= 0.5": 1.0,
    "in(gate.open)": PI / 2,
    "in(gate.open) and c >= 0": 3 * PI / 2,
    "in(gate.fast) or x <= -3": PI / 2 + 0.25,
    "not in(gate.slow) and count >= 1": 1.0,
}


def run(text: str, engine: str):
    return statechart.run(interpret(read_text(text)), engine=engine)


@ENGINES
@pytest.mark.parametrize("relation", FIRST)
def test_a_guard_fires_when_its_relation_first_holds(relation, engine):
    trace = run(CHART + GUARD.replace("RELATION", relation), engine).trace
    fired = [jump.t for jump in trace.jumps if jump.cause == "hit"]
    expected = [] if FIRST[relation] is None else [pytest.approx(FIRST[relation], abs=1e-11)]
    assert fired == expected
    assert not trace.warnings


@ENGINES
@pytest.mark.parametrize("relation", FIRST)
def test_a_run_stops_when_a_condition_first_holds(relation, engine):
    trace = run(CHART + STOP.replace("RELATION", relation), engine).trace
    if FIRST[relation] is None:
        assert trace.outcome is Outcome.HORIZON
    else:
        assert trace.outcome is Outcome.STOPPED
        assert trace.t_end == pytest.approx(FIRST[relation], abs=1e-11)
        assert (trace.jumps[-1].cause, trace.jumps[-1].fired) == ("stop", ("hit",))


def test_switching_the_watched_atom_is_no_jump():
    relation = "x <= 0 and sin(40*time) >= 0.5 and time >= 6.9"
    text = CHART.replace("every: 1,", "every: 10,") + GUARD.replace("RELATION", relation)
    result = run(text + "\nsettings: {max_jumps: 5}", "taylor")
    hit = result.trace.jumps[-1]
    assert [jump.cause for jump in result.trace.jumps] == ["opens", "hurries", "hit"]
    # The first place after 6.9 at which the sine comes to 1/2.
    turns = math.ceil((40 * 6.9 - PI / 6) / (2 * PI))
    phase = 40 * 6.9 % (2 * PI)
    expected = 6.9 if PI / 6 <= phase <= 5 * PI / 6 else (PI / 6 + 2 * PI * turns) / 40
    assert hit.t == pytest.approx(expected, abs=1e-10)


def test_alternating_atoms_do_not_end_a_run():
    relation = "min(s, -s) > 0"
    trace = run(CHART + GUARD.replace("RELATION", relation), "taylor").trace
    assert trace.outcome is Outcome.HORIZON
    assert {jump.cause for jump in trace.jumps} == {"tick", "opens", "hurries"}


def test_list_of_relations_is_a_conjunction():
    listed = CHART + GUARD.replace('"RELATION"', "[x <= 0, c <= 0 or n > 1]")
    model = interpret(read_text(listed))
    assert model.regions["e"].transitions[0].guard == "x <= 0 and (c <= 0 or n > 1)"
    fired = [jump.t for jump in statechart.run(model).trace.jumps if jump.cause == "hit"]
    assert fired == [pytest.approx(PI / 2, abs=1e-11)]


def test_reports_have_the_margin_of_the_whole_relation():
    relation = "x <= -2 and c <= 0"
    result = run(CHART + GUARD.replace("RELATION", relation), "taylor")
    margins = result.to_dict()["margins"]
    assert [name for name in margins if name.startswith("e.")] == ["e.hit"]
    assert margins["e.hit"] == pytest.approx(0.0, abs=1e-12)


def test_check_passes_if_single_atoms_hold():
    relation = "x <= 0 and c >= 0 and s <= 0"
    report = statechart.check(
        interpret(read_text(CHART + GUARD.replace("RELATION", relation))), examples=1
    )
    assert report.passed, report


@pytest.mark.parametrize(
    ("relation", "reported"),
    [
        ("x == 0", "== compares 'x', which changes between events; write >= if it rises"),
        ("time != 1", "!= compares 'time', which changes between events"),
        ("in(gate.opened)", "no state 'opened'; did you mean 'open'"),
        ("in(gates.open)", "no region 'gates'; did you mean 'gate'"),
        ("0 <= x <= 1", "a comparison has two sides; write 0 <= x and x <= 1"),
        ("[x <= 0, y <= 0]", "unknown name 'y'"),
        ("[x <= 0, 7]", "is not a relation; write x <= 0"),
        ("[]", "an empty list is no relation"),
    ],
)
def test_wrong_relations_are_reported_with_their_place(relation, reported):
    quoted = relation if relation.startswith("[") else f'"{relation}"'
    text = CHART + GUARD.replace('"RELATION"', quoted)
    line = next(i for i, line in enumerate(text.splitlines(), 1) if "name: hit" in line)
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "f.yaml"))
    assert reported in str(caught.value)
    assert caught.value.line == line


@pytest.mark.parametrize("word", ["and", "or", "not", "in"])
def test_relation_keywords_refer_to_states_only(word):
    with pytest.raises(DeclarationError, match=f"'{word}' is a word of relations"):
        interpret(read_text(CHART.replace("{k: -1}", f"{{{word}: 1}}")))
    text = CHART.replace("shut", word) + GUARD.replace("RELATION", f"in(gate.{word})")
    fired = [jump.t for jump in run(text, "taylor").trace.jumps if jump.cause == "hit"]
    assert fired == [0.0]


@ENGINES
@pytest.mark.parametrize(
    ("invariant", "least"),
    [
        ("not in(gate.open) or x <= -0.5", PI / 2 - 1.5),
        ("not in(gate.open) or x <= -1", PI / 2 - 2.0),
        ("in(gate.shut) or c <= 0 and in(m.a)", 0.0),
        ("in(gate.shut) or in(gate.open)", math.inf),
        ("not in(gate.fast)", -math.inf),
        ("not in(gate.fast) or time >= 1", PI / 2 - 0.75),
        # Without a value where another part decides.
        ("in(gate.open) or 1/(time - 2) <= -0.5", 0.0),
    ],
)
def test_invariant_margin_counts_only_its_states(invariant, least, engine):
    text = CHART + f'stop: {{time: 1.9}}\ninvariants: {{i: "{invariant}"}}'
    found = run(text, engine).to_dict()["invariants"]["i"]
    assert float(found) == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize(
    ("where", "invariant", "message"),
    [
        ("RUN", "not in(gate.open) or x <= -0.5", ""),
        ("RUN", "not in(gate.open) or x <= -1", "the margin of 'i' is -0."),
        ("RUN", "not in(gate.fast)", "i does not hold between t = 1.8"),
        ("RUN", "count != 1", "i does not hold at t = 1"),
        ("STATE", "not in(gate.open) or x <= -0.5", ""),
        ("STATE", "not in(gate.open) or x <= -1", "the margin of 'm.i' is -0."),
        ("STATE", "not in(gate.open)", "m.i does not hold between t = 1.5"),
    ],
)
def test_check_evaluates_invariants_in_their_states(where, invariant, message):
    text = CHART
    if where == "STATE":
        text = text.replace("s: c}}}", f's: c}}, invariants: {{i: "{invariant}"}}}}}}')
    else:
        text = f'invariants: {{i: "{invariant}"}}\n{text}'
    found = statechart.check(interpret(read_text(text + "stop: {time: 1.9}")), examples=1)
    failures = {one.name: one.failure.message for one in found.properties if one.failure}
    assert [*failures] == (["declared invariants hold"] if message else [])
    assert message in failures.get("declared invariants hold", "")


def test_an_invariant_of_a_mode_of_zero_duration_is_evaluated_in_its_states():
    # Both transitions are taken at one instant, one after the other.
    twins = """
  one: {initial: a, states: {a: {}, b: {}}, transitions: [
    {name: go, from: a, to: b, guard: x <= 0}]}
  two: {initial: a, states: {a: {}, b: {}}, transitions: [
    {name: go, from: a, to: b, guard: in(one.b)}]}
stop: {time: 2}
invariants: {both: "in(one.a) or in(two.b)", either: "in(one.b) or in(two.a)"}
"""
    found = run(CHART + twins, "taylor").to_dict()["invariants"]
    assert found == {"both": "-inf", "either": "inf"}
    (failed,) = (
        one.failure.message
        for one in statechart.check(interpret(read_text(CHART + twins)), examples=1).properties
        if one.failure
    )
    at = "both does not hold at t = 1 in m:a clock:w gate:shut one:b two:a, which lasts no time"
    assert at in failed


LISTED = {
    "guard": "  e:\n    initial: w\n    states: {w: {}}\n    transitions:\n"
    "    - name: hit\n      from: w\n      to: w\n      guard:",
    "of a state": "  e:\n    initial: w\n    states:\n      w:\n        invariants:\n          i:",
    "stop": "stop:\n  conditions:\n    i:",
    "of a run": "invariants:\n  i:",
}


@pytest.mark.parametrize("field", LISTED)
@pytest.mark.parametrize(
    ("wrong", "column", "message"),
    [
        ("x <= why", 6, "unknown name 'why'"),
        ("x <= 1 or why <= 1", 11, "unknown name 'why'"),
        ("in(gate.closed)", 1, "no state 'closed'"),
        ("x == 0", 3, "== compares 'x'"),
    ],
)
def test_a_mistake_in_a_list_of_relations_has_the_place_of_its_item(field, wrong, column, message):
    items = ["x <= 3 or c <= 3", "count >= 0", wrong, "x <= 9"]
    text = CHART + LISTED[field] + "".join(f"\n            - {item}" for item in items)
    with pytest.raises(DeclarationError) as caught:
        interpret(read_text(text, "f.yaml"))
    assert message in str(caught.value)
    assert f".2: formula '{wrong}'" in str(caught.value)
    assert caught.value.line == text.count("\n")
    assert caught.value.column == len("            - ") + column


INSTANT = """
kind: chart
name: instant
variables: {x: 0, y: 0}
regions:
  r:
    initial: waits
    states: {waits: {flows: {x: 1, y: 2}}, done: {}}
    transitions: [{name: t, from: waits, to: done, guard: "GUARD"}]
stop: {time: 1}
"""


@ENGINES
@pytest.mark.parametrize(
    ("guard", "time"),
    [
        ("sign(x - 0.5)**2 <= 0", 0.5),
        ("abs(sign(x - 0.5)) <= 0", 0.5),
        ("not 2*sign(x - 0.5)**4 > 0", 0.5),
        ("sign(0.5 - x) <= 0", 0.5),
        ("sign(x - 0.5)**2 < 0", None),
        ("sign(x - 0.5)**2 + 3*sign(y - 1)**2 <= 0", 0.5),
        ("sign(x - 0.5)**2 + 3*sign(y - 1.1)**2 <= 0", None),
        ("sign(x - 0.5)**2*sign(y - 1.1)**2 <= 0", 0.5),
        ("(x + 1)*sign(x - 0.5)**2 <= 0", 0.5),
        ("(0.7 - x)*sign(x - 0.5)**2 < 0", 0.7),
        ("-sign(x - 0.5)**2 >= 0", 0.5),
        ("-sign(x - 0.5)**2 < 0", 0.0),
    ],
)
def test_guard_that_signs_make_true_at_one_instant_fires_there(guard, time, engine):
    model = interpret(read_text(INSTANT.replace("GUARD", guard)))
    jumps = statechart.run(model, engine=engine).trace.jumps
    assert [jump.t for jump in jumps] == pytest.approx([] if time is None else [time], abs=1e-14)


@ENGINES
@pytest.mark.parametrize(
    ("guard", "time"),
    [
        ("sign(0.5 - x) <= -1", 0.5),
        ("sign(x - 0.5) >= 1", 0.5),
        ("sign(0.5 - x) + sign(0.8 - x) <= 0", 0.5),
        ("sign(0.5 - x) + sign(0.8 - x) <= -2", 0.8),
        ("sign(0.5 - x)*sign(0.8 - x) <= -1", 0.5),
        ("abs(sign(0.5 - x) + 1) <= 0", 0.5),
        ("sign(0.25 - x)*y <= -1.2", 0.6),
        ("sign(x + 1) <= -1", None),
    ],
)
def test_guard_on_a_value_of_a_sign_fires_where_the_sign_changes(guard, time, engine):
    model = interpret(read_text(INSTANT.replace("GUARD", guard)))
    jumps = statechart.run(model, engine=engine).trace.jumps
    assert [jump.t for jump in jumps] == pytest.approx([] if time is None else [time], abs=1e-14)


@ENGINES
def test_reciprocal_of_a_square_of_a_sign_has_no_value_where_the_sign_changes(engine):
    model = interpret(read_text(INSTANT.replace("GUARD", "1/sign(x - 0.5)**2 <= 0")))
    with pytest.raises(NonFinite, match=r"guard r.t has no value near t = 0.5;"):
        statechart.run(model, engine=engine)
