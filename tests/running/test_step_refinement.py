"""Requested accuracies by time steps are reached, or the failure is reported."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path

import pytest

from statechart.automaton.trace import Outcome, Trace
from statechart.cli.main import main
from statechart.documents.yaml_reader import read_text
from statechart.errors import DeclarationError, SimulationError
from statechart.observation.difference import mode_disagreement
from statechart.observation.observer import Observer
from statechart.running.accuracy import SHORTER, refine
from statechart.running.result import Result
from statechart.running.runner import Runner, run

BLOCK = """\
kind: scene
name: sliding_block
parameters: {mu: 0.5, v0: 3}
gravity: 9.81
bodies: {block: {mass: 1, start: {dx: v0}}}
surfaces: {floor: {height: 0}}
contacts: {base: {point: {body: block}, surface: floor, modes: [slide, pin], friction: mu}}
stop: {time: 2}
outputs:
  t_stop: {value: time, at: first base.stick}
  distance: {value: block.x}
"""
BALL = """\
kind: scene
name: ball
parameters: {h: 1, e: 0.5}
gravity: 9.81
bodies: {ball: {mass: 1, start: {y: h, dx: 0.3}}}
surfaces: {floor: {height: 0}}
contacts:
  c: {point: {body: ball}, surface: floor, restitution: e, friction: 0, modes: [free, slide]}
stop: {time: 2}
outputs:
  t_hit: {value: time, at: first c.touchdown}
  t_rest: {value: time, at: last c.touchdown}
  bounces: {count: c.touchdown}
  x: {value: ball.x}
"""
PENDULUM = """\
kind: scene
name: pendulum
parameters: {L: 0.5}
gravity: 9.81
bodies: {rod: {mass: 1, inertia: L**2/3, start: {x: L}}}
joints: {pivot: {point: {body: rod, at: [-L, 0]}, to: [0, 0]}}
stop: {time: 2}
outputs: {fastest: {minimum: rod.dangle}}
"""
POST = """\
kind: scene
name: post
gravity: 0
bodies: {b: {mass: 1, start: {x: -0.013, y: 1, dx: 50}}}
surfaces: {post: {height: "1.3*exp(-((x-1)/0.005)**2)"}}
contacts: {c: {point: {body: b}, surface: post, friction: 0.3, restitution: 0.5}}
stop: {time: 0.03}
"""


def reached(result: Result) -> bool:
    return result.asked is not None and result.asked.reached(result.error_estimate)


def off(result: Result, name: str, exact: float) -> float:
    return abs(float(result.outputs[name]) - exact) / abs(exact)  # type: ignore[arg-type]


@pytest.mark.parametrize("accuracy", [1e-2, 1e-3, 1e-4])
def test_a_block_stops_where_the_closed_form_says(accuracy: float) -> None:
    result = run(read_text(BLOCK), engine="impulse", accuracy=accuracy)
    assert reached(result)
    assert result.error_estimate is not None
    # Error of a time, relative to the end of the run.
    assert off(result, "t_stop", 3.0 / (0.5 * 9.81)) * 0.31 <= result.error_estimate
    assert off(result, "distance", 9.0 / (2 * 0.5 * 9.81)) <= result.error_estimate


@pytest.mark.parametrize("e", [0.0, 0.5, 0.8])
def test_a_ball_lands_and_rests_when_the_closed_form_says(e: float) -> None:
    result = run(read_text(BALL), parameters={"e": e}, engine="impulse", accuracy=1e-3)
    assert reached(result)
    fall = math.sqrt(2.0 / 9.81)
    bouncing = fall * (1.0 + e) / (1.0 - e)
    assert abs(float(result.outputs["t_hit"]) - fall) <= 2e-3  # type: ignore[arg-type]
    if bouncing < 2.0:
        assert off(result, "t_rest", bouncing) <= 1e-3
        # The number of bounces is not judged, except without bounces.
        expected = ("bounces",) if e > 0.0 else ()
        assert result.asked is not None
        assert result.asked.not_judged == expected


def test_a_pendulum_is_as_fast_as_its_energy_says() -> None:
    result = run(read_text(PENDULUM), engine="impulse", accuracy=1e-4)
    assert reached(result)
    assert off(result, "fastest", -math.sqrt(2.0 * 9.81 * 0.5 / (4.0 / 3.0 * 0.25))) <= 1e-4


def test_a_stick_topples_as_by_its_events() -> None:
    result = run("toppling_stick", engine="impulse", accuracy=1e-4)
    exact = run("toppling_stick", engine="auto").outputs
    assert reached(result)
    for name, value in exact.items():
        assert off(result, name, float(value)) <= 1e-4  # type: ignore[arg-type]


def test_step_refinement_halves_the_step_until_the_estimate_is_below() -> None:
    text = read_text(BLOCK)
    runner = Runner(text, engine="impulse", step=0.01)
    steps: list[float] = []

    def once(step: float) -> tuple[Observer, Trace]:
        steps.append(step)
        result = Runner(text, engine="impulse", step=step).run()
        return result.observer, result.trace

    answer = refine(once, 1e-3, first=0.01, end=2.0)
    assert steps == pytest.approx([0.01 * SHORTER**k for k in range(len(steps))])
    assert answer.cost.runs == len(steps) > 4
    assert answer.trace.step == steps[-1]
    assert answer.error is not None
    assert 1e-4 < answer.error <= 1e-3
    again = Runner(text, engine="impulse", step=0.01, accuracy=1e-3).run()
    assert again.trace.step == answer.trace.step
    assert runner.run().error_estimate is None


def test_accuracy_reduces_a_step_that_tunnels() -> None:
    result = run(read_text(POST), engine="impulse", step=5e-3, accuracy=0.05)
    assert reached(result)
    assert result.trace.final[0] < 1.0
    assert result.trace.outcome is Outcome.HORIZON


def test_bodies_start_from_the_step_of_their_own() -> None:
    text = """\
