"""`run --explain`: the fired guard, margins and rejected candidates of every jump."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from runs import SOUND, run

import statechart
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.reporting.text import explain_events, explained
from statechart.running.runner import Runner
from statechart.tabular import write_plain

BAR = """\
kind: scene
name: bar
gravity: 9.81
bodies: {bar: {mass: 1, inertia: 1/3, start: {y: 1, angle: 0.1}}}
surfaces: {floor: {height: 0}}
contacts:
  A: {point: {body: bar, at: [-1, 0]}, surface: floor, friction: 0.3, restitution: 0}
  B: {point: {body: bar, at: [1, 0]}, surface: floor, friction: 0.3, restitution: 0}
stop: {time: 0.45, conditions: {low: bar.y <= 0.05}}
"""


def explanation(report: dict[str, Any]) -> str:
    return write_plain(explain_events(report))


def test_margins_of_an_event_belong_to_the_mode_before_it() -> None:
    events = Runner("toppling_stick").run().to_dict(explain=True)["events"]
    slip, reverse, stop = events
    assert slip["fired"] == ["tip.mu V - H"]
    assert set(slip["margins"]) == {
        "tip.V", "tip.mu V - H", "tip.mu V + H", "fallen", "fallen backward",
    }  # fmt: skip
    assert slip["margins"]["tip.mu V - H"] == pytest.approx(0.0, abs=1e-11)
    assert slip["margins"]["tip.mu V + H"] > 0.1
    assert set(reverse["margins"]) == {"tip.V", "tip.slip", "fallen", "fallen backward"}
    assert stop["fired"] == ["fallen"]
    assert stop["margins"]["fallen"] == pytest.approx(0.0, abs=1e-12)


CHAIN = """\
kind: chart
name: chain
variables: {x: 0}
regions:
  one:
    initial: on
    states: {on: {flows: {x: 1}}, off: {}}
    transitions: [{name: go, from: on, to: off, guard: x >= 1}]
  two:
    initial: waits
    states: {waits: {}, done: {}}
    transitions: [{name: hears, from: waits, to: done, on: one.go}]
  three:
    initial: waits
    states: {waits: {}, done: {}}
    transitions: [{name: hears, from: waits, to: done, on: two.done, guard: x >= 0}]
