"""Joints: pivots, linkages, loops, driven points, and their impacts."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from runs import ENGINES, engine

from contacts.dynamics.mechanics import Mechanics
from contacts.kind import automaton
from contacts.scene.joints import Joint, Path
from contacts.scene.parts import Body, Contact, Coordinate, Point, Surface
from contacts.scene.scene import Scene
from contacts.testing.scene_properties import assert_energy
from contacts.testing.symmetry import mirrored, rescaled
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.validation import validate
from statechart.documents.yaml_reader import read_text
from statechart.documents.yaml_writer import dump
from statechart.engines.taylor import Taylor
from statechart.errors import DeclarationError, DeclarationProblem, NoConsistentMode
from statechart.execution.simulator import Simulator
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs
from statechart.running.runner import Runner
from statechart.testing.agreement import assert_same
from statechart.testing.subject import Subject

# A crank of length 1, a coupler of length 2, ends on the x axis: angles at the start.
_CRANK = 0.6
_COUPLER = -math.asin(math.sin(_CRANK) / 2)


def _body(x: float, y: float, angle: float = 0.0, **rates: float) -> Body:
    return Body(mass=2, inertia=0.3, start={"x": x, "y": y, "angle": angle, **rates})


def _run(scene: Scene, name: str = "taylor", until: float = 3.0, **parameters: float) -> Trace:
    chosen = Taylor(1e-15) if name == "taylor" else engine(name)
    return Simulator(automaton(scene), chosen).run(parameters, until=until)


def _distance(scene: Scene, trace: Trace) -> float:
    """Return how far the joints were open at most, at the ends of all steps."""
    mechanics = Mechanics(scene)
    gaps = [row.gap for row in mechanics.joint_rows]
    subject = Subject(scene)
    worst = 0.0
    for arc in trace.arcs:
        times = arc.start.high + (arc.start.low + arc.times[:-1])
        apart = subject.values(trace, gaps, arc.coefficients[:, :, 0], times)
        worst = max(worst, float(np.abs(apart).max()))
    return worst


def _pendulum(lean: float, **more: Any) -> Scene:
    start = _body(math.sin(lean), -math.cos(lean), lean)
    pivot = Joint(point=Point(body="rod", at=(0, 1)), to=(0, 0))
    return Scene(name="p", gravity=9.81, bodies={"rod": start}, joints={"pivot": pivot}, **more)


def _double(start: tuple[float, float]) -> tuple[Scene, Scene]:
    """Return a double pendulum of bars of length 2: by joints, and in generalised coordinates."""
    a, b = start
    x, y = 2 * math.sin(a), -2 * math.cos(a)
    jointed = Scene(
        name="double",
        gravity=9.81,
        bodies={
            "upper": _body(x / 2, y / 2, a),
            "lower": _body(x + math.sin(b), y - math.cos(b), b),
        },
        joints={
            "shoulder": Joint(point=Point(body="upper", at=(0, 1)), to=(0, 0)),
            "elbow": Joint(
                point=Point(body="lower", at=(0, 1)), to=Point(body="upper", at=(0, -1))
            ),
        },
    )
    reduced = Scene(
        name="double",
        gravity=9.81,
        coordinates={"a": Coordinate(start=a), "b": Coordinate(start=b)},
        bodies={
            "upper": Body(mass=2, inertia=0.3, position=("sin(a)", "-cos(a)"), angle="a"),
            "lower": Body(
                mass=2, inertia=0.3,
                position=("2*sin(a) + sin(b)", "-2*cos(a) - cos(b)"), angle="b",
            ),
        },
    )  # fmt: skip
    return jointed, reduced


@pytest.mark.parametrize("name", ENGINES)
def test_joint_pendulum_equals_angle_pendulum(name: str) -> None:
    lean = 0.7
    reduced = Scene(
        name="p",
        gravity=9.81,
        coordinates={"th": Coordinate(start=lean)},
        bodies={"rod": Body(mass=2, inertia=0.3, position=("sin(th)", "-cos(th)"), angle="th")},
    )
    jointed = _run(_pendulum(lean), name, 5.0)
    expected = _run(reduced, name, 5.0).final
    assert jointed.final[[2, 5]] == pytest.approx(expected, abs=1e-11)
    assert _distance(_pendulum(lean), jointed) < (1e-14 if name == "taylor" else 1e-11)


def test_the_force_in_a_pivot_is_weight_and_centripetal_force() -> None:
    scene = _pendulum(
        0.7,
        outputs={
            "X": {"value": "pivot.X", "at": "end"},
            "Y": {"value": "pivot.Y", "at": "end"},
            "angle": {"value": "rod.angle", "at": "end"},
            "rate": {"value": "rod.dangle", "at": "end"},
        },
    )
    simulator = Simulator(automaton(scene), Taylor(1e-15))
    found = Outputs(Observer(simulator)).of(simulator.run(until=1.3))
    th, w, m, inertia = found["angle"], found["rate"], 2.0, 0.3
    turning = -m * 9.81 * math.sin(th) / (m + inertia)
    along = m * w**2 + m * 9.81 * math.cos(th)
    across = m * turning + m * 9.81 * math.sin(th)
    assert found["X"] == pytest.approx(across * math.cos(th) - along * math.sin(th), abs=1e-12)
    assert found["Y"] == pytest.approx(across * math.sin(th) + along * math.cos(th), abs=1e-12)


@pytest.mark.parametrize("name", ENGINES)
def test_joint_double_pendulum_equals_angle_coordinates(name: str) -> None:
    jointed, reduced = _double((1.0, 0.4))
    found = _run(jointed, name, 2.0).final
    expected = _run(reduced, name, 2.0).final
    assert found[[2, 5, 8, 11]] == pytest.approx(expected, abs=1e-9)


def _four_bar(**more: Any) -> Scene:
    """Return a crank, a coupler and a rocker between pivots at x = 0 and 3."""
    crank, ground, long, rocker = 1.0, 3.0, 2.5, 2.0
    a = 1.0
    x, y = crank * math.cos(a), crank * math.sin(a)
    reach = math.hypot(ground - x, y)
    inner = math.acos((long**2 + reach**2 - rocker**2) / (2 * long * reach))
    b = math.atan2(-y, ground - x) + inner
    u, v = x + long * math.cos(b), y + long * math.sin(b)
    c = math.atan2(v, u - ground)
    return Scene(
        name="four_bar",
        gravity=9.81,
        bodies={
            "crank": _body(x / 2, y / 2, a),
            "coupler": _body((x + u) / 2, (y + v) / 2, b),
            "rocker": _body((u + ground) / 2, v / 2, c),
        },
        joints={
            "A": Joint(point=Point(body="crank", at=(-crank / 2, 0)), to=(0, 0)),
            "B": Joint(
                point=Point(body="coupler", at=(-long / 2, 0)),
                to=Point(body="crank", at=(crank / 2, 0)),
            ),
            "C": Joint(
                point=Point(body="rocker", at=(rocker / 2, 0)),
                to=Point(body="coupler", at=(long / 2, 0)),
            ),
            "D": Joint(point=Point(body="rocker", at=(-rocker / 2, 0)), to=(ground, 0)),
        },
        **more,
    )


def test_a_closed_loop_keeps_its_energy_and_its_joints() -> None:
    scene = _four_bar()
    # Joints drift by round-off, 1.3e-14 to 2.1e-14 in 5 s with compiled equations of more or fewer
    # optimisations, until they are projected back: at 5e-14, also after 20 s.
    assert _distance(scene, _run(scene, until=20.0)) < 6e-14
    trace = _run(scene, until=5.0)
    assert_energy(*_energy_arguments(scene), trace)
    agreed = _run(scene, "scipy", 5.0)
    assert trace.final == pytest.approx(agreed.final, abs=1e-8)


def _energy_arguments(scene: Scene) -> tuple[Mechanics, Subject]:
    return Mechanics(scene), Subject(scene)


def test_a_slider_crank_moves_as_its_closed_form() -> None:
    # The crank is driven at its pin, so nothing is left free: the slider's place is geometry.
    pin = (math.cos(_CRANK), math.sin(_CRANK))
    end = pin[0] + 2 * math.cos(_COUPLER)
    slope = -math.cos(_CRANK) / (2 * math.cos(_COUPLER))
    turn = (-math.sin(_COUPLER), math.cos(_COUPLER))
    rate = (-math.sin(_CRANK), math.cos(_CRANK))
    scene = Scene(
        name="slider",
        bodies={
            "coupler": _body(
                pin[0] + math.cos(_COUPLER), pin[1] + math.sin(_COUPLER), _COUPLER,
                dx=rate[0] + slope * turn[0], dy=rate[1] + slope * turn[1], dangle=slope,
            ),
        },
        joints={
            "pin": Joint(
                point=Point(body="coupler", at=(-1, 0)),
                to=(f"cos({_CRANK!r} + time)", f"sin({_CRANK!r} + time)"),
            ),
            "guide": Joint(point=Point(body="coupler", at=(1, 0)), to=Path(y=0)),
        },
    )  # fmt: skip
    assert end == pytest.approx(scene.values().get("end", end))
    trace = _run(scene, until=20.0)
    angle = -math.asin(math.sin(_CRANK + 20.0) / 2)
    assert trace.final[2] == pytest.approx(angle, abs=1e-12)
    assert trace.final[0] == pytest.approx(math.cos(_CRANK + 20.0) + math.cos(angle), abs=1e-12)


def test_work_of_a_driven_pivot_equals_the_gain_of_energy() -> None:
    # Kapitza's pendulum stands upright where its pivot is shaken fast enough.
    scene = Scene(
        name="kapitza",
        gravity=1,
        parameters={"w": 40, "A": 0.1},
        bodies={
            "rod": Body(
                mass=1, inertia=0,
                start={"x": "sin(0.2)", "y": "cos(0.2)", "angle": "-0.2", "dy": "A*w"},
            ),
        },
        joints={"pivot": Joint(point=Point(body="rod", at=(0, -1)), to=(0, "A*sin(w*time)"))},
    )  # fmt: skip
    trace = _run(scene, until=8.0)
    assert_energy(*_energy_arguments(scene), trace)
    leans = [float(np.abs(arc.coefficients[:, 2, 0]).max()) for arc in trace.arcs]
    assert max(leans) < 0.5
    free = _run(scene, until=8.0, A=0.0)
    assert max(float(np.abs(arc.coefficients[:, 2, 0]).max()) for arc in free.arcs) > 2.0


def test_a_redundant_joint_changes_only_the_sharing_of_forces() -> None:
    once, twice = _pendulum(0.7), _pendulum(0.7)
    pivot = once.joints["pivot"]
    twice = once.model_copy(update={"joints": {"pivot": pivot, "again": pivot}})
    trace = _run(twice)
    assert trace.final == pytest.approx(_run(once).final, abs=1e-12)
    assert any("'again'" in warning for warning in trace.warnings)
    assert trace.parameters["again.redundant_x"] == trace.parameters["again.redundant_y"] == 1.0


def test_redundant_joints_are_found_in_each_of_several_mechanisms() -> None:
    # Rods b on pivots of their own; the first and the last are held twice.
    bodies = {f"b{i}": Body(mass=1, inertia=1, start={"x": 3 * i + 1}) for i in range(3)}
    pivots = {
        f"{name}{i}": Joint(point=Point(body=f"b{i}", at=(-1, 0)), to=(3 * i, 0))
        for name, which in (("pivot", (0, 1, 2)), ("again", (0, 2)))
        for i in which
    }
    trace = _run(Scene(name="rods", gravity=1, bodies=bodies, joints=pivots))
    redundant = {
        name for name, value in trace.parameters.items() if ".redundant_" in name and value
    }
    assert redundant == {f"again{i}.redundant_{c}" for i in (0, 2) for c in "xy"}


@pytest.mark.parametrize("name", ENGINES)
def test_a_jointed_body_lands_as_the_same_body_in_its_angles(name: str) -> None:
    # Two links from a pivot fall on the ground: a frictional impact, then sliding.
    a, b = 1.2, 0.5
    contact = {
        "tip": Contact(
            point=Point(body="lower", at=(0, -1)), surface="ground", friction=0.3, restitution=0.4
        )
    }
    ground = {"ground": Surface(height=-2.9)}
    scenes = [
        scene.model_copy(update={"contacts": contact, "surfaces": ground})
        for scene in _double((a, b))
    ]
    jointed, reduced = (_run(scene, name, 1.5) for scene in scenes)
    assert [j.cause for j in jointed.jumps] == [j.cause for j in reduced.jumps]
    assert len(jointed.jumps) > 1
    for one, other in zip(jointed.jumps, reduced.jumps, strict=True):
        assert one.t == pytest.approx(other.t, abs=1e-9)
        for k in one.impulse:
            assert one.impulse[k] == pytest.approx(other.impulse[k], rel=1e-7, abs=1e-9)
        # Jointed bodies move together after an impact as well.
        th, u, v, w = one.after[[2, 6, 7, 8]]
        assert (u, v) == pytest.approx((w * math.cos(th), w * math.sin(th)), abs=1e-10)
    assert jointed.final[[2, 5, 8, 11]] == pytest.approx(reduced.final, abs=1e-7)
    assert_energy(*_energy_arguments(scenes[0]), jointed)


@pytest.mark.parametrize("name", ENGINES)
def test_linkages_are_invariant_under_reflection_and_units(name: str) -> None:
    scene = _four_bar(stop={"time": 2})
    subject = Subject(scene)
    case = subject.case({})
    for changed, reading in (mirrored(scene), rescaled(scene)):
        image = Subject(changed).case({}).traces[name]
        assert_same(case.traces[name], image, case.sensitivity, reading=reading)


LED = """\
kind: scene
name: led
gravity: 1
bodies:
  rod: {mass: 1, inertia: 1/3, start: {x: -sin(1.2), y: 2 - cos(1.2), angle: -1.2, dx: 2.4}}
