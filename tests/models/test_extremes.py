"""Scenes at the edges of their parameters, against closed forms; see also the tests by model."""

from __future__ import annotations

import functools
import math

import pytest
from runs import ENGINES, outputs, run

from statechart import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationProblem
from statechart.loading.load import load
from statechart.running.result import Result
from statechart.running.runner import Runner

pytestmark = pytest.mark.parametrize("engine", ENGINES)

G = 9.81
SMOOTH = 3 / (G * math.sin(math.pi / 9))


@functools.cache
def _runner(text: str, engine: str) -> Runner:
    return Runner(
        read_text(text), engine=engine, tolerance=2.3e-16 if engine == "taylor" else 1e-12
    )


def _run(text: str, engine: str, **parameters: float) -> Result:
    return _runner(text, engine).run(parameters, throw=False)


END = {
    name: float(load(name).stop.time)  # type: ignore[attr-defined]
    for name in (
        "block_on_incline", "bouncing_ball", "bouncing_ball_hills", "double_contact_bar",
        "dragged_stick", "four_legged_table", "hopper", "rocking_block", "sliding_ladder",
        "stick_slip_block", "toppling_stick", "two_balls",
    )
}  # fmt: skip
CLOSED_FORMS = [
    # Without friction it slides at g sin(alpha); nothing pins it.
    ("block_on_incline", {"mu": 0.0}, ["base.reverse"], {"t_stop": SMOOTH}),
    ("block_on_incline", {"mu": 1e-12}, ["base.reverse"], {"t_stop": SMOOTH}),
    # Friction that grows without bound stops it at once, without a way.
    ("block_on_incline", {"mu": 1e300}, ["base.jam"], {"t_stop": 0.0, "d_stop": 0.0}),
    ("block_on_incline", {"mu": math.inf}, ["base.jam"], {"t_stop": 0.0, "d_stop": 0.0}),
    # Upright, the slope is a wall: nothing presses the block on it.
    ("block_on_incline", {"alpha": math.pi / 2, "v0": 1.0}, ["base.reverse"], {"t_stop": 1 / G}),
    ("block_on_incline", {"g": 0.0}, [], {"t_stop": None}),
    ("block_on_incline", {"v0": 0.0}, [], {"t_stop": None}),
    # At the angle of repose it stops and stays.
    (
        "block_on_incline", {"alpha": math.atan(0.5), "mu": 0.5}, ["base.stick"],
        {"t_stop": 3 / (2 * G * math.sin(math.atan(0.5)))},
    ),
    ("bouncing_ball", {"k": 0.0}, ["floor.touchdown"], {"bounces": 1, "t_rest": math.sqrt(2 / G)}),
    ("bouncing_ball", {"g": 0.0, "v0": -1.0}, ["floor.touchdown"], {"bounces": 1, "t_rest": None}),
    ("bouncing_ball", {"g": 0.0, "x0": 0.0}, [], {"bounces": 0, "t_rest": None}),
    ("bouncing_ball", {"x0": 0.0, "k": 1.0}, [], {"bounces": 0}),
    ("bouncing_ball", {"g": -1.0}, [], {"bounces": 0}),
    # An empty run, or one that begins where it ends.
    ("toppling_stick", {"theta0": math.pi / 2}, [".stop"], {"t_impact": 0.0}),
    ("toppling_stick", {"theta0": -math.pi / 2}, [".stop"], {"t_impact": 0.0}),
    ("toppling_stick", {"g": 0.0, "omega0": 1.0}, [".stop"], {"t_impact": math.pi / 2 - 0.01}),
    ("toppling_stick", {"omega0": -100.0}, [".stop"], {"slip_backward": 0.0, "slip_forward": 0.0}),
    # Elastic balls of any ratio of masses: each rebounds as if alone.
    ("two_balls", {"ratio": 1e-12}, ["floor1.touchdown"] * 2, {"dy2": math.sqrt(1.8 * G)}),
    ("two_balls", {"ratio": 1e12}, ["floor1.touchdown"] * 2, {"dy1": math.sqrt(1.8 * G)}),
    ("two_balls", {"apart": 0.2}, ["floor1.touchdown"] * 2, {"dy1": math.sqrt(1.8 * G)}),
    ("two_balls", {"g": 0.0}, [], {"impacts1": 0}),
    # Flat, both ends land in one impact; upright, one.
    ("double_contact_bar", {"tilt_deg": 0.0}, ["A.touchdown"], {"t_A": 1.0, "t_B": 1.0}),
    ("double_contact_bar", {"tilt_deg": 90.0}, ["A.touchdown"], {"t_A": 1.0, "t_B": None}),
    ("double_contact_bar", {"tilt_deg": 0.0, "drop_height": 0.0}, [], {"xA_final": 0.0}),
    # Pinned at A from its impact on: moment of momentum, then energy, about A.
    (
        "double_contact_bar", {"mu": math.inf}, ["A.touchdown", "B.touchdown"],
        {"omega_before_B": math.hypot(0.75 * math.cos(math.pi / 6), math.sqrt(0.75))},
    ),
    # On its edges of the parameters the ladder stands, or falls free of the wall.
    ("sliding_ladder", {"theta0": 0.0}, [], {"t_leave": None}),
    ("sliding_ladder", {"mu": math.inf}, [], {"t_leave": None}),
    ("sliding_ladder", {"theta0": 1.57}, ["top.liftoff", ".stop"], {"height_ratio": 2 / 3}),
    ("rocking_block", {"theta0": 0.0}, [], {"impact_times": []}),
    ("rocking_block", {"theta0": 1e-16}, [], {"impact_times": []}),
    ("four_legged_table", {"g": 0.0, "push": 1.0}, [], {"moved": 1.25, "weight": 0.0}),
    ("four_legged_table", {"mu": math.inf}, [], {"moved": 0.0, "weight": 98.1}),
    ("four_legged_table", {"tilt": math.pi / 2}, [], {"weight": 0.0, "moved": 0.0}),
    # The dragged stick hangs on its end once friction is without bound.
    ("dragged_stick", {"mu": 0.0}, [], {"H": 0.0, "N": 0.5}),
    ("dragged_stick", {"mu": math.inf}, [], {"H": 1.0, "N": 0.0}),
    ("stick_slip_block", {"mu": math.inf}, [], {"t_first_slip": None, "x_end": 0.0}),
    ("stick_slip_block", {"F0": 0.0}, [], {"t_first_slip": None, "x_end": 0.0}),
    ("bouncing_ball_hills", {"A": 0.0}, ["ground.touchdown"] * 3, {"bounces": 3}),
    ("hopper", {"g": 0.0}, [], {"hops": 0}),
]  # fmt: skip


