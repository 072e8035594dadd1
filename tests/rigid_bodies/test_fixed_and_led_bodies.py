"""Fixed and led bodies with shapes, beside closed forms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import statechart
from contacts.rigid_bodies.body_stepper import bodies_automaton
from contacts.rigid_bodies.declared_numbers import body_numbers
from contacts.rigid_bodies.mechanics import BodyMechanics
from contacts.rigid_bodies.prescribed_motion import Paths
from contacts.scene.scene import Scene
from contacts.testing.body_properties import assert_depths, body_properties
from statechart.arrays import Array
from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner
from statechart.testing.subject import Subject

G = 9.81
BOX = "{polygon: [[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]}"
MOVED = f"mass: 2, inertia: 0.04, shape: {BOX}"


def _run(bodies: str, collisions: str, further: str = "", **settings: Any) -> Result:
    step = settings.pop("step", 1e-3)
    text = f"""
kind: scene
name: n
gravity: {G}
bodies:
{bodies}
collisions:
{collisions}
{further}
settings: {{engine: impulse, step: {step}}}
"""
    throw = settings.pop("throw", True)
    return Runner(interpret(read_text(text))).run(until=settings.pop("until", 1.0), throw=throw)


SEAM = f"""
  box: {{{MOVED}, start: {{y: 0.1, dx: 4}}}}
  tile:
    fixed: true
    copies: 12
    shape: {{polygon: [[-0.5, -0.25], [0.5, -0.25], [0.5, 0.25], [-0.5, 0.25]]}}
    start: {{x: (1 + GAP)*index - 0.5, y: -0.25}}
"""


@pytest.mark.parametrize("gap", [0, 1e-6, 1e-3, 0.03])
def test_a_box_slides_over_level_fixed_crates_as_on_one(gap: float) -> None:
    far = 4.0**2 / (2 * 0.2 * G)
    for h in (8e-3, 3e-3, 1e-3, 2.5e-4):
        law = "  all: {bodies: [box, tile], friction: 0.2, restitution: 0}"
        result = _run(SEAM.replace("GAP", f"{gap}"), law, until=3.0, step=h)
        x, y, angle = result.trace.final[:3]
        assert result.trace.outcome is Outcome.HORIZON
        assert x == pytest.approx(far, abs=4.0 * h)
        assert (y, angle) == pytest.approx((0.1, 0.0), abs=1e-12)
        # It comes to rest once, and nothing strikes it on the way.
        assert [jump.cause for jump in result.trace.jumps] == ["touchdown", "stick"]


def test_an_elastic_ball_on_a_fixed_crate_keeps_its_energy() -> None:
    bodies = """
  ball: {mass: 1, inertia: 0.004, shape: {disc: 0.1}, start: {y: 1.1}}
  crate: {fixed: true, shape: {polygon: [[-1, -1], [1, -1], [1, 0], [-1, 0]]}}
"""
    result = _run(bodies, "  all: {bodies: [ball, crate], friction: 0, restitution: 1}", until=3.0)
    times = [jump.t for jump in result.trace.jumps]
    falls = math.sqrt(2.0 / G)
    assert times == pytest.approx([falls, 3 * falls, 5 * falls], abs=5e-3)
    assert "crate" not in result.trace.regions
    assert result.trace.variables == ("ball.x", "ball.y", "ball.angle", "ball.dx", "ball.dy",
                                      "ball.dangle")  # fmt: skip


def test_a_funnel_lets_a_ball_through_that_rolls_off_a_turned_crate() -> None:
    # A ball rolls down a crate that is turned: g sin(a)/(1 + I/(m r^2)) along it.
    slope, r = 0.3, 0.05
    bodies = f"""
  ball:
    mass: 1
    inertia: 0.5*{r}**2
    shape: {{disc: {r}}}
    start: {{x: -{r}*sin({slope}), y: {r}*cos({slope})}}
  ramp: {{fixed: true, shape: {{polygon: [[-2, -0.3], [2, -0.3], [2, 0], [-2, 0]]}},
         start: {{angle: {slope}}}}}
"""
    result = _run(bodies, "  all: {bodies: [ball, ramp], friction: 1, restitution: 0}", until=0.5)
    x, y = result.trace.final[:2]
    along = -(x * math.cos(slope) + y * math.sin(slope))
    assert along == pytest.approx(G * math.sin(slope) / 1.5 * 0.5**2 / 2, abs=1e-3)


BELT = f"""
  box: {{{MOVED}, start: {{y: 0.1}}}}
  belt:
    position: [v*time, -0.1]
    shape: {{polygon: [[-9, -0.1], [9, -0.1], [9, 0.1], [-9, 0.1]]}}