surfaces: {floor: {height: 1.9 - 2*cos(1.2)}}
joints: {hand: {point: {body: rod, at: [0, 1]}, to: [0.4*sin(6*time), 2]}}
contacts: {tip: {point: {body: rod, at: [0, -1]}, surface: floor, friction: 0.6, restitution: 0.9}}
stop: {time: 3}
"""


def test_work_of_a_prescribed_joint_in_an_impact_is_counted() -> None:
    scene = validate(read_text(LED), Scene)
    trace = _run(scene)
    # The hand follows its path under any load: the rod gains its work.
    first = next(j for j in trace.jumps if j.energy is not None and j.energy[1] > j.energy[0] + 0.1)
    assert_energy(*_energy_arguments(scene), trace)
    lost = replace(first, after=first.after + 1e-3 * np.array([0, 0, 0, 1, 0, 1]))
    jumps = tuple(lost if jump is first else jump for jump in trace.jumps)
    with pytest.raises(AssertionError, match="energy grows"):
        assert_energy(*_energy_arguments(scene), replace(trace, jumps=jumps))


def test_a_point_that_a_joint_leads_into_the_ground_where_friction_wedges_it_is_reported() -> None:
    # Slip stops under the hand, which goes on down: no impulse of the ground stops that.
    text = LED.replace("to: [0.4*sin(6*time), 2]", "to: [0, 2 - time]").replace("dx: 2.4", "dy: -1")
    scene = validate(read_text(text.replace("friction: 0.6", "friction: 5")), Scene)
    with pytest.raises(NoConsistentMode, match="driven into its surface"):
        _run(scene)


_DOCUMENT = """\
kind: scene
name: held
gravity: 9.81
parameters: {v: 0.5}
bodies:
  rod: {mass: 1, inertia: 1/3, start: {dx: v}}
  other: {mass: 1, inertia: 1/3, start: {x: 1}}