@pytest.mark.parametrize(
    ("model", "parameters", "events", "expected"),
    CLOSED_FORMS,
    ids=lambda value: str(value)[:40] if isinstance(value, str | dict) else "",
)
def test_a_model_at_its_limit_follows_its_closed_form(
    engine: str,
    model: str,
    parameters: dict[str, float],
    events: list[str],
    expected: dict[str, float | None],
) -> None:
    trace = run(model, engine, until=END[model], **parameters)
    assert trace.outcome.succeeded
    assert trace.certified
    assert [f"{jump.region}.{jump.cause}" for jump in trace.jumps] == events
    found = outputs(model, engine, trace)
    for name, value in expected.items():
        if value is None or isinstance(value, list):
            assert found[name] == value, name
        else:
            assert found[name] == pytest.approx(value, rel=1e-9, abs=1e-11), name


@pytest.mark.parametrize(("e", "rebound"), [(0.0, 0.0), (0.5, 0.143401), (1.0, 0.286802)])
def test_a_rod_that_jams_stops_and_rebounds_by_its_restitution(
    engine: str, e: float, rebound: float
) -> None:
    trace = run("painleve_rod", engine, until=1e-3, mu=2.0, phi=-0.6, omega=0.0, v=1.0, e=e)
    jam = trace.jumps[0]
    assert (jam.cause, jam.t) == ("jam", 0.0)
    *_, angle, dx, dy, spin = jam.after
    assert dx + math.cos(angle) * spin == pytest.approx(0.0, abs=1e-12)
    assert dy + math.sin(angle) * spin == pytest.approx(rebound, abs=1e-6)


