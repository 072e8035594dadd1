"""Bodies that collide run without an engine or a step being named."""

from __future__ import annotations

import json

import pytest

from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.running.runner import Runner

DISCS = """\
kind: scene
name: discs
gravity: 9.81
parameters: {scale: 1}
bodies:
  disc:
    mass: 1
    inertia: 0.005*scale**2
    shape: {disc: 0.1*scale}
    copies: 2
    start: {x: 0.05*index*scale, y: (0.15 + 0.25*index)*scale}
surfaces:
  floor: {height: 0}
collisions:
  all: {bodies: [disc], surfaces: [floor], friction: 0.5, restitution: 0.3}
stop: {time: 0.3}
"""


def test_colliding_bodies_take_steps_by_their_scales_and_say_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "discs.yaml"
    path.write_text(DISCS)
    assert main(["run", str(path), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["engine"] == "impulse"
    assert shown["outcome"] == "HORIZON"
    (said,) = [w for w in shown["warnings"] if "steps of" in w]
    assert f"{shown['step']:g}" in said
    for verb in (["validate", str(path)], ["check", str(path), "--examples", "2", "--seed", "1"]):
        assert main(verb) == 0, verb


def test_the_step_follows_the_scales_and_gives_way_to_one_that_is_given():
    own = Runner(read_text(DISCS)).setting.step
    # Falling takes twice the time at four times the size.
    larger = Runner(read_text(DISCS.replace("{scale: 1}", "{scale: 4}"))).setting.step
    assert larger == pytest.approx(2.0 * own, rel=0.3)
    assert Runner(read_text(DISCS), engine="auto", step=1e-4).setting.step == 1e-4
    assert not Runner(read_text(DISCS), engine="impulse", step=1e-3).run(until=0.0).warnings


def test_engines_with_events_still_refuse_colliding_bodies():
    with pytest.raises(DeclarationError):
        Runner(read_text(DISCS), engine="impulse")
    with pytest.raises(DeclarationError, match="the engine taylor cannot run bodies that collide"):
        Runner(read_text(DISCS), engine="taylor").run()
