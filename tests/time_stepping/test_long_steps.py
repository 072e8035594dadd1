"""Time steps that are too long give warnings."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contacts.time_stepping.scene_tape import SteppedTape
from statechart import Outcome, Runner, run
from statechart.documents.yaml_reader import read_text
from statechart.running.result import Result

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


@functools.lru_cache(maxsize=8)
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


def test_advised_step_resolves_a_thin_post() -> None:
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


def test_fast_discs_split_their_step() -> None:
    # 0.2 in a step of discs that are 0.04 wide: both looks are beside the other disc.
    text, start = DISCS.replace("disc: 0.1", "disc: 0.02"), {"y0": 0.01, "x0": -1.5}
    found = runner(text, 4e-3).run(start)
    assert any("would pass through" in warning for warning in found.warnings)
    # They touch at a sine of a quarter, and half of the approach is lost.
    exact = 50.0 - 0.75 * 50.0 * (1.0 - 0.25**2)
    errors = [runner(text, h).run(start).outputs["vx"] - exact for h in (4e-3, 1e-4)]  # type: ignore[operator]
    assert abs(errors[0]) < 4.0
    assert abs(errors[1]) < 0.4


def test_discs_that_passed_before_a_split_step_collide() -> None:
    # Between the looks of a step and the next, but before the end of the first.
    start = {"x0": -1.75, "y0": 0.125}
    found = runner(DISCS, 0.02).run(start)
    assert any("would pass through" in warning for warning in found.warnings)
    # They touch at a sine of 5/8, and half of the approach is lost.
    exact = 50.0 - 0.75 * 50.0 * (1.0 - 0.625**2)
    assert abs(found.outputs["vx"] - exact) < 5.0  # type: ignore[operator]
    assert abs(runner(DISCS, 1e-4).run(start).outputs["vx"] - exact) < 0.2  # type: ignore[operator]


def test_a_step_of_fifty_diameters_is_taken_in_256_parts() -> None:
    # In a sixty-fourth of it the disc moves by 0.8 of its width, between two detections.
    text = DISCS.replace("disc: 0.1", "disc: 0.01").replace("50", "1000")
    found = runner(text, 1e-3).run({"x0": -3.1, "y0": 0.0})
    assert any("up to 256 parts" in warning for warning in found.warnings)
    assert found.outputs["vx"] == pytest.approx(250.0)


def test_discs_at_the_same_midpoint_collide() -> None:
    found = runner(DISCS, 0.02).run({"x0": -1.5, "y0": 0.0})
    assert found.outputs["vx"] == pytest.approx(12.5)


def test_unstable_spring_ends_the_run_and_a_fast_one_warns() -> None:
    fine = runner(SPRING, 1e-4).run()
    assert not fine.warnings
    fast = runner(SPRING, 1e-3).run()
    assert any("1 rad in one step" in warning for warning in fast.warnings)
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
    assert any("too long for the forces" in warning for warning in coarse.warnings)
    exact = run(read_text(SPRING), parameters=values).outputs["vx"]
    assert math.isfinite(float(exact))  # type: ignore[arg-type]
    assert abs(float(coarse.outputs["vx"]) - float(exact)) > 1.0  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["hopper", "woodpecker", "compass_walker", "stick_slip_block"])
def test_the_shipped_models_have_no_warnings_at_a_suitable_step(name: str) -> None:
    runner_ = Runner(name, engine="impulse", step=1e-3)
    warnings = runner_.run(until=0.5, throw=False).warnings
    assert not any("springs swing" in w or "forces change" in w for w in warnings)


@given(x0=st.floats(-0.6, 0.5), w=st.floats(3e-3, 0.1))
def test_a_flank_that_turns_within_a_step_gives_no_energy(x0: float, w: float) -> None:
    # Its curvature would turn the particle by up to 5e4 m/s in a step.
    found = runner(POST, 1e-3).run({"x0": x0, "w": w}, throw=False)
    states = [*(jump.after for jump in found.trace.jumps), found.trace.final]
    assert max(math.hypot(state[2], state[3]) for state in states) <= 50.0 * (1.0 + 1e-9)


def test_turning_flank_ends_the_run_with_an_advised_step() -> None:
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


DRIVE = """\
kind: scene
name: drive
parameters: {A: 10, f: 25, phase: 2.5, mu: 0.1}
gravity: 9.81
bodies: {b: {mass: 1}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, modes: [slide, pin], friction: mu}}
forces: {f: {body: b, force: ["A*sin(2*pi*f*time+phase)", 0]}}
stop: {time: 1}
outputs: {x: {value: b.x}, vx: {value: b.dx}}
"""
BAR = """\
kind: scene
name: bar
parameters: {L: 0.0725, y0: 0.4904, dy: -1.111, spin: -200.8, e: 0.7, mu: 0.0678, angle: 0.8754}
gravity: 9.81
bodies: {b: {mass: 1, inertia: L**2/3, start: {y: y0, dy: dy, angle: angle, dangle: spin}}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: b, at: [-L, 0]}, surface: floor, friction: mu, restitution: e, impact: moreau}
  B: {point: {body: b, at: [L, 0]}, surface: floor, friction: mu, restitution: e, impact: moreau}
