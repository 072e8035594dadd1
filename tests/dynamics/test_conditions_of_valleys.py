"""Valleys of two surfaces whose contacts have conditions that exclude each other."""

from __future__ import annotations

import random

import pytest
from runs import ENGINES

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

TEXT = """
kind: scene
name: valley
parameters: {{a: 0.5, b: 0.5, mu: 0.1, e: 0, x: 0, y: 0, v: 0, w: 0}}
gravity: 9.81
bodies: {{ball: {{mass: 1, start: {{x: x, y: y, dx: v, dy: w}}}}}}
surfaces: {{down: {{height: -a*x}}, up: {{height: b*x}}}}
contacts:
  left:
    {{point: {{body: ball}}, surface: down, friction: mu, restitution: e, enabled: ball.x {0}}}
  right:
    {{point: {{body: ball}}, surface: up, friction: mu, restitution: e, enabled: ball.x {1}}}
stop: {{time: 0.5}}
"""
CONDITIONS = [("<= 0", ">= 0"), ("< 0", ">= 0"), ("<= 0", "> 0"), ("< 0", "> 0")]

# At rest in the kink at the end; the last falls onto it.
REST = [
    {"a": 1.0, "b": 1.02675, "mu": 0.0, "x": -0.359, "y": 0.359, "v": 0.748, "w": -0.748},
    {"a": 1.25, "b": 0.5, "mu": 1.0, "v": -1.0},
    {"a": 1.0, "b": 1.0, "mu": 0.0, "e": 0.5, "v": 1.0},
    {"a": 1.88, "b": 1.0, "mu": 0.5, "x": -0.07, "y": 0.1316, "v": 0.5, "w": -0.94},
    {"a": 1.654, "b": 1.667, "mu": 0.0, "x": 0.1, "y": 0.1667},
    {"a": 8.0, "b": 9.0, "mu": 0.0, "x": -0.01, "y": 0.08},
    {"a": 1.21, "b": 1.4, "mu": 1.0, "e": 0.5, "v": -0.0884, "w": 1.0},
]


def _runner(conditions: tuple[str, str], engine: str = "taylor", step: float | None = None):
    return Runner(read_text(TEXT.format(*conditions)), engine=engine, step=step)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("conditions", CONDITIONS)
def test_point_rests_at_the_bottom_of_a_valley(conditions: tuple[str, str], engine: str) -> None:
    run = _runner(conditions, engine)
    for values in REST:
        trace = run.run(values).trace
        assert trace.outcome is Outcome.HORIZON
        assert trace.final == pytest.approx([0.0] * 4, abs=1e-8)


def test_impact_in_a_narrow_valley_is_simultaneous() -> None:
    trace = _runner(("<= 0", "> 0")).run(REST[4]).trace
    (blow,) = (jump for jump in trace.jumps if len(jump.impulse) == 2)
    assert blow.after[2:] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert len(trace.jumps) < 10


def _siblings(count: int) -> list[dict[str, float]]:
    draw, found = random.Random(37), []
    for _ in range(count):
        values = {"a": draw.uniform(0.05, 3), "b": draw.uniform(0.05, 3)}
        values |= {"mu": draw.choice([0, 0.1, 0.5]), "e": draw.choice([0, 0, 0.5, 0.9])}
        side = draw.choice([-1, 1])
        slope, x = values["b"] if side > 0 else -values["a"], side * draw.uniform(0.01, 0.3)
        v = -side * draw.uniform(0, 2)
        found.append(values | {"x": x, "y": slope * x, "v": v, "w": slope * v})
    return found


def test_exclusive_conditions_move_like_ones_sharing_the_kink() -> None:
    shared, *others = (_runner(conditions) for conditions in CONDITIONS)
    for values in _siblings(16):
        final = shared.run(values).trace.final
        x, y = final[:2]
        assert y >= max(-values["a"] * x, values["b"] * x) - 1e-9
        for run in others:
            assert run.run(values).trace.final == pytest.approx(final, abs=1e-7)


@pytest.mark.parametrize("conditions", CONDITIONS)
def test_by_steps_no_point_falls_through_the_kink(conditions: tuple[str, str]) -> None:
    events = _runner(conditions)
    for step in (4e-4, 1e-4):
        steps = _runner(conditions, "impulse", step)
        for values in _siblings(3):
            plastic = values | {"e": 0.0}
            expected, result = events.run(plastic).trace, steps.run(plastic)
            assert result.trace.final[:2] == pytest.approx(expected.final[:2], abs=50 * step)
            assert not [text for text in result.warnings if "stays off" in text]


EDGES = """
kind: scene
name: edges
parameters: {s: 0.4, q: 0.7, x: 0, y: 0, mu: 0.1, e: 0.3, x0: -0.5, h: 0.2, v: 0.3}
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: x + x0, y: y + h, dx: v}}}
surfaces:
  left: {edge: [[x - 3, y + 3*s], [x, y]]}
  right: {edge: [[x, y], [x + 3, y + 3*q]]}
contacts:
  a: {point: {body: ball}, surface: left, friction: mu, restitution: e}
  b: {point: {body: ball}, surface: right, friction: mu, restitution: e}
stop: {time: 3}
"""
# The bounces end in the corner; edges at an acute angle, fast, and with unequal round-off.
INTO_CORNERS = [
    {"h": 0.4},
    {"s": 1.84, "q": 1.0, "mu": 0.418, "e": 0.0, "x0": 1e-9, "h": 0.398, "v": 0.0},
    {"s": 0.634, "q": 1.702, "e": 0.0, "x0": 0.926, "h": 1.59, "v": 0.0},
    {"s": 1.8, "q": 1.0, "mu": 0.453, "x0": 0.4626, "h": 0.784, "v": 0.0},
    {"s": 1.4, "q": 0.6, "x": -0.70112, "y": -0.67864, "mu": 0.0, "e": 0.0, "x0": 1e-9, "h": 6e-10},
    {"s": 0.521, "q": 0.461, "e": 0.301, "x0": 0.514, "h": 0.2926, "v": 0.99357},
    {"s": 0.7693, "q": 0.1929, "e": 0.668, "x0": 0.5, "h": 0.3309, "v": -0.1152},
    {"s": 1.7, "q": 0.1, "x": -1.09312, "y": 0.69903, "mu": 0.062, "e": 0.0, "x0": 0.74, "h": 0.46},
]


@pytest.mark.parametrize("engine", ENGINES)
def test_a_point_rests_where_the_ends_of_two_edges_meet(engine: str) -> None:
    runner = Runner(read_text(EDGES), engine=engine)
    for values in INTO_CORNERS:
        trace = runner.run(values).trace
        assert trace.outcome is Outcome.HORIZON
        left, right = values.get("s", 0.4), values.get("q", 0.7)
        x, y = trace.final[0] - values.get("x", 0.0), trace.final[1] - values.get("y", 0.0)
        assert y >= max(-left * x, right * x) - 1e-9
        assert trace.final[2:] == pytest.approx([0.0, 0.0], abs=1e-6)
