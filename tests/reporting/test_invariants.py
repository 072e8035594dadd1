"""Invariants of models: reported with their least margin, tested by `check`."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import models
import statechart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret, load
from statechart.running.result import Result


def ball(tmp_path: Path, invariants: str) -> Path:
    """Return the shipped ball with invariants."""
    shipped = models.path("bouncing_ball")
    assert shipped is not None
    text = shipped.read_text(encoding="utf-8").replace("k: 0.9 ", "k: 0.5 ")
    file = tmp_path / "ball.yaml"
    file.write_text(f"{text}\ninvariants:\n{invariants}", encoding="utf-8")
    return file


def least(found: Result) -> dict[str, float]:
    return dict(found.to_dict()["invariants"])


def test_the_least_margin_of_an_invariant_is_reported(tmp_path: Path) -> None:
    file = ball(
        tmp_path,
        "  stays below: height <= 1.25\n  never fast: dheight**2 < 20\n  in time: time >= 0\n",
    )
    found = least(statechart.run(file))
    # Dropped from 1 it is fastest at the first impact: v^2 = 2 g h.
    assert found["stays below"] == pytest.approx(0.25, rel=1e-12)
    assert found["never fast"] == pytest.approx(20 - 2 * 9.81, rel=1e-9)
    assert found["in time"] == 0.0


def test_check_names_the_invariant_that_fails(tmp_path: Path) -> None:
    kept = ball(tmp_path, "  above: height >= -1e-6\n")
    assert statechart.check(load(kept), examples=3, seed=1).passed
    broken = statechart.check(load(ball(tmp_path, "  low: height <= 0.05\n")), examples=3, seed=1)
    assert not broken.passed
    assert "the margin of 'low' is -" in broken.text()


def test_an_invariant_of_an_unknown_name_is_refused_with_its_place(tmp_path: Path) -> None:
    file = ball(tmp_path, "  low: hight <= 2\n")
    with pytest.raises(DeclarationError, match="unknown name 'hight'") as caught:
        statechart.run(file)
    text = file.read_text(encoding="utf-8")
    assert caught.value.line == text.count("\n")
    assert caught.value.column == len("  low: ") + 1


SLIDES = """
kind: scene
name: slides
gravity: 1
parameters: {mu: 0.1}
bodies: {ball: {mass: 1, start: {y: 1, dx: 0.5}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: ball}, surface: floor, friction: mu, restitution: 0}
regions:
  clock:
    initial: early
    states: {early: {}, late: {}}
    transitions: [{name: tick, from: early, to: late, guard: time >= 1}]
stop: {time: 2.5}
outputs: {x: {value: ball.x, at: end}}
"""
STEPS = "settings: {engine: impulse, step: 0.01}\n"
# A drop from the height 1 takes sqrt(2); the slide then starts at 0.5 - mu*sqrt(2).
IN_SCENES = {
    "in(c.free) or ball.y <= 0.5": 0.5,
    "in(c.free) or ball.dx <= 0.2": 0.2 - (0.5 - 0.1 * 2**0.5),
    "in(c.free) or c.V >= 0.5": 0.5,
    "not in(clock.late) or ball.y <= 0.6": 0.1,
    "in(c.free) or in(c.slide)": math.inf,
    "not in(c.slide)": -math.inf,
}


@pytest.mark.parametrize("settings", ["", STEPS])
@pytest.mark.parametrize(("invariant", "margin"), IN_SCENES.items())
def test_invariants_of_scenes_ask_for_states_of_contacts_and_controllers(
    invariant: str, margin: float, settings: str
) -> None:
    text = f"{SLIDES}{settings}invariants: {{i: {invariant}}}\n"
    model = interpret(read_text(text))
    assert float(least(statechart.run(model))["i"]) == pytest.approx(margin, abs=0.02)
    checked = statechart.check(model, examples=1)
    failed = [one.name for one in checked.properties if one.failure]
    assert failed == ([] if margin >= 0.0 else ["declared invariants hold"])


def test_invariants_of_states_that_a_run_does_not_keep_are_left_out() -> None:
    text = SLIDES + STEPS.replace("}", ", record: poses}")
    kept, lost = "not in(clock.late) or ball.y <= 0.6", "in(c.free) or ball.y <= 0.5"
    text += f"invariants: {{kept: {kept}, lost: {lost}}}\n"
    found = statechart.run(interpret(read_text(text)))
    assert [*least(found)] == ["kept"]
    assert {
        "what": "the invariant 'lost'",
        "why": "record: poses stores no states; use record: modes",
    } in found.to_dict()["left_out"]


def test_models_with_invariants_of_states_are_swept() -> None:
    text = f"{SLIDES}invariants: {{i: in(c.free) or ball.dx <= 0.2}}\n"
    swept = statechart.sweep(interpret(read_text(text)), {"mu": [0.05, 0.1]})
    assert (swept["x"].diff("mu") < 0.0).all()