stop: {time: 0.25}
outputs: {dy: {value: b.dy}}
"""


def words(found: Result, what: str) -> list[str]:
    return [warning for warning in found.warnings if what in warning]


def named(warning: str) -> float:
    return float(warning.removesuffix(" or less").rsplit(" ", 1)[1])


@pytest.mark.parametrize("turn", [2.0, 3.5, 6.0, 20.0])
def test_a_drive_is_compared_with_the_speeds_that_it_makes(turn: float) -> None:
    # The block moves at a hundredth of its free-fall speed.
    step = turn / (2.0 * math.pi * 25.0)
    assert words(runner(DRIVE, step).run(), "too long for the forces")
    (warning,) = words(runner(DRIVE, step).run({"mu": 0.0}), "too long for the forces")
    # One sample does not show a turn; the second one shows their number.
    again = words(runner(DRIVE, named(warning)).run({"mu": 0.0}), "too long for the forces")
    assert (turn > 6.0) == bool(again)
    assert not again or not runner(DRIVE, named(again[0])).run({"mu": 0.0}).warnings


def test_the_quadrature_error_of_a_drive_is_its_integral_less_the_midpoint_rule() -> None:
    # Without friction the speed is A (cos(phase) - cos(w t + phase)) / w.
    w, step = 50.0 * math.pi, 0.02
    found = runner(DRIVE, step).run({"mu": 0.0})
    times = (np.arange(50) + 0.5) * step
    rule = np.cumsum(10.0 * step * np.sin(w * times + 2.5))
    exact = 10.0 * (math.cos(2.5) - np.cos(w * step * np.arange(1, 51) + 2.5)) / w
    (warning,) = words(found, "too long for the forces")
    expected = np.abs(exact - rule).max() / np.abs(rule).max()
    assert f"up to {expected:.2g} of" in warning


def test_constant_forces_need_no_equations_for_their_quadrature(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    evaluate, calls = SteppedTape.equations, [0]

    def counted(*of: Any) -> Any:
        calls[-1] += 1
        return evaluate(*of)

    monkeypatch.setattr(SteppedTape, "equations", counted)
    for force in ("3", "3 + 0*time", "3 + 1e-6*time"):
        text = SPRING.replace('"-k*b.x + A*sin(2*pi*f*time+1)", "-k*(b.y-1)"', f'"{force}", 0')
        runner(text, 1e-3).run()
        calls.append(0)
    assert calls[0] == calls[1] < calls[2]


def test_well_sampled_drive_gives_no_warning() -> None:
    assert not runner(DRIVE, 1e-3).run().warnings
    assert not runner(DRIVE, 3e-3).run({"mu": 0.0}).warnings


def test_bar_turning_on_before_its_impact_gives_a_warning() -> None:
    # A tip at 14.5 m/s turns by 0.036 radians in a step: by up to 0.5 of 3 m/s of its approach.
    step, exact = 0.25 / 1404, float(run(read_text(BAR)).outputs["dy"])  # type: ignore[arg-type]
    said = 0
    for parts in np.linspace(0.9, 1.1, 9):
        found = runner(BAR, step * parts).run()
        off = abs(float(found.outputs["dy"]) - exact)  # type: ignore[arg-type]
        warnings = words(found, "contacts that are switched on")
        # The largest speed is 3.07 m/s, in its fall.
        assert bool(warnings) == (off > 0.15 * 3.07) or 0.12 < off / 3.07 < 0.18
        said += len(warnings)
    assert said > 0
    assert not runner(BAR, step / 5.0).run().warnings


def test_phase_error_of_a_long_swing_is_reported() -> None:
    values = {"k": 150.0**2}
    (warning,) = words(runner(SPRING, 3e-3).run(values), "too long for the springs")
    assert not runner(SPRING, named(warning)).run(values).warnings
    # The same stiffness, at rest in equilibrium.
    still = SPRING.replace("y: 1.1, x: 0.1", "y: 1-9.81/k")
    assert not runner(still, 3e-3).run(values).warnings


def test_a_slip_that_ends_in_its_first_step_warns() -> None:
    text = DRIVE.replace("bodies: {b: {mass: 1}}", "bodies: {b: {mass: 1, start: {dx: 0.5}}}")
    values = {"A": 0.0, "mu": 0.9}
    (warning,) = words(runner(text, 0.1).run(values), "ends of slips")
    fine = runner(text, named(warning)).run(values)
    assert not fine.warnings
    assert fine.outputs["x"] == pytest.approx(0.5**2 / (2 * 0.9 * 9.81), rel=0.1)


def test_drift_by_slip_reversals_gives_a_warning() -> None:
    values = {"A": 18.9, "f": 41.4, "phase": 4.73}
    coarse = runner(DRIVE, 1.0 / 1160).run(values)
    assert words(coarse, "too long for the forces")
    assert not runner(DRIVE, 1e-4).run(values).warnings


def test_grazing_discs_meet_and_separate_ones_do_not() -> None:
    text = DISCS.replace("disc: 0.1", "disc: 0.02")
    for x0 in np.linspace(-1.5, -1.3, 21):
        speeds = [
            runner(text, 3.9e-3).run({"y0": part * 0.04, "x0": x0}).outputs["vx"]
            for part in (0.97, 1.01)
        ]
        assert speeds[0] < 50.0  # type: ignore[operator]
        assert speeds[1] == 50.0


def test_a_body_that_is_hit_and_turns_far_in_a_step_warns() -> None:
    values = {"x0": -0.6, "y0": 0.01, "v": 9.0}
    text = SQUARES.replace("inertia: 1e-3", "inertia: 1e-4")
    # Corners of 6 mm at some meters per second: 270 radians per second.
    (warning,) = words(runner(text, 2e-3).run(values), "turn by up to")
    assert not words(runner(text, named(warning)).run(values), "turn by up to")
