"""Truth of relations compared with the modes of a run, independent of margins."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import sympy as sp

from statechart.automaton.automaton import Automaton
from statechart.automaton.regions import Margin, Region, State
from statechart.documents.yaml_reader import read_text
from statechart.formulas.relation import parse_relation
from statechart.loading.kind import kind
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.checking import examine
from statechart.testing.guards import (
    assert_invariant_relations,
    assert_relations,
    truth,
)
from statechart.testing.properties import generic
from statechart.testing.subject import Subject

NAME = "relations hold where modes say so"
FALLS = """
kind: chart
name: falls
variables: {x: 1, n: 0}
regions:
  m: {initial: a, states: {a: {flows: {x: -1}}}}
  e:
    initial: w
    states: {w: {invariants: {high: x >= 0}}, d: {}}
    transitions: [{name: hit, from: w, to: d, guard: "x <= n"}]
stop: {time: 3}
"""
COUNTS = """
kind: chart
name: counts
variables: {T: 5, count: 1}
regions:
  oven: {initial: cool, states: {cool: {flows: {T: -1}}}}
  clock:
    initial: w
    states: {w: {}}
    transitions: [{name: tick, from: w, every: 1, updates: {count: count + 1}}]
  gate:
    initial: shut
    states: {shut: {}, open: {}}
    transitions: [{name: opens, from: shut, to: open, guard: "(T - 1.5)*count <= 0"}]
stop: {time: 10}
"""
SLIDES = """
kind: scene
name: slides
gravity: 9.81
bodies: {ball: {mass: 1, start: {dx: 1}}}
surfaces: {floor: {height: 0}}
controls: {push: 0}
forces: {f: {body: ball, force: [push, 0]}}
contacts:
  b:
    point: {body: ball}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: 0
    enabled: ball.x < 1
regions:
  c:
    initial: w
    states: {w: {}, "on": {sets: {push: 1}}}
    transitions: [{name: go, from: w, to: "on", guard: ball.x >= 0.5}]