joints:
  hip: {point: {body: rod, at: [0, 1]}, to: {body: other, at: [-1, 1]}}
"""


def _read(text: str) -> Scene:
    return validate(read_text(text), Scene)


def test_joint_round_trips() -> None:
    scene = Scene(
        name="held",
        bodies={"rod": _body(0, 0), "other": _body(1, 0)},
        joints={
            "hip": Joint(point=Point(body="rod"), to=Point(body="other", at=(-1, 0))),
            "crank": Joint(point=Point(body="rod"), to=("v*time", 0)),
            "guide": Joint(point=Point(body="other"), to=Path(y=0)),
        },
        parameters={"v": 1},
    )
    assert _read(dump(scene)) == scene


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ("{point: {body: rod}, to: {body: rod}}", "holds two bodies together"),
        ("{point: {body: rod}, to: {body: rood}}", "no body 'rood'"),
        ("{point: {body: rod}, to: {}}", "an x, a y, or both"),
        ("{point: {body: rod}, to: [1]}", "two components, not 1"),
        ("{point: {body: rod}, to: [w*time, 0]}", "'w'"),
        ("{point: {body: rod}, to: {x: rod.y}}", "'rod.y'"),
        ("{point: {body: rod}, to: {body: other, x: 1}}", "unknown key 'x'"),
        ("{point: {body: rod}}", "'to' is missing"),
    ],
)
def test_an_empty_joint_is_refused_with_its_place(joint: str, message: str) -> None:
    lines = [*_DOCUMENT.splitlines()[:-1], f"  hip: {joint}"]
    with pytest.raises(DeclarationError, match=message) as caught:
        _read("\n".join(lines))
    assert caught.value.line == len(lines)


def test_joint_names_are_unique() -> None:
    with pytest.raises(DeclarationError, match="'rod' is a body already"):
        _read(_DOCUMENT.replace("hip", "rod"))


def _refused(text: str) -> DeclarationProblem:
    with pytest.raises(DeclarationProblem) as caught:
        Simulator(automaton(_read(text)), Taylor(1e-12)).run(until=1.0)
    return caught.value


def test_a_joint_open_at_the_start_is_named_with_the_position_that_closes_it() -> None:
    problem = _refused(_DOCUMENT.replace("[-1, 1]", "[-1, 1.25]"))
    assert problem.loc == ("joints", "hip")
    assert "'hip' is open at the start: its points of 'rod' and 'other' are 0.25 apart" in str(
        problem
    )
    assert "a position that closes all: " in problem.advice
    assert "rod.y = " in problem.advice


def test_advice_on_an_open_joint_closes_it() -> None:
    # Copied from a report of seven digits.
    start = {"x": 0.4207355, "y": -0.2701512, "angle": 1.0, "dx": 0.1350756, "dy": 0.2103677}
    start["dangle"] = 0.5
    for _ in range(2):
        listed = ", ".join(f"{key}: {value!r}" for key, value in start.items())
        text = f"""
