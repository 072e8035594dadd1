"""Convergence orders against theory, and the warnings that explain why a family deviates.

Errors and steps fall with powers of the tolerance, or of the step where it is fixed.
"""

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
    falls,
    median_slope,
)

Quantity = Literal["error", "steps"]

SLOPES: Mapping[str, Mapping[Quantity, float]] = {
    "RK45": {"error": 1.0, "steps": -1.0 / 5.0},
    "DOP853": {"error": 1.0, "steps": -1.0 / 8.0},
    "impulse": {"error": 1.0},
}
"""Powers of the tolerance (of the step, where it is fixed) that error and steps of a family follow.

SciPy keeps the error of every step, of order p in its length, at the tolerance and goes on with
the better of its two solutions: the steps are as long as tol^(1/p), p = 5 for RK45 and 8 for
DOP853, and the error of all of them is of order h^p = tol (Hairer, Norsett, Wanner, "Solving
Ordinary Differential Equations I", section II.4). Steps are those accepted: the part that is
rejected falls with the tolerance. The theory of a fixed step is order 1 (Moreau, Jean), of the
path that a run takes: it holds whether or not its modes are those of the reference, as where
bounces accumulate."""

# Largest error that a slope is fitted to: above, the error is as large as the motion.
_SATURATED = 1e-1
# A slope of the steps is fitted where a flow takes at least so many: its first step and its last,
# which an event cuts short, are no matter of the tolerance.
_STEPS_PER_FLOW = 10.0
# The tolerance decides errors and steps where the finest run takes so many times the steps of the
# coarsest. Flights along parabolas and bodies at rest take steps that no tolerance decides: at six
# times they are no more than a sixth of all.
_GROWN: Mapping[Quantity, float] = {"error": 3.0, "steps": 6.0}


@dataclass(frozen=True)
class Slope:
    """A straight line, in logarithms, through points of a family of settings."""

    family: str  # See `Setting.family`.
    of: Quantity  # What follows the tolerance or the step: error, or steps (accepted ones).
    slope: float  # Its power.
    # Standard error of the slope, from the distances of points from the line. With a fixed step it
    # is large: an event falls anywhere between two steps, and so does its error.
    scatter: float
    theory: float  # The power of theory, see `SLOPES`.
    points: int  # Number of points that it was fitted to.


def slopes(study: Measurements) -> tuple[Slope, ...]:
    """Fit the slopes of the families that have enough points to fit, where a theory holds."""
    found = []
    for family, theories in _theories(study).items():
        for of, theory in theories.items():
            points = fitted(study, family, of)
            if len(points) < MIN_POINTS:
                continue
            x, y = np.log(np.array(points)).T
            # Where errors of steps and events happen to cancel, one point is far below the line.
            slope = median_slope(x, y)
            if slope * theory <= 0.0:
                continue
            off = y - np.median(y - slope * x) - slope * x
            scatter = math.sqrt(float(off @ off) / (len(x) - 2)) / (float(x.std()) * len(x) ** 0.5)
            found.append(Slope(family, of, slope, scatter, theory, len(points)))
    return tuple(found)


def unfitted(study: Measurements) -> dict[str, str]:
    """Return quantities of the families run that have a theory but no slope -> why."""
    known = {(slope.family, slope.of) for slope in slopes(study)}
    deviating, found = reasons(study), {}
    for family, theories in _theories(study).items():
        for of in theories:
            if (family, of) in known:
                continue
            if study.parted is not None and of == "error":
                why = "there are no errors"
            elif family in deviating and of == "error":
                why = "its runs differ for the reason that they warn of"
            elif len(fitted(study, family, of)) >= MIN_POINTS:
                why = "it does not fall: it is round-off, or the runs take other modes"
            elif len(_same(study, family)) < MIN_POINTS:
                why = "few runs take the modes of the reference"
            elif not _grown(study, family, of):
                why = "the tolerance hardly decides the steps"
            elif of == "steps":
                why = f"few runs have {_STEPS_PER_FLOW:g} steps a flow"
            else:
                why = (
                    f"too few runs have an error below {_SATURATED:g} and above the "
                    f"resolution of the reference ({RESOLVED * study.least:.0e})"
                )
            found[f"{of} of {family}"] = why
    return found


