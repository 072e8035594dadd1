"""Running a model at many settings against a reference: `statechart trade`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from statechart.automaton.automaton import Automaton
from statechart.documents.setting import Setting
from statechart.errors import DeclarationError, StatechartError
from statechart.running.runner import Runner
from statechart.study.bench import Bench
from statechart.study.file import load, save
from statechart.study.record import Study, fingerprint

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
_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
_ACCURACIES = (1e-3, 1e-6, 1e-9)
# A family whose run takes longer than so many seconds, once compiled, is tightened no more.
_TOO_LONG = 4.0


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
    bench = Bench(runner.model, runner.automaton, end, repeats, clock)
    known = None if folder is None else load(folder)
    mark = fingerprint(runner.model)
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
    points = {} if known is None else {p.setting: p for p in known.points if p.setting in settings}
    left_out = {} if known is None else dict(known.left_out)
    study = study.model_copy(update={"planned": len(settings)})

    def kept() -> Study:
        done = tuple(points[s] for s in settings if s in points)
        found = study.model_copy(update={"points": done, "left_out": dict(left_out)})
        if folder is not None:
            save(folder, found)
        return found

    slow = {
        p.setting.family: f"{p.setting.label} took {p.seconds:.3g} s already"
        for p in points.values()
        if p.seconds > _TOO_LONG
    }
    for place, setting in enumerate(settings):
        if setting in points or setting.label in left_out:
            continue
        if setting.family in slow:
            left_out[setting.label] = slow[setting.family]
            continue
        if setting.step is not None and setting.step <= study.step:
            left_out[setting.label] = f"no coarser than the check, {study.check}"
            continue
        try:
            point = bench.measure(setting, reference)
        except KeyboardInterrupt:
            break
        except StatechartError as error:
            left_out[setting.label] = str(error)
            progress(f"{setting.label} ({place + 1} of {len(settings)}): left out, {error}")
            kept()
            continue
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
