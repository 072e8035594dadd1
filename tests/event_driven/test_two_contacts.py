"""Two contacts composed: the product automaton, and a ladder that leaves its wall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, engine

from contacts.kind import automaton
from contacts.scene.modes import Free, Slide
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.documents.yaml_reader import read_text
from statechart.engines.scipy import SciPy
from statechart.execution.simulator import Simulator
from statechart.loading.load import interpret
from statechart.running.runner import Runner


def ladder(lean: float, inertia: float, friction: object = 0) -> Scene:
    """Return a rod of half-length 1 between a wall (x = 0) and the floor."""
    s, c = math.sin(lean), math.cos(lean)
    modes = {"modes": (Free(), Slide())} if friction == 0 else {}
    return Scene(
        name="ladder",
        gravity=1,
        bodies={"rod": Body(mass=1, inertia=inertia, start={"x": s, "y": c, "angle": lean})},
        surfaces={"floor": Surface(height=0), "wall": Surface(line=((0, 1), (0, 0)))},
        contacts={
            "foot": Contact(
                point=Point(body="rod", at=(0, -1)), surface="floor",
                friction=friction, restitution=0, **modes,
            ),
            "top": Contact(
                point=Point(body="rod", at=(0, 1)), surface="wall",
                friction=friction, restitution=0, **modes,
            ),
        },
    )  # fmt: skip


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("lean", [0.1, 0.5])
def test_a_smooth_ladder_leaves_the_wall_at_two_thirds_of_its_height(
    name: str, lean: float
) -> None:
    simulator = Simulator(automaton(ladder(lean, 1 / 3)), engine(name))
    trace = simulator.run(until=8.0, throw=False)
    assert trace.modes[:2] == (("slide", "slide"), ("slide", "free"))
    left = trace.jumps[0]
    assert (left.region, left.cause) == ("top", "liftoff")
    assert left.before[1] == pytest.approx(2 / 3 * math.cos(lean), abs=1e-9)
    # Only the modes entered were built.
    assert simulator.modes.built == 2


@pytest.mark.parametrize("name", ENGINES)
def test_residual_velocity_of_a_landing_does_not_creep(name: str) -> None:
    start = {"x": -0.918869770144658, "y": 1.2636323659717263, "dx": -1.4215664404397923}
    scene = Scene(
        name="caught",
        gravity=1,
        bodies={"ball": Body(mass=1, start={**start, "dy": -0.05281726057613229})},
        surfaces={"hills": Surface(height="0.8708883291549392*sin(7.7804451726748445*x)")},
        contacts={
            "tip": Contact(
                point=Point(body="ball"),
                surface="hills",
                friction=0.7012716489717028,
                restitution=0,
            )
        },
    )
    trace = Simulator(automaton(scene), engine(name)).run(until=20)
    assert trace.final_mode == ("pin",)
    rest = trace.arcs[-1]
    moved = rest.states(np.linspace(0.0, rest.duration, 9))[:, :2] - trace.jumps[-1].after[:2]
    assert np.abs(moved).max() <= 0.1 * trace.tolerances["gap"]


@pytest.mark.parametrize("name", ENGINES)
def test_balls_that_fall_side_by_side_touching_have_no_force_and_no_event(name: str) -> None:
    scene = Scene(
        name="side_by_side",
        gravity=1,
        parameters={"mu": 3956.7827248447566},
        bodies={
            "low": Body(
                mass=1,
                start={"x": 0.22, "y": 0.89, "dx": 0.57, "dy": 1.96},
            ),
            "high": Body(mass=2.28, start={"x": 0.022, "y": 3.19}),
        },
        surfaces={"shell": Surface(circle=(0, 0), radius=1, body="low")},
        contacts={
            "between": Contact(
                point=Point(body="high"), surface="shell", friction="mu", restitution=0
            )
        },
    )
    trace = Simulator(automaton(scene), engine(name)).run(until=10.0)
    assert len(trace.jumps) == 1
    apart = trace.final[2:4] - trace.final[:2]
    assert np.hypot(*apart) == pytest.approx(1.0, abs=1e-11)


def test_low_bounces_of_one_end_are_summed_with_the_other_end_lying() -> None:
    scene = Scene(
        name="falling_bar",
        gravity=9.81,
        parameters={
            "mu": 0.11324235527288026,
            "e": 0.11534025937747788,
            "tilt": -0.09860218216959471,
        },
        bodies={
            "bar": Body(
                mass=1,
                inertia=0.39978433049282314,
                start={
                    "x": 0,
                    "y": "0.6753462694980112 + sin(abs(tilt))",
                    "angle": "tilt",
                    "dx": -0.6640370580840274,
                },
            )
        },
        surfaces={"floor": Surface(height=0)},
        contacts={
            name: Contact(
                point=Point(body="bar", at=(x, 0)), surface="floor", friction="mu", restitution="e"
            )
            for name, x in (("A", -1), ("B", 1))
        },
    )
    loose, tight = (
        Simulator(automaton(scene), SciPy(tolerance)).run(until=1.0) for tolerance in (1e-9, 1e-13)
    )
    ends = [[j.t for j in trace.jumps if j.cause == "zeno"] for trace in (loose, tight)]
    skipped = [max(j.skipped for j in trace.jumps) for trace in (loose, tight)]
    # The looser run sums more, and to the same end.
    assert skipped[0] > 10.0 * skipped[1] > 0.0
    assert ends[0] == pytest.approx(ends[1], rel=1e-9)


RATTLING = """
kind: scene
name: rattling_bar
parameters: {tilt: 0.340824159917981, drop: 0.7006029395944852, I_G: 0.29955787110970944}
gravity: 9.81
bodies:
  bar:
    mass: 1
    inertia: I_G
    start: {y: drop + sin(tilt), angle: tilt, dx: -0.7612088297573569}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-1, 0]}, surface: floor, friction: 0.0504, restitution: 0.48915}
  B: {point: {body: bar, at: [1, 0]}, surface: floor, friction: 0.0504, restitution: 0.48915}
