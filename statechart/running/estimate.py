"""Accuracy on request: runs at ever tighter tolerances, and what their differences say."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.engines.request import TIGHTER
from statechart.errors import DeclarationError
from statechart.observation.difference import compare, paired
from statechart.observation.observer import Observer
from statechart.running.answer import UNTOLD, Answer, Cost, Made

_BELOW = 1.0 / 10.0
"""Errors of a run exceed its tolerance by about so much: where an accuracy is asked for and nothing
was measured, the first tolerance is that far below."""

BRIEF = 1e-6
"""Modes that differ for less than this part of a run are the same where no accuracy says more."""

# Where the best accuracy within a time is looked for: the first tolerance, and the step to the
# next. A method of order 5 takes three times as long for it, so a third of the time is used at
# least.
_FIRST, _STRIDE = 1e-4, TIGHTER**2
# The next run is expected to take at least so many times the time of the last one.
_LONGER = 1.5

# So many times one run allows a second, tighter one besides.
_ADVISED = 5.0
# A budget is kept to within this factor, or so many seconds.
_OVERRUN, _MOMENT = 1.2, 0.05

Once = Callable[[float, bool], tuple[Observer, Trace]]
"""Runs a model once, at a tolerance; True: from a start that is off by it."""

# How far below a run is another, that tells how many events there are.
_FAR = TIGHTER**2
# Runs of many steps that are equal to so many roundings are not known any better.
_ROUNDED = 32.0 * float(np.finfo(float).eps)
_NEARLY = 1.0 + 1e-9


class _Error(NamedTuple):
    """An estimated error, and the quantity that it is of with its values in two runs."""

    size: float
    decides: str


_NO_ERROR = _Error(0.0, "")


class _Runs:
    """Runs that are made one after the other; what they took, and how the last two differ."""

    def __init__(
        self,
        once: Once,
        floor: float,
        accuracy: float | None = None,
        clock: Callable[[], float] = working_time,
    ) -> None:
        self._accuracy, self._floor = accuracy, floor
        self._brief = accuracy or BRIEF
        self._once, self._clock, self._began = once, clock, clock()
        self._last: Made | None = None
        self.runs = self.steps = self.evaluations = 0
        self._error: _Error | None = None
        self.diverged = ""
        self.merged: float | None = None
        self.endless: frozenset[str] = frozenset()

    def make(self, tolerance: float, *, nudged: bool = False) -> tuple[Observer, Trace]:
        observer, trace = self._once(tolerance, nudged)
        self.runs += 1
        self.steps += trace.counts.get("steps", 0)
        self.evaluations += trace.counts.get("evaluations", 0)
        return observer, trace

    def compare(self, observer: Observer, trace: Trace, *, last: bool = False) -> None:
        """Estimate the error of a run by its difference from the last one.

        Two runs may agree by luck, or because their flows are polynomials, on which the tolerance
        has no influence. So where they agree well, or nothing tighter follows, a third, from a
        start that is off by the tolerance, shows how much an error so small is magnified; it alone
        tells the error of a first run that is the `last`.
        """
        now = Made.of(observer, trace)
        if self._last is None and last:
            # Nothing is tighter, and what is looser need not be run.
            self._error = self._magnified(now)
        elif self._last is not None:
            before = self._last.trace
            error = self._difference(
                self._last, now, f"at the tolerances {before.tolerance:.2g} and"
            )
            well = trace.tolerance if self._accuracy is None else self._accuracy
            if error.size <= well or (last and error.size < math.inf):
                error = max(error, self._grown(self._last, now, well))
            if error.size <= well and trace.tolerance > _NEARLY * _FAR * before.tolerance:
                error = max(error, self._counted(now))
            self._error = error
        self._last = now

    @property
    def estimate(self) -> float | None:
        return None if self._error is None else self._error.size

    @property
    def decides(self) -> str:
        return "" if self._error is None else self._error.decides

    def _grown(self, before: Made, now: Made, well: float) -> _Error:
        """Return what an error of the tolerance becomes; 0 where that cannot be told.

        The run before is cheaper to make again than the last one, and it shows the same in
        proportion, unless its own tolerance takes it into other modes.
        """
        found = self._magnified(before)
        if found is not None:
            shrunk = found.size * (now.trace.tolerance / before.trace.tolerance)
            if shrunk <= well:
                return found._replace(size=shrunk)
        return self._magnified(now) or _NO_ERROR

    def _magnified(self, now: Made) -> _Error | None:
        """Return the difference from a run whose start is off; None where that says nothing."""
        try:
            observer, trace = self.make(now.trace.tolerance, nudged=True)
        except DeclarationError:
            # Off by so much, the start is no start.
            return None
        if _identical(trace, now.trace) or trace.outcome in (
            Outcome.INTERRUPTED,
            Outcome.OUT_OF_BUDGET,
        ):
            return None
        found = Made.of(observer, trace)
        return self._difference(
            found, now, "with gaps and from starts that differ by the tolerance"
        )

    def _counted(self, now: Made) -> _Error:
        """Return the difference from a far tighter run; 0 where no events are counted or listed.

        Impacts that follow each other within the tolerance are one, and two runs whose tolerances
        are near each other may agree on that.
        """
        tolerance = max(now.trace.tolerance * _FAR, self._floor)
        if not (_counts(now) and tolerance < now.trace.tolerance):
            return _NO_ERROR
        observer, trace = self.make(tolerance)
        if trace.outcome in (Outcome.INTERRUPTED, Outcome.OUT_OF_BUDGET):
            return _NO_ERROR
        return self._difference(now, Made.of(observer, trace), "at the tolerances far apart, to")

    @property
    def stride(self) -> float:
        """From the first tolerance to the next; where events are counted, a far tighter one."""
        return _FAR if self._last is not None and _counts(self._last) else TIGHTER

    def _difference(self, one: Made, other: Made, how: str) -> _Error:
        # How many events of a Zeno sequence are resolved follows from the tolerance.
        self.endless = one.endless | other.endless
        found = compare(
            one.trace,
            other.trace,
            one.outputs,
            other.outputs,
            scales=other.scales,
            endless=self.endless,
            brief=self._brief,
        )
        runs, self.diverged = f"runs {how} {other.trace.tolerance:.2g}", ""
        if found.diverged is None:
            # Of events that one of the runs has, and the other not, the result is the same.
            _, self.merged = paired(one.trace, other.trace)
        if found.diverged is not None:
            self.diverged = (
                f"{runs} take different modes: accuracy is undefined from "
                f"t = {found.diverged:.6g} on"
            )
        elif found.outputs == math.inf:
            names = [name for name, off in found.named.items() if off == math.inf]
            self.diverged = f"{runs} have {', '.join(names)} the one, and not the other"
        decides = str(found.decides) if found.decides.off > 0.0 else ""
        return _Error(max(found.largest, _ROUNDED), decides)

    @property
    def seconds(self) -> float:
        return self._clock() - self._began

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of the answer must know of how the runs compare."""
        if self.diverged:
            return (self.diverged,)
        if self.merged is None:
            return ()
        return (
            f"modes that last less than {self._brief:g} of the run are not told apart: from "
            f"t = {self.merged:.6g} on one of the runs has some that another has not",
        )

    @property
    def not_judged(self) -> tuple[str, ...]:
        return tuple(sorted(self.endless))

    @property
    def cost(self) -> Cost:
        return Cost(self.runs, self.steps, self.evaluations, self.seconds)


