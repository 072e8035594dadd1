"""Scales of a scene: a shift of its origin, other units and a start moved by a rounding."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from runs import ENGINES, engine
from scenes import scene

from contacts.dynamics.setup import SceneSetup
from statechart.automaton.trace import Trace
from statechart.execution.simulator import Simulator

PAD = """
kind: scene
name: pad
parameters: {W: 11, p: 0, A: 0.05, y0: 0}
gravity: 9.81
coordinates: {q: {start: y0 + A*sin(p)**2, rate: A*W*sin(2*p)}}
bodies: {b: {mass: 1, position: [0, q]}}
surfaces: {pad: {height: y0, displacement: [0, "A*sin(W*time + p)**2"]}}
contacts:
  c: {point: {body: b}, surface: pad, modes: [free, slide], friction: 0, restitution: 0}
stop: {time: 0.5}
"""
# The numbers L, M and T are the units of length, mass and time, in others; x0 and y0 the shift.
DROP = """
kind: scene
name: drop
parameters: {L: 1, M: 1, T: 1, x0: 0, y0: 0, h: 1, e: 0.5}
gravity: 9.81*L/T**2
bodies: {b: {mass: M, start: {x: x0*L, y: (y0 + h)*L, dx: 0.7*L/T}}}
surfaces: {s: {height: y0*L}}
contacts: {c: {point: {body: b}, surface: s, friction: 0.5, restitution: e}}
stop: {time: T}
"""
DISC = """
kind: scene
name: disc
parameters: {L: 1, M: 1, T: 1, x0: 0, y0: 0, h: 0.24}
gravity: 9.81*L/T**2
bodies:
  disc:
    mass: 2*M
    inertia: 0.067*M*L**2
    start: {x: (x0 - 0.88)*L, y: (y0 + 0.27 + h)*L, dx: 1.4*L/T, dangle: 4.9/T}
surfaces:
  floor: {line: [[(x0 - 1)*L, y0*L], [(x0 + 1)*L, y0*L]]}
  wall: {line: [[(x0 + 0.5)*L, y0*L], [(x0 + 0.1)*L, (y0 + 0.9)*L]]}
contacts:
  low: {point: {body: disc}, radius: 0.27*L, surface: floor, friction: 0.3, restitution: 0.5}
  side: {point: {body: disc}, radius: 0.27*L, surface: wall, friction: 0.5, restitution: 0.4}
stop: {time: 0.9*T}
"""
ROD = """
kind: scene
name: rod
parameters: {L: 1, M: 1, T: 1, x0: 0, y0: 0}
gravity: 9.81*L/T**2
bodies:
  rod: {mass: M, inertia: 0.03*M*L**2, start: {x: x0*L, y: (y0 + 0.4)*L, angle: 0.3, dx: 0.5*L/T}}
surfaces: {floor: {height: y0*L}}
contacts:
  a: {point: {body: rod, at: [-0.3*L, 0]}, surface: floor, friction: 0.3, restitution: 0.3}
  b: {point: {body: rod, at: [0.3*L, 0]}, surface: floor, friction: 0.3, restitution: 0.3}
