"""Global error estimation and control by differences of runs.

`tighten` reaches an accuracy by decreasing tolerances, `refine` by decreasing time steps;
`run_within_budget` reaches the best accuracy in a time budget; `replay` repeats a run that a study
measured. `RunPlanner` selects among them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.documents.setting import Setting
from statechart.engines.engine import TimeBudget
from statechart.engines.request import TIGHTER, Chosen, Plan, choose
from statechart.errors import DeclarationError, DeclarationProblem
from statechart.execution.flow import STIFF
from statechart.execution.perturbation import Start
from statechart.execution.time_stepping import SteppingSimulator
from statechart.observation.alignment import pair_jumps
from statechart.observation.difference import Difference, compare, distance, mode_disagreement
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.observation.outputs import outputs_of
from statechart.observation.scales import OutputValue, Scales
from statechart.tabular import pluralise

WITHOUT_ERROR = (Outcome.OUT_OF_BUDGET, Outcome.UNSUPPORTED)
"""Outcomes of runs without an error estimate."""
_CUT_SHORT = (Outcome.INTERRUPTED, Outcome.OUT_OF_BUDGET)

_BELOW = 1.0 / 10.0
"""First tolerance relative to the requested accuracy: errors exceed the tolerance by about this
factor."""

BRIEF = 1e-6
"""Modes that differ for less than this fraction of a run count as equal."""

# Search for the best accuracy within a time: first tolerance, and factor to the next. A method of
# order 5 takes three times as long for it, so at least a third of the time is used.
_FIRST, _STRIDE = 1e-4, TIGHTER**2
# Least expected ratio of the times of the next run and the last one.
_LONGER = 1.5
# This many times the time of one run allows a second, tighter one.
_ADVISED = 5.0
# Allowed overrun of a budget, as a factor and in seconds.
_OVERRUN, _MOMENT = 1.2, 0.05
# Tolerance ratio of the run that verifies the number of events.
_FAR = TIGHTER**2
# Two runs of many steps may agree to this by chance.
_ROUNDED = 32.0 * float(np.finfo(float).eps)
_NEARLY = 1.0 + 1e-9

# Richardson extrapolation of time stepping: order 1, x(h) = x + c h, so that the error of the finer
# of two runs is c h = (x(r h) - x(h)) / (r - 1). The place of an event between two steps is random
# and makes c random: a run is compared with four others, with steps longer by powers of sqrt(2).
SHORTER = math.sqrt(0.5)
"""Ratio of successive step sizes."""
FIRST_SHARE = 1e-3
"""Default of the first step, as a fraction of the run."""
_COMPARED = 4
"""Number of earlier runs in an estimate; their steps reach four times its own."""
_SAFE = 1.5
"""Safety factor. For one event at a random place, four first-order estimates are all below the
error in 12 % of cases; 1.5 times them in 3 %, and below half of it in 0.3 %."""
_MAX_STEPS = 2**20
"""Limit of the steps of a run: minutes, and the capacity of a trace."""
_SHORTEST = 2.0**-40
"""Least step, as a fraction of the run, if longer steps end runs early."""
_PATIENCE = 10
"""Number of runs, with steps down to 1/32, in which an estimate must have halved."""
_AT_REST = 1e-3
"""Fraction of the velocity tolerance at the start (1e-9 of the scene's scale) below which motion is
round-off, as of a block that sticks from the start."""

_STEP_TOO_LONG = (Outcome.STEP_TOO_LARGE, Outcome.UNSOLVED_IMPULSES)

Once = Callable[[float, bool], tuple[Observer, Trace]]
"""Runs a model at a tolerance; True: from a start perturbed by the tolerance."""


@dataclass(frozen=True)
class Cost:
    """Cost of one or several runs."""

    runs: int
    steps: int
    evaluations: int  # of the rates; 0 if not counted
    seconds: float  # wall time without compilation of kernels

    def __add__(self, other: Cost) -> Cost:
        """Return the sum of two costs."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Cost(*(mine + its for mine, its in pairs))


@dataclass(frozen=True)
class AccuracyRequest:
    """Request of an accuracy or a time budget instead of a tolerance, and its cost.

    Attributes
    ----------
    setting : Setting
        With the accuracy or budget.
    basis : str
        Source of the first tolerance or step.
    cost : Cost
        Cost of all runs.
    not_judged : tuple of str
        Outputs without an error estimate: the number of bounces of a Zeno sequence has no limit.
    decides : str
        The quantity with the largest error, with its values in two runs; else empty.
    """

    setting: Setting
    basis: str
    cost: Cost
    not_judged: tuple[str, ...] = ()
    decides: str = ""

    def reached(self, estimate: float | None) -> bool:
        """Return whether an error estimate satisfies the request; any does for a budget."""
        return estimate is not None and estimate <= (self.setting.accuracy or math.inf)

    def to_dict(self, estimate: float | None) -> dict[str, Any]:
        """Return the request as a JSON object."""
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

    observer: Observer
    trace: Trace
    # Largest difference from the run before; inf for different modes, None without one.
    error: float | None
    cost: Cost  # of all runs
    warnings: tuple[str, ...] = ()  # why the estimate misses the request
    not_judged: tuple[str, ...] = ()  # as of `AccuracyRequest`
    decides: str = ""


@dataclass(frozen=True, eq=False)
class EvaluatedRun:
    """A run with outputs and scales."""

    observer: Observer
    trace: Trace
    outputs: Mapping[str, OutputValue]
    scales: Scales
    truncated: Mapping[str, Sequence[int]]

    @classmethod
    def of(cls, observer: Observer, trace: Trace, *more: Any) -> Self:
        """Evaluate the outputs of a run; `more` are further fields of a subclass."""
        made = outputs_of(observer)
        cuts = made.truncated(trace)
        return cls(observer, trace, made.of(trace), made.scales(trace), cuts, *more)

    @property
    def endless(self) -> frozenset[str]:
        """The outputs that count or list events of Zeno sequences."""
        return frozenset(self.truncated)

    def difference(
        self, other: EvaluatedRun, scales: Scales, endless: Iterable[str] = (), **options: Any
    ) -> Difference:
        """Return the difference of another run; see `compare` for the options."""
        options["endless"] = {
            name: (self.truncated.get(name, ()), other.truncated.get(name, ()))
            for name in {*endless, *self.endless, *other.endless}
        }
        runs = self.trace, other.trace
        return compare(*runs, self.outputs, other.outputs, scales=scales, **options)

    @property
    def counts_events(self) -> bool:
        """True if outputs count or list events that are not endless."""
        counted = {name for name, value in self.outputs.items() if isinstance(value, int | list)}
        return not counted <= self.endless


class _Error(NamedTuple):
    """An error, and its quantity with the values in two runs."""

    size: float
    decides: str


_NO_ERROR = _Error(0.0, "")


class _Series:
    """A series of runs, with their cost and the estimated error of the last."""

    def __init__(
        self,
        once: Callable[..., tuple[Observer, Trace]],
        accuracy: float | None,
        clock: Callable[[], float] = working_time,
    ) -> None:
        self._once, self._clock, self._began = once, clock, clock()
        self._accuracy = accuracy
        self._brief = accuracy or BRIEF
        self.runs = self._steps = self._evaluations = 0
        self._error: _Error | None = None
        self._endless: frozenset[str] = frozenset()

    def make(self, *how: Any) -> tuple[Observer, Trace]:
        observer, trace = self._once(*how)
        self.runs += 1
        self._steps += trace.counts.get("steps", 0)
        self._evaluations += trace.counts.get("evaluations", 0)
        return observer, trace

    @property
    def error(self) -> float | None:
        return None if self._error is None else self._error.size

    @property
    def seconds(self) -> float:
        return self._clock() - self._began

    @property
    def cost(self) -> Cost:
        return Cost(self.runs, self._steps, self._evaluations, self.seconds)

    def estimate(
        self, observer: Observer, trace: Trace, warnings: tuple[str, ...] = ()
    ) -> RunEstimate:
        decides = "" if self._error is None else self._error.decides
        endless = tuple(sorted(self._endless))
        return RunEstimate(observer, trace, self.error, self.cost, warnings, endless, decides)

    def interrupted(self, observer: Observer, trace: Trace) -> RunEstimate:
        """Return an interrupted run, without error estimate."""
        warning = "interrupted before its error was estimated"
        return RunEstimate(observer, trace, math.inf, self.cost, (warning,))


class _Tightened(_Series):
    """Runs at decreasing tolerances."""

    def __init__(
        self,
        once: Once,
        floor: float,
        accuracy: float | None = None,
        clock: Callable[[], float] = working_time,
    ) -> None:
        super().__init__(once, accuracy, clock)
        self._floor = floor
        self._last: EvaluatedRun | None = None
        self.diverged = ""
        self._merged: float | None = None

    def compare(self, observer: Observer, trace: Trace, *, last: bool = False) -> None:
        """Estimate the error of a run by its difference from the one before.

        Two runs may agree by chance, or because their flows are polynomials. If they agree well, or
        this run is the `last`, a third run from a perturbed start bounds the error from below.
        """
        now = EvaluatedRun.of(observer, trace)
        if self._last is None and last:
            # The first run is at the least tolerance: no other is needed.
            self._error = self._magnified(now)
        elif self._last is not None:
            before = self._last.trace
            words = f"at the tolerances {before.tolerance:.2g} and"
            error = self._difference(self._last, now, words)
            well = trace.tolerance if self._accuracy is None else self._accuracy
            if error.size <= well or (last and error.size < math.inf):
                error = max(error, self._grown(self._last, now, well))
            if error.size <= well and trace.tolerance > _NEARLY * _FAR * before.tolerance:
                error = max(error, self._counted(now))
            self._error = error
        self._last = now

    def _grown(self, before: EvaluatedRun, now: EvaluatedRun, well: float) -> _Error:
        """Return the effect of a perturbation by the tolerance; 0 if unknown.

        Computed with the run before, which is cheaper, and scaled, unless its modes differ.
        """
        found = self._magnified(before)
        if found is not None:
            shrunk = found.size * (now.trace.tolerance / before.trace.tolerance)
            if shrunk <= well:
                return found._replace(size=shrunk)
        return self._magnified(now) or _NO_ERROR

    def _magnified(self, now: EvaluatedRun) -> _Error | None:
        """Return the difference from a run with a perturbed start, or None."""
        try:
            observer, trace = self.make(now.trace.tolerance, True)
        except DeclarationError:
            return None  # no valid initial state
        times, known = ([jump.t for jump in one.jumps] for one in (trace, now.trace))
        identical = times == known and np.array_equal(trace.final, now.trace.final)
        if identical or trace.outcome in _CUT_SHORT:
            return None
        words = "with gaps and from starts that differ by the tolerance"
        return self._difference(EvaluatedRun.of(observer, trace), now, words)

    def _counted(self, now: EvaluatedRun) -> _Error:
        """Return the difference from a far tighter run; 0 without outputs that count events.

        Impacts within the tolerance of each other merge, alike in runs of similar tolerance.
        """
        tolerance = max(now.trace.tolerance * _FAR, self._floor)
        if not (now.counts_events and tolerance < now.trace.tolerance):
            return _NO_ERROR
        observer, trace = self.make(tolerance, False)
        if trace.outcome in _CUT_SHORT:
            return _NO_ERROR
        tighter = EvaluatedRun.of(observer, trace)
        return self._difference(now, tighter, "at very different tolerances, to")

    @property
    def stride(self) -> float:
        """Ratio of the second tolerance; smaller if events are counted."""
        return _FAR if self._last is not None and self._last.counts_events else TIGHTER

    def _difference(self, one: EvaluatedRun, other: EvaluatedRun, how: str) -> _Error:
        # The resolved number of events of a Zeno sequence depends on the tolerance.
        self._endless = one.endless | other.endless
        found = one.difference(other, other.scales, brief=self._brief)
        runs, self.diverged = f"runs {how} {other.trace.tolerance:.2g}", ""
        if found.diverged is None:
            # Events in only one of the runs that do not change the result.
            _, self._merged = pair_jumps(one.trace, other.trace)
        else:
            self.diverged = (
                f"{runs} take different modes from t = {found.diverged:.6g} on: no accuracy can be "
                "stated after it"
            )
        if found.diverged is None and found.outputs == math.inf:
            names = [name for name, off in found.named.items() if off == math.inf]
            self.diverged = f"only one of the {runs} has the outputs {', '.join(names)}"
        decides = str(found.decides) if found.decides.off > 0.0 else ""
        return _Error(max(found.largest, _ROUNDED), decides)

    @property
    def warnings(self) -> tuple[str, ...]:
        if self.diverged:
            return (self.diverged,)
        if self._merged is None:
            return ()
        return (
            f"from t = {self._merged:.6g} on the runs differ in modes shorter than "
            f"{self._brief:g} of the run, which the error estimate ignores",
        )


def tighten(
    once: Once, accuracy: float, *, floor: float, first: float | None = None
) -> RunEstimate:
    """Run at decreasing tolerances until two runs differ by at most `accuracy`."""
    tolerance = max(accuracy * _BELOW if first is None else first, floor)
    runs = _Tightened(once, floor, accuracy)
    observer, trace = runs.make(tolerance, False)
    if trace.outcome is Outcome.UNSUPPORTED:
        return RunEstimate(observer, trace, None, runs.cost)
    while trace.outcome is not Outcome.INTERRUPTED:
        runs.compare(observer, trace, last=tolerance <= floor)
        if runs.error is not None and (runs.error <= accuracy or tolerance <= floor):
            break
        if tolerance <= floor:
            runs.compare(*runs.make(floor / TIGHTER, False))
            continue
        stride = runs.stride if runs.runs == 1 else TIGHTER
        tolerance = max(tolerance * stride, floor)
        observer, trace = runs.make(tolerance, False)
    else:
        return runs.interrupted(observer, trace)
    found = runs.estimate(observer, trace, runs.warnings)
    assert found.error is not None
    if found.error <= accuracy:
        return found
    missed = runs.diverged or (
        f"the accuracy {accuracy:g} was not reached: at the smallest tolerance the estimated "
        f"error is {found.error:.2g}, in {found.decides}"
    )
    return replace(found, warnings=(missed,))


def run_within_budget(
    once: Once,
    budget: float,
    *,
    spent: float = 0.0,
    floor: float,
    first: float | None = None,
    clock: Callable[[], float] = working_time,
) -> RunEstimate:
    """Return the most accurate run within a time budget.

    `once` ends a run with `Outcome.OUT_OF_BUDGET` when the time is up; `spent` of the `budget`
    passed before. `first` and `floor` are the first and least tolerance. If no run completes, the
    partial first one is returned.
    """
    tolerance, stride = (_FIRST, _STRIDE) if first is None else (first, TIGHTER)
    tolerance = max(tolerance, floor)
    runs = _Tightened(once, floor, clock=clock)
    best: RunEstimate | None = None
    while True:
        began = runs.seconds
        observer, trace = runs.make(tolerance, False)
        took = runs.seconds - began
        cut = trace.outcome in (*WITHOUT_ERROR, Outcome.INTERRUPTED)
        if cut and best is not None:
            break
        if not cut:
            runs.compare(observer, trace, last=tolerance <= floor)
        best = runs.estimate(observer, trace, runs.warnings)
        if cut or tolerance <= floor or spent + runs.seconds + _LONGER * took > budget:
            break
        tolerance = max(tolerance * stride, floor)
    taken, warnings = spent + runs.seconds, best.warnings
    over = taken > max(_OVERRUN * budget, budget + _MOMENT)
    reason = "as the compilation of a mode is not interrupted"
    if best.error is None and best.trace.outcome not in WITHOUT_ERROR:
        exceeded = f", of {taken:.2g} s, {reason}" if over else ""
        advice = f"for an error estimate take --budget {_ADVISED * taken:.2g}"
        warnings = (f"the budget of {budget:g} s allowed one run{exceeded}; {advice}",)
    elif over:
        words = f"the run took {taken:.2g} s, more than the budget of {budget:g} s"
        warnings += (f"{words}, {reason}; the next run needs none",)
    return replace(best, warnings=warnings, cost=runs.cost)


def replay(once: Once, chosen: Chosen) -> RunEstimate | None:
    """Repeat a run that a study measured, with its measured error; None if it differs.

    Outcome, flows, steps and evaluations identify the run; other libraries or processors may change
    it.
    """
    assert chosen.setting.tolerance is not None
    series = _Series(once, None)
    observer, trace = series.make(chosen.setting.tolerance, False)
    cost = series.cost
    if trace.outcome is Outcome.INTERRUPTED:
        return series.interrupted(observer, trace)
    made = (trace.outcome.name, len(trace.arcs), cost.steps, cost.evaluations)
    if made != (chosen.outcome, chosen.flows, chosen.steps, chosen.evaluations):
        return None
    endless = tuple(sorted(outputs_of(observer).truncated(trace)))
    return RunEstimate(observer, trace, chosen.error, cost, (), endless, chosen.decides)


class _Refined(_Series):
    """Runs at decreasing steps, each compared with the four before."""

    def __init__(self, once: Callable[[float], tuple[Observer, Trace]], accuracy: float) -> None:
        super().__init__(once, accuracy)
        self._before: deque[EvaluatedRun] = deque(maxlen=_COMPARED)
        self._estimates: list[float] = []
        self._reason = ""

    def compare(self, observer: Observer, trace: Trace) -> RunEstimate:
        """Return a run with its estimated error; inf after too few runs."""
        now, decides, error = EvaluatedRun.of(observer, trace), "", math.inf
        if len(self._before) == _COMPARED:
            self._endless = now.endless.union(*(run.endless for run in self._before))
            errors = []
            for run in self._before:
                size, decides, diverged = self._distance(run, now)
                errors.append(size / (_step(run) / _step(now) - 1.0))
            error = _SAFE * max(errors)
            self._reason = f". Runs at two steps differ most in {decides}"
            if diverged is not None:
                self._reason += f", and take different modes from t = {diverged:.6g} on"
        self._before.append(now)
        self._estimates.append(error)
        self._error = _Error(error, decides)
        return self.estimate(observer, trace)

    def missed(self, found: RunEstimate, why: str) -> RunEstimate:
        """Return a run that misses the accuracy, with a warning."""
        warning = (
            f"the accuracy {self._accuracy:g} was not reached: at a step of {found.trace.step:.2g} "
            f"the estimated error is {found.error:.2g}, and {why}{self._reason}"
        )
        return replace(found, cost=self.cost, warnings=(warning,))

    @property
    def stuck(self) -> bool:
        """True if the estimate does not converge with the step."""
        known = self._estimates[_COMPARED:]
        return len(known) > _PATIENCE and not known[-1] < 0.5 * known[-1 - _PATIENCE]

    def _distance(
        self, coarse: EvaluatedRun, fine: EvaluatedRun
    ) -> tuple[float, str, float | None]:
        """Return the difference of two runs, its quantity, and the time of the first other mode."""
        options = {
            "brief": self._brief,
            "nothing": _AT_REST * fine.trace.tolerances.get("speed", 0.0),
        }
        found = coarse.difference(fine, fine.scales, self._endless, **options)
        parts = {str(found.decides): max(found.state, found.times, found.outputs)}
        if found.diverged is not None and max(parts.values()) < math.inf:
            # The number of resolved bounces depends on the step: only the path converges, and the
            # duration of other modes (Moreau 1999).
            runs = coarse.trace, fine.trace
            parts |= {"the modes": mode_disagreement(*runs), "the path": distance(*runs)}
        quantity = max(parts, key=parts.__getitem__)
        return parts[quantity], quantity, found.diverged


def refine(
    once: Callable[[float], tuple[Observer, Trace]], accuracy: float, *, first: float, end: float
) -> RunEstimate:
    """Run at decreasing steps until the estimated error is at most `accuracy`."""
    runs = _Refined(once, accuracy)
    step = min(first, end) or first
    last: RunEstimate | None = None
    while True:
        observer, trace = runs.make(step)
        if trace.outcome is Outcome.INTERRUPTED:
            return runs.interrupted(observer, trace)
        if trace.outcome is Outcome.TOO_LONG:
            if last is not None:
                return runs.missed(last, "a run at a shorter step is too long to be stored")
            return RunEstimate(observer, trace, None, runs.cost)
        taken = trace.counts["steps"]
        if trace.outcome in _STEP_TOO_LONG:
            if taken > _MAX_STEPS or step < _SHORTEST * end:
                return RunEstimate(observer, trace, None, runs.cost)
            last, step = None, 0.5 * step
            continue
        last = runs.compare(observer, trace)
        assert last.error is not None
        if last.error <= accuracy:
            return last
        if runs.stuck:
            return runs.missed(last, "shorter steps do not reduce the difference")
        if taken > _MAX_STEPS * SHORTER:
            return runs.missed(last, f"it took {pluralise(taken, 'step')}")
        step *= SHORTER


def _step(run: EvaluatedRun) -> float:
    assert run.trace.step is not None
    return run.trace.step


class RunPlanner:
    """Runs a model by a plan.

    `first` is the setting tried first; `setting` is that of the last run, with another engine if
    the first choice failed for `reason`. `searching` is true for an accuracy or a budget.
    """

    def __init__(self, observers: Observers, plan: Plan, time_budget: TimeBudget | None) -> None:
        self._observers, self._plan, self._time_budget = observers, plan, time_budget
        self.first = self.setting = plan.setting
        self.reason = plan.reason if plan.setting.stepped else choose(plan.setting)[1]
        self._first_reason = self.reason
        self.searching = self.first.accuracy is not None or self.first.budget is not None

    def run(self, overrides: Mapping[str, float], end: float) -> tuple[RunEstimate, str]:
        """Return the run, and the source of its first tolerance or step."""
        # Each run tries the first engine, since it may enter other modes.
        self.setting, self.reason = self.first, self._first_reason
        if not self.searching:
            observer, trace = self._once(self.setting, overrides, end)
            if self._change_engine(trace):
                observer, trace = self._once(self.setting, overrides, end)
            counts = trace.counts
            cost = Cost(1, counts.get("steps", 0), counts.get("evaluations", 0), 0.0)
            return RunEstimate(observer, trace, None, cost), self._plan.basis
        if self._time_budget is not None:
            self._time_budget.begin()
        found, basis = self._search(overrides, end)
        if self._change_engine(found.trace):
            vain = found.cost
            found, basis = self._search(overrides, end, vain.seconds)
            found = replace(found, cost=vain + found.cost)
        return found, basis

    def certified(self, found: RunEstimate, overrides: Mapping[str, float], end: float) -> Trace:
        """Return the trace of a run with proved bounds of its defect."""
        trace, simulator = found.trace, found.observer.simulator
        ended = trace.outcome in (*WITHOUT_ERROR, Outcome.INTERRUPTED)
        if ended or isinstance(simulator, SteppingSimulator):
            return trace
        if self._time_budget is not None:
            self._time_budget.remove_limit()
        return simulator.certified(trace, overrides, until=end)

    def _once(
        self,
        setting: Setting,
        overrides: Mapping[str, float],
        end: float,
        start: Start = Start.DECLARED,
    ) -> tuple[Observer, Trace]:
        observer, other = self._observers.at(setting, start), Start.DECREASED
        try:
            trace = observer.simulator.run(overrides, until=end, throw=False)
            starts = trace.t_end > 0.0 or trace.outcome is not Outcome.NON_FINITE
            if start is Start.DECLARED or starts:
                return observer, trace
        except DeclarationProblem:
            if start is Start.DECLARED:
                raise
            # The perturbed start keeps its constraints within the tolerances of the run only.
            other = Start.INCREASED_WITH_TOLERANCES
        observer = self._observers.at(setting, other)
        return observer, observer.simulator.run(overrides, until=end, throw=False)

    def _change_engine(self, trace: Trace) -> bool:
        """Fall back from taylor to scipy if it cannot run the model; return whether it did.

        Taylor cannot expand every flow, and its steps collapse on stiff ones.
        """
        picked = self.setting.engine == "auto" and trace.engine.startswith("taylor")
        if not (picked and trace.outcome is Outcome.UNSUPPORTED):
            return False
        method, why = self.setting.method, trace.message
        if STIFF in why:
            method = "Radau"
        self.setting = replace(self.setting, engine="scipy", method=method)
        self.reason = f"engine scipy{' Radau' if STIFF in why else ''}: {why.partition('; use')[0]}"
        return True

    def _search(
        self, overrides: Mapping[str, float], end: float, spent: float = 0.0
    ) -> tuple[RunEstimate, str]:
        """Search for the accuracy, or the best one in the remaining budget."""
        setting, plan, basis = self.setting, self._plan, self._plan.basis

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            start = Start.INCREASED if off else Start.DECLARED
            return self._once(replace(setting, tolerance=tolerance), overrides, end, start)

        def run_step(step: float) -> tuple[Observer, Trace]:
            return self._once(replace(setting, accuracy=None, step=step), overrides, end)

        if setting.stepped:
            assert setting.accuracy is not None
            longest = setting.step or FIRST_SHARE * end or 1.0
            return refine(run_step, setting.accuracy, first=longest, end=end), basis
        floor = self._observers.floor(setting)
        first = self._observers.first(setting) if plan.first is None else plan.first
        if self._time_budget is not None:
            allowed = self._time_budget.seconds
            return run_within_budget(once, allowed, spent=spent, first=first, floor=floor), basis
        assert setting.accuracy is not None
        if plan.chosen is not None:
            found = replay(once, plan.chosen)
            if found is not None:
                return found, f"{basis}, with the same result"
            basis += ", which gives another result here"
        return tighten(once, setting.accuracy, first=first, floor=floor), basis
