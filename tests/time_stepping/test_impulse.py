"""The impulse-based engine on scenes of points against surfaces."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from statechart.automaton.trace import Outcome
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, EventLoop
from statechart.loading.load import interpret
from statechart.running.runner import Runner, run

GOLDEN = Path(__file__).parents[1] / "golden"
STEPPING = json.loads((GOLDEN / "impacts_and_timestepping.json").read_text())
STEPS = (1e-2, 1e-3, 1e-4, 1e-5)


def slope(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


def scene(text):
    return interpret(read_text(text))


@pytest.mark.parametrize("case", STEPPING["time_stepping_error_reference"])
def test_stick_error_is_at_most_five_times_the_reference_scheme(case):
    inertia = 1 / 3 if case["I_G"] == "1/3" else float(case["I_G"])
    # The finest step takes as long as all others together: one of the cases has it.
    runs = case["runs"] if case["mu"] == 0.5 else case["runs"][:-1]
    assert len(runs) >= 3
    for row in runs:
        outputs = run(
            "toppling_stick",
            parameters={"mu": case["mu"], "I_G": inertia},
            engine="impulse",
            step=row["h"],
        ).outputs
        for name, error in (
            ("slip_backward", "err_back"),
            ("slip_forward", "err_fwd"),
            ("omega_impact", "err_omega"),
            ("t_impact", "err_t"),
        ):
            allowed = 5 * abs(row[error])
            assert abs(outputs[name] - case["truth"][name]) <= allowed, (row["h"], name)


def test_bounces_converge_at_first_order():
    g, k = 9.81, 0.5
    rest = np.sqrt(2 / g) * (1 + k) / (1 - k)
    errors = []
    for h in STEPS:
        result = run("bouncing_ball", parameters={"k": k}, engine="impulse", step=h, until=3)
        assert result.trace.outcome is Outcome.HORIZON
        errors.append(abs(result.outputs["t_rest"] - rest))
    assert max(e / h for e, h in zip(errors, STEPS, strict=True)) < 20
    assert 0.75 < slope(STEPS, errors) < 1.25


@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_steps_on_an_incline_converge(mu):
    exact = run("block_on_incline", parameters={"mu": mu})
    for h in STEPS[:3]:
        found = run("block_on_incline", parameters={"mu": mu}, engine="impulse", step=h)
        assert found.trace.modes == exact.trace.modes
        for name, value in exact.outputs.items():
            assert abs(found.outputs[name] - value) <= h
        assert np.abs(found.trace.final - exact.trace.final).max() <= 5 * h


@pytest.mark.parametrize("alpha", [0.0, 0.3, 0.4636])
def test_a_block_below_the_friction_angle_does_not_creep(alpha):
    trace = run(
        "block_on_incline",
        parameters={"alpha": alpha, "mu": 0.5, "v0": 0.0},
        engine="impulse",
        step=1e-3,
        until=10,
    ).trace
    assert trace.modes == (("pin",),)
    assert np.abs(trace.final).max() <= 1e-14


def test_a_perfectly_elastic_ball_keeps_its_energy():
    result = run("bouncing_ball", parameters={"k": 1}, engine="impulse", step=1e-3, until=20)
    energy = result.observer.sample(result.trace, ["energy"]).columns["energy"]
    assert np.ptp(energy) <= 1e-11 * energy.max()


def test_infinite_friction_sticks_with_a_warning(capsys):
    assert main(["run", "toppling_stick", "--set", "mu=inf", "--set", "I_G=0.1",
                 "--engine", "impulse", "--step", "1e-3", "--json"]) == 0  # fmt: skip
    printed = capsys.readouterr()
    report = json.loads(printed.out)
    exact = run("toppling_stick", parameters={"mu": float("inf"), "I_G": 0.1}).outputs
    assert abs(report["outputs"]["omega_impact"] - exact["omega_impact"]) < 2e-3
    assert "4096" in printed.err
    assert report["step"] == 1e-3
    assert report["modes_built"] == 0


def test_friction_within_round_off_warns():
    found = {
        mu: run("toppling_stick", parameters={"mu": mu}, engine="impulse", step=1e-3, until=1)
        for mu in (0.0, 1e-12, 1e-6)
    }
    warned = [any("write 0" in text for text in one.warnings) for one in found.values()]
    assert warned == [False, True, False]


def test_a_point_mass_has_a_small_inertia_with_a_warning():
    exact = run("toppling_stick", parameters={"I_G": 0})
    found = run("toppling_stick", parameters={"I_G": 0}, engine="impulse", step=1e-3)
    assert np.abs(found.trace.final - exact.trace.final).max() <= 1e-3
    assert any("without an inertia" in warning for warning in found.warnings)


def test_a_chart_has_no_time_steps():
    with pytest.raises(DeclarationError, match="a scene is needed"):
        Runner("bouncing_ball_chart", engine="impulse", step=1e-3)


def test_step_is_required_by_the_impulse_engine_only():
    with pytest.raises(DeclarationError, match="needs a step"):
        Runner("bouncing_ball", engine="impulse")
    with pytest.raises(DeclarationError, match="chooses its own steps"):
        Runner("bouncing_ball", engine="scipy", step=1e-3)
    with pytest.raises(DeclarationError, match="positive"):
        Runner("bouncing_ball", engine="impulse", step=-1)
    with pytest.raises(DeclarationError, match="no tolerance"):
        Runner("bouncing_ball", engine="impulse", step=1e-3, tolerance=1e-6)


def test_a_step_too_large_keeps_the_trace_and_advises(tmp_path, capsys):
    code = main(["run", "bouncing_ball", "--engine", "impulse", "--step", "1",
                 "--output", str(tmp_path / "run")])  # fmt: skip
    assert code == 1
    assert "STEP_TOO_LARGE" in capsys.readouterr().out
    assert (tmp_path / "run" / "trace.nc").exists()


@pytest.mark.parametrize("model", ["toppling_stick", "box_stack", "two_balls"])
@pytest.mark.parametrize("step", [1e308, 1e100, 5.0])
def test_a_step_beyond_all_bounds_is_refused(model, step):
    # At 5 the stick's second step is wild, and those after it overflow before it is looked at.
    trace = run(model, engine="impulse", step=step, throw=False).trace
    assert trace.outcome is Outcome.STEP_TOO_LARGE
    assert "or less" in trace.message


def test_stepped_runs_have_tables_figures_and_diagrams(tmp_path):
    folder = tmp_path / "run"
    assert main(["run", "toppling_stick", "--engine", "impulse", "--step", "1e-2",
                 "--output", str(folder)]) == 0  # fmt: skip
    assert {path.name for path in folder.iterdir()} >= {"events.csv", "samples.csv", "figure.svg"}


def test_forces_on_a_resting_block_are_its_weight():
    result = run(
        "block_on_incline",
        parameters={"alpha": 0.3, "mu": 0.5, "v0": 0.0},
        engine="impulse",
        step=1e-2,
        until=1,
    )
    samples = result.observer.sample(result.trace, ["base.V", "base.H"]).columns
    assert samples["base.V"] == pytest.approx(9.81 * np.cos(0.3), rel=1e-12)
    assert samples["base.H"] == pytest.approx(9.81 * np.sin(0.3), rel=1e-12)


HINGE = """
kind: scene
name: pendulum
parameters: {L: 1}
gravity: 1
bodies:
  rod: {mass: 1, inertia: 1/3, start: {x: L, angle: pi/2}}
