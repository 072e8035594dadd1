"""Conditions that are zero where a run begins, where contacts hand over, and after impacts."""

from __future__ import annotations

import math
from itertools import product

import pytest
from runs import ENGINES

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NonFinite
from statechart.running.result import Result
from statechart.running.runner import Runner
from statechart.sweeps.sweep import sweep


def _run(text: str, engine: str = "taylor", **values: float) -> Result:
    step = 1e-4 if engine == "impulse" else None
    return Runner(read_text(text), engine=engine, step=step).run(values)


def _gate(condition: str) -> str:
    return f"""
kind: scene
name: gate
parameters: {{g: 0}}
gravity: g
coordinates: {{q: {{start: 1, rate: 0}}}}
bodies: {{b: {{mass: 1, position: [0, q]}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  a:
    point: {{body: b}}
    surface: floor
    modes: [free, slide]
    friction: 0
    restitution: 0
    enabled: "{condition}"
stop: {{time: 0.4}}
"""


# Relations on their boundary at the start -> whether they hold after it, without and with gravity.
GATES = {
    "time <= 0": (False, False),
    "time < 0": (False, False),
    "time > 0": (True, True),
    "sin(time) <= 0": (False, False),
    "cos(time) >= 1": (False, False),
    "time**3 <= 0": (False, False),
    "(exp(time) - 1)**3 >= 0": (True, True),
    "1e6 + time <= 1e6": (False, False),
    "q >= 1": (True, False),
    "q > 1": (False, False),
    "dq < 0": (False, True),
    "q - 1 + time**2 > 0": (True, False),
    "-(dq**3) + 100 >= 100": (True, True),
    # Without a Taylor series there.
    "sqrt(time) <= 0": (False, False),
    "time**(1/3) > 0": (True, True),
    "time**1.5 <= 0": (False, False),
}


@pytest.mark.parametrize("condition", GATES)
def test_a_condition_that_is_zero_at_the_start_follows_its_derivative(condition: str) -> None:
    run = Runner(read_text(_gate(condition)))
    for g, holds in zip((0.0, 9.81), GATES[condition], strict=True):
        trace = run.run({"g": g}).trace
        assert trace.outcome.succeeded
        assert trace.start_mode == (("free",) if holds else ("off",))
        assert not trace.jumps


@pytest.mark.parametrize("engine", ["scipy", "impulse"])
@pytest.mark.parametrize("condition", ["time <= 0", "cos(time) >= 1", "time**3 <= 0", "q > 1"])
def test_other_engines_agree_on_a_condition_that_is_zero_at_the_start(
    condition: str, engine: str
) -> None:
    trace = _run(_gate(condition), engine).trace
    assert trace.outcome.succeeded
    assert trace.start_mode == (("free",) if GATES[condition][0] else ("off",))
    assert not trace.jumps


RIDGE = """
kind: scene
name: ridge
parameters: {s: 0.2, mu: 0.1, e: 0, v: 1, w: -s*v}
gravity: 9.81
bodies: {ball: {mass: 1, start: {dx: v, dy: w}}}
surfaces: {up: {height: s*x}, down: {height: -s*x}}
contacts:
  left:
    {point: {body: ball}, surface: up, friction: mu, restitution: e, enabled: ball.x <= 0}
  right:
    {point: {body: ball}, surface: down, friction: mu, restitution: e, enabled: ball.x >= 0}
stop: {time: 0.3}
"""


@pytest.mark.parametrize("engine", [*ENGINES, "impulse"])
def test_a_start_at_a_kink_slides_down_the_far_side_at_once(engine: str) -> None:
    result = _run(RIDGE, engine)
    s, mu, t = 0.2, 0.1, 0.3
    x = t + (s - mu) * 9.81 * t**2 / (2 * (1 + s**2))
    assert result.trace.final[:2] == pytest.approx([x, -s * x], abs=1e-9)
    assert not result.trace.jumps


def test_point_flies_off_a_kink_and_strikes_the_other_piece() -> None:
    trace = _run(RIDGE, v=1, w=0.2).trace
    # y = 0.2 t - g t**2 / 2 meets -0.2 t.
    (landing,) = trace.jumps
    assert (landing.region, landing.cause) == ("right", "touchdown")
    assert landing.t == pytest.approx(0.8 / 9.81, abs=1e-14)


def test_impact_at_a_kink_is_by_the_approaching_piece() -> None:
    for v in (1.0, -1.0):
        (blow, *_) = _run(RIDGE, v=v, w=-1.0).trace.jumps
        assert blow.t == 0.0
        assert [*blow.impulse] == ["right" if v > 0 else "left"]


def test_impact_at_a_kink_may_continue_on_the_other_piece() -> None:
    # Friction turns the ball round at the kink: the piece that it strikes is not that it leaves on.
    text = RIDGE.replace("v: 1, w: -s*v", "v: 0.1, w: -4")
    trace = _run(text, s=0.5, mu=1.0).trace
    first, *_ = trace.jumps
    assert [*first.impulse] == ["right"]
    assert trace.outcome.succeeded
    # Down the side where it goes, and not through the ridge.
    x, y = trace.final[:2]
    assert y >= -0.5 * abs(x) - 1e-12