stop: {time: 2}
"""


def test_the_first_summed_impact_does_not_change_the_result() -> None:
    # Both ends slide while they rattle: friction takes its part of every impulse summed.
    scene = interpret(read_text(RATTLING))
    found = []
    for name, tolerance in (("taylor", None), ("scipy", 1e-10), ("scipy", 1e-12)):
        trace = Runner(scene, engine=name, tolerance=tolerance).run().trace
        sums = [jump.skipped for jump in trace.jumps if jump.skipped > 0.0]
        stick = trace.jumps[-1]
        assert (stick.cause, trace.final_mode) == ("stick", ("pin", "pin"))
        found.append((sums, stick.t, trace.final[0]))
        # While both slide one way, friction is mu times whatever the ground bears in all.
        for jump in trace.jumps[-16:-1]:
            gained = stick.before - jump.after
            borne = 9.81 * (stick.t - jump.t) + gained[4]
            assert gained[3] == pytest.approx(0.0504 * borne, abs=1e-14)
    assert len({f"{sums[-1]:.3g}" for sums, *_ in found}) > 1
    for _, t, x in found[1:]:
        assert (t, x) == pytest.approx(found[0][1:], rel=1e-12)


SQUEEZED = """
kind: scene
name: squeezed_ball
gravity: 1
bodies:
  low: {mass: 1, start: {y: 0.6}}
  high: {mass: 36821, start: {x: 0.1, y: 2}}
surfaces: {floor: {height: 0}, shell: {circle: [0, 0], radius: 1, body: low}}
contacts:
  ground: {point: {body: low, at: [0, -0.5]}, surface: floor, friction: 0.6, restitution: 0.85}
  between: {point: {body: high}, surface: shell, friction: 0.6, restitution: 0.85}
stop: {time: 2}
"""


def test_a_falling_body_closes_its_gap_without_projection() -> None:
    # The heavy body would push the light one aside if gaps were closed before it has come down.
    found = [
        Runner(interpret(read_text(SQUEEZED)), engine="scipy", tolerance=tolerance).run()
        for tolerance in (1e-9, 1e-11)
    ]
    ends = [result.trace.final[0] for result in found]
    assert ends[0] == pytest.approx(ends[1], abs=30 * found[0].trace.tolerances["gap"])


def test_a_truncated_sum_of_impacts_warns() -> None:
    text = SQUEEZED.replace("restitution: 0.85", "restitution: 0.98").replace("36821", "613333")
    trace = Runner(interpret(read_text(text))).run().trace
    assert any("the sequence of impacts does not end" in warning for warning in trace.warnings)


SHAKEN = """\
kind: scene
name: shaken
parameters: {a: 0.0275, w: 47, mu: 0}
gravity: 9.81
bodies: {box: {mass: 1, inertia: 0.05, start: {y: 0.1, dy: a*w}}}
surfaces: {table: {height: 0, displacement: [0, a*sin(w*time)]}}
contacts:
  left: {point: {body: box, at: [-0.2, -0.1]}, surface: table, friction: mu, restitution: 0}
  right: {point: {body: box, at: [0.2, -0.1]}, surface: table, friction: mu, restitution: 0}
