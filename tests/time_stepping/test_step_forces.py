"""Forces and impulses of time steps."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from strategies import examples

from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.documents.outputs import Integral, Maximum, Value
from statechart.documents.settings import Stop
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.runner import Runner

MASS = 1.3


def corner(simultaneous="capped"):
    """Return a bar with two feet, thrown on the floor beside a wall that its end may strike."""
    contacts = {
        name: Contact(
            point=Point(body="bar", at=at),
            surface=surface,
            friction="mu",
            restitution="e",
            impact="moreau",
        )
        for name, at, surface in (
            ("left", ("-l", "-d"), "floor"),
            ("right", ("r", "-d"), "floor"),
            ("top", ("r", "d"), "wall"),
        )
    }
    return Scene(
        name="corner",
        parameters={
            "l": 0.3, "r": 0.4, "d": 0.1, "I": 0.1, "mu": 0.5, "e": 0.3, "wall": 1.0,
            "x": 0.0, "y": 0.2, "a": 0.1, "u": 1.0, "v": -1.0, "w": 0.0,
        },
        gravity=9.81,
        bodies={
            "bar": Body(
                mass=MASS, inertia="I",
                start={"x": "x", "y": "y", "angle": "a", "dx": "u", "dy": "v", "dangle": "w"},
            )
        },
        surfaces={
            "floor": Surface(height=0),
            "wall": Surface(line=(("wall", 0), ("wall", 1))),
        },
        contacts=contacts,
        simultaneous=simultaneous,
        stop=Stop(time=0.6),
        outputs={"V_max": Maximum(maximum="left.V"), "H_max": Maximum(maximum="abs(right.H)")},
    )  # fmt: skip


@st.composite
def thrown(draw):
    """Draw a bar above the floor and left of the wall."""
    values = {
        "l": draw(st.floats(0.1, 0.5)),
        "r": draw(st.floats(0.1, 0.5)),
        "d": draw(st.floats(0.02, 0.2)),
        "I": draw(st.floats(0.02, 0.3)),
        "mu": draw(st.floats(0.0, 1.5)),
        "e": draw(st.sampled_from([0.0]) | st.floats(0.0, 0.8)),
        "a": draw(st.sampled_from([0.0]) | st.floats(-0.5, 0.5)),
        "u": draw(st.floats(-1.0, 2.0)),
        "v": draw(st.floats(-1.0, 0.0)),
        "w": draw(st.floats(-3.0, 3.0)),
    }
    c, s = math.cos(values["a"]), math.sin(values["a"])
    points = [(-values["l"], -values["d"]), (values["r"], -values["d"])]
    lowest = min(s * x + c * y for x, y in points)
    values["y"] = -lowest + draw(st.sampled_from([0.0, 1e-3]) | st.floats(0.0, 0.1))
    values["wall"] = c * values["r"] + s * values["d"] + 0.6 * draw(st.floats(0.05, 1.0))
    assume(c * values["r"] - s * values["d"] < values["wall"])
    return values


@cache
def cornered(simultaneous, engine, step=None):
    return Runner(corner(simultaneous), engine=engine, step=step)


@given(thrown(), st.sampled_from([1e-3, 2.7e-4]))
@examples(15)
def test_impulses_lie_in_the_cone_and_equal_the_change_of_momentum(values, step):
    trace = cornered("capped", "impulse", step).run(values, throw=False).trace
    for jump in trace.jumps:
        push = np.zeros(2)
        for name, (V, H) in jump.impulse.items():
            assert V >= 0.0
            assert abs(H) <= values["mu"] * V * (1.0 + 1e-12)
            # The wall's normal is to the left; slip is positive upwards.
            push += (H, V) if name != "top" else (-V, H)
        n = len(jump.before) // 2
        change = MASS * (jump.after[n:] - jump.before[n:])[:2]
        size = sum(math.hypot(*impulse) for impulse in jump.impulse.values())
        assert change == pytest.approx(push, abs=1e-7 * size + 1e-12)


@cache
def landing(engine, step=None):
    """Return a particle that falls on an incline and rests or slides there."""
    scene = Scene(
        name="landing",
        parameters={"m": 1.0, "a": 0.3, "mu": 0.5, "e": 0.3, "drop": 0.1, "u": 0.0},
        gravity=9.81,
        bodies={"ball": Body(mass="m", start={"y": "drop", "dx": "u"})},
        surfaces={"slope": Surface(incline="a")},
        contacts={
            "base": Contact(
                point=Point(body="ball"), surface="slope", friction="mu", restitution="e"
            )
        },
        stop=Stop(time=0.5),
        outputs={
            "V_max": Maximum(maximum="base.V"),
            "H_max": Maximum(maximum="abs(base.H)"),
            "landed": Value(value="base.V", at="last base.touchdown"),
            "V_sum": Integral(integral="base.V"),
        },
    )
    return Runner(scene, engine=engine, step=step)


@given(
    st.fixed_dictionaries(
        {
            "m": st.floats(0.1, 10.0),
            "a": st.floats(-0.6, 0.6),
            "mu": st.floats(0.0, 1.5),
            "e": st.sampled_from([0.0]) | st.floats(0.0, 0.5),
            "drop": st.floats(0.01, 0.2),
            "u": st.floats(-1.0, 1.0),
        }
    ),
    st.sampled_from([1e-3, 1.3e-4]),
)
@examples(15)
def test_largest_force_excludes_the_landing_impulse(values, step):
    # At any step: an impulse divided by the step is not a force.
    outputs = landing("impulse", step).run(values).outputs
    weight = values["m"] * 9.81 * math.cos(values["a"])
    assert outputs["V_max"] == pytest.approx(weight, rel=1e-6) or outputs["V_max"] == 0.0
    assert outputs["H_max"] <= values["mu"] * weight * (1.0 + 1e-6)
    assert math.isfinite(outputs["V_sum"])


@given(thrown(), st.sampled_from([2e-4, 3e-5]))
@examples(2)
def test_the_largest_forces_of_a_bar_are_those_of_the_run_with_events(values, step):
    # Bounces that a step does not resolve are other modes, with forces of their own.
    values |= {"wall": 9.0, "e": 0.0}
    exact = cornered("capped", "scipy").run(values, throw=False)
    assume(exact.trace.outcome.succeeded)
    found = cornered("capped", "impulse", step).run(values, throw=False)
    assume(found.trace.modes == exact.trace.modes)
    for name, force in (("V_max", "left.V"), ("H_max", "right.H")):
        # The change of forces in the steps after an event, which have none, and the effect of a
        # landing's place in its step on the motion of a second.
        error = 5.0 * step * (steepest(exact, force) + MASS * 9.81)
        assert found.outputs[name] == pytest.approx(exact.outputs[name], abs=error), name


def steepest(result, force):
    """Return how fast a force changes at most, but for its jumps."""
    times = np.linspace(0.0, result.trace.t_end, 6001)
    values = result.observer.sample(result.trace, [force], times=times).columns[force]
    jumps = np.searchsorted([jump.t for jump in result.trace.jumps], times)
    return np.abs(np.diff(values)[np.diff(jumps) == 0]).max() / times[1]


def test_force_after_a_landing_is_the_lasting_one():
    outputs = landing("impulse", 1e-3).run({"e": 0.0}).outputs
    assert outputs["landed"] == pytest.approx(9.81 * math.cos(0.3), rel=1e-9)


@pytest.mark.parametrize("step", [1e-3, 1e-4])
def test_joint_forces_after_an_impact_have_no_peak(step):
    """The two steps after an impact move the joint to its new error, and say nothing of forces.

    A ball strikes a hanging arm at its centre without loss: w = 2 v m r/(J + 2 m r^2), and the pin
    bears m (g + w^2 r) = 15.4 N, not twice the centripetal part.
    """
    text = """
