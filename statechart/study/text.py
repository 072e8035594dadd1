"""Measurements as text, and as the object that `--json` prints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from statechart.automaton.trace import Outcome
from statechart.study.measurements import Measurements, Point, Third
from statechart.study.slopes import (
    Note,
    distinct_warnings,
    new_warnings,
    reasons,
    reasons_without_slope,
    slopes,
)
from statechart.tabular import Table, TextBlock, align_numbers, pluralise

# Least listed error of an odd run, relative to its largest.
_MUCH = 0.5
_COLUMNS = {
    "path": "mean distance from the reference over the run",
    "constraint": "deepest penetration of closed contacts",
    "cone": "largest force outside its friction cone",
    "overlap": "deepest penetration of bodies",
    "impulse": "allowed residual of impulses",
    "inexact": "part of the steps above it",
}
# Accuracies for which a setting is advised: the first one reached.
_ADVISED = (1e-6, 1e-4, 1e-3, 1e-2)
_OPTIONS = ("engine", "method", "tolerance", "step", "accuracy")
_MAX_NOTES = 8  # warnings listed in full


def describe_study(study: Measurements) -> list[TextBlock]:
    """Return a study as blocks of text: head, table, conclusions."""
    kinds = list(dict.fromkeys(name for p in study.points for name in p.errors.violations))
    front, cold = study.front(), study.front(once=True)
    head = ["error", "state", "events", "outputs", "path", "energy"]
    if study.parted is not None:
        head = ["leaves it at", "energy"]
    rows = [("", "modes", *head, *kinds, "evaluations", "steps", "warm", "cold")]
    for point in study.points:
        errors = point.errors
        if study.parted is None:
            parts = [errors.state, errors.times, errors.outputs, errors.path, errors.energy]
            shown = [study.error(point), *parts]
        else:
            shown = [point.parted, errors.energy]
        shown += map(errors.violations.get, kinds)
        label = point.setting.label + marks(point, front, cold)
        counts = str(point.evaluations or ""), str(point.steps)
        times = _seconds(point.seconds), "" if point.cold is None else _seconds(point.cold)
        rows.append((label, _modes(point), *map(_format_number, shown), *counts, *times))
    above = "".join(f"{line}\n" for line in _head(study)) + "\n"
    columns = [(head, *align_numbers(texts)) for head, *texts in zip(*rows, strict=True)]
    return [above, Table(list(zip(*columns, strict=True)), headed=True), _foot(study)]


def _head(study: Measurements) -> list[str]:
    lines = [
        f"{study.model} to t = {study.until:g}: {len(study.points)} of "
        f"{pluralise(study.planned, 'setting')}",
        f"reference: {study.reference}, checked by {study.check}",
    ]
    if study.parted is not None:
        words = "no error can be measured: the table shows when each setting leaves the reference"
        return [*lines, _divergence_lines(study), words]
    third, shift = study.third, study.shift.largest or 0.0
    words = f"the two differ by {study.resolution.largest or 0.0:.2g}"
    if third is not None and third.odd:
        lines.append(_odd(third, study))
    elif third is not None:
        words += f", as {third.setting} from them"
    if shift > 0.0:
        words += f", and the tolerance of forces changes the result by {shift:.2g}"
    return [*lines, f"{words}; smaller errors cannot be measured"]


def _odd(third: Third, study: Measurements) -> str:
    """Describe the difference of the odd run of three."""
    worst = third.errors.largest or 0.0
    large = {what: e for what, e in third.errors.parts.items() if e >= _MUCH * worst > 0.0}
    parts = [f"{what.removeprefix('output ')} by {error:.2g}" for what, error in large.items()]
    when = "" if third.parted is None else f"leaves both at t = {third.parted:.6g}, and "
    known = study.warnings.get(study.reference, ())
    warned = new_warnings(study.warnings.get(third.setting, ()), known)
    return (
        f"{third.setting} disagrees with both and is not used: it {when}is off in "
        f"{', '.join(parts) or 'its modes'}, more than a start that is off by {third.shift:.0e} "
        "explains" + "".join(f"; it warns: {text}" for text in warned)
    )


def _divergence_lines(study: Measurements) -> str:
    """Describe the evidence that the motion is chaotic."""
    third, known = study.third, study.warnings.get(study.reference, ())
    own = new_warnings(study.warnings.get(study.check, ()), known)
    why = "chaotic, or at a bifurcation"
    why += ", or their steps are too long" if study.step > 0.0 else ""
    if own:
        why = f"{study.check} warns: {'; '.join(own)}"
    two = f"the two differ from t = {study.parted:.6g} on"
    if third is None:
        return f"{two}, and no run of another method shows which is right: {why}"
    if third.edge is None:
        return f"{two}, and {third.setting} the nearer of them at t = {third.parted:.6g}: {why}"
    return (
        f"{third.setting} leaves the two at t = {study.parted:.6g}, and {study.reference} leaves "
        f"itself at t = {third.edge:.6g} where its start is off by {third.shift:.0e}: {why}"
    )


def _foot(study: Measurements) -> str:
    shown = {name for point in study.points for name in point.errors.violations}
    shown |= {"path"} if study.parted is None and study.points else set()
    columns = "; ".join(f"{name}: {words}" for name, words in _COLUMNS.items() if name in shown)
    lines = [columns] if columns else []
    if study.front():
        lines.append(
            "no other setting is both faster and more accurate: * warm, after other runs in "
            "one process; + cold, as the first run of a process"
        )
    missed = study.missed()
    if missed:
        parts = (f"{family} {few} of {many}" for family, (few, many) in missed.items())
        lines.append("error above the tolerance: " + ", ".join(parts))
    refused = [p.setting.label for p in study.points if p.refused]
    if refused:
        lines.append("did not reach their accuracy:" + ", ".join(refused))
    stepped = {p.setting.family for p in study.points if p.setting.stepped}
    for slope in slopes(study):
        fineness = "the step" if slope.family in stepped else "the tolerance"
        power = f"{slope.slope:.3g} +- {slope.scatter:.1g} (theory {slope.theory:.3g})"
        words = f"{fineness} to the power {power}, {slope.points} points"
        lines.append(f"{slope.of} of {slope.family}: {words}")
    why, listed = reasons(study), _listed_warnings(study)
    lines += [
        f"{family} deviates from the reference even at its finest: see {_footnote(texts, listed)}, "
        "which the reference does not have"
        for family, texts in why.items()
    ]
    unsettled = study.unsettled()
    if unsettled:
        off = ", ".join(f"{name} ({error:.2g})" for name, error in unsettled.items())
        kept = "stay off by that" if stepped & why.keys() else "do not converge with the step"
        words = "no part of the errors above (at the shortest step)"
        lines.append(f"outputs that {kept}, {words}: {off}")
    lines += [f"no slope for {what}: {why}" for what, why in reasons_without_slope(study).items()]
    lines += [f"left out: {line}" for line in omitted(study)]
    for place, note in enumerate(listed, 1):
        whose = f" (numbers of {note.settings[0]})" if note.differs else ""
        settings = _list_settings(study, note.settings)
        lines.append(f"warning {place}, of {settings}: {note.text}{whose}")
    more = len(distinct_warnings(study)) - len(listed)
    if more:
        verb = "is" if more == 1 else "are"
        lines.append(f"{pluralise(more, 'further warning')} {verb} in trade.json")
    lines += advice(study)
    return "\n" + "".join(f"{line}\n" for line in lines) if lines else ""


def advice(study: Measurements) -> list[str]:
    """Return a sentence on the cheapest setting for an accuracy, against another family."""
    for accuracy in _ADVISED:
        comparable = filter(study.comparable, study.points)
        able = [p for p in comparable if (study.error(p) or 0.0) + study.least <= accuracy]
        if not able:
            continue
        best = min(able, key=lambda point: point.seconds)
        setting = best.setting
        parts = {part: getattr(setting, part) for part in _OPTIONS}
        options = " ".join(f"--{part} {x}" for part, x in parts.items() if x is not None)
        others = [point for point in able if point.setting.family != setting.family]
        comparison = ""
        if others:
            next_best = min(others, key=lambda point: point.seconds)
            times = next_best.seconds / best.seconds
            cheaper = f"{times:.2g} times cheaper than" if times >= 1.1 else "as fast as"
            comparison = f", {cheaper} {next_best.setting.label}"
        cost = _seconds(best.seconds)
        return [f"for an accuracy of {accuracy:g} use {options}: {cost} a run{comparison}"]
    return []


def omitted(study: Measurements) -> list[str]:
    """Return the skipped settings, one line per reason."""
    reasons: dict[str, dict[str, list[str]]] = {}
    for label, why in study.left_out.items():
        family, _, fineness = label.rpartition(" ")
        reasons.setdefault(why, {}).setdefault(family, []).append(fineness)
    lines = []
    for why, families in reasons.items():
        ends = {family: dict.fromkeys((some[0], some[-1])) for family, some in families.items()}
        shown = (f"{family} {' to '.join(pair)}" for family, pair in ends.items())
        lines.append(f"{', '.join(shown)}: {why}")
    return lines


def _listed_warnings(study: Measurements) -> list[Note]:
    """Return the warnings listed in full, those that explain a deviation first."""
    why = [text for texts in reasons(study).values() for text in texts]
    found = sorted(distinct_warnings(study), key=lambda note: not note.says_one_of(why))
    return found[: max(_MAX_NOTES, sum(note.says_one_of(why) for note in found))]


def _footnote(texts: Sequence[str], listed: Sequence[Note]) -> str:
    places = [str(place) for place, note in enumerate(listed, 1) if note.says_one_of(texts)]
    return f"warning{'s' if len(places) > 1 else ''} {', '.join(places)}"


def _list_settings(study: Measurements, labels: Sequence[str]) -> str:
    """Return settings by family, as ranges or one by one."""
    parts = []
    for points in study.families.values():
        own = [point.setting.label for point in points]
        places = [place for place, label in enumerate(own) if label in labels]
        if not places:
            continue
        # The common part, then the fineness of each.
        head = own[0].rpartition(" ")[0]
        fine = [own[place].rpartition(" ")[2] for place in places]
        if len(fine) > 2 and places[-1] - places[0] + 1 == len(places):
            fine = [f"{fine[0]} to {fine[-1]}"]
        parts.append(f"{head} {', '.join(fine)}")
    return "; ".join(parts)


def marks(point: Point, warm: Sequence[Point], cold: Sequence[Point]) -> str:
    """Return the marks of a point on a Pareto front."""
    marks = "*" * (point in warm) + "+" * (point in cold)
    return f" {marks}" if marks else ""


def _modes(point: Point) -> str:
    if point.diverged is None:
        return "same"
    # A failure outweighs a separation from the reference.
    ended = "" if Outcome[point.outcome].succeeded else f", {point.outcome}"
    return f"others from t = {point.diverged:.6g}{ended}"


def _format_number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def _seconds(value: float) -> str:
    return f"{value * 1e3:.3g} ms" if value < 1.0 else f"{value:.3g} s"


def to_dict(study: Measurements) -> dict[str, Any]:
    """Return a study as a JSON object, with its conclusions."""
    shown = study.model_dump(mode="json")
    shown["least"] = study.least
    front, cold = study.front(), study.front(once=True)
    for point, one in zip(study.points, shown["points"], strict=True):
        one["label"] = point.setting.label
        one["error"] = study.error(point)
        one["kept"] = study.meets_tolerance(point)
        one["on_front"] = point in front
        one["on_cold_front"] = point in cold
    shown["complete"] = study.complete
    shown["missed"] = {
        family: {"missed": missed, "of": count}
        for family, (missed, count) in study.missed().items()
    }
    shown["slopes"] = [asdict(slope) for slope in slopes(study)]
    shown["no_slope"] = reasons_without_slope(study)
    shown["unsettled"] = study.unsettled()
    shown["notes"] = [asdict(note) for note in distinct_warnings(study)]
    shown["reasons"] = reasons(study)
    return shown
