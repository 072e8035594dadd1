"""Accuracy and budgets: estimates, cost, and magnification of errors by events."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import golden

from contacts.event_driven import accumulation
from statechart.automaton.trace import Outcome, Trace
from statechart.cli.main import main
from statechart.documents.setting import Setting
from statechart.documents.yaml_reader import read_text
from statechart.engines.engine import TimeBudget
from statechart.errors import OutOfBudget
from statechart.observation.alignment import pair_jumps
from statechart.observation.difference import compare, separation_time
from statechart.observation.observer import Observer
from statechart.running.accuracy import EvaluatedRun, Once, run_within_budget, tighten
from statechart.running.runner import Runner, run

THROWN = """\
kind: chart
name: thrown
parameters: {v0: 1, h: 0.4}
variables: {x: 0, v: v0}
regions:
  ball:
    initial: below
    states: {below: {flows: {x: v, v: -1}}, above: {flows: {x: v, v: -1}}}
    transitions:
      - {name: pass, from: below, to: above, guard: x >= h}
stop: {time: 1}
"""


def slow(runner: Runner, seconds: Callable[[float], float]) -> tuple[Once, Callable[[], float]]:
    """Return runs that take `seconds` of their tolerance, and the clock that they move."""
    now = [0.0]

    def once(tolerance: float, off: bool) -> tuple[object, object]:
        now[0] += seconds(tolerance)
        result = Runner(runner.model, engine="scipy", tolerance=tolerance).run()
        return result.observer, result.trace

    return once, lambda: now[0]  # type: ignore[return-value]


def test_the_condition_of_an_event_is_that_of_its_formula() -> None:
    # x = v t - t^2/2 reaches h: with sizes X of x and V of v, kappa = X / (T |v|).
    result = run(read_text(THROWN), accuracy=1e-6)
    trace = result.trace
    (kappa,) = result.conditions
    speed = math.sqrt(1.0 - 2.0 * 0.4)
    assert kappa == pytest.approx(abs(trace.final[0]) / (1.0 * speed), rel=1e-8)


@pytest.mark.parametrize("margin", [1e-2, 1e-4, 1e-6])
def test_the_condition_grows_as_a_graze_is_approached(margin: float) -> None:
    # The highest point is 1/2; an error of the state moves the event by 1/sqrt(2 margin) of it.
    (kappa,) = run(read_text(THROWN), parameters={"h": 0.5 - margin}, accuracy=1e-3).conditions
    assert kappa == pytest.approx(0.5 / math.sqrt(2.0 * margin), rel=1e-5)


def test_the_condition_number_predicts_the_shift_of_an_event() -> None:
    trace = run("bouncing_ball_hills", accuracy=1e-9)
    kappa = trace.conditions[0]
    assert kappa is not None
    moved = run("bouncing_ball_hills", parameters={"y0": 1.05 * (1 + 1e-6)})
    shift = abs(moved.trace.jumps[0].t - trace.trace.jumps[0].t) / trace.trace.t_end
    assert 0.0 < shift <= 1.01 * kappa * 1e-6


def test_jumps_without_a_fired_margin_have_no_condition_number() -> None:
    result = run("bouncing_ball", accuracy=1e-6)
    assert len(result.conditions) == len(result.trace.jumps)
    for jump, kappa in zip(result.trace.jumps, result.conditions, strict=True):
        assert (kappa is None) == (jump.fired in ((), ("zeno",)))


def test_accuracy_request_reports_condition_and_cost() -> None:
    report = run("toppling_stick", accuracy=1e-5).to_dict()
    asked = report["asked"]
    assert asked["reached"]
    assert asked["cost"]["runs"] >= 2
    assert asked["cost"]["steps"] > report["counts"]["steps"]
    assert report["condition"] == max(e["condition"] for e in report["events"])
    plain = run("toppling_stick").to_dict()
    assert (plain["asked"], plain["condition"]) == (None, None)


def test_tightening_starts_at_the_first_tolerance_and_ends_when_two_runs_agree() -> None:
    tolerances: list[float] = []
    nudges: list[bool] = []
    runner = Runner("toppling_stick")

    def once(tolerance: float, off: bool) -> tuple[object, object]:
        tolerances.append(tolerance)
        nudges.append(off)
        result = Runner(runner.model, engine="scipy", tolerance=tolerance).run()
        return result.observer, result.trace

    answer = tighten(once, 1e-4, first=1e-3, floor=1e-13)  # type: ignore[arg-type]
    assert answer.error is not None
    assert answer.error <= 1e-4
    assert answer.cost.runs == len(tolerances) > 2
    *tightened, before, last = tolerances
    assert tightened == pytest.approx([1e-3 / 20**k for k in range(len(tightened))], rel=1e-12)
    # Before acceptance a perturbed start is tried at the previous tolerance. It changes nothing in
    # these runs, so it is also tried at the last one.
    assert (before, last) == (tightened[-2], tightened[-1])
    assert nudges == [False] * len(tightened) + [True, True]


def test_a_missed_accuracy_is_reported_and_exits_with_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    code = main(["run", "toppling_stick", "--accuracy", "1e-15", "--engine", "scipy", "--json"])
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert code == 1
    assert report["outcome"] == "STOPPED"
    assert not report["asked"]["reached"]
    assert "was not reached" in said.err


def test_within_a_budget_runs_tighten_as_long_as_there_is_time() -> None:
    runner = Runner("toppling_stick")
    once, clock = slow(runner, lambda tolerance: 1.0)
    few = run_within_budget(once, 2.9, floor=1e-13, clock=clock)
    once, clock = slow(runner, lambda tolerance: 1.0)
    many = run_within_budget(once, 4.9, floor=1e-13, clock=clock)
    # A run is not begun unless half as much again as the last one took is left.
    assert (few.cost.runs, many.cost.runs) == (2, 4)
    assert few.cost.seconds <= 2.9
    assert few.error is not None
    assert many.error is not None
    assert many.error < few.error / 100
    assert many.warnings == ()


def test_the_tightest_run_ends_a_budget_early() -> None:
    once, clock = slow(Runner("toppling_stick"), lambda tolerance: 0.0)
    answer = run_within_budget(once, 100.0, floor=1e-9, clock=clock)
    assert answer.trace.tolerance == pytest.approx(1e-9)


def test_a_single_run_within_the_budget_warns_of_no_estimate() -> None:
    once, clock = slow(Runner("toppling_stick"), lambda tolerance: 1.0)
    answer = run_within_budget(once, 1.5, floor=1e-13, clock=clock)
    assert answer.error is None
    assert "allowed one run" in answer.warnings[0]


def test_a_run_over_the_time_budget_reports_the_last_complete_one() -> None:
    ticks = count()
    time_budget = TimeBudget(10.0, clock=lambda: float(next(ticks)))
    time_budget.begin()
    for _ in range(10):
        time_budget.check(0.5)
    with pytest.raises(OutOfBudget, match=r"used up at t = 0\.5; allow more time"):
        time_budget.check(0.5)


def test_a_budget_that_cannot_be_met_exits_with_1_and_keeps_the_trace(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = count()
    # The clock is looked at once when the budget begins and before every call for steps.
    monkeypatch.setattr(
        "statechart.running.runner.TimeBudget",
        lambda seconds: TimeBudget(seconds, clock=lambda: float(next(ticks))),
    )
    code = main(["run", "bouncing_ball", "--budget", "20", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert code == 1
    assert report["outcome"] == "OUT_OF_BUDGET"
    assert "allow more time" in report["message"]
    assert 5 < len(report["events"]) < 40
    assert report["error_estimate"] is None
    assert not report["asked"]["reached"]


def test_a_budget_gives_an_answer_with_its_estimate() -> None:
    result = run("toppling_stick", budget=120.0)
    assert result.trace.outcome is Outcome.STOPPED
    assert result.asked is not None
    assert result.error_estimate is not None
    assert result.error_estimate < 1e-9


def test_difference_reports_its_parts_and_the_divergence_time() -> None:
    exact, rough = run("toppling_stick"), run("toppling_stick", tolerance=1e-4)
    found = compare(exact.trace, rough.trace, exact.outputs, rough.outputs)
    assert found.diverged is None
    assert found.largest == max(found.state, found.times, found.outputs)
    assert separation_time(exact.trace, rough.trace) is None
    other = run("toppling_stick", parameters={"mu": 0.25})
    when = separation_time(exact.trace, other.trace)
    assert when is not None
    assert 3.0 < when < exact.trace.t_end
    # Slightly different times of bounces do not count as differences of states.
    ball, later = run("bouncing_ball"), run("bouncing_ball", parameters={"x0": 1 + 1e-4})
    first = separation_time(ball.trace, later.trace)
    assert first is None or first > 5.0


def test_short_mode_differences_are_ignored() -> None:
    result = run("bouncing_ball_hills")
    trace = result.trace
    jumps = trace.jumps
    later = replace(jumps[3], t=jumps[3].t + 1e-9, region="another")
    extra = replace(trace, jumps=(*jumps[:4], later, *jumps[4:]))
    assert pair_jumps(trace, extra)[1] == later.t
    pairs, diverged = pair_jumps(trace, extra, brief=1e-6)
    assert diverged is None
    # Its neighbours are still paired with themselves.
    assert all(one.t == other.t for one, other in pairs)
    assert len(pairs) == len(jumps)
    elsewhere = replace(jumps[3], t=jumps[3].t + 1e-3, region="another")
    assert (
        pair_jumps(trace, replace(trace, jumps=(*jumps[:4], elsewhere)), brief=1e-6)[1] is not None
    )


def test_an_accuracy_is_delivered_on_random_scenes_or_refused_with_the_reason() -> None:
    path = Path(__file__).parents[2] / "benchmarks" / "accuracy_of_random_scenes.py"
    spec = importlib.util.spec_from_file_location("accuracy_of_random_scenes", path)
    assert spec is not None
    assert spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = benchmark
    spec.loader.exec_module(benchmark)
    judges = benchmark.Judges()
    found = [judges.judge(scene, parameters) for scene, parameters in benchmark.draws(12, 7)]
    assert not [j for j in found if j.verdict == "missed"]
    assert sum(j.verdict == "delivered" for j in found) >= 10
    assert all(j.reason for j in found if j.verdict != "delivered")


def test_a_run_that_fails_early_separates_at_its_end() -> None:
    exact = run("bouncing_ball_hills")
    short = run("bouncing_ball_hills", until=0.2)
    ended = replace(short.trace, outcome=Outcome.STEP_FAILURE)
    assert separation_time(exact.trace, ended) is not None


@pytest.mark.parametrize(
    ("settings", "factor"),
    [
        ({"engine": "taylor"}, 1.0),
        ({"engine": "scipy", "method": "DOP853"}, 30.0),
        ({"engine": "scipy", "method": "RK45"}, 30.0),
        ({"engine": "scipy", "method": "Radau"}, 30.0),
        # Its past is kept where its state is brought back onto the constraints.
        ({"engine": "scipy", "method": "LSODA"}, 30.0),
    ],
)
@pytest.mark.parametrize("name", ["toppling_stick", "stick_slip_block"])
def test_the_error_of_events_is_that_of_the_integrator(
    name: str, settings: dict[str, str], factor: float
) -> None:
    exact = run(name)
    # A force that falls where the dense output is off its constraints has not fallen on them.
    for tolerance in (1e-5, 1e-7):
        rough = run(name, tolerance=tolerance, **settings)  # type: ignore[arg-type]
        found = compare(exact.trace, rough.trace, exact.outputs, rough.outputs)
        assert found.diverged is None
        assert found.largest <= factor * tolerance


def test_alternating_sums_with_different_starts_agree(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    many = run("rocking_block", until=13.0, engine="scipy", tolerance=2.3e-14)
    # They begin at a part of the length, whatever the tolerance.
    monkeypatch.setattr(accumulation, "_MAX_HEIGHT_AT_REST", 1e-4)
    few = run("rocking_block", until=13.0, engine="scipy", tolerance=1e-11)
    assert len(many.trace.jumps) > len(few.trace.jumps)
    assert few.endless == many.endless != frozenset()
    found = compare(few.trace, many.trace, few.outputs, many.outputs, endless=few.endless)
    assert found.diverged is None
    assert found.largest <= 1e-7


def test_the_estimate_bounds_the_error_that_all_engines_share() -> None:
    # Every engine leaves a mode where a force is below its tolerance: agreement shows nothing.
    cell = next(c for c in golden("toppling_stick")["cells"] if c["mu"] == 0.2)
    for accuracy in (1e-12, 1e-15):
        result = run("toppling_stick", accuracy=accuracy, throw=False)
        assert result.error_estimate is not None
        names = {"critical_angle": "critical_angle_rad", "t_impact": "t_impact"}
        true = max(abs(result.outputs[a] / cell[b] - 1.0) for a, b in names.items())
        assert 1e-13 < true < 1.1 * result.error_estimate
        assert any("was not reached" in warning for warning in result.warnings)


# Its ends hit the ground in turn, ever faster; which one is last depends on the tolerance of gaps.
RATTLING = """\
kind: scene
name: rattling_bar
gravity: 9.81
bodies:
  bar:
    mass: 1
    inertia: 0.11225805169500412
    start: {x: 0, y: 0.7474407345467969 + sin(0.19446268032406214), angle: -0.19446268032406214,
            dx: -0.11982062507388047}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-1, 0]}, surface: floor, friction: 0.011,
      restitution: 0.12}
  B: {point: {body: bar, at: [1, 0]}, surface: floor, friction: 0.011,
      restitution: 0.12}
