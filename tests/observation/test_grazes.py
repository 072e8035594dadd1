"""Guards that touch their boundary, or nearly: by hand it is known whether they pass."""

from __future__ import annotations

import math
from typing import Any

import pytest
from scipy.special import ellipk

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret

pytestmark = pytest.mark.parametrize("engine", ["taylor", "scipy"])

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14)
# It rises to 5 + e, with a ceiling at 5.
_THROWN = """
kind: scene
name: thrown
parameters: {g: 10, e: 0}
gravity: g
bodies: {b: {mass: 1, start: {dx: 3, dy: sqrt(2*g*(5 + e))}}}
surfaces: {ceiling: {line: [[9, 5], [-9, 5]]}}
contacts: {c: {point: {body: b}, surface: ceiling, friction: 0.3, restitution: 0.5}}
stop: {time: 2}
outputs: {hits: {count: c.touchdown}}
"""
# Its x is sin(2 t).
_SWINGS = """
kind: scene
name: swings
parameters: {e: 0}
gravity: 0
bodies: {b: {mass: 1, start: {dx: 2}}}
surfaces: {}
contacts: {}
forces: {spring: {body: b, force: [-4*b.x, 0]}}
stop: {time: 3, conditions: {top: b.x >= 1 - e}}
"""
# A pendulum pulls at a block on a rough floor, by at most 1 + e of the friction limit.
_PULLED = """
kind: scene
name: pulled
parameters: {e: 0, f: 5}
gravity: 10
bodies: {b: {mass: 1, start: {}}, d: {mass: 1, start: {y: 1, dx: 2}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.5, restitution: 0}}
forces:
  pull: {body: b, force: [f*(1 + e)*d.x, 0]}
  spring: {body: d, force: [-4*d.x, 10]}
stop: {time: 3}
outputs: {x: {value: b.x}, slips: {count: c.slip}}
"""
# x falls from 1 + e to e, and rises again.
_CHART = """
kind: chart
name: dips
parameters: {e: 0}
variables: {x: 1 + e, v: -2}
regions:
  r:
    initial: "on"
    states: {"on": {flows: {x: v, v: 2}}, "off": {}}
    transitions: [{name: low, from: "on", to: "off", guard: x < 0}]
stop: {time: 2}
outputs: {fired: {count: low}}
"""


def ran(text: str, engine: str, tolerance: float, e: float = 0.0) -> Any:
    scene = interpret(read_text(text.replace("e: 0", f"e: {e!r}", 1), "model.yaml"))
    return statechart.run(scene, engine=engine, tolerance=tolerance)


def reported(result: Any) -> list[str]:
    return [warning for warning in result.warnings if "within the error of the run" in warning]


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_graze_fires_no_event_and_gives_a_warning(engine: str, tolerance: float) -> None:
    result = ran(_THROWN, engine, tolerance)
    assert result.outputs["hits"] == 0
    assert [warning.split(",")[0] for warning in reported(result)] == [
        "c.gap grazes its boundary at t = 1"
    ]
    assert result.to_dict()["warnings"] == list(result.warnings)


@pytest.mark.parametrize("e", [1e-9, -1e-9])
def test_a_near_graze_within_the_tolerance_gives_a_warning(engine: str, e: float) -> None:
    assert len(reported(ran(_THROWN, engine, 1e-8, e))) == 1
    result = ran(_THROWN, engine, 1e-12, e)
    assert not reported(result)
    assert result.outputs["hits"] == (e > 0.0)


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_a_stop_condition_that_is_only_touched_gives_a_warning(
    engine: str, tolerance: float
) -> None:
    (warning,) = reported(ran(_SWINGS, engine, tolerance))
    assert warning.startswith("top ")


@pytest.mark.parametrize(("e", "outcome"), [(1e-9, "STOPPED"), (-1e-9, "HORIZON")])
def test_clear_stops_give_no_warning(engine: str, e: float, outcome: str) -> None:
    result = ran(_SWINGS, engine, 1e-12, e)
    assert (result.trace.outcome.name, reported(result)) == (outcome, [])


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_a_pull_that_grazes_the_friction_limit_gives_a_warning_and_no_slip(
    engine: str, tolerance: float
) -> None:
    result = ran(_PULLED, engine, tolerance)
    # A slip under a force error lasts as long as its root, and covers its square.
    assert abs(result.outputs["x"]) <= (10.0 * tolerance) ** 1.5 + 1e-15
    assert {warning.split()[0] for warning in reported(result)} == {"c.mu"}


