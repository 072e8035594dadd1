"""Runs that end at an event: the event belongs to the run, and a longer run begins alike."""

from __future__ import annotations

import pytest
from runs import ENGINES

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


# The decelerating far block leans on its front foot: V = 10 -+ mu m g 0.1/0.4.
_BLOCKS = """
kind: scene
name: blocks
gravity: 10
parameters: {mu: 0.5, v: 3}
bodies:
  near: {mass: 1, inertia: 0.1, start: {y: 0.1, dx: v}}
  far: {mass: 2, inertia: 0.1, start: {x: 5, y: 0.1, dx: 2*v}}
surfaces: {floor: {height: 0}}
contacts:
  l: {point: {body: near, at: [-0.2, -0.1]}, surface: floor, friction: mu, restitution: 0}
  r: {point: {body: near, at: [0.2, -0.1]}, surface: floor, friction: mu, restitution: 0}
  far_l: {point: {body: far, at: [-0.2, -0.1]}, surface: floor, friction: mu, restitution: 0}
  far_r: {point: {body: far, at: [0.2, -0.1]}, surface: floor, friction: mu, restitution: 0}
stop: {time: v/(mu*10), conditions: {slow: far.dx <= 0}}
outputs:
  l: {value: l.V}
  far_l: {value: far_l.V}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("longer", [1, 2, 3])
def test_a_run_that_ends_as_two_feet_stick_shows_how_they_share_the_load(
    engine: str, longer: int
) -> None:
    # At its end the near block sticks, then the far one; the last run stops by its condition.
    ending = statechart.run(read_text(_BLOCKS), until=longer * 0.6, engine=engine)
    assert ending.outputs["l"] == pytest.approx(5.0, rel=1e-12)
    assert ending.outputs["far_l"] == pytest.approx(10.0 if longer > 1 else 7.5, rel=1e-12)


# A controller listens to the stick of the first of two sleds, so that its mode lasts no time.
_SLEDS = """
kind: scene
name: sleds
gravity: 10
bodies:
  near: {mass: 2, inertia: 0.1, start: {y: 0.1, dx: 1}}
  far: {mass: 2, inertia: 0.1, start: {x: 9, y: 0.1, dx: SPEED}}
surfaces: {floor: {height: 0}}
contacts:
  l: {point: {body: near, at: [-0.3, -0.1]}, surface: floor, friction: 0.2, restitution: 0}
  r: {point: {body: near, at: [0.3, -0.1]}, surface: floor, friction: 0.2, restitution: 0}
  far_l: {point: {body: far, at: [-0.3, -0.1]}, surface: floor, friction: 0.2, restitution: 0}
  far_r: {point: {body: far, at: [0.3, -0.1]}, surface: floor, friction: 0.2, restitution: 0}
controls: {push: 0}
forces: {hand: {body: near, force: [push, 0]}}
regions:
  hold:
    initial: off
    states: {off: {}, on: {sets: {push: 1.5}}}
    transitions: [{name: start, from: off, to: on, on: l.stick}]
stop: {time: 1}
outputs:
  stuck: {value: l.V, at: first l.stick}
  beside: {value: far_l.V, at: first l.stick}
  held: {value: l.V, at: first hold.start}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("speed", [0.4, 1.6])
def test_a_mode_that_lasts_no_time_shares_its_load(engine: str, speed: float) -> None:
    text = _SLEDS.replace("SPEED", str(speed))
    result = statechart.run(read_text(text), engine=engine)
    # The far sled still slides at 1.6 m/s: friction of 4 N at a height of 0.1 loads its front.
    beside = 10.0 if speed < 1.0 else 10.0 - 4 * 0.1 / 0.6
    # The near one is pushed by 1.5 N at that height.
    want = {"stuck": 10.0, "beside": beside, "held": 10.0 - 1.5 * 0.1 / 0.6}
    assert dict(result.outputs) == pytest.approx(want, rel=1e-12)
