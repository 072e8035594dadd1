"""Convergence orders of errors and steps in tolerance or step size, against theory."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from statechart.study.measurements import (
    MIN_POINTS,
    RESOLVED,
    Measurements,
    Point,
    converges,
    median_slope,
)

Quantity = Literal["error", "steps"]

SLOPES: Mapping[str, Mapping[Quantity, float]] = {
    "RK45": {"error": 1.0, "steps": -1.0 / 5.0},
    "DOP853": {"error": 1.0, "steps": -1.0 / 8.0},
    "impulse": {"error": 1.0},
}
"""Theoretical powers of the tolerance (or the fixed step) for error and steps of a family.

SciPy keeps the local error, of order p in the step size, at the tolerance and continues with the
solution of higher order: h ~ tol^(1/p), p = 5 for RK45 and 8 for DOP853, and the global error is
~ h^p = tol (Hairer, Norsett, Wanner, "Solving Ordinary Differential Equations I", section II.4).
Only accepted steps count, since the fraction of rejected ones falls with the tolerance. Time
stepping has order 1 in the path (Moreau, Jean), also if modes differ, as for accumulating bounces.
"""

# Larger errors are as large as the motion, and not fitted.
_SATURATED = 1e-1
# Least steps per flow of a fit: the first step, and the last one before an event, do not depend on
# the tolerance.
_STEPS_PER_FLOW = 10.0
# Least ratio of the steps of the finest and the coarsest run of a fit: the steps of parabolic
# flight and of rest do not depend on the tolerance.
_GROWN: Mapping[Quantity, float] = {"error": 3.0, "steps": 6.0}


@dataclass(frozen=True)
class Slope:
    """Log-log fit of a family of settings."""

    family: str  # see `Setting.family`
    of: Quantity  # error, or accepted steps
    slope: float
    scatter: float  # standard error of the slope; large for a fixed step, between events
    theory: float  # see `SLOPES`
    points: int  # number of points


def slopes(study: Measurements) -> tuple[Slope, ...]:
    """Fit the slopes of families with a theory and enough points."""
    found = []
    for family, theories in _theories(study).items():
        for of, theory in theories.items():
            points = points_to_fit(study, family, of)
            if len(points) < MIN_POINTS:
                continue
            x, y = np.log(np.array(points)).T
            # Robust against points where errors happen to cancel.
            slope = median_slope(x, y)
            if slope * theory <= 0.0:
                continue
            off = y - np.median(y - slope * x) - slope * x
            scatter = math.sqrt(float(off @ off) / (len(x) - 2)) / (float(x.std()) * len(x) ** 0.5)
            found.append(Slope(family, of, slope, scatter, theory, len(points)))
    return tuple(found)


def reasons_without_slope(study: Measurements) -> dict[str, str]:
    """Return quantities with a theory but no slope -> reason."""
    known = {(slope.family, slope.of) for slope in slopes(study)}
    deviating, found = reasons(study), {}
    for family, theories in _theories(study).items():
        for of in theories:
            if (family, of) in known or (study.parted is not None and of == "error"):
                continue
            if family in deviating and of == "error":
                why = "its runs deviate from the reference, as their warnings explain"
            elif len(points_to_fit(study, family, of)) >= MIN_POINTS:
                why = "it does not fall: it is round-off, or the runs take other modes"
            elif len(_same(study, family)) < MIN_POINTS:
                why = "few runs take the modes of the reference"
            elif not _grown(study, family, of):
                why = "the tolerance hardly decides the steps"
            elif of == "steps":
                why = f"few runs have {_STEPS_PER_FLOW:g} steps a flow"
            else:
                least = f"the resolution of the reference ({RESOLVED * study.least:.0e})"
                why = f"too few runs have an error below {_SATURATED:g} and above {least}"
            found[f"{of} of {family}"] = why
    return found


def _theories(study: Measurements) -> dict[str, Mapping[Quantity, float]]:
    names = {family: family.split()[0] for family in study.families}
    return {family: SLOPES[name] for family, name in names.items() if name in SLOPES}


def _same(study: Measurements, family: str) -> list[Point]:
    """Return the points of a family with the modes of the reference, or of time stepping."""
    return [p for p in study.families[family] if p.same_modes or p.setting.step]


def _grown(study: Measurements, family: str, of: Quantity) -> list[Point]:
    points = _same(study, family)
    steps = [point.steps for point in points] or [0]
    return points if max(steps) >= _GROWN[of] * min(steps) else []


def points_to_fit(study: Measurements, family: str, of: Quantity) -> list[tuple[float, float]]:
    """Return (fineness, error or steps) of the points of a fit."""
    points = _grown(study, family, of)
    if of == "steps":
        points = [p for p in points if p.steps >= _STEPS_PER_FLOW * p.flows]
        return [(p.setting.fineness, float(p.steps)) for p in points]
    least = RESOLVED * max(study.least, float(np.finfo(float).eps))
    pairs = [(p.setting.fineness, study.error(p)) for p in points]
    return [(x, e) for x, e in pairs if e is not None and least < e < _SATURATED]


# Warnings that differ in numbers only are merged.
_NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?(e[+-]?\d+)?\b")


@dataclass(frozen=True)
class Note:
    """A warning with the labels of its settings; `differs` if its numbers do."""

    text: str
    settings: tuple[str, ...]
    differs: bool

    def says_one_of(self, texts: Collection[str]) -> bool:
        """Return whether it equals one of `texts` apart from numbers."""
        return _same_apart_from_numbers(self.text) in map(_same_apart_from_numbers, texts)


def distinct_warnings(study: Measurements) -> tuple[Note, ...]:
    """Return the distinct warnings of all points."""
    found: dict[str, list[tuple[str, Point]]] = {}
    for point in study.points:
        for text in new_warnings(point.warnings, ()):
            found.setdefault(_same_apart_from_numbers(text), []).append((text, point))
    notes = []
    for alike in found.values():
        labels = tuple(point.setting.label for _, point in alike)
        notes.append(Note(alike[0][0], labels, len({text for text, _ in alike}) > 1))
    return tuple(notes)


def reasons(study: Measurements) -> dict[str, tuple[str, ...]]:
    """Return the families that deviate from the reference -> the warnings that explain it.

    A family deviates if its finest run has other modes, or an error does not converge with the
    step. Warnings of the reference are no reason.
    """
    found = {}
    for family, points in study.families.items():
        finest = min(points, key=lambda point: point.setting.fineness)
        own = new_warnings(finest.warnings, study.warnings.get(study.reference, ()))
        if own and _deviates(study, points, finest):
            found[family] = own
    return found


def new_warnings(warnings: Sequence[str], known: Collection[str]) -> tuple[str, ...]:
    """Return the distinct warnings that are not known, apart from numbers."""
    found: dict[str, str] = {}
    for text in warnings:
        found.setdefault(_same_apart_from_numbers(text), text)
    seen = set(map(_same_apart_from_numbers, known))
    return tuple(text for form, text in found.items() if form not in seen)


def _deviates(study: Measurements, points: Sequence[Point], finest: Point) -> bool:
    if study.parted is not None:
        return False
    if not finest.same_modes:
        return True
    if finest.setting.step is None:
        return False
    errors = [(p.setting.fineness, error) for p in points if (error := study.error(p)) is not None]
    return bool(study.unsettled()) or not converges(errors, study.least)


def _same_apart_from_numbers(text: str) -> str:
    return _NUMBER.sub("#", text)
