"""Relations that their own consequences change back: by steps a warning, with events an error."""

from __future__ import annotations

import pytest

import statechart
from contacts import Body, Coupling, Force, Joint, Point, Scene
from statechart import Outcome, Stop
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

ADVICE = "give it two bounds"


def wheel(limit: float, enabled: str) -> Scene:
    """A wheel under a couple of 1, with a brake."""
    return Scene(
        name="brake",
        bodies={"w": Body(mass=1, inertia=1)},
        joints={"axle": Joint(point=Point(body="w"), to=(0, 0))},
        forces={"drive": Force(body="w", moment=1)},
        couplings={"b": Coupling(bodies=["w"], limit=limit, enabled=enabled)},
        stop=Stop(time=3),
    )


@pytest.mark.parametrize("limit", [2, 20])
def test_a_brake_that_its_own_couple_opens_gives_a_warning(limit: float) -> None:
    scene = wheel(limit, "w.dangle >= 1")
    stepped = statechart.run(scene, engine="impulse", step=1e-3).trace
    (warning,) = [w for w in stepped.warnings if ADVICE in w]
    assert warning.startswith("b returns to its last state after one step")
    assert "from t = 1.001 on" in warning
    # The mean of the couple holds the rate at the bound.
    assert abs(stepped.final[stepped.variables.index("w.dangle")] - 1) < 1e-3 * limit
    with_events = statechart.run(scene, engine="taylor", throw=False).trace
    assert with_events.outcome is Outcome.EVENT_LOOP
    assert ADVICE in with_events.message


RELAY = """
kind: scene
name: relay
bodies: {p: {mass: 1, start: {dx: 1}}}
controls: {push: 0}
forces: {g: {body: p, force: [push, 0]}}
regions:
  r:
    initial: back
    states: {back: {sets: {push: -1}}, forth: {sets: {push: 1}}}
    transitions:
      - {name: push, from: back, to: forth, guard: p.dx <= LOW}
      - {name: pull, from: forth, to: back, guard: HIGH}
stop: {time: 3}
"""


def test_a_relay_without_a_band_gives_a_warning_by_steps() -> None:
    text = RELAY.replace("LOW", "0").replace("HIGH", "p.dx >= 0")
    stepped = statechart.run(interpret(read_text(text)), engine="impulse", step=1e-3)
    assert [w for w in stepped.warnings if w.startswith("r returns") and ADVICE in w]
    banded = text.replace("p.dx >= 0", "p.dx >= 0.01")
    assert not statechart.run(interpret(read_text(banded)), engine="impulse", step=1e-3).warnings
    # In a step of 0.02 the rate crosses both bounds.
    (warning,) = statechart.run(interpret(read_text(banded)), engine="impulse", step=0.02).warnings
    assert "write a shorter step or, if it switches what decides it, give it two" in warning


@pytest.mark.parametrize(
    "enabled", ["mod(time, 0.01) < 0.001", "mod(time, 0.002) < 0.001", "w.dangle >= 1e-9"]
)
def test_pulses_of_one_step_and_lasting_brakes_give_none(enabled: str) -> None:
    limit = 0.5 if "dangle" in enabled else 2
    run = statechart.run(wheel(limit, enabled), engine="impulse", step=1e-3)
    assert not run.warnings
    assert "b close" in {f"{jump.region} {jump.cause}" for jump in run.trace.jumps}


@pytest.mark.parametrize("limit", [1e-6, 20])
def test_a_cam_that_closes_a_switch_for_one_step_in_each_turn_gives_none(limit: float) -> None:
    # At 100 rad/s a turn takes 63 steps, and the cam is 0.98 steps wide.
    scene = wheel(limit, "cos(w.angle) >= 0.9988")
    start = Body(mass=1, inertia=1, start={"angle": 1, "dangle": 100})
    scene = scene.model_copy(update={"bodies": {"w": start}})
    stepped = statechart.run(scene, engine="impulse", step=1e-3, until=0.9)
    closings = [jump.t for jump in stepped.trace.jumps if jump.cause == "close"]
    assert 12 <= len(closings) <= 15
    assert not stepped.warnings