kind: scene
name: discs
gravity: 0
bodies:
  a: {mass: 1, inertia: 1, shape: {disc: 0.1}, start: {x: 0, y: 0}}
  b: {mass: 1, inertia: 1, shape: {disc: 0.1}, start: {x: -1.03, y: 0.1, dx: 5}}
collisions: {all: {bodies: [a, b], friction: 0, restitution: 0.5}}
stop: {time: 1}
outputs: {vx: {value: b.dx}}
"""
    result = run(read_text(text), accuracy=1e-2)
    assert reached(result)
    assert "at most" in result.warnings[0]
    # They meet at a distance of 0.1 from the centre line: along the normal, 0.75 of it is lost.
    assert off(result, "vx", 5.0 * (1.0 - 0.75 * 0.75)) <= 1e-2


def test_runs_that_do_not_converge_end_with_exit_code_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    # The last digits of a distance, which no step settles.
    scene = tmp_path / "noise.yaml"
    scene.write_text(BLOCK.replace("{value: block.x}", "{value: sin(1e12*block.x)}"))
    arguments = ["run", str(scene), "--engine", "impulse", "--step", "0.05"]
    code = main([*arguments, "--accuracy", "1e-3", "--json"])
    said = capsys.readouterr()
    report = json.loads(said.out)
    assert code == 1
    assert not report["asked"]["reached"]
    assert "the accuracy 0.001 was not reached" in said.err
    assert "reduce the difference. Runs at two steps differ most in output distance (" in said.err


def test_the_error_of_a_force_that_falls_to_zero_is_relative_to_the_scale_of_forces() -> None:
    # The run ends where the tip lifts off, so that the least force is zero.
    result = run("no_slip_pencil", engine="impulse", accuracy=1e-3, throw=False)
    assert result.asked is not None
    assert result.asked.reached(result.error_estimate)
    assert 0.0 <= result.outputs["V_min"] <= 1e-3


def test_the_command_line_reports_the_request(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "toppling_stick", "--engine", "impulse", "--accuracy", "1e-3"]
    assert main([*arguments, "--step", "2e-3", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    asked = report["asked"]
    assert (asked["accuracy"], asked["reached"], asked["basis"]) == (1e-3, True, "as given")
    assert report["error_estimate"] <= 1e-3
    assert report["step"] == pytest.approx(2e-3 * SHORTER ** (asked["cost"]["runs"] - 1))
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "estimated relative error" in said
    assert "first step a thousandth of the run" in said


def test_a_step_in_the_call_overrides_the_accuracy_of_the_file() -> None:
    model = read_text(BLOCK + "settings: {engine: impulse, accuracy: 1e-3}\n")
    assert reached(Runner(model).run())
    single = Runner(model, step=1e-3).run()
    assert single.asked is None
    assert single.trace.step == 1e-3


@pytest.mark.parametrize("name", ["budget", "tolerance"])
def test_step_refinement_takes_neither_budget_nor_tolerance(name: str) -> None:
    with pytest.raises(DeclarationError, match=f"the engine impulse has no {name}"):
        Runner(read_text(BLOCK), engine="impulse", **{name: 0.5})  # type: ignore[arg-type]


def test_an_interrupted_search_ends_with_the_run_at_hand() -> None:
    runner = Runner(read_text(BLOCK), engine="impulse", step=0.01)

    def once(step: float) -> tuple[Observer, Trace]:
        result = runner.run()
        ended = Outcome.INTERRUPTED if step < 0.006 else Outcome.HORIZON
        return result.observer, replace(result.trace, step=step, outcome=ended)

    answer = refine(once, 1e-9, first=0.01, end=2.0)
    assert answer.trace.outcome is Outcome.INTERRUPTED
    assert answer.error == math.inf
    assert answer.warnings == ("interrupted before its error was estimated",)


def test_a_step_that_never_does_ends_with_its_reason() -> None:
    runner = Runner(read_text(BLOCK), engine="impulse", step=0.01)

    def once(step: float) -> tuple[Observer, Trace]:
        result = runner.run()
        return result.observer, replace(
            result.trace, step=step, outcome=Outcome.STEP_TOO_LARGE, message="never"
        )

    answer = refine(once, 1e-3, first=0.01, end=2.0)
    assert answer.error is None
    assert answer.cost.runs < 50


def test_a_pickled_result_keeps_its_step() -> None:
    result = run(read_text(BLOCK), engine="impulse", accuracy=1e-3)
    there = pickle.loads(pickle.dumps(result))
    assert there.outputs == result.outputs
    assert there.to_dict()["asked"] == result.to_dict()["asked"]


def test_a_run_that_cannot_start_raises() -> None:
    text = BLOCK.replace("mu: 0.5", "mu: nan_")
    with pytest.raises((DeclarationError, SimulationError)):
        run(read_text(text), engine="impulse", accuracy=1e-3)


def test_modes_are_apart_for_as_long_as_they_differ() -> None:
    runs = [run(read_text(BLOCK), engine="impulse", step=step).trace for step in (0.1, 0.01)]
    times = [trace.jumps[0].t for trace in runs]
    assert mode_disagreement(*runs) == pytest.approx(abs(times[0] - times[1]) / 2.0, rel=1e-12)
    assert mode_disagreement(runs[0], runs[0]) == 0.0


def test_a_block_that_never_moves_is_as_accurate_as_can_be() -> None:
    text = BLOCK.replace("{dx: v0}", "{x: 0}").replace(
        "\nstop:", '\nforces: {f: {body: block, force: ["2.4*sin(0.84*time)", 0]}}\nstop:'
    )
    result = run(read_text(text), engine="impulse", accuracy=1e-6)
    assert reached(result)
    assert abs(float(result.outputs["distance"])) < 1e-15  # type: ignore[arg-type]
