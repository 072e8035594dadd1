"""Work-precision study: runs of a model at many settings (`statechart trade`)."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import reduce
from itertools import product
from pathlib import Path

from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.documents.declaration import Declaration
from statechart.documents.files import obstacle
from statechart.documents.hints import check_arguments
from statechart.documents.setting import Setting
from statechart.engines.request import Plan
from statechart.errors import DeclarationError, StatechartError
from statechart.execution.outcome import error_of
from statechart.observation.observer import Observer
from statechart.observation.observers import Observers
from statechart.running.accuracy import RunEstimate, RunPlanner
from statechart.running.runner import Runner
from statechart.study.measurements import Errors, Point, fingerprint
from statechart.study.reference import References, Run, separation_of
from statechart.study.startup_cost import FreshProcess
from statechart.study.study import Study, load, save

# Tolerances of every method, as powers of ten.
_POWERS: Mapping[str, range] = {
    "RK45": range(3, 11),
    "DOP853": range(3, 14),
    "Radau": range(3, 9),
    "LSODA": range(3, 12),
}
# Tolerances of the Taylor method, which compiles for each.
_TAYLOR = (1e-3, 1e-6, 1e-9, 1e-12, 2.2e-16)
# Time steps, as fractions of the run.
_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
_IMPULSES = (1e-2, 1e-4, 1e-6, 1e-8)  # impulse tolerances of many bodies
_ACCURACIES = (1e-3, 1e-6, 1e-9)
_TOO_LONG = 4.0  # seconds of a warm run, after which a family is not tightened
_ENOUGH = 2.0  # seconds of repeated runs
# The error of a time step is the worst at these fractions of it, since the place of events between
# two steps is random.
_PARTS = (1.0, 0.983, 0.967, 0.951)


def plan(automaton: Automaton, until: float) -> tuple[Setting, ...]:
    """Return the settings of a study, every family from coarse to fine."""
    steps = [float(f"{until * part:.3g}") for part in _STEPS]
    if automaton.laws is None:
        # Rigid-body systems, by time stepping only.
        pairs = product(_IMPULSES, steps)
        return tuple(
            Setting("impulse", step=h, impulse_tolerance=tolerance) for tolerance, h in pairs
        )
    settings = [Setting(engine="taylor", tolerance=tolerance) for tolerance in _TAYLOR]
    for method, powers in _POWERS.items():
        settings += [Setting("scipy", method, float(f"1e-{power}")) for power in powers]
    if automaton.stepper is not None:
        settings += [Setting(engine="impulse", step=step) for step in steps]
    settings += [Setting(engine="auto", accuracy=accuracy) for accuracy in _ACCURACIES]
    return tuple(settings)


@dataclass(frozen=True, eq=False)
class Bench:
    """Runs and times a model at settings."""

    model: Declaration
    automaton: Automaton
    until: float
    repeats: int
    clock: Callable[[], float]
    cold: Callable[[Setting], float | None]

    def reference(self, mark: str) -> tuple[Run, Study]:
        """Compute the reference; see `References.make`."""
        return References(self.model, self.automaton, self.until, self.once).make(mark)

    def once(self, observer: Observer) -> Trace:
        """Run the model once."""
        return observer.simulator.run(until=self.until, throw=False)

    def runner(self, setting: Setting) -> Callable[[], RunEstimate]:
        """Return a function that runs a setting, with cached programs."""
        planner = RunPlanner(Observers(self.automaton), Plan(setting), None)
        return lambda: planner.run({}, self.until)[0]

    def measure(self, setting: Setting, reference: Run) -> Point:
        """Run a setting and compare it with the reference."""
        step, settings = setting.step, [setting]
        if step is not None:
            settings = [replace(setting, step=part * step) for part in _PARTS]
        makers = [self.runner(one) for one in settings]

        def timed(make: Callable[[], RunEstimate]) -> tuple[RunEstimate, float]:
            began = self.clock()
            found = make()
            if found.trace.outcome is Outcome.INTERRUPTED:
                raise KeyboardInterrupt
            if found.trace.outcome is Outcome.UNSUPPORTED:
                raise error_of(found.trace)
            return found, self.clock() - began

        found, _ = timed(makers[0])
        shown = [found]
        times: list[float] = []
        # The first run compiles and is not timed.
        while (len(times) < self.repeats and sum(times) < _ENOUGH) or len(shown) < len(makers):
            again, seconds = timed(makers[len(shown) % len(makers)])
            shown.append(again)
            times.append(seconds)
        seconds = statistics.median(times)
        compared = shown[-len(makers) :]
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
        self, reference: Run, setting: Setting, found: Sequence[RunEstimate]
    ) -> tuple[Errors, float | None, float | None]:
        """Return the largest errors, and the earliest times of other modes and of separation."""
        runs = [Run.of(one.observer, one.trace, setting) for one in found]
        pairs = [separation_of(self.model, reference, run) for run in runs]
        return (
            reduce(Errors.worse, [one.errors for one, _ in pairs]),
            min((t for _, t in pairs if t is not None), default=None),
            min((one.parted for one, _ in pairs if one.parted is not None), default=None),
        )


@check_arguments
def trade(
    model: Runner | Declaration | str | Path,
    *,
    folder: Path | str | None = None,
    settings: Sequence[Setting] | None = None,
    until: float | None = None,
    repeats: int = 3,
    clock: Callable[[], float] | None = None,
    cold: Callable[[Setting], float | None] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Study:
    """Run a model at many settings, and compare every run with a reference.

    The reference is the tightest run of the most accurate engine, checked by the tightest of
    another; their difference is the resolution. Errors are of final state, times of events, outputs
    and energy, and violations of constraints and friction cones.

    Parameters
    ----------
    model : Runner, Declaration, str or Path
        A model, the path of its file, the name of a shipped one, or a runner with its model.
    folder : Path or str, optional
        Folder of the study, written after every point. A study of the same model in it is resumed.
    settings : sequence of Setting, optional
        By default `plan`.
    until : float, optional
        End of the runs.
    repeats : int
        Number of timed runs.
    clock : callable, optional
        Returns the time in seconds; by default without compilation.
    cold : callable, optional
        Returns the seconds of a first run; by default measured in a fresh process.
    progress : callable, optional
        Receives a line for every point.

    Returns
    -------
    Study
        Not `complete` if it was interrupted.

    Raises
    ------
    DeclarationError
        If the folder contains the study of another model or cannot be written, or the model cannot
        start.
    StatechartError
        If there is no reference, since no engine reaches the end.
    """
    if folder is not None and (why := obstacle(Path(folder).absolute())):
        raise DeclarationError(f"{folder}: {why}", advice="name another folder")
    runner = model if isinstance(model, Runner) else Runner(model)
    progress = progress or (lambda line: None)
    end = runner.end(until=until)
    runner.start()
    fresh = FreshProcess(runner.model, end)
    clock, cold = clock or working_time, cold or fresh.seconds
    bench = Bench(runner.model, runner.automaton, end, repeats, clock, cold)
    mark = fingerprint(runner.model)
    known = None if folder is None else load(folder)
    if known is not None and (known.fingerprint, known.until) != (mark, end):
        raise DeclarationError(
            f"{folder} holds the study of another model, or of {known.model!r} as it was before it "
            "was changed or by another version",
            advice="name another folder, or remove trade.json there",
        )
    progress("reference")
    reference, study = bench.reference(mark)
    if settings is None:
        settings = plan(runner.automaton, reference.trace.t_end)
    study = study.model_copy(update={"planned": len(settings)})
    made = _Trade(study, settings, folder, progress, known)
    with closing(fresh):
        for setting in settings:
            if made.skips(setting):
                continue
            try:
                point = bench.measure(setting, reference)
            except KeyboardInterrupt:
                break
            except StatechartError as error:
                made.leave(setting, str(error))
            else:
                made.take(point)
    return made.stored_study()


class _Trade:
    """A study in progress."""

    def __init__(
        self,
        study: Study,
        settings: Sequence[Setting],
        folder: Path | str | None,
        progress: Callable[[str], None],
        known: Study | None,
    ) -> None:
        self._study, self._settings = study, settings
        self._folder, self._progress = folder, progress
        points = () if known is None else known.points
        self._points = {point.setting: point for point in points if point.setting in settings}
        self._left_out = {} if known is None else dict(known.left_out)
        self._slow: dict[str, str] = {}
        for point in self._points.values():
            self._time(point)

    def skips(self, setting: Setting) -> bool:
        """Return whether a setting is done or skipped; record the reason for skipping."""
        if setting in self._points or setting.label in self._left_out:
            return True
        why = self._slow.get(setting.family)
        if why is None and setting.step is not None and setting.step <= self._study.step:
            why = f"no coarser than the check, {self._study.check}"
        if why is None:
            return False
        self._left_out[setting.label] = why
        return True

    def leave(self, setting: Setting, why: str) -> None:
        self._left_out[setting.label] = why
        self._say(setting, f"left out, {why}")
        self.stored_study()

    def take(self, point: Point) -> None:
        self._points[point.setting] = point
        self._time(point)
        self.stored_study()
        found, modes = self._study.error(point), "" if point.same_modes else ", other modes"
        error = "no error measured" if found is None else f"error {found:.2g}"
        self._say(point.setting, f"{error}{modes}, {point.seconds:.3g} s")

    def stored_study(self) -> Study:
        """Write the study to its folder, and return it."""
        done = tuple(self._points[s] for s in self._settings if s in self._points)
        found = self._study.model_copy(update={"points": done, "left_out": dict(self._left_out)})
        if self._folder is not None:
            save(self._folder, found)
        return found

    def _time(self, point: Point) -> None:
        if point.seconds > _TOO_LONG:
            why = f"{point.setting.label} took {point.seconds:.3g} s already"
            self._slow[point.setting.family] = why

    def _say(self, setting: Setting, words: str) -> None:
        place = self._settings.index(setting) + 1
        self._progress(f"{setting.label} ({place} of {len(self._settings)}): {words}")