"""
RUB = "  all: {bodies: [box, belt], friction: 0.3, restitution: 0}\n"


def test_a_box_on_a_conveyor_gains_its_speed() -> None:
    v, gains = 1.5, 1.5 / (0.3 * G)
    more = """parameters: {v: 1.5}
outputs: {rides: {value: time, at: first box.stick}, place: {value: belt.x}, rate: {value: belt.dx}}
"""
    for h in (4e-3, 1e-3, 2.5e-4):
        result = _run(BELT, RUB, more, step=h)
        assert result.outputs["rides"] == pytest.approx(gains, abs=1.5 * h)
        assert result.outputs["place"] == pytest.approx(v, abs=1e-12)
        assert result.outputs["rate"] == pytest.approx(v, abs=1e-12)
        assert result.trace.final[0] == pytest.approx(v - v * gains / 2, abs=v * h)
        assert result.trace.final[3] == pytest.approx(v, abs=1e-12)


def test_a_paddle_pushes_a_box_and_strikes_it_with_its_speed() -> None:
    bodies = f"""
  box: {{{MOVED}, start: {{y: 0.1}}}}
  paddle:
    position: [v*time - 0.6, 0.1]
    shape: {{polygon: [[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]}}
"""
    for e, speed in ((0.0, 1.5), (0.5, 2.25)):
        laws = f"""  push: {{bodies: [box, paddle], friction: 0, restitution: {e}}}
  ground: {{bodies: [box], surfaces: [floor], friction: 0, restitution: 0}}
"""
        result = _run(bodies, laws, "parameters: {v: 1.5}\nsurfaces: {floor: {height: 0}}")
        meets = 0.3 / 1.5
        strikes = [jump.t for jump in result.trace.jumps if jump.cause == "impact"]
        assert strikes[:1] == pytest.approx([meets], abs=1e-3)
        assert result.trace.final[3] == pytest.approx(speed, abs=1e-12)
        assert result.trace.final[0] == pytest.approx((1 - meets) * speed, abs=2e-3)


def _bounces(a: float, w: float, e: float, until: float) -> list[float]:
    """Return when a ball at 0.3 above a shaken floor strikes it, by bisection on a closed form."""
    t, y, v, found = 0.0, 0.3, 0.0, []

    def gap(since: Any) -> Any:
        return y + v * since - G / 2 * since**2 - a * np.sin(w * (t + since))

    while True:
        later = np.linspace(1e-4, 2.0, 200_001)
        first = int(np.argmax(gap(later) < 0.0))
        low, high = float(later[first - 1]), float(later[first])
        for _ in range(80):
            middle = (low + high) / 2
            low, high = (middle, high) if gap(middle) > 0.0 else (low, middle)
        if t + high > until:
            return found
        t, falling = t + high, v - G * high
        floor = a * w * math.cos(w * t)
        y, v = a * math.sin(w * t), floor - e * (falling - floor)
        found.append(t)


def test_a_ball_bounces_on_a_shaken_body() -> None:
    a, w, e = 0.02, 20.0, 0.7
    bodies = """
  ball: {mass: 1, inertia: 0.004, shape: {disc: 0.1}, start: {y: 0.4}}
  table:
    position: [0, 0.02*sin(20*time) - 0.5]
    shape: {polygon: [[-1, -0.5], [1, -0.5], [1, 0.5], [-1, 0.5]]}
"""
    law = "  all: {bodies: [ball, table], friction: 0.2, restitution: 0.7}"
    right = _bounces(a, w, e, 1.6)
    for h in (1e-3, 1e-4, 1e-5):
        found = [jump.t for jump in _run(bodies, law, step=h, until=1.6).trace.jumps]
        assert len(found) == len(right) >= 3
        assert found == pytest.approx(right, abs=3 * h)


def test_a_turning_wheel_drags_a_disc_that_lies_on_it() -> None:
    # Under slip the disc gains mu g backwards and turns by mu m g r/I; the wheel's normal turns
    # by less than 1e-3 in that time.
    bodies = """
  puck: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {x: 0, y: 0.6}}
  wheel: {position: [0, 0], angle: 3*time, shape: {disc: 0.5}}
