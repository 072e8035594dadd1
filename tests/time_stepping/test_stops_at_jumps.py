"""Stop conditions that an impact, a controller or the first force makes true."""

from __future__ import annotations

import math

import numpy as np
import pytest

import statechart
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G, STEP = 9.81, 1e-3

POINT = f"""
kind: scene
name: thrown
parameters: {{high: 1}}
gravity: {G}
bodies: {{b: {{mass: 1, start: {{y: high}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{tip: {{point: {{body: b}}, surface: floor, friction: 0.3, restitution: 0.5}}}}
stop: {{time: 1, conditions: {{met: b.dy > 0.1}}}}
outputs: {{t: {{value: time}}, v: {{value: b.dy}}, n: {{count: tip.touchdown}}}}
"""
SHAPE = f"""
kind: scene
name: thrown
gravity: {G}
bodies: {{ball: {{mass: 1, inertia: 0.1, shape: {{disc: 0.1}}, start: {{y: 1.1}}}}}}
surfaces: {{floor: {{height: 0}}}}
collisions: {{all: {{bodies: [ball], surfaces: [floor], friction: 0.3, restitution: 0.5}}}}
stop: {{time: 1, conditions: {{met: ball.dy > 0.1}}}}
outputs: {{t: {{value: time}}, v: {{value: ball.dy}}, n: {{count: ball.touchdown}}}}
"""


def run(text, **values):
    model = interpret(read_text(text))
    result = statechart.run(model, engine="impulse", step=STEP, parameters=values)
    assert result.trace.outcome is Outcome.STOPPED
    return result


@pytest.mark.parametrize("text", [POINT, SHAPE])
@pytest.mark.parametrize("record", ["modes", "poses", "nothing"])
def test_a_stop_on_rising_velocity_comes_after_the_bounce(text, record):
    result = run(f"{text}settings: {{record: {record}}}\n")
    fall = math.sqrt(2 / G)
    # It is a step deep at most, and moves back from there.
    assert result.outputs["t"] == pytest.approx(fall, abs=2 * STEP)
    assert result.outputs["v"] == pytest.approx(G * fall / 2, abs=2 * G * STEP)
    assert result.outputs["n"] == 1
    trace = result.trace
    assert trace.final[len(trace.final) // 2 + 1] == result.outputs["v"]
    if record != "nothing":
        last = trace.arcs[-1]
        assert last.states(np.array([last.duration]))[0] == pytest.approx(trace.final, abs=1e-12)


def test_initial_force_stops_the_run_at_the_start():
    result = run(POINT.replace("b.dy > 0.1", "tip.V > 5"), high=0)
    assert result.outputs["t"] == 0.0
    assert result.trace.final.tolist() == [0.0, 0.0, 0.0, 0.0]


def test_a_stop_made_true_by_a_controller_comes_after_its_transition():
    controlled = """
controls: {push: 0}
regions:
  hand:
    initial: off
    states: {off: {}, on: {sets: {push: 3}}}
    transitions: [{name: go, from: off, to: on, guard: time >= 0.0505}]
"""
    text = POINT.replace("b.dy > 0.1", "b.dy + push > 1").replace("tip.touchdown", "hand.go")
    result = run(text + controlled)
    assert result.outputs["n"] == 1
    assert result.outputs["t"] == pytest.approx(0.0505, abs=STEP)
    assert [jump.cause for jump in result.trace.jumps] == ["go", "stop"]
