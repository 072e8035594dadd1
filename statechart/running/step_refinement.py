"""Error estimate and control of time stepping: runs at ever shorter steps.

The scheme is of first order: x(h) = x + c h, so that two runs tell the error of the finer one,
c h = (x(r h) - x(h)) / (r - 1). But an event falls anywhere between two steps, so that c is another
number in every run, and two runs agree by luck. Steps shorten by the square root of 1/2, whose
powers put no event at the same place between steps twice, and a run is compared with four.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.observation.difference import distance, modes_apart
from statechart.observation.observer import Observer
from statechart.running.accuracy import Cost, EvaluatedRun, RunEstimate, interrupted
from statechart.tabular import several

SHORTER = math.sqrt(0.5)
"""The step from one run to the next."""
FIRST_SHARE = 1e-3
"""Part of the run that the first step is, where nothing else says how long it is."""
_COMPARED = 4
"""So many runs before tell the error of one: their steps reach to four times its own."""
_SAFE = 1.5
"""Where an event falls in its step is chance. For one event, a place as good as any other, four
first-order estimates all stay below the error in 12 of 100 cases; 1.5 times them in 3, and below a
half of it in 0.3."""
_MAX_STEPS = 2**20
"""Steps of a run, beyond which none is tried: minutes, and as much as a trace can hold."""
_SHORTEST = 2.0**-40
"""Part of the longest run that a step may be, where runs end early because it is too long."""
_PATIENCE = 10
"""After so many runs, steps a 32nd as long, an estimate that has not even halved never will."""
_AT_REST = 1e-3
"""Of the tolerance of speeds at the start, 1e-9 of the scene's: where a block is stuck from the
start on, all of its motion is round-off."""

_STEP_TOO_LONG = (Outcome.STEP_TOO_LARGE, Outcome.UNSOLVED_IMPULSES)

Once = Callable[[float], tuple[Observer, Trace]]
"""Runs a model once, at a step."""


class _Distance(NamedTuple):
    """Distance of two runs, the quantity that differs most, and when their modes first differ."""

    size: float
    quantity: str
    diverged: float | None


class _Runs:
    """A series of runs at ever shorter steps: their cost, and the error of the last."""

    def __init__(self, once: Once, accuracy: float) -> None:
        self._once, self._began = once, working_time()
        self._accuracy = accuracy
        self._before: deque[EvaluatedRun] = deque(maxlen=_COMPARED)
        self._count = self._steps = 0
        self._estimates: list[float] = []
        self._endless: frozenset[str] = frozenset()
        self._reason = self._decides = ""

    def make(self, step: float) -> tuple[Observer, Trace]:
        observer, trace = self._once(step)
        self._count += 1
        self._steps += trace.counts.get("steps", 0)
        return observer, trace

    def estimate(self, observer: Observer, trace: Trace) -> RunEstimate:
        """Return a run with its estimated error; inf where too few were made before it."""
        now = EvaluatedRun.of(observer, trace)
        error = math.inf
        if len(self._before) == _COMPARED:
            self._endless = now.endless.union(*(run.endless for run in self._before))
            distances = [(_ratio(run, now), self._distance(run, now)) for run in self._before]
            error = _SAFE * max(found.size / (ratio - 1.0) for ratio, found in distances)
            last = distances[-1][1]
            self._decides = last.quantity
            self._reason = f"; runs at two steps differ most in {last.quantity}"
            if last.diverged is not None:
                self._reason += f", and take different modes from t = {last.diverged:.6g} on"
        self._before.append(now)
        self._estimates.append(error)
        endless = tuple(sorted(self._endless))
        return RunEstimate(observer, trace, error, self.cost, (), endless, self._decides)

    def missed(self, found: RunEstimate, why: str) -> RunEstimate:
        """Return a run that is less accurate than requested, with a warning."""
        warning = (
            f"the accuracy {self._accuracy:g} was not reached: at a step of {found.trace.step:.2g} "
            f"the estimated error is {found.error:.2g}, and {why}{self._reason}"
        )
        return replace(found, cost=self.cost, warnings=(warning,))

    @property
    def stuck(self) -> bool:
        """Whether the estimate no longer falls with the step."""
        known = self._estimates[_COMPARED:]
        return len(known) > _PATIENCE and not known[-1] < 0.5 * known[-1 - _PATIENCE]

    @property
    def cost(self) -> Cost:
        return Cost(self._count, self._steps, self._steps, working_time() - self._began)

    def _distance(self, coarse: EvaluatedRun, fine: EvaluatedRun) -> _Distance:
        found = coarse.difference(
            fine,
            fine.scales,
            endless=self._endless,
            brief=self._accuracy,
            nothing=_AT_REST * fine.trace.tolerances.get("speed", 0.0),
        )
        parts = {str(found.decides): max(found.state, found.times, found.outputs)}
        if found.diverged is not None and max(parts.values()) < math.inf:
            # How many bounces are resolved before rest follows from the step: what converges then
            # is the path, and for how long modes are others (Moreau 1999).
            runs = coarse.trace, fine.trace
            parts |= {"the modes": modes_apart(*runs), "the path": distance(*runs)}
        quantity = max(parts, key=parts.__getitem__)
        return _Distance(parts[quantity], quantity, found.diverged)


def refine(once: Once, accuracy: float, *, first: float, end: float) -> RunEstimate:
    """Run at ever shorter steps until the estimated error is no more than `accuracy`."""
    runs = _Runs(once, accuracy)
    step = min(first, end) or first
    last: RunEstimate | None = None
    while True:
        observer, trace = runs.make(step)
        if trace.outcome is Outcome.INTERRUPTED:
            return interrupted(observer, trace, runs.cost)
        if trace.outcome is Outcome.TOO_LONG and last is not None:
            return runs.missed(last, "a run at a shorter step is too long to be kept")
        if trace.outcome is Outcome.TOO_LONG:
            return RunEstimate(observer, trace, None, runs.cost)
        taken = trace.counts["steps"]
        if trace.outcome in _STEP_TOO_LONG:
            if taken > _MAX_STEPS or step < _SHORTEST * end:
                return RunEstimate(observer, trace, None, runs.cost)
            last, step = None, 0.5 * step
            continue
        last = runs.estimate(observer, trace)
        assert last.error is not None
        if last.error <= accuracy:
            return last
        if runs.stuck:
            return runs.missed(last, "shorter steps bring runs no nearer")
        if taken > _MAX_STEPS * SHORTER:
            return runs.missed(last, f"it took {several(taken, 'step')}")
        step *= SHORTER


def _ratio(coarse: EvaluatedRun, fine: EvaluatedRun) -> float:
    assert coarse.trace.step is not None
    assert fine.trace.step is not None
    return coarse.trace.step / fine.trace.step
