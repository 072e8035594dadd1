"""Bodies with shapes by steps have the events of their corners with events."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import quad, solve_ivp

from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

STEP = 1e-3
TRIANGLE = [(0.2, 0.02), (-0.12, 0.15), (-0.1, -0.16)]
SQUARE = [(-0.168, -0.138), (0.168, -0.138), (0.168, 0.138), (-0.168, 0.138)]
FLAT = [(-0.25, -0.08), (0.25, -0.08), (0.25, 0.08), (-0.25, 0.08)]

# Corners, friction, slope, angle, and velocities at the start.
THROWS = {
    "square rocks": (SQUARE, 0.95, 0.187, 2.059, (1.259, -0.208, -2.917)),
    "square slides": (SQUARE, 0.15, 0.1, 0.4, (-1.0, 0.0, 2.0)),
    "flat turns back": (FLAT, 0.5, -0.1, 0.3, (0.8, -0.5, -3.0)),
    "flat without friction": (FLAT, 0.0, 0.05, -0.5, (0.3, 0.0, 3.5)),
    "triangle": (TRIANGLE, 0.3, 0.05, 0.7, (0.6, 0.2, -2.0)),
    "rough triangle": (TRIANGLE, 1.1, -0.15, -1.1, (-0.9, 0.1, 3.0)),
}


def text(name: str, shapes: bool) -> str:
    """Return a scene of a body that is thrown, with a shape or with points at its corners."""
    corners, mu, slope, angle, (dx, dy, dangle) = THROWS[name]
    polygon = ", ".join(f"[{x}, {y}]" for x, y in corners)
    modes = "" if mu > 0.0 else ", modes: [free, slide]"
    law = f"surface: floor, friction: {mu}, restitution: 0, impact: moreau{modes}"
    points = "\n".join(
        f"  c{i}: {{point: {{body: b, at: [{x}, {y}]}}, {law}}}" for i, (x, y) in enumerate(corners)
    )
    touched = f"  all: {{bodies: [b], surfaces: [floor], friction: {mu}, restitution: 0}}"
    return f"""
kind: scene
name: thrown
gravity: 9.81
bodies:
  b: {{mass: 2, inertia: 0.04, start: {{y: 0.6, angle: {angle}, dx: {dx}, dy: {dy},
    dangle: {dangle}}}{f", shape: {{polygon: [{polygon}]}}" if shapes else ""}}}
surfaces: {{floor: {{line: [[-6, {-6 * slope}], [6, {6 * slope}]]}}}}
{"collisions" if shapes else "contacts"}:
{touched if shapes else points}
stop: {{time: 0.6}}
settings: {{{f"engine: impulse, step: {STEP}" if shapes else "engine: taylor"}}}
"""


def events(name: str, shapes: bool) -> list[tuple[float, str]]:
    """Return times and modes of a body at its changes; points have their joint mode."""
    trace = Runner(interpret(read_text(text(name, shapes)))).run({}).trace
    found: list[tuple[float, str]] = []
    for arc in trace.arcs:
        kinds = {mode.rstrip("+-") for mode in arc.mode}
        mode = next((mode for mode in ("pin", "slide") if mode in kinds), "free")
        if not found or mode != found[-1][1]:
            found.append((arc.start.high, mode))
    return found


@pytest.mark.parametrize("name", THROWS)
def test_a_landing_box_has_the_events_of_its_corners(name):
    shaped, exact = events(name, True), events(name, False)
    assert [mode for _, mode in shaped] == [mode for _, mode in exact]
    assert [t for t, _ in shaped] == pytest.approx([t for t, _ in exact], abs=4 * STEP)


PUSHED = """
kind: scene
name: pushed
parameters: {rate: 6, mu: 0.5}
gravity: 9.81
bodies:
  b:
    mass: 1
    inertia: 0.08/3
    shape: {polygon: [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]}
    start: {y: 0.2}
