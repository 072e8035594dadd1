"""Runs by steps start in the modes of the event-driven engines, without events of their own."""

from __future__ import annotations

import math

import pytest

from contacts.scene.scene import Scene
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

ENGINES = pytest.mark.parametrize("engine", ["taylor", "scipy", 1e-3, 1e-5])


def trace_of(text: str, engine: str | float) -> Trace:
    model = interpret(read_text(text))
    assert isinstance(model, Scene)
    if isinstance(engine, str):
        return Runner(model, engine=engine).run().trace
    return Runner(model, engine="impulse", step=engine).run().trace


# A bar lies with one end on a smooth floor, and a brake of its rotation bears a part of its weight.
LEANING = """
kind: scene
name: leaning
gravity: 10
bodies: {bar: {mass: 1, inertia: 0.02}}
surfaces: {floor: {height: 0}}
contacts: {end: {point: {body: bar, at: [-0.25, 0]}, surface: floor, friction: 0, restitution: 0}}
couplings: {rub: {bodies: [bar], limit: 2.5*PART}}
regions:
  control:
    initial: low
    states: {low: {}, high: {}}
    transitions: [{name: rise, from: low, to: high, on: rub.slip}]
stop: {time: 0.02}
"""


@ENGINES
@pytest.mark.parametrize("part", [0.5, 0.99, 1.01])
def test_a_brake_that_cannot_hold_slips_from_the_start(part: float, engine: str | float) -> None:
    trace = trace_of(LEANING.replace("PART", f"{part}"), engine)
    slips = part < 1.0
    assert trace.start_mode == ("slide", "slip-" if slips else "locked", "low")
    assert not trace.jumps
    # V = m (g - 0.25 turn), 0.02 turn = 0.25 V - limit.
    turn = 2.5 * (1.0 - part) / (0.02 + 0.25**2) if slips else 0.0
    spun = dict(zip(trace.variables, trace.final.tolist(), strict=True))["bar.dangle"]
    assert spun == pytest.approx(-0.02 * turn, rel=1e-3, abs=1e-9)


# The gap is 3 * 0.1 - 0.3, round-off of either sign.
TOUCHING = """
kind: scene
name: touching
gravity: 10
bodies: {ball: {mass: 1, start: {y: START, dx: 0.5}}}
surfaces: {floor: {height: 0}}
contacts: {foot: {point: {body: ball}, surface: floor, friction: 0.2, stiffness: 400}}
stop: {time: 0.05}
"""


@ENGINES
@pytest.mark.parametrize("start", ["0.1 + 0.2 - 0.3", "0.3 - 0.2 - 0.1", "0"])
def test_a_compliant_contact_that_touches_is_closed_from_the_start(
    start: str, engine: str | float
) -> None:
    trace = trace_of(TOUCHING.replace("START", start), engine)
    assert trace.start_mode == ("slide+",)
    assert not trace.jumps
    depth = 10.0 / 400.0 * (1.0 - math.cos(20.0 * 0.05))
    assert trace.final[1] == pytest.approx(-depth, rel=2e-3)


LEVEL_ROPE = """
kind: scene
name: level_rope
gravity: 10
bodies: {b: {mass: 2, start: {x: 1}}}
joints: {c: {point: {body: b}, to: [0, 0], rope: 1}}
stop: {time: 0.3}
"""


@pytest.mark.parametrize("step", [1e-2, 1e-3, 1e-4])
def test_a_level_rope_whose_tension_begins_at_zero_is_taut_from_the_start_on(step: float) -> None:
    """The tension is 3 m g sin(a) below the horizontal, and the rope never slack."""
    trace = trace_of(LEVEL_ROPE, step)
    assert trace.start_mode == ("slide",)
    assert not trace.jumps
    x, y = trace.final[:2]
    assert math.hypot(x, y) == pytest.approx(1.0, abs=2.0 * step**2)
    assert math.hypot(*trace.final[2:]) == pytest.approx(math.sqrt(-20.0 * y), rel=step)


def test_a_rope_that_nothing_tightens_starts_free() -> None:
    text = LEVEL_ROPE.replace("gravity: 10", "gravity: 0")
    trace = trace_of(text, 1e-3)
    assert (trace.start_mode, len(trace.jumps)) == (("free",), 0)