stop: {time: 2, conditions: {far: ball.x > 2}}
"""


def changed(text: str, name: str, margin: Callable[[sp.Expr], sp.Expr]) -> Subject:
    """Return a subject with other margins of that name, or relation: its runs see other events."""
    model = interpret(read_text(text))
    automaton = kind(model.kind).automaton(model)
    assert isinstance(automaton, Automaton)

    def of(one: Margin) -> Margin:
        same = name not in (one.name, one.relation)
        return one if same else dataclasses.replace(one, expression=margin(one.expression))

    def region(one: Region) -> Region:
        def build(role: object) -> State:
            state = one.build(role)  # type: ignore[arg-type]
            return dataclasses.replace(state, margins=tuple(map(of, state.margins)))

        return dataclasses.replace(one, build=build)

    stops = tuple(
        dataclasses.replace(stop, margins=tuple(map(of, stop.margins))) for stop in automaton.stops
    )
    regions = tuple(map(region, automaton.regions))
    return Subject(model, dataclasses.replace(automaton, regions=regions, stops=stops))


def failure(subject: Subject) -> str:
    (item,) = (item for item in generic(subject) if item.name == NAME)
    (result,) = examine(subject, [item], examples=1, seed=1).properties
    return "" if result.failure is None else result.failure.message


def later(by: float) -> Callable[[sp.Expr], sp.Expr]:
    return lambda margin: margin + by


@pytest.mark.parametrize("text", [FALLS, COUNTS, SLIDES])
def test_relations_of_a_correct_run_hold(text: str) -> None:
    assert failure(changed(text, "", later(0))) == ""


@pytest.mark.parametrize("by", [1.0, 0.1, 1e-3, 1e-8])
@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        (FALLS, "e.hit", "e.hit holds at t = 1"),
        (COUNTS, "gate.opens", "gate.opens holds at t = 3.5"),
        (SLIDES, "c.go", "c.go holds at t = 0.5"),
        (SLIDES, "b: ball.x < 1", "b: ball.x < 1 does not hold at t = 0.91"),
        (SLIDES, "far", "far holds at t = 1."),
    ],
)
def test_check_detects_a_late_event(text: str, name: str, message: str, by: float) -> None:
    subject = changed(text.replace("x > 2}", "x > 1.9}"), name, later(by))
    found = failure(subject)
    assert found.startswith(f"taylor: {message}")


def test_check_detects_a_contact_that_stays_off() -> None:
    text = SLIDES.replace("ball.x < 1", "ball.x > 1")
    found = failure(changed(text.replace("dx: 1", "y: 5, dx: 3"), "b.off: ball.x > 1", later(0.5)))
    assert found.startswith("taylor: b is enabled holds at t = 0.3")


def test_check_detects_a_guard_passed_with_its_margin_at_zero() -> None:
    # The margin max(x, n) stays at zero once it is there; with a tolerance it never falls.
    text = FALLS.replace("x <= n", "max(x, n) <= 0").replace("{invariants: {high: x >= 0}}", "{}")
    subject = changed(text, "e.hit", lambda margin: sp.Max(margin, 0) + sp.Float(1e-9))
    assert failure(subject).startswith("taylor: e.hit holds at t = 1")
    (run,) = (trace for name, trace in subject.case({}).traces.items() if name == "taylor")
    assert not run.jumps
    with pytest.raises(AssertionError, match=r"e\.hit holds"):
        assert_relations(subject, run)


def test_check_detects_a_violated_invariant() -> None:
    text = FALLS.replace("x <= n", "x <= -0.5")
    subject = changed(text, "", later(0))
    with pytest.raises(AssertionError, match=r"^e\.high does not hold at t = 1"):
        assert_invariant_relations(subject, subject.case({}).trace)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("x < 1", [True, False, False]), ("x <= 1", [True, True, False]),
     ("x > 1", [False, False, True]), ("x >= 1", [False, True, True]),
     ("x == 1", [False, True, False]), ("x != 1", [True, False, True]),
     ("not x < 1", [False, True, True]), ("x < 1 or x > 1", [True, False, True]),
     ("x < 2 and not (x < 1 or in(r.b))", [False, True, False]),
     ("x < 2 and in(r.b)", [False, False, False])],
)  # fmt: skip
def test_truth_matches_comparisons_and_states(text: str, expected: list[bool]) -> None:
    relation = parse_relation(text)
    x = np.array([0.0, 1.0, 2.0])
    sides = [(x, np.full(3, one.right.value({}))) for one in relation.comparisons]
    found = truth(relation.root, iter(sides), lambda region, state: state == "a", 3)
    assert found.tolist() == expected


BRAKED = """
kind: scene
name: braked
bodies: {b: {mass: 1, inertia: 1, start: {dangle: 2}}}
couplings: {j: {bodies: [b], limit: 1, enabled: "cos(time) >= 1"}}
stop: {time: 1}
"""
FLAT = FALLS.replace("x <= n", "cos(x) >= 1 - 1e-12").replace("high: x >= 0", "high: x >= -1")
CIRCLES = """
kind: chart
name: circles
variables: {x: 1, y: 0}
regions:
  m: {initial: a, states: {a: {flows: {x: -y, y: x}}}}
  e: {initial: w, states: {w: {}, d: {}},
      transitions: [{name: hit, from: w, to: d, guard: "acos(x) >= 3"}]}
stop: {time: 4}
outputs: {t: {value: time, at: first e.hit}}
"""
BOUNCES = """
kind: scene
name: bounces
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts: {b: {point: {body: ball}, surface: floor, restitution: 0.5, friction: 0.3}}
stop: {time: 3, conditions: {s: "max(b.V, 0) > 5"}}
"""


@pytest.mark.parametrize("text", [BRAKED, FLAT, CIRCLES, BOUNCES])
def test_relations_within_round_off_of_their_bound_are_as_modes_say(text: str) -> None:
    subject = Subject(interpret(read_text(text)))
    case = subject.case({})
    for one in generic(subject):
        if not one.skipped:
            one.holds(case)


def test_an_accuracy_is_stated_where_a_greater_start_has_no_value() -> None:
    result = Runner(read_text(CIRCLES), accuracy=1e-9).run()
    assert result.outputs["t"] == pytest.approx(3.0, abs=1e-9)
    assert not result.warnings
