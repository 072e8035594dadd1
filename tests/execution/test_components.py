"""Runs by independent components against runs of the product, and how they end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import statechart
from contacts.dynamics.components import components
from contacts.dynamics.setup_evaluation import SceneNumbers
from contacts.scene.scene import Scene
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.yaml_reader import read_text
from statechart.engines.taylor import Taylor
from statechart.errors import DeclarationProblem
from statechart.execution.simulator import Simulator
from statechart.loading.kind import kind
from statechart.loading.load import interpret, load
from statechart.running.runner import Runner
from statechart.testing.properties import assert_ordered

# Two alike particles at heights of their own, a rod that topples, and a puck on a slope: bodies
# that nothing couples.
BODIES = """
kind: scene
name: apart
parameters: {mu: 0.4}
gravity: 9.81
bodies:
  low: {mass: 2, start: {y: 0.7}}
  rod: {mass: 1, inertia: 1/3, start: {y: 1.1, angle: 0.4, dx: 0.3}}
  high: {mass: 2, start: {x: 4, y: 0.9}}
  puck: {mass: 2, start: {x: 8, y: 0.9, dx: 1}}
surfaces: {ground: {height: 0}, slope: {height: 0.05*sin(x)}}
contacts:
  a: {point: {body: low}, surface: ground, friction: 0.2, restitution: 0.6}
  b: {point: {body: rod, at: [0, -1]}, surface: ground, friction: mu, restitution: 0.3}
  c: {point: {body: rod, at: [0, 1]}, surface: ground, friction: mu, restitution: 0.3}
  d: {point: {body: high}, surface: ground, friction: 0.3, restitution: 0.5}
  e: {point: {body: puck}, surface: slope, friction: 0.1, restitution: 0.4}
"""
# Names of the format, `x` and `y`, as coordinates.
NAMED = """
kind: scene
name: named
gravity: 9.81
coordinates:
  x: {start: 0, rate: 1}
  y: {start: 0.7, rate: 0}
  u: {start: 3, rate: -1}
  v: {start: 0.9, rate: 0}
bodies:
  ball: {mass: 2, position: [x, y]}
  other: {mass: 2, position: [u, v]}
surfaces: {ground: {height: 0}}
contacts:
  a: {point: {body: ball}, surface: ground, friction: 0.2, restitution: 0.6}
  b: {point: {body: other}, surface: ground, friction: 0.3, restitution: 0.5}
"""
ROOMS = """
kind: chart
name: rooms
variables: {T0: 20.0, T1: 20.5}
regions:
  r0:
    initial: cool
    states:
      cool: {flows: {T0: -0.1*(T0 - 5)}}
      warm: {flows: {T0: -0.1*(T0 - 5) + 3}}
    transitions:
      - {name: up, from: cool, to: warm, guard: T0 <= 18}
      - {name: down, from: warm, to: cool, guard: T0 >= 22}
  r1:
    initial: cool
    states:
      cool: {flows: {T1: -0.1*(T1 - 5)}}
      warm: {flows: {T1: -0.1*(T1 - 5) + 3}}
    transitions:
      - {name: up, from: cool, to: warm, guard: T1 <= 18}
      - {name: down, from: warm, to: cool, guard: T1 >= 22}
"""


# Two carts, each with a sampler and a timer of its own, at the same instants; a puck that stops
# beside one that turns round.
SAMPLED = """
kind: scene
name: sampled
gravity: 10
coordinates: {p: {start: 1}, q: {start: 1}}
bodies:
  front: {mass: 1, position: [p, 0]}
  rear: {mass: 1, position: [q, 0]}
  stops: {mass: 1, start: {x: 3, dx: 5}}
  turns: {mass: 1, start: {x: 9, dx: 15}}
surfaces: {ground: {height: 0}}
contacts:
  left: {point: {body: stops}, surface: ground, friction: 0.5, restitution: 0.5}
  right: {point: {body: turns}, surface: ground, friction: 0.5, restitution: 0.5}
