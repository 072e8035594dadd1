"""Events by steps equal the events of the event-driven engines, up to some steps in time."""

from __future__ import annotations

import math
import re
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

import statechart
from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner

H = 2.5e-4

# A corner that turns as it lands on a ramp: the turning takes it off the ramp in the next step.
# A controller counts the events.
TURNING = """
kind: scene
name: turning
gravity: 9.81
stop: {time: 0.5}
controls: {u: 0}
regions:
  ctl:
    initial: a
    variables: {n: 0}
    states: {a: {sets: {u: -0.606}}}
    transitions:
    - {name: cnt, from: a, on: c.touchdown or c.slip or c.stick, updates: {n: n + 1}}
bodies:
  b:
    mass: 1.659
    inertia: 0.025
    start: {x: -0.062, y: 1.21, dx: 0.512, angle: 0.269, dangle: 0.703}
surfaces: {ramp: {edge: [[-1, 0.495], [0.345, 0.308]]}}
contacts:
  c:
    {point: {body: b, at: [-0.14, -0.1]}, surface: ramp, friction: 1.1, restitution: 0,
    impact: moreau}
forces: {push: {body: b, force: [u, 0]}}
outputs:
  n: {value: n}
  landings: {count: c.touchdown}
  slips: {count: c.slip}
"""


def by_events(model: Scene) -> Result:
    return Runner(model, engine="scipy", tolerance=1e-10).run()


def by_steps(model: Scene, h: float) -> Result:
    return Runner(model, engine="impulse", step=h).run()


@cache
def turning() -> Scene:
    model = interpret(read_text(TURNING, "f.yaml"))
    assert isinstance(model, Scene)
    return model


@pytest.mark.parametrize("h", [6e-4, 1.5e-4])
def test_turning_body_has_one_touchdown_by_steps(h: float) -> None:
    exact, found = by_events(turning()), by_steps(turning(), h)
    assert exact.outputs["n"] == 2.0
    assert found.outputs == exact.outputs
    causes = [[(j.region, j.cause) for j in run.trace.jumps] for run in (exact, found)]
    assert causes[1] == causes[0]
    for there, here in zip(exact.trace.jumps, found.trace.jumps, strict=True):
        assert here.t == pytest.approx(there.t, abs=3 * h)
    np.testing.assert_allclose(found.trace.final, exact.trace.final, rtol=0, atol=0.1 * h)


# A tip lands, slides under a fan, sticks for 1.5 ms as the rod turns, and slides back.
BLOWN = """
kind: scene
name: blown
gravity: 9.81
stop: {time: 0.31}
bodies:
  b: {mass: 1, inertia: 0.05, start: {x: 3, y: 0.44738221, dx: -0.33105629, dangle: -0.91552779}}
surfaces: {floor: {height: 0}}
contacts:
  c:
    {point: {body: b, at: [0.3, 0]}, surface: floor, friction: 0.17900972, restitution: 0,
    impact: moreau}
controls: {push: 0}
forces: {fan: {body: b, force: [push, 0]}}
regions:
  fan:
    initial: calm
    states: {calm: {}, blows: {sets: {push: 8.88511512}}}
    transitions: [{name: open, from: calm, to: blows, on: c.touchdown}]
"""


@pytest.mark.parametrize("h", [1e-4, 1e-5])
def test_the_tip_of_a_turning_rod_sticks_and_slides_back_as_with_events(h: float) -> None:
    found = by_steps(interpret(read_text(BLOWN)), h).trace
    # The fan opens at the end of a step; with events, as late after the touchdown.
    opened = found.jumps[1].t
    late = BLOWN.replace("on: c.touchdown", f"guard: time >= {opened}")
    exact = by_events(interpret(read_text(late))).trace
    causes = [(jump.cause, jump.target) for jump in exact.jumps]
    assert causes[-2:] == [("stick", ("pin", "blows")), ("slip", ("slide-", "blows"))]
    assert [(jump.cause, jump.target) for jump in found.jumps] == causes
    for there, here in zip(exact.jumps, found.jumps, strict=True):
        assert here.t == pytest.approx(there.t, abs=4 * h)


# A bar that is thrown on a line, and a controller that pushes it after an event.
THROWN = """
kind: scene
name: thrown
parameters: {{m: 1, I: 0.03, y0: 0.6, dx0: 0, dy0: 0, angle0: 0, dangle0: 0, slope: 0, mu: 0.5,
  nu: 0.5, e: 0, F: 0}}
gravity: 9.81
stop: {{time: 0.6}}
simultaneous: {simultaneous}
bodies:
  b:
    mass: m
    inertia: I
    start: {{y: y0, dx: dx0, dy: dy0, angle: angle0, dangle: dangle0}}
surfaces: {{ground: {{height: slope*x}}}}
contacts:
  left:
    {{point: {{body: b, at: [-0.14, -0.1]}}, surface: ground, friction: mu, restitution: e,
    impact: moreau}}
  right:
    {{point: {{body: b, at: [0.2, -0.1]}}, surface: ground, friction: nu, restitution: e,
    impact: moreau}}
forces: {{push: {{body: b, force: [u, 0]}}}}
controls: {{u: 0}}
regions:
  driver:
    initial: wait
    states: {{wait: {{}}, go: {{sets: {{u: F}}}}}}
    transitions:
    - {{name: heard, from: wait, to: go, on: left.{event} or right.{event}}}
"""


@cache
def runners(simultaneous: str, event: str) -> tuple[Runner, Runner]:
    """Return runners with events and by steps."""
    model = interpret(read_text(THROWN.format(simultaneous=simultaneous, event=event), "f.yaml"))
    return Runner(model, engine="scipy", tolerance=1e-10), Runner(model, engine="impulse", step=H)


def throw(seed: int) -> dict[str, float]:
    """Return random values of its parameters."""
    g = np.random.default_rng(seed)
    least = [0.5, 0.01, 0.5, -1.5, -1.5, -0.6, -3.0, -0.03, -5.0]
    most = [2.0, 0.06, 0.9, 1.5, 0.0, 0.6, 3.0, 0.03, 5.0]
    names = ("m", "I", "y0", "dx0", "dy0", "angle0", "dangle0", "slope", "F")
    values = dict(zip(names, g.uniform(least, most).tolist(), strict=True))
    mu, nu = g.choice([0.1, 0.3, 0.5, 0.8, 1.2], 2).tolist()
    return {**values, "mu": mu, "nu": nu, "e": float(g.choice([0.0, 0.0, 0.5]))}


# A box slides to rest on two points, which stick at one instant.
SLIDING = """
kind: scene
name: sliding
gravity: 9.81
stop: {time: 0.4}
bodies:
  b: {mass: 1, inertia: 0.02, start: {y: 0.1, dx: 1}}
surfaces: {ground: {height: 0}}
contacts:
  left:
    {point: {body: b, at: [-0.2, -0.1]}, surface: ground, friction: 0.5, restitution: 0,
    impact: moreau}
  right:
    {point: {body: b, at: [0.2, -0.1]}, surface: ground, friction: 0.5, restitution: 0,
    impact: moreau}
regions:
  ctl:
    initial: a
    states: {a: {}, b: {}}
    transitions:
    - {name: go, from: a, to: b, on: left.stick or right.stick}
    - {name: back, from: b, to: a, on: left.stick or right.stick}
"""


def test_controller_hears_simultaneous_events_once() -> None:
    model = interpret(read_text(SLIDING, "f.yaml"))
    assert isinstance(model, Scene)
    for found in (by_events(model), by_steps(model, 1e-3)):
        assert [j.cause for j in found.trace.jumps if j.region == "ctl"] == ["go"]
        assert found.trace.final_mode == ("pin", "pin", "b")


