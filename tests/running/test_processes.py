"""Pickling: models, settings, runners and results travel to another process."""

from __future__ import annotations

import multiprocessing
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields

import numpy as np
import pytest

from statechart.automaton.trace import Outcome, Trace
from statechart.documents.setting import Setting
from statechart.loading.load import load
from statechart.running.result import Result
from statechart.running.runner import Runner, run

SCENE, CHART = "toppling_stick", "bouncing_ball_chart"


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    # A process without the memory of this one, as on systems without fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as made:
        yield made


def assert_same(one: Trace, other: Trace) -> None:
    assert [arc.mode for arc in one.arcs] == [arc.mode for arc in other.arcs]
    assert [(jump.t, jump.cause) for jump in one.jumps] == [(j.t, j.cause) for j in other.jumps]
    for mine, its in zip(one.arcs, other.arcs, strict=True):
        for part in fields(mine):
            np.testing.assert_equal(getattr(mine, part.name), getattr(its, part.name))
    assert (one.final == other.final).all()
    assert one.outcome is other.outcome


@pytest.mark.parametrize(
    "value",
    [load(SCENE), load(CHART), Setting("scipy", "RK45", 1e-6), Outcome.HORIZON],
    ids=lambda value: type(value).__name__,
)
def test_pickled_values_are_equal(value: object) -> None:
    assert pickle.loads(pickle.dumps(value)) == value


@pytest.mark.parametrize("model", [SCENE, CHART])
def test_a_run_in_another_process_is_the_run_in_this_one(
    model: str, pool: ProcessPoolExecutor
) -> None:
    declared = load(model)
    here, there = run(declared), pool.submit(run, declared).result()
    assert_same(there.trace, here.trace)
    assert there.outputs == here.outputs
    assert there.to_dict(explain=True)["events"] == here.to_dict(explain=True)["events"]


def test_a_runner_is_pickled_as_its_model_and_settings(pool: ProcessPoolExecutor) -> None:
    runner = Runner(SCENE, engine="scipy", method="RK45", accuracy=1e-4)
    found = pool.submit(runner.run, {"mu": 0.3}).result()
    here = runner.run({"mu": 0.3})
    assert_same(found.trace, here.trace)
    assert found.error_estimate == here.error_estimate
    assert found.asked is not None
    assert found.asked.setting == runner.setting


def test_stepped_run_is_picklable(pool: ProcessPoolExecutor) -> None:
    found: Result = pool.submit(run, SCENE, engine="impulse", step=1e-3).result()
    here = run(SCENE, engine="impulse", step=1e-3)
    assert_same(found.trace, here.trace)
    assert found.outputs == here.outputs