surfaces:
  wall: {height: 0}
contacts:
  hinge: {point: {body: rod, at: [0, L]}, surface: wall, modes: [pin]}
stop: {time: 2}
settings: {engine: impulse, step: 1e-3}
"""


def test_a_hinge_holds_its_point_and_the_energy():
    result = run(scene(HINGE))
    columns = result.observer.sample(result.trace, ["energy", "hinge.gap"]).columns
    assert np.abs(columns["hinge.gap"]).max() < 1e-5
    assert np.ptp(columns["energy"]) < 1e-5
    exact = run(scene(HINGE), engine="scipy")
    assert np.abs(result.trace.final - exact.trace.final).max() < 1e-5


DOUBLE = """
kind: scene
name: double_pendulum
gravity: 9.81
bodies:
  upper: {mass: 2, inertia: 0.3, start: {x: 1, y: 0, angle: 0}}
  lower: {mass: 1, inertia: 0.2, start: {x: 3, y: 0, angle: 0}}
joints:
  pivot: {point: {body: upper, at: [-1, 0]}, to: [0, 0]}
  elbow: {point: {body: lower, at: [-1, 0]}, to: {body: upper, at: [1, 0]}}
stop: {time: 1}
"""


def test_joints_converge_to_the_event_based_motion():
    exact = run(scene(DOUBLE), engine="scipy")
    force = exact.observer.final(exact.trace, ["pivot.Y"])
    for h in (1e-2, 1e-3):
        found = run(scene(DOUBLE), engine="impulse", step=h)
        assert np.abs(found.trace.final - exact.trace.final).max() <= 10 * h
        assert found.observer.final(found.trace, ["pivot.Y"]) == pytest.approx(force, abs=10 * h)


SLIDING = """
kind: scene
name: block
gravity: 9.81
bodies:
  block: {mass: 1, start: {dx: 3}}