stop: {time: 2}
"""


def test_a_transition_that_waits_for_an_event_is_fired_by_it(tmp_path: Path) -> None:
    file = tmp_path / "chain.yaml"
    file.write_text(CHAIN, encoding="utf-8")
    events = Runner(file).run().to_dict(explain=True)["events"]
    reasons = [dict(explained(event, None)[1])["fired"] for event in events]
    assert reasons == [[("one.go",)], [("on one.go",)], [("on two.done if x >= 0",)]]
    leaves = [e for e in Runner("raibert_hopper").run(until=1).to_dict()["events"]
              if e["cause"] == "leave"]  # fmt: skip
    assert dict(explained(leaves[0], None)[1])["fired"] == [("on sole.liftoff",)]


def test_margins_agree_with_the_observer() -> None:
    result = Runner("toppling_stick").run()
    events = result.to_dict(explain=True)["events"]
    values = result.observer.at(result.trace, ["tip.V"], result.trace.jumps, before=True)[:, 0]
    shown = [event["margins"].get("tip.V") for event in events]
    assert shown[:2] == pytest.approx(values[:2], rel=1e-12)  # a pin, and a backward slide


def test_without_explain_no_margins_are_evaluated() -> None:
    events = Runner("toppling_stick").run().to_dict()["events"]
    assert all("margins" not in event for event in events)


def test_events_of_charts_and_captured_regions_have_margins() -> None:
    events = Runner("bouncing_ball_chart").run().to_dict(explain=True)["events"]
    assert events[0]["margins"] == {"ball.bounce": pytest.approx(0.0, abs=1e-12)}
    assert events[-1]["cause"] == "settle"
    ball = Runner("bouncing_ball").run().to_dict(explain=True)["events"]
    assert all(event["margins"] for event in ball)
    json.dumps(ball, allow_nan=False)


def test_explanation_covers_all_data_of_a_jump() -> None:
    report = Runner(read_text(BAR)).run().to_dict(explain=True)
    said = explanation(report)
    first, last = said.split("\n\n")
    assert first.splitlines()[0].endswith("jump 0: A touchdown; A: free -> slide+")
    for words in ("fired       A.gap", "margins     A.gap", "B.gap", "impulse     A  normal"):
        assert words in first
    for event in report["events"]:
        for verdict in event["considered"].values():
            assert verdict in said
    # The state of B is the same in all candidates, and omitted.
    assert "  A:slide+  taken" in first
    assert last.splitlines()[1] == "  fired    low"


def test_the_first_and_the_last_of_many_events_are_explained() -> None:
    report = Runner("bouncing_ball").run().to_dict(explain=True)
    said = explanation(report)
    events = report["events"]
    assert len(events) > 40
    assert f"... {len(events) - 40} more" in said
    assert said.count("\nt = ") + said.startswith("t = ") == 40


def test_the_command_line_and_saved_runs_explain_jumps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bar.yaml").write_text(BAR, encoding="utf-8")
    assert main(["run", "bar.yaml", "--explain"]) == 0
    said = capsys.readouterr().out
    assert "considered  A:free" in said
    assert main(["run", "bar.yaml"]) == 0
    assert "considered" not in capsys.readouterr().out
    assert main(["run", "bar.yaml", "--json", "--explain"]) == 0
    explained = json.loads(capsys.readouterr().out)
    assert all(event["margins"] for event in explained["events"])
    assert main(["run", "bar.yaml", "--json"]) == 0
    assert "margins" not in json.loads(capsys.readouterr().out)["events"][0]
    assert main(["run", "bar.yaml", "--output", "saved"]) == 0
    saved = json.loads(Path("saved/run.json").read_text(encoding="utf-8"))
    assert explanation(saved) == explanation(explained)
    assert explanation(saved) in said


def test_a_run_without_events_has_no_explanations() -> None:
    runner = Runner(read_text(BAR.replace("time: 0.45", "time: 0.1")))
    assert explanation(runner.run().to_dict(explain=True)) == ""


@pytest.mark.parametrize("name", SOUND)
def test_every_jump_names_its_mode_and_the_reasons_against_others(name: str) -> None:
    trace = run(name, "taylor", until=3.0)
    for jump in trace.jumps:
        if jump.cause == "stop":
            continue
        reasons = [*jump.considered.values()]
        assert sum(reason.startswith("taken") for reason in reasons) >= 1, jump
        assert all(reasons)


def test_a_jam_explains_the_rejected_modes_and_the_mode_after_the_impact() -> None:
    jump = run("painleve_rod", "taylor", until=0.1).jumps[0]
    assert jump.cause == "jam"
    assert "before the impact tip: V = -" in jump.considered["tip:slide+"]
    assert jump.considered["tip:free"].startswith("taken: it leaves its surface at")
    assert "before the impact tip: it would accelerate" in jump.considered["tip:free"]


def test_a_pin_that_cannot_hold_is_advised_to_list_slide(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", "no_slip_pencil"]) == 1
    shown = capsys.readouterr()
    assert "Add slide, with a friction, to the modes of tip" in shown.out
    assert "(McGeer's paradox)" in shown.out


def test_a_body_without_inertia_that_lifts_off_is_advised_to_have_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    fast = ["--set", "gamma=0.2", "--set", "omega0=2.5"]
    assert main(["run", "rimless_wheel", *fast]) == 1
    advice = (
        "No mass or inertia moves with wheel.angle while no contact holds it: add it to its body"
    )
    assert advice in capsys.readouterr().out


def test_candidates_with_the_same_reason_are_one_line() -> None:
    report = statechart.run("double_contact_bar").to_dict()
    *_, landing = report["events"]
    assert len(landing["considered"]) == 16
    lines = explanation({**report, "events": [landing]}).splitlines()
    of_candidates = lines[next(k for k, line in enumerate(lines) if "considered" in line) :]
    assert len(of_candidates) == 6
    assert "A: it would accelerate at -1 into the surface; 3 more alike" in of_candidates[0]
    assert of_candidates[-1].split() == ["A:pin", "B:pin", "taken"]
