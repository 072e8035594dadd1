"""A rod slides from ice onto rubber, tip ahead, and jams: by `paradox: stop` that ends the run."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

_G, _L, _LEAN, _ICE, _WAY = 9.81, 0.5, 0.3, 0.2, 0.4
_ROD = f"""
kind: scene
name: rubber
parameters: {{l: {_L}, a: {_LEAN}, s: {_WAY}, rubber: 1.5}}
gravity: {_G}
bodies:
  rod: {{mass: 1, inertia: l**2/3, start: {{x: -l*sin(a), y: l*cos(a), angle: a, dx: 2}}}}
surfaces: {{floor: {{height: 0}}}}
controls: {{mu: {_ICE}}}
contacts:
  tip: {{point: {{body: rod, at: [0, -l]}}, surface: floor, friction: mu, restitution: 0}}
regions:
  ground:
    initial: ice
    states: {{ice: {{}}, rubber: {{sets: {{mu: rubber}}}}}}
    transitions:
      - {{name: enters, from: ice, to: rubber, guard: rod.x + l*sin(rod.angle) >= s}}
paradox: stop
stop: {{time: 0.5}}
outputs: {{t: {{value: time, at: first enters}}, angle: {{value: rod.angle, at: first enters}}}}
"""


@functools.cache
def _arrives() -> tuple[float, float]:
    """Return when the tip comes to the rubber, and how far the rod leans then."""

    def rates(t, q):
        _, a, v, w = q
        turned = 3.0 * (math.sin(a) - _ICE * math.cos(a)) / _L
        load = (_G - _L * math.cos(a) * w**2) / (1.0 + _L * math.sin(a) * turned)
        return [v, w, -_ICE * load, turned * load]

    def there(t, q):
        return q[0] + _L * math.sin(q[1]) - _WAY

    there.terminal = True
    start = [-_L * math.sin(_LEAN), _LEAN, 2.0, 0.0]
    found = solve_ivp(rates, (0.0, 1.0), start, events=there, rtol=1e-12, atol=1e-13)
    return found.t[-1], found.y[1, -1]


def _critical() -> float:
    """Return the friction above which sliding is pressed in (Genot and Brogliato 1999)."""
    a = _arrives()[1]
    return (1.0 / (3.0 * math.sin(a)) + math.sin(a)) / math.cos(a)


def _run(**settings):
    return statechart.run(interpret(read_text(_ROD)), throw=False, **settings)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_paradox_stop_ends_the_run_at_the_rubber(engine):
    result = _run(engine=engine)
    t, angle = _arrives()
    assert result.trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert [result.trace.t_end, result.outputs["angle"]] == pytest.approx([t, angle], rel=1e-10)


@pytest.mark.parametrize("record", ["modes", "poses", "nothing"])
@pytest.mark.parametrize("step", [2e-3, 1e-3, 3e-4])
def test_paradox_stop_ends_a_run_by_steps_at_the_rubber(step, record):
    result = _run(engine="impulse", step=step, record=record)
    t, angle = _arrives()
    assert result.trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "Painleve" in result.trace.message
    assert t - 1e-12 <= result.trace.t_end <= t + 2.0 * step
    assert result.outputs["angle"] == pytest.approx(angle, abs=3.0 * step)
    assert "tip.jam" not in {f"{jump.region}.{jump.cause}" for jump in result.trace.jumps}


@pytest.mark.parametrize("part", [0.97, 1.03])
@pytest.mark.parametrize("settings", [{"engine": "taylor"}, {"engine": "impulse", "step": 1e-4}])
def test_rod_slides_on_below_critical_friction(settings, part):
    until = _arrives()[0] + 5e-4
    result = _run(parameters={"rubber": part * _critical()}, until=until, **settings)
    assert (result.trace.outcome is Outcome.HORIZON) == (part < 1.0)


def test_a_jam_at_the_start_ends_the_run_there():
    values = {"a": _arrives()[1], "s": -1.0}
    for settings in ({"engine": "taylor"}, {"engine": "impulse", "step": 1e-3}):
        trace = _run(parameters=values, **settings).trace
        assert trace.outcome is Outcome.NO_CONSISTENT_MODE
        assert np.isclose(trace.t_end, 0.0)


def test_impacts_policy_continues_the_run():
    model = interpret(read_text(_ROD.replace("paradox: stop\n", "")))
    trace = statechart.run(model, engine="impulse", step=1e-3).trace
    assert [jump.cause for jump in trace.jumps][:2] == ["enters", "jam"]


def test_paradox_stop_warns_for_bodies_with_shapes():
    text = """
kind: scene
name: disc
gravity: 9.81
bodies: {d: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {y: 0.1, dx: 1}}}
surfaces: {floor: {height: 0}}
collisions: {all: {bodies: [d], surfaces: [floor], friction: 0.3, restitution: 0}}
paradox: stop
stop: {time: 0.01}
"""
    for said, wanted in ((text, 1), (text.replace("paradox: stop\n", ""), 0)):
        warnings = statechart.run(interpret(read_text(said))).warnings
        assert sum(line.startswith("paradox: stop: ") for line in warnings) == wanted
