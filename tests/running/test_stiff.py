"""Stiff models under the engine auto, against published values and closed forms."""

from __future__ import annotations

import math

import pytest

from statechart.automaton.trace import Outcome
from statechart.documents.yaml_reader import read_text
from statechart.loading.load import interpret
from statechart.running.result import Result
from statechart.running.runner import Runner

ROBERTSON = """\
kind: chart
name: robertson
variables: {a: 1, b: 0, c: 0}
regions:
  r:
    initial: on
    states:
      on:
        flows:
          a: -0.04*a + 1e4*b*c
          b: 0.04*a - 1e4*b*c - 3e7*b**2
          c: 3e7*b**2
stop: {time: 1e11}
"""


def run(text: str, **setting: object) -> Result:
    runner = Runner(interpret(read_text(text, "f.yaml")), **setting)  # type: ignore[arg-type]
    return runner.run(throw=False)


def test_robertsons_problem_runs_to_its_published_end() -> None:
    # Hairer and Wanner, Solving Ordinary Differential Equations II, test set ROBER.
    found = run(ROBERTSON)
    assert found.trace.outcome is Outcome.HORIZON
    assert found.trace.engine == "scipy Radau"
    assert found.trace.final == pytest.approx(
        [0.2083340149701255e-07, 0.8333360770334713e-13, 0.9999999791665050], rel=1e-7
    )
    (reason,) = found.warnings
    assert reason.startswith("engine scipy Radau: ")
    assert "the model is stiff: its steps collapse to 0.0036 at t = 14.9" in reason


def test_a_requested_engine_also_runs_a_stiff_model() -> None:
    found = run(ROBERTSON, engine="taylor")
    assert found.trace.outcome is Outcome.TOO_LONG
    assert found.trace.engine == "taylor"


# Steps as short, but of an oscillation, which no method follows in longer ones.
FAST = """\
kind: chart
name: fast
parameters: {w: 1e4}
variables: {x: 1, v: 0, y: 1}
regions: {r: {initial: on, states: {on: {flows: {x: w*v, v: -w*x, y: -y}}}}}
stop: {time: 1e6}
"""


def test_a_fast_oscillation_is_not_stiff() -> None:
    runner = Runner(interpret(read_text(FAST, "f.yaml")))
    found = runner.run(until=2.0)
    assert found.trace.engine == "taylor"
    assert found.trace.final == pytest.approx(
        [math.cos(2e4), -math.sin(2e4), math.exp(-2.0)], abs=1e-10
    )


HALF = ROBERTSON.replace(
    "stop:",
    """\
      late: {}
    transitions: [{name: half, from: on, to: late, guard: c >= 0.5}]
outputs: {half: {value: time, at: first r.half}}
stop:""",
)


def test_events_of_stiff_models_are_those_of_taylors_method() -> None:
    # 130453 steps of Taylor's method lead to the event, which are too many for the whole run only.
    found, exact = run(HALF), run(HALF.replace("1e11", "1e6"), engine="taylor")
    assert (found.trace.engine, exact.trace.engine) == ("scipy Radau", "taylor")
    assert found.trace.outcome is Outcome.HORIZON
    assert found.outputs["half"] == pytest.approx(exact.outputs["half"], rel=1e-10)
