"""Two balls that hit the floor, or each other, at once or nearly so: no impact is lost."""

from __future__ import annotations

import math

import numpy as np
import pytest
import runs
from runs import ENGINES, outputs, run

from contacts.kind import automaton
from contacts.scene.scene import Scene
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.execution.simulator import Simulator

MODEL = "two_balls"
G, RADIUS = 9.81, 0.1

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def fall(height: float) -> float:
    """Return the time of the first impact."""
    return math.sqrt(2.0 * (height - RADIUS) / G)


def test_identical_balls_are_both_thrown_up_in_one_jump(engine: str) -> None:
    trace = run(MODEL, engine, until=2.0)
    assert trace.certified
    assert len(trace.jumps) == 2
    for jump in trace.jumps:
        assert (jump.cause, set(jump.impulse)) == ("touchdown", {"floor1", "floor2"})
        assert jump.after[[5, 7]] == pytest.approx(-jump.before[[5, 7]], abs=1e-14)
    found = outputs(MODEL, engine, trace)
    assert (found["impacts1"], found["impacts2"]) == (2, 2)
    assert found["dy1"] == found["dy2"] == pytest.approx(math.sqrt(2 * G * 0.9), abs=1e-11)


@pytest.mark.parametrize("apart", [0.0, 1e-16, 1e-15, 1e-14, 1e-13, 1e-12, 1e-10, 1e-6])
def test_nearly_simultaneous_impacts_are_both_located(engine: str, apart: float) -> None:
    rng = np.random.default_rng(7)
    for height in rng.uniform(0.5, 2.0, 12).tolist():
        for other in (height * (1.0 + apart), height * (1.0 - apart)):
            trace = run(MODEL, engine, until=2.9 * fall(height), h1=height, h2=other)
            found = outputs(MODEL, engine, trace)
            assert (found["impacts1"], found["impacts2"]) == (1, 1)
            assert trace.certified
            # Both are on their way up or down again, where free flight puts them.
            for place, h in ((1, height), (3, other)):
                since, v = trace.t_end - fall(h), G * fall(h)
                y = RADIUS + v * since - 0.5 * G * since**2
                assert trace.final[place] == pytest.approx(y, abs=1e-10)


@pytest.mark.parametrize("ratio", [1e-6, 0.1, 0.5, 1.0, 3.0, 100.0])
@pytest.mark.parametrize("gap", [1e-3, 0.05])
def test_galton_the_upper_ball_is_thrown_up_by_the_lower(
    engine: str, ratio: float, gap: float
) -> None:
    height = 1.0
    over = height + 2.0 * RADIUS + gap
    trace = run(MODEL, engine, until=0.6, h1=height, h2=over, apart=0.0, ratio=ratio)
    (floor, pair) = trace.jumps[:2]
    assert (floor.region, pair.region) == ("floor1", "pair")
    v = G * floor.t
    # They approach at 2 v; the centres then are one gap more than two radii apart.
    delay = gap / (2.0 * v)
    assert pair.t - floor.t == pytest.approx(delay, abs=1e-12)
    up, down = v - G * delay, -v - G * delay
    mean = (up + ratio * down) / (1.0 + ratio)
    assert pair.after[5] == pytest.approx(2.0 * mean - up, abs=1e-11)
    assert pair.after[7] == pytest.approx(2.0 * mean - down, abs=1e-11)
    # Without the fall between the two impacts the factor is (3 - ratio)/(1 + ratio).
    factor = (3.0 - ratio) / (1.0 + ratio)
    assert pair.after[7] == pytest.approx(factor * v, abs=1.01 * G * delay)


SQUEEZED = """
kind: scene
name: squeezed
gravity: 1
bodies:
  low: {mass: 1, start: {y: 1.5}}
  high: {mass: 100, start: {x: 0.129, y: 3.43}}
surfaces: {floor: {height: 0}, shell: {circle: [0, 0], radius: 1, body: low}}
contacts:
  ground: {point: {body: low, at: [0, -0.5]}, surface: floor, friction: 1, restitution: 0.665}
  between: {point: {body: high}, surface: shell, friction: 1, restitution: 0.665}
"""


def test_a_light_ball_between_heavy_ones_bounces_until_all_separate(
    engine: str,
) -> None:
    scene = validate(read_text(SQUEEZED), Scene)
    trace = Simulator(automaton(scene), runs.engine(engine)).run(until=2.0, throw=False)
    end = next(i for i, jump in enumerate(trace.jumps) if jump.cause == "zeno")
    last = trace.jumps[end - 1]
    assert last.skipped > 0.0
    # Every impact on the ground stops the slip, whatever comes in between: so does the last.
    assert last.after[4:6] == pytest.approx([0.0, 0.0], abs=1e-12)
    x, y = last.after[2:4] - last.after[0:2]
    assert last.after[6:8] @ [x, y] == pytest.approx(0.0, abs=1e-9)
    assert trace.jumps[end].target[0] == "pin"
