"""Machines with controllers move as their closed forms say: a pendulum, a staircase, a hopper."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.special
from controllers import BLOCK, DRIVE, both, compose, ran
from runs import ENGINES, engine, outputs, run

from statechart.execution.simulator import Simulator

PENDULUM = """\
kind: scene
name: pendulum
parameters: {g: 10, lean: 1, hard: 0}
gravity: g
bodies:
  rod: {mass: 2, inertia: 0.5, start: {x: sin(lean), y: -cos(lean), angle: lean}}
joints:
  pivot: {point: {body: rod, at: [0, 1]}, to: [0, 0]}
regions:
  swing:
    initial: there
    states: {there: {}, back: {}}
    transitions:
      - {name: turn, from: there, to: back, guard: rod.dangle >= 0}
      - {name: turn, from: back, to: there, guard: rod.dangle <= 0}
  load:
    initial: light
    states: {light: {}, heavy: {}}
    transitions:
      - {name: grow, from: light, to: heavy, guard: pivot.Y >= hard}
      - {name: drop, from: heavy, to: light, guard: pivot.Y <= hard}
"""


@both
def test_guards_of_jointed_bodies_fire_at_closed_form_times(name: str) -> None:
    rate = math.sqrt(2 * 10 / 2.5)
    half = 2 * scipy.special.ellipk(math.sin(0.5) ** 2) / rate

    def force(angle: float) -> float:
        spin = 2 * rate**2 * (math.cos(angle) - math.cos(1))
        return 2 * (10 + math.cos(angle) * spin - (rate * math.sin(angle)) ** 2)

    trace = ran(PENDULUM, name, 2.2 * half, hard=force(0.3))
    turns = [jump.t for jump in trace.jumps if jump.cause == "turn"]
    # At rest at the start it is about to swing there, so that it does not turn back at once.
    assert turns == pytest.approx([half, 2 * half], abs=1e-9)
    loads = [(jump.cause, jump.after[2]) for jump in trace.jumps if jump.region == "load"]
    assert [cause for cause, _ in loads] == ["grow", "drop"] * 2
    assert [angle for _, angle in loads] == pytest.approx([0.3, -0.3, -0.3, 0.3], abs=1e-9)


STAIRS = (
    BLOCK
    + DRIVE
    + """\
controls: {push: F0}
regions:
  stairs:
    initial: s0
    states: {s0: {}, s1: {sets: {push: F1}}, s2: {sets: {push: F2}}, s3: {sets: {push: F3}}}
    transitions:
      - {name: step, from: s0, to: s1, guard: time >= 0.5}
      - {name: step, from: s1, to: s2, guard: time >= 1}
      - {name: step, from: s2, to: s3, guard: time >= 1.5}
"""
).replace("{F: 2, ", "{F0: 0, F1: 0, F2: 0, F3: 0, ")


def staircase(forces: list[float]) -> tuple[float, float, int]:
    """Return place, speed and number of changes of mode of a block of weight 10, mu = 1/2."""
    x, v, mode, changes = 0.0, 0.0, 0, 0
    for force in forces:
        left = 0.5
        while left > 0.0:
            now = 0 if v == 0.0 and abs(force) <= 5.0 else math.copysign(1, v or force)
            changes += now != mode
            mode = now
            a = 0.0 if now == 0 else force - 5.0 * now
            dt = min(left, -v / a) if v * a < 0.0 else left
            stops = dt < left
            x, v, left = x + v * dt + a * dt**2 / 2, 0.0 if stops else v + a * dt, left - dt
    return x, v, changes


def test_a_staircase_of_forces_moves_a_block_as_its_parabolas_say() -> None:
    random = np.random.default_rng(8)
    simulators = {name: Simulator(compose(STAIRS), engine(name)) for name in ENGINES}
    seen: set[str] = set()
    for _ in range(60):
        forces = (random.choice([0, 4.8, 5.15, 7.3, 12.1], 4) * random.choice([-1, 1], 4)).tolist()
        x, v, changes = staircase(forces)
        for name, simulator in simulators.items():
            trace = simulator.run({f"F{i}": f for i, f in enumerate(forces)}, until=2.0)
            assert trace.final[[0, 2]] == pytest.approx([x, v], abs=1e-9), (name, forces)
            modes = [trace.start_mode[0], *(jump.target[0] for jump in trace.jumps)]
            found = sum(a != b for a, b in zip(["pin", *modes], modes, strict=False))
            assert found == changes, (name, forces)
            seen |= {jump.cause for jump in trace.jumps}
    assert seen == {"step", "slip", "stick", "reverse"}


def hops(until: float, **parameters: float) -> dict[str, list[float]]:
    """Return the hopper's events in closed form: falls, half periods of springs, an impact."""
    p = {"m": 1.0, "foot": 0.05, "k": 200.0, "l0": 1.0, "d": 0.03, "h0": 0.2, "g": 9.81}
    p |= parameters
    rate, sag = math.sqrt(p["k"] / p["m"]), p["m"] * p["g"] / p["k"]
    found: dict[str, list[float]] = {"landings": [], "bottoms": [], "lift_offs": [], "speeds": []}
    t, speed = math.sqrt(2 * p["h0"] / p["g"]), math.sqrt(2 * p["h0"] * p["g"])
    while t < until:
        found["landings"].append(t)
        t += (math.pi - math.atan2(speed * rate, p["g"])) / rate
        bottom = p["l0"] - sag - math.hypot(sag, speed / rate)
        if t > until:
            break
        found["bottoms"].append(bottom)
        # About the raised rest length, from rest at the bottom to the leg's full length.
        swing = p["l0"] - sag + p["d"] - bottom
        phase = math.acos((p["d"] - sag) / swing)
        t += phase / rate
        if t > until:
            break
        speed = swing * rate * math.sin(phase) * p["m"] / (p["m"] + p["foot"])
        found["lift_offs"].append(t)
        found["speeds"].append(speed)
        t += 2 * speed / p["g"]
    return found


@both
@pytest.mark.parametrize(
    "parameters", [{}, {"k": 1000.0, "foot": 0.2}, {"d": 0.01, "foot": 0.01, "h0": 0.4}]
)
def test_the_hopper_lands_and_leaves_as_its_closed_form_says(
    name: str, parameters: dict[str, float]
) -> None:
    trace = run("hopper", name, 5.0, **parameters)
    found: dict[str, Any] = outputs("hopper", name, trace)
    expected = hops(5.0, **parameters)
    assert found["hops"] == len(expected["lift_offs"]) >= 5
    for key, values in expected.items():
        assert found[key] == pytest.approx(values, abs=1e-9)
    assert trace.certified
