"""Runs whose guards or gaps lose their value end where they do, on every engine."""

from __future__ import annotations

import pytest
from scenes import compose, engine, region

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator
from statechart.loading.load import interpret

ROOF = """
kind: scene
name: roof
gravity: 1
bodies: {ball: {mass: 1, start: {x: 1, dx: -1, y: 1}}}
surfaces: {roof: {height: sqrt(x)}}
contacts: {c: {point: {body: ball}, surface: roof, modes: [free, slide], friction: 0,
  restitution: 0}}
stop: {time: 3}
"""


FREE = "modes: [free, slide], friction: 0, restitution: 0"
SLIDING = f"""
kind: scene
name: sliding
gravity: 1
bodies: {{ball: {{mass: 1, start: {{x: 1, dx: -1}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{c: {{point: {{body: ball}}, surface: floor, {FREE}CONDITION}}}}
controls: {{push: 0}}
forces: {{drive: {{body: ball, force: [0, push]}}}}
regions:
  r:
    initial: a
    states: {{a: {{}}, b: {{sets: {{push: 1}}}}}}
    transitions: [{{name: go, from: a, to: b, guard: "GUARD"}}]
stop: {{time: 3, conditions: {{low: "STOP"}}}}
"""
USUAL = {"CONDITION": "", "GUARD": "ball.x < -9", "STOP": "ball.x < -9"}
LOST = {
    "CONDITION": ", enabled: sqrt(ball.x) > -1",
    "GUARD": "log(ball.x) < -1000",
    "STOP": "sqrt(ball.x) < -1",
}


@pytest.mark.parametrize("where", LOST)
@pytest.mark.parametrize(
    ("name", "step", "error"), [("taylor", None, 1e-12), ("impulse", 0.01, 0.02)]
)
def test_conditions_without_a_value_end_a_run(
    where: str, name: str, step: float | None, error: float
) -> None:
    text = SLIDING
    for place, words in {**USUAL, where: LOST[where]}.items():
        text = text.replace(place, words)
    model = interpret(read_text(text, "sliding.yaml"))
    trace = statechart.Runner(model, engine=name, step=step).run({}, throw=False).trace
    assert trace.outcome.name == "NON_FINITE"
    assert trace.t_end == pytest.approx(1.0, abs=error)


@pytest.mark.parametrize("name", ["taylor", "scipy"])
@pytest.mark.parametrize("guard", ["log(x) <= -100", "sqrt(x) + 1 <= 0"])
def test_a_guard_that_loses_its_value_is_reported_with_the_time(name: str, guard: str) -> None:
    states = {"s": {"x": "-1"}, "t": {}}
    go = {"name": "go", "from": "s", "to": "t", "guard": guard}
    automaton = compose({"x": 1}, {"r": region(states, go)})
    trace = Simulator(automaton, engine(name)).run({}, until=3.0, throw=False)
    assert trace.outcome.name == "NON_FINITE"
    assert trace.t_end == pytest.approx(1.0, abs=1e-12)
    assert trace.final == pytest.approx([0.0], abs=1e-12)


@pytest.mark.parametrize(
    ("name", "step", "error"),
    [("taylor", None, 1e-12), ("scipy", None, 1e-12), ("impulse", 1e-3, 2e-3)],
)
def test_ground_leaving_its_domain_ends_the_run(
    name: str, step: float | None, error: float
) -> None:
    model = interpret(read_text(ROOF, "roof.yaml"))
    trace = statechart.Runner(model, engine=name, step=step).run({}, throw=False).trace
    assert trace.outcome.name == "NON_FINITE"
    assert trace.t_end == pytest.approx(1.0, abs=error)