kind: scene
name: copied
bodies: {{rod: {{mass: 1, inertia: 1/12, start: {{{listed}}}}}}}
joints: {{hook: {{point: {{body: rod, at: [0, 0.5]}}, to: [0, 0]}}}}
"""
        for key, value in re.findall(r"rod\.(\w+) = ([-.e\d]+)", _refused(text).advice):
            start[key] = float(value)
    listed = ", ".join(f"{key}: {value!r}" for key, value in start.items())
    closed = automaton(_read(re.sub(r"start: \{.*?\}", f"start: {{{listed}}}", text)))
    Simulator(closed, Taylor(1e-12)).run(until=0.1)


def test_a_loop_that_cannot_close_is_refused() -> None:
    third = "  far: {point: {body: other, at: [1, 0]}, to: [9, 0]}\n"
    near = "  near: {point: {body: rod, at: [0, 0]}, to: [0, 0]}\n"
    problem = _refused(_DOCUMENT + third + near)
    assert "no position near the start closes all joints" in problem.advice


def test_rates_that_separate_a_joint_are_reported_with_rates_that_agree() -> None:
    problem = _refused(_DOCUMENT)
    assert "moving apart at 0.5" in str(problem)
    assert "velocities that it allows: " in problem.advice


@pytest.mark.parametrize(
    ("paths", "what"),
    [
        (("[time, 0]", "[0, 0]"), "velocity"),
        (("[time**2, 0]", "[0, 0]"), "acceleration"),
    ],
)
def test_contradicting_joints_are_named(paths: tuple[str, str], what: str) -> None:
    text = _DOCUMENT.replace("dx: v", "dx: 0")
    for name, path in zip(("one", "two"), paths, strict=True):
        text += f"  {name}: {{point: {{body: rod}}, to: {path}}}\n"
    problem = _refused(text)
    assert f"'one', 'two' contradict one another: no {what}" in str(problem)


def test_joints_that_become_contradictory_end_the_run() -> None:
    text = _DOCUMENT.replace("dx: v", "dx: 0")
    for name, path in (("one", "[time**4, 0]"), ("two", "[0, 0]")):
        text += f"  {name}: {{point: {{body: rod}}, to: {path}}}\n"
    simulator = Simulator(automaton(_read(text)), Taylor(1e-12))
    trace = simulator.run(until=1.0, throw=False)
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    assert "cannot all hold" in trace.message
    with pytest.raises(NoConsistentMode):
        simulator.run(until=1.0)


@pytest.mark.parametrize("name", ENGINES)
def test_a_redundant_parallel_crank_conserves_energy(name: str) -> None:
    # A plate hangs on three parallel cranks: one loop more than its motion needs. It swings clear
    # of where all joints lie on one line, and the cranks could turn either way.
    def crank(x: float) -> Body:
        return _body(x + math.sin(a) / 2, math.cos(a) / 2, -a)

    a = 2.5
    places = {"one": -1.0, "two": 0.0, "three": 2.0}
    scene = Scene(
        name="plate",
        gravity=9.81,
        bodies={
            "plate": _body(math.sin(a), math.cos(a)),
            **{name: crank(x) for name, x in places.items()},
        },
        joints={
            **{
                f"foot_{name}": Joint(point=Point(body=name, at=(0, -0.5)), to=(x, 0))
                for name, x in places.items()
            },
            **{
                f"top_{name}": Joint(
                    point=Point(body="plate", at=(x, 0)), to=Point(body=name, at=(0, 0.5))
                )
                for name, x in places.items()
            },
        },
    )
    trace = _run(scene, name, 2.0)
    assert sum(v for k, v in trace.parameters.items() if ".redundant_" in k) == 1.0
    assert trace.final[2] == pytest.approx(0.0, abs=1e-9)
    # One angle th: (m (1 + 3/4) + 3 I) th'' = m g (1 + 3/2) sin th, by energy.
    th, w = -trace.final[5], -trace.final[14 + 3]
    inertia = 2 * (1 + 3 / 4) + 3 * 0.3
    fallen = 2 * 9.81 * 2.5 * (math.cos(a) - math.cos(th))
    assert 0.5 * inertia * w**2 == pytest.approx(fallen, abs=1e-8)


@pytest.mark.parametrize("name", ENGINES)
def test_dead_point_of_the_rods_that_imply_another_ends_the_run(name: str) -> None:
    # Two of three parallel rods become dependent where they lie in line with their ends.
    start = {"x": 0.0, "y": -1.0, "dx": 8.0}
    places = {"a": (-0.5, 0.0), "b": (0.5, 0.0), "c": (0.1, 0.4)}
    scene = Scene(
        name="plate",
        gravity=9.81,
        bodies={"plate": Body(mass=2, inertia=0.3, start=start)},
        joints={
            rod: Joint(point=Point(body="plate", at=place), to=place, rod=1.0)
            for rod, place in places.items()
        },
    )
    with pytest.raises(NoConsistentMode, match=r"'c' parts at .* dead point"):
        _run(scene, name, 1.0)


@pytest.mark.parametrize(("name", "steps"), [("taylor", 4000), ("scipy", 4000)])
def test_a_pinned_rod_stays_on_its_pivot(name: str, steps: int) -> None:
    lean = 2.5
    scene = _pendulum(lean)
    trace = _run(scene, name, 2500.0 if name == "taylor" else 160.0)
    assert trace.counts["steps"] > steps
    assert _distance(scene, trace) < (1e-13 if name == "taylor" else 1e-11)


def test_an_angle_of_many_turns_is_rounding_and_no_broken_joint() -> None:
    start = _body(0, 1, 0, dx=-8, dangle=8)
    pivot = Joint(point=Point(body="rod", at=(0, -1)), to=(0, 0))
    scene = Scene(name="p", gravity=9.81, bodies={"rod": start}, joints={"pivot": pivot})
    trace = _run(scene, until=300.0)
    assert trace.final[2] > 2000.0
    assert _distance(scene, trace) < 64 * 2.2e-16 * 2500.0


@pytest.mark.parametrize("name", ENGINES)
def test_a_hinged_table_on_more_feet_than_needed_lands_flat_and_rests(name: str) -> None:
    # Four feet for three motions of the two boards: the sums of forces are determined.
    feet = {
        f"{board}_{side}": Contact(
            point=Point(body=board, at=(x, -0.1)), surface="floor", friction=0.5, restitution=0.5
        )
        for board in ("left", "right")
        for side, x in (("outer", -0.8), ("inner", 0.8))
    }
    hinge = Joint(point=Point(body="left", at=(1, 0)), to=Point(body="right", at=(-1, 0)))
    scene = Scene(
        name="table",
        gravity=9.81,
        bodies={"left": _body(-1, 0.4), "right": _body(1, 0.4)},
        surfaces={"floor": Surface(height=0)},
        contacts=feet,
        joints={"hinge": hinge},
        outputs={
            "weight": {"value": " + ".join(f"{foot}.V" for foot in feet), "at": "end"},
            "left": {"value": "left_outer.V + left_inner.V + hinge.Y", "at": "end"},
            "hinge": {"value": "hinge.X", "at": "end"},
        },
    )
    simulator = Simulator(automaton(scene), engine(name))
    trace = simulator.run(until=3.0)
    assert trace.final_mode == ("pin",) * 4
    assert trace.final == pytest.approx([-1, 0.1, 0, 1, 0.1, 0] + [0] * 6, abs=1e-10)
    found = Outputs(Observer(simulator)).of(trace)
    assert found["weight"] == pytest.approx(2 * 2 * 9.81, abs=1e-9)
    assert found["left"] == pytest.approx(2 * 9.81, abs=1e-9)
    assert found["hinge"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("start", "mode", "why"),
    [
        ("{y: 1}", "slide", "slip would accelerate"),
        ("{y: 1, dx: 1}", "pin", "its point slips at 1"),
        ("{y: 2}", "pin", "its gap is open or opening"),
    ],
)
def test_a_declared_mode_inconsistent_with_the_start_is_refused_with_a_reason(
    start: str, mode: str, why: str
) -> None:
    text = f"""\
