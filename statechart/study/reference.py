"""Reference solution: two runs by different methods, and a third if these disagree."""

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
from statechart.execution.perturbation import with_doubled_tolerances, with_shifted_start
from statechart.loading.kind import load_entry
from statechart.observation.difference import distance, separation_time
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.accuracy import BRIEF, EvaluatedRun
from statechart.study.measurements import RESOLVED, Errors, Third
from statechart.study.study import Study

# By accuracy; time stepping follows. A reference is checked by the next run of another method.
_REFERENCES = (
    Setting(engine="taylor", method=LONG_DOUBLE, tolerance=1.1e-19),
    Setting(engine="taylor", tolerance=2.2e-16),
    Setting(engine="scipy", method="DOP853", tolerance=2.3e-14),
    Setting(engine="scipy", method="LSODA", tolerance=1e-13),
    Setting(engine="scipy", method="Radau", tolerance=1e-9),
)
_STEPS = (1e-4, 3e-4)  # of reference and check, as fractions of the run
_IMPULSES = (1e-10, 1e-8)  # impulse tolerances of reference and check for many bodies
# A third run decides above this difference; the shipped models differ by less than 1e-12.
_GROSS = 1e-8
# Error of a run after several events, in tolerances (docs/speed-and-accuracy.md): the perturbation
# of the initial state that shows how the motion magnifies errors.
_REACH = 30.0


@dataclass(frozen=True, eq=False)
class Run(EvaluatedRun):
    """A run at a setting, with its outputs."""

    setting: Setting

    def brief(self, other: Run) -> float:
        """Return the fraction of the run for which modes may differ: two time steps at least."""
        if self.setting.step is None:
            return BRIEF
        step = max(self.setting.step, other.setting.step or 0.0)
        return max(BRIEF, 2.0 * step / self.trace.t_end)

    def energies(self, jumps: Sequence[Jump]) -> Array | None:
        """Return the energy (m + 1,) before jumps and at the end, or None without an energy."""
        if "energy" not in self.observer.automaton.observables:
            return None
        before = self.observer.at(self.trace, ["energy"], jumps, before=True)[:, 0]
        return np.append(before, self.observer.final(self.trace, ["energy"]))


@dataclass(frozen=True)
class Separation:
    """Time of separation of two runs (see `separation_time`), and errors."""

    parted: float | None
    errors: Errors

    @property
    def size(self) -> float:
        """The largest error, inf for separated runs."""
        return math.inf if self.parted is not None else self.errors.largest or 0.0

    def worse(self, other: Separation) -> Separation:
        """Return the earlier separation, else the larger errors."""
        if self.parted is None and other.parted is None:
            return Separation(None, self.errors.worse(other.errors))
        return min(self, other, key=lambda one: math.inf if one.parted is None else one.parted)


@dataclass(frozen=True, eq=False)
class _Pair:
    reference: Run
    check: Run
    separation: Separation

    @property
    def closeness(self) -> tuple[float, float]:
        """Sort key: longer agreement first, then smaller errors."""
        parted = self.separation.parted
        return (-math.inf, self.separation.size) if parted is None else (-parted, 0.0)


