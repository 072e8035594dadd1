"""A tolerance that was measured to suffice is run as it is, and its error is the measured one."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
from studies import OSCILLATOR, scipy, traded

from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.engines.request import Chosen
from statechart.observation.difference import compare
from statechart.running.accuracy import replay
from statechart.running.result import Result
from statechart.running.runner import Runner, run
from statechart.study.study import Study, save

MODEL = OSCILLATOR.replace("time: 50", "time: 20")


@pytest.fixture(scope="module")
def measured() -> Study:
    return traded(Runner(read_text(MODEL)), settings=scipy("DOP853", *range(3, 13)))


def error(result: Result) -> float:
    exact = run(read_text(MODEL))
    return compare(exact.trace, result.trace, exact.outputs, result.outputs).largest


@pytest.mark.parametrize("accuracy", [1e-3, 1e-5, 1e-7, 1e-9])
def test_measured_run_is_replayed(measured: Study, accuracy: float) -> None:
    result = run(read_text(MODEL), accuracy=accuracy, study=measured)
    asked = result.asked
    assert asked is not None
    assert asked.decides.startswith(("output ", "the final state", "the times", "the path"))
    assert asked.cost.runs == 1
    assert asked.basis == f"measured: scipy DOP853 {result.trace.tolerance:g}, with the same result"
    assert result.error_estimate is not None
    assert error(result) <= result.error_estimate <= accuracy
    # A run that is 20 times looser was not measured to do.
    looser = [p for p in measured.points if p.setting.fineness > 19.0 * result.trace.tolerance]
    assert all((measured.error(p) or 1.0) > 0.01 * accuracy for p in looser)
    without = run(read_text(MODEL), accuracy=accuracy, method="DOP853").asked
    assert without is not None
    assert without.cost.runs > 1
    assert without.cost.evaluations > 2 * asked.cost.evaluations


def test_a_runner_gives_the_measured_run_time_after_time(measured: Study) -> None:
    runner = Runner(read_text(MODEL), accuracy=1e-7, study=measured)
    for _ in range(3):
        asked = runner.run().asked
        assert asked is not None
        assert asked.cost.runs == 1


@pytest.mark.parametrize("change", [{"until": 19.0}, {"parameters": {"k": 1.1}}])
def test_a_run_that_was_not_measured_is_estimated(change: Mapping[str, object]) -> None:
    text = MODEL.replace("variables:", "parameters: {k: 1}\nvariables:").replace(
        "v: -x,", "v: -k*x,"
    )
    study = traded(Runner(read_text(text)), settings=scipy("DOP853", 6, 8, 10))
    same = run(read_text(text), accuracy=1e-6, study=study).asked
    other = run(read_text(text), accuracy=1e-6, study=study, **change).asked  # type: ignore[arg-type]
    assert same is not None
    assert other is not None
    assert same.cost.runs == 1 < other.cost.runs
    assert other.basis.startswith("guessed")


def test_deviating_replay_is_estimated(measured: Study) -> None:
    points = [p.model_copy(update={"steps": p.steps + 1}) for p in measured.points]
    other = measured.model_copy(update={"points": tuple(points)})
    result = run(read_text(MODEL), accuracy=1e-6, study=other)
    assert result.asked is not None
    assert result.asked.basis.endswith(", which gives another result here")
    assert result.asked.cost.runs > 1
    assert result.error_estimate is not None
    assert error(result) <= result.error_estimate <= 1e-6


@pytest.mark.parametrize("what", ["outcome", "flows", "steps", "evaluations"])
def test_any_different_count_identifies_another_run(measured: Study, what: str) -> None:
    runner = Runner(read_text(MODEL), engine="scipy", method="DOP853", tolerance=1e-6)
    result = runner.run()
    counts = result.trace.counts
    chosen = Chosen(
        runner.setting, 1e-7, "HORIZON", counts["steps"], counts["evaluations"],
        len(result.trace.arcs),
    )  # fmt: skip

    def once(tolerance: float, off: bool) -> tuple[object, object]:
        return result.observer, result.trace

    same = replay(once, chosen)  # type: ignore[arg-type]
    assert same is not None
    assert same.error == 1e-7
    other = "STOPPED" if what == "outcome" else getattr(chosen, what) + 1
    assert replay(once, replace(chosen, **{what: other})) is None  # type: ignore[arg-type]


def test_the_command_line_reports_the_measured_run(
    tmp_path: Path, measured: Study, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("swing.yaml").write_text(MODEL)
    save("out", measured)
    assert main(["run", "swing.yaml", "--accuracy", "1e-5", "--output", "out", "--json"]) == 0
    asked = json.loads(capsys.readouterr().out)["asked"]
    assert asked["basis"].endswith("with the same result")
    assert asked["cost"]["runs"] == 1
    assert asked["reached"]
