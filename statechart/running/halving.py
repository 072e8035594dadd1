"""Accuracy on request by time steps: runs at ever shorter steps, and what their differences say.

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
from statechart.observation.difference import compare, distance, modes_apart
from statechart.observation.observer import Observer
from statechart.running.answer import Answer, Cost, Made
from statechart.tabular import several

SHORTER = math.sqrt(0.5)
"""The step from one run to the next."""
_COMPARED = 4
"""So many runs before tell the error of one: their steps reach to four times its own."""
_SAFE = 1.5
"""Where an event falls in its step is chance. For one event, a place as good as any other, four
first-order estimates all stay below the error in 12 of 100 cases; 1.5 times them in 3, and below a
half of it in 0.3."""
_MOST = 2**20
"""Steps of a run, beyond which none is tried: minutes, and as much as a trace can hold."""
_SHORTEST = 2.0**-40
"""Part of the longest run that a step may be, where runs end early because it is too long."""
_PATIENCE = 10
"""After so many runs, steps a 32nd as long, an estimate that has not even halved never will."""
_ROUNDING = 1e-3
"""Of the tolerance of speeds at the start, 1e-9 of the scene's: where a block is stuck from the
start on, all of its motion is rounding."""
SHARE = 1e-3
"""Of the run is the first step, where nothing else says how long it is."""

_SHORTEN = (Outcome.STEP_TOO_LARGE, Outcome.UNSOLVED_IMPULSES)
"""A run that ends so says that its step was too long, and nothing else."""

Once = Callable[[float], tuple[Observer, Trace]]
"""Runs a model once, at a step."""


class _Apart(NamedTuple):
    """How far two runs are apart, in what most, and since when in their modes."""

    size: float
    what: str
    diverged: float | None


class _Steps:
    """Runs at ever shorter steps, what they took, and the error of the last."""

    def __init__(self, once: Once, accuracy: float) -> None:
        self._once, self._began = once, working_time()
        self._accuracy = accuracy
        self._before: deque[Made] = deque(maxlen=_COMPARED)
        self._runs = self._taken = 0
        self._estimates: list[float] = []
        self.endless: frozenset[str] = frozenset()
        self.why = self.decides = ""

    def make(self, step: float) -> tuple[Observer, Trace]:
        observer, trace = self._once(step)
        self._runs += 1
        self._taken += trace.counts.get("steps", 0)
        return observer, trace

    def judge(self, observer: Observer, trace: Trace) -> float:
        """Return the estimated error of a run; inf where too few were made before it."""
        now = Made.of(observer, trace)
        found = math.inf
        if len(self._before) == _COMPARED:
            self.endless = now.endless.union(*(made.endless for made in self._before))
            apart = [(made, self._between(made, now)) for made in self._before]
            found = _SAFE * max(one.size / (_ratio(made, now) - 1.0) for made, one in apart)
            self.why, self.decides = _said(apart[-1][1]), apart[-1][1].what
        self._before.append(now)
        self._estimates.append(found)
        return found

    @property
    def stuck(self) -> bool:
        """Whether the estimate no longer falls with the step."""
        known = self._estimates[_COMPARED:]
        return len(known) > _PATIENCE and not known[-1] < 0.5 * known[-1 - _PATIENCE]

    @property
    def cost(self) -> Cost:
        return Cost(self._runs, self._taken, self._taken, working_time() - self._began)

    def _between(self, coarse: Made, fine: Made) -> _Apart:
        found = compare(
            coarse.trace,
            fine.trace,
            coarse.outputs,
            fine.outputs,
            scales=fine.scales,
            endless=self.endless,
            brief=self._accuracy,
            nothing=_ROUNDING * fine.trace.tolerances.get("speed", 0.0),
        )
        parts = {str(found.decides): max(found.state, found.times, found.outputs)}
        if found.diverged is not None and max(parts.values()) < math.inf:
            # How many bounces are resolved before rest follows from the step: what converges then
            # is the path, and for how long modes are others (Moreau 1999).
            runs = coarse.trace, fine.trace
            parts |= {"the modes": modes_apart(*runs), "the path": distance(*runs)}
        what = max(parts, key=parts.__getitem__)
        return _Apart(parts[what], what, found.diverged)


def halve(once: Once, accuracy: float, *, first: float, end: float) -> Answer:
    """Run at ever shorter steps until the estimated error is no more than `accuracy`."""
    steps = _Steps(once, accuracy)
    step = min(first, end) or first
    last: Answer | None = None
    while True:
        observer, trace = steps.make(step)
        if trace.outcome is Outcome.INTERRUPTED:
            warning = "interrupted before its error was estimated"
            return Answer(observer, trace, math.inf, steps.cost, (warning,))
        if trace.outcome is Outcome.TOO_LONG and last is not None:
            return _missed(last, steps, accuracy, "a run at a shorter step is too long to be kept")
        if trace.outcome is Outcome.TOO_LONG:
            return Answer(observer, trace, None, steps.cost)
        taken = trace.counts["steps"]
        if trace.outcome in _SHORTEN:
            if taken > _MOST or step < _SHORTEST * end:
                return Answer(observer, trace, None, steps.cost)
            last, step = None, 0.5 * step
            continue
        estimate = steps.judge(observer, trace)
        endless = tuple(sorted(steps.endless))
        last = Answer(observer, trace, estimate, steps.cost, (), endless, steps.decides)
        if estimate <= accuracy:
            return last
        if steps.stuck:
            return _missed(last, steps, accuracy, "shorter steps bring runs no nearer")
        if taken > _MOST * SHORTER:
            return _missed(last, steps, accuracy, f"it took {several(taken, 'step')}")
        step *= SHORTER


def _missed(answer: Answer, steps: _Steps, accuracy: float, reason: str) -> Answer:
    """Return an answer that is not as good as it was asked to be."""
    warning = (
        f"the accuracy {accuracy:g} was not reached: at a step of {answer.trace.step:.2g} the "
        f"estimated error is {answer.estimate:.2g}, and {reason}{steps.why}"
    )
    return replace(answer, cost=steps.cost, warnings=(warning,))


def _ratio(coarse: Made, fine: Made) -> float:
    assert coarse.trace.step is not None
    assert fine.trace.step is not None
    return coarse.trace.step / fine.trace.step


def _said(apart: _Apart) -> str:
    """Say in what the last two runs differ most, and when they took different modes."""
    said = f"; runs at two steps differ most in {apart.what}"
    if apart.diverged is not None:
        said += f", and take different modes from t = {apart.diverged:.6g} on"
    return said
