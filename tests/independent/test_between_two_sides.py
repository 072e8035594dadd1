"""Guided bodies: friction is limited by the pressing load, without self-equilibrated forces.

A point wedged between both sides of a slot could carry any load. Without preload only one side of
a slot with elastic sides, however stiff, is loaded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G, MU = 9.81, 0.3
ENGINES = [("taylor", None, 1e-10), ("scipy", None, 1e-10), ("impulse", 1e-3, 3e-3)]
_SLOT = """
kind: scene
name: slot
gravity: 9.81
bodies: {block: {mass: 1, start: START}}
surfaces:
  floor: {height: 0}
  roof: {line: [[1, 0], [0, 0]]}
contacts:
  low: {point: {body: block}, surface: floor, friction: 0.3, restitution: 0}
  high: {point: {body: block}, surface: roof, friction: 0.3, restitution: 0}
stop: {time: 2}
outputs: {x: {value: block.x}, v: {value: block.dx}}
"""
_FORCE = "forces: {push: {body: block, force: [PUSH, 0]}}\n"
_SWITCHED = """
controls: {F: 0}
forces: {push: {body: block, force: [F, 0]}}
regions:
  drive:
    initial: waits
    states: {waits: {}, pushes: {sets: {F: 5}}}
    transitions: [{name: go, from: waits, to: pushes, guard: time >= 1}]
"""
_HOOP = """
kind: scene
name: hoop
parameters: {R: 0.5, w: 6, m: 0.2, a: 0.3, v: 1.5}
gravity: 9.81
bodies: {bead: {mass: m, start: {x: R*sin(a), y: -R*cos(a), dx: v*cos(a), dy: v*sin(a)}}}
surfaces: {outer: {circle: [0, 0], radius: R, hollow: true}, inner: {circle: [0, 0], radius: R}}
contacts:
  outer: {point: {body: bead}, surface: outer, friction: 0.15, restitution: 0}
  inner: {point: {body: bead}, surface: inner, friction: 0.15, restitution: 0}
forces: {outwards: {body: bead, force: [m*w**2*bead.x, 0]}}
stop: {time: 2}
outputs:
  t: {value: time, at: each outer.stick or outer.reverse}
  x: {value: bead.x}
"""


def run(text: str, engine: str, step: float | None) -> Any:
    model = interpret(read_text(text, "scene.yaml"))
    return statechart.run(model, engine=engine, step=step)


@pytest.mark.parametrize(("engine", "step", "error"), ENGINES)
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_a_block_in_a_slot_slips_at_the_friction_of_its_weight(
    engine: str, step: float | None, error: float, way: float, up: float
) -> None:
    text = _SLOT.replace("START", "{}").replace("gravity: 9.81", f"gravity: {up * G}")
    result = run(text + _FORCE.replace("PUSH", f"{way * 5.0}*time"), engine, step)
    begins = MU * G / 5.0
    speed = 2.5 * (2.0 - begins) ** 2
    wanted = {"x": way * speed * (2.0 - begins) / 3.0, "v": way * speed}
    assert result.outputs == pytest.approx(wanted, rel=error)


@pytest.mark.parametrize(("engine", "step", "error"), ENGINES)
def test_pushed_block_in_a_slot_moves_immediately(
    engine: str, step: float | None, error: float
) -> None:
    pull, slot = 5.0 - MU * G, _SLOT.replace("START", "{}")
    result = run(slot + _FORCE.replace("PUSH", "5"), engine, step)
    assert result.outputs == pytest.approx({"x": 2.0 * pull, "v": 2.0 * pull}, rel=error)
    result = run(slot + _SWITCHED, engine, step)
    assert result.outputs == pytest.approx({"x": pull / 2.0, "v": pull}, rel=error)


@pytest.mark.parametrize(("engine", "step", "error"), ENGINES)
def test_a_block_in_a_slot_turns_where_it_stops(
    engine: str, step: float | None, error: float
) -> None:
    text = _SLOT.replace("START", "{dx: 2}") + _FORCE.replace("PUSH", "-5")
    result = run(text, engine, step)
    there, back = 5.0 + MU * G, 5.0 - MU * G
    left = 2.0 - 2.0 / there
    wanted = {"x": 2.0 / there - back * left**2 / 2.0, "v": -back * left}
    assert result.outputs == pytest.approx(wanted, rel=error)


@pytest.mark.parametrize(("engine", "step", "error"), ENGINES)
def test_a_bead_on_a_spinning_hoop_turns_and_sticks(
    engine: str, step: float | None, error: float
) -> None:
    reach, spin, mu = 0.5, 6.0, 0.15
    t, angle, rate, way, times = 0.0, 0.3, 3.0, 1.0, []
    for _ in range(2):

        def rates(_: float, y: Any, way: float = way) -> list[float]:
            s, c = np.sin(y[0]), np.cos(y[0])
            load = reach * y[1] ** 2 + G * c + spin**2 * reach * s * s
            return [y[1], (-G * s + spin**2 * reach * s * c - way * mu * load) / reach]

        def rests(_: float, y: Any, way: float = way) -> float:
            return float(way * y[1])

        rests.terminal, rests.direction = True, -1  # type: ignore[attr-defined]
        made = solve_ivp(
            rates, (t, 3.0), [angle, rate], "DOP853", rtol=1e-13, atol=1e-15, events=rests
        )
        t, angle, rate, way = made.t[-1], made.y[0, -1], -1e-30, -way
        times.append(t)
    found = run(_HOOP, engine, step).outputs
    assert found["t"] == pytest.approx(times, rel=error)
    assert found["x"] == pytest.approx(reach * np.sin(angle), rel=error)


@pytest.mark.parametrize(("mu", "reported"), [(0.9, False), (1.3, True)])
def test_a_block_that_two_sides_may_jam_gives_a_warning(mu: float, reported: bool) -> None:
    text = _SLOT.replace("START", "{}").replace("friction: 0.3", f"friction: {mu}")
    result = run(text + _FORCE.replace("PUSH", "10*time"), "taylor", None)
    may = [line for line in result.trace.warnings if "low, high may be wedged" in line]
    # From where H = V/mu on, long before H = mu V.
    assert [line.split(":")[0] for line in may] == [f"t = {G / mu / 10:.6g}"] * reported
    assert (result.outputs["x"] == 0.0) == reported
