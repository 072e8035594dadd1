"""Static and kinetic friction between bodies with shapes, beside closed forms."""

from __future__ import annotations

import math

import pytest

from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.runner import Runner

G = 9.81

SLOPE = """
kind: scene
name: slope
parameters: {alpha: 0.4, s: 0.5, k: 0.3, v: 0, a: 0.1}
gravity: 9.81
bodies:
  block:
    mass: 2
    inertia: a**2/3
    shape: {polygon: [[-a, -a/2], [a, -a/2], [a, a/2], [-a, a/2]]}
    start: {x: -a/2*sin(alpha), y: a/2*cos(alpha), angle: alpha, dx: v*cos(alpha), dy: v*sin(alpha)}
surfaces: {ramp: {incline: alpha}}
collisions:
  all: {bodies: [block], surfaces: [ramp], friction: {static: s, kinetic: k}, restitution: 0}
stop: {time: 1}
settings: {engine: impulse, step: 1e-3}
outputs:
  way: {value: block.x*cos(alpha) + block.y*sin(alpha)}
  slips: {count: block.slip}
  sticks: {count: block.stick}
"""

DRAGGED = """
kind: scene
name: dragged
parameters: {k: 50, v: 0.1, s: 0.9, kin: 0.2, a: 0.1}
gravity: 9.81
bodies:
  block:
    mass: 1
    inertia: a**2/6
    shape: {polygon: [[-a/2, -a/2], [a/2, -a/2], [a/2, a/2], [-a/2, a/2]]}
    start: {y: a/2}
surfaces: {floor: {height: 0}}
collisions:
  all: {bodies: [block], surfaces: [floor], friction: {static: s, kinetic: kin}, restitution: 0}
forces:
  spring: {body: block, force: [k*(v*time - block.x), 0], at: [0, -a/2]}
stop: {time: 6}
settings: {engine: impulse, step: 1e-3}
outputs:
  slips: {value: time, at: each block.slip}
  sticks: {value: time, at: each block.stick}
"""


def run(text, parameters=None, **settings):
    runner = Runner(interpret(read_text(text)), **settings)
    return runner.run(parameters)


def test_a_block_between_both_angles_of_friction_holds():
    outputs = run(SLOPE).outputs
    assert outputs["way"] == pytest.approx(0, abs=1e-9)
    assert outputs["slips"] == 0


@pytest.mark.parametrize("v", [-0.5, -1e-3])
def test_a_block_pushed_downhill_slides_on(v):
    """tan(0.4) = 0.42 is above the kinetic coefficient: it does not stop."""
    pull = G * (math.sin(0.4) - 0.3 * math.cos(0.4))
    outputs = run(SLOPE, {"v": v}).outputs
    assert outputs["way"] == pytest.approx(v - pull / 2, abs=1e-4)
    assert outputs["sticks"] == 0


def test_a_block_slides_uphill_and_sticks_when_it_stops():
    v, pull = 2.0, G * (math.sin(0.4) + 0.3 * math.cos(0.4))
    outputs = run(SLOPE, {"v": v}).outputs
    assert outputs["way"] == pytest.approx(v**2 / (2 * pull), abs=1e-4)
    assert (outputs["sticks"], outputs["slips"]) == (1, 0)


def test_block_slides_above_static_friction():
    pull = G * (math.sin(0.55) - 0.3 * math.cos(0.55))
    assert run(SLOPE, {"alpha": 0.55}).outputs["way"] == pytest.approx(-pull / 2, abs=5e-3)


def test_a_dragged_block_breaks_away_and_stops_as_with_points():
    """The times of `static_kinetic` in docs/how-to/friction.md, of first order in the step."""
    expected = {"slips": [1.7658, 4.985911], "sticks": [2.239111, 5.459222]}
    for step in (4e-3, 1e-3, 2.5e-4):
        outputs = run(DRAGGED, step=step).outputs
        for name, times in expected.items():
            assert list(outputs[name]) == pytest.approx(times, abs=2 * step)


def test_equal_coefficients_are_one_coefficient():
    both = run(DRAGGED, {"kin": 0.9}).outputs
    one = run(DRAGGED.replace("{static: s, kinetic: kin}", "s")).outputs
    assert both == one


def test_struck_shapes_slip_under_kinetic_friction():
    """A disc that falls with a slip: both bounds of its impulse are mu times the normal one."""
    text = """
kind: scene
name: thrown
parameters: {s: 0.6, kin: 0.2, v: 3, w: 2}
gravity: 9.81
bodies:
  disc: {mass: 1, inertia: 0.005, shape: {disc: 0.1}, start: {y: 0.3, dx: v, dy: -w}}
surfaces: {floor: {height: 0}}
collisions:
  all: {bodies: [disc], surfaces: [floor], friction: {static: s, kinetic: kin}, restitution: 0.5}
stop: {time: 0.2}
settings: {engine: impulse, step: 1e-4}
outputs:
  after: {value: disc.dx}
"""
    speed = math.sqrt(2**2 + 2 * G * 0.2)
    assert run(text).outputs["after"] == pytest.approx(3 - 0.2 * 1.5 * speed, abs=1e-3)


