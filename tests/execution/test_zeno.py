"""Bouncing balls as plain charts: bounce times and where they accumulate."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import path
from statechart.automaton.automaton import Automaton
from statechart.automaton.clock import Clock
from statechart.automaton.trace import Outcome, Trace
from statechart.charts.chart import Chart
from statechart.charts.laws import automaton
from statechart.engines.scipy import SciPy
from statechart.engines.taylor import Taylor
from statechart.errors import SimulationError
from statechart.execution.simulator import Simulator
from statechart.execution.zeno import Accumulation, _remaining
from statechart.loading.load import load

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "bouncing_ball_flat.json").read_text())
FIRST = math.sqrt(2.0 / 9.81)


def model() -> Automaton:
    file = path("bouncing_ball_chart")
    assert file is not None
    chart = load(file)
    assert isinstance(chart, Chart)
    return automaton(chart)


@pytest.fixture(scope="module", params=["taylor", "scipy"])
def ball(request: pytest.FixtureRequest) -> Simulator:
    return Simulator(model(), Taylor(2.2e-16) if request.param == "taylor" else SciPy(1e-12))


def times(trace: Trace, cause: str) -> list[float]:
    return [jump.t for jump in trace.jumps if jump.cause == cause]


@pytest.mark.parametrize("case", GOLDEN["flat"], ids=lambda case: f"k={case['k']}")
def test_bounces_and_their_accumulation_agree_with_the_golden_times(
    ball: Simulator, case: Mapping[str, Any]
) -> None:
    given = {"x0": case["x0"], "v0": case["v0"], "g": case["g"], "k": case["k"]}
    trace = ball.run(given, until=20.0)
    expected = [float(text) for text in case["bounce_times"]]
    assert times(trace, "bounce")[: len(expected)] == pytest.approx(expected, abs=1e-11, rel=0)
    (rest,) = times(trace, "settle")
    assert rest == pytest.approx(float(case["zeno_time_from_drop"]), abs=1e-11, rel=0)
    assert trace.final.tolist() == [0.0, 0.0]
    assert trace.final_mode == ("rest",)
    assert trace.certified


@pytest.mark.parametrize("k", [1e-20, 1e-8, 1e-4, 1e-3, 0.01, 0.3, 0.95])
def test_bounces_end_at_the_geometric_sum(ball: Simulator, k: float) -> None:
    trace = ball.run({"k": k, "v0": 0}, until=200.0)
    (rest,) = times(trace, "settle")
    assert rest == pytest.approx(FIRST * (1 + k) / (1 - k), rel=1e-11)


def test_without_restitution_the_ball_rests_after_one_bounce(ball: Simulator) -> None:
    trace = ball.run({"k": 0}, until=20.0)
    assert [jump.cause for jump in trace.jumps] == ["bounce", "settle"]
    assert times(trace, "settle") == times(trace, "bounce") == pytest.approx([FIRST], abs=1e-14)


def test_a_ball_at_rest_on_the_ground_settles_at_once(ball: Simulator) -> None:
    trace = ball.run({"x0": 0, "v0": 0}, until=20.0)
    assert [(jump.t, jump.cause) for jump in trace.jumps] == [(0.0, "settle")]


def test_a_ball_thrown_upwards_falls_later(ball: Simulator) -> None:
    trace = ball.run({"v0": 3, "k": 0.5}, until=20.0)
    speed = math.sqrt(9 + 2 * 9.81)
    first = (3 + speed) / 9.81
    assert times(trace, "bounce")[0] == pytest.approx(first, abs=1e-12)
    assert times(trace, "settle") == pytest.approx([first + 2 * speed / 9.81], abs=1e-11)


@pytest.mark.parametrize("start", [0.0, 1e-12])
def test_a_ball_thrown_from_the_ground_does_not_bounce_at_the_start(
    ball: Simulator, start: float
) -> None:
    trace = ball.run({"x0": start, "v0": 5, "k": 0.5}, until=20.0)
    assert times(trace, "bounce")[0] == pytest.approx(10 / 9.81, abs=1e-11)
    assert times(trace, "settle") == pytest.approx([20 / 9.81], abs=1e-11)


def test_elastic_bounces_keep_period_and_energy() -> None:
    ball = Simulator(model(), Taylor(2.2e-16))
    trace = ball.run({"k": 1}, until=FIRST * 2000)
    bounces = times(trace, "bounce")
    assert bounces == pytest.approx(FIRST * (2 * np.arange(1000) + 1), rel=1e-11)
    energies = [9.81 * jump.after[0] + 0.5 * jump.after[1] ** 2 for jump in trace.jumps]
    assert energies == pytest.approx([9.81] * 1000, rel=1e-11)
    assert not times(trace, "settle")


def test_a_restitution_of_nearly_one_is_not_captured() -> None:
    ball = Simulator(model(), Taylor(2.2e-16))
    trace = ball.run({"k": 1 - 1e-12}, until=FIRST * 200)
    assert len(times(trace, "bounce")) == 100
    assert trace.final_mode == ("flight",)


def bouncing(*names: str, settle: bool) -> Automaton:
    """Return one ball in each region, at height 1, with its own restitution k."""
    regions: dict[str, Any] = {}
    variables: dict[str, Any] = {}
    for name in names:
        x, v = f"x_{name}", f"v_{name}"
        variables |= {x: 1, v: 0}
        transitions: list[dict[str, Any]] = [
            {
                "name": "bounce",
                "from": "flight",
                "to": "flight",
                "guard": f"{x} <= 0",
                "updates": {v: f"-k_{name}*{v}"},
            }
        ]
        if settle:
            rest = {x: 0, v: 0}
            transitions.append(
                {"name": "settle", "from": "flight", "to": "rest", "on": "zeno", "updates": rest}
            )
        regions[name] = {
            "initial": "flight",
            "states": {"flight": {"flows": {x: v, v: "-9.81"}}, "rest": {}},
            "transitions": transitions,
        }
    parameters: dict[str, Any] = {f"k_{name}": 0.5 for name in names}
    return automaton(
        Chart.model_validate(
            {"name": "balls", "variables": variables, "regions": regions, "parameters": parameters}
        )
    )


def test_an_undeclared_accumulation_ends_the_run_with_advice() -> None:
    simulator = Simulator(bouncing("one", settle=False), Taylor(2.2e-16))
    trace = simulator.run(until=20.0, throw=False)
    assert trace.outcome is Outcome.ZENO
    assert "'bounce' accumulates at t = 1.35457;" in trace.message
    assert "on: zeno" in trace.message
    assert trace.t_end < FIRST * 3
    with pytest.raises(SimulationError, match="on: zeno"):
        simulator.run(until=20.0)


@pytest.mark.parametrize(
    ("one", "other"),
    # The last are so close that one ball is still held while the other settles.
    [(0.5, 0.5), (0.5, 0.8), (0.8, 0.5), (0.5, 0.5 + 1e-10)],
)
def test_two_balls_settle_at_their_own_times(one: float, other: float) -> None:
    simulator = Simulator(bouncing("a", "b", settle=True), Taylor(2.2e-16))
    trace = simulator.run({"k_a": one, "k_b": other}, until=20.0)
    settled = {jump.region: jump.t for jump in trace.jumps if jump.cause == "settle"}
    for name, k in (("a", one), ("b", other)):
        assert settled[name] == pytest.approx(FIRST * (1 + k) / (1 - k), rel=1e-12)
    assert trace.final_mode == ("rest", "rest")
    if one == other:
        assert settled["a"] == settled["b"]


def test_a_zeno_sequence_captures_only_its_region() -> None:
    chart = bouncing("a", "b", settle=True)
    simulator = Simulator(chart, SciPy(1e-6))
    trace = simulator.run({"k_a": 0.5, "k_b": 1.0}, until=3.0)
    (skip,) = [jump for jump in trace.jumps if jump.skipped > 0.0]
    (settle,) = [jump for jump in trace.jumps if jump.cause == "settle"]
    assert skip.region == settle.region == "a"
    moved = settle.before[2] - skip.after[2]
    fall = skip.after[3] * skip.skipped - 0.5 * 9.81 * skip.skipped**2
    assert moved == pytest.approx(fall, abs=1e-9)
    assert settle.before[0] == skip.after[0]


def test_alternating_zeno_sequence_is_recognised() -> None:
    # Two tanks share one hose (Zhang, Johansson, Lygeros, Sastry 2001): it switches faster and
    # faster, until both are empty at 2 h / (2 out - in).
    chart = automaton(
        Chart.model_validate(
            {
                "name": "tanks",
                "parameters": {"inflow": 3, "out": 2},
                "variables": {"a": 1, "b": 1},
                "regions": {
                    "hose": {
                        "initial": "left",
                        "states": {
                            "left": {"flows": {"a": "inflow - out", "b": "-out"}},
                            "right": {"flows": {"a": "-out", "b": "inflow - out"}},
                            "off": {},
                        },
                        "transitions": [
                            {"name": "to_right", "from": "left", "to": "right", "guard": "b <= 0"},
                            {"name": "to_left", "from": "right", "to": "left", "guard": "a <= 0"},
                            {"name": "close", "from": "right", "to": "off", "on": "zeno"},
                        ],
                    }
                },
            }
        )
    )
    trace = Simulator(chart, Taylor(2.2e-16)).run(until=10.0)
    assert times(trace, "close") == pytest.approx([2.0], abs=1e-11)


def test_only_geometric_sequences_are_extrapolated() -> None:
    def predicted(ratio: float, power: float = 1.0) -> float | None:
        watch, clock = Accumulation(), Clock()
        for n in range(200):
            rest = watch.watch(("r", "hit"), clock, 1e-6, flowed=True)
            if rest is not None:
                return clock.later(rest).high
            clock = clock.later(ratio ** (n**power))
        return None

    assert predicted(0.5) == pytest.approx(2.0, abs=1e-15)
    assert predicted(0.9) == pytest.approx(10.0, abs=1e-13)
    assert predicted(1.0) is None
    assert predicted(1.1) is None
    assert predicted(0.9, 0.7) is None


def test_zeno_detection_is_per_region() -> None:
    watch, clocks = Accumulation(), {"a": Clock(), "b": Clock(0.3)}
    found: dict[str, float] = {}
    for n in range(60):
        for name in ("a", "b"):
            rest = watch.watch((name, "hit"), clocks[name], 1e-6, flowed=True)
            if rest is not None:
                found.setdefault(name, clocks[name].later(rest).high)
            clocks[name] = clocks[name].later(0.5**n)
    assert found == pytest.approx({"a": 2.0, "b": 2.3}, abs=1e-14)


def test_jumps_without_flow_are_a_loop_not_zeno() -> None:
    watch = Accumulation()
    found = [watch.watch(("r", "hit"), Clock(1.0), 1e-6, flowed=False) for _ in range(60)]
    assert found == [None] * 60


def test_intervals_with_round_off_are_extrapolated_only_while_they_converge() -> None:
    disturbed = np.random.default_rng(1).uniform(-1e-4, 1e-4, (200, 12))
    rest = 0.7**12 / 0.3
    for row in 0.7 ** np.arange(12) * (1.0 + disturbed):
        intervals = row.tolist()
        assert _remaining(intervals, intervals[-1] * 0.7 / 0.3) == pytest.approx(rest, rel=8e-3)


@pytest.mark.parametrize("ratios", [(0.4, 0.6), (0.45, 0.55), (0.5, 0.501)])
def test_a_sequence_whose_ratio_changes_is_not_summed(ratios: tuple[float, float]) -> None:
    watch, clock, interval = Accumulation(), Clock(), 1.0
    for n in range(60):
        assert watch.watch(("r", "hit"), clock, 1e-6, flowed=True) in (None, 0.0)
        clock = clock.later(interval)
        interval *= ratios[n % 2]


@pytest.mark.parametrize("power", [2, 3, 4])
def test_a_sequence_of_powers_is_not_summed_as_a_geometric_one(power: int) -> None:
    watch, clock = Accumulation(), Clock()
    for n in range(1, 3000):
        assert watch.watch(("r", "hit"), clock, 1e-3, flowed=True) is None
        clock = clock.later(float(n) ** -power)