surfaces: {floor: {height: 0}}
forces: {push: {body: b, force: [rate*time, 0], at: [0, 0.1]}}
collisions: {all: {bodies: [b], surfaces: [floor], friction: mu, restitution: 0}}
stop: {time: 1}
settings: {engine: impulse, step: 1e-3}
outputs: {slips: {value: time, at: each b.slip}}
"""


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
@pytest.mark.parametrize("rate", [4.95, 6.0, 12.0])
def test_slow_slip_begins_where_friction_is_exceeded(rate: float, step: float) -> None:
    found = Runner(interpret(read_text(PUSHED)), step=step).run({"rate": rate}).outputs["slips"]
    assert found == pytest.approx([0.5 * 9.81 / rate], abs=1.01 * step)


WHEEL = f"""
kind: scene
name: rimless_wheel
parameters: {{slope: 0.1, lean: slope - pi/8, w: 1.2}}
gravity: 9.81
bodies:
  wheel:
    mass: 1
    inertia: 0.3
    shape: {{polygon: [{", ".join(f"[sin({k}*pi/4), -cos({k}*pi/4)]" for k in range(8))}]}}
    start: {{x: sin(lean), y: cos(lean), angle: -lean,
      dx: cos(lean)*w, dy: -sin(lean)*w, dangle: -w}}
surfaces: {{ground: {{incline: -slope}}}}
collisions: {{all: {{bodies: [wheel], surfaces: [ground], friction: 5, restitution: 0}}}}
stop: {{time: 2}}
settings: {{engine: impulse, step: 1e-3}}
outputs: {{strikes: {{value: time, at: each wheel.impact}}}}
"""


@pytest.mark.parametrize("step", [1e-3, 2.5e-4, 5e-5])
def test_corner_that_falls_over_its_landing_gap_strikes_once(step: float) -> None:
    # Own integration of the angle, and McGeer's ratio of rates at a strike.
    found = Runner(interpret(read_text(WHEEL)), step=step).run({}).outputs["strikes"]
    assert found == pytest.approx([0.7331569, 1.4295423], abs=4 * step)


ROCKING = """
kind: scene
name: rocking
parameters: {b: 0.1, h: 0.4, v: 0.3, lean: 0.1, R: sqrt(b**2 + h**2), a: "atan2(b, h) - lean"}
gravity: 9.81
bodies:
  block:
    mass: 1
    inertia: R**2/3
    shape: {polygon: [[-b, -h], [b, -h], [b, h], [-b, h]]}
    start: {x: b - R*sin(a), y: R*cos(a), angle: -lean}
