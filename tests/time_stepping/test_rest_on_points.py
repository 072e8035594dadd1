"""Points by steps against hand calculation: rest persists, free contacts bear no force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contacts.time_stepping import stepper
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner, run

BOX = """
kind: scene
name: pulled_box
parameters: {b: 0.2, a: 0.15625, g: 13, F: 40, mu: 2, m: 5}
gravity: g
bodies:
  box: {mass: m, inertia: m*(b**2 + a**2)/3, start: {y: a}}
surfaces: {ground: {height: 0}}
contacts:
  rear: {point: {body: box, at: [-b, -a]}, surface: ground, friction: mu, restitution: 0,
    impact: moreau}
  front: {point: {body: box, at: [b, -a]}, surface: ground, friction: mu, restitution: 0,
    impact: moreau}
forces:
  rope: {body: box, at: [b, a], force: [F, 0]}
stop: {time: 0.2}
settings: {engine: impulse, step: 1e-3}
"""


@pytest.fixture(scope="module")
def runner():
    return Runner(interpret(read_text(BOX)))


@pytest.mark.parametrize(
    "values",
    [
        {},
        {"g": 16, "F": 21, "mu": 1, "m": 2.5},
        {"F": 12, "mu": 0.3},
        {"F": -12, "mu": 0.3, "b": 0.3},
    ],
)
def test_a_pulled_box_that_neither_slips_nor_tips_has_no_event(runner, values):
    known = {"b": 0.2, "a": 0.15625, "g": 13, "F": 40, "mu": 2, "m": 5, **values}
    weight = known["m"] * known["g"]
    # It slips above mu m g, and tips above m g b/(2 a).
    assert abs(known["F"]) < min(known["mu"], known["b"] / (2 * known["a"])) * weight
    trace = runner.run(values).trace
    assert trace.final_mode == ("pin", "pin")
    assert [jump.cause for jump in trace.jumps] == []
    assert abs(trace.final).max() == pytest.approx(known["a"], abs=1e-12)


def test_free_contact_bears_no_force_while_another_lands(runner):
    # It tips about its front, leaves the ground, and strikes it again with the front.
    trace = runner.run({"a": 0.15625, "m": 2.5, "g": 9.81}, until=0.3).trace
    assert [(jump.region, jump.cause) for jump in trace.jumps] == [
        ("front", "liftoff"),
        ("front", "touchdown"),
    ]
    for arc in trace.arcs:
        forces = arc.unknowns(np.linspace(0.0, arc.duration, 9))[:, -4:].reshape(9, 2, 2)
        free = np.array(arc.mode) == "free"
        assert free.any()
        assert (forces[:, free] == 0.0).all()


CLOSING = """
kind: scene
name: closing
parameters: {V: 0.1875, r: 0.02}
bodies:
  ball: {mass: 0.1, inertia: 0.00002, start: {x: r, dx: 1}}
surfaces:
  left: {line: [[0, 1], [0, -1]]}
  right: {line: [[1 + 2*r, -1], [1 + 2*r, 1]], displacement: [-V*time, 0]}
contacts:
  one: {point: {body: ball}, radius: r, surface: left, friction: 0, modes: [free, slide],
    restitution: 0, impact: moreau}
  two: {point: {body: ball}, radius: r, surface: right, friction: 0, modes: [free, slide],
    restitution: 0, impact: moreau}
stop: {time: 6}
settings: {engine: impulse, step: 1e-3}
"""


def test_closing_walls_end_the_run():
    trace = Runner(interpret(read_text(CLOSING))).run(throw=False).trace
    assert trace.outcome is Outcome.UNSOLVED_IMPULSES
    assert "no impulses keep two out" in trace.message
    assert 1 / 0.1875 < trace.t_end < 1 / 0.1875 + 0.02


SECOND_END = """
kind: scene
name: second_end
parameters: {a: -2e-5, w: 0.03}
gravity: 9.81
simultaneous: plastic
bodies:
  rod:
    {mass: 1, inertia: 0.05,
     start: {y: 0.3*sin(-a), angle: a, dx: 1.4, dy: -0.3*w*cos(a), dangle: w}}
surfaces: {ground: {height: 0}}
contacts:
  left: {point: {body: rod, at: [-0.3, 0]}, surface: ground, friction: 0.5, restitution: 0.5,
    impact: moreau}
  right: {point: {body: rod, at: [0.3, 0]}, surface: ground, friction: 0.5, restitution: 0.5,
    impact: moreau}
