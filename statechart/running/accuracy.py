"""Error estimate and control: several runs, and what their differences show.

`tighten` delivers an accuracy at ever tighter tolerances, `refine` at ever shorter steps, `within`
the best accuracy in a time, `replay` a run that a study measured; `RunPlanner` chooses among them.
`EvaluatedRun` is compared, `RunEstimate` is the run delivered with its estimated error,
`AccuracyRequest` what a result keeps of the request.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, astuple, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting
from statechart.engines.engine import Allowance
from statechart.engines.request import TIGHTER, Chosen, Plan, choose
from statechart.errors import DeclarationError
from statechart.execution.flow import STIFF
from statechart.execution.time_stepping import SteppingSimulator
from statechart.observation.difference import (
    Difference,
    compare,
    distance,
    mode_disagreement,
    paired,
)
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.observation.outputs import outputs_of
from statechart.observation.scales import OutputValue, Scales
from statechart.tabular import several

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

# Steps of bodies: the scheme is of first order, x(h) = x + c h, so that two runs tell the error of
# the finer one, c h = (x(r h) - x(h)) / (r - 1). But an event falls anywhere between two steps, so
# that c is another number in every run, and two runs agree by luck. Steps shorten by the square
# root of 1/2, whose powers put no event at the same place between steps twice, and a run is
# compared with four.
SHORTER = math.sqrt(0.5)
"""The factor from one step size to the next."""
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
        pairs = zip(astuple(self), astuple(other), strict=True)
        return Cost(*(mine + its for mine, its in pairs))


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
        """Return whether an error estimate satisfies the request; a budget takes any estimate."""
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
        made = outputs_of(observer)
        return cls(observer, trace, made.of(trace), made.scales(trace), made.endless(trace))

    def difference(self, other: EvaluatedRun, scales: Scales, **options: Any) -> Difference:
        """Return the difference of another run from this one; see `compare` for the options."""
        options.setdefault("endless", self.endless | other.endless)
        return compare(
            self.trace, other.trace, self.outputs, other.outputs, scales=scales, **options
        )

    @property
    def counts_events(self) -> bool:
        """True if outputs count or list events that are not endless."""
        counted = {name for name, value in self.outputs.items() if isinstance(value, int | list)}
        return not counted <= self.endless


class _Error(NamedTuple):
    """An error, and the quantity that it belongs to with its values in two runs."""

    size: float
    decides: str


_NO_ERROR = _Error(0.0, "")


class _Series:
    """Several runs of a model, with their cost and the estimated error of the last."""

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
        """Return a run that a signal ended: its error is unknown."""
        warning = "interrupted before its error was estimated"
        return RunEstimate(observer, trace, math.inf, self.cost, (warning,))


class _Tightened(_Series):
    """Runs at ever tighter tolerances, and how the last two differ."""

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

    def _grown(self, before: EvaluatedRun, now: EvaluatedRun, well: float) -> _Error:
        """Return the error that the tolerance becomes at the end; 0 where it is unknown.

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
            observer, trace = self.make(now.trace.tolerance, True)
        except DeclarationError:
            # Off by so much, the start is no start.
            return None
        if _identical(trace, now.trace) or trace.outcome in _CUT_SHORT:
            return None
        words = "with gaps and from starts that differ by the tolerance"
        return self._difference(EvaluatedRun.of(observer, trace), now, words)

    def _counted(self, now: EvaluatedRun) -> _Error:
        """Return the difference from a far tighter run; 0 where no events are counted or listed.

        Impacts that follow each other within the tolerance are one, and two runs whose tolerances
        are near each other may agree on that.
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
        """Factor to the second tolerance; far smaller where events are counted."""
        return _FAR if self._last is not None and self._last.counts_events else TIGHTER

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
            (
                f"from t = {self._merged:.6g} on the runs differ in modes shorter than "
                f"{self._brief:g} of the run, which the error estimate ignores"
            ),
        )


def tighten(
    once: Once, accuracy: float, *, floor: float, first: float | None = None
) -> RunEstimate:
    """Run at ever tighter tolerances until two runs differ by no more than `accuracy`."""
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

    `once` makes a run, and ends it with `Outcome.OUT_OF_BUDGET` once the time is up; `spent` of the
    `budget` passed before the first. `first` is the tolerance to begin with, where the time of runs
    is known, `floor` the least. If no run ended in time, the first is returned as far as it came.
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
    if best.error is None and best.trace.outcome not in WITHOUT_ERROR:
        late = (
            f", of {taken:.2g} s, as the compilation of a mode is not interrupted" if over else ""
        )
        warnings = (
            (
                f"the budget of {budget:g} s allowed one run{late}; for an error estimate take "
                f"--budget {_ADVISED * taken:.2g}"
            ),
        )
    elif over:
        warnings += (
            (
                f"the run took {taken:.2g} s, more than the budget of {budget:g} s, as the "
                "compilation of a mode is not interrupted; the next run needs none"
            ),
        )
    return replace(best, warnings=warnings, cost=runs.cost)


def replay(once: Once, chosen: Chosen) -> RunEstimate | None:
    """Repeat a run that a study measured; None where it turns out as another one.

    Its error needs no further run to be estimated: that of the same run was measured against a
    reference. That it is the same shows in its end, its flows, steps and evaluations; a library of
    another version, or a setting of the processor, may make it another.
    """
    assert chosen.setting.tolerance is not None
    series = _Series(once, None)
    observer, trace = series.make(chosen.setting.tolerance, False)
    cost = series.cost
    if trace.outcome is Outcome.INTERRUPTED:
        warning = "interrupted before it came to its end"
        return RunEstimate(observer, trace, math.inf, cost, (warning,))
    made = (trace.outcome.name, len(trace.arcs), cost.steps, cost.evaluations)
    if made != (chosen.outcome, chosen.flows, chosen.steps, chosen.evaluations):
        return None
    endless = tuple(sorted(outputs_of(observer).endless(trace)))
    return RunEstimate(observer, trace, chosen.error, cost, (), endless, chosen.decides)


def _identical(one: Trace, other: Trace) -> bool:
    times = [[jump.t for jump in trace.jumps] for trace in (one, other)]
    return times[0] == times[1] and np.array_equal(one.final, other.final)


class _Refined(_Series):
    """Runs at ever shorter steps, of which each is compared with four before."""

    def __init__(self, once: Callable[[float], tuple[Observer, Trace]], accuracy: float) -> None:
        super().__init__(once, accuracy)
        self._before: deque[EvaluatedRun] = deque(maxlen=_COMPARED)
        self._estimates: list[float] = []
        self._reason = ""

    def compare(self, observer: Observer, trace: Trace) -> RunEstimate:
        """Return a run with its estimated error; inf where too few were made before it."""
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
        """Return a run that is less accurate than requested, with a warning."""
        warning = (
            f"the accuracy {self._accuracy:g} was not reached: at a step of {found.trace.step:.2g} "
            f"the estimated error is {found.error:.2g}, and {why}{self._reason}"
        )
        return replace(found, cost=self.cost, warnings=(warning,))

    @property
    def stuck(self) -> bool:
        """True if the estimate no longer falls with the step."""
        known = self._estimates[_COMPARED:]
        return len(known) > _PATIENCE and not known[-1] < 0.5 * known[-1 - _PATIENCE]

    def _distance(
        self, coarse: EvaluatedRun, fine: EvaluatedRun
    ) -> tuple[float, str, float | None]:
        """Return how far two runs differ, in which quantity, and when their modes first do."""
        found = coarse.difference(
            fine,
            fine.scales,
            endless=self._endless,
            brief=self._brief,
            nothing=_AT_REST * fine.trace.tolerances.get("speed", 0.0),
        )
        parts = {str(found.decides): max(found.state, found.times, found.outputs)}
        if found.diverged is not None and max(parts.values()) < math.inf:
            # How many bounces are resolved before rest follows from the step: what converges then
            # is the path, and for how long modes are others (Moreau 1999).
            runs = coarse.trace, fine.trace
            parts |= {"the modes": mode_disagreement(*runs), "the path": distance(*runs)}
        quantity = max(parts, key=parts.__getitem__)
        return parts[quantity], quantity, found.diverged


def refine(
    once: Callable[[float], tuple[Observer, Trace]], accuracy: float, *, first: float, end: float
) -> RunEstimate:
    """Run at ever shorter steps until the estimated error is no more than `accuracy`."""
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
            return runs.missed(last, f"it took {several(taken, 'step')}")
        step *= SHORTER


def _step(run: EvaluatedRun) -> float:
    assert run.trace.step is not None
    return run.trace.step


class RunPlanner:
    """Makes the runs that a plan asks for.

    A run is tried with the setting `first`; `setting` is that of the last run, with another engine
    where the first choice could not make it, and `reason` says why. `searching` is whether the
    tolerance, or the step, is searched for.
    """

    def __init__(
        self, model: Declaration, observers: Observers, plan: Plan, allowance: Allowance | None
    ) -> None:
        self._max_jumps = model.settings.max_jumps
        self._observers, self._plan, self._allowance = observers, plan, allowance
        self.first = self.setting = plan.setting
        self.reason = plan.reason if plan.setting.stepped else choose(plan.setting)[1]
        self._first_reason = self.reason
        self.searching = self.first.accuracy is not None or self.first.budget is not None

    def run(self, overrides: Mapping[str, float], end: float) -> tuple[RunEstimate, str]:
        """Return the run asked for, and how its first tolerance or step was chosen."""
        # What another run could not do says nothing of this one, which may enter other modes.
        self.setting, self.reason = self.first, self._first_reason
        if not self.searching:
            observer, trace = self._once(self.setting, overrides, end)
            if self._change_engine(trace):
                observer, trace = self._once(self.setting, overrides, end)
            counts = trace.counts
            cost = Cost(1, counts.get("steps", 0), counts.get("evaluations", 0), 0.0)
            return RunEstimate(observer, trace, None, cost), self._plan.basis
        if self._allowance is not None:
            self._allowance.begin()
        found, basis = self._search(overrides, end)
        if self._change_engine(found.trace):
            vain = found.cost
            found, basis = self._search(overrides, end, vain.seconds)
            found = replace(found, cost=vain + found.cost)
        return found, basis

    def certified(self, found: RunEstimate, overrides: Mapping[str, float], end: float) -> Trace:
        """Return the trace of a run with the proved bounds of its motion."""
        trace, simulator = found.trace, found.observer.simulator
        ended = trace.outcome in (*WITHOUT_ERROR, Outcome.INTERRUPTED)
        if ended or isinstance(simulator, SteppingSimulator):
            return trace
        if self._allowance is not None:
            self._allowance.remove_limit()
        return simulator.certified(trace, overrides, until=end, max_jumps=self._max_jumps)

    def _once(
        self, setting: Setting, overrides: Mapping[str, float], end: float, *, off: bool = False
    ) -> tuple[Observer, Trace]:
        observer = self._observers.at(setting, off=off)
        return observer, observer.simulator.run(
            overrides, until=end, max_jumps=self._max_jumps, throw=False
        )

    def _change_engine(self, trace: Trace) -> bool:
        """Take scipy where taylor was picked and cannot run the model; whether that is so.

        It cannot expand every flow, its steps collapse on stiff ones, and there may be no time to
        compile the first.
        """
        picked = self.setting.engine == "auto" and trace.engine.startswith("taylor")
        late = trace.outcome is Outcome.OUT_OF_BUDGET and not trace.arcs
        if not (picked and (late or trace.outcome is Outcome.UNSUPPORTED)):
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
        """Search for the accuracy, or the best in the time of which some is `spent`."""
        setting, plan, basis = self.setting, self._plan, self._plan.basis

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            return self._once(replace(setting, tolerance=tolerance), overrides, end, off=off)

        def run_step(step: float) -> tuple[Observer, Trace]:
            return self._once(replace(setting, accuracy=None, step=step), overrides, end)

        if setting.stepped:
            assert setting.accuracy is not None
            longest = setting.step or FIRST_SHARE * end or 1.0
            return refine(run_step, setting.accuracy, first=longest, end=end), basis
        floor = self._observers.floor(setting)
        first = self._observers.first(setting) if plan.first is None else plan.first
        if self._allowance is not None:
            allowed = self._allowance.seconds
            return within(once, allowed, spent=spent, first=first, floor=floor), basis
        assert setting.accuracy is not None
        if plan.chosen is not None:
            found = replay(once, plan.chosen)
            if found is not None:
                return found, f"{basis}, as that run"
            basis += ", which runs otherwise here"
        return tighten(once, setting.accuracy, first=first, floor=floor), basis