def test_a_pull_beyond_friction_slips_without_a_warning(engine: str) -> None:
    beyond, within = (ran(_PULLED, engine, 1e-12, e) for e in (1e-6, -1e-6))
    assert (beyond.outputs["slips"], within.outputs["slips"]) == (2, 0)
    assert not reported(beyond) + reported(within)


@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_guards_of_charts_that_graze_zero_give_a_warning(engine: str, tolerance: float) -> None:
    assert len(reported(ran(_CHART, engine, tolerance))) == 1
    passed, missed = (ran(_CHART, engine, 1e-12, e) for e in (-1e-9, 1e-9))
    assert (passed.outputs["fired"], missed.outputs["fired"]) == (1, 0)
    assert not reported(passed) + reported(missed)


def test_a_margin_that_rests_on_its_bound_is_no_graze(engine: str) -> None:
    assert not reported(ran(_PULLED.replace("f*(1 + e)*d.x", "f"), engine, 1e-10))


@pytest.mark.parametrize("model", ["bouncing_ball", "stick_slip_block", "toppling_stick"])
def test_shipped_models_have_no_graze_warnings(engine: str, model: str) -> None:
    assert not reported(statechart.run(model, engine=engine))


_TURNED = """
kind: chart
name: turned
variables: {{x: 0}}
regions:
  m:
    initial: a
    states: {{a: {{flows: {{x: 1}}}}, b: {{flows: {{x: -1}}}}}}
    transitions: [{{name: back, {back}}}]
  e:
    initial: w
    states: {{w: {{}}, d: {{}}}}
    transitions: [{{name: hit, from: w, to: d, guard: "{guard}"}}]
stop: {{time: 1.5}}
outputs: {{hits: {{count: e.hit}}}}
"""
_BACK = [
    'from: a, to: a, guard: "x >= 1", updates: {x: 0}',
    "from: a, every: 1, updates: {x: 0}",
    'from: a, to: b, guard: "x >= 1"',
    "from: a, to: b, after: 1",
]


@pytest.mark.parametrize("back", _BACK)
@pytest.mark.parametrize("guard", ["x >= 1", "x >= 1 and time <= 2", "abs(x - 1) <= 0"])
def test_a_guard_that_another_event_turns_back_on_its_boundary_gives_a_warning(
    engine: str, back: str, guard: str
) -> None:
    result = statechart.run(read_text(_TURNED.format(back=back, guard=guard)), engine=engine)
    assert result.outputs["hits"] == 0
    (warning,) = result.warnings
    assert warning == (
        "e.hit reaches its boundary at t = 1, where another event reverses it, and does not fire"
    )


@pytest.mark.parametrize("back", _BACK)
@pytest.mark.parametrize("condition", ["x >= 1", "x >= 1 and time <= 2"])
def test_a_stop_condition_that_an_event_turns_back_gives_a_warning(
    engine: str, back: str, condition: str
) -> None:
    text = _TURNED.format(back=back, guard="x >= 2")
    text = text.replace("time: 1.5", f"time: 1.5, conditions: {{full: {condition}}}")
    result = statechart.run(read_text(text), engine=engine)
    assert result.trace.t_end == 1.5
    (warning,) = result.warnings
    assert warning.startswith("full reaches its boundary at t = 1, where another event reverses it")


