"""Speed against accuracy: studies, slopes, files, and their use."""

from __future__ import annotations

import json
import math
import re
from base64 import b64decode
from collections.abc import Callable
from pathlib import Path

import pytest
from studies import OSCILLATOR, billiard, cold, point, scipy, study, ticking, traded

from statechart.cli.main import main
from statechart.documents.setting import Setting
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, StatechartError
from statechart.observation.difference import distance
from statechart.running.runner import Runner
from statechart.study.figure import figure, write_study_figure
from statechart.study.measurements import Errors, Point, fingerprint
from statechart.study.slopes import slopes
from statechart.study.study import Study, load, save
from statechart.study.text import to_dict
from statechart.study.trade import plan, trade


@pytest.mark.parametrize("model", ["oscillator", "toppling_stick"])
def test_slopes_are_those_of_theory(model: str) -> None:
    runner = Runner(read_text(OSCILLATOR) if model == "oscillator" else model)
    # At 1e-3 the step of an event of DOP853 is repeated: its error is a third.
    settings = [*scipy("RK45", *range(3, 12)), *scipy("DOP853", *range(4, 14))]
    found = traded(runner, settings=settings)
    assert found.complete
    fits = {(slope.family, slope.of): slope for slope in slopes(found)}
    assert set(fits) == {(m, of) for m in ("RK45", "DOP853") for of in ("error", "steps")}
    for slope in fits.values():
        assert slope.points >= (5 if slope.of == "error" else 3)
        assert slope.slope == pytest.approx(slope.theory, rel=0.15)
    assert "steps of RK45: the tolerance to the power -0." in str(found)
    # The figure lists them apart from its marks, which a number beside a line would hide.
    _, _, promises, steps = (drawn := figure(found)).axes
    drawn.canvas.draw()
    for ax, of in ((promises, "error"), (steps, "steps")):
        written = {text.get_text() for text in ax.get_legend().get_texts()}
        assert written == {f"slope {slope.slope:.2f}" for slope in fits.values() if slope.of == of}
        box = ax.get_legend().get_window_extent()
        marks = [line.get_xydata() for line in ax.lines if line.get_marker() != "None"]
        assert not any(box.contains(*ax.transData.transform(xy)) for line in marks for xy in line)


@pytest.mark.parametrize(
    ("model", "part"),
    [("stick_slip_block", 0.3), ("two_balls", 1.0), ("hopper", 0.3), ("bouncing_ball", 1.0)],
)
def test_the_error_of_time_stepping_falls_with_the_step(model: str, part: float) -> None:
    # The ball's bounces accumulate: its modes are never those of the reference, its path is.
    runner = Runner(model)
    steps = [Setting(engine="impulse", step=runner.end() * 1e-3 * 0.5**k) for k in range(7)]
    found = traded(runner, settings=steps, until=part * runner.end())
    assert found.points[-1].same_modes is (model != "bouncing_ball")
    (slope,) = slopes(found)
    assert slope.points >= 5
    assert slope.slope == pytest.approx(slope.theory, rel=0.15)


def test_many_body_trade_varies_step_and_impulse_tolerance(tmp_path: Path) -> None:
    runner = Runner("dice")
    planned = plan(runner.automaton, 0.1)
    assert {setting.engine for setting in planned} == {"impulse"}
    grid = {(setting.step, setting.impulse_tolerance) for setting in planned}
    steps, tolerances = ({pair[k] for pair in grid} for k in (0, 1))
    assert len(planned) == len(grid) == len(steps) * len(tolerances)
    assert min(len(steps), len(tolerances)) >= 4
    assert plan(Runner("bouncing_ball").automaton, 0.1)[-4].impulse_tolerance is None
    settings = [
        Setting(engine="impulse", step=1e-3, impulse_tolerance=tolerance)
        for tolerance in (0.5, 1e-8)
    ]
    # Impulses of up to eight contacts are exact to round-off at any tolerance.
    column = Runner("granular_column")
    found = traded(column, settings=settings, until=0.1, folder=tmp_path)
    assert found.reference.startswith("impulse to 1e-10 step ")
    # The reference is checked along both axes.
    assert found.check.startswith("impulse to 1e-08 step ")
    assert found.check.split("step ")[1] != found.reference.split("step ")[1]
    assert [point.setting for point in found.points] == settings
    assert found.points == load(tmp_path).points
    assert "impulse to 1e-08 step 0.001" in str(found)
    assert repr(found) == str(found)
    shown = found._repr_html_()
    assert b"<svg" in b64decode(re.search(r"base64,([^\"]*)", shown)[1])
    assert "impulse to 1e-08 step 0.001" in shown
    write_study_figure(tmp_path, found)
    assert "1e-08" in (tmp_path / "trade.csv").read_text()
    loose, tight = (point.errors for point in found.points)
    assert loose.energy != tight.energy
    assert loose.violations.keys() == {"overlap", "impulse", "inexact"}
    assert 0.5 > loose.violations["impulse"] > 1e-8 > tight.violations["impulse"] > 0.0
    assert 0.0 < tight.violations["overlap"] < 1e-2
    assert loose.violations["inexact"] == 0.0


