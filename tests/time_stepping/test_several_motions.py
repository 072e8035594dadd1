"""Warnings of indeterminate steps, with which several motions agree (Painleve)."""

from pathlib import Path

import pytest

from statechart import check, run
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text

# Friction presses the tip into the ground where mu is 2, and something lifts the rod there.
ROD = """\
kind: scene
name: rod
gravity: 9.81
parameters: {angle: 0.9, l: 0.5, lift: 0, mu: 2, later: 0.01}
bodies:
  rod: {mass: 1, inertia: 0.025, start: {y: l*cos(angle), angle: angle, dx: 2}}
surfaces: {floor: {height: 0}}
contacts:
  tip: {point: {body: rod, at: [0, -l]}, surface: floor, friction: FRICTION, restitution: 0}
forces: {up: {body: rod, force: [0, FORCE]}}
stop: {time: 0.02}
"""
AT_ONCE = ROD.replace("FRICTION", "mu").replace("FORCE", "lift")
LATER = (
    ROD.replace("FRICTION", "rough").replace("FORCE", "pull")
    + """\
controls: {rough: 0.1, pull: 0}
regions:
  hand:
    initial: waiting
    states: {waiting: {}, lifting: {sets: {rough: mu, pull: lift}}}
    transitions: [{name: lift, from: waiting, to: lifting, guard: time >= later}]
"""
)
REPORTED = "friction presses a contact into its surface so that it may slide as well as lift off"


@pytest.mark.parametrize(
    ("lift", "reported"),
    [(20, True), (0, False)],  # comes off by itself; jams, which is the only motion
)
def test_an_indeterminate_start_gives_a_warning_on_both_engines(
    lift: float, reported: bool
) -> None:
    scene = read_text(AT_ONCE)
    by_steps = run(scene, engine="impulse", step=1e-3, parameters={"lift": lift})
    by_events = run(scene, parameters={"lift": lift})
    assert (f"at the start {REPORTED}" in " ".join(by_steps.warnings)) == reported
    assert ("tip:slide+, tip:free all agree" in " ".join(by_events.warnings)) == reported


def test_less_friction_makes_the_motion_unique() -> None:
    found = run(read_text(AT_ONCE), engine="impulse", step=1e-3, parameters={"mu": 1, "lift": 20})
    assert not any(REPORTED in warning for warning in found.warnings)


def test_indeterminate_motion_gives_a_warning_with_its_time() -> None:
    found = run(read_text(LATER), engine="impulse", step=1e-3, parameters={"lift": 20})
    assert any(f"the first at t = 0.01, {REPORTED}" in warning for warning in found.warnings)


def test_check_reports_several_motions_at_the_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rod.yaml"
    path.write_text(
        AT_ONCE.replace("lift: 0", "lift: 20") + "settings: {engine: impulse, step: 1e-3}\n"
    )
    assert main(["check", str(path), "--examples", "1", "--seed", "1", "-q"]) == 0
    assert f"warning: at the start {REPORTED}" in capsys.readouterr().err


def test_a_jam_by_steps_has_the_edge_and_the_depth_that_check_allows() -> None:
    text = AT_ONCE + "settings: {engine: impulse, step: 1e-3}\n"
    found = run(read_text(text))
    assert [(jump.cause, *jump.source, *jump.target) for jump in found.trace.jumps] == [
        ("jam", "slide+", "pin")
    ]
    assert found.trace.tolerances["gap"] >= 9.81 * 1e-3**2 / 8.0  # free up to the middle of a step
    assert check(read_text(text), examples=2, seed=1).passed