"""
    law = "  all: {bodies: [puck, wheel], friction: 0.2, restitution: 0}"
    result = _run(bodies, law, until=0.02, step=1e-4)
    assert result.trace.final[3] == pytest.approx(-0.2 * G * 0.02, rel=2e-3)
    assert result.trace.final[5] == pytest.approx(-0.2 * G * 0.1 / 0.01 * 0.02, rel=2e-3)


def test_controller_prescribes_a_slider() -> None:
    bodies = f"""
  box: {{{MOVED}, start: {{x: 0.4, y: 0.1}}}}
  slider:
    position: [s, 0.1]
    shape: {{polygon: [[-0.1, -0.05], [0.1, -0.05], [0.1, 0.05], [-0.1, 0.05]]}}
"""
    more = """surfaces: {floor: {height: 0}}
controls: {u: 0}
regions:
  drive:
    initial: waits
    variables: {s: 0}
    states:
      waits: {}
      pushes: {sets: {u: 2}, flows: {s: u}}
      holds: {}
    transitions:
      - {name: go, from: waits, to: pushes, after: 0.25}
      - {name: done, from: pushes, to: holds, guard: slider.x >= 0.6}
outputs: {place: {value: slider.x}, fastest: {maximum: slider.dx}}
"""
    laws = """  push: {bodies: [box, slider], friction: 0, restitution: 0}
  ground: {bodies: [box], surfaces: [floor], friction: 0, restitution: 0}
"""
    result = _run(bodies, laws, more)
    assert result.outputs["place"] == pytest.approx(0.6, abs=2.1e-3)
    assert result.outputs["fastest"] == pytest.approx(2.0)
    # The box goes on at 2 where the slider stops.
    assert result.trace.final[3] == pytest.approx(2.0, abs=1e-12)
    assert result.trace.final[0] == pytest.approx(0.9 + 2 * 0.45, abs=4e-3)


JUMPS = """surfaces: {floor: {height: 0}}
controls: {u: 2}
regions:
  lift:
    initial: down
    states: {down: {}, up: {sets: {u: TO}}}
    transitions: [{name: go, from: down, to: up, after: 0.3}]
"""


def test_jumping_path_is_checked_again() -> None:
    bodies = f"""
  box: {{{MOVED}, start: {{x: 0, y: 0.1}}}}
  shelf: {{position: [u, -0.1], shape: {{polygon: [[-1, -0.1], [1, -0.1], [1, 0.1], [-1, 0.1]]}}}}
"""
    law = "  all: {bodies: [box, shelf], friction: 0.3, restitution: 0}"
    resting = bodies.replace("[u, -0.1]", "[u - 2, -0.1]")
    # Away from below the box, which falls from then on, and no farther sideways.
    result = _run(resting, law, JUMPS.replace("TO", "9"), until=0.5)
    assert result.trace.final[:2] == pytest.approx([0.0, 0.1 - G / 2 * 0.2**2], abs=3e-3)
    law += "\n  ground: {bodies: [box], surfaces: [floor], friction: 0.3, restitution: 0}"
    # A stop condition on its boundary asks for forces before the jump is refused.
    for more in ("", "stop: {conditions: {goes: box.dx > 0}}\n"):
        result = _run(
            bodies.replace("-0.1], shape", "0.05], shape"),
            law,
            JUMPS.replace("TO", "0") + more,
            throw=False,
        )
        assert result.trace.outcome is Outcome.NO_CONSISTENT_MODE
        assert "the path of body 'shelf' jumps" in result.trace.message
        assert "body 'box' is 0." in result.trace.message


def test_a_fast_led_body_strikes_between_steps() -> None:
    # The bat passes the ball's place within a step, seen from one to the next.
    bodies = """
  ball: {mass: 1, inertia: 0.0004, shape: {disc: 0.02}, start: {x: 0, y: 0}}
  bat: {position: [-1 + 40*time, 0], shape: {polygon: [[-0.01, -0.3], [0.01, -0.3], [0.01, 0.3],
        [-0.01, 0.3]]}}
"""
    law = "  all: {bodies: [ball, bat], friction: 0, restitution: 1}"
    for h in (1e-2, 1e-3):
        result = _run(bodies, law, "", until=0.1, step=h)
        assert result.trace.final[3] == pytest.approx(80.0, rel=1e-9), h
        struck = [jump.t for jump in result.trace.jumps]
        assert struck == pytest.approx([(1 - 0.03) / 40], abs=h)


def test_properties_hold_and_are_checked_against_paths() -> None:
    text = f"""