kind: scene
name: block
gravity: 9.81
bodies: {{b: {{mass: 1, inertia: 1, start: {start}}}}}
surfaces: {{ground: {{height: 0}}}}
contacts:
  foot: {{point: {{body: b, at: [0, -1]}}, surface: ground, friction: 0.5, restitution: 0}}
modes: {{foot: {mode}}}
stop: {{time: 1}}
"""
    with pytest.raises(DeclarationError, match=f"cannot start in mode {mode!r}: .*{why}") as caught:
        Runner(read_text(text, "a.yaml")).run()
    assert (caught.value.source, caught.value.line) == ("a.yaml", 8)


@pytest.mark.parametrize("name", [*ENGINES, "impulse"])
@pytest.mark.parametrize("mass", [1.0, 0.2])
def test_two_particles_on_a_rod_land_side_by_side(name: str, mass: float) -> None:
    """Two particles on a rod fall flat: in the end the rod's row holds round-off across the rod.

    Without friction the centre of mass keeps its x, and the upper particle falls freely at the end:
    its speed is sqrt(2 g h).
    """
    text = f"""\
kind: scene
name: fall
gravity: 9.81
bodies: {{a: {{mass: {mass}}}, b: {{mass: 1, start: {{x: 0.6, y: 0.8}}}}}}
surfaces: {{floor: {{height: 0}}}}
joints: {{bar: {{point: {{body: a}}, to: {{body: b}}, rod: 1}}}}
contacts:
  left: {{point: {{body: a}}, surface: floor, friction: 0, restitution: 0, impact: moreau}}
  right: {{point: {{body: b}}, surface: floor, friction: 0, restitution: 0, impact: moreau}}
stop: {{time: 1}}
outputs:
  v: {{value: b.dy, at: first right.touchdown, before: true}}
  left: {{value: a.x}}
  right: {{value: b.x}}
  slides: {{value: abs(a.dx) + abs(b.dx)}}
"""
    setting = {"step": 1e-4} if name == "impulse" else {}
    result = Runner(read_text(text), engine=name, **setting).run()
    within = 1e-3 if name == "impulse" else 1e-9
    centre = 0.6 / (1 + mass)
    assert result.outputs["v"] == pytest.approx(-math.sqrt(1.6 * 9.81), rel=within)
    assert result.outputs["left"] == pytest.approx(centre - 1 / (1 + mass), abs=within)
    assert result.outputs["right"] == pytest.approx(centre + mass / (1 + mass), abs=within)
    assert result.outputs["slides"] < within
    assert [jump.cause for jump in result.trace.jumps] == ["touchdown"]