controls: {u: 0, w: 0}
forces:
  u: {body: front, force: [u, 0]}
  w: {body: rear, force: [w, 0]}
  back: {body: turns, force: [-10, 0]}
regions:
  one:
    initial: on
    variables: {a: 0}
    states: {on: {sets: {u: a}}}
    transitions: [{name: tick, from: on, every: 0.1, updates: {a: -4*p - dp}}]
  two:
    initial: on
    variables: {b: 0}
    states: {on: {sets: {w: b}}}
    transitions: [{name: tock, from: on, every: 0.1, updates: {b: -4*q - dq}}]
  three:
    initial: on
    states: {on: {}, off: {}}
    transitions:
      - {name: far, from: on, to: off, guard: p > 9}
      - {name: late, from: on, to: off, after: 0.35}
  four:
    initial: on
    states: {on: {}, off: {}}
    transitions:
      - {name: away, from: on, to: off, guard: q > 9}
      - {name: over, from: on, to: off, after: 0.35}
stop: {time: 1.25}
outputs:
  ticks: {count: one.tick}
  tocks: {count: two.tock}
  over: {value: time, at: first four.over}
  away: {count: four.away}
  sticks: {value: time, at: first left.stick}
  reverses: {value: time, at: first right.reverse}
"""


def composed(text: str, folder: Path) -> Automaton:
    path = folder / "model.yaml"
    path.write_text(text)
    model = load(path)
    return kind(model.kind).automaton(model)


def both(text: str, folder: Path, until: float, **asked: int) -> tuple[Trace, Trace]:
    """Return the runs by components, and as one product."""
    automaton = composed(text, folder)
    assert len(automaton.components()) > 1
    engine = Taylor(1e-12)
    whole = replace(automaton, components=tuple)
    return (
        Simulator(automaton, engine).run(until=until, **asked),
        Simulator(whole, engine).run(until=until, **asked),
    )


def near(one: object, other: object) -> object:
    return np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-11)  # type: ignore[call-overload]


@pytest.mark.parametrize(("text", "until"), [(BODIES, 1.5), (NAMED, 1.5), (ROOMS, 30.0)])
def test_component_runs_equal_the_product_run(text: str, until: float, tmp_path: Path) -> None:
    found, expected = both(text, tmp_path, until)
    assert (found.outcome, found.message) == (expected.outcome, expected.message)
    assert found.modes == expected.modes
    assert len(found.jumps) == len(expected.jumps) > 5
    for one, other in zip(found.jumps, expected.jumps, strict=True):
        assert (one.region, one.cause, one.j) == (other.region, other.cause, other.j)
        assert (one.source, one.target) == (other.source, other.target)
        assert one.fired == other.fired
        near([one.t, *one.before, *one.after], [other.t, *other.before, *other.after])
        if other.energy is not None:
            near(one.energy, other.energy)
        for name, impulse in one.impulse.items():
            near(impulse, other.impulse[name])
    near(found.final, expected.final)
    for one, other in zip(found.arcs, expected.arcs, strict=True):
        assert (one.mode, one.roles, one.j) == (other.mode, other.roles, other.j)
        local = np.linspace(0.0, min(one.duration, other.duration), 7)
        near(one.states(local), other.states(local))


def test_equal_components_share_modes(tmp_path: Path) -> None:
    automaton = composed(BODIES, tmp_path)
    components = automaton.components()
    shared = {component.automaton for component in components}
    # The two particles are alike but for names, starts and coefficients.
    assert (len(components), len(shared)) == (4, 3)


def test_end_of_one_component_ends_the_run(tmp_path: Path) -> None:
    text = f"{BODIES}stop: {{time: 3, conditions: {{down: d.gap < 0.2}}}}\n"
    found, expected = both(text, tmp_path, 3.0)
    assert found.outcome is expected.outcome is Outcome.STOPPED
    assert found.message == expected.message
    assert found.jumps[-1].cause == "stop"
    near([found.t_end, *found.final], [expected.t_end, *expected.final])
    assert found.arcs[-1].end.high == pytest.approx(found.t_end, rel=1e-15)


def test_max_jumps_ends_a_componentwise_run(tmp_path: Path) -> None:
    automaton = composed(f"{BODIES}settings: {{max_jumps: 4}}\n", tmp_path)
    trace = Simulator(automaton, Taylor(1e-12)).run(until=1.5, throw=False)
    assert (trace.outcome, len(trace.jumps)) == (Outcome.TOO_MANY_JUMPS, 4)
    near(trace.final, trace.jumps[-1].after)


def test_components_that_jump_at_one_instant_do_so_in_one_jump(tmp_path: Path) -> None:
    text = BODIES.replace("x: 4, y: 0.9", "x: 4, y: 0.7").replace(
        "restitution: 0.5", "restitution: 0.6"
    )
    automaton = composed(text, tmp_path)
    trace = Simulator(automaton, Taylor(1e-12)).run(until=1.0)
    struck = [set(jump.impulse) for jump in trace.jumps if "a" in jump.impulse]
    assert struck
    assert all(names == {"a", "d"} for names in struck)


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_each_of_several_events_at_one_instant_is_seen(engine: str, whole: bool) -> None:
    text = SAMPLED
    if whole:  # A condition that mentions all bodies couples them.
        bound = "conditions: {never: p + q + stops.x + turns.x > 1e9}"
        text = text.replace("{time: 1.25}", f"{{time: 1.25, {bound}}}")
    step = {"step": 1e-3} if engine == "impulse" else {}
    found = Runner(interpret(read_text(text)), engine=engine, **step).run().outputs
    assert (found["ticks"], found["tocks"], found["away"]) == (12, 12, 0)
    times = [found["over"], found["sticks"], found["reverses"]]
    assert times == pytest.approx([0.35, 1.0, 1.0], abs=2e-3 if step else 1e-9)


def test_an_impossible_start_is_reported_in_declared_names(tmp_path: Path) -> None:
    automaton = composed(BODIES.replace("y: 0.7", "y: -0.7"), tmp_path)
    with pytest.raises(Exception, match="'a' starts inside its surface"):
        Simulator(automaton, Taylor(1e-12)).run(until=1.0)


# A controller of one particle that hears or reads another particle.
HEARD = """
kind: scene
name: heard
gravity: 9.81
bodies:
  p: {mass: 1, start: {y: 0.5}}
  q: {mass: 2, start: {y: 1, x: 3}}
