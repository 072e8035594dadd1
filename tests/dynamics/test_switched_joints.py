"""Joints that let go and take hold, ropes, rods, welds and limits, against closed forms."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import statechart
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, NoConsistentMode
from statechart.loading.load import interpret
from statechart.running.runner import Runner
from statechart.testing.checking import check

_BREAKS = """
kind: scene
name: breaks
gravity: 9.81
bodies: {weight: {mass: 1, inertia: 0.01, start: {x: 1}}}
joints:
  hook: {point: {body: weight, at: [-1, 0]}, to: [0, 0], enabled: hook.X**2 + hook.Y**2 <= 625}
stop: {time: 0.8}
outputs:
  angle: {value: weight.angle, at: first hook.disable}
  t: {value: time, at: first hook.disable}
  spin: {value: weight.dangle}
"""
_WELD = """
kind: scene
name: weld
bodies:
  a: {mass: 1, inertia: 0.1, start: {dx: 1, dangle: 2}}
  b: {mass: 2, inertia: 0.3, start: {x: 2, dy: 1, dangle: -1}}
joints:
  glue:
    point: {body: a, at: [0.3, 0.1]}
    to: {body: b}
    rest: captured
    angle: held
    enabled: time >= 0.5
stop: {time: 2}
outputs:
  spin: {value: b.dangle}
  turn: {value: a.angle - b.angle}
  apart: {value: "hypot(a.x - b.x, a.y - b.y)"}
"""
_CATCH = """
kind: scene
name: catch
gravity: 10
bodies:
  box: {mass: 2, inertia: 0.1, start: {y: 0.1, dx: 1}}
surfaces: {floor: {height: 0}}
contacts:
  base: {point: {body: box, at: [0, -0.1]}, surface: floor, friction: 0, restitution: 0.5}
joints:
  hook:
    point: {body: box, at: [0, 0.1]}
    to: [0, 0]
    rest: captured
    enabled: time >= 0.25 and time < 0.5
stop: {time: 0.4}
outputs: {spin: {value: box.dangle}, dx: {value: box.dx}, dy: {value: box.dy}}
"""
_SWING = _CATCH.replace("gravity: 10\n", "")
# The hook is at a corner: the box would turn into the floor.
_STOP = _CATCH.replace("at: [0, 0.1]", "at: [0.1, 0.1]")
_ROPE = """
kind: scene
name: rope
bodies:
  a: {mass: 1}
  b: {mass: 2, start: {x: 0.5, dx: 1}}
joints:
  rope: {point: {body: a}, to: {body: b}, rope: 1, restitution: 0.5}
stop: {time: 2}
outputs:
  taut: {value: time, at: first rope.touchdown}
  a: {value: a.dx}
  b: {value: b.dx}
  slack: {value: rope.gap}
"""
_ROD = """
kind: scene
name: rod
gravity: 9.81
bodies:
  a: {mass: 1}
  b: {mass: 1, start: {x: 0.8, y: -0.6}}
joints:
  pin: {point: {body: a}, to: [0, 0]}
  bar: {point: {body: b}, to: {body: a}, rod: 1}
stop: {conditions: {low: b.x <= 0}, time: 2}
outputs: {pull: {value: bar.T}, speed: {value: -b.dx}}
"""
_LIMITS = """
kind: scene
name: limits
bodies:
  door: {mass: 1, inertia: 1/12, start: {x: 0.5, dy: 1, dangle: 2}}
joints:
  hinge:
    point: {body: door, at: [-0.5, 0]}
    to: [0, 0]
    limits: [0, pi/2]
    restitution: 0.5
stop: {time: 4}
outputs:
  high: {value: time, at: first hinge_max.touchdown}
  low: {value: time, at: first hinge_min.touchdown}
  spin: {value: door.dangle}
"""
_ELBOW = """
kind: scene
name: elbow
gravity: 9.81
bodies:
  upper: {mass: 1, inertia: 1/12, start: {x: 0.5}}
  fore: {mass: 1, inertia: 1/12, start: {x: 1.5}}
joints:
  shoulder: {point: {body: upper, at: [-0.5, 0]}, to: [0, 0], angle: held}
  elbow:
    point: {body: fore, at: [-0.5, 0]}
    to: {body: upper, at: [0.5, 0]}
    limits: [-pi/4, pi/2]