stop: {time: 1e-3}
settings: {engine: impulse}
"""


@pytest.mark.parametrize("step", [1e-5, 1e-6, 3e-7])
def test_contact_that_lands_within_its_gap_tolerance_rests_there(step):
    # At the two short steps the middle of a step finds the left end 4e-9 above the ground.
    trace = run(interpret(read_text(SECOND_END)), step=step).trace
    assert [(jump.region, jump.cause) for jump in trace.jumps] == [("left", "touchdown")]
    assert trace.final_mode == ("slide+", "slide+")


BALL = """
kind: scene
name: last_bounces
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 1e-3, dx: 0.2}}}
surfaces: {ground: {height: 0}}
contacts: {tip: {point: {body: ball}, surface: ground, friction: 0.5, restitution: 0.53}}
stop: {time: 0.06}
settings: {engine: impulse}
"""


@pytest.mark.parametrize("step", [2e-6, 4e-7, 1e-7])
def test_bounces_within_the_gap_tolerance_end_where_their_series_does(step):
    # The series of bounces ends at t0 (1 + e)/(1 - e), t0 = sqrt(2 y/g).
    end = math.sqrt(2e-3 / 9.81) * 1.53 / 0.47
    landings = run(interpret(read_text(BALL)), step=step).trace.jumps
    assert landings[-1].t == pytest.approx(end, abs=20.0 * step)
    assert len(landings) <= 20


LEVEL_BOX = """
kind: scene
name: level_box
parameters: {a: -0.002, V: 10*(0.2*cos(a) - 0.1*sin(a))/(0.4*cos(a))}
gravity: 10
bodies:
  b: {mass: 1, inertia: 0.02, start: {x: -0.1*sin(a), y: 0.2*sin(a) + 0.1*cos(a), angle: a}}
surfaces: {floor: {height: 0}}
contacts:
  hard: {point: {body: b, at: [-0.2, -0.1]}, surface: floor, friction: 0.5, restitution: 0,
    impact: moreau}
  soft: {point: {body: b, at: [0.2, -0.1]}, surface: floor, friction: {static: 0.8, kinetic: 0.3},
    stiffness: V/(-0.4*sin(a)), damping: 20}
forces: {drive: {body: b, force: [0.1*time, 0]}}
stop: {time: 0.25}
"""


@pytest.mark.parametrize(("engine", "step"), [("taylor", 0.0), ("impulse", 1e-3)])
def test_pins_that_nearly_imply_each_other_bear_their_forces(engine, step):
    """Feet at rest hold the angle: moments about the centre give their friction forces.

    ``H = F (y1 - 0)/(y0 - y1)`` of the hard foot, with the heights y of the feet below the centre:
    it breaks loose at its cone, although kinetic friction would not hold the other foot.
    """
    text = LEVEL_BOX + (f"settings: {{engine: impulse, step: {step}}}" if step else "")
    result = Runner(interpret(read_text(text))).run()
    lever = (0.2 * math.sin(-0.002) - 0.1 * math.cos(-0.002)) / (-0.4 * math.sin(-0.002))
    force = result.at(0.15 - 0.5 * step).values["hard.H"]
    assert force == pytest.approx(lever * 0.1 * (0.15 - 0.5 * step), rel=1e-6)
    weight = 10 - 10 * (0.5 - 0.25 * math.tan(-0.002))
    (slip,) = result.trace.jumps
    assert (slip.region, slip.cause) == ("hard", "slip")
    assert slip.t == pytest.approx(0.5 * weight / (-0.1 * lever), abs=max(20 * step, 1e-9))


LANDING = """
kind: scene
name: landing
parameters: {low: 0}
gravity: 10
bodies:
  b: {mass: 1, inertia: 0.02, start: {x: -0.1*sin(0.3), y: 0.2*sin(0.3) + 0.1*cos(0.3) + 0.05,
    angle: 0.3}}
surfaces: {floor: {height: 0}, ground: {height: -low}}
contacts:
  hard: {point: {body: b, at: [-0.2, -0.1]}, surface: floor, friction: 1, restitution: 0,
    impact: moreau}
  soft: {point: {body: b, at: [0.2, -0.1]}, surface: ground, friction: 2, stiffness: 1e4,
    damping: 20}
stop: {time: 0.4}
"""


@pytest.mark.parametrize(
    ("step", "size"),
    [(0.0, 512), (1e-3, 512), (1e-3, 8), (1e-3, 1), (1e-4, 512), (1e-5, 512)],
)
@pytest.mark.parametrize(("low", "lands"), [(0.0, "pin"), (0.02, "slide-")])
def test_a_foot_that_lands_level_with_a_pinned_foot_has_no_slip(
    step, size, low, lands, monkeypatch
):
    """The slip of a foot about the other is the rate of turn times the difference of heights."""
    monkeypatch.setattr(stepper, "_CHUNK", size)
    text = LANDING + (f"settings: {{engine: impulse, step: {step}}}" if step else "")
    jumps = Runner(interpret(read_text(text))).run({"low": low}).trace.jumps
    assert next(jump.target[1] for jump in jumps if jump.target[1] != "free") == lands


BOUND = """
kind: scene
name: bound
gravity: 9.81
bodies: {b: {mass: 1, inertia: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: b}, surface: floor, friction: 0.2, restitution: 0.5, enabled: b.y >= -1e-4}
stop: {time: 1}
settings: {engine: impulse, step: STEP}
"""


@pytest.mark.parametrize("step", [1e-3, 7e-4])
def test_a_condition_that_holds_on_the_surface_holds_at_the_depth_of_an_impact(step: float) -> None:
    jumps = run(read_text(BOUND.replace("STEP", str(step)))).trace.jumps
    assert [jump.cause for jump in jumps] == ["touchdown", "touchdown"]
    first = math.sqrt(2 / 9.81)
    assert [jump.t for jump in jumps] == pytest.approx([first, 2 * first], abs=2 * step)