def test_trade_reports_the_worst_error_of_nearby_steps() -> None:
    runner = Runner("block_on_incline")
    reported = trade(
        runner,
        settings=[Setting(engine="impulse", step=0.01)],
        repeats=1,
        clock=ticking(),
        cold=cold,
    ).points[0]
    exact = runner.run().outputs["t_stop"]
    assert isinstance(exact, float)

    def error(step: float) -> float:
        found = Runner("block_on_incline", engine="impulse", step=step).run().outputs["t_stop"]
        assert isinstance(found, float)
        return abs(found - exact) / max(found, exact)

    errors = [error(0.01 * part) for part in (1.0, 0.983, 0.967, 0.951)]
    assert max(errors) > 1.5 * errors[0] > 0.0
    assert reported.errors.outputs == pytest.approx(max(errors), rel=1e-9)
    assert reported.steps == 300


def test_distance_is_the_largest_along_the_runs() -> None:
    chart = """\
kind: chart
name: ramp
parameters: {late: 0}
variables: {x: 0}
regions:
  r:
    initial: still
    states: {still: {flows: {x: 0}}, up: {flows: {x: 0}}}
    transitions:
      - {name: step, from: still, to: up, guard: time >= 1 + late, updates: {x: 3}}
stop: {time: 4}
"""
    runner = Runner(read_text(chart))
    first = runner.run().trace
    for late in (1e-7, 0.25):
        other = runner.run(parameters={"late": late}).trace
        # x differs by all of its size, as long as the event is late.
        assert distance(first, other) == pytest.approx(late / 4, rel=1e-6)
        assert distance(other, first) == pytest.approx(late / 4, rel=1e-6)
    assert distance(first, first) == 0.0


def test_the_pareto_front_has_the_undominated_points() -> None:
    slow, good, bad = point(1e-6, 1e-6, 2.0), point(1e-5, 1e-7, 1.0), point(1e-3, 1e-3, 0.5)
    other = point(1e-4, 1e-12, 0.1, same_modes=False, diverged=0.5)
    assert study(slow, good, bad, other).front() == (bad, good)


def test_a_study_ends_with_the_cheapest_setting_for_an_accuracy() -> None:
    fine = point(1e-8, 1e-7, 2.0)
    other = fine.model_copy(update={"setting": Setting(engine="taylor", tolerance=1e-6)})
    cheap = other.model_copy(update={"seconds": 0.5})
    last = str(study(fine, cheap)).splitlines()[-1]
    assert last == (
        "for an accuracy of 1e-06 use --engine taylor --tolerance 1e-06: 500 ms a run, "
        "4 times cheaper than scipy RK45 1e-08"
    )
    equal = other.model_copy(update={"seconds": 1.9})
    assert str(study(fine, equal)).splitlines()[-1].endswith(" a run, as fast as scipy RK45 1e-08")
    assert "for an accuracy of 0.001 use --engine scipy --method RK45 --tolerance 0.001" in (
        str(study(point(1e-3, 5e-4, 1.0)))
    )
    assert "for an accuracy" not in str(study(point(1e-3, 0.5, 1.0)))