stop: {time: 2}
outputs: {stop: {value: elbow.M}, weld: {value: shoulder.M}}
"""

# The weight has the moment of inertia 1.01 about the hook, which pulls along the arm with
# w^2 + g sin a and across it with a share of the weight.
_INERTIA = 1.01


def _breaking() -> dict[str, float]:
    def force(angle: float) -> float:
        w2 = 2 * 9.81 * math.sin(angle) / _INERTIA
        across = 9.81 * math.cos(angle) * (1 - 1 / _INERTIA)
        return math.hypot(w2 + 9.81 * math.sin(angle), across) - 25.0

    low, high = 0.1, 1.5
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if force(middle) < 0.0 else (low, middle)
    return {"angle": -low, "spin": -math.sqrt(2 * 9.81 * math.sin(low) / _INERTIA)}


_EXPECTED: dict[str, tuple[str, dict[str, float]]] = {
    "breaks": (_BREAKS, _breaking()),
    # Angular momentum about the centre of mass, over the moment of inertia of both.
    "weld": (
        _WELD,
        {"spin": 1.85 / 3.1, "turn": 1.5, "apart": 1.5 * math.sqrt(1 + 1 / 9)},
    ),
    # m v l / (I + m l^2), as on a pivot; hook and floor together stop the box, without rebound.
    "swing": (_SWING, {"spin": 0.2 / 0.12}),
    "stop": (_STOP, {"spin": 0.0, "dx": 0.0, "dy": 0.0}),
    "rope": (_ROPE, {"taut": 0.5, "a": 1.0, "b": 0.5, "slack": 0.75}),
    "rod": (_ROD, {"pull": 9.81 * 1.8, "speed": math.sqrt(2 * 9.81 * 0.4)}),
    "limits": (
        _LIMITS,
        {"high": math.pi / 4, "low": 3 * math.pi / 4, "spin": 0.5},
    ),
    "elbow": (
        _ELBOW,
        {
            "stop": 0.5 * 9.81 * math.cos(math.pi / 4),
            "weld": 9.81 * (0.5 + 1 + 0.5 * math.cos(math.pi / 4)),
        },
    ),
}


def _outputs(text: str, **setting: Any) -> dict[str, Any]:
    return dict(statechart.run(interpret(read_text(text, "joint.yaml")), **setting).outputs)


@pytest.mark.parametrize("name", [*_EXPECTED])
@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_a_joint_moves_as_its_closed_form(name: str, engine: str) -> None:
    text, expected = _EXPECTED[name]
    found = _outputs(text, engine=engine)
    for output, value in expected.items():
        assert found[output] == pytest.approx(value, abs=1e-9), output


@pytest.mark.parametrize("name", [*_EXPECTED])
def test_steps_come_nearer_to_the_closed_form_of_a_joint(name: str) -> None:
    text, expected = _EXPECTED[name]
    for step in (4e-3, 1e-3):
        found = _outputs(text, engine="impulse", step=step)
        for output, value in expected.items():
            scale = max(abs(value), 1.0)
            assert found[output] == pytest.approx(value, abs=8.0 * step * scale), output


def test_a_joint_that_closes_with_separate_points_warns() -> None:
    apart = _WELD.replace("    rest: captured\n", "")
    with pytest.raises(NoConsistentMode, match="rest: captured"):
        statechart.run(interpret(read_text(apart, "joint.yaml")))


def test_a_broken_joint_does_not_close_again() -> None:
    text = _CATCH.replace("time < 0.5", "abs(hook.X) <= 3 and time < 2")
    text = text.replace("stop: {time: 0.4}", "stop: {time: 1}").replace("dx: 1}", "dx: 4}")
    result = statechart.run(interpret(read_text(text, "joint.yaml")))
    assert [jump.cause for jump in result.trace.jumps if jump.region == "hook"] == [
        "enable",
        "disable",
    ]
    assert "broken" in result.trace.jumps[-1].target


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("rope: 1,", "rope: 1, rod: 2,", "a joint is a rod or a rope"),
        ("rope: 1,", "rope: 1, angle: held,", "a rope has no angle"),
        ("rope: 1,", "rope: -1,", "must be positive"),
        ("rope: 1,", "rope: 0.1,", "shorter than the distance of its ends"),
        (
            "x: 0.5, dx: 1",
            "dx: 1",
            "joints.rope: rope 'rope' has both ends at one place at the start",
        ),
        ("rope: 1, restitution: 0.5", "restitution: 0.5", "restitution is for a rope"),
        ("rope: 1, restitution: 0.5", "rest: captured", "write enabled"),
        ("rope: 1, restitution: 0.5", "limits: [0, 1]", "a particle, which has no angle"),
        ("rope: 1,", "rope: 1, enabled: rope.X <= 1,", "rope.X"),
        ("rope: 1,", "rope: 2 + a.x,", "write a formula of time, controls and variables"),
        ("rope: 1, restitution: 0.5", "rod: 2 + a.x", "write a formula of time, or a rope"),
    ],
)
def test_a_mistake_in_a_joint_is_reported(old: str, new: str, reported: str) -> None:
    assert old in _ROPE
    with pytest.raises(DeclarationError, match=re.escape(reported)):
        statechart.run(interpret(read_text(_ROPE.replace(old, new), "joint.yaml")))


def test_steps_refuse_a_rope_without_direction_as_events_do() -> None:
    with pytest.raises(DeclarationError, match=r"joints\.rope: rope 'rope' has both"):
        statechart.run(
            interpret(read_text(_ROPE.replace("x: 0.5, dx: 1", "dx: 1"), "joint.yaml")),
            engine="impulse",
            step=1e-3,
        )


@pytest.mark.parametrize("length", ["L", "L*cos(time)"])
def test_a_rope_without_length_is_reported_at_its_place(length: str) -> None:
    text = "parameters: {L: 1}\n" + _ROPE.replace("rope: 1,", f"rope: {length},")
    assert "parameters" not in _ROPE
    with pytest.raises(DeclarationError, match=r"joints\.rope\.rope: must be positive, not 0"):
        Runner(interpret(read_text(text))).run({"L": 0.0})


def test_initially_redundant_joint_is_reported() -> None:
    # Its equations were singular: the state was not finite.
    again = "again: {point: {body: b}, to: {body: a}, rod: 0.5, enabled: time < 1}"
    rod = "rod: {point: {body: a}, to: {body: b}, rod: 0.5}"
    joints = _ROPE.partition("joints:\n")[2].partition("stop:")[0]
    text = _ROPE.partition("outputs:")[0].replace(joints, f"  {rod}\n  {again}\n")
    text = text.replace("dx: 1", "dy: 1")
    with pytest.raises(DeclarationError, match="starts closed, and other closed joints imply"):
        statechart.run(interpret(read_text(text, "joint.yaml")))


_SWAP = """
kind: scene
name: swap
bodies: {bob: {mass: 1, start: {x: 1, dy: 1}}}
joints:
  second: {point: {body: bob}, to: [2, 2], rod: "hypot(2 - cos(T), 2 - sin(T))", enabled: SECOND}
  first: {point: {body: bob}, to: [0, 0], rod: 1, enabled: FIRST}