kind: scene
name: n
gravity: {G}
parameters: {{v: 1.5}}
bodies: {BELT}
collisions:
{RUB}
stop: {{time: 0.6}}
settings: {{engine: impulse, step: 0.001}}
"""
    model = interpret(read_text(text))
    subject = Subject(model)
    for item in body_properties(model):
        item.holds(subject.case({}))
    trace, numbers, paths = (
        subject.case({}).trace,
        body_numbers(model, model.values()),
        Paths(BodyMechanics(model)),
    )

    def raised(times: Array, memories: Array, states: Mapping[str, str]) -> Array:
        return paths.at(trace.values, times, memories, states) + np.array([0.0, 0.01, 0.0])

    with pytest.raises(AssertionError, match=r"0\.01 deep in a body that moves as prescribed"):
        assert_depths(numbers, trace, raised)


MISTAKES = {
    "  a: {fixed: true, mass: 1, shape: {disc: 1}}": "a fixed body has no mass",
    "  a: {fixed: true, shape: {disc: 1}, start: {dx: 1}}": "a fixed body has no velocity",
    "  a: {fixed: true}": "a fixed body needs a shape",
    "  a: {shape: {disc: 1}}": "a body needs a mass",
    "  a: {position: [box.x, 0], shape: {disc: 1}}": "box.x",
    "  a: {position: [0, 0], inertia: 1, shape: {disc: 1}}": "no inertia",
    "  a: {static: true, shape: {disc: 1}}": "fixed: true",
}


@pytest.mark.parametrize("body", MISTAKES)
def test_mistakes_are_named(body: str) -> None:
    law = "  all: {bodies: [box, a], friction: 0.3, restitution: 0}"
    with pytest.raises(DeclarationError, match=MISTAKES[body]):
        _run(f"  box: {{{MOVED}, start: {{y: 9}}}}\n{body}", law)


def test_a_fixed_body_needs_collisions() -> None:
    scene = {"kind": "scene", "name": "n", "bodies": {
        "a": {"fixed": True, "shape": {"disc": 1}}, "b": {"mass": 1}}}  # fmt: skip
    with pytest.raises(ValueError, match="a fixed body takes part in collisions"):
        Scene.model_validate(scene)


def test_forces_on_prescribed_bodies_and_joints_from_them_are_refused() -> None:
    law = "  all: {bodies: [box, a], friction: 0.3, restitution: 0}"
    bodies = f"  box: {{{MOVED}, start: {{y: 9}}}}\n  a: {{fixed: true, shape: {{disc: 1}}}}"
    for more, message in (
        ("forces: {f: {body: a, force: [1, 0]}}", "'a' is fixed, and no force moves it"),
        (
            "joints: {j: {point: {body: a}, to: {body: box}}}",
            "'a' is fixed, and the point of a joint is on a body that moves by itself; name a body",
        ),
    ):
        with pytest.raises(DeclarationError, match=message):
            _run(bodies, law, more)


def test_a_spring_pulls_a_body_to_a_led_one() -> None:
    # m x'' = -k (x - a t) from rest: x = a t - (a/w) sin(w t).
    bodies = f"""
  box: {{{MOVED}, start: {{y: 5}}}}
  guide: {{position: [0.3*time, 0], shape: {{disc: 0.1}}}}
"""
    law = "  all: {bodies: [box, guide], friction: 0.3, restitution: 0}"
    more = "forces: {f: {body: box, force: [-50*(box.x - guide.x), 2*9.81]}}"
    x = _run(bodies, law, more, step=2e-4).trace.final[0]
    assert x == pytest.approx(0.3 - 0.3 / 5 * math.sin(5), abs=1e-4)


def test_the_default_step_follows_led_bodies_and_not_thin_fixed_ones() -> None:
    bodies = f"""
  box: {{{MOVED}, start: {{y: 0.1}}}}
  wall: {{fixed: true, shape: {{polygon: [[3, 0], [3.001, 0], [3.001, 1], [3, 1]]}}}}
