"""Contacts that come to rest where rest takes just the force that friction gives, by hand."""

from __future__ import annotations

from collections.abc import Callable
from math import pi, sin, sqrt
from typing import Any

import pytest

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])

_BEGIN = """
kind: scene
name: sprung
parameters: {m: 2, k: 100, mu: 0.3, g: 10, f: mu*m*g, w: sqrt(k/m)}
gravity: g
surfaces: {floor: {height: 0}}
outputs: {x: {value: b.x}, H: {value: c.H}, reversals: {count: c.reverse}, slips: {count: c.slip}}
"""
# Each swing ends 2 f/k nearer to the middle; the last where the spring pulls by f.
_SPRUNG = """
bodies: {b: {mass: m, start: {x: 3*f/k}}}
contacts: {c: {point: {body: b}, surface: floor, friction: mu, restitution: 0}}
forces: {spring: {body: b, force: ["-k*b.x", 0]}}
stop: {time: 4*pi/w}
"""
_FEET = """
bodies: {b: {mass: m, inertia: 0.1, start: {x: 3*f/k, y: 0.1}}}
contacts:
  c: {point: {body: b, at: [-0.3, -0.1]}, surface: floor, friction: mu, restitution: 0}
  d: {point: {body: b, at: [0.3, -0.1]}, surface: floor, friction: mu, restitution: 0}
forces: {spring: {body: b, force: ["-k*b.x", 0]}}
stop: {time: 4*pi/w}
"""
# It swings in the air by half a period, and lands where it turns.
_LANDED = """
bodies: {b: {mass: m, start: {x: f/k, y: g*(pi/w)**2/2}}}
contacts: {c: {point: {body: b}, surface: floor, friction: mu, restitution: 0}}
forces: {spring: {body: b, force: ["-k*b.x", 0]}}
stop: {time: 4*pi/w}
"""
# The slip ends at T, where the spring pulls by f and the push passes through zero.
_PUSHED = """
bodies:
  b:
    mass: m
    start:
      x: f/k - 2*f/k*cos(w*T) + a/(k*w)*sin(w*T) - a*T/k
      dx: -2*f*w/k*sin(w*T) - a/k*cos(w*T) + a/k
contacts: {c: {point: {body: b}, surface: floor, friction: mu, restitution: 0}}
forces: {spring: {body: b, force: ["-k*b.x + a*(time - T)", 0]}}
stop: {time: 1}
"""
TOLERANCES = (1e-4, 1e-8, 1e-11, 1e-14)
W, REST = sqrt(50.0), -0.06


def ran(text: str, engine: str, tolerance: float, stiffness: float = 100.0) -> Any:
    begin = _BEGIN.replace("k: 100", f"k: {stiffness}")
    scene = interpret(read_text(begin + text, "scene.yaml"))
    return statechart.run(scene, engine=engine, tolerance=tolerance)


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("stiffness", [100.0, 1e6])
@pytest.mark.parametrize("text", [_SPRUNG, _FEET, _LANDED], ids=["sprung", "feet", "landed"])
def test_a_block_that_stops_at_the_friction_limit_sticks(
    text: str, stiffness: float, engine: str, tolerance: float
) -> None:
    result = ran(text, engine, tolerance, stiffness)
    found = result.outputs
    assert (found["reversals"], found["slips"]) == (0, 0)
    assert found["x"] == pytest.approx(-6.0 / stiffness, rel=20.0 * max(tolerance, 1e-13))
    assert len(result.trace.jumps) == 1
    reported = [warning for warning in result.trace.warnings if "might slip on" in warning]
    assert len(reported) == len(result.trace.regions)


# Its weight and friction cancel; drag of 20 m v stops it after v/20 = 0.05, in infinite time.
_CREEPS = """
kind: scene
name: creeps
parameters: {slope: 0.3}
gravity: 10
surfaces: {floor: {incline: -slope}}
bodies:
  b: {mass: 1, start: {dx: cos(slope), dy: -sin(slope)}}
  load: {mass: 1, start: {y: 1}}
contacts: {c: {point: {body: b}, surface: floor, friction: tan(slope), restitution: 0}}
joints: {rail: {point: {body: load}, to: {y: 1}}}
forces:
  drag: {body: b, force: ["-20*b.dx", "-20*b.dy"]}
  pull: {body: load, force: ["sat(2*sin(5*time), -1, 1) + b.x", 0]}
outputs: {x: {value: b.x/cos(slope)}}
stop: {time: 3}
"""