stop: {time: 0.1}
"""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_a_box_leaves_a_shaken_table_whatever_the_friction(engine: str, mu: float) -> None:
    """Without friction a cone has no width, and is nevertheless left where forces pull."""
    for a in (0.0275, 0.02, 0.0125, 0.01):
        trace = Runner(read_text(SHAKEN), engine=engine).run({"a": a, "mu": mu}).trace
        first = trace.jumps[0]
        assert (first.cause, first.target) == ("liftoff", ("free", "free"))
        assert first.t == pytest.approx(math.asin(9.81 / (a * 47**2)) / 47, abs=1e-9)


def test_a_tip_that_the_closing_of_the_other_moves_into_the_floor_may_leave() -> None:
    """A rod comes to rest on both tips; B closes while A flies from just above -tolerance."""
    text = """
kind: scene
name: rod
gravity: 1
bodies:
  rod:
    mass: 1
    inertia: 2.515723190519573
    start:
      {x: 3.7671466618583125, y: 3.0223765752298145e-11, angle: -1.5707963268251184,
       dx: -1.4910141555842003e-16, dy: -3.566762450876755e-06, dangle: 4.933577553410055e-06}
surfaces: {floor: {height: 0}}
contacts:
  A:
    {point: {body: rod, at: [0, -1]}, surface: floor, friction: 0.284449634620876,
     restitution: 0.6713075742194778}
  B:
    {point: {body: rod, at: [0, 1]}, surface: floor, friction: 0.284449634620876,
     restitution: 0.6713075742194778}
stop: {time: 0.01}
"""
    trace = Runner(read_text(text), tolerance=1e-13).run().trace
    assert trace.final_mode == ("pin", "pin")
    assert trace.final == pytest.approx([3.7671466618583125, 0, -math.pi / 2, 0, 0, 0], abs=1e-12)


@pytest.mark.parametrize(
    ("cause", "values"),
    [
        ("liftoff", {
            "mu": 0.0, "e": 0.0, "x0": 0.6959046999341651, "a0": -0.0880636685057099,
            "u0": -0.13357754855575088, "r0": -0.09606371155613802, "b": 0.23565719246837763,
            "m": 0.13973833834637867,
        }),
        ("slip", {
            "mu": 0.7477005248046553, "e": 0.5172556896799085, "x0": 0.4943928015609569,
            "a0": 1.290667391803559, "u0": 1.0, "r0": -2.0, "b": 0.37232311147540686, "m": 0.1,
        }),
    ],
)  # fmt: skip
def test_a_block_at_rest_does_not_slip_where_a_stick_beside_it_changes_its_mode(
    cause: str, values: dict[str, float]
) -> None:
    """Nothing pushes the block, and its two feet share its weight."""
    text = """
kind: scene
name: stick_beside_a_block
gravity: g
parameters: {g: 1, mu: 0.5, e: 0.2, x0: 0.6, y0: 2.5, a0: 0.7, u0: 0, w0: 0, r0: 0, b: 0.5, m: 2}
bodies:
  block: {mass: m, inertia: 2/3*m*b**2, start: {y: b}}
  stick: {mass: 1, inertia: 1/3, start: {x: x0, y: y0, angle: a0, dx: u0, dy: w0, dangle: r0}}
surfaces:
  floor: {height: 0}
  top: {edge: [[-b, b], [b, b]], body: block}
contacts:
  left: {point: {body: block, at: [-b, -b]}, surface: floor, friction: mu, restitution: 0}
  right: {point: {body: block, at: [b, -b]}, surface: floor, friction: mu, restitution: 0}
  A: {point: {body: stick, at: [-1, 0]}, surface: top, friction: mu, restitution: e}
  B: {point: {body: stick, at: [1, 0]}, surface: top, friction: mu, restitution: e}
  C: {point: {body: stick, at: [1, 0]}, surface: floor, friction: mu, restitution: e}
stop: {time: 4}
"""
    for name in ("taylor", "scipy"):
        last = Runner(read_text(text), engine=name).run(values).trace.jumps[-1]
        assert (last.region, last.cause, last.target[:2]) == ("C", cause, ("pin", "pin"))
