"""Plastic impacts on surfaces that recede: the body flies on, and no mode pulls on it."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from runs import ENGINES

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

SHAKER = """
kind: scene
name: shaker
parameters: {a: 0.01, w: 60, p: 0, mu: 0.5, e: 0, u: 0}
gravity: 9.81
bodies: {box: {mass: 1, start: {y: a*sin(p), dy: a*w*cos(p), dx: u}}}
surfaces: {table: {height: 0, displacement: [0, a*sin(w*time + p)]}}
contacts: {c: {point: {body: box}, surface: table, friction: mu, restitution: e}}
stop: {time: 0.3}
outputs:
  least: {minimum: c.V}
  lifts: {count: c.liftoff}
  lands: {count: c.touchdown}
invariants: {it pushes: c.V >= -1e-6}
"""


@pytest.mark.parametrize("engine", ENGINES)
def test_a_plastic_landing_on_a_receding_table_is_one_jump_into_flight(engine: str) -> None:
    result = Runner(read_text(SHAKER), engine=engine).run()
    lift, *lands = result.trace.jumps
    assert math.sin(60 * lift.t) == pytest.approx(9.81 / 36, abs=1e-9)
    again = ("touchdown", ("free",), ("free",))
    assert [(j.cause, j.source, j.target) for j in lands] == [again] * 2
    for jump in lands:
        # It leaves with the table's velocity, that falls faster than it.
        assert jump.after[3] == pytest.approx(0.6 * math.cos(60 * jump.t), abs=1e-9)
        assert jump.impulse["c"][0] > 0.0
        assert 36 * math.sin(60 * jump.t) > 9.81
    assert result.outputs["least"] >= -1e-8
    assert (result.outputs["lifts"], result.outputs["lands"]) == (1, 2)


def test_no_contact_of_a_shaken_body_is_entered_and_left_at_one_instant() -> None:
    run, random = Runner(read_text(SHAKER)), np.random.default_rng(7)
    again = 0
    for _ in range(20):
        values = {
            "a": random.uniform(0.005, 0.02),
            "w": random.uniform(40, 120),
            "p": random.uniform(0, 2 * math.pi),
            "mu": random.uniform(0, 1),
            "u": random.uniform(-1, 1),
        }
        result = run.run(values)
        jumps = result.trace.jumps
        assert result.outputs["least"] is None or result.outputs["least"] >= -1e-8
        assert not any(a.t == b.t and b.cause == "liftoff" for a, b in pairwise(jumps))
        again += sum(j.cause == "touchdown" and j.target == ("free",) for j in jumps)
    assert again > 5


@pytest.mark.parametrize("step", [1e-3, 1e-4])
def test_by_steps_the_sequence_of_jumps_is_that_of_events(step: float) -> None:
    events = Runner(read_text(SHAKER)).run()
    steps = Runner(read_text(SHAKER), engine="impulse", step=step).run()
    expected, found = events.trace.jumps, steps.trace.jumps
    assert [(j.cause, j.target) for j in found] == [(j.cause, j.target) for j in expected]
    assert [j.t for j in found] == pytest.approx([j.t for j in expected], abs=2 * step)
    assert steps.outputs["least"] >= -1e-8