def test_a_block_whose_slip_fades_at_the_friction_limit_sticks_where_forces_have_kinks(
    engine: str,
) -> None:
    result = statechart.run(interpret(read_text(_CREEPS)), engine=engine)
    assert result.outputs["x"] == pytest.approx(0.05, abs=1e-12)
    ((kink, cause),) = [(jump.t, jump.cause) for jump in result.trace.jumps]
    assert cause == "stick"
    assert abs(sin(5 * kink)) == pytest.approx(0.5, abs=1e-9)
    (warning,) = result.warnings
    assert warning.startswith("c comes to rest with its friction at the bound")


def _on(t: float) -> float:
    """Return where it is that slips on from the middle between a spring and friction."""
    return REST + 0.3 * (t - sin(W * t) / W)


def _back(t: float) -> float:
    """Return where it is that sticks until it is pushed the other way."""
    return REST - (0.3 * (t - sin(W * t) / W) if t > 0.0 else 0.0)


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize(
    ("push", "at", "slips", "ends"),
    [(30.0, 0.2, 0.0, _on), (-30.0, 0.4, 0.4, _back)],
    ids=["on", "back"],
)
def test_a_block_at_the_friction_limit_slips_if_pushed_further(
    push: float,
    at: float,
    slips: float,
    ends: Callable[[float], float],
    engine: str,
    tolerance: float,
) -> None:
    text = _PUSHED.replace("a*", f"({push})*").replace("a/", f"({push})/").replace("T", str(at))
    result = ran(text, engine, tolerance)
    allowed = 20.0 * max(tolerance, 1e-13)
    assert [jump.cause for jump in result.trace.jumps] == ["stick", "slip"]
    assert result.trace.jumps[0].t == pytest.approx(at, abs=allowed)
    assert result.trace.jumps[1].t == pytest.approx(at + slips, abs=allowed)
    assert result.outputs["x"] == pytest.approx(ends(1.0 - at - slips), abs=allowed)


@pytest.mark.parametrize("beyond", [1e-3, 1e-6, 1e-9])
def test_a_force_clearly_beyond_the_friction_limit_reverses_the_slip(
    beyond: float, engine: str
) -> None:
    text = _SPRUNG.replace("3*f/k", f"(3 + {beyond})*f/k").replace("4*pi/w", "1.9*pi/w")
    result = ran(text, engine, 1e-12)
    assert [jump.cause for jump in result.trace.jumps] == ["reverse"]
    assert not result.trace.warnings


@pytest.mark.parametrize("short", [1e-3, 1e-6, 1e-9])
def test_a_force_clearly_below_the_friction_limit_sticks_without_a_warning(
    short: float, engine: str
) -> None:
    result = ran(_SPRUNG.replace("3*f/k", f"(3 - {short})*f/k"), engine, 1e-12)
    assert [jump.cause for jump in result.trace.jumps] == ["stick"]
    assert not result.trace.warnings


@pytest.mark.parametrize("tolerance", [1e-6, 1e-12])
def test_a_block_at_the_friction_limit_stays_while_others_jump(
    engine: str, tolerance: float
) -> None:
    text = (
        _SPRUNG
        + """
regions:
  clock:
    initial: tick
    states: {tick: {}, tock: {}}
    transitions:
      - {name: up, from: tick, to: tock, after: 0.1}
      - {name: down, from: tock, to: tick, after: 0.1}
"""
    )
    result = ran(text, engine, tolerance)
    assert (result.outputs["reversals"], result.outputs["slips"]) == (0, 0)
    assert [jump.t for jump in result.trace.jumps if jump.region == "c"] == pytest.approx([pi / W])
    assert len(result.trace.jumps) > 10


def test_half_a_swing_takes_half_a_period(engine: str) -> None:
    result = ran(_SPRUNG, engine, 1e-12)
    assert result.trace.jumps[0].t == pytest.approx(pi / W, abs=1e-11)