stop: {time: 2}
"""


def test_modes_that_depend_on_a_tolerance_are_no_accurate_answer() -> None:
    result = run(read_text(RATTLING), accuracy=1e-6, throw=False)
    assert result.error_estimate == math.inf
    assert "take different modes from t = 0.444059 on" in result.warnings[-1]


# An end lands 1e-8 s before the other. Runs at tolerances from 1e-7 to 1e-11 merge the two impacts
# and come to rest at 0.5201 s.
NEARLY_TOGETHER = """\
kind: scene
name: bar_with_impacts_nearly_together
gravity: 9.81
bodies:
  bar:
    mass: 1
    inertia: 0.2118988878993148
    start: {y: 0.31560348997827314 + sin(0.59031530168598179), angle: -0.59031530168598179,
            dx: 0.48149696575149736}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-1, 0]}, surface: floor, friction: 0.5798748343627852,
      restitution: 0.27950864391894803}
  B: {point: {body: bar, at: [1, 0]}, surface: floor, friction: 0.5798748343627852,
      restitution: 0.27950864391894803}
stop: {time: 2}
outputs: {hits: {count: A.touchdown}}
"""


@pytest.mark.parametrize("method", ["RK45", "LSODA"])
def test_the_estimate_includes_the_merging_of_impacts(method: str) -> None:
    model = read_text(NEARLY_TOGETHER)
    exact = run(model, engine="taylor")
    assert exact.trace.jumps[-1].t == pytest.approx(0.519356, abs=1e-6)
    result = run(model, accuracy=1e-4, engine="scipy", method=method)
    assert result.error_estimate is not None
    assert result.error_estimate <= 1e-4
    assert result.trace.jumps[-1].t == pytest.approx(exact.trace.jumps[-1].t, abs=2e-4)


@pytest.mark.parametrize("asked", [["--accuracy", "1e-3"], ["--budget", "2"]])
def test_accuracy_fails_if_an_engine_cannot_run(
    asked: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "ramp.yaml"
    # A root has no Taylor series at zero.
    path.write_text(
        "kind: chart\nname: ramp\nvariables: {x: 0}\nstop: {time: 3}\n"
        "regions: {r: {initial: on, states: {on: {flows: {x: sqrt(time)}}}}}\n"
    )
    assert main(["run", str(path), "--engine", "taylor", "--json", *asked]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["outcome"] == "UNSUPPORTED"
    assert report["error_estimate"] is None
    assert report["asked"]["reached"] is False
    assert report["asked"]["cost"]["runs"] == 1


def test_an_exceeded_budget_gives_a_warning() -> None:
    once, clock = slow(Runner("toppling_stick"), lambda tolerance: 1.0)
    reported = run_within_budget(once, 0.5, floor=1e-13, clock=clock).warnings
    assert reported[0].startswith("the budget of 0.5 s allowed one run, of 1 s, ")
    late = run_within_budget(once, 0.5, spent=0.75, floor=1e-13, clock=clock).warnings
    assert "one run, of 1.8 s" in late[0]
    once, clock = slow(Runner("toppling_stick"), lambda tolerance: 1.0)
    kept = run_within_budget(once, 2.9, floor=1e-13, clock=clock).warnings
    assert not any("budget" in warning for warning in kept)
    assert (len(reported), len(late)) == (1, 1)


@pytest.mark.parametrize("accuracy", [1e-3, 1e-10])
def test_taylor_starts_at_its_least_tolerance_and_one_perturbed_run_estimates_its_error(
    accuracy: float,
) -> None:
    result = run("hopper", accuracy=accuracy)
    assert result.trace.engine == "taylor"
    assert result.asked is not None
    assert result.asked.cost.runs == 2
    assert result.error_estimate is not None
    assert 1e-15 < result.error_estimate < 1e-10


def test_run_from_zero_estimates_its_error() -> None:
    # A force grows from zero: the start has no error.
    text = """\
