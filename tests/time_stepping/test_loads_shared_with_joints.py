"""Contacts and couplings that share their load with joints: steps against events and statics."""

from __future__ import annotations

import math

import pytest

import statechart
from contacts import Body, Contact, Coupling, Force, Joint, Point, Scene, Surface
from statechart import Stop, Value
from statechart.running.result import Result

INDETERMINATE = "indeterminate: the smallest are shown"


def beam(friction: float, limit: float, joint: Joint) -> Scene:
    """A beam of weight 10, held at its left end, on two supports 1 and 2 to the right of it."""
    end = {"surface": "floor", "friction": friction, "restitution": 0}
    return Scene(
        name="beam",
        gravity=10,
        bodies={"b": Body(mass=1, inertia=1)},
        surfaces={"floor": Surface(height=0)},
        joints={"a": joint},
        contacts={
            "m": Contact(point=Point(body="b"), **end),
            "r": Contact(point=Point(body="b", at=(1, 0)), **end),
        },
        couplings={"c": Coupling(bodies=["b"], limit=limit)} if limit else {},
        stop=Stop(time=0.2),
        outputs={"m": Value(value="m.V"), "r": Value(value="r.V"), "a": Value(value="a.Y")},
    )


LEFT = Point(body="b", at=(-1, 0))
JOINTS = {"pin": Joint(point=LEFT, to=(-1, 0)), "guide": Joint(point=LEFT, to={"y": 0})}


@pytest.mark.parametrize("joint", JOINTS)
@pytest.mark.parametrize("friction", [0, 0.5])
@pytest.mark.parametrize("limit", [0, 1])
def test_supports_share_by_steps_as_with_events(joint: str, friction: float, limit: float) -> None:
    scene = beam(friction, limit, JOINTS[joint])
    # Moments about the joint: m + 2 r = 10 - limit, with the least m^2 + r^2.
    bears = (10.0 - limit) / 5.0
    expected = {"m": bears, "r": 2.0 * bears, "a": 10.0 - 3.0 * bears}
    for engine, step in (("taylor", None), ("impulse", 1e-3)):
        run = statechart.run(scene, engine=engine, step=step)
        assert run.outputs == pytest.approx(expected, abs=1e-9)
        assert [w for w in run.warnings if INDETERMINATE in w and "m, r" in w]
        # Round-off lifts nothing off.
        assert not [jump for jump in run.trace.jumps if jump.cause == "liftoff"]


def test_unloaded_supports_beside_a_joint_are_indeterminate() -> None:
    scene = beam(0, 0, Joint(point=Point(body="b"), to=(0, 0)))
    end = scene.contacts["r"]
    left = end.model_copy(update={"point": LEFT})
    scene = scene.model_copy(update={"contacts": {"m": left, "r": end}})
    for engine, step in (("taylor", None), ("impulse", 1e-3)):
        run = statechart.run(scene, engine=engine, step=step)
        assert run.outputs == pytest.approx({"m": 0, "r": 0, "a": 10}, abs=1e-12)
        assert [w for w in run.warnings if INDETERMINATE in w]


def welded(engine: str) -> Result:
    """A wheel that a weld holds against a couple of 1, with a brake."""
    scene = Scene(
        name="wheel",
        bodies={"b": Body(mass=1, inertia=1)},
        joints={"a": Joint(point=Point(body="b"), to=(0, 0), angle="held")},
        couplings={"c": Coupling(bodies=["b"], limit=3)},
        forces={"drive": Force(body="b", moment=1)},
        stop=Stop(time=0.1),
        outputs={"couple": Value(value="a.M")},
    )
    return statechart.run(scene, engine=engine, step=1e-3 if engine == "impulse" else None)


@pytest.mark.parametrize("engine", ["taylor", "scipy", "impulse"])
def test_a_brake_on_a_welded_body_is_locked_and_bears_nothing(engine: str) -> None:
    run = welded(engine)
    assert run.trace.start_mode == ("locked",)
    assert run.outputs["couple"] == pytest.approx(-1, abs=1e-12)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
@pytest.mark.parametrize("angle", [0.3, 0.7])
@pytest.mark.parametrize("units", [1.0, 1e-6])
def test_a_brake_in_a_triangle_of_bars_bears_nothing(
    engine: str, angle: float, units: float
) -> None:
    # By hand: by symmetry the ridge pushes p with H along x; moments about a: H = g c / (2 s).
    c, s = units * math.cos(angle), units * math.sin(angle)
    start = {"y": 0.5 * s}
    scene = Scene(
        name="triangle",
        gravity=10,
        bodies={
            "p": Body(mass=1, inertia=units**2, start={**start, "x": 0.5 * c, "angle": angle}),
            "q": Body(mass=1, inertia=units**2, start={**start, "x": 1.5 * c, "angle": -angle}),
        },
        joints={
            "a": Joint(point=Point(body="p", at=(-0.5 * units, 0)), to=(0, 0)),
            "m": Joint(
                point=Point(body="p", at=(0.5 * units, 0)),
                to=Point(body="q", at=(-0.5 * units, 0)),
            ),
            "b": Joint(point=Point(body="q", at=(0.5 * units, 0)), to=(2 * c, 0)),
        },
        couplings={"c": Coupling(bodies=["p"], limit=3 * units)},
        stop=Stop(time=0.05),
        outputs={"X": Value(value="a.X"), "Y": Value(value="a.Y"), "M": Value(value="c.M")},
    )
    run = statechart.run(scene, engine=engine)
    assert run.trace.start_mode == ("locked",)
    expected = {"X": 5.0 * c / s, "Y": 10.0, "M": 0.0}
    assert run.outputs == pytest.approx(expected, abs=1e-9)