# A bar lies on one corner, which slides and turns fast, as the other corner lands.
STOPPED = """
kind: scene
name: stopped
gravity: 9.81
stop: {time: 0.26}
bodies:
  b:
    mass: 1.73
    inertia: 0.0272
    start: {x: 0.152, y: 0.4, dx: 0.223, dy: -0.322, angle: -0.273, dangle: 1.866}
surfaces: {ground: {line: [[0, 0], [0.998148, 0.060831]]}}
contacts:
  left:
    {point: {body: b, at: [-0.2, -0.1]}, surface: ground, friction: 0.384, restitution: 0,
    impact: moreau}
  right:
    {point: {body: b, at: [0.25, -0.1]}, surface: ground, friction: 0, restitution: 0,
    impact: moreau}
forces: {push: {body: b, force: [-2.615, 0]}}
"""


@pytest.mark.parametrize("h", [1e-4, 2e-5])
def test_corner_that_an_impact_stops_sticks_at_once(h: float) -> None:
    model = interpret(read_text(STOPPED, "f.yaml"))
    assert isinstance(model, Scene)
    for found in (by_events(model), by_steps(model, h)):
        assert [(j.region, j.target) for j in found.trace.jumps] == [
            ("left", ("slide-", "free")),
            ("right", ("pin", "slide")),
        ]


# A marble that rebounds comes to rest on the ground of a bowl, in which it takes 75 times its
# weight.
BOWL = """
kind: scene
name: bowl
gravity: 1
stop: {time: 0.4}
bodies: {b: {mass: 1, start: {x: 0, y: 0.002, dx: 6}}}
surfaces: {bowl: {height: x**2}}
contacts:
  c: {point: {body: b}, surface: bowl, friction: 0, restitution: 0.3, impact: moreau}
outputs: {bounces: {count: c.touchdown}}
"""


@pytest.mark.parametrize("h", [1e-3, 2.5e-4])
def test_fast_point_in_a_bowl_stops_bouncing(h: float) -> None:
    model = interpret(read_text(BOWL, "f.yaml"))
    assert isinstance(model, Scene)
    exact, found = by_events(model), by_steps(model, h)
    assert found.outputs["bounces"] == 3
    # The error of a step is of first order.
    np.testing.assert_allclose(found.trace.final, exact.trace.final, rtol=0, atol=2.0 * h)


def modes(trace: Trace) -> dict[str, list[tuple[float, str]]]:
    """Return the changes of each region; for modes without duration the end alone."""
    found: dict[str, list[tuple[float, str]]] = {name: [] for name in trace.regions}
    for place, (name, changes) in enumerate(found.items()):
        last, hit = trace.start_mode[place], False
        for k, jump in enumerate(trace.jumps):
            after = trace.jumps[k + 1].t if k + 1 < len(trace.jumps) else trace.t_end
            hit = hit or (last == "free" and name in jump.impulse)
            if after > jump.t:
                if hit or jump.target[place] != last:
                    changes.append((jump.t, jump.target[place]))
                last, hit = jump.target[place], False
    return found


def distinct(trace: Trace, apart: float) -> float:
    """Return until when the events of a run are so far apart."""
    times = [0.0, *sorted({jump.t for jump in trace.jumps}), trace.t_end]
    for before, after in pairwise(times):
        if 0.0 < after - before < apart:
            return before - 0.5 * apart
    return trace.t_end - 0.5 * apart


