"""Points that slide from one piece of ground onto the next, against uniform deceleration."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

G = 9.81

PATH = f"""
kind: scene
name: path
parameters: {{q: 0, a: 0.7, v: 2, mu: 0.05, nu: 0.3, c: cos(q), s: sin(q)}}
gravity: {G}
bodies: {{p: {{mass: 1, start: {{x: 0.1*c, y: 0.1*s, dx: v*c, dy: v*s}}}}}}
surfaces:
  one: {{edge: [[0, 0], [a*c, a*s]]}}
  two: {{SECOND}}
contacts:
  A: {{point: {{body: p}}, surface: one, friction: mu, restitution: 0}}
  B: {{point: {{body: p}}, surface: two, friction: nu, restitution: 0ENABLED}}
modes: {{B: off}}
stop: {{time: 0.5}}
outputs:
  along: {{value: p.x*c + p.y*s}}
  above: {{value: p.y*c - p.x*s}}
  met: {{value: time, at: first B.enable}}
"""
EDGE = "edge: [[a*c, a*s], [3*c, 3*s]]"
LINE = "line: [[0, 0], [c, s]]"


@pytest.mark.parametrize(("engine", "error"), [("taylor", 1e-13), ("scipy", 1e-11)])
@pytest.mark.parametrize(
    ("second", "enabled"),
    [
        (EDGE, ""),
        (LINE, ", enabled: p.x*c + p.y*s > a"),
        (LINE, ", enabled: [abs(p.x*c + p.y*s - 2) < 2 - a, time < 9]"),
    ],
)
def test_a_block_slides_from_a_plate_onto_the_next(second, enabled, engine, error):
    text = PATH.replace("SECOND", second).replace("ENABLED", enabled)
    model = interpret(read_text(text))
    for q in (0.0, -0.27, 0.13):
        first, then = (G * (math.sin(q) + mu * math.cos(q)) for mu in (0.05, 0.3))
        speed = math.sqrt(4 - 2 * first * 0.6)
        met = (2 - speed) / first
        left = 0.5 - met
        along = 0.7 + speed * left - then * left**2 / 2
        found = statechart.run(model, engine=engine, parameters={"q": q}).outputs
        wanted = [along, 0.0, met]
        assert [found["along"], found["above"], found["met"]] == pytest.approx(wanted, abs=error)


CLOTH = f"""
kind: scene
name: tablecloth
parameters: {{B: 0.4, a: 8, mu: 0.25, nu: 0.5}}
gravity: {G}
bodies: {{mug: {{mass: 0.3}}}}
surfaces:
  table: {{height: 0}}
  cloth: {{edge: [[-2, 0], [B, 0]], displacement: [-a*time**2/2, 0]}}
contacts:
  below: {{point: {{body: mug}}, surface: cloth, friction: mu, restitution: 0}}
  wood: {{point: {{body: mug}}, surface: table, friction: nu, restitution: 0,
    enabled: mug.x > B - a*time**2/2}}
modes: {{wood: off}}
stop: {{time: 1}}
outputs:
  x: {{value: mug.x}}
  y: {{value: mug.y}}
  bare: {{value: time, at: first wood.enable}}
  rest: {{value: time, at: first wood.stick}}
"""


@pytest.mark.parametrize(
    ("engine", "step", "error"),
    [("taylor", None, 1e-12), ("scipy", None, 1e-10), ("impulse", 1e-3, 2e-3)],
)
def test_a_mug_stays_on_the_table_from_under_which_its_cloth_is_drawn(engine, step, error):
    bare = math.sqrt(0.8 / (8 - 0.25 * G))
    speed = 0.25 * G * bare
    wanted = [-speed * bare / 2 - speed**2 / G, 0, bare, bare + speed / (0.5 * G)]
    found = statechart.run(interpret(read_text(CLOTH)), engine=engine, step=step).outputs
    assert list(found.values()) == pytest.approx(wanted, abs=error)


FEET = "\n".join(
    f"  {foot}{side}: {{point: {{body: sled, at: [{x}, 0]}}, surface: {side}, friction: 0.1, "
    "restitution: 0}"
    for foot, x in (("rear", -0.8), ("middle", 0), ("front", 0.8))
    for side in ("near", "far")
)
SLED = f"""
kind: scene
name: sled
parameters: {{q: 0, o: 0, c: cos(q), s: sin(q)}}
gravity: [{G}*s, -{G}*c]
bodies: {{sled: {{mass: 1, inertia: 0.3,
  start: {{x: -c - o*s, y: o*c - s, angle: q, dx: 4*c, dy: 4*s}}}}}}
surfaces:
  near: {{edge: [[-3*c - o*s, o*c - 3*s], [-o*s, o*c]]}}
  far: {{edge: [[0.5*c - o*s, 0.5*s + o*c], [9*c - o*s, 9*s + o*c]]}}
