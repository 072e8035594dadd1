"""Bodies of several parts that wedge in each other's notches as they fall into a bowl."""

from __future__ import annotations

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

SCENE = """
kind: scene
name: notches
gravity: 9.81
bodies:
  low:
    mass: 0.5590824560955052
    inertia: 0.004852135602075768
    shape:
      - {disc: 0.1, at: [0.05, 0.05]}
      - {polygon: [[0.05, 0.05], [0.15, 0.05], [0.15, 0.1], [0.05, 0.1]]}
      - {polygon: [[-0.05, 0.05], [0.05, 0.05], [0.05, 0.1], [-0.05, 0.1]]}
      - {polygon: [[0, -0.05], [0.15, -0.05], [0.15, 0.1], [0, 0.1]]}
    start: {x: 0.00702716705461591, y: 0.35, dangle: 1.5710647655618342}
  middle:
    mass: 1.247077070330309
    inertia: 0.0037433891259727923
    shape:
      - {polygon: [[-0.1, 0.05], [0, 0.05], [0, 0.1], [-0.1, 0.1]]}
      - {polygon: [[0.05, -0.05], [0.15, -0.05], [0.15, 0.05], [0.05, 0.05]]}
      - {polygon: [[-0.05, 0.05], [0.05, 0.05], [-0.05, 0.2]]}
      - {polygon: [[-0.05, 0], [0.1, 0], [0.1, 0.05], [-0.05, 0.05]]}
    start: {x: 0.003959735697575406, y: 0.85, dangle: -1.7785498460255684}
  high:
    mass: 1.7596987060375657
    inertia: 0.0031509452236311826
    shape:
      - {polygon: [[0.05, 0], [0.15, 0], [0.05, 0.1]]}
      - {polygon: [[-0.1, -0.1], [0.05, -0.1], [-0.1, 0.05]]}
    start: {x: -0.0043653267146183, y: 1.35, angle: 3.4401543112719, dangle: -2.2617366888143}
surfaces:
  bowl: {circle: [0, 2], radius: 2, hollow: true}
collisions:
  all: {bodies: [low, middle, high], surfaces: [bowl], friction: 0.5, restitution: 0.4}
stop: {time: 0.9}
outputs: {begun: {value: energy, at: start}, most: {maximum: energy}}
settings: {engine: impulse, step: 5e-4}
"""


def test_wedged_bodies_keep_their_contacts_as_these_turn():
    """Nothing can: its contacts would press each other without bound, from step to step."""
    result = Runner(read_text(SCENE)).run()
    assert result.trace.counts["inexact_steps"] == 0
    assert result.outputs["most"] == pytest.approx(result.outputs["begun"], rel=1e-9)


@pytest.mark.parametrize("tip", [-0.3, -0.2])
def test_a_wedge_with_its_centre_on_an_edge_drives_blocks_apart(tip):
    """The wedge falls by as much as each block moves: ``2 a = 2 g - 2 a``.

    The centres of the blocks are outside of them, that of the wedge is on its edge for -0.3.
    """
    text = f"""
kind: scene
name: wedge
gravity: 10
bodies:
  w:
    mass: 2
    inertia: 0.1
    shape: {{polygon: [[0, {tip}], [0.3, {tip + 0.3}], [-0.3, {tip + 0.3}]]}}
    start: {{y: {0.15 - tip}}}
  l:
    mass: 1
    inertia: 0.1
    shape: {{polygon: [[-0.6, -0.1], [-0.05, -0.1], [-0.05, 0.1], [-0.6, 0.1]]}}
    start: {{y: 0.1}}
  r:
    mass: 1
    inertia: 0.1
    shape: {{polygon: [[0.05, -0.1], [0.6, -0.1], [0.6, 0.1], [0.05, 0.1]]}}
    start: {{y: 0.1}}
surfaces: {{f: {{height: 0}}}}
collisions: {{c: {{bodies: [l, r, w], surfaces: [f], friction: 0, restitution: 0}}}}
stop: {{time: 0.2}}
outputs: {{sinks: {{value: {0.15 - tip} - w.y}}, x: {{value: r.x}}}}
settings: {{engine: impulse, step: 2e-3}}
"""
    result = Runner(read_text(text)).run()
    assert not result.trace.warnings
    assert [*result.outputs.values()] == pytest.approx([0.1, 0.1], abs=1e-9)