STOPPED_AT_START = """
kind: scene
name: stopped
gravity: 10
bodies: {b: {mass: 1.5, start: {dx: 1}}}
surfaces: {floor: {height: 0}}
contacts: {p: {point: {body: b}, surface: floor, friction: 0.1, restitution: 0}}
stop: {time: 1, conditions: {far: CONDITION}}
outputs:
  start: {value: p.V, at: start}
  stop: {value: p.V, at: first stop}
  end: {value: p.V, at: end}
  most: {maximum: p.V}
"""


@pytest.mark.parametrize("condition", ["p.V >= 5", "b.dx > 0"])
@pytest.mark.parametrize("record", ["modes", "nothing"])
@pytest.mark.parametrize("until", [None, 0.0])
@pytest.mark.parametrize("engine", ["taylor", 1e-2])
def test_a_run_without_a_flow_has_the_forces_of_its_start(
    condition: str, record: str, until: float | None, engine: str | float
) -> None:
    """V = m g; a run to time 0 reaches its end, a longer one stops there."""
    model = interpret(read_text(STOPPED_AT_START.replace("CONDITION", condition)))
    assert isinstance(model, Scene)
    if isinstance(engine, str):
        runner = Runner(model, engine=engine)
    else:
        runner = Runner(model, engine="impulse", step=engine, record=record)
    result = runner.run(until=until)
    stopped = until is None
    assert result.trace.t_end == 0.0
    assert result.trace.outcome is (Outcome.STOPPED if stopped else Outcome.HORIZON)
    assert result.outputs == {
        "start": pytest.approx(15.0),
        "stop": pytest.approx(15.0) if stopped else None,
        "end": pytest.approx(15.0),
        "most": pytest.approx(15.0),
    }


PRESSED = """
kind: scene
name: pressed
bodies: {b: {mass: 1}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, restitution: LAW}}
forces: {f: {body: b, force: [0.1, "5*time*(400*time - 1)"]}}
stop: {time: 0.05}
"""


@ENGINES
@pytest.mark.parametrize("law", ["0", "0.5", "0, impact: moreau"])
def test_a_contact_whose_load_begins_at_zero_is_closed_until_it_lifts(
    law: str, engine: str | float
) -> None:
    """The floor bears 5 t (1 - 400 t), for less than three steps of 1e-3."""
    trace = trace_of(PRESSED.replace("LAW", law), engine)
    assert trace.start_mode == ("slide+",)
    (lift,) = trace.jumps
    assert lift.cause == "liftoff"
    near = 1e-9 if isinstance(engine, str) else engine
    assert lift.t == pytest.approx(0.0025, abs=near)


CIRCLING = """
kind: scene
name: circling
gravity: 0
bodies: {b: {mass: 1, start: {x: 1, dy: 2}}}
HELD
regions:
  watch:
    initial: light
    states: {light: {}, heavy: {}}
    transitions: [{name: loads, from: light, to: heavy, guard: c.V >= 3.99}]
stop: {time: 0.5}
outputs: {start: {value: c.V, at: start}, least: {minimum: c.V}, most: {maximum: c.V}}
"""


@ENGINES
@pytest.mark.parametrize("e", [0, 0.5])
@pytest.mark.parametrize(
    "held",
    [
        "joints: {c: {point: {body: b}, to: [0, 0], rope: 1, restitution: E}}",
        "surfaces: {drum: {circle: [0, 0], radius: 1, hollow: true}}\n"
        "contacts: {c: {point: {body: b}, surface: drum, friction: 0, restitution: E}}",
    ],
)
def test_motion_along_a_circle_is_no_impact_at_the_start(
    held: str, e: float, engine: str | float
) -> None:
    """V = v^2/r = 4 at all times."""
    text = read_text(CIRCLING.replace("HELD", held.replace("E", f"{e}")))
    steps = {"engine": engine} if isinstance(engine, str) else {"engine": "impulse", "step": engine}
    result = Runner(text, **steps).run()
    trace = result.trace
    assert trace.start_mode[0] in ("slide", "slide+", "slide-")
    assert [(jump.cause, jump.t) for jump in trace.jumps] == [("loads", 0.0)]
    for force in result.outputs.values():
        assert force == pytest.approx(4.0, abs=1e-5)