"""
    law = "  all: {bodies: [box], friction: 0.3, restitution: 0}"
    bat = "  bat: {position: [50*time, 9], shape: {disc: 0.1}}\n"

    def step(bodies: str) -> float:
        text = f"kind: scene\nname: n\ngravity: {G}\nbodies:\n{bodies}\ncollisions:\n{law}\n"
        model = interpret(read_text(text))
        assert isinstance(model, Scene)
        found = bodies_automaton(model).default_step
        assert found is not None
        return found()

    without = bodies.split("  wall")[0]
    assert step(bodies) == step(without)
    assert step(without + bat) == pytest.approx(0.1 * 0.1 / 50, rel=0.1)


def test_a_wheel_that_turns_too_fast_for_the_step_gives_a_warning() -> None:
    bodies = """
  ball: {mass: 1, inertia: 0.004, shape: {disc: 0.1}, start: {y: 1}}
  vane: {position: [5, 0], angle: 900*time, shape: {polygon: [[-1, -0.1], [1, -0.1], [1, 0.1],
         [-1, 0.1]]}}
"""
    law = "  all: {bodies: [ball, vane], friction: 0, restitution: 1}"
    trace = _run(bodies, law, until=0.05, step=1e-2).trace
    assert any("turn by more than half a turn" in warning for warning in trace.warnings)


def test_led_bodies_may_be_declared_behind_fixed_ones() -> None:
    # A crate that is declared first stays, and the paddle behind it moves.
    bodies = f"""
  box: {{{MOVED}, start: {{y: 0.1, dx: -1}}}}
  crate:
    fixed: true
    copies: 6
    shape: {{polygon: [[-0.5, -0.2], [0.5, -0.2], [0.5, 0], [-0.5, 0]]}}
    start: {{x: index - 2.5}}
  paddle:
    position: [-1.5 + 0.4*time, 0]
    shape: {{polygon: [[-0.1, 0], [0, 0], [0, 0.2], [-0.1, 0.2]]}}
"""
    laws = """  slides: {bodies: [box, crate], friction: 0, restitution: 0}
  strikes: {bodies: [box, paddle], friction: 0, restitution: 1}
"""
    trace = _run(bodies, laws, until=1.5).trace
    # The gap of 1.3 closes at 1.4.
    assert [jump.t for jump in trace.jumps if jump.cause == "impact"] == pytest.approx(
        [1.3 / 1.4], abs=1e-3
    )
    assert trace.final[3] == pytest.approx(1.8, rel=1e-12)


STARTING = """
kind: scene
name: starting
gravity: 9.81
bodies:
  box: {mass: 1, inertia: 0.01, shape: {disc: 0.1}, start: {y: 0.1}}
LIFT
collisions: {all: {PARTNERS, restitution: 0.2, friction: 0.3}}
regions:
  pad:
    initial: rest
    variables: {p: 0}
    states: {rest: {}, up: {flows: {p: 1}}}
    transitions: [{name: go, from: rest, to: up, guard: "time >= 0.1"}]
  look:
    initial: a
    states: {a: {}, b: {}}
    transitions: [{name: see, from: a, to: b, guard: "in(pad.up) and box.dy <= 0.5"}]
stop: {time: 0.11}
"""


@pytest.mark.parametrize(
    ("lift", "partners"),
    [
        (
            "  lift: {shape: {polygon: [[-1, -1], [1, -1], [1, 0], [-1, 0]]}, position: [0, p]}",
            "bodies: [box, lift], surfaces: []",
        ),
        (
            "surfaces: {lift: {height: 0, displacement: [0, p]}}",
            "bodies: [box], surfaces: [lift]",
        ),
    ],
)
def test_bodies_set_in_motion_strike_before_guards_fire(lift, partners):
    """The disc has 1.2 m/s when the guard is evaluated, which is true for less; as with points."""
    text = STARTING.replace("LIFT", lift).replace("PARTNERS", partners)
    trace = Runner(interpret(read_text(text)), engine="impulse", step=1e-3).run().trace
    assert [jump.cause for jump in trace.jumps if jump.region in ("pad", "look")] == ["go"]
    # It left at 1.2 m/s.
    assert trace.final[3 + 1] == pytest.approx(1.2 - 9.81 * 0.01, abs=0.02)


PIVOT = "{position: ['0.1*sin(3*time)', 0], angle: W*time, shape: {disc: 0.05}}"
BOB = "mass: 1, inertia: 0.01, shape: {disc: 0.05}"
HANGS = "  all: {bodies: [bob, pivot], friction: 0.3, restitution: 0}"


def _angle(arm: float, turning: float, inertia: float) -> float:
    """Return the angle at t = 1 of a pendulum on an arm of the pivot, by Runge-Kutta."""

    def rates(t: float, y: Array) -> Array:
        turned = arm * turning**2
        ax = -0.9 * math.sin(3 * t) - turned * math.cos(turning * t)
        ay = G - turned * math.sin(turning * t)
        couple = -0.5 * (math.sin(y[0]) * ay + math.cos(y[0]) * ax)
        return np.array([y[1], couple / (0.25 + inertia)])

    y, h = np.zeros(2), 1e-3
    for k in range(1000):
        a = rates(h * k, y)
        b = rates(h * (k + 0.5), y + 0.5 * h * a)
        c = rates(h * (k + 0.5), y + 0.5 * h * b)
        y = y + h / 6 * (a + 2 * b + 2 * c + rates(h * (k + 1), y + h * c))
    return float(y[0])


@pytest.mark.parametrize("arm", [0.0, 0.2])
def test_a_pendulum_hangs_on_a_led_body(arm: float) -> None:
    bodies = f"""
  pivot: {PIVOT.replace("W", "2")}
  bob: {{{BOB}, start: {{x: {arm}, y: -0.5, dx: 0.3, dy: {2 * arm}}}}}