# A table whose height is handed from one contact to the next every half period.
CAM = """
kind: scene
name: cam
gravity: 9.81
parameters: {w: 3, e: 0}
coordinates: {q: {start: 0, rate: w/10}}
bodies: {b: {mass: 1, position: [0, q]}}
surfaces:
  one: {height: 0, displacement: [0, sin(w*time)/10]}
  two: {height: 0, displacement: [0, (sin(w*time) - sin(w*time)**3)/10]}
contacts:
  one:
    point: {body: b}
    surface: one
    modes: [free, slide]
    friction: 0
    restitution: e
    enabled: sin(w*time) >= 0
  two:
    point: {body: b}
    surface: two
    modes: [free, slide]
    friction: 0
    restitution: e
    enabled: sin(w*time) <= 0
stop: {time: 5}
"""


@pytest.mark.parametrize("engine", ENGINES)
def test_contact_passes_to_the_next_edge_without_a_gap(engine: str) -> None:
    trace = _run(CAM, engine).trace
    assert trace.start_mode == ("slide", "off")
    assert [jump.target for jump in trace.jumps] == [
        ("off", "free"),
        ("off", "slide"),
        ("free", "off"),
        ("slide", "off"),
    ] * 2
    times = [jump.t for jump in trace.jumps[::2]]
    assert times == pytest.approx([k * math.pi / 3 for k in range(1, 5)], abs=1e-9)
    height = math.sin(15.0)
    height -= height**3 if height < 0 else 0
    assert trace.final[0] == pytest.approx(height / 10, abs=1e-9)


def _nowhere(height: str, condition: str, x: float = -1) -> str:
    return f"""
kind: scene
name: nowhere
gravity: 9.81
bodies: {{b: {{mass: 1, start: {{x: {x}, y: 0.2, dx: 1, dy: 6}}}}}}
surfaces: {{s: {{height: {height}}}}}
contacts:
  c: {{point: {{body: b}}, surface: s, friction: 0.1, restitution: 0, enabled: {condition}}}
stop: {{time: 2}}
"""


@pytest.mark.parametrize("engine", [*ENGINES, "impulse"])
@pytest.mark.parametrize("height", ["sqrt(x) - sqrt(x)", "log(x) - log(x)", "0/x"])
def test_disabled_contact_may_have_an_undefined_surface(height: str, engine: str) -> None:
    text = _nowhere(height.replace("0/x", "(1/x - 1/x)/x"), "b.x > 0.1")
    plain = _run(_nowhere("0", "b.x > 0.1"), engine).trace
    trace = _run(text, engine).trace
    assert trace.start_mode == ("off",)
    assert trace.outcome.succeeded
    assert [j.cause for j in trace.jumps] == [j.cause for j in plain.jumps]
    assert trace.final == pytest.approx(plain.final, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_forces_of_a_pinned_contact_do_not_need_the_surface_of_one_that_is_off(engine: str) -> None:
    text = """
kind: scene
name: beyond
parameters: {mu: 0.2, v: 0.62}
gravity: 9.81
bodies: {b: {mass: 1, start: {x: 2, dx: -v}}}
surfaces: {dome: {height: sqrt(1 - x**2)}, floor: {height: 0}}
contacts:
  on_dome:
    {point: {body: b}, surface: dome, friction: mu, restitution: 0, enabled: b.x < 0.5}
  on_floor:
    {point: {body: b}, surface: floor, friction: mu, restitution: 0, enabled: b.x > 0.5}
stop: {time: 0.8}
"""
    trace = _run(text, engine).trace
    assert trace.outcome.succeeded
    (stick,) = trace.jumps
    assert stick.target == ("off", "pin")
    assert trace.final == pytest.approx([2 - 0.62**2 / (2 * 0.2 * 9.81), 0, 0, 0], abs=1e-9)


def test_enabled_contact_needs_a_defined_surface() -> None:
    with pytest.raises(DeclarationError, match="its place at the start is not finite"):
        _run(_nowhere("sqrt(x)", "b.x < 0.1"))
    with pytest.raises(NonFinite, match="hold where its surface has no finite value"):
        _run(_nowhere("sqrt(x)", "time > 0.5"))


def test_batched_runs_begin_in_the_same_modes() -> None:
    text = read_text(RIDGE + "outputs: {x: {value: ball.x, at: end}, hits: {count: touchdown}}\n")
    grid = {"v": [-1.0, 1.0], "w": [-1.0, -0.2, 0.2, 0.5]}
    swept = sweep(text, grid)
    run = Runner(text)
    for v, w in product(*grid.values()):
        outputs = run.run({"v": v, "w": w}).outputs
        cell = swept.sel(v=v, w=w)
        assert cell.x.item() == outputs["x"]
        assert cell.hits.item() == outputs["hits"]