kind: scene
name: knocked
gravity: 9.81
bodies:
  arm: {mass: 1, inertia: 0.1, start: {y: -0.5}}
  ball: {mass: 1, start: {x: -0.01, y: -0.5, dx: 2}}
surfaces: {side: {body: arm, line: [[0, -0.5], [0, 0.5]]}}
contacts: {hit: {point: {body: ball}, surface: side, friction: 0, restitution: 1}}
joints:
  pin: {point: {body: arm, at: [0, 0.5]}, to: [0, 0], enabled: 'hypot(pin.X, pin.Y) <= 17'}
stop: {time: 0.03}
"""
    result = Runner(read_text(text), engine="impulse", step=step).run()
    assert [jump.cause for jump in result.trace.jumps] == ["touchdown"]


@pytest.mark.parametrize("part", [1.0, 0.5, 0.01])
@pytest.mark.parametrize("step", [1e-2, 1e-3])
def test_the_first_step_and_a_shorter_last_one_have_the_tension_of_a_rod(step, part):
    """Two particles of 1 kg circle 1 m apart at 1 m/s: the tension is m v^2/r = 2 N."""
    text = """
kind: scene
name: pair
gravity: 0
bodies: {a: {mass: 1, start: {dy: -1}}, b: {mass: 1, start: {x: 1, dy: 1}}}
joints: {r: {point: {body: a}, to: {body: b}, rod: 1}}
stop: {time: 1.5}
outputs: {end: {value: r.T}, most: {maximum: r.T}}
"""
    runner = Runner(read_text(text), engine="impulse", step=step)
    outputs = runner.run(until=1.5 + part * step).outputs
    assert outputs["end"] == pytest.approx(2.0, abs=3.0 * step**2 + 1e-7)
    assert outputs["most"] == pytest.approx(2.0, abs=3.0 * step**2 + 1e-7)


@pytest.mark.parametrize(("drag", "warned"), [("200*block.dx", True), ("1", False)])
def test_a_stick_with_its_friction_at_the_bound_gives_a_warning(drag: str, warned: bool) -> None:
    """The push balances friction but for the drag: the slip is exp(-100 t), to its round-off."""
    text = f"""