def test_missed_accuracies_and_other_modes_are_counted() -> None:
    kept, missed = point(1e-3, 1e-4, 1.0), point(1e-6, 1e-5, 1.0)
    other = point(1e-7, 1e-9, 1.0, same_modes=False, diverged=0.5)
    unresolved = point(1e-14, 1e-15, 1.0)
    refused = point(1e-8, 1.0, 1.0, refused="the accuracy was not reached")
    found = study(kept, missed, other, unresolved, refused)
    assert [found.meets_tolerance(p) for p in found.points] == [True, False, False, None, None]
    assert found.missed() == {"RK45": (2, 3)}
    # Digits below the resolution of the reference do not count.
    assert found.error(unresolved) == 1e-13


def test_the_cheapest_setting_that_reached_an_accuracy_is_chosen() -> None:
    points = (
        point(1e-3, 1e-4, 0.1),
        point(1e-6, 1e-7, 0.4),
        point(1e-7, 1e-8, 0.3),
        point(1e-9, 1e-9, 0.2, same_modes=False),
    )
    found = study(*points)

    def chosen(**asked: object) -> Setting | None:
        chosen = found.choose(Setting(**asked), once=False)  # type: ignore[arg-type]
        return None if chosen is None else chosen.setting

    assert chosen(accuracy=1e-5) == points[2].setting
    assert chosen(accuracy=1e-3) == points[0].setting
    assert chosen(accuracy=1e-12) is None
    assert chosen(accuracy=1e-3, engine="taylor") is None
    assert chosen(accuracy=1e-3, method="RK45") == points[0].setting
    assert chosen(budget=0.7) == points[2].setting
    assert chosen(budget=0.01) is None


def test_the_error_of_the_reference_counts_with_each_error() -> None:
    found = study(point(1e-6, 1.0e-7, 0.1), resolution=Errors(state=5e-8))
    assert found.choose(Setting(accuracy=1.2e-7), once=False) is None
    chosen = found.choose(Setting(accuracy=2e-7), once=False)
    assert chosen is not None
    assert chosen.error == pytest.approx(1.5e-7)


def test_a_chaotic_motion_has_no_errors_but_a_time_at_which_runs_part(tmp_path: Path) -> None:
    runner = Runner(read_text(billiard(40.0)))
    settings = [*scipy("DOP853", 4, 12), Setting(engine="auto", accuracy=1e-6)]
    found = traded(runner, settings=settings)
    assert found.parted is not None
    assert 1.0 < found.parted < 40.0
    for p in found.points:
        assert found.error(p) is None
        assert found.meets_tolerance(p) is None
    coarse, fine, refused = found.points
    # Flights in straight lines are right to the last digit at every tolerance; their rounding is
    # magnified all the same.
    for p in (coarse, fine):
        assert p.parted is not None
        assert 1.0 < p.parted < 40.0
    assert "starts that differ by the tolerance" in refused.refused
    assert "leaves it at" in str(found)
    assert found.front() == ()
    write_study_figure(tmp_path, found)
    shown = to_dict(found)
    assert shown["points"][0]["error"] is None
    json.dumps(shown, allow_nan=False)


def test_motion_has_an_accuracy_before_divergence() -> None:
    found = trade(
        Runner(read_text(billiard(2.0))),
        settings=scipy("DOP853", 8),
        repeats=1,
        clock=ticking(),
        cold=cold,
    )
    assert found.parted is None
    assert found.error(found.points[0]) is not None


def test_interrupted_study_resumes(tmp_path: Path) -> None:
    settings = scipy("DOP853", 4, 6, 8)
    seen: list[int] = []

    def interrupting(line: str) -> None:
        done = load(tmp_path)
        seen.append(0 if done is None else len(done.points))
        if len(seen) == 3:
            raise KeyboardInterrupt

    def run(progress: Callable[[str], None]) -> Study:
        return traded(
            Runner(read_text(OSCILLATOR)), folder=tmp_path, settings=settings, progress=progress,
        )  # fmt: skip

    with pytest.raises(KeyboardInterrupt):
        run(interrupting)
    assert seen == [0, 1, 2]
    before = load(tmp_path)
    assert before is not None
    assert not before.complete
    lines: list[str] = []
    after = run(lines.append)
    assert after.complete
    assert after.points[:2] == before.points
    assert [line for line in lines if "1e-08" in line] == lines[1:]
    assert load(tmp_path) == after


