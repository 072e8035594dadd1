"""Runs from Python: settings, engines, accuracy, errors at their place."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import SOUND, shipped

import models
from statechart.charts.chart import Chart
from statechart.documents.setting import Setting
from statechart.documents.yaml_reader import read_text
from statechart.engines.engine import Path as Steps
from statechart.engines.request import choose
from statechart.errors import DeclarationError, SimulationError, StepFailure, Unsupported
from statechart.loading.load import load
from statechart.observation.difference import compare
from statechart.observation.outputs import extremes
from statechart.running.runner import Runner, run

BALL = """\
kind: chart
name: ball
parameters: {g: 1, k: 1/2}
variables: {x: 1/2, v: 0}
regions:
  ball:
    initial: flight
    states: {flight: {flows: {x: v, v: -g}}, rest: {}}
    transitions:
      - {name: bounce, from: flight, to: flight, guard: x <= 0, updates: {x: 0, v: -k*v}}
      - {name: settle, from: flight, to: rest, on: zeno, updates: {x: 0, v: 0}}
stop: {time: 5}
outputs: {t_rest: {value: time, at: first settle}}
"""


def ball(*changes: tuple[str, str]) -> str:
    text = BALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return text


def test_auto_takes_taylor_if_heyoka_is_installed_and_warns_otherwise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("statechart.engines.request._has_heyoka", lambda: False)
    engine, reason = choose(Setting())
    assert (engine.name, engine.method, engine.tolerance) == ("scipy", "DOP853", 1e-12)
    assert "heyoka" in reason
    with pytest.raises(DeclarationError, match="heyoka"):
        choose(Setting("taylor"))
    result = run(read_text(BALL))
    assert result.trace.engine == "scipy DOP853"
    assert "heyoka" in result.warnings[0]


def test_a_method_asks_for_the_engine_that_has_methods() -> None:
    assert choose(Setting(method="Radau"))[0].method == "Radau"
    with pytest.raises(DeclarationError, match="no method 'Euler'"):
        choose(Setting(method="Euler"))
    with pytest.raises(DeclarationError, match="taylor has no method"):
        choose(Setting("taylor", "RK45"))
    with pytest.raises(DeclarationError, match=r"no engine 'magic'; known: .*impulse"):
        choose(Setting("magic"))


def test_arguments_override_the_settings_of_the_document() -> None:
    text = BALL + "settings: {engine: scipy, method: RK45, tolerance: 1e-8}\n"
    declared = Runner(read_text(text)).run().trace
    assert (declared.engine, declared.tolerance) == ("scipy RK45", 1e-8)
    other = Runner(read_text(text), method="LSODA", tolerance=1e-9).run().trace
    assert (other.engine, other.tolerance) == ("scipy LSODA", 1e-9)
    result = Runner(read_text(text), accuracy=1e-6).run()
    assert result.error_estimate is not None
    assert result.error_estimate <= 1e-6


def test_a_run_without_accuracy_has_no_error_estimate() -> None:
    assert run(read_text(BALL)).error_estimate is None


@pytest.mark.parametrize("name", SOUND)
def test_the_requested_accuracy_is_estimated_and_reached(name: str) -> None:
    exact = shipped(name)
    rough = run(name, accuracy=1e-5, engine="scipy")
    assert rough.error_estimate is not None
    assert rough.error_estimate <= 1e-5
    found = compare(exact.trace, rough.trace, exact.outputs, rough.outputs, endless=exact.endless)
    assert found.diverged is None
    assert found.largest <= 1e-5
    assert rough.asked is not None
    assert set(rough.asked.not_judged) == exact.endless


def test_an_unreachable_accuracy_reports_the_reached_one() -> None:
    result = run("toppling_stick", accuracy=1e-16, engine="scipy")
    assert result.error_estimate is not None
    assert 1e-16 < result.error_estimate < 1e-8
    assert any("was not reached" in warning for warning in result.warnings)


def test_runs_of_different_modes_have_no_accuracy() -> None:
    result = run("toppling_stick")
    trace = result.trace
    other = replace(trace, jumps=(trace.jumps[0], *trace.jumps[2:]))
    found = compare(trace, other, result.outputs, result.outputs)
    assert found.largest == math.inf
    assert found.diverged == trace.jumps[1].t
    ended = replace(trace, jumps=trace.jumps[:1])
    assert compare(trace, ended, result.outputs, result.outputs).diverged == trace.jumps[1].t


def test_the_difference_of_runs_is_relative_to_each_quantity() -> None:
    result = run("bouncing_ball_hills", until=0.2)
    trace = result.trace
    shifted = replace(trace, final=trace.final * np.array([1.0, 1.0 + 1e-6, 1.0, 1.0]))
    error = compare(trace, shifted, {}, {}).largest
    # The largest value on the way counts, not those at the ends.
    largest = extremes(result.observer, trace, trace.variables[1])
    size = max(map(abs, largest))
    assert error == pytest.approx(1e-6 * abs(trace.final[1]) / size, rel=2e-2)
    assert compare(trace, trace, {"a": 1.0}, {"a": 1.5}).largest == pytest.approx(1 / 3)
    assert compare(trace, trace, {"a": 3}, {"a": 4}).largest == 0.25
    assert compare(trace, trace, {"a": 3}, {"a": 4}, endless=["a"]).largest == 0.0
    assert compare(trace, trace, {"a": [1.0]}, {"a": [1.0, 2.0]}).largest == 0.5
    assert compare(trace, trace, {"a": None}, {"a": 1.0}).largest == math.inf
    assert compare(trace, trace, {"a": 1.0}, {"a": math.nan}).largest == math.inf


def test_a_flow_without_a_taylor_series_falls_back_to_scipy_with_a_reason() -> None:
    text = ball(("v: -g", "v: -g - sqrt(v**2)"))
    result = run(read_text(text))
    assert result.trace.engine.startswith("scipy")
    assert any("sqrt(v**2) has no Taylor" in warning for warning in result.warnings)
    with pytest.raises(Unsupported, match=r"sqrt\(v\*\*2\)"):
        run(read_text(text), engine="taylor")


def test_one_runner_serves_many_runs() -> None:
    runner = Runner(read_text(BALL))
    for k in (0.25, 0.5, 0.6):
        outputs = runner.run({"k": k}).outputs
        assert outputs["t_rest"] == pytest.approx(1 + 2 * k / (1 - k), rel=1e-12)


def test_a_model_made_in_python_runs_like_its_file() -> None:
    model = load("bouncing_ball_chart")
    assert isinstance(model, Chart)
    one, other = run(model), run("bouncing_ball_chart")
    assert one.outputs == other.outputs
    assert (one.trace.final == other.trace.final).all()


def test_the_end_is_an_argument_or_declared() -> None:
    assert run(read_text(BALL), until=0.5).trace.t_end == 0.5
    assert run(read_text(BALL), until=0.0).trace.t_end == 0.0
    assert run(read_text(ball(("time: 5", "time: 3*k")))).trace.t_end == 1.5
    assert run(read_text(ball(("time: 5", "time: 3*k"))), parameters={"k": 0.1}).trace.t_end == (
        pytest.approx(0.3)
    )
    without = read_text(ball(("stop: {time: 5}\n", "")), "a.yaml")
    with pytest.raises(DeclarationError, match="the run has no end"):
        run(without)
    for end in (-1.0, math.inf, math.nan):
        with pytest.raises(DeclarationError, match="finite time"):
            run(read_text(BALL), until=end)


def test_an_endless_declared_end_is_refused_at_its_place() -> None:
    with pytest.raises(DeclarationError, match="finite") as caught:
        run(read_text(ball(("time: 5", "time: inf")), "a.yaml"))
    assert (caught.value.source, caught.value.line) == ("a.yaml", 12)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [({"q": 1.0}, "no parameter 'q'"), ({"k": math.nan}, "must be a number")],
)
def test_wrong_overrides_are_refused(overrides: dict[str, float], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        run(read_text(BALL), parameters=overrides)


def test_an_unphysical_override_is_refused_where_it_is_used() -> None:
    with pytest.raises(DeclarationError, match=r"friction: must be .* .with mu = -1.") as caught:
        run("toppling_stick", parameters={"mu": -1.0})
    path = models.path("toppling_stick")
    assert path is not None
    assert caught.value.source == str(path)
    assert caught.value.line is not None
    line = path.read_text(encoding="utf-8").splitlines()[caught.value.line - 1]
    assert line.strip() == "friction: mu"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"tolerance": 0.0}, "tolerance must be above 0"),
        ({"accuracy": 2.0}, "accuracy must be above 0"),
        ({"accuracy": 1e-3, "tolerance": 1e-3}, "exclude each other"),
    ],
)
def test_settings_out_of_their_bounds_are_refused(settings: dict[str, float], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        Runner(read_text(BALL), **settings)  # type: ignore[arg-type]


def test_a_run_that_cannot_go_on_raises_with_its_trace_or_returns_it() -> None:
    text = ball(("v: -g}", "v: v**3}"), ("v: 0}", "v: 1}"))
    result = run(read_text(text), throw=False)
    assert not result.trace.outcome.succeeded
    assert result.trace.t_end == pytest.approx(0.5, rel=1e-10)
    with pytest.raises(SimulationError) as caught:
        run(read_text(text))
    assert caught.value.outcome == result.trace.outcome.name
    assert caught.value.trace is not None


def test_a_run_with_too_many_jumps_keeps_its_trace() -> None:
    text = BALL + "settings: {max_jumps: 3}\n"
    result = run(read_text(text), throw=False)
    assert result.trace.outcome.name == "TOO_MANY_JUMPS"
    assert len(result.trace.jumps) == 3
    assert result.trace.t_end == pytest.approx(1.0 + 2 * (0.5 + 0.25))
    with pytest.raises(SimulationError, match="3 jumps"):
        run(read_text(text))


def test_an_interrupted_run_returns_its_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    runner = Runner("bouncing_ball_chart")
    laws = type(runner.automaton.laws)
    jump, calls = laws.jump, []

    def interrupting(self: object, *arguments: object) -> object:
        calls.append(1)
        if len(calls) == 8:
            raise KeyboardInterrupt
        return jump(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(laws, "jump", interrupting)
    result = runner.run()
    assert result.trace.outcome.name == "INTERRUPTED"
    assert result.trace.jumps


def test_the_start_is_checked_without_running() -> None:
    mode, warnings = Runner("toppling_stick").start()
    assert (mode, warnings) == (("pin",), ())
    _, warnings = Runner("toppling_stick").start({"I_G": 1e-15})
    assert "point mass" in warnings[0]


def test_a_result_saves_its_run(tmp_path: Path) -> None:
    result = run(read_text(BALL))
    names = result.save(tmp_path / "out", samples=False)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(names)
    assert "run.json" in names
    assert "samples.csv" not in names
    with pytest.warns(DeprecationWarning, match="samples=True"):
        assert "samples.csv" in result.save(tmp_path / "out")


def test_a_result_does_not_make_a_folder_with_the_name_of_a_file(tmp_path: Path) -> None:
    result = run(read_text(BALL))
    with pytest.raises(DeclarationError, match=r"several files, in a folder; write .*out$"):
        result.save(tmp_path / "out.txt", samples=False)
    assert not any(tmp_path.iterdir())
    (tmp_path / "old.txt").mkdir()
    assert "run.json" in result.save(tmp_path / "old.txt", samples=False)


def test_steps_that_fill_the_memory_are_an_outcome() -> None:
    path = Steps()
    path.reserve(10, 3, 4)
    with pytest.raises(StepFailure, match="fill the memory"):
        path.reserve(10**15, 3, 20)
    path.append(0.5, np.ones((3, 4)))
    assert path.arc()[0].tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    "choice",
    [
        {"engine": "taylor"},
        {"engine": "taylor", "method": "long double"},
        {"engine": "scipy", "method": "DOP853"},
        {"engine": "scipy", "method": "RK45"},
        {"engine": "scipy", "method": "Radau"},
        {"engine": "scipy", "method": "LSODA"},
    ],
    ids=lambda choice: choice.get("method", "taylor"),
)
def test_no_step_is_longer_than_the_longest(choice: dict[str, str]) -> None:
    plain = run("toppling_stick", tolerance=1e-6, **choice)  # type: ignore[arg-type]
    found = run("toppling_stick", tolerance=1e-6, max_step=0.02, **choice)  # type: ignore[arg-type]
    steps = [np.diff(arc.times).max() for arc in found.trace.arcs]
    assert max(steps) <= 0.02 * (1 + 1e-12)
    assert max(np.diff(arc.times).max() for arc in plain.trace.arcs) > 0.02
    assert found.outputs["t_impact"] == pytest.approx(plain.outputs["t_impact"], rel=1e-3)


def test_a_call_overrides_the_longest_step_of_the_file() -> None:
    model = load("toppling_stick")
    settings = model.settings.model_copy(update={"max_step": 0.05})
    model = model.model_copy(update={"settings": settings})
    assert Runner(model).setting.max_step == 0.05
    assert Runner(model, max_step=0.01).setting.max_step == 0.01


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"engine": "impulse", "step": 1e-3, "max_step": 0.1}, "has no max_step"),
        ({"max_step": 0.0}, "must be a positive time"),
    ],
)
def test_a_maximal_step_without_effect_is_refused(asked: dict[str, Any], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        Runner("toppling_stick", **asked)
