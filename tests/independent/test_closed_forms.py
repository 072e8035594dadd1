"""A tautochrone, a loop, an orbit and bounces along a floor, against their closed forms."""

from __future__ import annotations

import math
from typing import Any

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])

_CYCLOID = """
kind: scene
name: cycloid
gravity: 10
parameters: {r: 0.4}
coordinates: {s: {start: 2.5}}
bodies: {bead: {mass: 1, position: [r*(s + sin(s)), r*(1 - cos(s))]}}
surfaces: {wall: {line: [[0, 2], [0, -2]]}}
contacts: {c: {point: {body: bead}, surface: wall, friction: 0.3, restitution: 0.5}}
stop: {time: 4}
outputs: {t: {value: time, at: each c.touchdown}}
"""
_LOOP = """
kind: scene
name: loop
gravity: 10
bodies: {b: {mass: 1, start: {y: -1, dx: sqrt(35)}}}
surfaces: {ring: {circle: [0, 0], radius: 1, hollow: true}}
contacts:
  c: {point: {body: b}, surface: ring, modes: [free, slide], friction: 0, restitution: 0}
stop: {time: 1}
outputs: {x: {value: b.x, at: first c.liftoff}, y: {value: b.y, at: first c.liftoff}}
"""
_ORBIT = """
kind: scene
name: orbit
bodies: {b: {mass: 1, start: {x: 2, dy: 0.3}}}
surfaces: {planet: {circle: [0, 0], radius: 0.5}}
forces:
  f: {body: b, force: [-b.x/(b.x**2 + b.y**2)**1.5, -b.y/(b.x**2 + b.y**2)**1.5]}
contacts:
  c: {point: {body: b}, surface: planet, modes: [free, slide], friction: 0, restitution: 1}
stop: {time: 20}
outputs:
  t: {value: time, at: each c.touchdown}
  fall: {value: (b.x*b.dx + b.y*b.dy)/0.5, at: first c.touchdown, before: true}
"""
_ALONG = """
kind: scene
name: along
gravity: 10
bodies: {b: {mass: 1, start: {y: 1.25, dx: 6}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.2, restitution: 0.5}}
stop: {time: 6}
outputs:
  t: {value: time, at: first c.zeno}
  x: {value: b.x, at: first c.zeno}
  dx: {value: b.dx, at: first c.zeno}
  area: {integral: b.y}
  stands: {value: time, at: first c.stick}
  end: {value: b.x}
"""


def outputs(text: str, engine: str) -> Any:
    return statechart.run(interpret(read_text(text, "scene.yaml")), engine=engine).outputs


def test_swings_on_a_cycloid_take_the_same_time_after_each_blow(engine: str) -> None:
    quarter = math.pi * math.sqrt(0.4 / 10)
    assert outputs(_CYCLOID, engine)["t"] == pytest.approx(
        [quarter, 3 * quarter, 5 * quarter], abs=1e-11
    )


def test_a_bead_that_is_too_slow_for_a_loop_leaves_it(engine: str) -> None:
    # v^2 = 35 - 20 (1 - cos) from the lowest point, and it leaves where v^2 = -10 cos.
    cosine = -0.5
    found = outputs(_LOOP, engine)
    assert [found["x"], found["y"]] == pytest.approx([math.sqrt(0.75), -cosine], abs=1e-11)


def test_orbit_reverses_after_a_radial_bounce(engine: str) -> None:
    # By Kepler's equation, from the farthest point at 2 to the radius 0.5.
    major = 1 / (1 - 0.3**2)
    eccentric = 2 / major - 1
    angle = 2 * math.pi - math.acos((1 - 0.5 / major) / eccentric)
    t = major**1.5 * (angle - eccentric * math.sin(angle) - math.pi)
    found = outputs(_ORBIT, engine)
    assert found["t"] == pytest.approx([t, 3 * t, 5 * t], abs=1e-9)
    radial = math.sqrt(2 / 0.5 - 1 / major - (2 * 0.3 / 0.5) ** 2)
    assert found["fall"] == pytest.approx(-radial, abs=1e-10)


def test_bounces_along_a_rough_floor_sum_to_a_slide(engine: str) -> None:
    # From 1.25 it strikes at 5; each blow takes mu (1 + e) of its speed from that along.
    g, e, mu, t, x, dx, speed = 10.0, 0.5, 0.2, 0.5, 3.0, 6.0, 5.0
    area = 1.25 * t - g * t**3 / 6
    while speed > 1e-17:
        dx, speed = dx - mu * (1 + e) * speed, e * speed
        took = 2 * speed / g
        t, x, area = t + took, x + dx * took, area + speed * took**2 / 2 - g * took**3 / 6
    found = outputs(_ALONG, engine)
    wanted = [t, x, dx, area, t + dx / (mu * g), x + dx**2 / (2 * mu * g)]
    assert [*found.values()] == pytest.approx(wanted, abs=1e-12)
