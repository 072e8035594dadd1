"""Forces with a sign of the time that turn at the instant of an impact."""

import pytest
from runs import ENGINES

from statechart import run
from statechart.documents.yaml_reader import read_text

# The ball falls at 10 + 20 until both the impact and the turn of the wind at t = 1.
FALLING = """\
kind: scene
name: turn
gravity: 10
parameters: {T: 1}
surfaces: {floor: {height: 0}}
bodies: {b: {mass: 1, start: {y: START}}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0}}
forces: {wind: {body: b, force: FORCE}}
stop: {time: 1.5}
"""


@pytest.mark.parametrize("engine", ENGINES)
def test_wind_that_turns_at_an_impact_lifts_the_ball_at_once(engine: str) -> None:
    text = FALLING.replace("START", "15").replace("FORCE", "[0, 20*sign(time - T)]")
    result = run(read_text(text), engine=engine)
    assert [jump.t for jump in result.trace.jumps] == [pytest.approx(1.0, rel=1e-12)]
    assert result.trace.final[[1, 3]] == pytest.approx([0.5 * 10 * 0.5**2, 10 * 0.5], rel=1e-10)
    assert not result.warnings


@pytest.mark.parametrize("engine", ENGINES)
def test_friction_after_an_impact_bears_the_wind_that_has_turned(engine: str) -> None:
    # The impact stops the slip of -2. The normal force is 10, the wind 2, against 5 by friction.
    text = FALLING.replace("START", "5").replace("FORCE", "[2*sign(time - T), 0]")
    result = run(read_text(text), engine=engine)
    assert [(jump.cause, jump.target) for jump in result.trace.jumps] == [("touchdown", ("pin",))]
    assert result.trace.final == pytest.approx([-1, 0, 0, 0], abs=1e-10)
    margins = result.to_dict()["margins"]
    assert margins["c.mu V - H"] == pytest.approx(7)
    assert margins["c.mu V + H"] == pytest.approx(3)


@pytest.mark.parametrize("engine", ENGINES)
def test_wind_that_turns_where_a_slide_ends_is_held(engine: str) -> None:
    # Decelerated by 4 + 6, then pushed by 3, which friction of at most 4 bears.
    text = """\
kind: scene
name: turn
gravity: 10
surfaces: {floor: {height: 0}}
bodies: {b: {mass: 1, start: {dx: 4}}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.4, restitution: 0}}
forces: {wind: {body: b, force: ["4.5*sign(time - 0.4) - 1.5", 0]}}
stop: {time: 1}
"""
    result = run(read_text(text), engine=engine)
    assert [(jump.cause, jump.target) for jump in result.trace.jumps] == [("stick", ("pin",))]
    assert result.trace.jumps[0].t == pytest.approx(0.4, rel=1e-12)
    assert result.trace.final == pytest.approx([0.8, 0, 0, 0], abs=1e-10)


def test_a_lift_that_jumps_where_a_slide_starts_is_seen_or_reported() -> None:
    text = FALLING.replace("START", "0, x: 1, dx: 1").replace("friction: 0.5", "friction: 0")
    text = text.replace("FORCE", '[0, "20*sign(b.x - T)"]').replace("time: 1.5", "time: 0.5")
    assert run(read_text(text)).trace.final == pytest.approx([1.5, 1.25, 1, 5], rel=1e-12)
    result = run(read_text(text), engine="scipy", throw=False)
    advice = "a sign jumps there: take the engine taylor, or write a state for each side"
    assert result.trace.message.endswith(advice)


# The second force reaches friction at one side only, while the body rests.
@pytest.mark.parametrize("force", ["9*sign(b.x)", "3*sin(time) + 4*sign(b.x)"])
def test_a_position_at_which_a_force_jumps_beyond_friction_is_reported(force: str) -> None:
    text = FALLING.replace("START", "0").replace("FORCE", f'["{force}", 0]')
    result = run(read_text(text), engine="taylor", throw=False)
    assert result.trace.message.endswith("a sign jumps there: write a state for each side")


@pytest.mark.parametrize("engine", ENGINES)
def test_a_preload_holds_a_body_in_its_place_beside_friction(engine: str) -> None:
    # A centring spring with a preload of 4 N, and friction of at most 5 N: 10 t - 9 moves it.
    text = FALLING.replace("START", "0").replace("FORCE", '["10*time - 4*sign(b.x)", 0]')
    result = run(read_text(text), engine=engine)
    assert [(jump.cause, jump.target) for jump in result.trace.jumps] == [("slip", ("slide+",))]
    assert result.trace.jumps[0].t == pytest.approx(0.9, rel=1e-11)
    assert result.trace.final[[0, 2]] == pytest.approx([10 * 0.6**3 / 6, 10 * 0.6**2 / 2], rel=1e-9)