@dataclass(frozen=True, eq=False)
class References:
    """Computes reference runs of a model until an end; `run` returns the trace of an observer."""

    model: Declaration
    automaton: Automaton
    until: float
    run: Callable[[Observer], Trace]

    def make(self, mark: str) -> tuple[Run, Study]:
        """Return the reference, and a study without points."""
        failures: list[str] = []
        candidates = self._runs(failures)
        first = tuple(islice(candidates, 2))
        if len(first) < 2:
            raise SimulationError(
                "no reference: two engines must reach the end of the run:" + "\n  ".join(failures)
            )
        found, third = self._compare_pair(*first), None
        runs = (*first, *islice(candidates, int(found.separation.size > _GROSS)))
        if len(runs) > 2:
            found, third = self._best_of_three(runs)
        reference, check = found.reference, found.check
        setting, shift = reference.setting, Errors()
        if setting.step is None:
            doubled = Observers(with_doubled_tolerances(self.automaton))
            shifted = self._ended(setting, doubled.at(setting))
            shift = self._compare_pair(reference, shifted).separation.errors
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
            warnings={run.setting.label: run.trace.warnings for run in runs},
        )
        return reference, study

    def _runs(self, failures: list[str]) -> Iterator[Run]:
        """Yield complete runs, each by another method; time stepping also checks itself."""
        settings: tuple[Setting, ...] = _REFERENCES
        if self.automaton.stepper is not None:
            bodies = self.automaton.laws is None
            for part, impulses in zip(_STEPS, _IMPULSES if bodies else (None, None), strict=True):
                step = float(f"{self.until * part:.3g}")
                settings += (Setting("impulse", step=step, impulse_tolerance=impulses),)
        methods: list[str | None] = []
        for setting in settings:
            if _method(setting) in methods and (setting.step is None or len(methods) > 1):
                continue
            try:
                run = self._ended(setting, Observers(self.automaton).at(setting))
            except StatechartError as error:
                failures.append(f"{setting.label}: {error}")
            else:
                methods.append(_method(setting))
                yield run

    def _ended(self, setting: Setting, observer: Observer) -> Run:
        """Return a complete run; raise its error otherwise."""
        trace = self.run(observer)
        if trace.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not trace.outcome.succeeded:
            raise error_of(trace)
        return Run.of(observer, trace, setting)

    def _compare_pair(self, reference: Run, check: Run) -> _Pair:
        return _Pair(reference, check, separation_of(self.model, reference, check)[0])

    def _best_of_three(self, runs: Sequence[Run]) -> tuple[_Pair, Third]:
        """Return the two of three runs that agree best, and the verdict on the third.

        The third is wrong if it is much farther from both than they are from each other, and than
        the reference is from itself with a perturbed start. Otherwise the motion magnifies errors
        so much that the agreement of two runs proves nothing.
        """
        pairs = [self._compare_pair(one, other) for one, other in combinations(runs, 2)]
        best = min(pairs, key=lambda pair: pair.closeness)
        third = next(run for run in runs if run not in (best.reference, best.check))
        others = (pair for pair in pairs if third in (pair.reference, pair.check))
        off = min(others, key=lambda pair: pair.closeness).separation
        part, edge = _REACH * max(map(_tolerance, runs)), None
        odd = off.size > RESOLVED * best.separation.size
        if odd:
            perturbed = self._perturbed(best.reference, part)
            odd, edge = off.size > RESOLVED * perturbed.size, perturbed.parted
        found = {"setting": third.setting.label, "parted": off.parted, "errors": off.errors}
        verdict = Third(**found, odd=odd, shift=part, edge=edge)
        if not odd and best.separation.parted is None:
            best = _Pair(best.reference, best.check, best.separation.worse(off))
        return best, verdict

    def _perturbed(self, run: Run, part: float) -> Separation:
        """Return the largest separation of a run from itself with a perturbed initial state.

        Perturbations are up, down, and alternating, which separates coincident events.
        """
        alternating: Array = (-1.0) ** np.arange(len(run.trace.initial), dtype=np.float64)
        found: Separation | None = None
        for signs in (np.ones(len(alternating)), alternating):
            for sign in (1.0, -1.0):
                off = with_shifted_start(self.automaton, part, sign * signs)
                try:
                    other = self._ended(run.setting, Observers(off).at(run.setting))
                except DeclarationError:  # no valid initial state
                    continue
                separation = self._compare_pair(run, other).separation
                found = separation if found is None else found.worse(separation)
                if found.parted is not None:
                    return found
        return found or Separation(None, Errors(state=0.0))


def _method(setting: Setting) -> str | None:
    return setting.method if setting.engine == "scipy" else setting.engine


def _tolerance(run: Run) -> float:
    """Return the tolerance of a run, or its time step as a fraction of the run."""
    return run.setting.tolerance or (run.setting.step or 0.0) / run.trace.t_end


def separation_of(model: Declaration, reference: Run, run: Run) -> tuple[Separation, float | None]:
    """Return the separation of a run, and the time of its first mode other than the reference's."""
    brief = reference.brief(run)
    found = reference.difference(run, reference.scales, brief=brief)
    ours = run.energies([other for _, other in found.pairs])
    theirs = reference.energies([one for one, _ in found.pairs])
    energy = None
    if ours is not None and theirs is not None and found.state < math.inf:
        size = float(np.abs(theirs).max()) or 1.0
        energy = float(np.abs(ours - theirs).max()) / size
    same = found.diverged is None
    violations = load_entry("statechart.violations", model.kind)
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
    parted = separation_time(reference.trace, run.trace, brief=brief)
    return Separation(parted, errors), found.diverged
