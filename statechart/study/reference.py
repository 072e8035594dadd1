"""Reference solutions: two runs of different kinds, and a third where these disagree."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Jump, Outcome, Trace
from statechart.documents.declaration import Declaration
from statechart.documents.setting import LONG_DOUBLE, Setting
from statechart.errors import DeclarationError, SimulationError, StatechartError
from statechart.execution.outcome import error_of
from statechart.execution.perturbation import shifted, widened
from statechart.loading.kind import offered
from statechart.observation.difference import distance, paired, parted
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.accuracy import BRIEF, EvaluatedRun
from statechart.study.measurements import RESOLVED, Errors, Third
from statechart.study.study import Study

# References, the best first; what steps in time is last, at parts of the run. Each is checked by
# the next of another kind that can run the model.
_REFERENCES = (
    Setting(engine="taylor", method=LONG_DOUBLE, tolerance=1.1e-19),
    Setting(engine="taylor", tolerance=2.2e-16),
    Setting(engine="scipy", method="DOP853", tolerance=2.3e-14),
    Setting(engine="scipy", method="LSODA", tolerance=1e-13),
    Setting(engine="scipy", method="Radau", tolerance=1e-9),
)
_STEPS = (1e-4, 3e-4)
# How exact the impulses of many bodies are, which iterations find: as the step is, of the check
# less, so that it tells of both.
_IMPULSES = (1e-10, 1e-8)
# Two runs as tight as can be that differ by more are judged by a third: those of the shipped models
# differ by less than 1e-12.
_GROSS = 1e-8
# The error of a run is up to so many tolerances behind several events (docs/speed-and-accuracy.md):
# a start that is off by that must lead to where a run leads, or nothing can be said against it.
_REACH = 30.0


@dataclass(frozen=True, eq=False)
class Run:
    """A run at a setting, with its outputs."""

    setting: Setting
    evaluated: EvaluatedRun

    @property
    def observer(self) -> Observer:
        """Outputs and events as the simulator of the reference evaluates them."""
        return self.evaluated.observer

    @property
    def trace(self) -> Trace:
        """Its trace."""
        return self.evaluated.trace

    def brief(self, other: Run) -> float:
        """Return for which part of the run the modes of another may differ from this reference's.

        Time stepping knows events to its step.
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

    def left(self, other: Run) -> float | None:
        """Return when another run leaves this one for good, see `parted`."""
        return parted(self.trace, other.trace, brief=self.brief(other))


@dataclass(frozen=True)
class _Separation:
    """Distance of two runs: when one left the other for good, and its errors."""

    parted: float | None
    errors: Errors

    @property
    def size(self) -> float:
        """The largest error; inf where they parted."""
        return math.inf if self.parted is not None else self.errors.largest or 0.0

    def worse(self, other: _Separation) -> _Separation:
        """Return the larger of two: the one that parts, the earlier one where both do."""
        if self.parted is None and other.parted is None:
            return _Separation(None, self.errors.worse(other.errors))
        return min(self, other, key=lambda one: math.inf if one.parted is None else one.parted)


@dataclass(frozen=True, eq=False)
class _Pair:
    reference: Run
    check: Run
    separation: _Separation

    @property
    def closeness(self) -> tuple[float, float]:
        """Sort key of a pair of references: longer agreement first, then smaller distance."""
        apart = self.separation
        if apart.parted is not None:
            return -apart.parted, 0.0
        return -math.inf, apart.size