@pytest.mark.parametrize(
    ("guard", "event", "count"),
    [
        ("mod(time, 1)**2 <= 0", "mod.wrap", 3),
        ("time - floor(time) <= 0", "floor.rise", 3),
        ("-floor(-time) - time >= 1 and x >= 1.5", "floor.fall", 2),
        ("mod(time, 1) <= D or x >= 9", "mod.wrap", 3),
        ("y <= 0", "m.back", 3),
        ("y < 0", "", 0),
        ("y < 0 and x >= 0.5", "", 0),
        ("not y >= 0 and x >= 0.5", "", 0),
        ("y < 0 or x < -1", "", 0),
        ("mod(time, 1) < D", "", 0),
        ("y <= 0.1", "", 0),
    ],
)
def test_a_guard_that_an_event_puts_on_its_boundary_for_an_instant_gives_a_warning(
    engine: str, guard: str, event: str, count: int
) -> None:
    text = f"""
kind: chart
name: saw
parameters: {{D: 0}}
variables: {{x: 0, y: 0.5}}
regions:
  m:
    initial: a
    states: {{a: {{flows: {{x: 1, y: 1}}}}}}
    transitions: [{{name: back, from: a, every: 1, updates: {{y: 0}}}}]
  e:
    initial: w
    states: {{w: {{}}, d: {{}}}}
    transitions: [{{name: hit, from: w, to: d, guard: "{guard}"}}]
stop: {{time: 3.5}}
outputs: {{hits: {{count: e.hit}}}}
"""
    result = statechart.run(read_text(text), engine=engine)
    assert result.outputs["hits"] == (guard == "y <= 0.1")
    assert len(result.warnings) == bool(event)
    for warning in result.warnings:
        first, further = 4 - count, f"; {count - 1} further time{'s' if count > 2 else ''}"
        assert warning.startswith(
            f"e.hit is true at the instant t = {first} only, at which {event} puts it on its "
            f"boundary, and does not fire{further}; write every"
        )


def test_two_feet_that_touch_at_one_instant_give_no_warning(engine: str) -> None:
    text = """
kind: scene
name: feet
gravity: 9.81
bodies: {b: {mass: 1, inertia: 5e-3, start: {y: 0.06, dx: 0.1}}}
surfaces: {floor: {height: 0}}
contacts:
  l:
    point: {body: b, at: [-0.05, -0.05]}
    surface: floor
    friction: 0.3
    stiffness: 4e4
    damping: 50
  r:
    point: {body: b, at: [0.05, -0.05]}
    surface: floor
    friction: 0.3
    stiffness: 4e4
    damping: 50
stop: {time: 0.06}
outputs: {y: {value: b.y}}
"""
    result = statechart.run(read_text(text), engine=engine)
    assert result.trace.jumps[0].target == ("slide+", "slide+")
    assert not result.warnings


_LANDED = """
kind: scene
name: landed
parameters: {e: 0}
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: 1}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: ball}, surface: floor, friction: 0, restitution: e}}
stop: {time: 2, conditions: {down: ball.y <= 0}}
"""


def test_a_stop_condition_met_in_an_impact_without_rebound_gives_no_warning(engine: str) -> None:
    result = statechart.run(read_text(_LANDED), engine=engine)
    assert result.trace.outcome.name == "STOPPED"
    assert not result.warnings
    again = statechart.run(read_text(_LANDED), parameters={"e": 0.5}, engine=engine, until=0.9)
    (warning,) = again.warnings
    assert warning.startswith("down reaches its boundary at t = 0.451524, where another event")


@pytest.mark.parametrize("back", _BACK)
@pytest.mark.parametrize(("guard", "hits"), [("x >= 0.9999", 1), ("x >= 1.0001", 0)])
def test_clear_guard_before_an_event_gives_no_warning(
    engine: str, back: str, guard: str, hits: int
) -> None:
    result = statechart.run(read_text(_TURNED.format(back=back, guard=guard)), engine=engine)
    assert result.outputs["hits"] == hits
    assert not result.warnings


_DIAGONAL = """
kind: chart
name: billiard
variables: {x: 0.25, y: 0.25, u: 1, v: 1}
regions:
  h:
    initial: a
    states: {a: {flows: {x: u}}}
    transitions:
      - {name: right, from: a, guard: x >= 1 and u > 0, updates: {u: -u}}
      - {name: left, from: a, guard: x <= 0 and u < 0, updates: {u: -u}}
  k:
    initial: a
    states: {a: {flows: {y: v}}}
    transitions:
      - {name: up, from: a, guard: y >= 1 and v > 0, updates: {v: -v}}
      - {name: down, from: a, guard: y <= 0 and v < 0, updates: {v: -v}}
stop: {time: 57.1}
outputs: {x: {value: x}, y: {value: y}, hits: {count: right or up or left or down}}
"""


