"""Where `statechart trade` runs a model and takes the time: settings, and a reference for them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Jump, Outcome, Trace
from statechart.documents.declaration import Declaration
from statechart.documents.setting import LONG_DOUBLE, Setting
from statechart.errors import SimulationError, StatechartError
from statechart.execution.outcome import error_of
from statechart.execution.perturbation import widened
from statechart.loading.kind import offered
from statechart.observation.difference import compare, distance, paired, parted
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.observation.outputs import Outputs
from statechart.observation.outputs import OutputValue as Output
from statechart.running.estimate import BRIEF, Answer, Cost, tighten
from statechart.study.record import Errors, Point, Study

# References, the best first: any one is checked by the next of another engine, or another method
# of scipy, that can run the model. What steps in time is last, at parts of the run.
_REFERENCES = (
    Setting(engine="taylor", method=LONG_DOUBLE, tolerance=1.1e-19),
    Setting(engine="taylor", tolerance=2.2e-16),
    Setting(engine="scipy", method="DOP853", tolerance=2.3e-14),
    Setting(engine="scipy", method="LSODA", tolerance=1e-13),
)
_STEPS = (1e-4, 3e-4)
# Repeats end once they took so many seconds.
_ENOUGH = 2.0
# Where events fall between two steps decides the error of one run: what is told of a step is the
# worst of runs at these parts of it.
_PARTS = (1.0, 0.983, 0.967, 0.951)


@dataclass(frozen=True, eq=False)
class Run:
    """A run that others are compared with, or that is compared."""

    setting: Setting
    observer: Observer
    trace: Trace
    outputs: Mapping[str, Output]
    sizes: Mapping[str, Output]
    endless: frozenset[str]

    @classmethod
    def of(cls, setting: Setting, observer: Observer, trace: Trace) -> Run:
        """Evaluate the outputs of a trace."""
        outputs = Outputs(observer)
        return cls(
            setting,
            observer,
            trace,
            outputs.of(trace),
            outputs.sizes(trace),
            outputs.endless(trace),
        )

    def brief(self, other: Run) -> float:
        """Return for which part of the run the modes of another may differ from this reference's.

        A reference that steps in time knows no event better than to its step.
        """
        if self.setting.step is None:
            return BRIEF
        step = max(self.setting.step, other.setting.step or 0.0)
        return max(BRIEF, 2.0 * step / self.trace.t_end)

    def energies(self, jumps: Sequence[Jump]) -> Array | None:
        """Return the energy (m + 1,) before each of some jumps and at the end, if there is one."""
        if "energy" not in self.observer.automaton.observables:
            return None
        before = self.observer.at(self.trace, ["energy"], jumps, before=True)[:, 0]
        return np.append(before, self.observer.final(self.trace, ["energy"]))


@dataclass(frozen=True, eq=False)
class Bench:
    """Runs a model at settings, and takes the time."""

    model: Declaration
    automaton: Automaton
    until: float
    repeats: int
    clock: Callable[[], float]

    def reference(self, mark: str) -> tuple[Run, Study]:
        """Make the reference and the run that checks it.

        Parameters
        ----------
        mark : str
            Fingerprint of the model.

        Returns
        -------
        Run
            The reference.
        Study
            Of it, without points.

        Raises
        ------
        KeyboardInterrupt
            If the user interrupted one of them.
        SimulationError
            If not two of them come to the end of the run.
        """
        settings: tuple[Setting, ...] = _REFERENCES
        if self.automaton.stepper is not None:
            settings += tuple(
                Setting(engine="impulse", step=float(f"{self.until * part:.3g}")) for part in _STEPS
            )
        runs: list[Run] = []
        failures = []
        for setting in settings:
            if any(setting.engine == "taylor" == known.setting.engine for known in runs):
                continue
            try:
                runs.append(self._ended(setting, Observers(self.automaton).at(setting)))
            except StatechartError as error:
                failures.append(f"{setting.label}: {error}")
            if len(runs) == 2:
                break
        else:
            raise SimulationError(
                "no reference to compare with, two engines must reach the end of the run:\n  "
                + "\n  ".join(failures)
            )
        reference, check = runs
        setting, shift = reference.setting, Errors()
        if setting.step is None:
            late = self._ended(setting, Observers(widened(self.automaton)).at(setting))
            shift, _ = self.errors(reference, late)
        resolution, _ = self.errors(reference, check)
        study = Study(
            model=self.model.name,
            fingerprint=mark,
            until=self.until,
            reference=setting.label,
            check=check.setting.label,
            resolution=resolution,
            shift=shift,
            parted=parted(reference.trace, check.trace, brief=reference.brief(check)),
            step=check.setting.step or 0.0,
            planned=0,
        )
        return reference, study

    def _ended(self, setting: Setting, observer: Observer) -> Run:
        """Return a run that came to its end; raise where it did not."""
        trace = self.once(observer)
        if trace.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not trace.outcome.succeeded:
            raise error_of(trace)
        return Run.of(setting, observer, trace)

    def once(self, observer: Observer) -> Trace:
        """Run the model."""
        return observer.simulator.run(
            until=self.until, max_jumps=self.model.settings.max_jumps, throw=False
        )

    def answerer(self, setting: Setting) -> Callable[[], Answer]:
        """Return what makes the run of a setting; what it compiles is kept for the next time."""
        observers = Observers(self.automaton)

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            observer = observers.at(replace(setting, tolerance=tolerance), off=off)
            return observer, self.once(observer)

        def answer() -> Answer:
            if setting.accuracy is not None:
                return tighten(once, setting.accuracy, floor=observers.floor(setting))
            observer = observers.at(setting)
            trace = self.once(observer)
            counts = trace.counts
            cost = Cost(1, counts.get("steps", 0), counts.get("evaluations", 0), 0.0)
            return Answer(observer, trace, None, cost)

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

        def timed(answer: Callable[[], Answer]) -> tuple[Answer, float]:
            began = self.clock()
            found = answer()
            if found.trace.outcome is Outcome.INTERRUPTED:
                raise KeyboardInterrupt
            if found.trace.outcome is Outcome.UNSUPPORTED:
                raise error_of(found.trace)
            return found, self.clock() - began

        found, first = timed(answers[0])
        shown = [found]
        times: list[float] = []
        # The first run compiles, however long it takes: times are of those that follow.
        while (len(times) < self.repeats and sum(times) < _ENOUGH) or len(shown) < len(answers):
            again, seconds = timed(answers[len(shown) % len(answers)])
            shown.append(again)
            times.append(seconds)
        seconds = statistics.median(times)
        errors, diverged, left = self._worst(reference, setting, shown[-len(answers) :])
        return Point(
            setting=setting,
            outcome=found.trace.outcome.name,
            same_modes=diverged is None,
            diverged=diverged,
            parted=left,
            refused=found.warnings[0] if found.warnings else "",
            errors=errors,
            seconds=seconds,
            repeats=len(times),
            compiling=max(first - seconds, 0.0),
            steps=found.cost.steps,
            evaluations=found.cost.evaluations,
            flows=len(found.trace.arcs),
        )

    def _worst(
        self, reference: Run, setting: Setting, answers: Sequence[Answer]
    ) -> tuple[Errors, float | None, float | None]:
        """Return the largest errors of runs, and when the first took other modes and left."""
        runs = [Run.of(setting, answer.observer, answer.trace) for answer in answers]
        pairs = [self.errors(reference, run) for run in runs]
        left = [parted(reference.trace, r.trace, brief=reference.brief(r)) for r in runs]
        return (
            reduce(Errors.worse, [errors for errors, _ in pairs]),
            min((t for _, t in pairs if t is not None), default=None),
            min((t for t in left if t is not None), default=None),
        )

    def errors(self, reference: Run, run: Run) -> tuple[Errors, float | None]:
        """Return the errors of a run, and when it took other modes than the reference."""
        found = compare(
            reference.trace,
            run.trace,
            reference.outputs,
            run.outputs,
            sizes_of_outputs=reference.sizes,
            endless=reference.endless | run.endless,
            brief=reference.brief(run),
        )
        pairs, _ = paired(reference.trace, run.trace, brief=reference.brief(run))
        ours = run.energies([other for _, other in pairs])
        theirs = reference.energies([one for one, _ in pairs])
        energy = None
        if ours is not None and theirs is not None and found.state < math.inf:
            size = float(np.abs(theirs).max()) or 1.0
            energy = float(np.abs(ours - theirs).max()) / size
        same = found.diverged is None
        violations = offered("statechart.violations", self.model.kind)
        violated = {} if violations is None else violations(self.model, run.observer, run.trace)
        errors = Errors(
            state=found.state if found.state < math.inf else None,
            times=found.times if same else None,
            outputs=found.outputs if same and found.outputs < math.inf else None,
            named={k: v for k, v in found.named.items() if v < math.inf},
            path=distance(reference.trace, run.trace) if found.state < math.inf else None,
            energy=energy,
            violations=dict(violated),
        )
        return errors, found.diverged
