"""Where `statechart trade` runs a model at a setting, takes the time and compares."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Outcome, Trace
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting
from statechart.execution.outcome import error_of
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.accuracy import Cost, RunEstimate, tighten
from statechart.study.point import Errors, Point
from statechart.study.record import Study
from statechart.study.reference import References, Run, errors_of

# Repeats end once they took so many seconds.
_ENOUGH = 2.0
# Where events fall between two steps decides the error of one run: what is told of a step is the
# worst of runs at these parts of it.
_PARTS = (1.0, 0.983, 0.967, 0.951)


@dataclass(frozen=True, eq=False)
class Bench:
    """Runs a model at settings, and takes the time."""

    model: Declaration
    automaton: Automaton
    until: float
    repeats: int
    clock: Callable[[], float]
    cold: Callable[[Setting], float | None]

    def reference(self, mark: str) -> tuple[Run, Study]:
        """Make what runs are compared with; see `References.make`."""
        return References(self.model, self.automaton, self.until, self.once).make(mark)

    def once(self, observer: Observer) -> Trace:
        """Run the model."""
        return observer.simulator.run(
            until=self.until, max_jumps=self.model.settings.max_jumps, throw=False
        )

    def answerer(self, setting: Setting) -> Callable[[], RunEstimate]:
        """Return what makes the run of a setting; what it compiles is kept for the next time."""
        observers = Observers(self.automaton)

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            observer = observers.at(replace(setting, tolerance=tolerance), off=off)
            return observer, self.once(observer)

        def answer() -> RunEstimate:
            if setting.accuracy is not None:
                floor, first = observers.floor(setting), observers.first(setting)
                return tighten(once, setting.accuracy, floor=floor, first=first)
            observer = observers.at(setting)
            trace = self.once(observer)
            counts = trace.counts
            cost = Cost(1, counts.get("steps", 0), counts.get("evaluations", 0), 0.0)
            return RunEstimate(observer, trace, None, cost)

        return answer

    def measure(self, setting: Setting, reference: Run) -> Point:
        """Run a setting and compare it.

        Raises
        ------
        KeyboardInterrupt
            If the user interrupted it.
        StatechartError
            If the engine cannot run the model.
        """
        step = setting.step
        settings = (
            [setting] if step is None else [replace(setting, step=part * step) for part in _PARTS]
        )
        answers = [self.answerer(one) for one in settings]

        def timed(answer: Callable[[], RunEstimate]) -> tuple[RunEstimate, float]:
            began = self.clock()
            found = answer()
            if found.trace.outcome is Outcome.INTERRUPTED:
                raise KeyboardInterrupt
            if found.trace.outcome is Outcome.UNSUPPORTED:
                raise error_of(found.trace)
            return found, self.clock() - began

        found, _ = timed(answers[0])
        shown = [found]
        times: list[float] = []
        # The first run compiles, however long it takes: times are of those that follow.
        while (len(times) < self.repeats and sum(times) < _ENOUGH) or len(shown) < len(answers):
            again, seconds = timed(answers[len(shown) % len(answers)])
            shown.append(again)
            times.append(seconds)
        seconds = statistics.median(times)
        compared = shown[-len(answers) :]
        errors, diverged, left = self._worst(reference, setting, compared)
        return Point(
            setting=setting,
            outcome=found.trace.outcome.name,
            same_modes=diverged is None,
            diverged=diverged,
            parted=left,
            refused=found.warnings[0] if found.warnings else "",
            warnings=tuple(dict.fromkeys(text for one in compared for text in one.trace.warnings)),
            errors=errors,
            seconds=seconds,
            repeats=len(times),
            cold=self.cold(setting),
            steps=found.cost.steps,
            evaluations=found.cost.evaluations,
            flows=len(found.trace.arcs),
        )

    def _worst(
        self, reference: Run, setting: Setting, answers: Sequence[RunEstimate]
    ) -> tuple[Errors, float | None, float | None]:
        """Return the largest errors of runs, and when the first took other modes and left."""
        runs = [Run.of(setting, answer.observer, answer.trace) for answer in answers]
        pairs = [errors_of(self.model, reference, run) for run in runs]
        left = [reference.left(run) for run in runs]
        return (
            reduce(Errors.worse, [errors for errors, _ in pairs]),
            min((t for _, t in pairs if t is not None), default=None),
            min((t for t in left if t is not None), default=None),
        )