def test_tipped_forwards_a_rod_jams_as_its_force_grows_without_bound(engine: str) -> None:
    trace = run("painleve_rod", engine, until=5.0, mu=2.0, phi=1.0, omega=-1.0, v=-1.0)
    assert [jump.cause for jump in trace.jumps] == ["jam", "stop"]
    assert trace.jumps[0].t == pytest.approx(0.0767166243845, abs=1e-11)
    assert any("grows without bound" in warning for warning in trace.warnings)
    energy = [before - after for before, after in (j.energy for j in trace.jumps if j.energy)]
    assert min(energy) >= 0.0


def test_an_event_at_the_very_end_is_reported_once(engine: str) -> None:
    trace = run("bouncing_ball", engine, until=1.0, x0=0.5, g=1.0)
    assert [jump.t for jump in trace.jumps] == [1.0]
    longer = run("bouncing_ball", engine, until=1.5, x0=0.5, g=1.0)
    assert [jump.t for jump in longer.jumps] == [pytest.approx(1.0, abs=1e-13)]


def test_permanent_rest_reaches_the_end_time(engine: str) -> None:
    trace = run("bouncing_ball", engine, until=1e12, k=0.0)
    assert (trace.t_end, len(trace.jumps)) == (1e12, 1)
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-300)


def test_a_start_inside_by_rounding_is_put_on_the_surface(engine: str) -> None:
    trace = run("double_contact_bar", engine, until=0.5, drop_height=-1e-13)
    on = run("double_contact_bar", engine, until=0.5, drop_height=0.0)
    assert [j.cause for j in trace.jumps] == [j.cause for j in on.jumps]
    assert trace.final == pytest.approx(on.final, abs=1e-11)


def test_a_start_deep_inside_names_the_contact_and_the_depth(engine: str) -> None:
    words = "contact 'A' starts inside its surface, 0.001 deep"
    with pytest.raises(DeclarationProblem, match=words):
        run("double_contact_bar", engine, drop_height=-1e-3)


BESIDE = """\
kind: scene
name: beside
gravity: 9.81
bodies: {ball: {mass: 1, start: {x: 0, y: 5}}}
surfaces: {wall: {line: [[0, 1], [0, 0]]}}
contacts: {side: {point: {body: ball}, surface: wall, friction: 0.5, restitution: 0.5}}
stop: {time: 1}
"""


def test_a_body_along_a_wall_without_pressure_falls_freely(engine: str) -> None:
    trace = _run(BESIDE, engine).trace
    assert not trace.jumps
    assert trace.final == pytest.approx([0.0, 5 - 0.5 * G, 0.0, -G], abs=1e-11)


SPRING = """\
kind: scene
name: spring
parameters: {k: 1}
bodies: {ball: {mass: 1, start: {x: 1}}}
forces: {spring: {body: ball, force: [-k*ball.x, 0]}}
stop: {time: 100/sqrt(k)}
"""


@pytest.mark.parametrize("k", [1.0, 1e12])
def test_a_stiff_spring_swings_as_a_soft_one(engine: str, k: float) -> None:
    trace = _run(SPRING, engine, k=k).trace
    assert trace.final[0] == pytest.approx(math.cos(100.0), abs=1e-10)
    assert trace.final[2] == pytest.approx(-math.sqrt(k) * math.sin(100.0), rel=1e-9)


SOURCE = """\
kind: chart
name: source
variables: {x: 1, y: 0}
regions: {only: {initial: run, states: {run: {flows: {x: -1, y: sqrt(x)}}}}}
stop: {time: 5}
"""


def test_undefined_values_end_the_run_with_time_and_mode(engine: str) -> None:
    trace = _run(SOURCE, engine).trace
    assert trace.outcome is Outcome.STEP_FAILURE
    assert trace.t_end == pytest.approx(1.0, abs=1e-9)
    assert "only:run" in trace.message
    assert "t = " in trace.message
