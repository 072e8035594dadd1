"""Ends of runs whose stop condition is met by an impact, or at rest."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

_THROWN = """
kind: scene
name: thrown
parameters: {h: 1, v: 3, e: 0.5}
gravity: 10
bodies: {b: {mass: 1, start: {y: h, dx: v}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 10, restitution: e}}
stop: {time: 10, conditions: {over: CONDITION}}
outputs: {t: {value: time}}
"""
# It lands at t, where friction stops it along the floor, and lies after bounces of e, e^2, ...
_LANDS = math.sqrt(0.2)


def _lies(e: float) -> float:
    return _LANDS * (1.0 + 2.0 * e / (1.0 - e))


_ENDS: list[tuple[str, Callable[[float], float]]] = [
    ("b.dx <= 0", lambda e: _LANDS),
    ("0 >= b.dx", lambda e: _LANDS),
    ("c.slip <= 0", lambda e: _LANDS),
    ("b.dx < 0", lambda e: 10.0),
    ("b.dy > 0", lambda e: _LANDS if e else 10.0),
    ("b.dy >= 0", lambda e: _LANDS),
    # Above the floor nothing presses; on it the weight does, and no more than that.
    ("c.V > 0", _lies),
    ("c.V >= 10", _lies),
    ("c.V > 10", lambda e: 10.0),
    # A ball that has just been struck is at the floor, and rises.
    ("c.gap <= 0", _lies),
    ("c.gap < 0", lambda e: 10.0),
    ("b.y < 0", lambda e: 10.0),
]


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize(("condition", "end"), _ENDS, ids=[condition for condition, _ in _ENDS])
def test_a_condition_is_met_as_a_guard_fires(
    condition: str, end: Callable[[float], float], engine: str
) -> None:
    model = interpret(read_text(_THROWN.replace("CONDITION", condition)))
    runner = statechart.Runner(model, engine=engine)
    # Later runs take other ways through the same modes; the last bounces are skipped.
    for e in (0.0, 0.5, 0.7, 0.5):
        found = runner.run({"e": e}).outputs["t"]
        assert found == pytest.approx(end(e), rel=2e-6)
    if engine == "taylor":
        cells = statechart.sweep(model, {"e": [0.0, 0.5, 0.6, 0.7]})
        assert cells["t"].values == pytest.approx([end(e) for e in cells["e"].values], rel=2e-6)


@pytest.mark.parametrize(
    ("condition", "end"), [("b.dx <= 0", _LANDS), ("b.dx < 0", 2.0), ("b.dx**2 <= 0", _LANDS)]
)
@pytest.mark.parametrize("e", [0.0, 0.5])
def test_steps_meet_a_stop_condition_that_stays_on_its_boundary(
    condition: str, end: float, e: float
) -> None:
    model = interpret(read_text(_THROWN.replace("CONDITION", condition)))
    for step in (1e-3, 1.234e-3):
        found = statechart.run(
            model, engine="impulse", step=step, until=2.0, parameters={"e": e}
        ).outputs["t"]
        assert found == pytest.approx(end, abs=3 * step)