@pytest.mark.parametrize("seed", range(24))
def test_controllers_receive_events_of_thrown_bars(seed: int) -> None:
    simultaneous = ("plastic", "capped")[seed % 2]
    event = ("touchdown", "slip")[seed // 2 % 2]
    exact, found = (r.run(throw(seed)).trace for r in runners(simultaneous, event))
    until = distinct(exact, 80 * H)
    expected, seen = modes(exact), modes(found)
    for name, changes in expected.items():
        before = [change for change in changes if change[0] < until]
        there = [change for change in seen[name] if change[0] < until]
        assert [mode for _, mode in there] == [mode for _, mode in before], name
        for (t, _), (exact_t, _) in zip(there, before, strict=True):
            assert t == pytest.approx(exact_t, abs=40 * H)


_HANDED_OVER = """
kind: scene
name: track
parameters: {e: 0, mu: 0}
gravity: 9.81
bodies: {b: {mass: 1, start: {x: -1, y: 0.5}}}
surfaces:
  down: {edge: [[-2, 1], [0, 0]]}
  flat: {edge: [[0, 0], [1, 0]]}
  on: {edge: [[1, 0], [9, 0]]}
contacts:
  c1: {point: {body: b}, surface: down, friction: mu, restitution: e}
  c2: {point: {body: b}, surface: flat, friction: mu, restitution: e}
  c3: {point: {body: b}, surface: on, friction: mu, restitution: e}
regions:
  r:
    initial: first
    states: {first: {}, second: {}, third: {}}
    transitions:
      - {name: kink, from: first, to: second, on: c2.touchdown}
      - {name: seam, from: second, to: third, on: c3.touchdown}
stop: {time: 1.3}
outputs:
  kink: {value: time, at: first r.kink}
  seam: {value: time, at: first r.seam}
  enables: {count: enable}
  touchdowns: {count: touchdown}
"""


@pytest.mark.parametrize("record", ["modes", "nothing"])
def test_a_surface_that_takes_over_is_enabled_and_then_touched_as_with_events(record: str) -> None:
    text = read_text(_HANDED_OVER)
    slope = math.atan(0.5)
    kink = math.sqrt(2.0 * math.sqrt(1.25) / (9.81 * math.sin(slope)))
    # The plastic impact in the kink leaves the velocity along the flat.
    seam = kink + 1.0 / (math.sqrt(9.81) * math.cos(slope))
    exact = statechart.run(text)
    assert exact.outputs["kink"] == pytest.approx(kink, abs=1e-12)
    assert exact.outputs["seam"] == pytest.approx(seam, abs=1e-12)
    for h in (1e-3, 1e-4):
        run = statechart.run(text, engine="impulse", step=h, record=record)
        assert run.outputs["kink"] == pytest.approx(kink, abs=2 * h)
        assert run.outputs["seam"] == pytest.approx(seam, abs=4 * h)
        assert run.outputs["enables"] == run.outputs["touchdowns"] == 2
        if record == "modes":
            heard = [(jump.region, jump.cause) for jump in run.trace.jumps]
            assert heard[2:4] == [("c2", "touchdown"), ("r", "kink")]


BRAKED_BAR = """
kind: scene
name: bar
gravity: 9.81
simultaneous: plastic
bodies: {b: {mass: 2, inertia: 0.06, start: {x: 0.3, y: 0.165, angle: 0.2, dx: -2}}}
surfaces: {f: {line: [[0, 0], [0.998376, 0.056969]]}}
contacts:
  c: {point: {body: b, at: [-0.2, -0.1]}, surface: f, friction: %s, restitution: 0, impact: moreau}
  d: {point: {body: b, at: [0.25, -0.1]}, surface: f, friction: 0, restitution: 0, impact: moreau}
couplings: {brake: {bodies: [b], limit: 0.02}}
stop: {time: 0.25}
"""


@pytest.mark.parametrize("step", [1e-4, 1.25e-5])
def test_a_brake_locks_once_where_two_feet_hold_the_body(step) -> None:
    # On both feet the bar cannot turn: the rate that round-off of their gaps leaves is no slip.
    scene = interpret(read_text(BRAKED_BAR % 0))
    jumps = Runner(scene, engine="impulse", step=step).run().trace.jumps
    landed = next(j.t for j in jumps if j.region == "d")
    assert [j.cause for j in jumps] == ["touchdown", "touchdown", "lock"]
    assert jumps[-1].target[2] == "locked"
    assert jumps[-1].t <= landed + 3.0 * step


# The engines find the slip to accelerate by 0, 1e-33 or -1e-33.
@pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
@pytest.mark.parametrize("friction", [0.3, 0.139, 1.107])
def test_a_warning_names_a_brake_that_decides_how_feet_share_the_load(engine, friction) -> None:
    # Any couple within the limit agrees, and gives the foot with friction another load.
    step = {"step": 1e-4} if engine == "impulse" else {}
    scene = interpret(read_text(BRAKED_BAR % friction))
    warnings = Runner(scene, engine=engine, **step).run().warnings
    assert any("share the load" in warning for warning in warnings)
    if engine == "impulse":
        assert any("how c, d, brake share" in warning for warning in warnings)
    same = Runner(interpret(read_text(BRAKED_BAR % 0)), engine=engine, **step).run().warnings
    assert not any("share the load" in warning for warning in same)


# A plate sinks under a point, stops, and sinks again: in the instant in which it stops it strikes
# the point, and that comes before a guard that holds all the time.
STOPPING_PLATE = """
kind: scene
name: stopping_plate
gravity: 9.81
stop: {time: 0.15}
controls: {u: 0}
regions:
  plate:
    initial: sinks
    variables: {p: 0, n: 0}
    states: {stands: {sets: {u: 0}}, sinks: {sets: {u: 1}, flows: {p: 0.5}}}
    transitions:
    - {name: stop, from: sinks, to: stands, after: 0.1}
    - {name: hit, from: stands, to: sinks, on: c.touchdown, updates: {n: n + 1}}
    - {name: held, from: stands, to: sinks, guard: time >= 0}
bodies: {b: {mass: 1, start: {dx: 0.2, dy: -0.5}}}
surfaces: {plate: {line: [[0, 0], [1, 0]], displacement: [0, -p]}}
contacts: {c: {point: {body: b}, surface: plate, friction: 0, restitution: 0}}
outputs: {n: {value: n}}
"""


@pytest.mark.parametrize("h", [1e-3, 2.5e-4])
def test_a_surface_that_stops_strikes_before_guards_are_evaluated(h: float) -> None:
    model = interpret(read_text(STOPPING_PLATE, "f.yaml"))
    exact, found = by_events(model), by_steps(model, h)
    stopped = [("plate", "stop"), ("c", "touchdown"), ("plate", "hit")]
    for run, late in (exact, 0.0), (found, 2 * h):
        assert [(j.region, j.cause) for j in run.trace.jumps] == stopped
        assert run.outputs["n"] == 1.0
        fallen = -0.05 - 9.81 * 0.05**2 / 2
        assert run.trace.final[1] == pytest.approx(fallen, abs=1e-9 + 0.5 * late)


BRAKED_PLATE = """
kind: scene
name: braked_plate
gravity: 10
stop: {time: 0.5}
controls: {u: 0}
regions:
  plate:
    initial: goes
    variables: {p: 0}
    states: {stands: {sets: {u: 0}}, goes: {sets: {u: 1}, flows: {p: 1}}}
    transitions: [{name: stop, from: goes, to: stands, after: 0.1}]
bodies: {b: {mass: 1, start: {y: %s, dx: 1}}}
surfaces: {plate: {line: [[0, 0], [1, 0]], displacement: [p, 0]}}
contacts: {c: {point: {body: b}, surface: plate, friction: 0.5, %s}}
outputs: {slips: {count: c.slip}}
"""


@pytest.mark.parametrize(
    "law", [("0", "restitution: 0"), ("-0.005", "stiffness: 2000, damping: 20")]
)
def test_stopping_surface_lets_its_load_slide_in_the_same_jump(law) -> None:
    model = interpret(read_text(BRAKED_PLATE % law, "f.yaml"))
    for run, late in (by_events(model), 0.0), (by_steps(model, H), 2 * H):
        stop, stick = run.trace.jumps
        assert (stop.cause, stop.source[0], stop.target[0]) == ("stop", "pin", "slide+")
        assert (stick.cause, stick.target[0]) == ("stick", "pin")
        assert stick.t == pytest.approx(0.1 + 1 / 5, abs=1e-8 + late)
        assert run.trace.final[0] == pytest.approx(0.1 + 1 / 10, abs=1e-8 + late)
        assert run.outputs["slips"] == 1


def test_stepped_zeno_event_is_reported_as_unavailable():
    model = interpret(
        read_text("""
kind: scene
name: bounces
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 0.1}}}
surfaces: {floor: {height: 0}}
contacts:
  foot: {point: {body: ball}, surface: floor, friction: 0, modes: [free, slide], restitution: 0.5}
regions:
  r: {initial: a, states: {a: {}, b: {}}, transitions: [{name: t, from: a, to: b, on: foot.zeno}]}
outputs:
  rests: {value: time, at: first foot.zeno}
  slides: {value: time, at: first foot.slide}
  sequences: {count: foot.zeno}
stop: {time: 0.6}
""")
    )
    events, steps = by_events(model), by_steps(model, H)
    assert not [w for w in events.warnings if "event zeno" in w]
    found = [w for w in steps.warnings if w.startswith("event zeno of ")]
    assert len(found) == 1
    assert found[0].startswith("event zeno of outputs.rests, outputs.sequences, regions.r: ")
    # The state that it names is entered on both.
    assert steps.outputs["slides"] == pytest.approx(events.outputs["slides"], abs=0.01)
    assert events.outputs["rests"] == events.outputs["slides"]


def test_steps_warn_of_bounces_that_they_leave_out_and_a_controller_waits_for() -> None:
    text = """
kind: scene
name: counted
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 0.2}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0, restitution: E}}
regions:
  r:
    initial: one
    states: {one: {}, two: {}, three: {}, four: {}}
    transitions:
    - {name: first, from: one, to: two, on: c.touchdown}
    - {name: second, from: two, to: three, on: c.touchdown}
    - {name: third, from: three, to: four, on: c.touchdown}
stop: {time: 0.5}
"""
    model = interpret(read_text(text.replace("E", "0.03")))
    assert by_events(model).trace.final_mode[-1] == "four"
    coarse, fine = by_steps(model, 1e-3), by_steps(model, 1e-5)
    assert coarse.trace.final_mode[-1] != "four"
    assert len(coarse.warnings) == 1
    assert "and are left out, but r." in coarse.warnings[0]
    assert fine.trace.final_mode[-1] == "four"
    assert not fine.warnings
    plastic = by_steps(interpret(read_text(text.replace("E", "0"))), 1e-3)
    assert not plastic.warnings


# Two links come to rest between a stop of the first and the ground under the second.
LINKS = """
kind: scene
name: links
gravity: 9.81
bodies:
  b: {mass: 1, inertia: 0.02, start: {x: 0.25, y: 0.25*sin(-0.909), angle: -0.909}}
  c: {mass: 0.691, inertia: 0.01, start: {x: 0.5 + 0.25*cos(0.909), y: 0.5*sin(-0.909)}}
surfaces: {floor: {height: -0.871}}
contacts:
  tip:
    {point: {body: c, at: [0.25, 0]}, surface: floor, friction: 0.25, restitution: 0.157,
     impact: moreau}
joints:
  hook:
    {point: {body: b, at: [-0.25, 0]}, to: ['0.25*(1 - cos(0.909))', 0], limits: [-1.361, 1.151],
     restitution: 0.127}
  elbow: {point: {body: c, at: [-0.25, 0]}, to: {body: b, at: [0.25, 0]}}
regions:
  watch:
    initial: moves
    states: {moves: {}, rests: {}}
    transitions: [{name: rest, from: moves, to: rests, on: tip.EVENT}]
stop: {time: 0.6}
"""


def test_steps_warn_of_a_stick_at_the_end_of_bounces_that_a_controller_takes() -> None:
    model = interpret(read_text(LINKS.replace("EVENT", "stick")))
    assert by_events(model).trace.final_mode[-1] == "moves"
    found = by_steps(model, 1e-3)
    assert found.trace.final_mode[-1] == "rests"
    assert any("that watch.rest waits for; wait for tip.pin" in w for w in found.warnings)
    # The state that it names is entered on both.
    model = interpret(read_text(LINKS.replace("EVENT", "pin")))
    for result in (by_events(model), by_steps(model, 1e-3)):
        assert result.trace.final_mode[-1] == "rests"
        assert not any("wait for tip.pin" in warning for warning in result.warnings)


@pytest.mark.parametrize(("speed", "warns"), [(1.7, True), (1.75, True), (2.0, False)])
def test_bounces_that_steps_leave_out_last_longer_with_more_restitution(
    speed: float, warns: bool
) -> None:
    """The bounces end at 0.1 + 2 0.1 (0.8 + 0.8^2 + ...) = 0.9, and the slip at speed/2."""
    text = f"""
kind: scene
name: skids
gravity: 10
bodies: {{b: {{mass: 1, start: {{y: 0.05, dx: {speed}}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts:
  c: {{point: {{body: b}}, surface: floor, friction: 0.2, restitution: 0.8, impact: moreau}}
regions:
  r:
    initial: moves
    states: {{moves: {{}}, rests: {{}}}}
    transitions: [{{name: go, from: moves, to: rests, on: c.stick}}]
stop: {{time: 1.1}}
"""
    model = interpret(read_text(text))
    exact, found = statechart.run(model, engine="taylor"), by_steps(model, 2e-3)
    assert exact.trace.final_mode == ("pin", "moves" if speed < 1.8 else "rests")
    assert found.trace.final_mode == ("pin", "rests")
    assert any("wait for c.pin" in warning for warning in found.warnings) == warns


# A damper leads from a body that bounces to one that sticks: at the impact its force vanishes.
DAMPED = """
kind: scene
name: damped
gravity: 9.81
simultaneous: plastic
bodies: {a: {mass: 2, start: {x: 3}}, b: {mass: 1, start: {y: 0.1, dx: -0.05}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: a}, surface: floor, friction: 0.3, restitution: 0, impact: moreau}
  d: {point: {body: b}, surface: floor, friction: 0.9, restitution: 0.5, impact: moreau}
forces:
  f: {body: b, force: [-0.7*(b.dx - a.dx), 0]}
  g: {body: a, force: [0.7*(b.dx - a.dx), 0]}
outputs: {slips: {count: c.slip}, landings: {count: d.touchdown}}
stop: {time: 0.2}
"""


@pytest.mark.parametrize("h", [1e-3, 1e-4])
def test_an_impact_elsewhere_lets_no_pinned_contact_slip(h: float) -> None:
    model = interpret(read_text(DAMPED))
    assert by_events(model).outputs == {"slips": 0.0, "landings": 1.0}
    assert by_steps(model, h).outputs == {"slips": 0.0, "landings": 1.0}


# A hand that falls takes hold of a ball in the instant in which the ball rebounds.
CATCH = """
kind: scene
name: catch
gravity: 9.81
bodies: {hand: {mass: 2, start: {x: 0.5, y: 0.5}}, ball: {mass: 1, start: {y: 0.2}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: ball}, surface: floor, friction: 0.3, restitution: 0.4, impact: moreau}
joints: {j: {point: {body: ball}, to: {body: hand}, enabled: in(grip.shut), rest: captured}}
regions:
  grip:
    initial: open
    states: {open: {}, shut: {}}
    transitions: [{name: close, from: open, to: shut, on: c.touchdown}]
outputs: {landings: {count: c.touchdown}}
stop: {time: 0.5}
"""


@pytest.mark.parametrize("h", [1e-3, 1e-4])
def test_a_joint_that_closes_at_a_rebound_stops_it(h: float) -> None:
    model = interpret(read_text(CATCH))
    exact, found = by_events(model), by_steps(model, h)
    assert exact.trace.final[3] == pytest.approx(0.0, abs=1e-9)
    assert len(found.trace.jumps) == len(exact.trace.jumps)
    np.testing.assert_allclose(found.trace.final, exact.trace.final, rtol=0, atol=4 * h)


PRESSED = """
kind: scene
name: pressed
gravity: 0
bodies: {b: {mass: 1, inertia: 1}, c: {mass: 1, inertia: 1, start: {x: 2, dangle: 1}}}
joints: {pin: {point: {body: b}, to: [0, 0], limits: [0, 1], restitution: 0}}
forces: {press: {body: b, moment: -5}, drive: {body: c, moment: -1.05}}
couplings: {rub: {bodies: [b, c], limit: 1}}
stop: {time: 1}
"""


@pytest.mark.parametrize("step", [1e-3, 1e-4, 1e-5])
def test_a_slip_that_passes_zero_slowly_beside_a_loaded_stop_does_not_lock(step) -> None:
    # The moment of 1.05 stops the slip after 1/2.05 and turns it against the limit of 1.
    jumps = Runner(interpret(read_text(PRESSED)), engine="impulse", step=step).run().trace.jumps
    assert [(j.region, j.cause) for j in jumps] == [("rub", "reverse")]
    assert jumps[0].t == pytest.approx(1 / 2.05, abs=2.0 * step)


CORNER = """
kind: scene
name: corner
gravity: 9.81
bodies: {b: {mass: 1, start: {dx: 1}}}
surfaces: {floor: {height: 0}, wall: {line: [[0.1, -1], [0.1, 1]]}}
contacts:
  foot: {point: {body: b}, surface: floor, friction: 0.1, restitution: 0}
  side: {point: {body: b}, surface: wall, friction: 0.5, restitution: 0}
forces: {press: {body: b, force: [30, 0]}}
stop: {time: 0.3}
"""


@pytest.mark.parametrize("step", [1e-3, 1e-4])
def test_a_contact_that_an_impact_at_a_wall_leaves_without_load_stays_closed(step) -> None:
    # Friction of 15 at the wall could carry the weight of 9.81 alone.
    model = interpret(read_text(CORNER))
    for run, late in (by_events(model), 0.0), (by_steps(model, step), step):
        first, *others = run.trace.jumps
        assert (first.region, first.cause) == ("side", "touchdown")
        assert not [j for j in run.trace.jumps if "free" in j.target]
        assert [j.cause for j in others] in ([], ["stick"])
        assert all(j.t <= first.t + late for j in others)
        assert run.trace.final_mode == ("pin", "pin")


RESTING = """
kind: scene
name: resting
gravity: 10
parameters: {high: 1}
bodies: {a: {mass: 1, start: {dx: 1}}, b: {mass: 1, start: {dx: 1, y: high}}}
surfaces: {floor: {height: 0}, shelf: {height: 1}}
contacts:
  slides: {point: {body: a}, surface: floor, friction: 0.5, restitution: 0}
  gated: {point: {body: b}, surface: shelf, friction: 0.5, restitution: 0, enabled: RELATION}
stop: {time: 0.5}
outputs: {height: {value: b.y}}
"""


@pytest.mark.parametrize("step", [1e-3, 7e-4])
@pytest.mark.parametrize(
    ("relation", "high", "height"), [("b.dx > 0", 1.0, 0.55), ("a.dx <= 0", 1.5, 1.0)]
)
def test_a_relation_decides_where_friction_stops_a_rate_at_zero(
    relation: str, high: float, height: float, step: float
) -> None:
    """A strict relation went on holding at zero, and the other one never began to hold."""
    model = interpret(read_text(RESTING.replace("RELATION", relation)))
    for options in ({"engine": "scipy"}, {"engine": "impulse", "step": step}):
        found = statechart.run(model, parameters={"high": high}, **options)
        assert found.outputs["height"] == pytest.approx(height, abs=0.01)


SLOWED = """
kind: scene
name: slowed
gravity: 10
parameters: {tilt: 0, belt: 0.5, start: 1}
bodies: {b: {mass: 1, start: {dx: start*cos(tilt), dy: start*sin(tilt)}}}
surfaces:
  floor: {line: [[0, 0], [cos(tilt), sin(tilt)]], displacement: [belt*time*cos(tilt), 0]}
contacts:
  c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0, enabled: RELATION}
stop: {time: 1}
outputs: {off: {value: time, at: first c.disable}}
"""


@pytest.mark.parametrize("step", [1e-3, 7e-4, 1e-4])
@pytest.mark.parametrize(
    ("relation", "tilt", "belt", "start"),
    [
        ("b.dx > belt", 0.0, 0.5, 1.0),
        ("b.dx/belt > 1", 0.0, 0.5, 1.0),
        ("b.dx > belt", 0.0, 0.3, 0.9),
        ("b.dx > belt", -0.2, 0.0, 0.7),
    ],
)
def test_a_strict_relation_fails_where_friction_leaves_a_rate_at_its_bound(
    relation: str, tilt: float, belt: float, start: float, step: float
) -> None:
    """The rate rests 1e-17 above the bound, or below it: the step decided whether b falls."""
    values = {"tilt": tilt, "belt": belt, "start": start}
    model = interpret(read_text(SLOWED.replace("RELATION", relation)))
    run = statechart.run(model, parameters=values, engine="impulse", step=step)
    deceleration = 10 * (0.5 * math.cos(tilt) + math.sin(tilt))
    assert run.outputs["off"] == pytest.approx((start - belt) / deceleration, abs=1.01 * step)


LIFTED = """
kind: scene
name: lifted
gravity: 0
bodies: {b: {mass: 1, start: {y: 1, dx: 1}}}
surfaces: {floor: {height: 0, displacement: [0, lift]}}
controls: {lift: 0}
regions:
  r: {initial: low, states: {low: {}, high: {sets: {lift: 0.1}}}, transitions: [
    {name: up, from: low, to: high, after: 0.5}]}
stop: {time: 1}
"""


def test_a_controller_lifts_a_floor_that_nothing_touches() -> None:
    run = statechart.run(interpret(read_text(LIFTED)), engine="impulse", step=1e-2)
    assert run.trace.final[:2] == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize(
    ("relation", "warns"),
    [
        ("abs(b.x - 2.5) <= 0 and b.dx > 0", True),
        ("0 >= abs(b.x - 2.5)", True),
        ("b.x >= 2.5 and b.x <= 2.5", True),
        ("b.x >= 2.5 and b.dx > 0 and not (2*b.x > 5)", True),
        ("max(b.x - 2.5, 2.5 - b.x) <= 0", True),
        ("abs(b.x - 2.5) <= nothing", True),
        ("(b.x - 2.5)**2 <= 0", True),
        ("b.x >= 2.5 and b.x <= 2.6", False),
        ("b.x >= 2.5 or b.x <= -2.5", False),
        ("b.x >= 2.5 and b.y <= 2.5", False),
        ("b.x >= 2.5", False),
        ("abs(b.dy) <= 0", False),
        ("abs(b.x - 2.5) <= 0 or b.x < -1", True),
        ("abs(sign(b.x - 2.5)) <= 0 or b.x < -1", True),
        ("(1 + sign(b.x - 2.5))*(b.x + 1) + (1 - sign(b.x - 2.5))*b.x > 5.5", False),
        ("(1 + sign(b.x - 2.5))*b.x > 4", False),
    ],
)
@pytest.mark.parametrize("guarded", [False, True])
def test_steps_warn_of_an_instant_that_they_pass_over(
    relation: str, warns: bool, guarded: bool
) -> None:
    watch = (
        f"stop: {{time: 1.5}}\nregions: {{r: {{initial: a, states: {{a: {{}}, b: {{}}}}, "
        f"transitions: [{{name: go, from: a, to: b, guard: '{relation}'}}]}}}}\n"
        if guarded
        else f"stop: {{time: 1.5, conditions: {{there: '{relation}'}}}}\n"
    )
    text = (
        "kind: scene\nname: passing\ngravity: 9.81\n"
        "parameters: {nothing: 0}\n"
        f"bodies: {{b: {{mass: 1, start: {{y: 1, dx: 2, dy: 1}}}}}}\n{watch}"
    )
    model = interpret(read_text(text, "passing.yaml"))
    passes = "steps pass over the instant"
    trace = statechart.run(model, engine="impulse", step=1e-3).trace
    assert any(passes in warning for warning in trace.warnings) == warns
    trace = statechart.run(model, engine="scipy").trace
    assert not any(passes in warning for warning in trace.warnings)
    if "b.x" in relation and "**" not in relation:
        assert trace.jumps[-1].t == pytest.approx(1.25, abs=1e-9)


def test_a_joint_that_closes_at_an_instant_only_is_reported_at_its_place() -> None:
    text = """
kind: scene
name: passing
gravity: 10
bodies: {b: {mass: 1}}
joints: {j: {point: {body: b}, to: {x: 0}, enabled: abs(time) <= 0}}
stop: {time: 0.01}
"""
    result = statechart.run(read_text(text), engine="impulse", step=1e-3)
    (warning,) = result.warnings
    assert warning.startswith("joints.j.enabled: steps pass over the instant")


@pytest.mark.parametrize(
    ("guard", "span"),
    [
        ("b.x >= 0.70003 and b.x <= 0.70007", True),
        ("b.x > 0.70003 and not time >= 0.70007 and in(r.a)", True),
        ("abs(b.x - 0.70005) <= 2e-5", True),
        ("b.x >= 0.70007 and b.x <= 0.70003", False),
        ("b.x >= 0.7515 and b.y <= 0.0001", False),  # b rebounds from the floor at 0.75.
    ],
)
@pytest.mark.parametrize("stops", [False, True])
def test_steps_warn_of_relations_that_are_true_within_a_step_only(
    guard: str, span: bool, stops: bool
) -> None:
    text = f"""
kind: scene
name: passing
parameters: {{g: 10}}
gravity: g
bodies: {{b: {{mass: 1, start: {{y: g*0.75**2/2, dx: 1}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{c: {{point: {{body: b}}, surface: floor, friction: 0, restitution: 1}}}}
regions:
  r:
    initial: a
    states: {{a: {{}}, b: {{}}}}
    transitions: [{{name: go, from: a, to: b, guard: "{guard}"}}]
stop: {{time: 0.8}}
"""
    if stops:
        text = re.sub("transitions: .*", "transitions: []", text)
        text = text.replace("time: 0.8", f"time: 0.8, conditions: {{go: '{guard}'}}")
    model = interpret(read_text(text))
    coarse, fine = by_steps(model, 1e-3), by_steps(model, 1e-5)
    assert [jump.cause for jump in coarse.trace.jumps] == ["touchdown"]
    words = f"{'' if stops else 'r.'}go is true within the step of 0.001 at t = 0.7, at neither end"
    assert [w.split(":")[0] for w in coarse.warnings if "within" in w] == [words] * span
    assert not any("within the step" in w for w in fine.warnings)
    assert [jump.t for jump in fine.trace.jumps if jump.cause in ("go", "stop")] == (
        [pytest.approx(0.70003, abs=2.1e-5)] if span else []
    )


@pytest.mark.parametrize("step", [1e-3, 7e-4])
@pytest.mark.parametrize(
    ("place", "n", "counted"),
    [("time", 0, "up"), ("b.x", 0, "up"), ("1 - b.x**2", 3, "down")],
)
def test_steps_do_not_warn_where_a_transition_moves_the_guard_that_it_crosses(
    place: str, n: int, counted: str, step: float
) -> None:
    # A place is counted up where it reaches n + 1, down where it falls below n.
    text = f"""
kind: scene
name: counts
bodies: {{b: {{mass: 1, start: {{dx: 0.95}}}}}}
regions:
  r:
    variables: {{n: {n}}}
    initial: on
    states: {{on: {{}}}}
    transitions:
      - {{name: up, from: on, guard: {place} >= (n + 1)*T, updates: {{n: n + 1}}}}
      - {{name: down, from: on, guard: {place} < n*T, updates: {{n: n - 1}}}}
parameters: {{T: 0.3}}
stop: {{time: 1}}
"""
    run = by_steps(interpret(read_text(text)), step)
    assert [jump.cause for jump in run.trace.jumps] == [counted] * 3
    assert not run.warnings


@pytest.mark.parametrize("guard", ["abs(b.dy) <= 0", "b.dy <= 0 and b.dy >= 0"])
@pytest.mark.parametrize(("speed", "start"), [(4.003, "0.4"), (4.0, "0.399")])
def test_steps_warn_of_relations_that_are_true_at_an_instant_only(
    guard: str, speed: float, start: str
) -> None:
    # The summit is at 0.4003 or 0.4, within a step or at its end.
    text = f"""
kind: scene
name: summit
gravity: 10
bodies: {{b: {{mass: 1, start: {{dy: {speed}}}}}}}
regions:
  r:
    initial: a
    states: {{a: {{}}, b: {{}}}}
    transitions: [{{name: top, from: a, to: b, guard: "{guard}"}}]
stop: {{time: 1}}
"""
    model = interpret(read_text(text))
    [jump] = statechart.run(model).trace.jumps
    assert jump.t == pytest.approx(speed / 10, abs=1e-12)
    [warning] = [w for w in by_steps(model, 1e-3).warnings if "within" in w]
    assert warning.startswith(f"r.top is true within the step of 0.001 at t = {start}, at neither")


PASSING = """
kind: scene
name: passing
gravity: 0
bodies: {b: {mass: 1, start: {dx: 1}}}
regions:
  r:
    initial: a
    states: {a: {}, b: {}}
    transitions: [{name: go, from: a, to: b, guard: "GUARD"}]
stop: {time: 0.72}
"""


@pytest.mark.parametrize(
    "guard",
    [
        "b.x >= 0.6995 and b.x <= 0.7007",
        "b.x >= 0.6995 and b.x <= 0.7013",
        "time >= 0.69995 and time <= 0.70007",
        "abs(b.x - 0.70005) <= 6e-5",
        "mod(time, 0.35) <= 4e-4 and b.x > 0.6",  # A wrap of mod turns it true.
    ],
)
def test_a_guard_that_is_true_at_the_end_of_one_step_only_fires(guard: str) -> None:
    model = interpret(read_text(PASSING.replace("GUARD", guard)))
    exact, found = statechart.run(model, engine="taylor"), by_steps(model, 1e-3)
    [due], [jump] = ([j for j in run.trace.jumps if j.cause == "go"] for run in (exact, found))
    assert due.t == pytest.approx(0.7, abs=1e-3)
    assert jump.t == pytest.approx(0.7, abs=1e-9)
    assert not any("within the step" in warning for warning in found.warnings)


# A ball far away rebounds at 0.6995, within the same step.
BESIDE_A_BALL = PASSING.replace(
    "start: {dx: 1}}}",
    """start: {dx: 1}}, ball: {mass: 1, start: {x: 5, y: 0.6995, dy: -1}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: ball}, surface: floor, friction: 0, restitution: 1}}""",
)


@pytest.mark.parametrize(
    ("guard", "due"),
    [
        ("b.x >= 0.6995 and b.x <= 0.7007", 0.7),
        ("b.x >= 0.6995 and b.x <= 0.7007 and b.dx > 0 and ball.y < 0.1", 0.7),
        ("b.x >= 0.69955 and b.x <= 0.69985", math.nan),  # within the step
    ],
)
@pytest.mark.parametrize("stops", [False, True])
def test_an_impact_elsewhere_hides_no_guard(guard: str, due: float, stops: bool) -> None:
    text = BESIDE_A_BALL.replace("GUARD", "time > 9" if stops else guard)
    if stops:
        text = text.replace("0.72}", f"0.72, conditions: {{go: {guard}}}}}")
    model = interpret(read_text(text))
    exact, found = statechart.run(model, engine="taylor"), by_steps(model, 1e-3)
    assert [j.cause for j in exact.trace.jumps] == ["touchdown", "stop" if stops else "go"]
    assert any("true within the step" in w for w in found.warnings) == math.isnan(due)
    times = [jump.t for jump in found.trace.jumps if jump.cause in ("go", "stop")]
    # A stop is located within its step.
    late = 1e-3 if stops else 1e-9
    assert times == ([] if math.isnan(due) else [pytest.approx(due, abs=late)])


@pytest.mark.parametrize(
    "guard", ["b.x >= 0.6998 and ball.y <= 0.0001", "b.x >= 0.6996 and ball.y < 0"]
)
def test_a_guard_that_the_motion_turns_back_from_does_not_fire(guard: str) -> None:
    """The ball is at 0.0003 and at 0.0001 when b passes: a landing depth must not count."""
    found = by_steps(interpret(read_text(BESIDE_A_BALL.replace("GUARD", guard))), 1e-3)
    assert [jump.cause for jump in found.trace.jumps] == ["touchdown"]
    assert not any("within" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("guard", "due"),
    [
        ("b.x >= 0.1005 and b.x <= 0.1017", 0.101),
        ("b.x >= 0.0995 and b.x <= 0.1015", 0.101),  # The impact comes first.
        ("b.x >= 0.1003 and b.x <= 0.1007", None),
    ],
)
def test_a_moved_surface_that_strikes_hides_no_guard(guard: str, due: float | None) -> None:
    text = f"""
kind: scene
name: lifted
gravity: 10
bodies: {{b: {{mass: 1, start: {{y: 1, dx: 1}}}}, block: {{mass: 1, start: {{x: 5}}}}}}
surfaces: {{floor: {{height: 0, displacement: [0, s]}}}}
contacts: {{c: {{point: {{body: block}}, surface: floor, friction: 0, restitution: 0}}}}
regions:
  m:
    initial: low
    variables: {{s: 0}}
    states: {{low: {{}}, rises: {{flows: {{s: 1}}}}}}
    transitions: [{{name: up, from: low, to: rises, after: 0.1}}]
  r:
    initial: a
    states: {{a: {{}}, b: {{}}}}
    transitions: [{{name: go, from: a, to: b, guard: "{guard}"}}]
stop: {{time: 0.11}}
"""
    model = interpret(read_text(text))
    exact, found = statechart.run(model, engine="taylor"), by_steps(model, 1e-3)
    assert sorted(j.cause for j in exact.trace.jumps) == ["go", "touchdown", "up"]
    times = [jump.t for jump in found.trace.jumps if jump.cause == "go"]
    assert times == ([] if due is None else [pytest.approx(due, abs=1e-9)])
    assert any("true within the step" in w for w in found.warnings) == (due is None)


def test_margins_at_zero_within_round_off_cross_within_their_step() -> None:
    """They drift by 1e-17 in a step: in steps before it they would be zero."""
    bodies = "{b: {mass: 1, start: {x: 1e-17, y: -3e-17, dx: 1e-14, dy: -1e-14}}, "
    text = f"""
kind: scene
name: drifting
gravity: 0
bodies: {bodies}far: {{mass: 1, start: {{x: 1, dy: 1}}}}}}
stop: {{time: 0.01, conditions: {{go: b.x <= 0 and b.y <= 0 and time <= 0.0005}}}}
"""
    assert not by_steps(interpret(read_text(text)), 1e-3).warnings


def test_guards_that_are_true_at_the_end_of_one_step_only_fire_in_their_order() -> None:
    text = PASSING.replace("GUARD", "b.x >= 0.6995 and b.x <= 0.7007")
    again = text[text.index("  r:") : text.index("stop:")].replace("  r:", "  s:")
    model = interpret(read_text(text.replace("stop:", again + "stop:")))
    jumps = by_steps(model, 1e-3).trace.jumps
    assert [(jump.region, jump.t) for jump in jumps] == [
        (region, pytest.approx(0.7, abs=1e-9)) for region in "rs"
    ]


# At 0.7 it ends at the bound.
@pytest.mark.parametrize("stops", [False, True])
def test_steps_warn_of_relations_that_end_with_a_step(stops: bool) -> None:
    text = PASSING.replace("GUARD", "b.x >= 0.6997 and b.x <= 0.7")
    if stops:
        text = re.sub("transitions: .*", "transitions: []", text).replace(
            "0.72}", "0.72, conditions: {go: b.x >= 0.6997 and b.x <= 0.7}}"
        )
    found = by_steps(interpret(read_text(text)), 1e-3)
    assert found.trace.jumps or any("true within the step" in w for w in found.warnings)


@pytest.mark.parametrize("early", [0.6955, 0.70001, 0.70006])
@pytest.mark.parametrize("stops", [False, True])
def test_steps_warn_of_nothing_after_the_end_of_a_run(early: float, stops: bool) -> None:
    go = "b.x >= 0.70003 and b.x <= 0.70007"
    text = PASSING.replace("GUARD", "time > 9" if stops else go)
    conditions = f"early: b.x >= {early}" + (f", go: {go}" if stops else "")
    text = text.replace("0.72}", f"0.72, conditions: {{{conditions}}}}}")
    found = by_steps(interpret(read_text(text)), 1e-3)
    assert found.trace.t_end == pytest.approx(early, abs=1e-9)
    assert any("true within the step" in w for w in found.warnings) == (early > 0.70005)


# A hand closes on a point that rebounds, with a motor that is stronger than its friction.
GRIPPED = """
kind: scene
name: gripped
gravity: 9.81
bodies: {a: {mass: 2, start: {x: 0.5, y: 0.4, dy: -1}}, b: {mass: 1, start: {y: 0.2}}}
surfaces: {floor: {height: 0}}
contacts: {d: {point: {body: b}, surface: floor, friction: 0.3, restitution: 0.4, impact: moreau}}
joints: {j: {point: {body: b}, to: {body: a}, enabled: in(hand.shut), rest: captured}}
controls: {push: 0}
forces: {motor: {body: a, force: [push, 2*9.81 + 0.4*push]}}
regions:
  hand:
    initial: open
    states: {open: {}, shut: {sets: {push: F}}}
    transitions: [{name: close, from: open, to: shut, on: d.touchdown}]
stop: {time: 0.4}
"""


@pytest.mark.parametrize(("force", "mode"), [(1, "pin"), (4, "slide+")])
def test_a_joint_that_closes_on_a_rebound_leaves_the_mode_that_forces_decide(
    force: float, mode: str
) -> None:
    scene = interpret(read_text(GRIPPED.replace("F}", f"{force}}}")))
    for options in ({"engine": "taylor"}, {"engine": "impulse", "step": 1e-4}):
        jumps = statechart.run(scene, **options).trace.jumps
        assert [(jump.region, jump.cause) for jump in jumps] == [
            ("d", "touchdown"), ("hand", "close"), ("j", "enable"),
        ]  # fmt: skip
        assert jumps[-1].target[0] == mode


SEIZED = """
kind: scene
name: seized
gravity: 10
bodies: {a: {mass: 2, start: {x: 0.5, y: 0.4}}, b: {mass: 1, start: {dx: 2}}}
surfaces: {floor: {height: 0}}
contacts:
  d: {point: {body: b}, surface: floor, friction: {static: 0.6, kinetic: 0.3}, restitution: 0}
joints: {j: {point: {body: b}, to: {body: a}, enabled: time >= 0.1, rest: captured}}
stop: {time: 0.1}
"""


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_a_joint_that_closes_on_a_sliding_body_brakes_it_by_kinetic_friction(engine: str) -> None:
    options = {"step": 1e-3} if engine == "impulse" else {}
    jump = statechart.run(read_text(SEIZED), engine=engine, **options).trace.jumps[0]
    # Before, a falls at 1 and b slides at 1.7.
    assert jump.impulse["d"] == pytest.approx((2 * 1, -0.3 * 2 * 1), rel=1e-9)
    speed = (1.7 - 0.3 * 2 * 1) / (2 + 1)
    np.testing.assert_allclose(jump.after[4:8], [speed, 0, speed, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("body", ["inertia: 1", "inertia: 1, shape: {disc: 0.1}"])
@pytest.mark.parametrize("slips", [True, False])
def test_a_brake_that_closes_on_a_small_slip_locks_in_an_event_of_its_own(
    body: str, slips: bool
) -> None:
    """A wheel decays to s = exp(-10), which a brake of M = 2 stops ln(1 + 40 s/2)/40 later."""
    text = f"""
kind: scene
name: braked
gravity: 0
bodies: {{wheel: {{mass: 1, {body}, start: {{dangle: 1}}}}}}
{"collisions: {all: {bodies: [wheel], friction: 0, restitution: 0}}" if "shape" in body else ""}
forces: {{drag: {{body: wheel, moment: -40*wheel.dangle}}}}
couplings: {{brake: {{bodies: [wheel], limit: 2, enabled: time >= {0.25 if slips else 0.9}}}}}
regions:
  control:
    initial: waiting
    states: {{waiting: {{}}, heard: {{}}}}
    transitions: [{{name: hear, from: waiting, to: heard, on: brake.lock}}]
stop: {{time: 1}}
"""
    model, slip = interpret(read_text(text)), math.exp(-10.0)
    causes = ["close", "lock", "hear"] if slips else ["close"]
    if "shape" not in body:
        for engine in ("taylor", "scipy"):
            jumps = Runner(model, engine=engine, tolerance=1e-13).run().trace.jumps
            assert [jump.cause for jump in jumps] == causes
            for jump in jumps[1:]:
                lock = math.log1p(40.0 * slip / 2.0) / 40.0
                assert jump.t - 0.25 == pytest.approx(lock, rel=1e-6)
    for step in (1e-3, H):
        jumps = by_steps(model, step).trace.jumps
        assert [jump.cause for jump in jumps] == causes
        assert jumps[-1].t == pytest.approx(0.25 if slips else 0.9, abs=3.0 * step)


@pytest.mark.parametrize("landing", [0.2505, 0.2515, 0.3])
@pytest.mark.parametrize("shape", ["", "{disc: 0.1}"])
def test_a_strike_elsewhere_hides_no_slip_of_a_closing_brake(landing: float, shape: str) -> None:
    """The brake closes at 0.25 and locks in the step to 0.251; a ball falls beside its wheel."""
    text = f"""
kind: scene
name: struck
gravity: 9.81
bodies:
  wheel: {{mass: 1, inertia: 1, start: {{x: 5, y: 5, dangle: {math.exp(-10.0)!r}}}}}
  ball: {{mass: 1, inertia: 1, start: {{y: {0.5 * 9.81 * landing**2!r}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{tip: {{point: {{body: ball}}, surface: floor, friction: 0, restitution: 0.5}}}}
joints: {{axle: {{point: {{body: wheel}}, to: [5, 5]}}}}
couplings: {{brake: {{bodies: [wheel], limit: 2, enabled: time >= 0.25}}}}
stop: {{time: 0.32}}
"""
    if shape:
        text = re.sub("contacts: .*", "", text).replace("mass: 1", f"mass: 1, shape: {shape}")
        text = text.replace("start: {y: ", "start: {y: 0.1 + ")
        text += (
            "collisions: {a: {bodies: [ball], surfaces: [floor], restitution: 0.5, friction: 0}}"
        )
    jumps = by_steps(interpret(read_text(text)), 1e-3).trace.jumps
    locks = [(jump.t, jump.cause) for jump in jumps if jump.region == "brake"]
    assert locks == [(pytest.approx(0.25), "close"), (pytest.approx(0.251), "lock")]
    (touchdown,) = (jump.t for jump in jumps if jump.cause == "touchdown")
    assert touchdown == pytest.approx(landing, abs=1.1e-3)


@pytest.mark.parametrize("compliant", [True, False])
def test_a_compliant_contact_lands_before_it_sticks(compliant: bool) -> None:
    """Its force begins at zero and stops no slip at once, while an impact does."""
    law = "stiffness: 1000, damping: 20" if compliant else "restitution: 0"
    text = f"""
kind: scene
name: landing
gravity: 9.81
bodies: {{point: {{mass: 1, start: {{y: 0.01, dx: 1e-8}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{tip: {{point: {{body: point}}, surface: floor, friction: 0.5, {law}}}}}
stop: {{time: 0.05}}
"""
    model = interpret(read_text(text))
    causes = ["touchdown", "stick"] if compliant else ["touchdown"]
    for result in (Runner(model, engine="taylor").run(), by_steps(model, 1e-3)):
        assert [jump.cause for jump in result.trace.jumps] == causes
        assert result.trace.jumps[-1].t == pytest.approx(math.sqrt(0.02 / 9.81), abs=3e-3)


# A load that falls and moves joins a block, whose foot slides or rests on the floor.
JOINED = """
kind: scene
name: joined
gravity: 10
bodies:
  block: {mass: 2, start: {dx: BLOCK}}
  load: {mass: 1, inertia: 1, start: {y: 1, dx: LOAD, dy: -1}}
surfaces: {floor: {height: 0}}
contacts:
  foot:
    {point: {body: block}, surface: floor, friction: {static: 0.8, kinetic: 0.2}, restitution: 0,
    impact: moreau}
joints: {hook: {point: {body: load}, to: {body: block}, rest: captured, enabled: time >= 0.1}}
forces: {lift: {body: load, force: [0, 10]}}
stop: {time: 0.11}
"""


@pytest.mark.parametrize(
    ("block", "load"),
    [(2.0, 0.5), (-1.0, 0.5), (-0.35, 0.4), (-0.3, 1.2), (0.0, 1.2), (0.0, 0.5), (0.0, 0.1)],
)
def test_a_joint_that_closes_meets_kinetic_friction(block: float, load: float) -> None:
    """The floor takes the momentum 1 of the fall, and friction up to 0.2 along itself."""
    model = interpret(read_text(JOINED.replace("BLOCK", f"{block}").replace("LOAD", f"{load}")))
    braked = math.copysign(max(abs(block) - 0.2 * 10.0 * 0.1, 0.0), block)
    momentum = 2.0 * braked + load
    speed = math.copysign(max(abs(momentum) - 0.2, 0.0), momentum) / 3.0
    for result in (Runner(model, engine="taylor").run(), by_steps(model, 1e-3)):
        [closing] = [jump for jump in result.trace.jumps if jump.cause == "enable"]
        after = dict(zip(result.trace.variables, closing.after.tolist(), strict=True))
        assert after["block.dx"] == pytest.approx(speed, abs=1e-9)
        assert after["load.dx"] == pytest.approx(speed, abs=1e-9)
        assert closing.impulse["foot"][0] == pytest.approx(1.0, abs=1e-9)
        slides = {1.0: "slide+", -1.0: "slide-", 0.0: "pin"}
        assert closing.target[0] == slides[float(np.sign(round(speed, 12)))]
        assert result.trace.jumps[-1].cause == "enable"


@pytest.mark.parametrize("foot", ["restitution: 0", "stiffness: 1000, damping: 20"])
@pytest.mark.parametrize(
    ("block", "load", "place", "mode"),
    [
        ("{}", "dx: 1.2", "body: load}, to: {body: block}", "slide+"),
        ("{}", "dx: -1.2", "body: load}, to: {body: block}", "slide-"),
        ("{}", "dy: 1", "body: load}, to: {body: block}", "free"),
        ("{dx: 1.5}", "dx: 0", "body: block}, to: [0, 0]", "pin"),
    ],
)
def test_a_joint_that_closes_without_an_impulse_of_the_floor_decides_its_mode(
    foot: str, block: str, load: str, place: str, mode: str
) -> None:
    """The load shares its momentum with the block, or the world stops the block."""
    text = JOINED.replace("restitution: 0,\n    impact: moreau", foot)
    text = text.replace("{dx: BLOCK}", block).replace("dx: LOAD, dy: -1", load)
    text = text.replace("body: load}, to: {body: block}", place)
    if foot.startswith("stiffness"):
        # It rises from the depth of its weight and still touches: 1000 0.02 > 20/3.
        text = text.replace(f"start: {block}", f"start: {{y: -0.02, {block[1:]}")
        text, mode = text.replace("y: 1,", "y: 0.98,"), {"free": "pin"}.get(mode, mode)
    for result in (
        Runner(interpret(read_text(text)), engine="taylor").run(),
        by_steps(interpret(read_text(text)), 1e-3),
    ):
        [closing] = [jump for jump in result.trace.jumps if jump.cause == "enable"]
        assert not closing.impulse
        assert closing.target[0] == mode


def test_a_contact_that_a_joint_lifts_flies_in_the_next_steps() -> None:
    """It rises at 0.03/3 and falls at 20/3: it is back after 2 0.01 3/20 = 0.003."""
    text = JOINED.replace("{dx: BLOCK}", "{}").replace("dx: LOAD, dy: -1", "dy: 0.03")
    found = by_steps(interpret(read_text(text)), 1e-3)
    assert [(jump.cause, jump.t) for jump in found.trace.jumps] == [
        ("enable", pytest.approx(0.1, abs=1e-9)),
        ("touchdown", pytest.approx(0.103, abs=1.1e-3)),
    ]


@pytest.mark.parametrize("step", [1e-3, 2.5e-4])
def test_a_joint_that_closes_on_its_bound_stays_closed(step):
    """A door snaps shut up to a step late: the closing brings it onto the bound of its relation."""
    text = f"""
    kind: scene
    name: door
    gravity: 0
    bodies:
      door: {{mass: 20, inertia: 1, start: {{x: 0.4*cos(0.8), y: 0.4*sin(0.8), angle: 0.8}}}}
    joints:
      hinge: {{point: {{body: door, at: [-0.4, 0]}}, to: [0, 0]}}
      latch: {{point: {{body: door, at: [0.4, 0]}}, to: {{y: 0}}, enabled: door.angle <= 0}}
    forces: {{closer: {{body: door, moment: -8*(door.angle + 0.2)}}}}
    stop: {{time: 1.2}}
    settings: {{engine: impulse, step: {step}}}
    outputs: {{Y: {{value: latch.Y}}}}
    """
    result = Runner(interpret(read_text(text))).run()
    assert [jump.cause for jump in result.trace.jumps] == ["enable"]
    assert abs(result.trace.final[2]) < 1e-12
    # The moment of the closer at rest, over the width of the door.
    assert result.outputs["Y"] == pytest.approx(8.0 * 0.2 / 0.8, rel=1e-9)