def _theories(study: Measurements) -> dict[str, Mapping[Quantity, float]]:
    families = dict.fromkeys(point.setting.family for point in study.points)
    names = {family: family.split()[0] for family in families}
    return {family: SLOPES[name] for family, name in names.items() if name in SLOPES}


def _same(study: Measurements, family: str) -> list[Point]:
    """Return the points of a family that took the reference's modes, or do not have to."""
    return [
        p for p in study.points if p.setting.family == family and (p.same_modes or p.setting.step)
    ]


def _grown(study: Measurements, family: str, of: Quantity) -> list[Point]:
    points = _same(study, family)
    steps = [p.steps for p in points]
    return points if points and max(steps) >= _GROWN[of] * min(steps) else []


def fitted(study: Measurements, family: str, of: Quantity) -> list[tuple[float, float]]:
    """Return (fineness, error or steps) of the points that a slope is fitted to."""
    points = _grown(study, family, of)
    if of == "steps":
        return [
            (p.setting.fineness, float(p.steps))
            for p in points
            if p.steps >= _STEPS_PER_FLOW * p.flows
        ]
    least = RESOLVED * max(study.least, float(np.finfo(float).eps))
    pairs = [(p.setting.fineness, study.error(p)) for p in points]
    return [(x, e) for x, e in pairs if e is not None and least < e < _SATURATED]


# Warnings that differ in numbers only are one.
_NUMBER = re.compile(r"(?<![\w.])\d+(\.\d+)?(e[+-]?\d+)?\b")


@dataclass(frozen=True)
class Note:
    """A warning, the labels of the settings whose runs have it, and whether its numbers differ."""

    text: str
    settings: tuple[str, ...]
    differs: bool

    def says_one_of(self, texts: Collection[str]) -> bool:
        """Return whether a warning equals one of several, apart from its numbers."""
        return _alike(self.text) in map(_alike, texts)


def notes(study: Measurements) -> tuple[Note, ...]:
    """Return the warnings of the runs of all points, each text once."""
    found: dict[str, list[tuple[str, Point]]] = {}
    for point in study.points:
        for text in beyond(point.warnings, ()):
            found.setdefault(_alike(text), []).append((text, point))
    return tuple(
        Note(
            alike[0][0],
            tuple(point.setting.label for _, point in alike),
            len({text for text, _ in alike}) > 1,
        )
        for alike in found.values()
    )


def reasons(study: Measurements) -> dict[str, tuple[str, ...]]:
    """Return the families that deviate from the reference -> the warnings that explain it.

    A family deviates where the finest of its runs takes other modes, or where its error, or that of
    an output, does not fall with the step. A warning of the reference, too, is no reason.
    """
    families: dict[str, list[Point]] = {}
    for point in study.points:
        families.setdefault(point.setting.family, []).append(point)
    found = {}
    for family, points in families.items():
        finest = min(points, key=lambda point: point.setting.fineness)
        own = beyond(finest.warnings, study.warnings.get(study.reference, ()))
        if own and _deviates(study, points, finest):
            found[family] = own
    return found


def beyond(warnings: Sequence[str], known: Collection[str]) -> tuple[str, ...]:
    """Return the warnings that are not known, each once, but for numbers in them."""
    seen = set(map(_alike, known))
    found = []
    for text in warnings:
        if _alike(text) not in seen:
            seen.add(_alike(text))
            found.append(text)
    return tuple(found)


def _deviates(study: Measurements, points: Sequence[Point], finest: Point) -> bool:
    if study.parted is not None:
        return False
    if not finest.same_modes:
        return True
    if finest.setting.step is None:
        return False
    errors = [(p.setting.fineness, error) for p in points if (error := study.error(p)) is not None]
    return bool(study.unsettled()) or not falls(errors, study.least)


def _alike(text: str) -> str:
    return _NUMBER.sub("#", text)