kind: scene
name: creeping
parameters: {{v0: 1, mu: 0.5, m: 2}}
gravity: 9.81
bodies: {{block: {{mass: m, start: {{dx: v0}}}}}}
surfaces: {{floor: {{height: 0}}}}
contacts: {{base: {{point: {{body: block}}, surface: floor, friction: mu, modes: [slide, pin]}}}}
forces: {{push: {{body: block, force: ["mu*m*9.81 - {drag}", 0]}}}}
stop: {{time: 3}}
settings: {{engine: impulse, step: 1e-3}}
"""
    result = Runner(interpret(read_text(text))).run()
    assert [jump.cause for jump in result.trace.jumps] == ["stick"]
    assert result.warnings == (
        ("base comes to rest with its friction at the bound: it sticks, and might slip on",)
        if warned
        else ()
    )


@pytest.mark.parametrize(("drag", "warned"), [("100*wheel.dangle", True), ("1", False)])
def test_a_lock_with_its_couple_at_the_limit_gives_a_warning(drag: str, warned: bool) -> None:
    """A moment balances a brake but for the drag: the slip is exp(-100 t), to its round-off."""
    text = f"""
kind: scene
name: creeping
gravity: 0
bodies: {{wheel: {{mass: 1, inertia: 1, start: {{dangle: 1}}}}}}
couplings: {{brake: {{bodies: [wheel], limit: 5}}}}
forces: {{push: {{body: wheel, moment: "5 - {drag}"}}}}
stop: {{time: 3}}
settings: {{engine: impulse, step: 1e-3}}
"""
    result = Runner(interpret(read_text(text))).run()
    assert [jump.cause for jump in result.trace.jumps] == ["lock"]
    words = "brake comes to rest with its friction at the bound: it sticks, and might slip on"
    assert result.warnings == ((words,) if warned else ())


SOFT_WALL = """
kind: scene
name: soft_wall
bodies: {{b: {{mass: 1, inertia: 0.004, {shape} start: {{x: 0.5, dx: 2}}}}}}
surfaces: {{wall: {{line: [[1, 0], [1, 1]]}}}}
{contact}
stop: {{time: 0.2}}
outputs: {{v: {{value: b.dx}}}}
"""
_SOFT = "friction: 0.3, stiffness: 5000, damping: 10"


@pytest.mark.parametrize("step", [2e-3, 1e-3, 5e-4, 2.5e-4])
@pytest.mark.parametrize(
    ("shape", "contact"),
    [
        ("", f"contacts: {{c: {{point: {{body: b}}, radius: 0.1, surface: wall, {_SOFT}}}}}"),
        ("shape: {disc: 0.1},", f"collisions: {{c: {{bodies: [b], surfaces: [wall], {_SOFT}}}}}"),
    ],
)
def test_a_compliant_contact_that_touches_at_the_end_of_a_step_has_no_force_in_it(
    shape: str, contact: str, step: float
) -> None:
    # It touches at (1 - 0.1 - 0.5)/2 = 0.2, the end of the run.
    text = SOFT_WALL.format(shape=shape, contact=contact)
    result = Runner(read_text(text), engine="impulse", step=step).run({})
    assert result.outputs["v"] == pytest.approx(2.0, abs=1e-4)


@pytest.mark.parametrize(("y", "dy"), [(1e-4, -0.1), (3e-4, -0.1), (3e-4, -0.3)])
@pytest.mark.parametrize("damping", [0, 10])
@pytest.mark.parametrize(
    ("shape", "contact"),
    [
        ("", "contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, "),
        ("shape: {disc: 0.5},", "collisions: {c: {bodies: [b], surfaces: [floor], friction: 0.3, "),
    ],
)
def test_a_compliant_contact_touches_down_where_its_gap_ends(
    shape: str, contact: str, damping: int, y: float, dy: float
) -> None:
    """Without gravity the gap y + dy t ends at -y/dy, here the end of a step."""
    text = f"""
kind: scene
name: soft_floor
gravity: 0
bodies: {{b: {{mass: 1, inertia: 0.1, {shape} start: {{y: {y + 0.5 * bool(shape)}, dy: {dy}}}}}}}
surfaces: {{floor: {{height: 0}}}}
{contact}stiffness: 5000, damping: {damping}}}}}
stop: {{time: 0.01}}
"""
    trace = Runner(read_text(text), engine="impulse", step=1e-3).run({}).trace
    (jump,) = trace.jumps
    assert jump.cause == "touchdown"
    assert jump.t == pytest.approx(-y / dy, abs=1e-9)