@dataclass(frozen=True, eq=False)
class References:
    """Makes reference runs of a model to an end; `run` makes the trace of an observer."""

    model: Declaration
    automaton: Automaton
    until: float
    run: Callable[[Observer], Trace]

    def make(self, mark: str) -> tuple[Run, Study]:
        """Make the reference and the run that checks it; a third where these two disagree.

        The study has no points.
        """
        failures: list[str] = []
        some = self._runs(failures)
        first = tuple(islice(some, 2))
        if len(first) < 2:
            raise SimulationError(
                "no reference: two engines must reach the end of the run:" + "\n  ".join(failures)
            )
        found, third = self._pair(*first), None
        made = (*first, *islice(some, int(found.separation.size > _GROSS)))
        if len(made) > 2:
            found, third = self._judged(made)
        reference, check = found.reference, found.check
        setting, shift = reference.setting, Errors()
        if setting.step is None:
            late = self._ended(setting, Observers(widened(self.automaton)).at(setting))
            shift = self._pair(reference, late).separation.errors
        study = Study(
            model=self.model.name,
            fingerprint=mark,
            until=self.until,
            reference=setting.label,
            check=check.setting.label,
            resolution=found.separation.errors,
            shift=shift,
            parted=found.separation.parted,
            third=third,
            step=check.setting.step or 0.0,
            planned=0,
            warnings={run.setting.label: run.trace.warnings for run in made},
        )
        return reference, study

    def _runs(self, failures: list[str]) -> Iterator[Run]:
        """Yield runs that came to their end, each of another kind; note those that did not.

        What has a step only is checked by itself, with another step.
        """
        settings: tuple[Setting, ...] = _REFERENCES
        if self.automaton.stepper is not None:
            bodies = self.automaton.laws is None
            settings += tuple(
                Setting(
                    engine="impulse",
                    step=float(f"{self.until * part:.3g}"),
                    impulse_tolerance=tolerance if bodies else None,
                )
                for part, tolerance in zip(_STEPS, _IMPULSES, strict=True)
            )
        made: list[str | None] = []
        for setting in settings:
            if _kind(setting) in made and (setting.step is None or len(made) > 1):
                continue
            try:
                run = self._ended(setting, Observers(self.automaton).at(setting))
            except StatechartError as error:
                failures.append(f"{setting.label}: {error}")
            else:
                made.append(_kind(setting))
                yield run

    def _ended(self, setting: Setting, observer: Observer) -> Run:
        """Return a run that came to its end; raise where it did not."""
        trace = self.run(observer)
        if trace.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not trace.outcome.succeeded:
            raise error_of(trace)
        return Run(setting, EvaluatedRun.of(observer, trace))

    def _pair(self, reference: Run, check: Run) -> _Pair:
        errors, _ = errors_of(self.model, reference, check)
        return _Pair(reference, check, _Separation(reference.left(check), errors))

    def _judged(self, runs: Sequence[Run]) -> tuple[_Pair, Third]:
        """Return the two of three runs that agree best, and the verdict on the third.

        It is the odd one out where it is much farther from both than they are from each other, and
        than the one of them is from itself with its start off by what the errors of runs amount to.
        Else the motion magnifies errors so much that of two courses either may be right: that two
        runs of three took the same one says nothing.
        """
        pairs = [self._pair(one, other) for one, other in combinations(runs, 2)]
        best = min(pairs, key=lambda pair: pair.closeness)
        third = next(run for run in runs if run not in (best.reference, best.check))
        off = min(
            (pair for pair in pairs if third in (pair.reference, pair.check)),
            key=lambda pair: pair.closeness,
        ).separation
        part, edge = _REACH * max(map(_tolerance, runs)), None
        odd = off.size > RESOLVED * best.separation.size
        if odd:
            shaken = self._shaken(best.reference, part)
            odd, edge = off.size > RESOLVED * shaken.size, shaken.parted
        verdict = Third(
            setting=third.setting.label,
            parted=off.parted,
            errors=off.errors,
            odd=odd,
            shift=part,
            edge=edge,
        )
        if not odd and best.separation.parted is None:
            best = _Pair(best.reference, best.check, best.separation.worse(off))
        return best, verdict

    def _shaken(self, run: Run, part: float) -> _Separation:
        """Return how far a run is at most from itself with its start off by a part.

        Up, down, and every other variable the one or the other way: where two things happen at
        once, what moves them alike would leave them so.
        """
        alternating = (-1.0) ** np.arange(len(run.trace.initial))
        found = _Separation(None, Errors(state=0.0))
        for signs in (np.ones(len(alternating)), alternating):
            for way in (part, -part):
                off = shifted(self.automaton, part, np.sign(way) * signs)
                try:
                    other = self._ended(run.setting, Observers(off).at(run.setting))
                except DeclarationError:
                    # Off by so much, the start is no start.
                    continue
                found = found.worse(self._pair(run, other).separation)
                if found.parted is not None:
                    return found
        return found


def _kind(setting: Setting) -> str | None:
    return setting.method if setting.engine == "scipy" else setting.engine


def _tolerance(run: Run) -> float:
    """Return the tolerance of a run; of one that steps in time, its step as a part of the run."""
    return run.setting.tolerance or (run.setting.step or 0.0) / run.trace.t_end


def errors_of(model: Declaration, reference: Run, run: Run) -> tuple[Errors, float | None]:
    """Return the errors of a run of a model, and when it took other modes than the reference."""
    one, other = reference.evaluated, run.evaluated
    found = one.difference(other, one.scales, brief=reference.brief(run))
    pairs, _ = paired(reference.trace, run.trace, brief=reference.brief(run))
    ours = run.energies([other for _, other in pairs])
    theirs = reference.energies([one for one, _ in pairs])
    energy = None
    if ours is not None and theirs is not None and found.state < math.inf:
        size = float(np.abs(theirs).max()) or 1.0
        energy = float(np.abs(ours - theirs).max()) / size
    same = found.diverged is None
    violations = offered("statechart.violations", model.kind)
    violated = {} if violations is None else violations(model, run.observer, run.trace)
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
