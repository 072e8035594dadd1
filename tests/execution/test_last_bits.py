"""Last bits of times and gaps."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from statechart.automaton.clock import Clock
from statechart.documents.yaml_reader import read_text
from statechart.kernels.polynomials import sample_states
from statechart.running.runner import Runner, run

DROP = """\
kind: scene
name: drop
parameters: {h: 1e-9}
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: 1, y: 1 + h}}}
surfaces: {shelf: {height: 1}}
contacts: {tip: {point: {body: ball}, surface: shelf, friction: 0.5, restitution: 0}}
stop: {time: 0.01}
"""


def test_times_of_many_flows_add_up_to_the_last_bit() -> None:
    clock = Clock()
    for _ in range(10_000):
        clock = clock.later(0.1)
    assert clock.high == float(10_000 * Fraction(0.1))
    assert abs(clock.low) <= 0.5 * math.ulp(clock.high)


def test_a_ball_a_billionth_above_a_shelf_falls_on_it() -> None:
    result = run(read_text(DROP))
    (touchdown,) = result.trace.jumps
    # The height has the round-off of its reference.
    fallen = (1.0 + 1e-9) - 1.0
    assert touchdown.cause == "touchdown"
    assert touchdown.t == pytest.approx(math.sqrt(2.0 * fallen / 9.81), rel=1e-4)


LIFTED = """\
kind: scene
name: lifted
parameters: {pull: 0, more: 0}
gravity: 10
bodies: {block: {mass: 1}}
surfaces: {ground: {height: 0}}
contacts: {base: {point: {body: block}, surface: ground, modes: [pin]}}
forces: {lift: {body: block, force: [0, 10 + pull + more*time]}}
stop: {time: 1}
"""


@pytest.mark.parametrize("name", ["taylor", "scipy"])
def test_contact_release_has_hysteresis(name: str) -> None:
    # Round-off of a zero force: 1e-12 of the weight, and half of it at the start of a mode.
    lifted = Runner(read_text(LIFTED), engine=name)

    def end(**parts: float) -> tuple[str, float]:
        pulls = {key: 1e-11 * part for key, part in parts.items()}
        trace = lifted.run(pulls, throw=False).trace
        return trace.outcome.name, trace.t_end

    assert end(pull=0.4) == ("HORIZON", 1.0)
    assert end(pull=0.6) == ("NO_CONSISTENT_MODE", 0.0)
    assert end(pull=0.4, more=0.5) == ("HORIZON", 1.0)
    outcome, time = end(pull=0.4, more=0.8)
    assert outcome == "NO_CONSISTENT_MODE"
    assert time == pytest.approx(0.75, abs=1e-3)


PLANK = """\
kind: scene
name: plank
parameters: {tilt: 0}
gravity: 10
bodies: {plank: {mass: 1, inertia: 1/3, start: {y: 0.5, angle: tilt}}}
surfaces: {ground: {height: 0}}
contacts:
  left: {point: {body: plank, at: [-1, 0]}, surface: ground, friction: 0.5, restitution: 0}
  right: {point: {body: plank, at: [1, 0]}, surface: ground, friction: 0.5, restitution: 0}
stop: {time: 1}
"""


@pytest.mark.parametrize("name", ["taylor", "scipy"])
def test_ends_that_land_together_lie_on_the_ground_from_the_jump_on(name: str) -> None:
    # One end is down, the other within the tolerance of its gap: both have landed.
    plank = Runner(read_text(PLANK), engine=name)
    tolerance = plank.run(until=0.0).trace.tolerances["gap"]
    trace = plank.run({"tilt": 0.25 * tolerance}).trace
    (landing,) = trace.jumps
    # The lower end comes down first.
    assert landing.t == pytest.approx(math.sqrt(0.2 * (0.5 - 0.25 * tolerance)), abs=1e-13)
    assert landing.target == ("pin", "pin")
    assert landing.before[2] == 0.25 * tolerance
    _, y, tilt, *_ = landing.after
    assert abs(y) + abs(tilt) < 0.05 * tolerance


# The pull approaches its limit, and then hardly changes.
SLOWLY = LIFTED.replace("pull + more*time", "pull - exp(-time)").replace("time: 1", "time: 40")


@pytest.mark.parametrize("name", ["taylor", "scipy"])
def test_force_settling_below_zero_fires_at_its_crossing(name: str) -> None:
    pulled = Runner(read_text(SLOWLY), engine=name)
    for pull in (1e-3, 1e-6, 1e-9, 1e-10):
        trace = pulled.run({"pull": pull}, throw=False).trace
        assert trace.outcome.name == "NO_CONSISTENT_MODE"
        # V = exp(-time) - pull, down to what rounding makes of it: 1e-12 of the weight.
        passed = -math.log(pull - 1e-11)
        assert trace.t_end == pytest.approx(passed, abs=1e-3)


def test_a_jump_begins_where_its_flow_ends_and_not_at_its_projection() -> None:
    trace = run("toppling_stick", engine="scipy", tolerance=1e-6).trace
    (reverse,) = [jump for jump in trace.jumps if jump.cause == "reverse"]
    arc = [arc for arc in trace.arcs if arc.j == reverse.j][-1]
    end = sample_states(arc.coefficients, arc.times, arc.times[-1:])[0]
    assert reverse.before.tolist() == end.tolist()
    # The constraints of the flow are off by the error of its steps.
    assert 1e-9 < np.abs(reverse.after - reverse.before).max() < 1e-6