def test_a_folder_with_the_study_of_another_model_is_refused(tmp_path: Path) -> None:
    save(tmp_path, study(point(1e-3, 1e-4, 1.0)))
    with pytest.raises(DeclarationError, match="another model"):
        trade(Runner(read_text(OSCILLATOR)), folder=tmp_path, settings=scipy("RK45", 3))


@pytest.mark.parametrize("content", [b"", b"{}", b"[1]", b"\xff\xfe", b'{"format": "other"}'])
def test_a_file_that_is_no_study_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "trade.json").write_bytes(content)
    with pytest.raises(DeclarationError, match="is not a study"):
        load(tmp_path)


def test_infinite_values_round_trip(tmp_path: Path) -> None:
    kept = study(point(1e-3, math.inf, 1.0))
    save(tmp_path, kept)
    assert load(tmp_path) == kept
    assert kept.error(kept.points[0]) is None
    assert load(tmp_path / "nothing") is None


def test_keys_without_effect_on_motion_keep_the_fingerprint() -> None:
    one = Runner(read_text(OSCILLATOR)).model
    same = Runner(read_text(OSCILLATOR + "doc: words\nsettings: {engine: scipy}\n")).model
    other = Runner(read_text(OSCILLATOR.replace("x: 2", "x: 2.5"))).model
    assert fingerprint(one) == fingerprint(same) != fingerprint(other)


def test_a_model_that_no_engine_completes_has_no_reference() -> None:
    blows_up = OSCILLATOR.replace("v: -x,", "v: x**3,")
    with pytest.raises(StatechartError, match="no reference"):
        trade(Runner(read_text(blows_up)), settings=scipy("RK45", 3))


def test_a_flow_without_a_taylor_series_is_studied_without_it() -> None:
    text = OSCILLATOR.replace("v: -x,", "v: -x - sqrt(v**2)/10,").replace("time: 50", "time: 5")
    settings = [Setting(engine="taylor", tolerance=1e-6), *scipy("DOP853", 6)]
    found = traded(Runner(read_text(text)), settings=settings)
    assert found.reference == "scipy DOP853 2.3e-14"
    assert found.check == "scipy LSODA 1e-13"
    assert list(found.left_out) == ["taylor 1e-06"]
    assert found.complete


def test_the_plan_has_every_engine_and_time_stepping_for_scenes_only() -> None:
    chart = plan(Runner(read_text(OSCILLATOR)).automaton, 1.0)
    scene = plan(Runner("bouncing_ball").automaton, 2.0)
    families = {setting.family for setting in chart}
    assert families == {"taylor", "RK45", "DOP853", "Radau", "LSODA", "accuracy"}
    assert {setting.family for setting in scene} == families | {"impulse"}
    assert max(s.step for s in scene if s.step is not None) == pytest.approx(0.02)


def test_different_modes_are_marked(tmp_path: Path) -> None:
    found = study(point(1e-3, 1e-2, 1.0, same_modes=False, diverged=0.25), point(1e-6, 1e-6, 2.0))
    assert "others from t = 0.25" in str(found)
    labels = [t.get_text() for t in figure(found).legends[0].get_texts()]
    assert "RK45, other modes" in labels
    write_study_figure(tmp_path, found)
    rows = (tmp_path / "trade.csv").read_text().splitlines()
    assert len(rows) == 3
    assert {p.name for p in tmp_path.iterdir()} == {"trade.svg", "trade.png", "trade.csv"}