surfaces:
  floor: {height: 0}
contacts:
  base: {point: {body: block}, surface: floor, modes: [slide, pin], friction: 0.5}
stop: {time: 2}
"""


def test_a_contact_that_is_never_free_slides_to_rest():
    exact, found = run(scene(SLIDING)), run(scene(SLIDING), engine="impulse", step=1e-3)
    assert found.trace.modes == exact.trace.modes == (("slide+",), ("pin",))
    assert np.abs(found.trace.final - exact.trace.final).max() <= 1e-5


def test_a_mode_that_is_not_declared_ends_the_run():
    text = SLIDING.replace("gravity: 9.81", "gravity: 9.81*(1 - time)").replace("gravity", "# ")
    text += "forces:\n  lift: {body: block, force: [0, 9.81*(time - 1)]}\n"
    result = run(scene(text), engine="impulse", step=1e-2, throw=False)
    assert result.trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "free is not among its modes" in result.trace.message
    assert result.trace.t_end == pytest.approx(1.0, abs=0.02)


def test_final_forces_do_not_come_from_a_tiny_step():
    # The step does not divide the run: the remainder is a ten-thousandth of it.
    exact = run("dragged_stick").outputs["H"]
    found = run("dragged_stick", engine="impulse", step=1 / 1000.0001)
    assert found.trace.counts["steps"] == 1001
    assert found.trace.t_end == 1.0
    assert found.outputs["H"] == pytest.approx(exact, rel=1e-8)


def test_warning_names_contacts_with_indeterminate_forces() -> None:
    shared = Runner("four_legged_table", engine="impulse", step=1e-3).run(until=0.01)
    reported = "the forces of A, B, C, D are indeterminate: the smallest are shown"
    assert shared.trace.warnings.count(reported) == 1
    # All forces are determined while one foot holds, or none touches.
    for name in ("bouncing_ball", "block_on_incline"):
        alone = Runner(name, engine="impulse", step=1e-3).run(until=0.01)
        assert not [w for w in alone.trace.warnings if "indeterminate" in w]


def test_controllers_that_follow_each_other_for_ever_are_named() -> None:
    scene = read_text(
        "kind: scene\nname: loop\ngravity: 1\nbodies: {ball: {mass: 1, start: {y: 1}}}\n"
        "surfaces: {ground: {height: 0}}\nstop: {time: 2}\n"
        "contacts: {c: {point: {body: ball}, surface: ground, friction: 1, restitution: 0}}\n"
        "controls: {push: 0}\nforces: {up: {body: ball, force: [0, push]}}\n"
        "regions:\n  hand:\n    initial: open\n    states: {open: {}, shut: {sets: {push: 2}}}\n"
        "    transitions:\n"
        "      - {name: close, from: open, to: shut, guard: ball.y <= 0.5}\n"
        "      - {name: loose, from: shut, to: open, guard: ball.y <= 0.6}\n"
    )
    for setting in ({"engine": "impulse", "step": 1e-3}, {}):
        with pytest.raises(EventLoop, match=r"close -> .*shut, loose -> .*open"):
            run(scene, **setting)


LANDING = """
kind: scene
name: landing
gravity: 9.81
parameters: {mu: 0.6, part: 0.65, limit: 1.05, q: -0.65}
bodies:
  b: {mass: 1, inertia: 0.02, start: {x: 0.25, y: 0.25*sin(q), angle: q}}
  c: {mass: 0.734, inertia: 0.01, start: {x: 0.5 + 0.25*cos(q), y: 0.5*sin(q)}}
