"""Running a model at many settings against a reference: `statechart trade`."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from statechart.accuracy import compare, paired, parted
from statechart.automaton import Automaton
from statechart.declaration import Declaration
from statechart.engine import Engine
from statechart.engines import choose
from statechart.errors import DeclarationError, SimulationError, StatechartError
from statechart.estimate import BELOW, BRIEF, Answer, Cost, tighten
from statechart.kinds import kind
from statechart.nudge import nudged
from statechart.observe import Observer
from statechart.outputs import Outputs
from statechart.outputs import Result as Output
from statechart.run import Runner
from statechart.simulate import Simulator
from statechart.stepping import SteppingSimulator
from statechart.study import Errors, Point, Setting, Study, fingerprint
from statechart.study_file import load, save
from statechart.trace import Jump, Outcome, Trace

__all__ = ["plan", "trade"]

Array = NDArray[np.float64]

# Tolerances of every method, as powers of ten: from where it begins to be of use to where it only
# takes long.
_POWERS: Mapping[str, range] = {
    "RK45": range(3, 11),
    "DOP853": range(3, 14),
    "Radau": range(3, 9),
    "LSODA": range(3, 12),
}
# Of Taylor's method, which compiles anew for every one.
_TAYLOR = (1e-3, 1e-6, 1e-9, 1e-12, 2.2e-16)
# Of time stepping, as parts of the run.
_STEPS = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)
_ACCURACIES = (1e-3, 1e-6, 1e-9)
# References, the best first: any one is checked by the next that can run the model.
_REFERENCES = (
    Setting(engine="taylor", tolerance=2.2e-16),
    Setting(engine="scipy", method="DOP853", tolerance=2.3e-14),
    Setting(engine="scipy", method="LSODA", tolerance=1e-13),
)
# Repeats end once they took so many seconds; a family whose run takes longer than the second, once
# compiled, is tightened no more.
_ENOUGH, _TOO_LONG = 2.0, 4.0


def plan(automaton: Automaton, until: float) -> tuple[Setting, ...]:
    """Return the settings that a model is run at, every family from coarse to fine.

    Parameters
    ----------
    automaton : Automaton
        Of the model.
    until : float
        When a run ends, for the steps.
    """
    settings = [Setting(engine="taylor", tolerance=tolerance) for tolerance in _TAYLOR]
    settings += [
        Setting(engine="scipy", method=method, tolerance=float(f"1e-{power}"))
        for method, powers in _POWERS.items()
        for power in powers
    ]
    if automaton.stepper is not None:
        settings += [
            Setting(engine="impulse", step=float(f"{until * part:.3g}")) for part in _STEPS
        ]
    settings += [Setting(engine="auto", accuracy=accuracy) for accuracy in _ACCURACIES]
    return tuple(settings)


def trade(
    runner: Runner,
    *,
    folder: Path | str | None = None,
    settings: Sequence[Setting] | None = None,
    until: float | None = None,
    repeats: int = 3,
    clock: Callable[[], float] = time.perf_counter,
    progress: Callable[[str], None] = lambda line: None,
) -> Study:
    """Run a model at many settings, and compare every run with a reference.

    The reference is the tightest run of the most accurate engine, checked by the tightest of
    another: their difference is what can be told. Each run is compared with the reference in its
    final state, the times of its events, its outputs and its energy; what violates constraints
    and cones of friction is measured on the run itself.

    Parameters
    ----------
    runner : Runner
        With the model.
    folder : Path or str, optional
        Where the study is kept: it is written after every point, whole, and a study of the same
        model that is there already is gone on with.
    settings : sequence of Setting, optional
        What to run; `plan` by default.
    until : float, optional
        End of the runs.
    repeats : int
        How often a run is repeated for its time.
    clock : callable
        Tells the time in seconds.
    progress : callable
        Gets a line for every point.

    Returns
    -------
    Study
        Not `complete` where it was interrupted.

    Raises
    ------
    DeclarationError
        If the folder holds the study of another model, or the model cannot start.
    StatechartError
        If no reference can be had: no engine takes the model to its end.
    """
    end = runner.end(until=until)
    runner.start()
    bench = _Bench(runner.model, runner.automaton, end, repeats, clock)
    known = None if folder is None else load(folder)
    mark = fingerprint(runner.model)
    if known is not None and (known.fingerprint, known.until) != (mark, end):
        raise DeclarationError(
            f"{folder} holds the study of another model, or of {known.model!r} as it was before it "
            "was changed",
            advice="name another folder, or remove trade.json there",
        )
    progress("reference")
    reference, study = _reference(bench, mark)
    if settings is None:
        settings = plan(runner.automaton, reference.trace.t_end)
    points = {} if known is None else {p.setting: p for p in known.points if p.setting in settings}
    left_out = {} if known is None else dict(known.left_out)
    study = study.model_copy(update={"planned": len(settings)})

    def kept() -> Study:
        done = tuple(points[s] for s in settings if s in points)
        found = study.model_copy(update={"points": done, "left_out": dict(left_out)})
        if folder is not None:
            save(folder, found)
        return found

    slow: dict[str, str] = {}
    for place, setting in enumerate(settings):
        if setting in points or setting.label in left_out:
            continue
        if setting.family in slow:
            left_out[setting.label] = slow[setting.family]
            continue
        try:
            point = bench.measure(setting, reference)
        except StatechartError as error:
            left_out[setting.label] = str(error)
            progress(f"{setting.label} ({place + 1} of {len(settings)}): left out, {error}")
            kept()
            continue
        if point is None:
            break
        points[setting] = point
        if point.seconds > _TOO_LONG:
            slow[setting.family] = f"{setting.label} took {point.seconds:.3g} s already"
        kept()
        found = study.error(point)
        progress(
            f"{setting.label} ({place + 1} of {len(settings)}): "
            + ("no error to tell" if found is None else f"error {found:.2g}")
            + ("" if point.same_modes else ", other modes")
            + f", {point.seconds:.3g} s"
        )
    return kept()


@dataclass(frozen=True, eq=False)
class _Run:
    """A run that others are compared with, or that is compared."""

    observer: Observer
    trace: Trace
    outputs: Mapping[str, Output]
    sizes: Mapping[str, Output]

    @classmethod
    def of(cls, observer: Observer, trace: Trace) -> _Run:
        outputs = Outputs(observer)
        return cls(observer, trace, outputs.of(trace), outputs.sizes(trace))

    def energies(self, jumps: Sequence[Jump]) -> Array | None:
        """Return the energy (m + 1,) before each of some jumps and at the end, if there is one."""
        if "energy" not in self.observer.automaton.observables:
            return None
        before = self.observer.at(self.trace, ["energy"], jumps, before=True)[:, 0]
        return np.append(before, self.observer.final(self.trace, ["energy"]))


@dataclass(frozen=True, eq=False)
class _Bench:
    """Runs a model at settings, and takes the time."""

    model: Declaration
    automaton: Automaton
    until: float
    repeats: int
    clock: Callable[[], float]

    def engine(self, setting: Setting, tolerance: float) -> Engine:
        return choose(engine=setting.engine, method=setting.method, tolerance=tolerance)[0]

    def observer(self, setting: Setting, fineness: float, *, off: bool = False) -> Observer:
        """Return the observer of a setting's simulator, at a tolerance or a step.

        `off`: its runs start off by the tolerance.
        """
        if setting.step is not None:
            return Observer(SteppingSimulator(self.automaton, fineness))
        automaton = nudged(self.automaton) if off else self.automaton
        return Observer(Simulator(automaton, self.engine(setting, fineness)))

    def once(self, observer: Observer) -> Trace:
        return observer.simulator.run(
            until=self.until, max_jumps=self.model.settings.max_jumps, throw=False
        )

    def answerer(self, setting: Setting) -> Callable[[], Answer]:
        """Return what makes the run of a setting; what it compiles is kept for the next time."""
        observers: dict[tuple[float, bool], Observer] = {}

        def once(tolerance: float, off: bool) -> tuple[Observer, Trace]:
            observer = observers.get((tolerance, off))
            if observer is None:
                observer = observers[tolerance, off] = self.observer(setting, tolerance, off=off)
            return observer, self.once(observer)

        def answer() -> Answer:
            if setting.accuracy is not None:
                floor = self.engine(setting, math.ulp(0.0)).tolerance
                return tighten(once, setting.accuracy, first=setting.accuracy * BELOW, floor=floor)
            observer, trace = once(setting.fineness, False)
            counts = trace.counts
            cost = Cost(1, counts.get("steps", 0), counts.get("evaluations", 0), 0.0)
            return Answer(observer, trace, None, cost)

        return answer

    def measure(self, setting: Setting, reference: _Run) -> Point | None:
        """Run a setting and compare it; None where the user interrupted it."""
        answer = self.answerer(setting)

        def timed() -> tuple[Answer, float]:
            began = self.clock()
            found = answer()
            return found, self.clock() - began

        found, first = timed()
        times: list[float] = []
        # The first run compiles, however long it takes: times are of those that follow.
        while len(times) < self.repeats and sum(times) < _ENOUGH:
            if found.trace.outcome is Outcome.INTERRUPTED:
                return None
            found, seconds = timed()
            times.append(seconds)
        if found.trace.outcome is Outcome.INTERRUPTED:
            return None
        seconds = statistics.median(times)
        run = _Run.of(found.observer, found.trace)
        errors, diverged = self.errors(reference, run)
        return Point(
            setting=setting,
            outcome=found.trace.outcome.name,
            same_modes=diverged is None,
            diverged=diverged,
            parted=parted(reference.trace, found.trace, brief=BRIEF),
            refused=found.warnings[0] if found.warnings else "",
            errors=errors,
            seconds=seconds,
            repeats=len(times),
            compiling=max(first - seconds, 0.0),
            steps=found.cost.steps,
            evaluations=found.cost.evaluations,
            flows=len(found.trace.arcs),
        )

    def errors(self, reference: _Run, run: _Run) -> tuple[Errors, float | None]:
        """Return the errors of a run, and when it took other modes than the reference."""
        found = compare(
            reference.trace,
            run.trace,
            reference.outputs,
            run.outputs,
            sizes_of_outputs=reference.sizes,
            brief=BRIEF,
        )
        pairs, _ = paired(reference.trace, run.trace, brief=BRIEF)
        ours = run.energies([other for _, other in pairs])
        theirs = reference.energies([one for one, _ in pairs])
        energy = None
        if ours is not None and theirs is not None and found.state < math.inf:
            size = float(np.abs(theirs).max()) or 1.0
            energy = float(np.abs(ours - theirs).max()) / size
        same = found.diverged is None
        offered = kind(str(getattr(self.model, "kind", ""))).violations
        violated = {} if offered is None else offered(self.model, run.observer, run.trace)
        errors = Errors(
            state=found.state if found.state < math.inf else None,
            times=found.times if same else None,
            outputs=found.outputs if same and found.outputs < math.inf else None,
            energy=energy,
            violations=dict(violated),
        )
        return errors, found.diverged


def _reference(bench: _Bench, mark: str) -> tuple[_Run, Study]:
    """Make the reference and the run that checks it; return it, and a study without points."""
    runs: list[tuple[Setting, _Run]] = []
    failures = []
    for setting in _REFERENCES:
        try:
            observer = bench.observer(setting, setting.fineness)
            trace = bench.once(observer)
        except StatechartError as error:
            failures.append(f"{setting.label}: {error}")
            continue
        if trace.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not trace.outcome.succeeded:
            failures.append(f"{setting.label}: {trace.message}")
            continue
        runs.append((setting, _Run.of(observer, trace)))
        if len(runs) == 2:
            break
    else:
        raise SimulationError(
            "no reference to compare with, two engines must reach the end of the run:\n  "
            + "\n  ".join(failures)
        )
    (setting, reference), (other, check) = runs
    resolution, _ = bench.errors(reference, check)
    study = Study(
        model=bench.model.name,
        fingerprint=mark,
        until=bench.until,
        reference=setting.label,
        check=other.label,
        resolution=resolution,
        parted=parted(reference.trace, check.trace, brief=BRIEF),
        planned=0,
    )
    return reference, study
