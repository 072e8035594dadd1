"""Contacts that open, slip or jam at one instant, against answers by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])

_LIFTED = """
kind: scene
name: lifted
gravity: 10
bodies: {bar: {mass: 1, inertia: 1/3, start: {}}}
surfaces: {floor: {height: 0}}
contacts:
  L: {point: {body: bar, at: [-1, 0]}, surface: floor, friction: 0.5, restitution: 0}
  R: {point: {body: bar, at: [1, 0]}, surface: floor, friction: 0.5, restitution: 0}
forces:
  up: {body: bar, at: [-1, 0], force: [0, 5*time]}
  push: {body: bar, force: [2.5*time, 0]}
stop: {time: 1.3}
outputs:
  x: {value: bar.x}
  angle: {value: bar.angle}
  lift: {value: time, at: first L.liftoff}
  slip: {value: time, at: first R.slip}
"""
_WEDGED = """
kind: scene
name: wedged
gravity: 10
bodies: {stick: {mass: 1, inertia: 1/3, start: {angle: 0.3}}}
surfaces:
  left: {line: [[-cos(0.3), 1], [-cos(0.3), 0]]}
  right: {line: [[cos(0.3), 0], [cos(0.3), 1]]}
contacts:
  l: {point: {body: stick, at: [-1, 0]}, surface: left, friction: MU, restitution: 0}
  r: {point: {body: stick, at: [1, 0]}, surface: right, friction: MU, restitution: 0}
stop: {time: 1}
outputs: {y: {value: stick.y}, angle: {value: stick.angle}}
"""
_GRIPPED = """
kind: scene
name: gripped
gravity: 10
coordinates: {q: {}}
bodies: {part: {mass: 1, inertia: 1e-2, start: {}}, jaw: {mass: 1, position: [q, 0]}}
surfaces:
  left: {line: [[-0.1, 1], [-0.1, 0]]}
  right: {line: [[0.1, 0], [0.1, 1]], body: jaw}
contacts:
  l: {point: {body: part, at: [-0.1, 0]}, surface: left, friction: 0.5, restitution: 0}
  r: {point: {body: part, at: [0.1, 0]}, surface: right, friction: 0.5, restitution: 0}
forces: {grip: {body: jaw, force: [10*time - 20, 0]}}
stop: {time: 3}
outputs:
  y: {value: part.y}
  slip: {value: time, at: first l.slip}
  off: {value: time, at: first r.liftoff}
"""
_ROLLERS = """
kind: scene
name: rollers
gravity: 10
coordinates: {p: {rate: -1000}, q: {rate: 1000}}
bodies:
  rod: {mass: 1, inertia: 1, start: {x: 0.1}}
  A: {mass: 1, inertia: 1e9, position: [-0.5, -0.1], angle: p}
  B: {mass: 1, inertia: 1e9, position: [0.5, -0.1], angle: q}
surfaces: {under: {line: [[1, 0], [-1, 0]], body: rod}}
contacts:
  a: {point: {body: A}, radius: 0.1, surface: under, friction: 0.2, restitution: 0}
  b: {point: {body: B}, radius: 0.1, surface: under, friction: 0.2, restitution: 0}