def test_guards_that_fire_one_after_another_at_one_instant_give_no_warning(engine: str) -> None:
    # A billiard ball that runs on the diagonal into the corners, both ways.
    result = statechart.run(read_text(_DIAGONAL), engine=engine)
    assert result.outputs["x"] == result.outputs["y"] == pytest.approx(1.65 - 1.0, abs=1e-11)
    assert result.outputs["hits"] == 114
    assert not result.warnings


_SMALL = """
kind: chart
name: small
parameters: {e: 1}
variables: {x: e}
regions:
  m:
    initial: falls
    states: {falls: {flows: {x: -x}}, rises: {flows: {x: x}}}
    transitions:
      - {name: low, from: falls, to: rises, guard: x <= e/2}
      - {name: high, from: rises, to: falls, guard: x >= e}
stop: {time: 3}
outputs: {n: {count: m.low}}
"""


@pytest.mark.parametrize("e", [1e-200, 1e-160, 1e160, 1e200])
def test_extreme_scales_give_no_graze_warnings(engine: str, e: float) -> None:
    result = statechart.run(read_text(_SMALL), engine=engine, parameters={"e": e})
    assert result.outputs["n"] == 2
    assert not result.warnings


@pytest.mark.parametrize("guard", ["x >= 1 and v <= 0", "min(x, 1 - v) >= 1"])
def test_several_relations_that_hold_at_one_tangential_instant_give_a_warning(
    engine: str, guard: str
) -> None:
    # x = sin(2 t) touches 1 where v passes 0.
    text = f"""
kind: chart
name: tangential
variables: {{x: 0, v: 2}}
regions:
  r:
    initial: a
    states: {{a: {{flows: {{x: v, v: -4*x}}}}, b: {{flows: {{x: v, v: -4*x}}}}}}
    transitions: [{{name: go, from: a, to: b, guard: "{guard}"}}]
stop: {{time: 2}}
"""
    (warning,) = reported(statechart.run(interpret(read_text(text)), engine=engine))
    assert warning.startswith("r.go ")
    for clear in ("x >= 0.9 and v <= 0", "min(x, 1 - v) >= 0.9", "x >= 0.9 and abs(v) <= 0"):
        result = statechart.run(interpret(read_text(text.replace(guard, clear))), engine=engine)
        assert len(result.trace.jumps) == 1
        assert not reported(result)


@pytest.mark.parametrize("guard", [
    "x >= 0.5 and time <= pi/12 - 5e-14",
    "x >= 0.5 and time <= pi/12 + 5e-14",
    "time >= pi/12 + 5e-14 and x <= 0.5",
    "x >= 0.5 and 1 - y <= pi/12 - 5e-14",
    "x >= 0.5 and 1 - y <= pi/12 + 5e-14",
    "x >= 0.5 and v >= sqrt(3)",
    "time >= pi/12 and x <= 0.5",
    "x >= 0.5 and time <= pi/12 - 1e-13 and y <= 0.9",
    "min(x - 0.5, pi/12 - time) >= 0",
    "not (x < 0.5 or time > pi/12)",
])  # fmt: skip
def test_relations_that_change_within_their_errors_give_a_warning(engine: str, guard: str) -> None:
    # x = sin(2 t) is 1/2 at t = pi/12.
    text = f"""
kind: chart
name: rises
variables: {{x: 0, v: 2, y: 1}}
regions:
  r:
    initial: a
    states: {{a: {{flows: {{x: v, v: -4*x, y: -1}}}}, b: {{flows: {{x: v, v: -4*x}}}}}}
    transitions: [{{name: go, from: a, to: b, guard: "{guard}"}}]
stop: {{time: 1}}
"""
    result = statechart.run(interpret(read_text(text)), engine=engine, tolerance=1e-13)
    (warning,) = reported(result)
    assert warning.startswith("r.go ")
    assert "at t = 0.261799" in warning
    for clear in ("abs(x - 0.5) <= 0", "x >= 0.5 and 2*x <= 1", "x >= 0.5 and time <= 0.2618"):
        result = statechart.run(interpret(read_text(text.replace(guard, clear))), engine=engine)
        assert [jump.t for jump in result.trace.jumps] == pytest.approx([math.pi / 12], abs=1e-11)
        assert not reported(result)


