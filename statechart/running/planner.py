"""Runs for a requested accuracy or time budget, of which the best is delivered."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from statechart.automaton.trace import Outcome, Trace
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting
from statechart.engines.budget import Allowance
from statechart.engines.choice import choose
from statechart.engines.request import Plan
from statechart.execution.time_stepping import SteppingSimulator
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.accuracy import WITHOUT_ERROR, Cost, RunEstimate, replay, tighten, within
from statechart.running.step_refinement import FIRST_SHARE, refine


class RunPlanner:
    """Makes the runs that a plan asks for.

    Attributes
    ----------
    first : Setting
        Setting that a run is tried with first.
    setting : Setting
        That of the last run: with another engine where the first choice could not make it.
    reason : str
        Why an engine was taken that nobody asked for; else empty.
    searching : bool
        Whether the tolerance, or the step, is searched for.
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
            return RunEstimate(observer, trace, None, Cost(1, 0, 0, 0.0)), self._plan.basis
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
            self._allowance.lift()
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

        It cannot expand every flow, and there may be no time to compile the first.
        """
        picked = self.setting.engine == "auto" and trace.engine.startswith("taylor")
        late = trace.outcome is Outcome.OUT_OF_BUDGET and not trace.arcs
        if not (picked and (late or trace.outcome is Outcome.UNSUPPORTED)):
            return False
        self.setting = replace(self.setting, engine="scipy")
        self.reason = f"engine scipy: {trace.message}"
        return True

    def _search(
        self, overrides: Mapping[str, float], end: float, spent: float = 0.0
    ) -> tuple[RunEstimate, str]:
        """Search for the accuracy, or the best in the time of which some is `spent`."""
        setting, plan, basis = self.setting, self._plan, self._plan.basis

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            return self._once(replace(setting, tolerance=tolerance), overrides, end, off=off)

        def stepped(step: float) -> tuple[Observer, Trace]:
            return self._once(replace(setting, accuracy=None, step=step), overrides, end)

        if setting.stepped:
            assert setting.accuracy is not None
            longest = setting.step or FIRST_SHARE * end or 1.0
            return refine(stepped, setting.accuracy, first=longest, end=end), basis
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
