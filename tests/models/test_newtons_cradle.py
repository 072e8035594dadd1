"""Newton's cradle by every law for simultaneous impacts."""

from __future__ import annotations

import functools
import itertools
import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from runs import ENGINES, engine, outputs, run

from contacts.kind import automaton
from contacts.scene.parts import Simultaneous
from contacts.scene.scene import Scene
from statechart.cli.main import main
from statechart.execution.simulator import Simulator
from statechart.loading.load import load
from statechart.testing.agreement import Undecidable, assert_same
from statechart.testing.properties import assert_engines_agree
from statechart.testing.subject import Subject

MODEL = "newtons_cradle"
SPEED = 2.0 * math.sqrt(9.81) * math.sin(0.15)  # of the first ball when it arrives
RATES = slice(5, 10)


@functools.cache
def simulator(choice: Simultaneous, name: str) -> Simulator:
    scene = load(MODEL)
    assert isinstance(scene, Scene)
    return Simulator(automaton(scene.model_copy(update={"simultaneous": choice})), engine(name))


def one_by_one(e: float) -> list[float]:
    """Return the rates after the first blow: pairs that approach collide, the fastest first."""
    v = [SPEED, 0.0, 0.0, 0.0, 0.0]
    for _ in range(10_000):
        approach = [a - b for a, b in itertools.pairwise(v)]
        k = int(np.argmax(approach))
        if approach[k] <= 1e-13:
            return v
        mean, half = (v[k] + v[k + 1]) / 2.0, e * approach[k] / 2.0
        v[k], v[k + 1] = mean - half, mean + half
    raise AssertionError("the sequence does not end")


def at_once(e: float) -> list[float]:
    """Return the rates by Newton's law for all pairs: the plastic impulse times 1 + e."""
    return [SPEED * ((i == 0) + (1 + e) * (0.2 - (i == 0))) for i in range(5)]


@pytest.mark.parametrize("name", ENGINES)
def test_impact_passes_through_the_cradle_and_back(name: str) -> None:
    trace = run(MODEL, name, until=4.0)
    assert trace.certified
    found = outputs(MODEL, name, trace)
    assert [(jump.region, jump.cause) for jump in trace.jumps] == [
        ("c12", "touchdown"), ("c45", "touchdown"), ("c12", "touchdown"), ("c45", "touchdown"),
    ]  # fmt: skip
    assert found["rate_last"] == pytest.approx([SPEED, 0.0, SPEED, 0.0], abs=1e-11)
    assert found["rate_first"] == pytest.approx([0.0, -SPEED, 0.0, -SPEED], abs=1e-11)
    # A quarter of a period to the first impact, half of one to each other.
    quarter = found["times"][0]
    assert found["times"] == pytest.approx([quarter * n for n in (1, 3, 5, 7)], abs=1e-11)


@pytest.mark.parametrize("name", ENGINES)
def test_balls_that_touch_without_load_stay_closed_however_their_forces_round(name: str) -> None:
    trace = run(MODEL, name, until=4.0)
    closed = ("slide",) * 3
    assert [jump.target for jump in trace.jumps] == [(*closed, "free"), ("free", *closed)] * 2
    assert max(abs(jump.after[place]) for jump in trace.jumps for place in (1, 2, 3)) < 1e-12


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("e", [0.3, 0.6, 0.9, 0.99])
@pytest.mark.parametrize(
    ("choice", "rates"),
    [
        ("plastic", lambda e: at_once(0.0)),
        ("capped", at_once),
        ("sequential", one_by_one),
    ],
)
def test_rates_after_the_first_blow_follow_each_law(
    choice: Simultaneous, rates: Callable[[float], list[float]], e: float, name: str
) -> None:
    trace = simulator(choice, name).run({"e": e}, until=0.6)
    after = trace.jumps[0].after[RATES]
    assert after == pytest.approx(rates(e), abs=1e-11)
    assert after.sum() == pytest.approx(SPEED, abs=1e-11)
    assert (np.diff(after) >= -1e-13).all()
    # Outcome: balls that move off together stay closed.
    together = tuple("slide" if step < 1e-12 else "free" for step in np.diff(after))
    assert trace.jumps[0].target == together


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("e", [0.9999, 0.99999, 0.999999])
def test_contacts_that_hardly_open_pass_the_blow_on(e: float, name: str) -> None:
    trace = run(MODEL, name, until=1.0, e=e)
    assert trace.jumps[0].after[RATES] == pytest.approx(one_by_one(e), abs=1e-10)
    assert trace.jumps[0].skipped == 0.0


@functools.cache
def subject() -> Subject:
    return Subject(load(MODEL))


def test_separation_within_tolerance_is_undecidable() -> None:
    case = subject().case({"e": 0.99999})
    first, other = case.sound
    parting = float(np.diff(first.jumps[0].after[RATES])[0])
    assert first.tolerances["speed"] < parting < other.tolerances["speed"]
    assert first.jumps[0].target != other.jumps[0].target
    with pytest.raises(Undecidable, match="with the tolerances of the other engine"):
        assert_engines_agree(case)
    # Without those tolerances it would be another course; in time two of them graze each other.
    until = first.jumps[3].t
    first, other = (
        observer.simulator.run({"e": 0.99999}, until=until)
        for observer in subject().observers.values()
    )
    with pytest.raises(AssertionError, match="event 1"):
        assert_same(first, other, case.sensitivity, loosened=lambda: first)


@pytest.mark.parametrize("e", [0.992, 0.993])
def test_slow_meetings_are_within_the_step_error(e: float) -> None:
    case = subject().case({"e": e})
    first, other = case.sound
    assert abs(first.jumps[6].t - other.jumps[6].t) > 1e-8  # at a speed of 3e-7
    # Not there, but where impacts of one instant are two of it.
    with pytest.raises(Undecidable, match=r"event 19 .* one in one of the runs"):
        assert_engines_agree(case)


def test_without_rebound_one_after_another_they_move_on_together() -> None:
    trace = run(MODEL, "taylor", until=0.6, e=0.0)
    assert trace.jumps[0].after[RATES] == pytest.approx(at_once(0.0), abs=1e-11)
    assert any("the sequence of impacts does not end" in warning for warning in trace.warnings)


def test_alternatives_report_different_runs_of_other_laws(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["run", MODEL, "--json", "--alternatives", "--until", "0.6"]) == 0
    rows = {row["choice"]: row for row in json.loads(capsys.readouterr().out)["alternatives"]}
    assert set(rows) == {"simultaneous: plastic", "simultaneous: capped"}
    for choice, e in (("plastic", 0.0), ("capped", 1.0)):
        row = rows[f"simultaneous: {choice}"]
        assert not row["same_modes"]
        assert row["diverged"] == pytest.approx(0.504352333753, abs=1e-11)
        assert row["outputs"]["rate_last"] == pytest.approx([at_once(e)[4]], abs=1e-11)