def tighten(
    once: Once,
    accuracy: float,
    *,
    floor: float,
    first: float | None = None,
) -> Answer:
    """Run at ever tighter tolerances until two runs differ by no more than `accuracy`."""
    tolerance = max(accuracy * _BELOW if first is None else first, floor)
    runs = _Runs(once, floor, accuracy)
    observer, trace = runs.make(tolerance)
    if trace.outcome is Outcome.UNSUPPORTED:
        return Answer(observer, trace, None, runs.cost)
    while trace.outcome is not Outcome.INTERRUPTED:
        runs.compare(observer, trace, last=tolerance <= floor)
        if runs.estimate is not None and (runs.estimate <= accuracy or tolerance <= floor):
            break
        if tolerance <= floor:
            runs.compare(*runs.make(floor / TIGHTER))
            continue
        stride = runs.stride if runs.runs == 1 else TIGHTER
        tolerance = max(tolerance * stride, floor)
        observer, trace = runs.make(tolerance)
    else:
        warning = "interrupted before its error was estimated"
        return Answer(observer, trace, math.inf, runs.cost, (warning,))
    assert runs.estimate is not None
    missed = (
        ""
        if runs.estimate <= accuracy
        else runs.diverged
        or f"the accuracy {accuracy:g} was not reached: at the least tolerance of the engine the "
        f"estimated error is {runs.estimate:.2g}, that of {runs.decides}"
    )
    warnings = (missed,) if missed else runs.warnings
    return Answer(
        observer, trace, runs.estimate, runs.cost, warnings, runs.not_judged, runs.decides
    )