surfaces: {floor: {height: 0}}
collisions: {all: {bodies: [block], surfaces: [floor], friction: 5, restitution: 0}}
stop: {time: 1}
settings: {engine: impulse, step: 1e-3}
outputs: {strikes: {value: time, at: each block.impact}}
"""


FACE = "shape: {polygon: [[-2, -0.5], [2, -0.5], [2, 0], [-2, 0]]}"
SLABS = {"surface": "", "fixed": f"fixed: true, {FACE}", "led": f"position: [0, v*time], {FACE}"}


def on_slab(kind: str) -> str:
    """Return the rocking block on a surface or a slab."""
    if kind == "surface":
        return ROCKING
    text = ROCKING.replace("bodies:\n", f"bodies:\n  slab: {{{SLABS[kind]}}}\n", 1)
    text = text.replace("[block], surfaces: [floor]", "[block, slab]")
    return text.replace("{x:", "{dy: v, x:") if kind == "led" else text


@pytest.mark.parametrize("slab", SLABS)
@pytest.mark.parametrize(
    ("lean", "step"), [(0.1, 1.25e-4), (0.15, 7e-4), (0.07, 5e-4), (0.07, 2.5e-4)]
)
def test_rocking_block_strikes_once_in_each_half_swing(lean: float, step: float, slab: str) -> None:
    # Energy of the swing about a corner, and Housner's ratio of rates at a strike.
    b, h = 0.1, 0.4
    alpha, p2 = math.atan2(b, h), 0.75 * 9.81 / math.hypot(b, h)

    def quarter(top: float) -> float:
        """Time from rest at an angle to the strike; u**2 is the angle fallen."""

        def rate(u: float) -> float:
            fallen = math.cos(alpha - top) - math.cos(alpha - top + u * u)
            return 2.0 * u / math.sqrt(2.0 * p2 * fallen)

        return float(quad(rate, 1e-9, math.sqrt(top), epsabs=1e-10)[0])

    strikes, swing = [quarter(lean)], lean
    while True:
        energy = (1.0 - 1.5 * math.sin(alpha) ** 2) ** 2 * (
            math.cos(alpha - swing) - math.cos(alpha)
        )
        swing = alpha - math.acos(math.cos(alpha) + energy)
        if strikes[-1] + 2.0 * quarter(swing) > 1.0:
            break
        strikes.append(strikes[-1] + 2.0 * quarter(swing))
    run = Runner(interpret(read_text(on_slab(slab))), step=step).run({"lean": lean})
    assert {jump.cause for jump in run.trace.jumps[1:]} == {"impact"}
    assert run.outputs["strikes"] == pytest.approx(strikes, abs=16 * step)


TURNING = ROCKING.replace("{x: b - R*sin(a), y: R*cos(a), angle: -lean}", "START")
START = "{x: 0.6 - R*sin(a), y: R*cos(a), angle: -lean, dx: -w*R*cos(a), dangle: w, "
START += "dy: w*(0.6 - R*sin(a))}"


@pytest.mark.parametrize("kind", ["polygon", "surface"])
@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
@pytest.mark.parametrize("w", [-0.3, -0.15])
def test_block_that_rocks_on_a_turning_slab_strikes_once_in_each_half_swing(
    w: float, step: float, kind: str
) -> None:
    # Own integration about the corner at p in the frame of the slab: I w' = m r x (g + W^2 p). The
    # Coriolis force passes through the corner; strikes have Housner's ratio of rates.
    b, h, lean = 0.1, 0.4, 0.1
    size, alpha = math.hypot(b, h), math.atan2(b, h)

    def rates(t: float, y: list[float], side: float) -> list[float]:
        at, corner = y[0] + side * alpha, 0.5 + side * b
        x, up = -size * math.sin(at), size * math.cos(at)
        pull_x, pull_up = -9.81 * math.sin(w * t) + w * w * corner, -9.81 * math.cos(w * t)
        return [y[1], 0.75 * (x * pull_up - up * pull_x) / size**2]

    def strikes_at(t: float, y: list[float], side: float) -> float:
        return -side * y[0]

    strikes_at.terminal, strikes_at.direction = True, -1  # type: ignore[attr-defined]
    strikes, time, side, state = list[float](), 0.0, 1.0, [-lean, 0.0]
    while True:
        swing = solve_ivp(
            rates, (time, 1.0), state, args=(side,), events=strikes_at, rtol=1e-10, atol=1e-12
        )
        if not swing.t_events[0].size:
            break
        time, side = float(swing.t[-1]), -side
        strikes.append(time)
        state = [1e-12 * -side, float(swing.y[1, -1]) * (1.0 - 1.5 * math.sin(alpha) ** 2)]
    text = TURNING.replace("START", START).replace("lean: 0.1", f"lean: 0.1, w: {w}")
    if kind == "polygon":
        slab = f"{{position: [0, 0], angle: w*time, {FACE}}}"
        text = text.replace("bodies:\n", f"bodies:\n  slab: {slab}\n", 1)
        text = text.replace("[block], surfaces: [floor]", "[block, slab]")
    else:
        text = text.replace("height: 0", "height: 0, turn: w*time")
    run = Runner(interpret(read_text(text)), step=step).run({})
    assert {jump.cause for jump in run.trace.jumps[1:]} == {"impact"}
    assert run.outputs["strikes"] == pytest.approx(strikes, abs=4 * step)