surfaces: {floor: {height: 0}}
contacts:
  one: {point: {body: p}, surface: floor, friction: 0.3, restitution: 0.5}
  two: {point: {body: q}, surface: floor, friction: 0.3, restitution: 0.5}
controls: {push: 0}
forces: {push: {body: q, force: [push, 0]}}
regions:
  listener:
    initial: idle
    states: {idle: {}, busy: {sets: {push: 3}}}
    transitions: [{name: go, from: idle, to: busy, TRIGGER}]
stop: {time: 0.4}
"""


@pytest.mark.parametrize("trigger", ["on: touchdown", "guard: energy < 24"])
def test_a_controller_that_hears_or_reads_all_bodies_joins_them(trigger):
    model = interpret(read_text(HEARD.replace("TRIGGER", trigger)))
    trace = statechart.run(model).trace
    # The impact of p at sqrt(2 y/g) takes 3.68 J of 24.525 J.
    assert [jump.t for jump in trace.jumps if jump.cause == "go"] == pytest.approx(
        [(1 / 9.81) ** 0.5]
    )


def test_regions_that_hear_a_cause_without_its_region_are_joined():
    text = """
kind: chart
name: heard
variables: {x: 0, y: 0}
regions:
  one:
    initial: up
    states: {up: {flows: {x: 1}}, down: {flows: {x: -1}}}
    transitions: [{name: turn, from: up, to: down, guard: x >= 1}]
  two:
    initial: up
    states: {up: {flows: {y: 1}}, down: {flows: {y: -1}}, off: {}}
    transitions:
      - {name: turn, from: up, to: down, guard: y >= 2}
      - {name: halt, from: up, to: off, on: turn}
