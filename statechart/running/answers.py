"""What is asked of a model becomes runs of it, and one of them the answer."""

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
from statechart.running.answer import UNTOLD, Answer, Cost
from statechart.running.confirmed import confirmed
from statechart.running.estimate import tighten, within
from statechart.running.halving import SHARE, halve

_ONCE = Cost(1, 0, 0, 0.0)


class Answers:
    """Makes the runs that a plan asks for.

    Parameters
    ----------
    model : Declaration
        What is run.
    observers : Observers
        Simulators of it at any setting.
    plan : Plan
        How to go about it.
    allowance : Allowance or None
        The time that all runs of an answer share.

    Attributes
    ----------
    setting : Setting
        That of the plan, with another engine where the one that was picked could not make the last
        run.
    reason : str
        Why an engine was taken that nobody asked for; else empty.
    """

    def __init__(
        self,
        model: Declaration,
        observers: Observers,
        plan: Plan,
        allowance: Allowance | None,
    ) -> None:
        self._limit = model.settings.max_jumps
        self._observers, self._plan, self._allowance = observers, plan, allowance
        self.setting, self.reason = plan.setting, plan.reason
        if not self.setting.stepped:
            _, self.reason = choose(self.setting)
        self._first = self.setting, self.reason

    @property
    def first(self) -> Setting:
        """How a run is tried first."""
        return self._first[0]

    @property
    def searching(self) -> bool:
        """Whether the tolerance, or the step, is looked for."""
        return self.setting.accuracy is not None or self.setting.budget is not None

    def answer(self, overrides: Mapping[str, float], end: float) -> tuple[Answer, str]:
        """Return the run asked for, and what it was chosen by."""
        # What another run could not do says nothing of this one, which may enter other modes.
        self.setting, self.reason = self._first
        if not self.searching:
            observer, trace = self._once(self.setting, overrides, end)
            if self._other_engine(trace):
                observer, trace = self._once(self.setting, overrides, end)
            return Answer(observer, trace, None, _ONCE), self._plan.basis
        if self._allowance is not None:
            self._allowance.begin()
        answer, basis = self._found(overrides, end)
        if self._other_engine(answer.trace):
            vain = answer.cost
            answer, basis = self._found(overrides, end, vain.seconds)
            answer = replace(answer, cost=vain + answer.cost)
        return answer, basis

    def certified(self, answer: Answer, overrides: Mapping[str, float], end: float) -> Trace:
        """Return the run of an answer with what is proved of its motion."""
        trace, simulator = answer.trace, answer.observer.simulator
        untold = trace.outcome in (*UNTOLD, Outcome.INTERRUPTED)
        if untold or isinstance(simulator, SteppingSimulator):
            return trace
        if self._allowance is not None:
            self._allowance.lift()
        return simulator.certified(trace, overrides, until=end, max_jumps=self._limit)

    def _once(
        self, setting: Setting, overrides: Mapping[str, float], end: float, *, off: bool = False
    ) -> tuple[Observer, Trace]:
        observer = self._observers.at(setting, off=off)
        return observer, observer.simulator.run(
            overrides, until=end, max_jumps=self._limit, throw=False
        )

    def _other_engine(self, trace: Trace) -> bool:
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

    def _found(
        self, overrides: Mapping[str, float], end: float, spent: float = 0.0
    ) -> tuple[Answer, str]:
        """Look for the accuracy asked for, or the best in the time of which some is `spent`."""
        setting, plan, basis = self.setting, self._plan, self._plan.basis

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            return self._once(replace(setting, tolerance=tolerance), overrides, end, off=off)

        def at(step: float) -> tuple[Observer, Trace]:
            return self._once(replace(setting, accuracy=None, step=step), overrides, end)

        if setting.stepped:
            assert setting.accuracy is not None
            longest = setting.step or SHARE * end or 1.0
            return halve(at, setting.accuracy, first=longest, end=end), basis
        floor = self._observers.floor(setting)
        first = self._observers.first(setting) if plan.first is None else plan.first
        if self._allowance is not None:
            allowed = self._allowance.seconds
            return within(once, allowed, spent=spent, first=first, floor=floor), basis
        assert setting.accuracy is not None
        if plan.chosen is not None:
            answer = confirmed(once, plan.chosen)
            if answer is not None:
                return answer, f"{basis}, as that run"
            basis += ", which runs otherwise here"
        return tighten(once, setting.accuracy, first=first, floor=floor), basis
