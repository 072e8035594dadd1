"""The unit of mass changes no motion, from 1e-280 to 1e300 kg."""

from __future__ import annotations

import pytest

from statechart import run
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

_SLIDES = """
kind: scene
name: slides
gravity: 9.81
parameters: {m: 1}
bodies: {b: {mass: m, start: {dx: 2}}}
surfaces: {s: {height: 0}}
contacts: {c: {point: {body: b}, surface: s, friction: 0.5, restitution: 0.5}}
stop: {time: 0.6}
outputs:
  load: {maximum: c.V/m}
  drag: {minimum: c.H/m}
  left: {value: energy/m}
"""
_LIFTS_OFF = """
kind: scene
name: lifts_off
gravity: 9.81
parameters: {m: 1}
bodies: {b: {mass: m, start: {x: -1, y: 0.5, dx: 4}}}
surfaces: {s: {height: 0.3*cos(2*x)}}
contacts: {c: {point: {body: b}, surface: s, friction: 0.1, restitution: 0}}
stop: {time: 1}
"""
_SHARES_ITS_LOAD = """
kind: scene
name: shares
gravity: 9.81
parameters: {m: 1}
bodies: {b: {mass: m, inertia: 0.1*m, start: {y: 0.11, dx: 1, angle: 0.02}}}
surfaces: {s: {height: 0}}
contacts:
  c: {point: {body: b, at: [0.3, -0.1]}, surface: s, friction: 0.5, restitution: 0}
  d: {point: {body: b, at: [-0.3, -0.1]}, surface: s, friction: 0.5, restitution: 0}
stop: {time: 0.5}
"""
_TWO_BODIES = """
kind: scene
name: two
gravity: 9.81
parameters: {m: 1, k: 20*m}
bodies:
  a: {mass: m, inertia: 0.02*m, start: {y: 0.1, dx: 3}}
  b: {mass: 0.5*m, start: {y: 0.5}}
forces: {spring: {body: b, force: [-k*b.x, 0]}}
surfaces: {s: {height: 0}, top: {height: 0.1, body: a}}
contacts:
  c: {point: {body: a, at: [0, -0.1]}, surface: s, friction: 0.5, restitution: 0}
  e: {point: {body: b}, surface: top, friction: 0.4, restitution: 0.2}
stop: {time: 1}
"""
_JOINED = """
kind: scene
name: joined
gravity: 9.81
parameters: {m: 1}
bodies:
  a: {mass: m, inertia: 0.02*m, start: {y: -1}}
  b: {mass: m, inertia: 0.02*m, start: {y: -1, x: 1}}
joints:
  h: {point: {body: a, at: [0, 1]}, to: [0, 0]}
  k: {point: {body: a}, to: {body: b, at: [-1, 0]}}
surfaces: {s: {height: -1.5}}
contacts: {c: {point: {body: b}, surface: s, friction: 0.3, restitution: 0}}
stop: {time: 1}
outputs: {pull: {maximum: h.Y/m}}
"""
_SCENES = {
    "slides": _SLIDES,
    "lifts off": _LIFTS_OFF,
    "shares its load": _SHARES_ITS_LOAD,
    "two bodies": _TWO_BODIES,
    "joined": _JOINED,
}
_SETTINGS = {
    "taylor": {"engine": "taylor"},
    "scipy": {"engine": "scipy"},
    "steps": {"engine": "impulse", "step": 1e-3},
}


def _events(trace: Trace) -> list[tuple[str, str, tuple[str, ...]]]:
    return [(jump.region, jump.cause, jump.target) for jump in trace.jumps]


@pytest.mark.parametrize("how", _SETTINGS)
@pytest.mark.parametrize("scene", _SCENES)
def test_scaling_masses_keeps_the_motion(scene: str, how: str) -> None:
    settings = _SETTINGS[how]
    one = run(interpret(read_text(_SCENES[scene])), **settings)  # type: ignore[arg-type]
    joined = how == "steps" and scene == "joined"
    for mass in ("1e160", "1e300") if joined else ("1e-279", "1e160", "1e300"):
        text = _SCENES[scene].replace("m: 1", f"m: {mass}", 1)
        other = run(interpret(read_text(text)), **settings)  # type: ignore[arg-type]
        assert _events(other.trace) == _events(one.trace)
        assert len(one.trace.jumps) > 0
        assert [j.t for j in other.trace.jumps] == pytest.approx([j.t for j in one.trace.jumps])
        # Sums of bounces, and the remaining slip, are known to a tolerance.
        assert other.trace.final == pytest.approx(one.trace.final, rel=1e-9, abs=1e-9)
        assert dict(other.outputs) == pytest.approx(dict(one.outputs), rel=1e-9, abs=1e-9)


def test_a_declared_mass_of_one_overrides_a_large_one() -> None:
    text = _SLIDES.replace("m: 1", "m: 1e160", 1)
    one, other = (
        run(interpret(read_text(_SLIDES))),
        run(interpret(read_text(text)), parameters={"m": 1.0}),
    )
    assert other.trace.final == pytest.approx(one.trace.final, rel=1e-12, abs=1e-12)