def test_a_relation_that_holds_where_a_control_saturates_gives_a_warning(engine: str) -> None:
    # u = min(3 t, 3) reaches 3 as w = max(0, t - 1) leaves 0.
    text = """
kind: chart
name: saturates
variables: {x: 0}
regions:
  r:
    initial: a
    states: {a: {flows: {x: 1}}, b: {}}
    transitions: [{name: go, from: a, to: b, guard: "min(3*min(x, 1), 3 - max(0, x - 1)) >= 3"}]
stop: {time: 2}
"""
    result = statechart.run(interpret(read_text(text)), engine=engine)
    assert len(result.trace.jumps) + len(reported(result)) == 1


_TANGENT = """
kind: scene
name: tangent
parameters: {a: pi/4, p: 0.6}
gravity: 9.81
"""
_TRACK = """
bodies: {b: {mass: 1, start: {x: -sin(a) - cos(a), y: 1 - cos(a) + sin(a)}}}
surfaces:
  ramp: {line: [[-sin(a) - cos(a), 1 - cos(a) + sin(a)], [-sin(a), 1 - cos(a)]]}
  arc: {circle: [0, 1], radius: 1, hollow: true}
  flat: {height: 0}
contacts:
  r: {point: {body: b}, surface: ramp, friction: 0, restitution: 0, enabled: b.x < -sin(a)}
  c:
    point: {body: b}
    surface: arc
    friction: 0
    restitution: 0
    enabled: b.x >= -sin(a) and b.x < 0
  f: {point: {body: b}, surface: flat, friction: 0, restitution: 0, enabled: b.x >= 0}
stop: {time: 1}
outputs: {over: {value: time, at: first r.disable}, lowest: {minimum: b.y}, v: {value: b.dx}}
"""
_PEG = """
bodies: {b: {mass: 1, start: {x: -sin(a), y: -cos(a)}}}
joints:
  o: {point: {body: b}, to: [0, 0], rope: 1, enabled: b.x < 0}
  q: {point: {body: b}, to: [0, -p], rope: 1 - p, enabled: b.x >= 0}
stop: {time: 0.8}
outputs: {over: {value: time, at: first o.disable}, lowest: {minimum: b.y}, tension: {maximum: q.V}}
"""


def test_a_handover_between_tangent_constraints_is_decided(engine: str) -> None:
    # Errors of a point on its ramp, or on its circle, are along it: they only delay the handover.
    result = statechart.run(interpret(read_text(_TANGENT + _TRACK)), engine=engine)
    assert not any("off fires" in warning for warning in result.warnings)
    g, drop = 9.81, 1.0 - math.cos(math.pi / 4) + math.sin(math.pi / 4)
    assert result.outputs["over"] == pytest.approx(math.sqrt(2 / (g * math.sin(math.pi / 4))))
    assert result.outputs["v"] == pytest.approx(math.sqrt(2 * g * drop), abs=1e-9)
    assert result.outputs["lowest"] == pytest.approx(0.0, abs=1e-9)
    # Galileo's pendulum swings on about a peg.
    result = statechart.run(interpret(read_text(_TANGENT + _PEG)), engine=engine)
    assert not any("off fires" in warning for warning in result.warnings)
    quarter = ellipk(math.sin(math.pi / 8) ** 2) / math.sqrt(g)
    assert result.outputs["over"] == pytest.approx(quarter, abs=1e-9)
    assert result.outputs["lowest"] == pytest.approx(-1.0, abs=1e-9)
    pull = g + 2 * g * (1.0 - math.cos(math.pi / 4)) / 0.4
    assert result.outputs["tension"] == pytest.approx(pull, abs=1e-7)