"""
    end = f"to: {{body: pivot, at: [{arm}, 0]}}"
    more = f"joints: {{j: {{point: {{body: bob, at: [0, 0.5]}}, {end}}}}}"
    errors = [
        _run(bodies, HANGS, more, step=h).trace.final[2] - _angle(arm, 2.0, 0.01)
        for h in (2e-3, 1e-3)
    ]
    assert abs(errors[1]) < 3e-6
    assert errors[0] == pytest.approx(4.0 * errors[1], rel=0.05)


@pytest.mark.parametrize("law", ["rod", "rope"])
def test_a_rod_and_a_rope_end_at_a_led_body(law: str) -> None:
    bodies = f"""
  pivot: {PIVOT.replace("W", "0")}
  bob: {{{BOB}, start: {{y: -0.5, dx: 0.3}}}}
"""
    more = f"joints: {{j: {{point: {{body: bob}}, to: {{body: pivot}}, {law}: 0.5}}}}"
    x, y = _run(bodies, HANGS, more).trace.final[:2]
    angle = math.atan2(x - 0.1 * math.sin(3), -y)
    assert angle == pytest.approx(_angle(0.0, 0.0, 0.0), abs=3e-6)


def test_a_weld_to_a_turning_body_carries_a_body_along() -> None:
    bodies = f"""
  pivot: {PIVOT.replace("W", "2")}
  bob: {{{BOB}, start: {{y: -0.5, dx: 0.3 + 1, dangle: 2}}}}
"""
    more = "joints: {j: {point: {body: bob}, to: {body: pivot, at: [0, -0.5]}, angle: held}}"
    placed = [0.1 * math.sin(3) + 0.5 * math.sin(2), -0.5 * math.cos(2), 2.0]
    np.testing.assert_allclose(_run(bodies, HANGS, more).trace.final[:3], placed, atol=2e-6)


def test_a_led_crank_turns_a_connecting_rod() -> None:
    # The rod is inclined by -asin(r sin(w t)/l); the force is greatest at the dead centre,
    # m w**2 (r + r**2/(2 l)).
    bodies = f"""
  bob: {{{BOB}, start: {{x: 0.25, dy: 0.5, dangle: -10/3}}}}
  pivot: {{position: [0, 0], angle: 10*time, shape: {{disc: 0.05}}}}
"""
    more = """
joints:
  pin: {point: {body: bob, at: [-0.15, 0]}, to: {body: pivot, at: [0.1, 0]}}
  guide: {point: {body: bob, at: [0.15, 0]}, to: {y: 0}}
gravity: 0
outputs: {force: {maximum: "hypot(pin.X, pin.Y)"}}
"""
    text = f"kind: scene\nname: n\nbodies:{bodies}collisions:\n{HANGS}\n{more}"
    settings = "settings: {engine: impulse, step: 2e-4}"
    result = Runner(interpret(read_text(text + settings))).run(until=1.0)
    up = math.asin(0.1 * math.sin(10) / 0.3)
    x = 0.1 * math.cos(10) + 0.15 * math.cos(up)
    np.testing.assert_allclose(result.trace.final[:3], [x, 0.15 * math.sin(up), -up], atol=2e-6)
    assert result.outputs["force"] == pytest.approx(35 / 3, rel=1e-5)


@pytest.mark.parametrize("pivot", ["fixed: true, start: {angle: 0.4}", "position: [0, 0.3*time]"])
def test_suction_to_a_fixed_or_led_body_keeps_the_place(pivot: str) -> None:
    bodies = f"""
  pivot: {{{pivot}, shape: {{disc: 0.05}}}}
  bob: {{{BOB}, start: {{x: 0.3, y: 2, dangle: 1}}}}