def test_the_command_measures_and_a_run_uses_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("ball.yaml").write_text(OSCILLATOR.replace("time: 50", "time: 20"))
    monkeypatch.setattr("statechart.study.trade.plan", lambda *_: tuple(scipy("DOP853", 4, 6, 8)))
    assert main(["trade", "ball.yaml", "-o", "out", "--json"]) == 0
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert report["complete"]
    assert len(report["points"]) == 3
    assert "(3 of 3)" in said.err
    assert {p.name for p in Path("out").iterdir()} == {
        "trade.json", "trade.csv", "trade.svg", "trade.png",
    }  # fmt: skip
    assert main(["trade", "ball.yaml", "-o", "out"]) == 0
    said_again = capsys.readouterr().out
    assert "reference: taylor " in said_again
    assert ", checked by scipy DOP853 2.3e-14\n" in said_again
    arguments = ["run", "ball.yaml", "--accuracy", "1e-5", "--output", "out", "--json"]
    assert main(arguments) == 0
    asked = json.loads(capsys.readouterr().out)["asked"]
    assert asked["basis"].startswith("measured: scipy DOP853")
    assert asked["reached"]
    Path("ball.yaml").write_text(OSCILLATOR.replace("time: 50", "time: 10"))
    assert main(arguments) == 0
    asked = json.loads(capsys.readouterr().out)["asked"]
    assert asked["basis"] == "guessed: the study is of another model or version"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["trade", "no_such_model"], "no_such_model"),
        (["trade", "toppling_stick", "-o", "file"], "file is a file"),
        (["run", "toppling_stick", "--budget", "0"], "budget"),
        (["run", "toppling_stick", "--budget", "inf"], "budget"),
        (["run", "toppling_stick", "--budget", "1", "--accuracy", "1e-3"], "not allowed with"),
        (
            ["run", "toppling_stick", "--budget", "1", "--engine", "impulse", "--step", "1e-3"],
            "impulse has no budget",
        ),
    ],
)
def test_wrong_input_is_refused(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    assert main(arguments) == 2
    assert words in capsys.readouterr().err


def test_no_slope_is_fitted_where_the_tolerance_does_not_decide_the_steps() -> None:
    flights = [point(10.0**-p, 10.0**-p, 1.0, steps=20 + p) for p in range(3, 10)]
    smooth = [point(10.0**-p, 10.0**-p, 1.0, steps=round(5 * 1.6**p)) for p in range(3, 10)]
    found = study(*flights)
    assert slopes(found) == ()
    assert "hardly decides" in str(found)
    assert {slope.of for slope in slopes(study(*smooth))} == {"error", "steps"}


def stepped(step: float, state: float, **named: float) -> Point:
    return point(
        1e-3,
        state,
        1.0,
        setting=Setting(engine="impulse", step=step),
        steps=round(1.0 / step),
        errors=Errors(state=state, times=0.0, outputs=max(named.values()), named=named),
    )


def test_non_converging_outputs_are_named_and_excluded() -> None:
    steps = [10.0**-k for k in range(2, 6)]
    found = study(*(stepped(h, h, V_max=0.02 + 0.1 * h, x=0.5 * h) for h in steps))
    assert found.unsettled() == {"V_max": pytest.approx(0.020001)}
    assert [found.error(p) for p in found.points] == pytest.approx(steps)
    assert "do not converge with the step, no part of the errors above" in str(found)
    assert "(at the shortest step): V_max (0.02)" in str(found)
    assert list(to_dict(found)["unsettled"]) == ["V_max"]
    (slope,) = slopes(found)
    assert slope.slope == pytest.approx(1.0)
    # For a run with events it is right, or its error counts.
    errors = Errors(state=1e-9, outputs=1e-4, named={"V_max": 1e-4})
    event_based = point(1e-6, 0.0, 1.0, errors=errors)
    assert study(*found.points, event_based).error(event_based) == 1e-4
    # Effects below round-off from three steps on are not reported.
    settled = study(*(stepped(h, h, V_max=1e-13, x=0.5 * h) for h in steps))
    assert settled.unsettled() == {}


def test_a_folder_that_cannot_be_written_is_refused_before_the_reference(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")

    def reported(line: str) -> None:
        raise AssertionError(line)

    with pytest.raises(DeclarationError, match="file is a file; name another folder"):
        trade("toppling_stick", folder=tmp_path / "file" / "new", progress=reported)
