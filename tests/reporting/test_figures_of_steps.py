"""Figures of runs by steps: curves that move, without round-off of impulses."""

from __future__ import annotations

import numpy as np

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.reporting.figure import figure
from statechart.running.runner import Runner


def test_round_off_velocities_after_impulses_are_not_drawn() -> None:
    # A belt carries boxes against a wall: none turns, but for what their impulses are known to.
    text = """
kind: scene
name: queue
gravity: 9.81
bodies:
  box: {copies: 3, mass: 2, inertia: 0.011, start: {x: -0.25*index, y: 0.08, dx: 0.8},
    shape: {polygon: [[-0.1, -0.08], [0.1, -0.08], [0.1, 0.08], [-0.1, 0.08]]}}
surfaces: {belt: {height: 0, displacement: [0.8*time, 0]}, wall: {line: [[0.2, 0], [0.2, 1]]}}
collisions:
  belt: {bodies: [box], surfaces: [belt], friction: 0.4, restitution: 0}
  wall: {bodies: [box], surfaces: [wall], friction: 0, restitution: 0}
stop: {time: 0.5}
settings: {engine: impulse, step: 1e-3}
"""
    result = Runner(interpret(read_text(text))).run()
    rates = result.observer.sample(result.trace, ["box0.dangle"]).columns["box0.dangle"]
    assert np.abs(rates).max() > 1e-9
    titles = [ax.get_ylabel() for ax in figure(result.observer, result.trace).axes]
    assert titles[:3] == ["position", "velocity", "impulse"]


def test_the_time_axis_covers_the_motion_of_undrawn_variables() -> None:
    # Six bodies fall farther than the plate that they lie on then is shaken: heights are drawn.
    text = """
kind: scene
name: plate
gravity: 10
bodies:
  box: {copies: 6, mass: 1, inertia: 1, start: {x: 3*index, y: 2},
    shape: {polygon: [[-1, -1], [1, -1], [1, 1], [-1, 1]]}}
surfaces: {plate: {height: 0, displacement: [0.3*(1 - cos(2*time)), 0]}}
collisions: {all: {bodies: [box], surfaces: [plate], friction: 1, restitution: 0}}
stop: {time: 5}
settings: {engine: impulse, step: 1e-2}
"""
    result = Runner(interpret(read_text(text))).run()
    assert result.trace.jumps[-1].t < 2.0
    drawing = figure(result.observer, result.trace)
    assert "box0.x" not in [line.get_label() for line in drawing.axes[0].get_lines()]
    assert drawing.axes[-1].get_xlabel() == "time"
