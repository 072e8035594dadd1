"""Cost of the first run of a process, measured in fresh processes."""

from __future__ import annotations

import os
import re
import signal
import sys
from contextlib import closing

import pytest
from studies import OSCILLATOR, point, study, traded

from statechart.documents.setting import Setting
from statechart.documents.yaml_reader import read_text
from statechart.engines.request import Chosen
from statechart.running.runner import Runner
from statechart.study.figure import figure
from statechart.study.startup_cost import FreshProcess
from statechart.study.text import to_dict

RK45 = Setting(engine="scipy", method="RK45", tolerance=1e-6)


def setting(chosen: Chosen | None) -> Setting | None:
    return None if chosen is None else chosen.setting


def test_a_first_run_is_timed_in_a_separate_process() -> None:
    model = Runner(read_text(OSCILLATOR)).model
    with closing(FreshProcess(model, 5.0)) as fresh:
        for one in (RK45, Setting(engine="auto", accuracy=1e-3)):
            seconds = fresh.seconds(one)
            assert seconds is not None
            assert seconds > 0.0
        # A setting that cannot run has no time; the next one still has one.
        assert fresh.seconds(Setting(engine="impulse", step=1e-3)) is None
        assert fresh.seconds(RK45) is not None
    assert fresh._process is None


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there are no copies")
def test_a_run_under_way_ends_with_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Runner(read_text(OSCILLATOR)).model
    fresh = FreshProcess(model, 5.0)
    assert fresh.seconds(RK45) is not None
    process = fresh._process
    assert process is not None
    ended: list[tuple[int, int]] = []
    kill = os.killpg
    monkeypatch.setattr(os, "killpg", lambda *all_of: (ended.append(all_of), kill(*all_of)))
    fresh.close()
    assert ended == [(process.pid, signal.SIGKILL)]
    assert process.poll() is not None
    fresh.close()


def test_the_cold_time_is_none_without_a_process(monkeypatch: pytest.MonkeyPatch) -> None:
    model = Runner(read_text(OSCILLATOR)).model
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    assert FreshProcess(model, 5.0).seconds(RK45) is None
    unknown = point(1e-6, 1e-7, 0.5, cold=None)
    assert unknown.cost(once=True) == 0.5
    assert "  500 ms\n" in str(study(unknown))


def test_a_study_has_both_costs() -> None:
    found = traded(Runner(read_text(OSCILLATOR)), settings=[RK45])
    (one,) = found.points
    assert one.cold == 0.25
    assert one.seconds == pytest.approx(1e-3)
    assert re.search(r" 1 ms +250 ms *\n", str(found))
    assert to_dict(found)["points"][0]["cold"] == 0.25


def test_cheapest_setting_differs_for_cold_and_warm_runs() -> None:
    quick = point(1e-6, 1e-7, 0.01, cold=0.9)
    ready = point(1e-7, 1e-8, 0.05, cold=0.2)
    found = study(quick, ready)
    asked = Setting(accuracy=1e-5)
    assert setting(found.choose(asked, once=False)) == quick.setting
    assert setting(found.choose(asked, once=True)) == ready.setting
    # The best setting within a time; half of a budget is for a coarser run.
    assert found.choose(Setting(budget=0.3), once=True) is None
    assert setting(found.choose(Setting(budget=0.3), once=False)) == ready.setting
    assert setting(found.choose(Setting(budget=0.5), once=True)) == ready.setting


def test_warm_and_cold_fronts_are_printed() -> None:
    quick = point(1e-5, 1e-7, 0.01, cold=0.9)
    ready = point(1e-6, 1e-6, 0.05, cold=0.2)
    found = study(quick, ready)
    assert found.front() == (quick,)
    assert found.front(once=True) == (ready, quick)
    said = str(found)
    assert "scipy RK45 1e-05 *+ " in said
    assert "scipy RK45 1e-06 + " in said
    assert "* warm" in said
    points = to_dict(found)["points"]
    assert [(p["on_front"], p["on_cold_front"]) for p in points] == [(True, True), (False, True)]
    labels = [t.get_text() for t in figure(found).legends[0].get_texts()]
    assert [label for label in labels if label.startswith("front")] == [
        "front, warm",
        "front, cold (dots)",
    ]