contacts:
{FEET}
stop: {{time: 0.6}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_sled_slides_over_a_ditch_on_two_of_its_feet(engine):
    model = interpret(read_text(SLED))
    along = -1 + 4 * 0.6 - 0.1 * G * 0.6**2 / 2
    for q, o in ((0.0, 0.0), (-0.21, -2.9)):
        final = statechart.run(model, engine=engine, parameters={"q": q, "o": o}).trace.final
        place = along * np.array([math.cos(q), math.sin(q)])
        place += o * np.array([-math.sin(q), math.cos(q)])
        assert final[:3] == pytest.approx([*place, q], abs=1e-11)


ENGINES = [("taylor", None, 1e-10), ("scipy", None, 1e-9), ("impulse", 1e-3, 3e-3)]

BELTS = f"""
kind: scene
name: belts
parameters: {{u: 0.5, v: 1.5, mu: 0.4}}
gravity: {G}
bodies: {{p: {{mass: 2, start: {{x: -1, dx: u}}}}}}
surfaces:
  slow: {{height: 0, displacement: [u*time, 0]}}
  fast: {{height: 0, displacement: [v*time, 0]}}
  table: {{height: 0}}
contacts:
  A: {{point: {{body: p}}, surface: slow, friction: mu, restitution: 0, enabled: p.x <= 0}}
  B: {{point: {{body: p}}, surface: fast, friction: mu, restitution: 0,
    enabled: [p.x >= 0, p.x <= 1]}}
  C: {{point: {{body: p}}, surface: table, friction: mu, restitution: 0, enabled: p.x >= 1}}
stop: {{time: 4}}
outputs:
  x: {{value: p.x}}
  y: {{value: p.y}}
  rides: {{value: time, at: first B.stick}}
  off: {{value: time, at: first C.enable}}
  rests: {{value: time, at: first C.stick}}
"""


@pytest.mark.parametrize(("engine", "step", "error"), ENGINES)
def test_a_parcel_rides_from_belt_to_belt_and_off_it(engine, step, error):
    rides = 2 + 1 / (0.4 * G)
    off = rides + (1 - (1.5**2 - 0.5**2) / (0.8 * G)) / 1.5
    wanted = [1 + 1.5**2 / (0.8 * G), 0, rides, off, off + 1.5 / (0.4 * G)]
    found = statechart.run(interpret(read_text(BELTS)), engine=engine, step=step).outputs
    assert list(found.values()) == pytest.approx(wanted, abs=error)


TRAY = f"""
kind: scene
name: tray
parameters: {{w: 0.1, mu: 0.2, nu: 0.1}}
gravity: {G}
bodies: {{mug: {{mass: 2, start: {{x: -0.3}}}}}}
surfaces:
  left: {{edge: [[-1, 0], [0, 0]], turn: -w*time}}
  right: {{edge: [[0, 0], [3, 0]], turn: -w*time}}
contacts:
  A: {{point: {{body: mug}}, surface: left, friction: mu, restitution: 0}}
  B: {{point: {{body: mug}}, surface: right, friction: nu, restitution: 0}}
stop: {{time: 4}}
outputs:
  along: {{value: mug.x*cos(w*time) - mug.y*sin(w*time)}}
  above: {{value: mug.y*cos(w*time) + mug.x*sin(w*time)}}
  slips: {{value: time, at: first A.slip}}
  over: {{value: time, at: first B.enable}}
"""


@pytest.mark.parametrize(("engine", "step", "error"), ENGINES)
def test_a_mug_slides_over_the_joint_of_a_tray_that_is_tilted(engine, step, error):
    w = 0.1

    def pull(time, place, speed, friction):
        press = G * math.cos(w * time) - 2 * w * speed
        return G * math.sin(w * time) + place * w**2 - friction * press

    def slide(friction, begin, state, **settings):
        def rates(time, s):
            return s[1], pull(time, *s, friction)

        return solve_ivp(rates, (begin, 4), state, rtol=1e-11, atol=1e-13, **settings)

    def crossing(_, s):
        return s[0]

    crossing.terminal = True
    slips = brentq(lambda time: pull(time, -0.3, 0, 0.2), 0, 4)
    first = slide(0.2, slips, [-0.3, 0], events=crossing)
    then = slide(0.1, first.t[-1], [0, first.y[1, -1]])
    found = statechart.run(interpret(read_text(TRAY)), engine=engine, step=step).outputs
    wanted = [then.y[0, -1], 0, slips, first.t[-1]]
    assert list(found.values()) == pytest.approx(wanted, abs=error)


@pytest.mark.parametrize("step", [4e-3, 1e-3])
def test_a_box_that_landed_deep_slides_over_seams_at_that_depth(step):
    text = PATH.replace("SECOND", EDGE).replace("ENABLED", "").replace("modes: {B: off}", "")
    text = text.replace("y: 0.1*s,", "y: 0.5,").replace("mu: 0.05, nu: 0.3", "mu: 0, nu: 0")
    text = text.replace("friction: mu", "friction: mu, modes: [free, slide]").replace(
        "friction: nu", "friction: nu, modes: [free, slide]"
    )
    result = statechart.run(
        interpret(read_text(text)), engine="impulse", step=step, until=0.7, parameters={"a": 0.9}
    )
    assert result.outputs["along"] == pytest.approx(0.1 + 2 * 0.7, abs=1e-9)
    assert abs(result.outputs["above"]) < step * math.sqrt(2 * G * 0.5)
