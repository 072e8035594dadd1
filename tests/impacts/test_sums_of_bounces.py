"""Sums of the last bounces of a contact, whose ratio need not be the coefficient of restitution."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.running.runner import Runner

# A mass on a rod about the origin lands on a floor beside its lowest point. Its slip is
# proportional to the rate of its gap, so that friction reverses in the middle of each impact.
LEVER = """\
kind: scene
name: lever
gravity: g
parameters: {{g: 1, mu: 0.1, e: 0.7, h: 0.15, w: -0.4}}
coordinates: {{p: {{start: -h, rate: w}}}}
bodies: {{mass: {{mass: 1, position: [sin(p), -cos(p)]}}}}
surfaces: {{floor: {{height: -cos(h)}}}}
contacts:
  tip: {{point: {{body: mass}}, surface: floor, friction: mu, restitution: e, impact: {law}}}
stop: {{time: 15}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("law", ["newton", "poisson", "stronge"])
def test_the_sum_of_the_last_bounces_has_the_ratio_of_their_rebounds(engine: str, law: str) -> None:
    part = (math.tan(0.15) - 0.1) / (math.tan(0.15) + 0.1)
    ratio = 0.7 * {"newton": 1.0, "poisson": part, "stronge": math.sqrt(part)}[law]
    model = read_text(LEVER.format(law=law))
    fine, coarse = (
        Runner(model, engine=engine, tolerance=tolerance).run().trace for tolerance in (1e-13, 1e-9)
    )
    *_, before, last = [jump for jump in fine.jumps if jump.cause == "touchdown"]
    rest = (last.t - before.t) * ratio / (1.0 - ratio)
    assert last.skipped == pytest.approx(rest, rel=1e-3)
    ends = [next(jump.t for jump in run.jumps if jump.cause == "zeno") for run in (fine, coarse)]
    assert len(coarse.jumps) < len(fine.jumps)
    assert ends[1] == pytest.approx(ends[0], abs=1e-6)


def test_the_sum_of_the_last_bounces_on_a_curved_ground_has_the_ratio_of_restitution() -> None:
    start = {"A": 0.281082880652198, "k": 19.776159123184033, "phase": 4.76457625049054}
    start |= {"y0": 1.75158450666059, "vx0": 2.2642174320896533, "vy0": -0.71411076424147479}
    start |= {"e": 0.40519434611193605}
    fine, coarse = (
        Runner("bouncing_ball_hills", tolerance=tolerance).run(start).trace
        for tolerance in (1e-13, 1e-9)
    )
    ends = [next(jump.t for jump in run.jumps if jump.cause == "zeno") for run in (fine, coarse)]
    assert len(coarse.jumps) < len(fine.jumps)
    assert ends[1] == pytest.approx(ends[0], abs=1e-8)


def test_bounces_on_an_accelerated_table_are_summed() -> None:
    # The table falls at 5 m/s**2: bounces accumulate as under a gravity of 4.81.
    table = """\
kind: scene
name: table
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {table: {height: 0, displacement: [0, -2.5*time**2]}}
contacts: {foot: {point: {body: ball}, surface: table, friction: 0, restitution: 0.3}}
stop: {time: 5}
"""
    for tolerance, most in ((1e-13, 30), (1e-8, 20)):
        jumps = Runner(read_text(table), tolerance=tolerance).run().trace.jumps
        end = next(jump.t for jump in jumps if jump.cause == "zeno")
        first = math.sqrt(2.0 / 4.81)
        assert end == pytest.approx(first * (1.0 + 0.6 / 0.7), abs=1e-9)
        assert len(jumps) < most
