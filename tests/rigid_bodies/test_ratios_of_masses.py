"""Extreme mass ratios give a warning, moderate ones do not."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner


def stack(heavy):
    """Return a run of a box on one of the mass of 1, for 20 steps."""
    box = "shape: {polygon: [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]}"
    text = f"""\
kind: scene
name: stack
gravity: 9.81
bodies:
  feather: {{mass: 1, inertia: 0.17, {box}, start: {{y: 0.5}}}}
  anvil: {{mass: {heavy}, inertia: {0.17 * heavy}, {box}, start: {{x: 0.01, y: 1.5}}}}
surfaces: {{ground: {{height: 0}}}}
collisions:
  all: {{bodies: [feather, anvil], surfaces: [ground], friction: 0.5, restitution: 0}}
stop: {{time: 0.02}}
settings: {{engine: impulse, step: 1e-3}}
"""
    return Runner(interpret(read_text(text))).run(throw=False).trace


def test_an_anvil_on_a_feather_gives_a_warning_of_its_residual():
    trace = stack(1e12)
    assert trace.counts["inexact_steps"] > 0
    (reported,) = trace.warnings
    assert "the residual of the contact impulses exceeds the tolerance of 1e-06" in reported


@pytest.mark.parametrize("heavy", [1.0, 1e6])
def test_mass_ratios_within_round_off_give_no_warning(heavy):
    trace = stack(heavy)
    assert trace.counts["inexact_steps"] == 0
    assert trace.warnings == ()