def within(
    once: Once,
    budget: float,
    *,
    spent: float = 0.0,
    floor: float,
    first: float | None = None,
    clock: Callable[[], float] = working_time,
) -> Answer:
    """Return the most accurate run that a time allows.

    Parameters
    ----------
    once : callable
        Makes a run, and ends it with `Outcome.OUT_OF_BUDGET` once the time is up.
    budget : float
        Seconds for all runs together.
    spent : float, optional
        Of these, before the first run.
    floor : float
        Least tolerance of the engine.
    first : float, optional
        Tolerance to begin with, where something is known of what runs take.
    clock : callable
        Tells the time in seconds.

    Returns
    -------
    Answer
        Of the last run that ended in time. If none did, the first as far as it came; its outcome
        says so.
    """
    tolerance, stride = (_FIRST, _STRIDE) if first is None else (first, TIGHTER)
    tolerance = max(tolerance, floor)
    runs = _Runs(once, floor, clock=clock)
    answer: Answer | None = None
    while True:
        began = runs.seconds
        observer, trace = runs.make(tolerance)
        took = runs.seconds - began
        cut = trace.outcome in (*UNTOLD, Outcome.INTERRUPTED)
        if cut and answer is not None:
            break
        if not cut:
            runs.compare(observer, trace, last=tolerance <= floor)
        answer = Answer(
            observer, trace, runs.estimate, runs.cost, runs.warnings, runs.not_judged, runs.decides
        )
        if cut or tolerance <= floor or spent + runs.seconds + _LONGER * took > budget:
            break
        tolerance = max(tolerance * stride, floor)
    if answer.estimate is None and answer.trace.outcome not in UNTOLD:
        warning = (
            f"within {budget:g} s there was time for one run only, so its error was not "
            f"estimated: allow {_ADVISED * (spent + runs.seconds):.2g} s"
        )
        answer = replace(answer, warnings=(warning,))
    taken = spent + runs.seconds
    if taken > max(_OVERRUN * budget, budget + _MOMENT):
        warning = (
            f"{taken:.2g} s were taken of the {budget:g} s allowed: a mode that is being "
            "solved or compiled is not interrupted; what is made is kept for the next run"
        )
        answer = replace(answer, warnings=(*answer.warnings, warning))
    return replace(answer, cost=runs.cost)


def _counts(made: Made) -> bool:
    """Whether a run has outputs that count or list events, of which there is an end."""
    counted = {name for name, value in made.outputs.items() if isinstance(value, int | list)}
    return not counted <= made.endless


def _identical(one: Trace, other: Trace) -> bool:
    times = [[jump.t for jump in trace.jumps] for trace in (one, other)]
    return times[0] == times[1] and np.array_equal(one.final, other.final)
