"""Error estimate and control: runs at ever tighter tolerances, and what their differences show.

`tighten` delivers an accuracy, `within` the best accuracy in a time, `replay` a run that a study
measured. `EvaluatedRun` is compared, `RunEstimate` is the run delivered with its estimated error,
`AccuracyRequest` what a result keeps of the request.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.documents.setting import Setting
from statechart.engines.request import TIGHTER, Chosen
from statechart.errors import DeclarationError
from statechart.observation.batch_outputs import OutputValue
from statechart.observation.difference import Difference, compare, paired
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs, Scales

WITHOUT_ERROR = (Outcome.OUT_OF_BUDGET, Outcome.UNSUPPORTED)
"""Outcomes of runs that tell nothing of their error."""
_CUT_SHORT = (Outcome.INTERRUPTED, Outcome.OUT_OF_BUDGET)

_BELOW = 1.0 / 10.0
"""Errors of a run exceed its tolerance by about so much: where an accuracy is asked for and nothing
was measured, the first tolerance is that far below."""

BRIEF = 1e-6
"""Modes that differ for less than this part of a run are the same where no accuracy says more."""

# The search for the best accuracy within a time: the first tolerance, and the step to the next. A
# method of order 5 takes three times as long for it, so a third of the time is used at least.
_FIRST, _STRIDE = 1e-4, TIGHTER**2
# The next run is expected to take at least so many times the time of the last one.
_LONGER = 1.5
# So many times the time of one run allows a second, tighter one besides.
_ADVISED = 5.0
# A budget is kept to within this factor, or so many seconds.
_OVERRUN, _MOMENT = 1.2, 0.05
# How far below a run another one is that tells how many events there are.
_FAR = TIGHTER**2
# Two runs of many steps may agree to so many round-off errors by luck.
_ROUNDED = 32.0 * float(np.finfo(float).eps)
_NEARLY = 1.0 + 1e-9

Once = Callable[[float, bool], tuple[Observer, Trace]]
"""Runs a model once at a tolerance; True: from a start that is off by the tolerance."""


@dataclass(frozen=True)
class Cost:
    """Cost of one or several runs."""

    # Over all runs; evaluations of the rates are 0 where the engine does not count them.
    runs: int
    steps: int
    evaluations: int
    # Wall time, without that of kernels that were compiled meanwhile, once on a machine.
    seconds: float

    def __add__(self, other: Cost) -> Cost:
        """Return the sum of two costs."""
        return Cost(
            self.runs + other.runs,
            self.steps + other.steps,
            self.evaluations + other.evaluations,
            self.seconds + other.seconds,
        )


@dataclass(frozen=True)
class AccuracyRequest:
    """Request of an accuracy or a time budget instead of a tolerance, and its cost.

    Attributes
    ----------
    setting : Setting
        With the accuracy or the budget allowed.
    basis : str
        How the first tolerance or step was chosen.
    cost : Cost
        Of all runs.
    not_judged : tuple of str
        Outputs without an error estimate: the number of bounces of a Zeno sequence has no limit.
    decides : str
        The quantity whose error is the estimate, with its values in two runs; else empty.
    """

    setting: Setting
    basis: str
    cost: Cost
    not_judged: tuple[str, ...] = ()
    decides: str = ""

    def reached(self, estimate: float | None) -> bool:
        """Whether an error estimate satisfies the request; a budget takes any estimate."""
        return estimate is not None and estimate <= (self.setting.accuracy or math.inf)

    def to_dict(self, estimate: float | None) -> dict[str, Any]:
        """Return the request as one plain object."""
        return {
            "accuracy": self.setting.accuracy,
            "budget": self.setting.budget,
            "reached": self.reached(estimate),
            "basis": self.basis,
            "cost": asdict(self.cost),
            "not_judged": list(self.not_judged),
            "decides": self.decides,
        }


@dataclass(frozen=True, eq=False)
class RunEstimate:
    """The best of several runs with its estimated error."""

    # Of that run.
    observer: Observer
    trace: Trace
    # Its largest difference from the run at the tolerance before; inf where the two took different
    # modes, None where there was only one.
    error: float | None
    cost: Cost  # Of all runs.
    # Reasons why the estimate misses the request; empty where it does not.
    warnings: tuple[str, ...] = ()
    # As of `AccuracyRequest`.
    not_judged: tuple[str, ...] = ()
    decides: str = ""


@dataclass(frozen=True, eq=False)
class EvaluatedRun:
    """A run, its outputs, their scales, and the outputs that count events without end."""

    observer: Observer
    trace: Trace
    outputs: Mapping[str, OutputValue]
    scales: Scales
    endless: frozenset[str]

    @classmethod
    def of(cls, observer: Observer, trace: Trace) -> EvaluatedRun:
        """Evaluate the outputs of a run."""
        outputs = Outputs(observer)
        return cls(
            observer, trace, outputs.of(trace), outputs.scales(trace), outputs.endless(trace)
        )

    def difference(self, other: EvaluatedRun, scales: Scales, **options: Any) -> Difference:
        """Return the difference of another run from this one; see `compare` for the options."""
        options.setdefault("endless", self.endless | other.endless)
        return compare(
            self.trace, other.trace, self.outputs, other.outputs, scales=scales, **options
        )


class _Error(NamedTuple):
    """An estimated error, and the quantity that it belongs to with its values in two runs."""

    size: float
    decides: str


_NO_ERROR = _Error(0.0, "")


class _Runs:
    """A series of runs at ever tighter tolerances: their cost, and how the last two differ."""

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
        self._last: EvaluatedRun | None = None
        self.runs = self._steps = self._evaluations = 0
        self._error: _Error | None = None
        self.diverged = ""
        self._merged: float | None = None
        self._endless: frozenset[str] = frozenset()

    def make(self, tolerance: float, *, nudged: bool = False) -> tuple[Observer, Trace]:
        observer, trace = self._once(tolerance, nudged)
        self.runs += 1
        self._steps += trace.counts.get("steps", 0)
        self._evaluations += trace.counts.get("evaluations", 0)
        return observer, trace

    def compare(self, observer: Observer, trace: Trace, *, last: bool = False) -> None:
        """Estimate the error of a run by its difference from the last one.

        Two runs may agree by luck, or because their flows are polynomials, on which the tolerance
        has no influence. So where they agree well, or nothing tighter follows, a third, from a
        start that is off by the tolerance, shows how much an error so small is magnified; it alone
        tells the error of a first run that is the `last`.
        """
        now = EvaluatedRun.of(observer, trace)
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
    def error(self) -> float | None:
        return None if self._error is None else self._error.size

    @property
    def decides(self) -> str:
        return "" if self._error is None else self._error.decides

    def estimate(
        self, observer: Observer, trace: Trace, warnings: tuple[str, ...] | None = None
    ) -> RunEstimate:
        """Return a run with the error estimated last."""
        return RunEstimate(
            observer,
            trace,
            self.error,
            self.cost,
            self.warnings if warnings is None else warnings,
            tuple(sorted(self._endless)),
            self.decides,
        )

    def _grown(self, before: EvaluatedRun, now: EvaluatedRun, well: float) -> _Error:
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

    def _magnified(self, now: EvaluatedRun) -> _Error | None:
        """Return the difference from a run whose start is off; None where that says nothing."""
        try:
            observer, trace = self.make(now.trace.tolerance, nudged=True)
        except DeclarationError:
            # Off by so much, the start is no start.
            return None
        if _identical(trace, now.trace) or trace.outcome in _CUT_SHORT:
            return None
        return self._difference(
            EvaluatedRun.of(observer, trace),
            now,
            "with gaps and from starts that differ by the tolerance",
        )

    def _counted(self, now: EvaluatedRun) -> _Error:
        """Return the difference from a far tighter run; 0 where no events are counted or listed.

        Impacts that follow each other within the tolerance are one, and two runs whose tolerances
        are near each other may agree on that.
        """
        tolerance = max(now.trace.tolerance * _FAR, self._floor)
        if not (_counts_events(now) and tolerance < now.trace.tolerance):
            return _NO_ERROR
        observer, trace = self.make(tolerance)
        if trace.outcome in _CUT_SHORT:
            return _NO_ERROR
        tighter = EvaluatedRun.of(observer, trace)
        return self._difference(now, tighter, "at the tolerances far apart, to")

    @property
    def stride(self) -> float:
        """From the first tolerance to the next; where events are counted, a far tighter one."""
        return _FAR if self._last is not None and _counts_events(self._last) else TIGHTER

    def _difference(self, one: EvaluatedRun, other: EvaluatedRun, how: str) -> _Error:
        # The number of events of a Zeno sequence that are resolved follows from the tolerance.
        self._endless = one.endless | other.endless
        found = one.difference(other, other.scales, brief=self._brief)
        runs, self.diverged = f"runs {how} {other.trace.tolerance:.2g}", ""
        if found.diverged is None:
            # Of events that one of the runs has, and the other not, the result is the same.
            _, self._merged = paired(one.trace, other.trace)
        else:
            self.diverged = (
                f"{runs} take different modes: accuracy is undefined from "
                f"t = {found.diverged:.6g} on"
            )
        if found.diverged is None and found.outputs == math.inf:
            names = [name for name, off in found.named.items() if off == math.inf]
            self.diverged = f"{runs} have {', '.join(names)} the one, and not the other"
        decides = str(found.decides) if found.decides.off > 0.0 else ""
        return _Error(max(found.largest, _ROUNDED), decides)

    @property
    def seconds(self) -> float:
        return self._clock() - self._began

    @property
    def warnings(self) -> tuple[str, ...]:
        """Caveats of the comparison."""
        if self.diverged:
            return (self.diverged,)
        if self._merged is None:
            return ()
        return (
            f"modes that last less than {self._brief:g} of the run are not told apart: from "
            f"t = {self._merged:.6g} on one of the runs has some that another has not",
        )

    @property
    def cost(self) -> Cost:
        return Cost(self.runs, self._steps, self._evaluations, self.seconds)


def tighten(
    once: Once, accuracy: float, *, floor: float, first: float | None = None
) -> RunEstimate:
    """Run at ever tighter tolerances until two runs differ by no more than `accuracy`."""
    tolerance = max(accuracy * _BELOW if first is None else first, floor)
    runs = _Runs(once, floor, accuracy)
    observer, trace = runs.make(tolerance)
    if trace.outcome is Outcome.UNSUPPORTED:
        return RunEstimate(observer, trace, None, runs.cost)
    while trace.outcome is not Outcome.INTERRUPTED:
        runs.compare(observer, trace, last=tolerance <= floor)
        if runs.error is not None and (runs.error <= accuracy or tolerance <= floor):
            break
        if tolerance <= floor:
            runs.compare(*runs.make(floor / TIGHTER))
            continue
        stride = runs.stride if runs.runs == 1 else TIGHTER
        tolerance = max(tolerance * stride, floor)
        observer, trace = runs.make(tolerance)
    else:
        return interrupted(observer, trace, runs.cost)
    assert runs.error is not None
    if runs.error <= accuracy:
        return runs.estimate(observer, trace)
    missed = runs.diverged or (
        f"the accuracy {accuracy:g} was not reached: at the least tolerance of the engine the "
        f"estimated error is {runs.error:.2g}, that of {runs.decides}"
    )
    return runs.estimate(observer, trace, (missed,))


def interrupted(observer: Observer, trace: Trace, cost: Cost) -> RunEstimate:
    """Return a run that a signal ended: its error is unknown."""
    warning = "interrupted before its error was estimated"
    return RunEstimate(observer, trace, math.inf, cost, (warning,))


def within(
    once: Once,
    budget: float,
    *,
    spent: float = 0.0,
    floor: float,
    first: float | None = None,
    clock: Callable[[], float] = working_time,
) -> RunEstimate:
    """Return the most accurate run that a time allows.

    Parameters
    ----------
    once : callable
        Makes a run, and ends it with `Outcome.OUT_OF_BUDGET` once the time is up.
    budget, spent : float
        Seconds for all runs together, and how many of them passed before the first run.
    floor : float
        Least tolerance of the engine.
    first : float, optional
        Tolerance to begin with, where the time that runs take is known.
    clock : callable
        Tells the time in seconds.

    Returns
    -------
    RunEstimate
        Of the last run that ended in time. If none did, the first as far as it came; its outcome
        says so.
    """
    tolerance, stride = (_FIRST, _STRIDE) if first is None else (first, TIGHTER)
    tolerance = max(tolerance, floor)
    runs = _Runs(once, floor, clock=clock)
    best: RunEstimate | None = None
    while True:
        began = runs.seconds
        observer, trace = runs.make(tolerance)
        took = runs.seconds - began
        cut = trace.outcome in (*WITHOUT_ERROR, Outcome.INTERRUPTED)
        if cut and best is not None:
            break
        if not cut:
            runs.compare(observer, trace, last=tolerance <= floor)
        best = runs.estimate(observer, trace)
        if cut or tolerance <= floor or spent + runs.seconds + _LONGER * took > budget:
            break
        tolerance = max(tolerance * stride, floor)
    taken, warnings = spent + runs.seconds, best.warnings
    if best.error is None and best.trace.outcome not in WITHOUT_ERROR:
        warnings = (
            f"within {budget:g} s there was time for one run only, so its error was not "
            f"estimated: allow {_ADVISED * taken:.2g} s",
        )
    if taken > max(_OVERRUN * budget, budget + _MOMENT):
        warnings += (
            f"{taken:.2g} s were taken of the {budget:g} s allowed: a mode that is being "
            "solved or compiled is not interrupted; what is made is kept for the next run",
        )
    return replace(best, warnings=warnings, cost=runs.cost)


def replay(once: Once, chosen: Chosen) -> RunEstimate | None:
    """Repeat a run that a study measured; None where it turns out as another one.

    Its error needs no further run to be estimated: that of the same run was measured against a
    reference. That it is the same shows in its end, its flows, steps and evaluations; a library of
    another version, or a setting of the processor, may make it another.
    """
    began = working_time()
    assert chosen.setting.tolerance is not None
    observer, trace = once(chosen.setting.tolerance, False)
    steps, evaluations = (trace.counts.get(what, 0) for what in ("steps", "evaluations"))
    cost = Cost(1, steps, evaluations, working_time() - began)
    if trace.outcome is Outcome.INTERRUPTED:
        warning = "interrupted before it came to its end"
        return RunEstimate(observer, trace, math.inf, cost, (warning,))
    made = (trace.outcome.name, len(trace.arcs), steps, evaluations)
    if made != (chosen.outcome, chosen.flows, chosen.steps, chosen.evaluations):
        return None
    endless = tuple(sorted(Outputs(observer).endless(trace)))
    return RunEstimate(observer, trace, chosen.error, cost, (), endless, chosen.decides)


def _counts_events(run: EvaluatedRun) -> bool:
    """Whether a run has outputs that count or list events, of which there is an end."""
    counted = {name for name, value in run.outputs.items() if isinstance(value, int | list)}
    return not counted <= run.endless


def _identical(one: Trace, other: Trace) -> bool:
    times = [[jump.t for jump in trace.jumps] for trace in (one, other)]
    return times[0] == times[1] and np.array_equal(one.final, other.final)
