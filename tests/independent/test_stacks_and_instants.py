"""Blocks on blocks, and controllers that act at a contact's event, against answers by hand."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from references import G, flow

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

ENGINES = ["taylor", "scipy"]
_STACK = """
kind: scene
name: stack
gravity: 9.81
bodies: {low: {mass: 3}, up: {mass: 1, start: {y: 0.5}}}
surfaces: {floor: {height: 0}, top: {height: 0.5, body: low}}
contacts:
  a: {point: {body: low}, surface: floor, friction: 0.15, restitution: 0}
  b: {point: {body: up}, surface: top, friction: 0.3, restitution: 0}
forces: {shake: {body: low, force: [14*sin(3*time) + 2*cos(5*time), 0]}}
stop: {time: 5}
outputs:
  low: {value: low.x}
  up: {value: up.x}
  a: {value: time, at: each a.slip or a.stick or a.reverse}
  b: {value: time, at: each b.slip or b.stick or b.reverse}
"""
_HANDS_ON = """
kind: scene
name: hands_on
gravity: 10
parameters: {v0: 2, ramp: 0}
bodies: {block: {mass: 1, start: {dx: v0}}}
surfaces: {floor: {height: 0}}
controls: {mu: 0.4, push: 0}
contacts: {c: {point: {body: block}, surface: floor, friction: mu, restitution: 0}}
forces: {f: {body: block, force: [push + ramp*time, 0]}}
regions:
  hand:
    initial: waits
    states: {waits: {}, pushes: {sets: {mu: 0.1, push: 3}}, holds: {sets: {mu: 1}}}
    transitions:
      - {name: go, from: waits, to: pushes, on: c.stick}
      - {name: hold, from: waits, to: holds, after: 0.5}
stop: {time: 1.5}
outputs:
  x: {value: block.x}
  dx: {value: block.dx}
  slips: {value: time, at: each c.slip}
"""
_BALL = """
kind: scene
name: ball
gravity: 10
bodies: {b: {mass: 1, inertia: 0.1, start: {y: 1, dx: 1, dangle: 3}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: b}, radius: 0.2, surface: floor, friction: 1e9, restitution: 1}
stop: {time: 3}
outputs:
  dx: {value: b.dx, at: each c.touchdown}
  w: {value: b.dangle, at: each c.touchdown}
  t: {value: time, at: each c.touchdown}
"""


def outputs(text: str, engine: str, **parameters: float) -> Any:
    result = statechart.run(
        interpret(read_text(text, "scene.yaml")), engine=engine, parameters=parameters
    )
    assert result.trace.certified
    return result.outputs


def stack() -> tuple[list[float], list[list[float]]]:
    """Two blocks: every way of sliding is tried, and the one that agrees is integrated."""
    masses, most = (3.0, 1.0), (0.15 * 4.0 * G, 0.3 * 1.0 * G)

    def rubs(t: float, ways: tuple[int, ...]) -> tuple[list[float], list[float]]:
        """Return accelerations of both, and the friction on the lower and the upper one."""
        push = 14.0 * math.sin(3.0 * t) + 2.0 * math.cos(5.0 * t)
        above = -ways[1] * most[1]
        if ways == (0, 0):
            return [0.0, 0.0], [-push, 0.0]
        if ways[0] == 0:
            return [0.0, above / masses[1]], [above - push, above]
        below = -ways[0] * most[0]
        if ways[1] == 0:
            both = (push + below) / sum(masses)
            return [both, both], [below, masses[1] * both]
        return [(push + below - above) / masses[0], above / masses[1]], [below, above]

    def agrees(t: float, slips: list[float], ways: tuple[int, ...]) -> bool:
        (one, two), friction = rubs(t, ways)
        return all(
            abs(force) <= limit + 1e-9 if way == 0 else way * (slip or gain) > 0.0
            for way, slip, gain, force, limit in zip(
                ways, slips, (one, two - one), friction, most, strict=True
            )
        ) and all(slip == 0.0 or way != 0 for slip, way in zip(slips, ways, strict=True))

    t, state, ways, times = 0.0, [0.0] * 4, (0, 0), [[], []]  # type: ignore[var-annotated]
    while t < 5.0:
        slips = [state[2], state[3] - state[2]]
        slips = [0.0 if abs(slip) < 1e-10 else slip for slip in slips]
        # Just after: at an event itself the way that is left still agrees.
        way = next(w for w in itertools.product((0, 1, -1), repeat=2) if agrees(t + 1e-9, slips, w))
        for k in range(2):
            times[k] += [t] if t > 0.0 and way[k] != ways[k] else []
        ways = way
        ends = [
            (lambda t, y, k=k: most[k] - abs(rubs(t, ways)[1][k]) + 1e-13)
            if ways[k] == 0
            else (lambda t, y, k=k: ways[k] * (y[2] if k == 0 else y[3] - y[2]))
            for k in range(2)
        ]
        t, state, _ = flow(lambda t, y: [y[2], y[3], *rubs(t, ways)[0]], t, 5.0, state, *ends)
    return state, times


@pytest.mark.parametrize("engine", ENGINES)
def test_stacked_shaken_blocks_match_an_integration(engine: str) -> None:
    state, times = stack()
    found = outputs(_STACK, engine)
    assert len(times[0]) > 5
    assert len(times[1]) > 2
    assert [found["low"], found["up"]] == pytest.approx(state[:2], abs=1e-9)
    for name, wanted in zip("ab", times, strict=True):
        assert found[name] == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_hand_acts_at_the_instant_of_a_contacts_event(engine: str) -> None:
    # Friction 4 stops 2 at 0.5; from then on 3 - 1 pushes.
    found = outputs(_HANDS_ON, engine)
    assert [found["x"], found["dx"]] == pytest.approx([0.5 + 1.0, 2.0], abs=1e-12)
    assert found["slips"] == pytest.approx([0.5], abs=1e-12)
    # The force 8 t exceeds the limit 4 at 0.5, where the limit becomes 10; it holds to 1.25.
    found = outputs(_HANDS_ON, engine, v0=0.0, ramp=8.0)
    assert found["slips"] == pytest.approx([1.25], abs=1e-9)
    assert found["dx"] == pytest.approx(4.0 * 0.25**2, abs=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_rough_elastic_ball_loses_only_the_work_of_friction(engine: str) -> None:
    # The first impact takes the slip of 1 + 0.6, by an impulse of 1.6/(1/m + r^2/I); no later one.
    impulse = 1.6 / 1.4
    found = outputs(_BALL, engine)
    assert found["t"] == pytest.approx([0.4, 1.2, 2.0, 2.8], abs=1e-12)
    assert found["dx"] == pytest.approx(np.full(4, 1.0 - impulse), abs=1e-12)
    assert found["w"] == pytest.approx(np.full(4, 3.0 - 2.0 * impulse), abs=1e-12)