parameters: {T: 0.5}
regions:
  hand:
    initial: one
    states: {one: {}, two: {}}
    transitions: [{name: swaps, from: one, to: two, after: T}]
stop: {time: 0.6}
outputs: {v: {value: "hypot(bob.dx, bob.dy)"}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
@pytest.mark.parametrize(
    ("first", "second"), [("time < T", "time >= T"), ("in(hand.one)", "in(hand.two)")]
)
def test_closing_joint_ignores_an_opening_one(engine: str, first: str, second: str) -> None:
    text = _SWAP.replace("FIRST", first).replace("SECOND", second)
    setting = {"engine": engine} | ({"step": 1e-3} if engine == "impulse" else {})
    way = math.atan2(2.0 - math.sin(0.5), 2.0 - math.cos(0.5))
    # The velocity along the second rod is lost.
    expected = abs(math.sin(0.5 + math.pi / 2.0 - way))
    error = 1e-5 if engine == "impulse" else 1e-9
    assert _outputs(text, **setting)["v"] == pytest.approx(expected, rel=error)


_CAUGHT = """
kind: scene
name: caught
gravity: 9.81
bodies: {sled: {mass: 1, inertia: 0.1, start: {dx: 2}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: sled}, surface: floor, friction: 0.3, restitution: 0}}
joints:
  hook: {point: {body: sled}, to: [1, 0], rest: captured, enabled: sled.x >= 0.5}
stop: {time: 1}
outputs: {x: {value: sled.x}, v: {value: sled.dx}}
"""


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_a_joint_catches_a_body_on_its_contact_point(engine: str) -> None:
    # Once the joint is closed, nothing that is left moves the contact; by steps that had no scale.
    setting = {"engine": engine} | ({"step": 1e-3} if engine == "impulse" else {})
    found = _outputs(_CAUGHT, **setting)
    assert found["v"] == pytest.approx(0.0, abs=1e-12)
    assert found["x"] == pytest.approx(0.5, abs=2e-3 if engine == "impulse" else 1e-12)


_DOCKED = """
kind: scene
name: docked
gravity: 9.81
bodies:
  sled: {mass: 1, inertia: 0.1, start: {dx: 1}}
  cart: {mass: 3, inertia: 1}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: sled}, surface: floor, friction: 0, restitution: 0}}
joints:
  rail: {point: {body: cart}, to: {y: 0}, angle: held}
  grip: {point: {body: sled}, to: {body: cart}, angle: held, rest: captured, enabled: time >= 0.5}
stop: {time: 1}
outputs: {v: {value: cart.dx}, force: {maximum: abs(rail.Y)}}
"""


@pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
def test_a_weld_to_a_cart_on_rails_keeps_the_momentum_of_a_sliding_body(engine: str) -> None:
    # Round-off in the directions that joints leave free seemed to let the contact stop the cart.
    setting = {"engine": engine} | ({"step": 1e-3} if engine == "impulse" else {})
    found = _outputs(_DOCKED, **setting)
    assert found["v"] == pytest.approx(0.25, rel=1e-9)
    assert found["force"] == pytest.approx(4.0 * 9.81, rel=1e-9)


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_a_joint_that_only_the_declared_parameters_close_names_them(engine: str) -> None:
    text = _WELD.replace("time >= 0.5", "time >= T").replace("bodies", "parameters: {T: 0}\nbodies")
    setting = {"engine": engine} | ({"step": 1e-3} if engine == "impulse" else {})
    runner = statechart.Runner(interpret(read_text(text)), **setting)
    with pytest.raises(DeclarationError, match="does not hold at the start"):
        runner.run()
    with pytest.raises(DeclarationError, match="the declared parameters close joint 'glue' at"):
        runner.run({"T": 0.5})


_PEG = """
kind: scene
name: peg
gravity: 9.81
parameters: {L: 1, d: 0.5, tilt: 0.5}
bodies: {bob: {mass: 1, start: {x: L*sin(tilt), y: -L*cos(tilt)}}}
joints:
  long: {point: {body: bob}, to: [0, 0], rod: L, enabled: bob.x >= 0}
  short: {point: {body: bob}, to: [0, -d], rod: L - d, enabled: bob.x < 0}
stop: {time: 4}
outputs: {swaps: {value: time, at: each long.disable or long.enable}, low: {minimum: bob.x}}
"""


@pytest.mark.parametrize("step", [None, 2e-3, 1e-3, 5e-4])
def test_galileos_pendulum_swings_on_about_its_peg(step: float | None) -> None:
    setting = {"engine": "scipy"} if step is None else {"engine": "impulse", "step": step}
    found = _outputs(_PEG, **setting)
    fall = 1.0 - math.cos(0.5)
    tilt = math.acos(1.0 - fall / 0.5)
    long, short = (
        math.sqrt(length / 9.81) * float(ellipk(math.sin(0.5 * angle) ** 2))
        for length, angle in ((1.0, 0.5), (0.5, tilt))
    )
    times = [long, long + 2 * short, 3 * long + 2 * short, 3 * long + 4 * short]
    assert found["swaps"] == pytest.approx(times, abs=1e-9 if step is None else 2.0 * step)
    assert found["low"] == pytest.approx(-0.5 * math.sin(tilt), abs=1e-9 if step is None else 1e-4)


_ENGINES = [
    ({"engine": "taylor"}, 1e-9),
    ({"engine": "scipy"}, 1e-9),
    ({"engine": "impulse", "step": 1e-3}, 2e-3),
]
_WINCH = """
kind: scene
name: winch
gravity: 9.81
parameters: {v: 0.3}
bodies: {load: {mass: 2, start: {y: -2}}}
surfaces: {floor: {height: -2}}
contacts: {foot: {point: {body: load}, surface: floor, friction: 0.5, restitution: 0}}
joints: {rope: {point: {body: load}, to: [0, 0], rope: l}}
regions:
  winch:
    initial: idle
    variables: {l: 2.06}
    states: {idle: {}, hauls: {flows: {l: -v}}, holds: {}}
    transitions:
      - {name: go, from: idle, to: hauls, after: 0.5}
      - {name: done, from: hauls, to: holds, guard: l <= 1.5}
stop: {time: 3}
outputs:
  taut: {value: time, at: each rope.touchdown}
  top: {maximum: load.y}
  pull: {value: rope.V}
"""
_HAULED = """
kind: scene
name: hauled
gravity: 9.81
parameters: {L: 2, v: 0.3, phi: 0.1}
ranges: {L: [1.5, 4], v: [0.1, 0.4]}  # no rope ends at length 0
bodies:
  load: {mass: 2, start: {x: L*sin(phi), y: -L*cos(phi), dx: -v*sin(phi), dy: v*cos(phi)}}
joints: {line: {point: {body: load}, to: [0, 0], KIND: L - v*time}}
stop: {time: 3}
outputs: {x: {value: load.x}, y: {value: load.y}, pull: {value: line.FORCE}}
"""


@pytest.mark.parametrize(("settings", "near"), _ENGINES)
def test_a_winch_lifts_a_load_and_stops(settings: dict[str, Any], near: float) -> None:
    got = statechart.run(interpret(read_text(_WINCH)), **settings).outputs
    flight = 2 * 0.3 / 9.81
    assert got["taut"] == pytest.approx([0.7, 0.7 + 0.5 / 0.3 + flight], abs=near)
    assert got["top"] == pytest.approx(-1.5 + 0.3 * flight / 4, abs=near)
    assert got["pull"] == pytest.approx(2 * 9.81, abs=near)


@pytest.mark.parametrize(("kind", "force"), [("rope", "V"), ("rod", "T")])
@pytest.mark.parametrize(("settings", "near"), _ENGINES)
def test_hauled_in_pendulum_follows_its_closed_form(
    kind: str, force: str, settings: dict[str, Any], near: float
) -> None:
    """L phi'' = 2 v phi' - g sin(phi), and the tension m (L phi'^2 + g cos(phi))."""
    v, g = 0.3, 9.81
    swing = solve_ivp(
        lambda t, y: (y[1], (2 * v * y[1] - g * math.sin(y[0])) / (2 - v * t)),
        (0, 3), (0.1, 0), method="DOP853", rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    (phi, rate), length = swing.y[:, -1], 2 - v * 3
    text = _HAULED.replace("KIND", kind).replace("FORCE", force)
    got = statechart.run(interpret(read_text(text)), **settings).outputs
    want = {
        "x": length * math.sin(phi),
        "y": -length * math.cos(phi),
        "pull": 2 * (length * rate**2 + g * math.cos(phi)),
    }
    assert {**got} == pytest.approx(want, rel=0, abs=near)


def test_work_of_a_winch_is_its_tension_times_its_speed() -> None:
    text = _HAULED.replace("KIND", "rope").replace("FORCE", "V")
    report = check(interpret(read_text(text)), examples=2, seed=1)
    assert report.passed, report.text()


def test_a_rope_that_a_control_shortens_ends_the_run() -> None:
    text = _WINCH.replace("variables: {l: 2.06}", "variables: {}").replace("l <= 1.5", "time >= 2")
    text = text.replace("flows: {l: -v}", "sets: {l: 1.5}").replace(
        "stop:", "controls: {l: 2}\nstop:"
    )
    with pytest.raises(NoConsistentMode, match="rope 'rope' jumps to 0"):
        statechart.run(interpret(read_text(text)))


@pytest.mark.parametrize(("settings", "near"), _ENGINES)
@pytest.mark.parametrize(("start", "led"), [("y: -2", True), ("x: 1.2, y: -1.6", False)])
def test_a_rope_that_is_hauled_in_to_its_end_ends_the_run(
    settings: dict[str, Any], near: float, start: str, led: bool
) -> None:
    """A load that swings about the end of its rope turns without bound as the length vanishes."""
    text = _WINCH.replace("start: {y: -2}", f"start: {{{start}}}").replace("{l: 2.06}", "{l: 2}")
    text = text[: text.index("surfaces:")] + text[text.index("joints:") :]
    text = text.replace("initial: idle", "initial: hauls").replace("l <= 1.5", "l <= -1")
    text = text.replace("stop: {time: 3}", "stop: {time: 9}")
    if led:
        text = text.replace("rope: l", "rope: 2 - v*time")
    result = statechart.run(interpret(read_text(text)), **settings, throw=False)
    assert result.trace.outcome.name == "NO_CONSISTENT_MODE"
    assert "rope 'rope' is hauled in" in result.trace.message
    assert result.trace.t_end == pytest.approx(2 * 0.999 / 0.3, abs=near)


SWING = """
kind: scene
name: swing
gravity: 9.81
bodies: {b: {mass: 2, inertia: 0.5, start: {x: 1}}}
joints: {j: {point: {body: b, at: [-1, 0]}, to: [0, 0]ENABLED}}
regions:
  r: {initial: w, states: {w: {}, d: {}}, transitions: [{name: fire, from: w, to: d, GUARD}]}
stop: {time: 0.6}
"""


@pytest.mark.parametrize("relation", ["j.Y - j.X > 30 or b.x > 9", "abs(j.X) + abs(j.Y) > 30"])
@pytest.mark.parametrize("gate", [True, False])
def test_relation_of_several_forces_fires_in_a_conjunction(relation, gate) -> None:
    enabled = f", enabled: 'not ({relation})'" if gate else ""
    guard = "after: 9" if gate else f"guard: {relation}"
    text = SWING.replace("ENABLED", enabled).replace("GUARD", guard)
    (jump,) = statechart.run(interpret(read_text(text))).trace.jumps
    # At the angle a below the horizontal, with a'' = k cos a and a'^2 = 2 k sin a.
    k, a = 2 * 9.81 / 2.5, -jump.before[2]
    pull, cross = 2 * (9.81 + 2 * k) * math.sin(a), 2 * (9.81 - k) * math.cos(a)
    x, y = cross * math.sin(a) - pull * math.cos(a), pull * math.sin(a) + cross * math.cos(a)
    assert y - x == pytest.approx(30, abs=1e-9)


def test_jumps_list_the_impulses_of_joints() -> None:
    # They are the change of momentum of a: m dv = (X, Y), I dw = r x (X, Y) + M.
    result = statechart.Runner(read_text(_WELD), engine="taylor").run()
    (jump,) = (jump for jump in result.trace.jumps if jump.region == "glue")
    pushes = jump.joint_impulse
    start, change = jump.before, (jump.after - jump.before)[6:9]
    x, y = (
        0.3 * math.cos(start[2]) - 0.1 * math.sin(start[2]),
        0.3 * math.sin(start[2]) + 0.1 * math.cos(start[2]),
    )
    assert [pushes["glue.X"], pushes["glue.Y"]] == pytest.approx(change[:2], abs=1e-12)
    couple = 0.1 * change[2] - x * pushes["glue.Y"] + y * pushes["glue.X"]
    assert pushes["glue.M"] == pytest.approx(couple, abs=1e-12)
    (event,) = (e for e in result.to_dict()["events"] if e["contact"] == "glue")
    assert event["joint_impulse"] == dict(pushes)


def test_joint_that_closes_by_steps_lists_its_impulses() -> None:
    model = read_text(_WELD)
    runs = statechart.run(model), statechart.run(model, engine="impulse", step=1e-3)
    by_events, by_steps = (
        next(jump for jump in run.trace.jumps if jump.region == "glue") for run in runs
    )
    assert set(by_events.joint_impulse) == {"glue.X", "glue.Y", "glue.M"}
    assert by_steps.joint_impulse == pytest.approx(by_events.joint_impulse, abs=1e-9)


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_joint_that_presses_a_contact_as_it_closes_lists_both_impulses(engine: str) -> None:
    """A box of 2 kg at 1 m/s is caught 0.2 m above its centre, 0.05 m before its foot.

    All stops: 0.4 N m s about the hook are 0.05 m times the impulse of the foot.
    """
    text = """
kind: scene
name: caught
gravity: 10
bodies: {box: {mass: 2, inertia: 0.1, start: {y: 0.1, dx: 1}}}
surfaces: {floor: {height: 0}}
contacts:
  foot: {point: {body: box, at: [0, -0.1]}, surface: floor, friction: 0, restitution: 0}
joints:
  hook: {point: {body: box, at: [0.05, 0.2]}, to: [0, 0], rest: captured, enabled: time >= 0.2}
stop: {time: 0.3}
"""
    settings = {"step": 1e-3} if engine == "impulse" else {}
    jumps = statechart.run(read_text(text), engine=engine, **settings).trace.jumps
    jump = next(jump for jump in jumps if jump.region == "hook")
    assert jump.after[3:6] == pytest.approx(0, abs=1e-9)
    assert jump.joint_impulse == pytest.approx({"hook.X": -2, "hook.Y": -8}, abs=1e-9)
    assert jump.impulse == {"foot": pytest.approx((8, 0), abs=1e-9)}


@pytest.mark.parametrize("engine", ["taylor", "impulse"])
def test_rolling_resistance_takes_the_impulse_of_a_joint_that_closes(engine: str) -> None:
    """A ball of 1 kg falls on the hub of a disc at 2 m/s each way; 0.2 m times 2 N s resist.

    (1 + 2 + 0.25/0.5^2) v = 1*2 - 0.4/0.5.
    """
    text = """
kind: scene
name: hub
gravity: 10
bodies:
  disc: {mass: 2, inertia: 0.25, start: {y: 0.5}}
  ball: {mass: 1, start: {x: -1, y: 1.5, dx: 2, dy: -2}}
surfaces: {ground: {height: 0}}
contacts:
  rim:
    point: {body: disc}
    radius: 0.5
    surface: ground
    friction: 0.9
    restitution: 0
    rolling_resistance: 0.2
forces: {weight: {body: ball, force: [0, 10]}}
joints:
  hook: {point: {body: ball}, to: {body: disc}, enabled: time >= 0.5}
stop: {time: 0.6}
"""
    settings = {"step": 1e-3} if engine == "impulse" else {}
    jumps = statechart.run(read_text(text), engine=engine, **settings).trace.jumps
    jump = next(jump for jump in jumps if jump.region == "hook")
    assert jump.after[5] == pytest.approx(0.3, abs=1e-9)
    assert jump.impulse == {"rim": pytest.approx((2, -1.1), abs=1e-9)}
    pushes = {"hook.X": -1.7, "hook.Y": 2, "rim_rolling.M": 0.4}
    assert jump.joint_impulse == pytest.approx(pushes, abs=1e-9)


def test_impacts_list_the_impulses_of_joints() -> None:
    # A rod of moment of inertia 1 about its pin stops at its tip, 1 m from the pin: the impulse of
    # the tip is its spin, and both together stop the centre of mass.
    text = """
kind: scene
name: rod
gravity: 9.81
bodies: {rod: {mass: 3, inertia: 0.25, start: {x: 0.5*cos(0.5), y: 0.5*sin(0.5), angle: 0.5}}}
surfaces: {floor: {height: 0}}
contacts: {tip: {point: {body: rod, at: [0.5, 0]}, surface: floor, friction: 0, restitution: 0}}
joints: {pin: {point: {body: rod, at: [-0.5, 0]}, to: [0, 0]}}
stop: {time: 1}
"""
    jump = statechart.Runner(read_text(text), engine="taylor").run().trace.jumps[0]
    spin = math.sqrt(3 * 9.81 * math.sin(0.5))
    assert jump.impulse["tip"][0] == pytest.approx(spin, abs=1e-9)
    assert jump.joint_impulse.get("pin.X", 0) == pytest.approx(0, abs=1e-9)
    assert jump.joint_impulse["pin.Y"] == pytest.approx(3 * 0.5 * spin - spin, abs=1e-9)


@pytest.mark.parametrize("setting", [{}, {"engine": "scipy"}, {"engine": "impulse", "step": 1e-3}])
def test_a_latch_at_the_far_end_of_a_hinged_door_gives_advice(
    setting: dict[str, Any],
) -> None:
    """Hinge and latch hold four components of a body with three coordinates."""
    text = """
kind: scene
name: door
bodies: {d: {mass: 2, inertia: 0.2, start: {x: 0.5, dy: 1, dangle: 2}}}
joints:
  hinge: {point: {body: d, at: [-0.5, 0]}, to: [0, 0]}
  latch: {point: {body: d, at: [0.5, 0]}, to: [0, 1], enabled: d.angle >= 1, rest: captured}
stop: {time: 1}
outputs: {a: {value: d.angle}}
"""
    result = statechart.run(read_text(text), throw=False, **setting)
    assert result.trace.outcome.name == "NO_CONSISTENT_MODE"
    assert "joint 'latch' closes, and closed joints imply a component" in result.trace.message
    held = text.replace("to: [0, 1]", "to: {x: 0}")
    outputs = statechart.run(read_text(held), **setting).outputs
    assert outputs["a"] == pytest.approx(1, abs=1e-9 if not setting.get("step") else 3e-3)


def test_a_dog_clutch_is_a_coupling_with_a_high_limit() -> None:
    """Two wheels on one axle turn alike once the clutch closes: J w stays."""
    text = """
kind: scene
name: dog_clutch
bodies:
  a: {mass: 1, inertia: 1, start: {dangle: 12}}
  b: {mass: 1, inertia: 3}
joints:
  axle: {point: {body: a}, to: [0, 0]}
  bearing: {point: {body: b}, to: {body: a}}
"""
    dog = "point: {body: b}, to: {body: a}, angle: held, rest: captured, enabled: time >= 0.5"
    message = statechart.run(
        read_text(f"{text}  dog: {{{dog}}}\nstop: {{time: 1}}"), throw=False
    ).trace.message
    assert message.endswith("and the angle alone by a coupling with a limit that it never reaches")
    coupled = f"{text}couplings: {{dog: {{bodies: [a, b], limit: 1e9, enabled: time >= 0.5}}}}\n"
    outputs = "outputs: {w: {value: b.dangle}, turned: {value: a.angle}}\nstop: {time: 1}"
    result = statechart.run(read_text(coupled + outputs))
    assert result.outputs["w"] == pytest.approx(3.0, rel=1e-12)
    assert result.outputs["turned"] == pytest.approx(7.5, abs=1e-6)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_feet_bear_a_load_that_a_switched_joint_and_a_locked_coupling_carry(engine: str) -> None:
    """Moments about the middle of the feet: 0.2 (V1 - V0) + g (0.1 sin a - 0.02 m) = 0."""
    text = """
kind: scene
name: laden
parameters: {a: 0.14, m: 0.4, I: 0.02}
gravity: 9.81
bodies:
  box: {mass: 1, inertia: I, start: {x: -0.1*sin(a), y: 0.1*cos(a), angle: a}}
  load: {mass: m, inertia: 0.01, start: {x: 0.02, y: 0.3}}
surfaces: {floor: {incline: a}}
contacts:
  left: {point: {body: box, at: [-0.2, -0.1]}, surface: floor, friction: 0.9, restitution: 0}
  right: {point: {body: box, at: [0.2, -0.1]}, surface: floor, friction: 0.9, restitution: 0}
joints:
  rail: {point: {body: load}, to: {body: box}, rest: captured, enabled: time >= 0}
couplings: {rub: {bodies: [load, box], limit: 5}}
outputs: {left: {value: left.V}, right: {value: right.V}, along: {value: left.H}}
stop: {time: 0.1}
"""
    g, a, m = 9.81, 0.14, 0.4
    result = Runner(interpret(read_text(text)), engine=engine).run()
    outputs, sum_of_both = result.outputs, (1.0 + m) * g * math.cos(a)
    difference = g * (0.02 * m - 0.1 * math.sin(a)) / 0.2
    assert not result.trace.jumps
    assert outputs["left"] == pytest.approx(0.5 * (sum_of_both - difference), abs=1e-9)
    assert outputs["right"] == pytest.approx(0.5 * (sum_of_both + difference), abs=1e-9)
    assert outputs["along"] == pytest.approx(0.5 * (1.0 + m) * g * math.sin(a), abs=1e-9)


@pytest.mark.parametrize("setting", [{}, {"engine": "scipy"}, {"engine": "impulse", "step": 1e-3}])
@pytest.mark.parametrize("rest", ["", ", rest: captured"])
def test_a_joint_of_points_that_closes_beyond_its_limits_ends_the_run(
    rest: str, setting: dict[str, Any]
) -> None:
    text = f"""
kind: scene
name: arm
bodies: {{arm: {{mass: 2, inertia: 0.1, start: {{dangle: 1}}}}}}
joints:
  hinge: {{point: {{body: arm}}, to: [0, 0], limits: [-1, MOST], enabled: arm.angle >= 0.5{rest}}}
stop: {{time: 1}}
"""
    trace = statechart.run(read_text(text.replace("MOST", "0.49")), throw=False, **setting).trace
    assert trace.outcome.name == "NO_CONSISTENT_MODE"
    assert "joint 'hinge' closes while its angle is beyond its limits" in str(trace.message)
    assert trace.t_end == pytest.approx(0.5, abs=1e-9)
    trace = statechart.run(read_text(text.replace("MOST", "0.7")), **setting).trace
    assert trace.final[2] == pytest.approx(0.7, abs=1e-3)


@pytest.mark.parametrize("most", [0.5005, 0.503, 0.5039])
def test_a_joint_that_a_step_closes_beyond_its_limit_does_not_leave_the_limit_off(
    most: float,
) -> None:
    """The angle is 7 t: it passes 0.5 within a step, whose end is at 0.504."""
    text = f"""
kind: scene
name: arm
bodies: {{arm: {{mass: 2, inertia: 0.1, start: {{dangle: 7}}}}}}
joints:
  hinge: {{point: {{body: arm}}, to: [0, 0], limits: [-1, {most}], enabled: arm.angle >= 0.5}}
stop: {{time: 1}}
"""
    steps: dict[str, Any] = {"engine": "impulse", "throw": False}
    assert statechart.run(read_text(text)).trace.final[2] == pytest.approx(most, abs=1e-9)
    trace = statechart.run(read_text(text), step=1e-3, **steps).trace
    assert trace.outcome.name == "NO_CONSISTENT_MODE"
    assert "joint 'hinge' closes while its angle is beyond its limits" in str(trace.message)
    assert str(trace.message).endswith(", or take shorter steps")
    assert trace.t_end == pytest.approx(0.072, abs=1e-9)
    trace = statechart.run(read_text(text), step=1e-5, **steps).trace
    assert trace.final[2] == pytest.approx(most, abs=1e-4)


def test_a_joint_that_starts_beyond_a_limit_is_refused_without_a_length_as_its_angle() -> None:
    """The angle 0.9 is 0.4 beyond the limit; margins of limits are lengths."""
    text = """
kind: scene
name: arm
bodies: {arm: {mass: 2, inertia: 0.1, start: {angle: 0.9}}}
joints: {hinge: {point: {body: arm}, to: [0, 0], limits: [-1, 0.5]}}
stop: {time: 1}
"""
    with pytest.raises(
        DeclarationError, match="joint 'hinge' starts beyond a limit of its angle; "
    ):
        statechart.run(read_text(text))
