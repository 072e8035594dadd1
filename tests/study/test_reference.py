"""Reference runs: two that agree, a third where they do not, and the report of it."""

from __future__ import annotations

import pytest
from studies import OSCILLATOR, billiard, cold, study, ticking, traded

from statechart.automaton.trace import Trace
from statechart.documents.setting import Setting
from statechart.documents.yaml_reader import read_text
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.runner import Runner
from statechart.study.measurements import Errors, Third
from statechart.study.reference import References, Run
from statechart.study.study import Study
from statechart.study.text import to_dict
from statechart.study.trade import Bench

# Free flight; the thrust begins where a step from the start cannot detect it.
THRUST = """\
kind: scene
name: thrust
gravity: 9.81
bodies: {b: {mass: 1, start: {y: 100, dx: 3}}}
surfaces: {floor: {height: 0}}
contacts: {c: {point: {body: b}, surface: floor, friction: 0.3, restitution: 0.5}}
forces: {burn: {body: b, force: [0, "10*(1+tanh((time-2)/0.1))/2"]}}
stop: {time: 4}
outputs: {vy: {value: b.dy}, x_end: {value: b.x}}
"""

# It just reaches the top, or does not: rounding decides at which swing.
EDGE = """\
kind: chart
name: edge
variables: {x: 0, v: 1}
regions:
  hill:
    initial: climb
    states: {climb: {flows: {x: v, v: -x}}, over: {flows: {x: 1, v: 0}}}
    transitions:
      - {name: top, from: climb, to: over, guard: x >= TOP}
stop: {time: 40}
"""


def lying(monkeypatch: pytest.MonkeyPatch, wrong: str, automaton: object) -> None:
    """Replace the runs of an engine or method by runs of another automaton."""
    honest = Bench.once

    def once(bench: Bench, observer: Observer) -> Trace:
        engine = observer.simulator.engine  # type: ignore[union-attr]
        if wrong not in (engine.name, engine.method):
            return honest(bench, observer)
        setting = Setting(engine.name, engine.method, engine.tolerance)
        return honest(bench, Observers(automaton).at(setting))  # type: ignore[arg-type]

    monkeypatch.setattr(Bench, "once", once)


def referred(runner: Runner) -> Study:
    bench = Bench(runner.model, runner.automaton, runner.end(), 1, ticking(), cold)
    return bench.reference("mark")[1]


@pytest.mark.parametrize(
    ("wrong", "pair", "odd"),
    [
        ("long double", ("scipy DOP853 2.3e-14", "scipy LSODA 1e-13"), "taylor long double"),
        ("DOP853", ("taylor long double 1.1e-19", "scipy LSODA 1e-13"), "scipy DOP853 2.3e-14"),
    ],
)
def test_outlier_of_three_runs_is_ignored(
    wrong: str, pair: tuple[str, str], odd: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner = Runner(read_text(THRUST))
    still = Runner(read_text(THRUST.replace("10*(1+", "0*(1+")))
    lying(monkeypatch, wrong, still.automaton)
    found = referred(runner)
    assert (found.reference, found.check) == pair
    assert found.parted is None
    assert found.least < 1e-10
    third = found.third
    assert third is not None
    assert third.odd
    assert third.setting.startswith(odd)
    assert third.parted == pytest.approx(2.0, abs=0.2)
    assert third.errors.named["vy"] > 0.1 > third.errors.named["x_end"]
    said = str(found)
    assert f"{third.setting} disagrees with both" in said
    assert "vy by 0.51" in said
    assert "x_end" not in said
    assert "chaotic" not in said
    assert to_dict(found)["third"]["odd"] is True


def test_the_two_agreeing_runs_of_three_are_the_reference(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    still = Runner(read_text(THRUST.replace("10*(1+", "0*(1+")))
    lying(monkeypatch, "long double", still.automaton)
    settings = [Setting(engine="scipy", method="RK45", tolerance=1e-9)]
    found = traded(Runner(read_text(THRUST)), settings=settings)
    error = found.error(found.points[0])
    assert error is not None
    assert error < 1e-7


def test_two_references_that_agree_need_no_third() -> None:
    found = referred(Runner(read_text(OSCILLATOR)))
    assert found.third is None
    assert "odd one" not in str(found)


def test_three_diverging_runs_are_chaotic() -> None:
    found = referred(Runner(read_text(billiard(40.0))))
    assert found.third is not None
    assert not found.third.odd
    assert found.parted is not None
    assert found.third.parted is not None
    assert 1.0 < found.third.parted <= found.parted < 40.0
    said = str(found)
    assert f"and {found.third.setting} the nearer of them at t = " in said
    assert "chaotic, or at a bifurcation" in said


def test_two_of_three_runs_do_not_decide_an_unstable_start() -> None:
    # With two possible motions, two of three runs always agree.
    found = referred(Runner(read_text(EDGE.replace("TOP", str(1 - 1e-15)))))
    third = found.third
    assert third is not None
    assert not third.odd
    assert third.edge == pytest.approx(1.57, abs=0.01)
    assert found.parted == third.parted is not None
    said = str(found)
    assert "leaves itself at t = 1.57" in said
    assert "where its start is off by 3e-12: chaotic, or at a bifurcation" in said
    # A little below the edge every run reaches the top at once.
    assert referred(Runner(read_text(EDGE.replace("TOP", "0.999")))).third is None


def test_a_perturbed_start_moves_times_and_outputs_more_than_the_state() -> None:
    # At a rate of 1e-3 the event is late by a thousand times the shift; the end of the run is 2.
    slow = (
        "kind: chart\nname: slow\nvariables: {x: 1}\nstop: {time: 2}\n"
        "regions:\n  r:\n    initial: s\n    states: {s: {flows: {x: 1e-3}}, t: {}}\n"
        "    transitions: [{name: there, from: s, to: t, guard: x >= 1.001, updates: {x: 5}}]\n"
    )
    runner = Runner(read_text(slow))
    observer = runner.observers.at(Setting("taylor"))

    def run(one: Observer) -> Trace:
        return one.simulator.run(until=2.0)

    references = References(runner.model, runner.automaton, 2.0, run)
    reference = Run.of(observer, run(observer), Setting("taylor"))
    assert references._perturbed(reference, 1e-9).size == pytest.approx(5e-7, rel=1e-3)


def test_three_different_runs_limit_the_resolution() -> None:
    third = Third(
        setting="scipy LSODA 1e-13", parted=None, errors=Errors(state=2e-7), odd=False,
        shift=3e-12, edge=None,
    )  # fmt: skip
    found = study(resolution=Errors(state=2e-7), third=third)
    assert "differ by 2e-07, as scipy LSODA 1e-13 from them" in str(found)


def test_a_check_that_warns_of_another_law_is_not_called_chaotic() -> None:
    found = study(
        parted=0.5,
        check="impulse step 1e-4",
        step=1e-4,
        warnings={"taylor 2.2e-16": ("a",), "impulse step 1e-4": ("a", "another law applies")},
    )
    said = str(found)
    assert "impulse step 1e-4 warns: another law applies" in said
    assert "chaotic" not in said


def test_a_missing_third_engine_is_reported() -> None:
    said = str(study(parted=0.5, check="impulse step 3e-4", step=3e-4))
    assert "t = 0.5 on, and no run of another method shows which is right: chaotic, or" in said
    assert "or their steps are too long" in said