kind: scene
name: pushed
bodies: {b: {mass: 3}}
forces: {f: {body: b, force: ["sin(time)*exp(time/3)", 0]}}
stop: {time: 20}
outputs: {x: {value: b.x}}
"""
    result = run(read_text(text), accuracy=1e-9)
    assert result.asked is not None
    assert result.asked.cost.runs == 2
    assert result.error_estimate is not None
    assert 1e-15 < result.error_estimate < 1e-9
    # x'' = sin(t) exp(t/3)/3
    a, t = complex(1 / 3, 1.0), 20.0
    exact = ((np.exp(a * t) - 1 - a * t) / a**2).imag / 3
    assert result.outputs["x"] == pytest.approx(exact, rel=1e-12)


def test_a_chart_that_rests_is_compared_by_its_events() -> None:
    result = run("bouncing_ball_chart", accuracy=1e-6)
    assert result.asked is not None
    assert result.asked.cost.runs == 2


def test_the_second_run_is_far_tighter_if_events_are_counted() -> None:
    runner = Runner("newtons_cradle", engine="scipy", accuracy=1e-6)
    tolerances: list[float] = []
    once = runner._planner._once

    def watched(setting: Setting, *args: Any, **options: Any) -> tuple[Observer, Trace]:
        assert setting.tolerance is not None
        tolerances.append(setting.tolerance)
        return once(setting, *args, **options)

    runner._planner._once = watched  # type: ignore[method-assign]
    result = runner.run()
    assert tolerances[:2] == pytest.approx([1e-7, 1e-7 / 400])
    assert result.trace.tolerance == pytest.approx(1e-7 / 400)
    assert result.outputs["clicks"] == run("newtons_cradle").outputs["clicks"]


def test_a_budget_that_ends_before_the_first_arc_tries_no_other_engine() -> None:
    result = run("compass_walker", budget=0.001, throw=False)
    assert result.trace.engine == "taylor"
    assert result.trace.outcome is Outcome.OUT_OF_BUDGET
    assert not result.trace.arcs


def test_lists_over_several_zeno_sequences_are_compared_sequence_by_sequence() -> None:
    # The ball comes to rest twice; how many bounces are resolved depends on the tolerance.
    start = {"A": 0.4076152515461017, "k": 11.329716503700658, "phase": 1.2333697043981378}
    start |= {"y0": 2.9924753207313244, "vx0": -4.108552571098766, "vy0": -1.4587951966373836}
    start |= {"e": 0.1585520579127728}
    tight, loose = (
        EvaluatedRun.of(result.observer, result.trace)
        for result in (
            run("bouncing_ball_hills", parameters=start, engine="taylor", tolerance=tolerance)
            for tolerance in (2.2e-16, 1e-9)
        )
    )
    assert len(tight.outputs["impact_times"]) > len(loose.outputs["impact_times"])
    assert [len(one.truncated["impact_times"]) for one in (tight, loose)] == [2, 2]
    assert tight.difference(loose, tight.scales).largest <= 1e-8