"""
    more = """
joints:
  j: {point: {body: bob}, to: {body: pivot}, angle: held, rest: captured, enabled: time >= 0.2}
"""
    speed = 0.0 if "fixed" in pivot else 0.3
    place = [0.3, 2 - G * 0.02 + 0.8 * speed, 0.2, 0.0, speed, 0.0]
    np.testing.assert_allclose(_run(bodies, HANGS, more).trace.final[:6], place, atol=2e-3)


def test_friction_in_a_joint_to_a_fixed_body_is_against_the_world() -> None:
    # I w/M = 0.01*3/0.02
    bodies = (
        f"  pivot: {{fixed: true, shape: {{disc: 0.05}}}}\n  bob: {{{BOB}, start: {{dangle: 3}}}}"
    )
    more = """
joints: {j: {point: {body: bob}, to: {body: pivot}}}
couplings: {bearing: {joint: j, limit: 0.02}}
outputs: {rests: {value: time, at: first bearing.lock}}
"""
    found = _run(bodies, HANGS, more, until=2.0).outputs["rests"]
    assert found == pytest.approx(1.5, abs=1e-3)


@pytest.mark.parametrize("to", ["{body: pivot}", "[s, 0]"])
def test_a_path_that_jumps_off_a_closed_joint_ends_the_run(to: str) -> None:
    bodies = f"""
  pivot: {{position: [s, 0], shape: {{disc: 0.05}}}}
  bob: {{{BOB}, start: {{y: -0.5}}}}
"""
    more = f"""
joints: {{j: {{point: {{body: bob, at: [0, 0.5]}}, to: {to}}}}}
regions:
  r:
    initial: a
    variables: {{s: 0}}
    states: {{a: {{}}, b: {{entry: {{s: 0.2}}}}}}
    transitions: [{{name: go, from: a, to: b, guard: time >= 0.5}}]
"""
    trace = _run(bodies, HANGS, more, throw=False).trace
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "jumps at t = 0.5, and opens joint 'j' by 0.2;" in str(trace.message)


LIMITS = "limits: [-0.2, 0.2]"


@pytest.mark.parametrize(
    ("angle", "jump", "opening", "turned"),
    [("angle: held", 0.3, 0.3, 1.0), (LIMITS, 0.3, 0.3, 0.8), (LIMITS, -1.0, 0.6, 0.8)],
)
def test_an_angle_that_jumps_off_a_joint_ends_the_run(
    angle: str, jump: float, opening: float, turned: float
) -> None:
    bodies = f"""
  pivot: {{position: [0, 0], angle: s, shape: {{disc: 0.05}}}}
  bob: {{{BOB}}}
"""
    more = f"""
joints: {{j: {{point: {{body: bob}}, to: {{body: pivot}}, {angle}}}}}
regions:
  r:
    initial: a
    variables: {{s: 0}}
    states: {{a: {{flows: {{s: 1}}}}, b: {{entry: {{s: s + TO}}, flows: {{s: 1}}}}}}
    transitions: [{{name: go, from: a, to: b, guard: time >= 0.5}}]
"""
    trace = _run(bodies, HANGS, more.replace("TO", str(jump)), throw=False).trace
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert f"jumps at t = 0.5, and opens joint 'j' by {opening} radians" in str(trace.message)
    final = _run(bodies, HANGS, more.replace("TO", "0")).trace.final
    assert final[2] == pytest.approx(turned, abs=1e-3)


@pytest.mark.parametrize("rest", ["", "rest: captured, "])
def test_a_joint_that_closes_beyond_its_limits_ends_the_run(rest: str) -> None:
    bodies = f"""
  pivot: {{position: [0, 0], shape: {{disc: 0.05}}}}
  bob: {{{BOB}, start: {{angle: START}}}}