stop: {time: 0.6*T}
"""
TEXTS = {"drop": DROP, "disc": DISC, "rod": ROD}


@functools.cache
def simulator(text: str, name: str = "taylor") -> Simulator:
    return Simulator(scene(text), engine(name))


def run(text: str, name: str = "taylor", **values: float) -> Trace:
    model = simulator(text, name)
    until = 0.5 if text == PAD else {"drop": 1.0, "disc": 0.9, "rod": 0.6}[model.automaton.name]
    return model.run(values, until=until * values.get("T", 1.0))


def numbers(text: str, **values: float) -> SceneSetup:
    setup = simulator(text).automaton.setup(values, 1e-16)
    assert isinstance(setup, SceneSetup)
    return setup


def story(trace: Trace) -> list[tuple[str, str, tuple[str, ...]]]:
    return [(jump.region, jump.cause, jump.target) for jump in trace.jumps]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("p", [1e-17, 1e-12, 1e-9, 1e-6, 1e-3])
def test_prescribed_motion_sets_the_length_scale(name: str, p: float) -> None:
    still, moved = (run(PAD, name, p=value) for value in (0.0, p))
    assert [jump.cause for jump in moved.jumps] == ["liftoff", "touchdown", "liftoff"]
    assert moved.outcome.name == "HORIZON"
    # The pad is p / W ahead.
    for before, after in zip(still.jumps, moved.jumps, strict=True):
        assert after.t == pytest.approx(before.t - p / 11.0, abs=1e-11)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("h", [1e-17, -1e-17, 1e-16])
def test_block_above_its_floor_by_round_off_rests(h: float, unit: float) -> None:
    trace = run(DROP, h=h, L=unit)
    assert trace.start_mode == ("slide+",)
    assert story(trace) == [("c", "stick", ("pin",))]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("until", [1e8, 1e12])
def test_a_late_end_hides_no_fall_and_no_slip(name: str, until: float) -> None:
    text = DROP.replace("dx: 0.7*L/T", "dx: v").replace("h: 1,", "h: 1, v: 0,")
    model = simulator(text, name)
    fallen = model.run({"e": 0.0}, until=until).jumps
    assert [jump.t for jump in fallen] == pytest.approx([math.sqrt(2 / 9.81)], abs=1e-12)
    slid = model.run({"h": 0.0, "v": 2.0}, until=until)
    assert [jump.cause for jump in slid.jumps] == ["stick"]
    assert slid.jumps[0].t == pytest.approx(2.0 / (0.5 * 9.81), abs=1e-12)
    assert slid.final[0] == pytest.approx(2.0**2 / 9.81, abs=1e-12)


def test_round_off_far_from_the_origin_is_no_bounce() -> None:
    near, far = run(DROP), run(DROP, y0=5e6)
    assert [jump.cause for jump in far.jumps] == [jump.cause for jump in near.jumps]
    assert far.final[1] - 5e6 == pytest.approx(near.final[1], abs=1e-8)
    assert far.final[3] == pytest.approx(near.final[3], abs=1e-7)
    assert any("put the origin nearer" in warning for warning in far.warnings)
    assert not near.warnings


@pytest.mark.parametrize(("e", "warned"), [(0.5, True), (0, False)])
def test_bounces_of_two_contacts_far_from_the_origin_warn_of_their_order(e, warned) -> None:
    second = f"d: {{point: {{body: b, at: [1, 0]}}, surface: s, friction: 0.5, restitution: {e}}}"
    bar = DROP.replace("restitution: e}", f"restitution: {e}}}, {second}")
    bar = bar.replace("{mass: M", "{mass: M, inertia: 0.1*M*L**2")
    near, far = run(bar, y0=10).warnings, run(bar, y0=1e4).warnings
    assert not any("put the origin nearer" in warning for warning in near)
    reported = any("put the origin nearer" in warning for warning in far)
    assert reported == warned


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("mass", [1e-150, 1e155, 1e160, 4e299])
@pytest.mark.parametrize("meaning", ["newton", "poisson", "stronge"])
def test_extreme_masses_rebound(name: str, mass: float, meaning: str) -> None:
    text = DISC.replace("restitution: 0.5", f"restitution: 0.5, impact: {meaning}")
    light, heavy = run(text, name), run(text, name, M=mass)
    assert story(heavy) == story(light)
    assert heavy.final == pytest.approx(light.final, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_scales_do_not_depend_on_the_origin(text: str) -> None:
    here, there = numbers(text).scales, numbers(text, x0=1e6, y0=-1e6).scales
    for quantity in ("length", "speed", "acceleration", "force", "sizes"):
        assert getattr(there, quantity) == pytest.approx(getattr(here, quantity), rel=1e-9)
    assert 1e6 * np.spacing(1.0) < there.rounding < 1e-8


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("shift", [2.0, -7.0, 100.0])
def test_motion_does_not_depend_on_the_origin(text: str, shift: float) -> None:
    here, there = run(text), run(text, x0=shift, y0=-shift)
    moved = np.zeros(len(here.final))
    moved[:2] = shift, -shift
    # The larger coordinates are, the earlier bounces are summed, and the less exactly where
    # friction stops a slip amid them.
    close = 1e-7 * abs(shift) if text == ROD else 1e-9
    assert there.final - moved == pytest.approx(here.final, rel=close, abs=close)
    # The number of summed bounces may differ, but not the end of the sequence.
    ends = [[jump.t for jump in trace.jumps if jump.cause == "zeno"] for trace in (here, there)]
    assert ends[1] == pytest.approx(ends[0], rel=close)


def test_springs_give_the_length_in_every_unit_of_time() -> None:
    # The period of the spring counts, whatever the end: dx/k^(1/2).
    text = """
kind: scene
name: spring
parameters: {T: 1}
bodies: {b: {mass: 1, start: {dx: 0.7/T}}}
surfaces: {s: {height: 0}}
contacts: {c: {point: {body: b}, surface: s, friction: 0, restitution: 0}}
forces: {spring: {body: b, force: [-4*b.x/T**2, 0]}}
stop: {time: 8*T}
"""
    for unit in (1e-9, 1.0, 1e9):
        assert numbers(text, T=unit).scales.length == pytest.approx(0.7 / 2.0, rel=1e-12)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("unit", [{"L": 1e6}, {"L": 1e-6}, {"M": 1e6}, {"M": 1e-6}, {"T": 1e6}])
def test_events_do_not_depend_on_units(text: str, unit: dict[str, float]) -> None:
    here, there = run(text), run(text, **unit)
    assert story(there) == story(here)
    n = len(here.final) // 2
    lengths = np.where(np.arange(n) == 2, 1.0, unit.get("L", 1.0))
    scale = np.concatenate([lengths, lengths / unit.get("T", 1.0)])
    assert there.final / scale == pytest.approx(here.final, rel=1e-9, abs=1e-9)


def test_prescribed_motions_count_by_their_range_over_the_run() -> None:
    belt = DROP.replace("height: y0*L", "height: y0*L, displacement: [v*time, 0]").replace(
        "e: 0.5}", "e: 0.5, v: 2, end: 1}"
    )
    belt = belt.replace("stop: {time: T}", "stop: {time: end}")
    scales = numbers(belt).scales
    assert scales.length == pytest.approx(1.0)
    # The range of a belt that runs for days is at most its braking distance.
    assert numbers(belt, end=1e6).scales.length == pytest.approx(1.0)
    assert numbers(belt, v=20.0, end=1e6).scales.length == pytest.approx(400.0 / 9.81)
    # A pad that shakes fast goes no farther than its range.
    pad = numbers(PAD, W=1e4).scales
    assert 0.05 <= pad.length < 0.06
    assert pad.speed >= 0.05 * 1e4
    assert math.isfinite(numbers(PAD.replace("sin(W*time", "tan(W*time")).scales.length)
