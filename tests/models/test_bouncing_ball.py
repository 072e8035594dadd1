"""The bouncing ball: closed forms, Zeno's point, hills (paper, section 2)."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from runs import ENGINES, golden, outputs, run

from contacts.scene.joints import Force
from contacts.scene.modes import Free, Slide
from contacts.scene.parts import Body, Contact, Point, Surface
from contacts.scene.scene import Scene
from statechart.automaton.trace import Trace
from statechart.documents.settings import Stop
from statechart.running.runner import Runner

FLAT = golden("bouncing_ball_flat")["flat"]
HILLS = golden("hilly_ball")["cases"]

pytestmark = pytest.mark.parametrize("engine", ENGINES)


def impacts(trace: Trace) -> list[float]:
    return [jump.t for jump in trace.jumps if jump.cause == "touchdown"]


@pytest.mark.parametrize("case", FLAT, ids=lambda c: f"k={c['k']}")
def test_bounce_times_and_the_zeno_time_match_the_closed_form(engine: str, case: dict) -> None:
    trace = run("bouncing_ball", engine, until=20.0, **{n: case[n] for n in ("x0", "v0", "g", "k")})
    times = impacts(trace)
    for found, expected in zip(times[:20], case["bounce_times"], strict=True):
        assert found == pytest.approx(float(expected), abs=1e-11)
    found = outputs("bouncing_ball", engine, trace)
    assert found["t_rest"] == pytest.approx(float(case["zeno_time_from_drop"]), abs=1e-11)
    assert found["bounces"] == len(times) >= 20
    assert trace.final_mode == ("slide",)
    assert trace.certified


def test_the_ledger_lists_the_skipped_impacts(engine: str) -> None:
    trace = run("bouncing_ball", engine, until=20.0, k=0.5)
    last, rest = trace.jumps[-2:]
    assert (last.cause, rest.cause) == ("touchdown", "zeno")
    assert last.t + last.skipped == pytest.approx(rest.t, abs=1e-14)
    # Equation 5: the impulse of the skipped bounces is the plastic impact's plus the weight's.
    speed = -last.before[1]
    skipped = speed * 1.5 / 0.5
    assert last.impulse["floor"][0] + 9.81 * last.skipped == pytest.approx(skipped, rel=1e-9)


def test_without_restitution_one_impact_is_the_end(engine: str) -> None:
    trace = run("bouncing_ball", engine, k=0.0, until=20.0)
    assert [jump.cause for jump in trace.jumps] == ["touchdown"]
    found = outputs("bouncing_ball", engine, trace)
    assert found["t_rest"] == pytest.approx(math.sqrt(2 / 9.81), abs=1e-13)
    assert found["bounces"] == 1
    assert trace.final == pytest.approx([0.0, 0.0], abs=1e-15)


@pytest.mark.parametrize("k", [1.0, 1.0 - 1e-12])
def test_elastic_bounces_are_never_captured(engine: str, k: float) -> None:
    count = 200
    first = math.sqrt(2 / 9.81)
    trace = run("bouncing_ball", engine, k=k, until=first * (2 * count))
    times = impacts(trace)
    assert len(times) == count
    assert {jump.cause for jump in trace.jumps} == {"touchdown"}
    expected = first + 2 * first * np.concatenate([[0.0], np.cumsum(k ** np.arange(1, count))])
    assert np.abs(times - expected).max() < 1e-9
    energies = [jump.energy[1] for jump in trace.jumps if jump.energy]
    assert max(energies) <= 9.81 * (1 + 1e-12)
    assert min(energies) >= 9.81 * (1 - 1e-9)


def test_a_ball_thrown_up_bounces_as_if_dropped_from_its_apex(engine: str) -> None:
    thrown = run("bouncing_ball", engine, until=20.0, x0=1.0, v0=3.0, k=0.5)
    apex = 1.0 + 9.0 / (2 * 9.81)
    dropped = run("bouncing_ball", engine, until=20.0, x0=apex, v0=0.0, k=0.5)
    shift = 3.0 / 9.81
    assert np.array(impacts(thrown)[:15]) - shift == pytest.approx(impacts(dropped)[:15], abs=1e-11)


@pytest.mark.parametrize(
    ("x0", "v0", "k"),
    [(0.0028807777424535697, 2.2989819505806954, 0.5), (0.0245042864219, 4.1268328971911, 0.9)],
)
def test_a_ball_thrown_up_near_the_ground_bounces(
    engine: str, x0: float, v0: float, k: float
) -> None:
    trace = run("bouncing_ball", engine, until=200.0, x0=x0, v0=v0, g=1.0, k=k)
    speed = math.sqrt(v0**2 + 2.0 * x0)
    rest = v0 + speed + 2.0 * speed * k / (1.0 - k)
    assert outputs("bouncing_ball", engine, trace)["t_rest"] == pytest.approx(rest, rel=1e-12)
    assert trace.certified


@pytest.mark.parametrize("push", [1e3, 1e4])
def test_a_ball_launched_far_above_its_start_bounces(engine: str, push: float) -> None:
    # Its flight is 1e5 to 1e7 times as high as all lengths of the start: the round-off of the gap
    # at an impact exceeds its tolerance.
    scene = Scene(
        name="launched",
        gravity=1,
        bodies={"ball": Body(mass=1, start={"y": 1e-4})},
        surfaces={"ground": Surface(height=0)},
        contacts={
            "base": Contact(
                point=Point(body="ball"), surface="ground", modes=(Free(), Slide()),
                friction=0, restitution=0.5,
            )
        },
        forces={"launch": Force(body="ball", force=(0, f"{push}*exp(-50*time)"))},
        stop=Stop(time=1000),
    )  # fmt: skip
    trace = Runner(scene, engine=engine).run().trace
    first, speed = trace.jumps[0].t, -trace.jumps[0].before[3]
    rest = next(jump.t for jump in trace.jumps if jump.cause == "zeno")
    assert rest == pytest.approx(first + 2.0 * speed, rel=1e-11)
    assert trace.certified


def test_a_start_on_the_ground_moving_down_hits_at_once(engine: str) -> None:
    trace = run("bouncing_ball", engine, until=0.1, x0=0.0, v0=-1.0, k=0.5)
    assert trace.jumps[0].t == 0.0
    assert trace.jumps[0].after[1] == 0.5


def test_a_start_at_rest_on_the_ground_rests(engine: str) -> None:
    trace = run("bouncing_ball", engine, until=5.0, x0=0.0, v0=0.0)
    assert trace.modes == (("slide",),)
    assert not trace.jumps


def test_a_body_without_gravity_flies_straight(engine: str) -> None:
    trace = run("bouncing_ball", engine, until=5.0, g=0.0, v0=-1.0, k=0.5)
    assert impacts(trace) == pytest.approx([1.0], abs=1e-13)
    assert trace.final == pytest.approx([2.0, 0.5], abs=1e-13)


@pytest.mark.parametrize("until", [0.0, 1e-300])
def test_an_empty_run_is_empty(engine: str, until: float) -> None:
    trace = run("bouncing_ball", engine, until=until)
    assert not trace.jumps
    assert trace.t_end == until


@pytest.mark.parametrize("case", HILLS, ids=lambda c: c["id"])
def test_no_bounce_is_missed_on_hills_where_sampling_tunnels(engine: str, case: dict) -> None:
    names = ("A", "k", "phase", "x0", "y0", "vx0", "vy0", "g", "e")
    until = float(case["true_bounces"][-1]["t"]) + 1e-3
    trace = run("bouncing_ball_hills", engine, until=until, **{n: float(case[n]) for n in names})
    assert trace.certified
    times = impacts(trace)
    assert len(times) == len(case["true_bounces"])
    for found, bounce, amplification in zip(
        times, case["true_bounces"], case["amplification_dt_dy0"], strict=True
    ):
        # Inputs are rounded to 1e-16; one bounce multiplies that by the amplification.
        assert found == pytest.approx(float(bounce["t"]), abs=1e-13 * max(1.0, amplification))


def test_random_steep_hills_without_a_tunnel(engine: str) -> None:
    count = 400 if engine == "taylor" else 30
    random_ = random.Random(20)
    for _ in range(count):
        A, k = 10 ** random_.uniform(-2, 0.3), 10 ** random_.uniform(0, 2)
        p = {
            "A": A, "k": k, "phase": random_.uniform(0, 6.3), "x0": random_.uniform(-1, 1),
            "y0": A + random_.uniform(0.01, 2), "vx0": random_.uniform(-9, 9),
            "vy0": random_.uniform(-4, 4), "g": 9.81, "e": random_.uniform(0.0, 0.95),
        }  # fmt: skip
        trace = run("bouncing_ball_hills", engine, until=1.5, **p)
        assert trace.outcome.succeeded, (p, trace.message)
        assert trace.certified, p
        for arc in trace.arcs:
            # Places that the search did not use: an irrational grid, dense on every hill.
            wavelengths = abs(arc.coefficients[:, 2, 0]).max() * arc.duration * k + 4
            places = min(int(200 * wavelengths), 20_000)
            local = arc.duration * ((np.arange(places) * 0.6180339887498949) % 1.0)
            x, y = arc.states(local)[:, :2].T
            angle = k * x + p["phase"]
            gap = (y - A * np.sin(angle)) / np.hypot(1.0, A * k * np.cos(angle))
            assert gap.min() >= -1.1 * trace.tolerances["gap"], (p, gap.min())