surfaces: {floor: {height: -0.834}}
contacts:
  tip:
    point: {body: c, at: [0.25, 0]}
    surface: floor
    friction: {static: mu, kinetic: part*mu}
    restitution: 0
joints:
  hook: {point: {body: b, at: [-0.25, 0]}, to: ["0.25*(1 - cos(q))", 0]}
  elbow: {point: {body: c, at: [-0.25, 0]}, to: {body: b, at: [0.25, 0]}}
couplings:
  rub: {bodies: [b], limit: limit}
stop: {time: 0.4}
"""


@pytest.mark.parametrize("step", [2e-3, 1e-3, 5e-4])
@pytest.mark.parametrize(
    "values",
    [
        {"mu": 0.6, "part": 0.65, "limit": 1.05, "q": -0.65},
        {"mu": 0.51, "part": 0.49, "limit": 1.16, "q": -0.74},
        {"mu": 0.7, "part": 0.44, "limit": 1.0, "q": -0.83},
    ],
)
def test_static_friction_holds_a_mechanism_that_has_landed(values, step):
    """The impulses that correct a landing made the tip slip, and kinetic friction let it go on."""
    model = interpret(read_text(LANDING))
    expected = run(model, parameters=values)
    found = run(model, parameters=values, engine="impulse", step=step)
    assert [jump.cause for jump in expected.trace.jumps] == ["touchdown"]
    assert {jump.cause for jump in found.trace.jumps} == {"touchdown", "lock"}
    assert np.abs(found.trace.final[6:]).max() < 0.01


DAMPED = """
kind: scene
name: damped
gravity: 0
bodies:
  trunk: {mass: 1, start: {y: 2, dy: -1}}
  foot: {mass: 0.1, start: {y: HEIGHT, dy: -1}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: foot}, surface: floor, friction: 0, restitution: 0}}
forces:
  above: {body: trunk, force: [0, 10*(foot.dy - trunk.dy)]}
  below: {body: foot, force: [0, 10*(trunk.dy - foot.dy)]}
stop: {time: 0.2}
"""


@pytest.mark.parametrize("height", [0.1001, 0.1004, 0.1006, 0.1009])
def test_damping_acts_from_the_touch_on(height):
    """The trunk falls at exp(-10 t) after the touch; late by half a step, 5e-3 faster."""
    model = interpret(read_text(DAMPED.replace("HEIGHT", str(height))))
    final = run(model, engine="impulse", step=1e-3).trace.final
    np.testing.assert_allclose(final[5], -np.exp(-10 * (0.2 - height)), rtol=1e-4)
    assert abs(final[4]) < 1e-12
