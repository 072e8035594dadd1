"""Steps that Python takes while another process compiles what takes them: the same bits."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys

import numpy as np
import pytest

from contacts.rigid_bodies.body_step import step_bodies
from contacts.time_stepping.scene_step import step_scene
from statechart import Runner
from statechart.automaton.trace import Outcome
from statechart.kernels import jit, kinds, maker
from statechart.kernels.jit import late, stepwise

STEPS = (step_bodies, step_scene)


@late
def _inner(x: float) -> float:
    return math.sqrt(x)


@stepwise
def _roots(values, result):
    for i in range(len(values)):
        result[0][i] = _inner(values[i])
    return len(values), 0


class Waiting:
    """A process that has compiled everything once it was asked some times."""

    polls = math.inf

    def __init__(self, kernel, arguments):
        self._left = self.polls

    def is_done(self):
        """Whether it has."""
        self._left -= 1
        return self._left <= 0


@pytest.fixture
def anew(monkeypatch):
    """Let no process have taken steps, and what lies on disk be of no use."""
    for steps in (*STEPS, _roots):
        for name in ("_spent", "_looked_at", "_many", "_settled", "_maker"):
            monkeypatch.setattr(steps, name, getattr(kinds.Stepwise, name), raising=False)
    monkeypatch.setattr(kinds, "is_cached", lambda kernel: False)
    monkeypatch.setattr(kinds, "BRIEF", 0.0)
    monkeypatch.setattr(maker, "Maker", Waiting)


def told(model, until, once):
    """Return all that a run tells, but for what it took."""
    result = Runner(model, once=once).run(until=until, throw=False)
    found = result.to_dict(explain=True)
    found.pop("timings")
    return found, result.trace.final.tobytes(), result.trace.motion


@pytest.mark.parametrize(
    ("model", "until"),
    [
        ("dice", 0.12),
        ("arch", 0.01),
        ("domino", 0.01),
        ("woodpecker", 0.004),
        ("raibert_hopper", 0.1),
    ],
)
@pytest.mark.parametrize("polls", [3, math.inf])
def test_python_takes_the_same_steps(model, until, polls, anew, monkeypatch):
    monkeypatch.setattr(Waiting, "polls", polls)
    # Between all calls is looked whether there is something compiled by now.
    monkeypatch.setattr(kinds, "_TOGETHER", 0.0)
    meanwhile = told(model, until, once=True)
    assert all(steps._maker is None or steps._settled == (polls == 3) for steps in STEPS)
    assert meanwhile == told(model, until, once=False)


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize(("model", "step"), [("dice", 1e-3), ("woodpecker", 2e-5)])
def test_a_signal_ends_steps_with_those_that_were_taken(model, step, anew, monkeypatch):
    class Ended(Waiting):
        def is_done(self):
            self._left = 0 if self._left == math.inf else self._left + 1
            if self._left == 20:
                signal.raise_signal(signal.SIGINT)
            return False

    monkeypatch.setattr(maker, "Maker", Ended)
    monkeypatch.setattr(kinds, "_TOGETHER", 0.0)
    trace = Runner(model, once=True).run(until=500.0 * step).trace
    assert trace.outcome is Outcome.INTERRUPTED
    # It is asked twice for each step, from the second one on.
    assert 10 <= trace.counts["steps"] <= 12
    assert trace.t_end == pytest.approx(trace.counts["steps"] * step, abs=1e-9 * step)


def test_what_is_no_number_to_compiled_code_alone_is_left_to_it(anew):
    values, result = np.array([4.0, -1.0]), (np.array([5.0, 5.0]), 1.0)
    with jit.meanwhile():
        assert _roots(values, result) == (2, 0)
        assert _roots._settled
    assert result[0][0] == 2.0
    assert math.isnan(result[0][1])


def test_a_process_compiles_and_waits_for_what_is_entered(tmp_path):
    script = """
import time
import numpy as np
from statechart.kernels import maker
from contacts.solvers import lemke
from contacts.solvers.lemke import on_support
made = maker.Maker(on_support, {arguments})
while not made.is_done():
    time.sleep(0.01)
print(made._process.poll())
"""
    arguments = "(np.eye(2), np.ones(2), np.array([True, False]))"
    script = script.replace("{arguments}", arguments)
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "None\n"
    assert list(tmp_path.rglob("lemke.on_support-*.nbi"))


def test_where_no_process_can_be_started_the_run_compiles(anew, monkeypatch):
    monkeypatch.undo()

    def refused(*arguments, **options):
        raise OSError

    monkeypatch.setattr(subprocess, "Popen", refused)
    assert maker.Maker(_roots, ()).is_done()


def test_steps_that_python_takes_too_long_for_are_given_up(anew, monkeypatch):
    monkeypatch.setattr(kinds, "_LONGEST", -1.0)
    values, result = np.array([4.0, 9.0]), (np.array([5.0, 5.0]), 1.0)
    with jit.meanwhile():
        assert _roots(values, result) == (2, 0)
    assert _roots._settled
    assert result[0].tolist() == [2.0, 3.0]
    assert kinds.Deadline.at == math.inf
