"""Threads that share a runner get the results of separate runs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from statechart.running.runner import Runner

FRICTIONS = (0.2, 0.3, 0.5, 0.9)


@pytest.fixture(autouse=True)
def _taking_turns_often() -> Iterator[None]:
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(usual)


@pytest.mark.parametrize("engine", ["taylor", "scipy"])
def test_runs_of_one_runner_in_several_threads_are_its_runs(engine: str) -> None:
    if engine == "taylor":
        pytest.importorskip("heyoka")
    runner = Runner("toppling_stick", engine=engine)
    alone = [runner.run({"mu": mu}).outputs for mu in FRICTIONS]
    with ThreadPoolExecutor(len(FRICTIONS)) as pool:
        found = list(pool.map(lambda mu: runner.run({"mu": mu}).outputs, FRICTIONS * 5))
    assert found == alone * 5
