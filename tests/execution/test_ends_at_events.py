"""Runs that end at an event: the event belongs to the run, and a longer run begins alike."""

from __future__ import annotations

import pytest

import statechart
from statechart import Runner
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

_BLOCK = """
kind: scene
name: pushed_block
gravity: 10
parameters: {v0: 3, force: -1}
bodies: {block: {mass: 1, start: {dx: v0}}}
surfaces: {floor: {height: 0}}
contacts:
  base: {point: {body: block}, surface: floor, friction: 0.5, restitution: 0}
forces: {push: {body: block, force: [force, 0]}}
stop: {time: 0.5}
outputs:
  sticks: {count: base.stick}
  reverses: {count: base.reverse}
"""
# A disc slips on a lane until it rolls, is struck by a wall, and rolls back.
_DISC = """
kind: scene
name: disc
gravity: 9.81
parameters: {r: 0.1}
bodies: {d: {mass: 2, inertia: 0.008, start: {y: 0.3, dx: 1, dangle: -30}}}
surfaces: {lane: {height: 0}, wall: {line: [[0.5, 0], [0.5, 1]]}}
contacts:
  c: {point: {body: d}, radius: r, surface: lane, friction: 0.2, restitution: 0}
  w: {point: {body: d}, radius: r, surface: wall, friction: 0.2, restitution: 0.5}
stop: {time: 2.5}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_slip_may_end_at_the_end_of_the_run(engine: str) -> None:
    block = interpret(read_text(_BLOCK, "block.yaml"))
    runner = Runner(block, engine=engine)
    # mu g = 5: 3 = (5 + 1) 0.5 is stopped, and 7 = (5 + 9) 0.5 is turned back.
    assert runner.run().outputs == {"sticks": 1, "reverses": 0}
    assert runner.run({"v0": 7, "force": -9}).outputs == {"sticks": 0, "reverses": 1}
    assert runner.run({"v0": 3.0000001}).outputs == {"sticks": 0, "reverses": 0}
    # A block that has hardly begun to slide does not stick.
    assert runner.run({"v0": 0, "force": 6}, until=1e-14).outputs == {"sticks": 0, "reverses": 0}


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_runs_to_each_event_match_the_full_run(engine: str) -> None:
    runner = statechart.Runner(interpret(read_text(_DISC, "disc.yaml")), engine=engine)
    whole = runner.run().trace
    causes = [jump.cause for jump in whole.jumps]
    assert "stick" in causes
    assert causes.count("touchdown") >= 2
    for place, jump in enumerate(whole.jumps):
        part = runner.run(until=jump.t).trace
        assert [one.cause for one in part.jumps] == causes[: place + 1]
        assert part.final_mode == jump.target
        assert part.final == pytest.approx(jump.after, abs=1e-12)
