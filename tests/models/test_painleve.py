"""Painleve's rod as complete runs: reports, and impacts without collision."""

from __future__ import annotations

import math

import numpy as np
import pytest
from runs import ENGINES, engine, golden

from contacts.dynamics.setup import SceneSetup
from contacts.event_driven.laws import SceneLaws
from contacts.impacts.jamming import paradoxes
from contacts.kind import automaton
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.automaton.trace import Outcome, Trace
from statechart.execution.simulator import Simulator

TABLE = golden("painleve")["sliding_table"]


def rod(**changes: object) -> Scene:
    """Return a rod of half-length 1 whose lower end slides on the floor; phi as in the tables."""
    return Scene(
        name="rod",
        gravity=1,
        parameters={"phi": 0.6, "omega": 0, "v": -1, "mu": 2, "k": "1/3", "e": 0},
        bodies={
            "rod": Body(
                mass=1,
                inertia="k",
                start={
                    "x": "sin(phi)",
                    "y": "cos(phi)",
                    "angle": "-phi",
                    "dx": "v + cos(phi)*omega",
                    "dy": "-sin(phi)*omega",
                    "dangle": "-omega",
                },
            )
        },
        surfaces={"board": Surface(height=0)},
        contacts={
            "end": Contact(
                point=Point(body="rod", at=(0, -1)), surface="board", friction="mu", restitution="e"
            )
        },
        **changes,  # type: ignore[arg-type]
    )


ROD = automaton(rod())
SIMULATORS = {name: Simulator(ROD, engine(name)) for name in ENGINES}


def start(case: dict) -> dict[str, float]:
    return {
        "phi": math.radians(case["phi_deg"]),
        "omega": case["omega"],
        "v": float(case["sigma"]),
        "mu": case["mu"],
        "k": case["I_G"],
    }


@pytest.mark.parametrize("case", TABLE, ids=lambda case: f"{case['phi_deg']:.0f}")
def test_p_b_and_the_critical_friction_are_the_reference_ones(case: dict) -> None:
    laws = ROD.laws
    assert isinstance(laws, SceneLaws)
    setup = ROD.setup(start(case), 1e-15)
    assert isinstance(setup, SceneSetup)
    snapshot = laws.tape.at(setup.values, setup.initial, 0.0)
    found = paradoxes(setup, snapshot, [True])
    assert bool(found) is (float(case["p"]) < 0.0)
    for paradox in found.values():
        assert paradox.kind == case["classification"]
        assert paradox.p == pytest.approx(float(case["p"]), abs=1e-12)
        assert paradox.b == pytest.approx(float(case["b"]), abs=1e-12)
        assert paradox.critical == pytest.approx(float(case["mu_critical_at_phi"]), abs=1e-12)


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("case", TABLE, ids=lambda case: f"{case['phi_deg']:.0f}")
def test_runs_begin_as_the_table_says(name: str, case: dict) -> None:
    trace = SIMULATORS[name].run(start(case), until=1e-3)
    slide = "slide+" if case["sigma"] > 0 else "slide-"
    kind = case["classification"]
    if kind == "inconsistent":
        assert (trace.jumps[0].cause, trace.jumps[0].t) == ("jam", 0.0)
        assert "inconsistent" in trace.warnings[0]
    else:
        assert trace.start_mode == ("free" if kind != "slide" else slide,)
        assert ("indeterminate" in "".join(trace.warnings)) is (kind == "indeterminate")


def jammed(e: float, mirrored: bool = False) -> Trace:
    sign = -1.0 if mirrored else 1.0
    return SIMULATORS["scipy"].run({"phi": -0.6 * sign, "v": sign, "e": e}, until=1e-3)


@pytest.mark.parametrize(("e", "speed"), [(0.0, 0.0), (0.5, 0.143401), (1.0, 0.286802)])
def test_an_impact_without_collision_stops_the_slip_and_throws_the_rod_up(
    e: float, speed: float
) -> None:
    jump = jammed(e).jumps[0]
    angle, dx, dy, turn = jump.after[2:]
    arm = np.array([math.sin(angle), -math.cos(angle)])
    velocity = np.array([dx, dy]) + turn * np.array([-arm[1], arm[0]])
    assert velocity == pytest.approx([0.0, speed], abs=5e-7)
    normal, tangential = jump.impulse["end"]
    assert normal > 0.0
    assert abs(tangential) <= 2.0 * normal
    assert jump.energy is not None
    assert jump.energy[1] < jump.energy[0]
    image = jammed(e, mirrored=True).jumps[0]
    assert image.after == pytest.approx(jump.after * [-1, 1, -1, -1, 1, -1], abs=1e-14)


def test_stop_ends_the_run_with_the_evidence() -> None:
    trace = Simulator(automaton(rod(paradox="stop")), engine("scipy")).run(
        {"phi": -0.6, "v": 1.0}, until=1e-3, throw=False
    )
    assert trace.outcome is Outcome.NO_CONSISTENT_MODE
    for part in ("end:slide+", "end:free", "inconsistent", "p = -0.839654", "critical mu"):
        assert part in trace.message


def test_a_chart_shows_jams_only_where_friction_can_press_a_point_in() -> None:
    causes = {edge.cause for edge in ROD.regions[0].edges}
    assert "jam" in causes
    particle = Scene(
        name="particle",
        bodies={"p": Body(mass=1, start={"y": 1})},
        surfaces={"floor": Surface(height=0)},
        contacts={"c": Contact(point=Point(body="p"), surface="floor", friction=1, restitution=0)},
    )
    assert "jam" not in {edge.cause for edge in automaton(particle).regions[0].edges}


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("count", [2, 3])
def test_rods_apart_from_each_other_lift_off_as_each_does_alone(name: str, count: int) -> None:
    alone = rod()
    (body,), (end,) = alone.bodies.values(), alone.contacts.values()
    several = {
        "bodies": {
            f"rod{i}": body.model_copy(update={"start": {**body.start, "x": f"sin(phi) + {5 * i}"}})
            for i in range(count)
        },
        "contacts": {
            f"end{i}": end.model_copy(update={"point": Point(body=f"rod{i}", at=(0, -1))})
            for i in range(count)
        },
    }
    case = next(case for case in TABLE if case["classification"] == "indeterminate")
    one = SIMULATORS[name].run(start(case), until=0.1)
    scene = automaton(alone.model_copy(update=several))
    trace = Simulator(scene, engine(name)).run(start(case), until=0.1)
    assert trace.start_mode == ("free",) * count
    assert "indeterminate" in "".join(trace.warnings)
    ends = dict(zip(trace.variables, trace.final, strict=True))
    for variable, value in zip(one.variables, one.final, strict=True):
        for i in range(count):
            shift = 5.0 * i if variable == "rod.x" else 0.0
            again = ends[variable.replace("rod", f"rod{i}")]
            assert again == pytest.approx(value + shift, abs=1e-9)
