"""A study as text for people."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from statechart.automaton.trace import Outcome
from statechart.reporting.text import table
from statechart.study.record import Point, Study
from statechart.study.slopes import slopes, unfitted


def text(study: Study) -> str:
    """Return a study as a table, with what follows from it below."""
    kinds = list(dict.fromkeys(name for p in study.points for name in p.errors.violations))
    front = study.front()
    head = ["error", "state", "events", "outputs", "path", "energy"]
    if study.parted is not None:
        head = ["leaves it at", "energy"]
    rows = [("", "modes", *head, *kinds, "evaluations", "steps", "time", "compiling")]
    for point in study.points:
        errors = point.errors
        if study.parted is None:
            parts = [errors.state, errors.times, errors.outputs, errors.path, errors.energy]
            shown = [study.error(point), *parts]
        else:
            shown = [point.parted, errors.energy]
        rows.append(
            (
                point.setting.label + (" *" if point in front else ""),
                _modes(point),
                *(_number(x) for x in shown),
                *(_number(errors.violations.get(name)) for name in kinds),
                str(point.evaluations or ""),
                str(point.steps),
                _seconds(point.seconds),
                _seconds(point.compiling),
            )
        )
    return "".join(f"{line}\n" for line in _head(study)) + "\n" + table(rows) + _foot(study)


def _head(study: Study) -> list[str]:
    lines = [
        f"{study.model} to t = {study.until:g}: {len(study.points)} of {study.planned} settings",
        f"reference: {study.reference}, checked by {study.check}",
    ]
    if study.parted is None:
        shift = study.shift.largest or 0.0
        lines.append(
            f"the two differ by {study.resolution.largest or 0.0:.2g}"
            + (f", and forces have a tolerance worth {shift:.2g}" if shift > 0.0 else "")
            + "; smaller errors cannot be told"
        )
    else:
        lines.append(
            f"the two leave each other at t = {study.parted:.6g}: chaotic, or on a knife's edge"
            + (", or their steps are too long" if study.step > 0.0 else "")
            + "; for every setting, when it leaves the reference"
        )
    return lines


def _foot(study: Study) -> str:
    lines = []
    if study.front():
        lines.append("* nothing else is as accurate and faster")
    missed = study.missed()
    if missed:
        parts = (f"{family} {few} of {many}" for family, (few, many) in missed.items())
        lines.append("missed what they promised: " + ", ".join(parts))
    refused = [p.setting.label for p in study.points if p.refused]
    if refused:
        lines.append("said that they did not reach it: " + ", ".join(refused))
    for slope in slopes(study):
        fineness = "the step" if slope.family == "impulse" else "the tolerance"
        lines.append(
            f"{slope.of} of {slope.family}: {fineness} to the power {slope.slope:.3g} "
            f"+- {slope.scatter:.1g} "
            f"(theory {slope.theory:.3g}), {slope.points} points"
        )
    lines += [
        f"{name} does not converge with the step: its error is {error:.2g} at the shortest, and is "
        "not part of the error above"
        for name, error in study.unsettled().items()
    ]
    lines += [f"no slope for {what}: {why}" for what, why in unfitted(study).items()]
    lines += [f"left out: {line}" for line in omitted(study)]
    return "\n" + "".join(f"{line}\n" for line in lines) if lines else ""


def omitted(study: Study) -> list[str]:
    """Return what was left out and why, one line a reason."""
    reasons: dict[str, dict[str, list[str]]] = {}
    for label, why in study.left_out.items():
        family, _, fineness = label.rpartition(" ")
        reasons.setdefault(why, {}).setdefault(family, []).append(fineness)
    return [
        ", ".join(
            f"{family} {some[0]}" + (f" to {some[-1]}" if len(some) > 1 else "")
            for family, some in families.items()
        )
        + f": {why}"
        for why, families in reasons.items()
    ]


def _modes(point: Point) -> str:
    if point.diverged is None:
        return "same"
    # Where both parted from the reference and failed, that it failed is more.
    ended = "" if Outcome[point.outcome].succeeded else f", {point.outcome}"
    return f"others from t = {point.diverged:.6g}{ended}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"


def _seconds(value: float) -> str:
    return f"{value * 1e3:.3g} ms" if value < 1.0 else f"{value:.3g} s"


def report(study: Study) -> dict[str, Any]:
    """Return a study as one plain object, with what follows from its points."""
    shown = study.model_dump(mode="json")
    shown["least"] = study.least
    front = study.front()
    for point, plain in zip(study.points, shown["points"], strict=True):
        plain["label"] = point.setting.label
        plain["error"] = study.error(point)
        plain["kept"] = study.kept(point)
        plain["on_front"] = point in front
    shown["complete"] = study.complete
    shown["missed"] = {
        family: {"missed": missed, "of": count}
        for family, (missed, count) in study.missed().items()
    }
    shown["slopes"] = [asdict(slope) for slope in slopes(study)]
    shown["no_slope"] = unfitted(study)
    shown["unsettled"] = study.unsettled()
    return shown