def test_the_kinetic_coefficient_is_no_formula_of_the_slip():
    text = DRAGGED.replace("kinetic: kin", "kinetic: kin + exp(-abs(slip))")
    with pytest.raises(DeclarationError, match="does not depend on the slip"):
        interpret(read_text(text))


def test_the_kinetic_coefficient_is_not_above_the_static_one():
    with pytest.raises(DeclarationError, match=r"static coefficient 0\.1 is below the kinetic"):
        run(DRAGGED, {"s": 0.1})


STACK = """
kind: scene
name: stack
parameters: {k: 40, a: 0.4, f: 2.4}
gravity: 10
bodies:
  low:
    mass: 1
    inertia: 1
    shape: {polygon: [[-2, -0.1], [2, -0.1], [2, 0.1], [-2, 0.1]]}
    start: {y: 0.1}
  top:
    mass: 1
    inertia: 1
    shape: {polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}
    start: {x: a, y: 0.3}
surfaces: {floor: {height: 0}}
collisions:
  below:
    {bodies: [low], surfaces: [floor], friction: {static: 0.25, kinetic: 0.1}, restitution: 0}
  between: {bodies: [low, top], friction: {static: 0.3, kinetic: 0.1}, restitution: 0}
forces:
  spring: {body: top, force: [-k*top.x, 0], at: [0, -0.1]}
  load: {body: low, force: [f, 0]}
stop: {time: 1.2}
settings: {engine: impulse, step: 1e-3}
outputs: {low: {value: low.x}, top: {value: top.x}, sticks: {count: top.stick}}
"""


@pytest.mark.parametrize("load", [2.4, -2.4, 0.0])
def test_resting_bodies_stay_while_another_keeps_slipping(load: float) -> None:
    """The load and static friction from above would move it, and kinetic friction does not.

    The box above swings about the places where spring and friction balance, 1/40 from 0.
    """
    w, c = math.sqrt(40), 1 / 40
    third = c + (0.4 - 4 * c - c) * math.cos(w * (1.2 - 2 * math.pi / w))
    errors = []
    for h in (1e-3, 1e-4):
        outputs = run(STACK, {"f": load}, step=h).outputs
        assert outputs["low"] == pytest.approx(0, abs=1e-12)
        assert outputs["sticks"] == 0
        errors.append(abs(outputs["top"] - third))
    assert errors[0] < 1e-3
    assert errors[1] < errors[0] / 5


CARRIED = """
kind: scene
name: carried
parameters: {mu: 0.2, m: 0.5, M: 2, v: 0.8, F: 0}
gravity: 9.81
bodies:
  load: {mass: m, inertia: m*0.1**2/2, start: {y: 0.1, dx: v}, shape: SHAPE}
  plank: {mass: M, inertia: 1, start: {y: -0.1}, shape: {polygon: [[-2, -0.1], [2, -0.1], [2, 0.1],
    [-2, 0.1]]}}
surfaces: {floor: {height: -0.2}}
collisions:
  load: {bodies: [load, plank], friction: mu, restitution: 0}
  plank: {bodies: [plank], surfaces: [floor], friction: 0, restitution: 0}
forces: {push: {body: plank, force: [F, 0]}}
stop: {time: 0.5}
settings: {engine: impulse}
outputs: {dx: {value: load.dx}}
"""
BOX = "{polygon: [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]}"


@pytest.mark.parametrize(("shape", "share"), [(BOX, 1.0), ("{disc: 0.1}", 3.0)])
@pytest.mark.parametrize("part", [0.3, 1.2, 3.0])
@pytest.mark.parametrize("step", [1e-2, 3.1e-3, 1e-3, 1.7e-4])
def test_a_load_on_a_pushed_plank_sticks_only_if_friction_holds_it(shape, share, part, step):
    """Its slip v - a t, with a = F/M + b and b = mu m g (1/M + s/m), ends at v/a.

    There it sticks if F/M < b; a disc, with s = 3, rolls from then on. Otherwise it slips back.
    """
    mu, m, large, v = 0.2, 0.5, 2.0, 0.8
    most = mu * m * G * (1.0 / large + share / m)
    force, ends = part * large * most, v / (part * most + most)
    text = read_text(CARRIED.replace("SHAPE", shape))
    result = Runner(interpret(text), step=step).run({"F": force})
    events = [(jump.cause, jump.t) for jump in result.trace.jumps if jump.region == "load"]
    later, slows = 0.5 - ends, mu * G
    if part > 1.0:
        assert [cause for cause, _ in events] == ["touchdown"]
        speed = v - slows * ends + slows * later
    else:
        assert [cause for cause, _ in events] == ["touchdown", "stick"]
        assert ends <= events[1][1] <= ends + 1.001 * step
        # The load needs the friction H of H (1/M + s/m) = F/M.
        speed = v - slows * ends + part * slows * later
    assert result.outputs["dx"] == pytest.approx(speed, abs=2.0 * slows * step)
