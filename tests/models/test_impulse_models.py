"""Every shipped scene on the impulse-based engine, against its run with events."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import models
from statechart.cli.main import main
from statechart.running.runner import Runner

# Model, parameters, end; step, and the largest allowed error relative to the step. Impacts obey
# Newton's law: scenes with another law run without restitution. Hills amplify the error of an
# impact time, the walker amplifies errors of its steps.
SCENES = [
    ("ball_in_a_bowl", {}, 2.0, 1e-3, 5.0),
    ("block_on_incline", {}, None, 1e-3, 0.01),
    ("bouncing_ball", {"k": 0.5}, 1.2, 1e-4, 40.0),
    ("bouncing_ball_hills", {}, 0.5, 1e-5, 600.0),
    ("compass_walker", {}, 2.0, 1e-4, 40.0),
    ("double_contact_bar", {}, None, 1e-3, 2.0),
    ("dragged_stick", {}, None, 1e-3, 1e-6),
    ("four_legged_table", {}, 1.0, 1e-3, 1e-9),
    ("hopper", {}, 1.9, 1e-4, 150.0),
    ("no_slip_pencil", {}, None, 1e-3, 1.0),
    ("painleve_rod", {"e": 0.0}, None, 1e-3, 2.0),
    ("raibert_hopper", {}, 1.0, 1e-4, 100.0),
    ("rimless_wheel", {}, 3.0, 1e-4, 20.0),
    ("rocking_block", {}, 3.0, 1e-4, 30.0),
    ("rope_swing", {}, None, 1e-3, 20.0),
    ("sampled_balance", {}, None, 1e-3, 1e-3),
    ("sliding_ladder", {}, None, 1e-3, 0.01),
    ("soft_landing", {}, None, 1e-3, 10.0),
    ("stick_slip_block", {}, None, 1e-3, 1.0),
    ("toppling_stick", {}, None, 1e-3, 1.0),
    ("toppling_stick", {"mu": 0.0}, None, 1e-3, 1.0),
    ("two_balls", {}, None, 1e-4, 60.0),
]
CHARTS = ("bouncing_ball_chart", "simplest_walker")
# Asks that contacts strike one after another, which no time step does.
SEQUENTIAL = "newtons_cradle"
# Has couplings, which steps refuse.
COUPLED = "braking_car"
# Modes differ if a few steps slide before they stick, or a sliding contact lifts off within a step.
SLIDES_ON = ("double_contact_bar", "raibert_hopper")


@pytest.mark.parametrize(("name", "parameters", "until", "step", "constant"), SCENES)
def test_impulse_engine_agrees_with_events(name, parameters, until, step, constant):
    exact = Runner(name).run(parameters, until=until, throw=False).trace
    found = Runner(name, engine="impulse", step=step).run(parameters, until=until, throw=False)
    trace = found.trace
    assert trace.outcome is exact.outcome
    assert np.abs(trace.final - exact.final).max() <= constant * step
    if name not in SLIDES_ON:
        assert trace.modes == exact.modes
    declared = [set(region.states) for region in found.observer.automaton.regions]
    assert all(s in d for key in trace.modes for s, d in zip(key, declared, strict=True))


def test_every_shipped_model_is_tested():
    folder = Path(models.__file__).parent
    shipped = {path.stem for path in folder.glob("*.yaml")}
    stepped = {name for name in shipped if Runner(name).setting.step is not None}
    assert shipped == {name for name, *_ in SCENES} | {*CHARTS, SEQUENTIAL, COUPLED} | stepped


def test_simultaneously_resolved_impacts_give_a_warning():
    found = Runner(SEQUENTIAL, engine="impulse", step=1e-3).run(until=0.6)
    assert any("simultaneous impacts follow" in warning for warning in found.warnings)
    # Newton's law at all contacts at once: the four that touch are hit as one.
    before = Runner(SEQUENTIAL).run(until=0.6).outputs["rate_last"][0]
    rates = found.outputs["rate_first"][0], found.outputs["rate_last"][0]
    assert rates == pytest.approx((-0.6 * before, 0.4 * before), rel=1e-3)


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_is_refused_with_advice(name, capsys):
    assert main(["run", name, "--engine", "impulse", "--step", "1e-3"]) == 2
    assert "taylor or scipy" in capsys.readouterr().err


def test_indeterminate_forces_are_shared_with_a_warning():
    exact = Runner("four_legged_table").run(until=0.1)
    found = Runner("four_legged_table", engine="impulse", step=1e-2).run(until=0.1)
    for name in ("V_A", "V_B", "V_C", "V_D"):
        assert found.outputs[name] == pytest.approx(exact.outputs[name], rel=1e-12)
    assert found.trace.indeterminate == exact.trace.indeterminate


def test_forces_of_joints_and_contacts_are_distinguished():
    exact = Runner("dragged_stick").run().outputs
    found = Runner("dragged_stick", engine="impulse", step=1e-3).run().outputs
    assert found == pytest.approx(exact, rel=1e-8)


def test_lasting_contact_shares_an_impact_as_with_events():
    exact = Runner("double_contact_bar").run()
    found = Runner("double_contact_bar", engine="impulse", step=1e-4).run()
    assert found.outputs["omega_before_B"] == pytest.approx(
        exact.outputs["omega_before_B"], rel=1e-3
    )
    (strike,) = [jump for jump in found.trace.jumps if jump.region == "B" and jump.impulse]
    (other,) = [jump for jump in exact.trace.jumps if jump.region == "B" and jump.impulse]
    # The motion does not determine how two contacts of a bar share an axial force.
    ours, theirs = (np.array([jump.impulse[c] for c in ("A", "B")]) for jump in (strike, other))
    assert ours[:, 0] == pytest.approx(theirs[:, 0], rel=1e-3)
    assert ours[:, 1].sum() == pytest.approx(theirs[:, 1].sum(), rel=1e-3)


def test_a_paradox_is_an_impact_at_once():
    trace = Runner("painleve_rod", engine="impulse", step=1e-4).run({"e": 0.0}).trace
    assert trace.start_mode == ("slide+",)
    jam = trace.jumps[0]
    assert (jam.cause, jam.target) == ("jam", ("free",))
    # The tip rests after the impact, but no mode would hold it there: it would have to be pulled.
    lean, rate = -jam.after[2], -jam.after[5]
    turning = 0.75 * math.sin(lean)
    assert 1.0 - turning * math.sin(lean) - rate**2 * math.cos(lean) < -0.1


def test_controllers_act_at_the_ends_of_steps():
    step = 1e-4
    result = Runner("hopper", engine="impulse", step=step).run(until=1.9)
    exact = Runner("hopper").run(until=1.9)
    assert result.outputs["landings"] == pytest.approx(exact.outputs["landings"], abs=10 * step)
    for jump in result.trace.jumps:
        if jump.region == "leg":
            assert abs(jump.t / step - round(jump.t / step)) < 1e-6
    # The values that a state sets act from its entry on.
    push = result.observer.sample(result.trace, ["push", "l"], times=[0.1, 0.3]).columns
    assert push["push"] == pytest.approx([1.0, 200.0 * (1.0 - push["l"][1])], rel=1e-2)