stop: {time: 3}
outputs: {x: {value: rod.x}, changes: {count: a.slip or a.stick or b.slip or b.stick}}
"""


def outputs(text: str, engine: str) -> Any:
    result = statechart.run(interpret(read_text(text, "scene.yaml")), engine=engine)
    assert result.trace.certified
    return result.outputs


def test_one_foot_opens_as_the_other_slips(engine: str) -> None:
    # The left foot carries 5 - 5t, so both feet hold 5 - 2.5t against 2.5t: both end at t = 1.
    def rates(t: float, state: Any) -> list[float]:
        _, angle, speed, turning = state
        c, s = math.cos(angle), math.sin(angle)
        lift, push = 5 * t, 2.5 * t
        equations = [[1, 0, 0.5], [0, c, 1], [0, 1 / 3, -c - 0.5 * s]]
        loads = [push, 10 - lift + s * turning**2, -c * lift]
        pulled, turned, _ = np.linalg.solve(equations, loads)
        return [speed, turning, pulled, turned]

    by_hand = solve_ivp(rates, (1, 1.3), [0.0] * 4, method="DOP853", rtol=1e-12, atol=1e-14)
    found = outputs(_LIFTED, engine)
    assert [found["x"], found["angle"]] == pytest.approx(list(by_hand.y[:2, -1]), rel=1e-8)
    # Forces end a mode outside a band of 1e-12 of the load, here of about 1e-11.
    assert [found["lift"], found["slip"]] == pytest.approx([1, 1], abs=1e-11)


@pytest.mark.parametrize("friction", ["0.309", "0.31"])
def test_a_stick_between_walls_falls_with_a_warning_that_it_might_jam(
    engine: str, friction: str
) -> None:
    # Above tan(0.3) forces along the stick, of any size, would hold it. Nothing has pressed it in.
    text = _WEDGED.replace("MU", friction)
    result = statechart.run(interpret(read_text(text, "scene.yaml")), engine=engine)
    assert [*result.outputs.values()] == pytest.approx([-5.0, 0.3], abs=1e-12)
    reported = any("l:pin r:pin, l:free r:free" in warning for warning in result.warnings)
    assert reported == (float(friction) > math.tan(0.3))


def test_a_gripper_whose_force_fades_loses_its_part(engine: str) -> None:
    # Friction of both jaws is 20 - 10t: less than the weight from t = 1, none from t = 2.
    found = outputs(_GRIPPED, engine)
    expected = [-10 / 6 - 10, 1, 2]
    assert [found["y"], found["slip"], found["off"]] == pytest.approx(expected, abs=1e-11)


def test_a_rod_on_two_rollers_swings_by_friction(engine: str) -> None:
    # The rollers turn towards each other; the rod swings by x'' = -mu g x / a (Timoshenko).
    found = outputs(_ROLLERS, engine)
    assert found["x"] == pytest.approx(0.1 * math.cos(3 * math.sqrt(0.2 * 10 / 0.5)), abs=1e-9)
    assert found["changes"] == 0


def test_a_ball_that_leaves_a_loop_lands_where_it_meets_the_floor(engine: str) -> None:
    """v^2 = 3.5 g R: it lets go at 120 degrees and comes down at the lowest point."""
    for shift, x0, y0 in ((0.0, 0.0, 0.0), (1e-9, 1.3, -2.7), (-1e-9, 100.0, 3000.0)):
        join = x0 + shift
        scene = f"""
kind: scene
name: line_loop
gravity: 9.81
bodies: {{b: {{mass: 2, start: {{x: {x0 - 2!r}, y: {y0 - 1!r}, dx: sqrt(3.5*9.81)}}}}}}
surfaces:
  loop: {{circle: [{x0!r}, {y0!r}], radius: 1, hollow: true}}
  floor: {{edge: [[{x0 - 5!r}, {y0 - 1!r}], [{join!r}, {y0 - 1!r}]]}}
contacts:
  l: {{point: {{body: b}}, surface: loop, friction: 0, restitution: 0,
      enabled: "b.x >= {join!r} or b.y > {y0 - 0.9!r}"}}
  f: {{point: {{body: b}}, surface: floor, friction: 0, restitution: 0}}
stop: {{time: 1.8}}
outputs: {{off: {{value: time, at: first l.liftoff}}, y: {{value: b.y}}}}
"""
        result = statechart.run(interpret(read_text(scene, "scene.yaml")), engine=engine)
        assert result.trace.jumps[-1].t == pytest.approx(
            result.outputs["off"] + math.sqrt(6 / 9.81), abs=2e-9
        )
        assert result.trace.jumps[-1].cause == "touchdown"
        assert result.outputs["y"] == pytest.approx(y0 - 1.0, abs=1e-9)


@pytest.mark.parametrize(
    ("relation", "causes"),
    [
        ("sqrt(abs(b.x)) <= 0", []),
        ("sqrt(abs(b.x)) > 0", ["touchdown"]),
        ("sqrt(abs(b.x - 0.3)) <= 0.1", ["enable", "disable"]),
    ],
)
def test_root_condition_equals_its_square(engine: str, relation: str, causes: list[str]) -> None:
    scene = f"""
kind: scene
name: root
gravity: 9.81
bodies: {{b: {{mass: 1, start: {{x: 0, y: 1, dx: 1}}}}}}
surfaces: {{f: {{height: 0}}}}
contacts:
  c: {{point: {{body: b}}, surface: f, friction: 0, restitution: 0, enabled: "{relation}"}}
stop: {{time: 0.5}}
"""
    jumps = statechart.run(interpret(read_text(scene, "scene.yaml")), engine=engine).trace.jumps
    assert [jump.cause for jump in jumps] == causes
    assert [jump.t for jump in jumps if jump.cause != "touchdown"] == pytest.approx(
        [0.29, 0.31] if "disable" in causes else []
    )