stop: {time: 3}
"""
    trace = statechart.run(interpret(read_text(text))).trace
    assert [(jump.t, jump.cause) for jump in trace.jumps] == [(1.0, "turn"), (1.0, "halt")]


_ALONE = """
kind: scene
name: alone
gravity: 9.81
bodies: {p: {mass: 1, start: {y: 1}}, q: {mass: 1, start: {y: 2}}}
surfaces: {floor: {height: 0}}
contacts:
  a: {point: {body: p}, surface: floor, friction: 0, restitution: 0}
  b: {point: {body: q}, surface: floor, friction: 0, restitution: 0}
CLOCK
stop: {time: 0.7}
"""
_CLOCK = """
regions:
  clock:
    initial: w
    states: {w: {}, d: {}}
    transitions: [{name: rings, from: w, to: d, after: 0.5}]
"""


@pytest.mark.parametrize(("clock", "count"), [("", 2), (_CLOCK, 0)])
def test_a_controller_of_time_alone_is_no_component(clock: str, count: int) -> None:
    model = interpret(read_text(_ALONE.replace("CLOCK", clock)))
    assert len(kind("scene").automaton(model).components()) == count
    jumps = [(j.region, j.t) for j in statechart.run(model).trace.jumps if j.t > 0.0]
    expected = [("a", (2 / 9.81) ** 0.5), ("clock", 0.5), ("b", (4 / 9.81) ** 0.5)]
    expected = [one for one in expected if clock or one[0] != "clock"]
    assert [name for name, _ in jumps] == [name for name, _ in expected]
    assert [t for _, t in jumps] == pytest.approx([t for _, t in expected])


def test_an_error_in_a_component_is_not_taken_for_a_part_that_is_no_scene() -> None:
    def failing(scene: Scene) -> tuple[Automaton, SceneNumbers]:
        raise DeclarationProblem("no equations")

    model = interpret(read_text(_ALONE.replace("CLOCK", "")))
    with pytest.raises(DeclarationProblem, match="no equations"):
        components(model, failing)


BESIDE = """\
kind: chart
name: beside
variables: {{x: 1, slow: 0, fast: 0}}
regions:
  m: {{initial: a, states: {{a: {{flows: {{x: -1}}}}}}}}
  e: {{initial: w, states: {{w: {{}}, d: {{}}}}, transitions: [
    {{name: hit, from: w, to: d, guard: "x <= {level} and x <= -50"}}]}}
  one: {{initial: w, states: {{w: {{}}}}, transitions: [
    {{name: tick, from: w, every: 0.1, updates: {{fast: fast + 1}}}}]}}
  other: {{initial: w, states: {{w: {{}}}}, transitions: [
    {{name: tock, from: w, every: 0.3, updates: {{slow: slow + 1}}}}]}}
stop: {{time: 4}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("level", [0.0, 1e-16, 0.1, 0.7])
def test_merged_runs_are_ordered_where_components_meet_up_to_rounding(
    engine: str, level: float
) -> None:
    trace = Runner(interpret(read_text(BESIDE.format(level=level))), engine=engine).run().trace
    assert_ordered(trace)
    assert len(trace.jumps) == 40 + 13


def test_merged_runs_are_ordered_where_a_sum_of_times_rounds_to_another() -> None:
    """The time from one event to the next is half-way between two that floats can express."""
    text = """\
kind: chart
name: pair
variables: {x: 1.1443360504355085, y: 3.162991900618492}
regions:
  one: {initial: a, states: {a: {flows: {x: -1}}, b: {}}, transitions: [
    {name: hit, from: a, to: b, guard: x <= 0}]}
  other: {initial: a, states: {a: {flows: {y: -1}}, b: {}}, transitions: [
    {name: hit, from: a, to: b, guard: y <= 0}]}
stop: {time: 4}
"""
    trace = Runner(interpret(read_text(text))).run().trace
    assert [jump.t for jump in trace.jumps] == [1.1443360504355085, 3.162991900618492]
    assert_ordered(trace)
