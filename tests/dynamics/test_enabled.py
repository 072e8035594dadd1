"""Times at which contacts with conditions, or on edges that end, switch off and on."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from runs import ENGINES, engine

from contacts.kind import automaton
from contacts.scene.joints import Force
from contacts.scene.modes import Pin, Slide
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from contacts.testing.scene_properties import properties
from contacts.testing.symmetry import mirrored, rescaled
from statechart.automaton.trace import Trace
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.documents.yaml_writer import dump
from statechart.errors import DeclarationError, DeclarationProblem
from statechart.execution.simulator import Simulator
from statechart.running.runner import run
from statechart.testing.agreement import assert_same
from statechart.testing.subject import Subject


def _scene(surface: Surface, start: dict[str, Any], **contact: Any) -> Scene:
    """Return a particle over a surface, under gravity 1."""
    fields = {"friction": 0.5, "restitution": 0, **contact}
    return Scene(
        name="scene",
        gravity=1,
        bodies={"p": Body(mass=1, start=start)},
        surfaces={"s": surface},
        contacts={"c": Contact(point=Point(body="p"), surface="s", **fields)},
        stop={"time": 4},
    )


def _run(scene: Scene, name: str = "taylor", until: float = 4.0) -> Trace:
    return Simulator(automaton(scene), engine(name)).run(until=until)


def _story(trace: Trace) -> list[tuple[str, float]]:
    return [(jump.cause, jump.t) for jump in trace.jumps]


def _hold(scene: Scene) -> None:
    """Check all properties of a scene at its declared parameters."""
    subject = Subject(scene)
    case = subject.case({})
    for prop in properties(scene):
        if not prop.skipped:
            prop.holds(case)


@pytest.mark.parametrize("name", ENGINES)
def test_disabled_ground_releases_and_enabled_ground_catches(name: str) -> None:
    # Held for a second, pushed up from below the ground for another, and caught coming down.
    scene = _scene(Surface(height=0), {"y": 0}, enabled="abs(time - 1.5) > 0.5")
    push = {"push": Force(body="p", force=(0, "4*sin(pi*(time - 1))"))}
    trace = _run(scene.model_copy(update={"forces": push}), name)
    assert trace.start_mode == ("pin",)
    causes = [cause for cause, _ in _story(trace)]
    assert causes[:3] == ["disable", "enable", "touchdown"]
    times = [t for _, t in _story(trace)]
    assert times[:2] == pytest.approx([1.0, 2.0], abs=1e-12)
    assert trace.jumps[0].target == ("off",)
    assert trace.jumps[2].impulse["c"][0] > 0


@pytest.mark.parametrize("name", ENGINES)
def test_penetrating_point_is_enabled_after_it_leaves(name: str) -> None:
    # Thrown up from below: the conditions hold all the time, the gap is open from t = 1 on.
    scene = _scene(Surface(height=0), {"y": -1.5, "dy": 2}, enabled="time >= 0")
    trace = _run(scene.model_copy(update={"initial_modes": {"c": "off"}}), name)
    assert trace.start_mode == ("off",)
    out = 2 - math.sqrt(4 - 3)
    assert _story(trace) == [
        ("enable", pytest.approx(out, abs=1e-12)),
        ("touchdown", pytest.approx(2 + 1, abs=1e-12)),
    ]
    assert trace.final_mode == ("pin",)


@pytest.mark.parametrize("name", ENGINES)
def test_conditions_fail_one_by_one_and_hold_together(name: str) -> None:
    scene = _scene(Surface(height=0), {"y": 3, "dx": 1}, enabled=["p.x > 1", "p.x < 2"])
    trace = _run(scene, name)
    assert _story(trace) == [
        ("enable", pytest.approx(1.0, abs=1e-12)),
        ("disable", pytest.approx(2.0, abs=1e-12)),
    ]
    assert trace.final[1] == pytest.approx(3 - 8, abs=1e-11)


@pytest.mark.parametrize("name", ENGINES)
def test_a_particle_slides_off_the_end_of_a_table(name: str) -> None:
    table = Surface(edge=((-1, 2), (1, 2)))
    scene = _scene(table, {"y": 2, "dx": 2})
    trace = _run(scene, name)
    # Friction 0.5 brakes from 2: x = 2 t - t^2/4 is 1 at t = 4 - sqrt(12).
    left = 4 - math.sqrt(12)
    assert _story(trace) == [("disable", pytest.approx(left, abs=1e-10))]
    flight = 4 - left
    assert trace.final[0] == pytest.approx(1 + (2 - left / 2) * flight, abs=1e-9)
    assert trace.final[1] == pytest.approx(2 - flight**2 / 2, abs=1e-9)
    _hold(scene)


@pytest.mark.parametrize(("x", "caught"), [(-1.001, False), (-0.999, True), (1.001, False)])
def test_only_points_between_its_ends_meet_an_edge(x: float, caught: bool) -> None:
    trace = _run(_scene(Surface(edge=((-1, 2), (1, 2))), {"x": x, "y": 3}))
    assert (trace.final_mode == ("pin",)) is caught


def test_the_edge_of_a_body_moves_with_it() -> None:
    # A cart runs away under a particle that lies on its platform without friction.
    scene = Scene(
        name="cart",
        gravity=1,
        bodies={
            "cart": Body(mass=1, inertia=1, start={"dx": 1}),
            "p": Body(mass=1, start={"y": 1}),
        },
        surfaces={
            "platform": Surface(edge=((-1, 1), (1, 1)), body="cart"),
            "rail": Surface(height=-1),
        },
        contacts={
            "c": Contact(
                point=Point(body="p"), surface="platform", modes=("free", "slide"),
                friction=0, restitution=0,
            ),
            **{
                wheel: Contact(
                    point=Point(body="cart", at=(x, -1)), surface="rail",
                    modes=("slide",), friction=0,
                )
                for wheel, x in (("back", -1), ("front", 1))
            },
        },
    )  # fmt: skip
    trace = _run(scene, until=2.0)
    assert _story(trace) == [("disable", pytest.approx(1.0, abs=1e-10))]
    assert trace.final[4] == pytest.approx(0.5, abs=1e-9)


def test_conditions_are_invariant_under_reflection_and_units() -> None:
    scene = _scene(
        Surface(edge=((-1, 0), (1.5, 0.1))), {"y": 1, "dx": 0.4}, enabled=["c.gap < 2", "p.dx > 0"]
    )
    case = Subject(scene).case({})
    for changed, reading in (mirrored(scene), rescaled(scene)):
        image = Subject(changed).case({}).traces["taylor"]
        assert_same(case.traces["taylor"], image, case.sensitivity, reading=reading)


def test_off_is_a_state_of_the_region() -> None:
    built = automaton(_scene(Surface(height=0), {}, enabled="time < 1"))
    (region,) = built.regions
    assert region.states == ("free", "slide+", "slide-", "pin", "off")
    assert (built.modes_declared, built.modes_total) == (4, 5)
    edges = {(e.cause, e.source, e.target): e.guard for e in region.edges}
    assert edges["disable", "pin", "off"] == "not (time < 1)"
    assert edges["enable", "off", "free"] == "time < 1, gap >= 0"
    assert all(e.target != "off" for e in region.edges if e.cause != "disable")


def test_disabled_contacts_have_no_force_or_gap_margin() -> None:
    scene = _scene(Surface(height=0), {"y": 1}, enabled="time < -1")
    trace = _run(scene, until=3.0)
    assert trace.start_mode == trace.final_mode == ("off",)
    assert not trace.jumps
    assert trace.final[1] == pytest.approx(1 - 4.5)
    assert np.isfinite(trace.final).all()
    _hold(scene)


def test_conditions_round_trip() -> None:
    scene = _scene(Surface(edge=((0, 0), (1, 0))), {}, enabled=["time < 1", "p.x > 0"])
    assert validate(read_text(dump(scene)), Scene) == scene
    one = _scene(Surface(height=0), {}, enabled="time < 1")
    assert one.contacts["c"].enabled == ("time < 1",)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"enabled": "time"}, "comparison"),
        ({"enabled": "c.V > 0"}, "c.V"),
        ({"enabled": ["time > 0", "q > 0"]}, "'q'"),
        ({"enabled": "time > 0", "modes": (Slide(), Pin()), "restitution": None}, "list free"),
    ],
)
def test_undecidable_conditions_are_refused(fields: dict[str, Any], message: str) -> None:
    text = None
    with pytest.raises(Exception, match=message):
        text = _scene(Surface(height=0), {}, **fields)
    assert text is None


def test_a_start_inside_the_surface_suggests_mode_off() -> None:
    scene = _scene(Surface(height=0), {"y": -1}, enabled="time >= 0")
    with pytest.raises(DeclarationProblem) as caught:
        _run(scene)
    assert "or write modes: {c: off}" in caught.value.advice


def test_a_declared_mode_is_checked_against_the_conditions() -> None:
    scene = _scene(Surface(height=0), {"y": 1}, enabled="time < -1")
    with pytest.raises(DeclarationProblem, match=r"the condition c: time < -1 fails"):
        _run(scene.model_copy(update={"initial_modes": {"c": "free"}}))
    with pytest.raises(DeclarationError, match="does not list the mode 'off'"):
        validate(
            read_text(
                "kind: scene\nname: n\nbodies: {p: {mass: 1}}\nsurfaces: {s: {height: 0}}\n"
                "contacts: {c: {point: {body: p}, surface: s, friction: 0.1, restitution: 0}}\n"
                "modes: {c: off}\n"
            ),
            Scene,
        )


@pytest.mark.parametrize(
    ("name", "shape"),
    [*((name, "") for name in (*ENGINES, "impulse")), ("impulse", ", shape: {disc: 0.1}")],
)
def test_a_relation_reads_places_and_rates_of_bodies_that_formulas_place(
    name: str, shape: str
) -> None:
    """From 30 degrees on, where its tip rises above 1/2, a brake stops an arm from 2 in 2/3."""
    text = f"""
kind: scene
name: arm
coordinates: {{q: {{start: 0, rate: 2}}}}
bodies:
  arm: {{mass: 1, inertia: 1, position: [0, 0], angle: q{shape}}}
  tip: {{mass: 1e-9, position: [cos(q), sin(q)]}}
couplings: {{brake: {{bodies: [arm], limit: 3, enabled: tip.y >= 0.5 and tip.dx <= 1}}}}
{"collisions: {a: {bodies: [arm], friction: 0, restitution: 0}}" if shape else ""}
stop: {{time: 2}}
"""
    scene = validate(read_text(text), Scene)
    story = _story(run(scene, engine=name, step=1e-3 if name == "impulse" else None).trace)
    assert [cause for cause, _ in story] == ["close", "lock"]
    within = 2e-3 if name == "impulse" else 1e-8
    assert [t for _, t in story] == pytest.approx([math.pi / 12, math.pi / 12 + 2 / 3], abs=within)
    if name == "taylor":
        _hold(scene)
