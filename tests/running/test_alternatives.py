"""Runs repeated under the other laws for simultaneous impacts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from statechart.cli.main import main

BALLS = """\
kind: scene
name: balls
doc: Two balls in a row hit a third that rests, or a wall; restitution e.
parameters: {e: 1, v: 1}
bodies:
  a: {mass: 1, start: {x: -2, dx: v}}
  b: {mass: 1, start: {x: 0}}
  c: {mass: 1, start: {x: 1}}
surfaces:
  back: {line: [[0, 0], [0, 1]], body: b}
  rear: {line: [[0, 0], [0, 1]], body: c}
contacts:
  ab: {point: {body: a, at: [1, 0]}, surface: back,
    modes: [free, slide], friction: 0, restitution: e}
  bc: {point: {body: b, at: [1, 0]}, surface: rear,
    modes: [free, slide], friction: 0, restitution: e}
stop: {time: 3}
outputs:
  last: {value: c.dx, at: end}
"""


@pytest.fixture
def balls(tmp_path: Path) -> str:
    path = tmp_path / "balls.yaml"
    path.write_text(BALLS)
    return str(path)


def rows(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, dict]:
    assert main(["run", *arguments, "--json", "--alternatives", "--engine", "scipy"]) == 0
    return {row["choice"]: row for row in json.loads(capsys.readouterr().out)["alternatives"]}


def test_a_cradle_depends_on_the_law_of_simultaneous_impacts(
    balls: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = rows(capsys, balls)
    assert set(found) == {"simultaneous: plastic", "simultaneous: sequential"}
    # One after another the momentum passes through; plastic, all three move on together.
    assert found["simultaneous: sequential"]["outputs"]["last"] == pytest.approx(1.0, abs=1e-12)
    assert found["simultaneous: plastic"]["outputs"]["last"] == pytest.approx(1 / 3, abs=1e-12)
    assert not found["simultaneous: plastic"]["same_modes"]
    assert found["simultaneous: plastic"]["diverged"] == pytest.approx(1.0, abs=1e-12)


def test_without_rebound_all_choices_agree(balls: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = rows(capsys, balls, "--set", "e=0")
    assert found["simultaneous: plastic"]["same_modes"]
    assert found["simultaneous: plastic"]["difference"] <= 1e-12


def test_one_contact_has_no_alternatives(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "bouncing_ball", "--until", "1", "--alternatives"]) == 0
    assert "no two contacts" in capsys.readouterr().out
