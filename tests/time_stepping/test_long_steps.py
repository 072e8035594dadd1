"""Time steps that are too long for what happens in them say so."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from statechart import Outcome, Runner, run
from statechart.documents.yaml_reader import read_text

POST = """\
kind: scene
name: post
parameters: {v: 50, y0: 1, w: 0.01, x0: 0.013}
gravity: 0
bodies: {b: {mass: 1, start: {x: x0, y: y0, dx: v}}}
surfaces: {post: {height: "1.3*exp(-((x-1)/w)**2)"}}
contacts: {c: {point: {body: b}, surface: post, friction: 0.3, restitution: 0.5}}
stop: {time: 0.05}
outputs: {vx: {value: b.dx}}
"""
DISCS = """\
kind: scene
name: discs
parameters: {v: 50, y0: 0.3, x0: -1.03}
gravity: 0
bodies:
  a: {mass: 1, inertia: 1, shape: {disc: 0.1}, start: {x: 0, y: 0}}
  b: {mass: 1, inertia: 1, shape: {disc: 0.1}, start: {x: x0, y: y0, dx: v}}
collisions: {all: {bodies: [a, b], friction: 0, restitution: 0.5}}
stop: {time: 0.1}
outputs: {vx: {value: b.dx}}
"""
SPRING = """\
kind: scene
name: spring
parameters: {k: 1e6, f: 100, A: 0}
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 1.1, x: 0.1}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, restitution: 0.5}}
forces: {f: {body: b, force: ["-k*b.x + A*sin(2*pi*f*time+1)", "-k*(b.y-1)"]}}
stop: {time: 1}
outputs: {vx: {value: b.dx}}
"""


def runner(text: str, step: float) -> Runner:
    return Runner(read_text(text), engine="impulse", step=step)


@given(x0=st.floats(-0.6, 0.9), w=st.floats(1e-3, 2e-2))
def test_a_particle_does_not_fly_through_a_thin_post(x0: float, w: float) -> None:
    for step in (1e-4, 1e-3):
        found = runner(POST, step).run({"x0": x0, "w": w}, throw=False)
        if found.trace.outcome is Outcome.STEP_TOO_LARGE:
            words = ("passes through", "closes", "would add")
            assert any(word in found.trace.message for word in words)
        else:
            assert abs(found.outputs["vx"] - 50.0) > 1.0  # type: ignore[operator]


def test_the_step_that_is_named_for_a_post_does() -> None:
    found = runner(POST, 5e-3).run(throw=False)
    step = float(found.trace.message.rsplit("take ", 1)[1].split()[0])
    assert runner(POST, step).run().outputs["vx"] < 0.0  # type: ignore[operator]


@given(x0=st.floats(-2.0, -1.0), y0=st.floats(-0.4, 0.4), step=st.sampled_from([1e-3, 0.01, 0.02]))
def test_discs_collide_where_they_meet_and_nowhere_else(x0: float, y0: float, step: float) -> None:
    found = runner(DISCS, step).run({"x0": x0, "y0": y0}, throw=False)
    if abs(y0) > 0.2:
        assert found.outputs["vx"] == 50.0
    elif abs(y0) < 0.15 and found.trace.outcome is not Outcome.STEP_TOO_LARGE:
        assert found.outputs["vx"] < 45.0  # type: ignore[operator]


def test_discs_that_would_pass_through_each_other_end_the_run() -> None:
    # 0.2 in a step of discs that are 0.04 wide: both looks are beside the other disc.
    text = DISCS.replace("disc: 0.1", "disc: 0.02")
    found = runner(text, 4e-3).run({"y0": 0.01, "x0": -1.5}, throw=False)
    assert found.trace.outcome is Outcome.STEP_TOO_LARGE
    assert "passes through" in found.trace.message
    step = float(found.trace.message.rsplit("take ", 1)[1].split()[0])
    assert runner(text, step).run({"y0": 0.01, "x0": -1.5}).outputs["vx"] < 45.0  # type: ignore[operator]


def test_a_spring_that_swings_ever_farther_ends_the_run_and_a_fast_one_warns() -> None:
    fine = runner(SPRING, 1e-4).run()
    assert not fine.warnings
    fast = runner(SPRING, 1e-3).run()
    assert any("1 radians in one step" in warning for warning in fast.warnings)
    wild = runner(SPRING, 0.01).run(throw=False)
    assert wild.trace.outcome is Outcome.STEP_TOO_LARGE
    assert "take 0.0001 or less" in wild.trace.message


def test_a_spring_that_a_joint_holds_needs_no_short_step() -> None:
    text = SPRING + "joints: {j: {point: {body: b}, to: [0.1, 1.1]}}\n"
    assert runner(text, 0.01).run().trace.outcome is Outcome.HORIZON


def test_a_drive_that_steps_sample_at_one_phase_warns() -> None:
    values = {"k": 1.0, "A": 100.0}
    assert not runner(SPRING, 1e-3).run(values).warnings
    coarse = runner(SPRING, 0.01).run(values)
    assert any("forces change within steps" in warning for warning in coarse.warnings)
    exact = run(read_text(SPRING), parameters=values).outputs["vx"]
    assert math.isfinite(float(exact))  # type: ignore[arg-type]
    assert abs(float(coarse.outputs["vx"]) - float(exact)) > 1.0  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["hopper", "woodpecker", "compass_walker", "stick_slip_block"])
def test_the_shipped_models_warn_of_nothing_at_a_step_that_does(name: str) -> None:
    runner_ = Runner(name, engine="impulse", step=1e-3)
    warnings = runner_.run(until=0.5, throw=False).warnings
    assert not any("springs swing" in w or "forces change" in w for w in warnings)


@given(x0=st.floats(-0.6, 0.5), w=st.floats(3e-3, 0.1))
def test_a_flank_that_turns_within_a_step_gives_no_energy(x0: float, w: float) -> None:
    # Its curvature would turn the particle by up to 5e4 m/s in a step.
    found = runner(POST, 1e-3).run({"x0": x0, "w": w}, throw=False)
    states = [*(jump.after for jump in found.trace.jumps), found.trace.final]
    assert max(math.hypot(state[2], state[3]) for state in states) <= 50.0 * (1.0 + 1e-9)


def test_a_flank_that_turns_within_a_step_ends_the_run_with_a_step_that_does() -> None:
    values = {"w": 0.0229, "x0": 0.803}
    step, found = 1e-3, runner(POST, 1e-3).run(values, throw=False)
    assert found.trace.outcome is Outcome.STEP_TOO_LARGE
    for _ in range(2):  # how fast it turns is seen once it is no longer passed
        if found.trace.outcome is Outcome.STEP_TOO_LARGE:
            step = float(found.trace.message.rsplit("take ", 1)[1].split()[0])
            found = runner(POST, step).run(values, throw=False)
    exact = run(read_text(POST), parameters=values).outputs["vx"]
    assert found.outputs["vx"] == pytest.approx(exact, rel=0.1)


SQUARES = """\
kind: scene
name: squares
parameters: {x0: -0.6, y0: 0.0145, v: 9, w: 0.0064, spin: 0}
gravity: 0
bodies:
  a:
    mass: 1
    inertia: 1e-3
    shape: {polygon: [[-w, -w], [w, -w], [w, w], [-w, w]]}
    start: {x: 0, y: 0}
  b:
    mass: 1
    inertia: 1e-3
    shape: {polygon: [[-w, -w], [w, -w], [w, w], [-w, w]]}
    start: {x: x0, y: y0, dx: v, dangle: spin}
collisions: {all: {bodies: [a, b], friction: 0, restitution: 0.5}}
stop: {time: 0.1}
outputs: {vx: {value: b.dx}}
"""


@given(
    x0=st.floats(-0.7, -0.5),
    y0=st.floats(0.0135, 0.03),
    step=st.floats(6e-4, 5e-3),
)
def test_squares_that_miss_each_other_do_not_collide(x0: float, y0: float, step: float) -> None:
    found = runner(SQUARES, step).run({"x0": x0, "y0": y0}, throw=False)
    assert found.outputs["vx"] == 9.0