"""
    law = "  all: {bodies: [bob], friction: 0.3, restitution: 0}"
    joint = f"{{point: {{body: bob}}, to: {{body: pivot}}, {LIMITS}, {rest}enabled: time >= 1e-3}}"
    more = f"joints: {{j: {joint}}}"
    trace = _run(bodies.replace("START", "1"), law, more, throw=False).trace
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "while its angle is 0.8 radians beyond its limits" in str(trace.message)
    final = _run(bodies.replace("START", "0.1"), law, more).trace.final
    assert final[2] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize(("pivot", "other"), [("0", "s"), ("0.1*s", "0")])
def test_a_jump_that_opens_no_joint_ends_no_run(pivot: str, other: str) -> None:
    # The landing leaves the angle 0.00115 beyond its limit.
    bodies = f"""
  pivot: {{position: [0, 0], angle: {pivot}, shape: {{disc: 0.05}}}}
  other: {{position: [9 + {other}, 0], shape: {{disc: 0.05}}}}
  bob: {{{BOB}, start: {{dangle: {2.7 if other == "s" else 0}}}}}
"""
    more = f"""
joints: {{j: {{point: {{body: bob}}, to: {{body: pivot}}, {LIMITS}}}}}
regions:
  r:
    initial: a
    variables: {{s: 0}}
    states: {{a: {{}}, b: {{entry: {{s: 1}}}}}}
    transitions: [{{name: go, from: a, to: b, guard: time >= 0.5}}]
"""
    law = "  all: {bodies: [bob, pivot, other], friction: 0.3, restitution: 0}"
    final = _run(bodies, law, more).trace.final
    assert final[2] == pytest.approx(0.2 if other == "s" else 0.0, abs=2e-3)


def test_copies_are_welded_to_copies_of_led_bodies() -> None:
    bodies = f"""
  pivot: {{copies: 2, position: [index, 0.1*sin(time)], shape: {{disc: 0.05}}}}
  bob: {{{BOB}, copies: 2, start: {{x: index, y: -0.5, dy: 0.1}}}}
"""
    more = "joints: {j: {point: {body: bob1}, to: {body: pivot1, at: [0, -0.5]}, angle: held}}"
    y = _run(bodies, HANGS, more).trace.final[4]
    assert y == pytest.approx(0.1 * math.sin(1) - 0.5, abs=1e-6)


@pytest.mark.parametrize("joined", [True, False])
def test_a_led_body_that_collides_with_nothing_may_be_the_end_of_a_joint(joined: bool) -> None:
    bodies = f"  pivot: {PIVOT.replace('W', '0')}\n  bob: {{{BOB}, start: {{y: -0.5, dx: 0.3}}}}"
    law = "  all: {bodies: [bob], friction: 0.3, restitution: 0}"
    more = "joints: {j: {point: {body: bob, at: [0, 0.5]}, to: {body: pivot}}}" if joined else ""
    found = _run(bodies, law, more, until=0.01).trace.warnings
    assert any("pivot: it collides with nothing" in text for text in found) != joined


PUSHED = """
kind: scene
name: pushed
gravity: 9.81
bodies:
  box: {mass: 1, inertia: 0.005, start: {y: 0.1, x: 0.2}, shape: {polygon: SQUARE}}
  pusher: {position: [0.5*time - back, 0.1], shape: {polygon: [[-0.05, -0.05], [0.05, -0.05],
    [0.05, 0.05], [-0.05, 0.05]]}}
surfaces: {floor: {height: 0}}
collisions: {a: {bodies: [box, pusher], surfaces: [floor], friction: 0.3, restitution: 0}}
regions:
  drive:
    variables: {back: 0}
    initial: on
    states: {on: {}, off: {flows: {back: 1}}}
    transitions: [{name: full, from: on, to: off, guard: box.x >= 0.4}]
stop: {time: 1}
settings: {engine: impulse}
"""


@pytest.mark.parametrize("step", [1e-2, 1e-3, 5e-4, 1e-4])
def test_a_box_sticks_to_what_pushes_it_along_a_floor_until_that_retreats(step):
    """Only the friction of the floor presses it on: the free acceleration there is zero."""
    square = "[[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]]"
    trace = statechart.run(read_text(PUSHED.replace("SQUARE", square)), step=step).trace
    events = [(jump.region, jump.cause) for jump in trace.jumps]
    assert events == [
        ("box", "touchdown"), ("box", "impact"), ("drive", "full"), ("box", "slip"),
        ("box", "stick"),
    ]  # fmt: skip
    times = [jump.t for jump in trace.jumps]
    assert times == pytest.approx([0, 0.1, 0.5, 0.5, 0.5 + 0.5 / (0.3 * 9.81)], abs=step)
