"""What speed costs in accuracy: the record of a model run at many settings."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from statechart.arrays import Array
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting
from statechart.engines.request import Chosen
from statechart.study.point import RESOLVED, Errors, Point, Record, Third

LEAST_POINTS = 3
"""Of a slope."""

# An output converges with the step if its error falls with at least this power of it: theory says
# 1, and a quarter is beyond what chance makes of three points or more.
_CONVERGING = 0.25


class Study(Record):
    """A model at many settings.

    Attributes
    ----------
    model, fingerprint : str
        Name of the model, and what tells it from any other.
    until : float
        End of the runs.
    reference, check : str
        The run that the others are compared with, and the independent one that it was compared
        with itself.
    resolution : Errors
        Difference of these two.
    shift : Errors
        Of the reference from its run with twice the tolerance of forces, which all runs share.
    parted : float or None
        When these two left each other: then the motion is chaotic or on a knife's edge, and what
        is measured is when runs leave the reference, not errors.
    third : Third or None
        A run of a third kind, where two did not agree: reference and check are the two of three
        that agree best.
    step : float
        Of the check, where it steps in time: no finer step can be judged. Else 0.
    planned : int
        Number of settings.
    warnings : mapping of str to tuple of str
        What the runs of reference, check and third warn of, by their labels.
    points : tuple of Point
        Those that were run.
    left_out : mapping of str to str
        Setting -> why it was not run.
    """

    METHODS: ClassVar[tuple[str, ...]] = ("choose", "error", "front", "kept", "missed")

    format: Literal["statechart trade 6"] = "statechart trade 6"
    model: str
    fingerprint: str
    until: float
    reference: str
    check: str
    resolution: Errors
    shift: Errors
    parted: float | None
    third: Third | None = None
    step: float = 0.0
    planned: int
    warnings: dict[str, tuple[str, ...]] = Field(default={})
    points: tuple[Point, ...] = ()
    left_out: dict[str, str] = Field(default={})

    def __str__(self) -> str:
        from statechart.study.report import text

        return text(self)

    def shown(self, label: str) -> dict[str, Any]:
        """Return what the page of a run shows of it; the run's own setting has this label."""
        from statechart.study.figure import shown

        return shown(self, label)

    def of(self, model: Declaration) -> bool:
        """Whether a model is the one that was measured, by this version."""
        return self.fingerprint == fingerprint(model)

    @property
    def complete(self) -> bool:
        """Whether every setting was run or left out for a reason."""
        return len(self.points) + len(self.left_out) >= self.planned

    @property
    def least(self) -> float:
        """What can be told: smaller errors may be those of the reference."""
        return max(self.resolution.largest or 0.0, self.shift.largest or 0.0)

    def error(self, point: Point) -> float | None:
        """Return the error of a point: the largest, and no less than what can be told.

        Of steps without that of outputs that do not converge, which are named apart (`unsettled`).
        None where the motion has no accuracy, or the run did not get to the end.
        """
        errors = point.errors
        if point.setting.step is not None:
            errors = errors.without(self.unsettled())
        largest = errors.largest
        if self.parted is not None or largest is None or not math.isfinite(largest):
            return None
        return max(largest, self.least)

    def unsettled(self) -> dict[str, float]:
        """Return the outputs that do not converge with the step -> their error at the shortest."""
        steps = [p for p in self.points if p.setting.step is not None]
        finest = min((p.setting.impulse_tolerance or 0.0 for p in steps), default=0.0)
        steps = [p for p in steps if (p.setting.impulse_tolerance or 0.0) == finest]
        return {} if self.parted is not None else unsettled(steps, self.least)

    def comparable(self, point: Point) -> bool:
        """Whether a point took the modes of the reference and has an error."""
        return point.same_modes and self.error(point) is not None

    def front(self, *, once: bool = False) -> tuple[Point, ...]:
        """Return the Pareto front: no other point is at least as accurate and faster.

        Only of points that took the modes of the reference; from the fastest on.

        Parameters
        ----------
        once : bool
            Whether that is the first run of a process, or one that follows others.
        """
        found: list[Point] = []
        least = math.inf
        points = filter(self.comparable, self.points)
        for point in sorted(points, key=lambda p: p.cost(once=once)):
            error = self.error(point)
            if error is not None and error < least:
                least = error
                found.append(point)
        return tuple(found)

    def kept(self, point: Point) -> bool | None:
        """Return whether a run kept what it promised; None where that cannot be told.

        A tolerance is taken for a promise of the result, which is what users hope for. A run
        that says itself that it failed promises nothing.
        """
        promise = point.setting.promise
        if promise is None or point.refused or self.parted is not None:
            return None
        if not point.same_modes:
            return False
        error = self.error(point)
        if error is None or promise < self.least:
            return None
        return error <= promise

    def missed(self) -> dict[str, tuple[int, int]]:
        """Return family -> (how many missed what they promised, of how many)."""
        missed: Counter[str] = Counter()
        told: Counter[str] = Counter()
        for point in self.points:
            kept = self.kept(point)
            if kept is not None:
                told[point.setting.family] += 1
                missed[point.setting.family] += not kept
        return {family: (missed[family], count) for family, count in told.items()}

    def choose(self, asked: Setting, *, once: bool) -> Chosen | None:
        """Return the cheapest setting that was seen to reach an accuracy, or the best in a time.

        What reaches it does so with the error that the reference itself may have on top.

        Parameters
        ----------
        asked : Setting
            With an accuracy, or a budget for the run and a coarser one to compare it with. An
            engine or a method that is named leaves out all others.
        once : bool
            Whether the first run of a process is to be cheap, or those that follow it.

        Returns
        -------
        Chosen or None
            One with a tolerance; None where none was seen to do.
        """
        best: tuple[float, Point] | None = None
        for point in self.points:
            setting, error = point.setting, self.error(point)
            if setting.tolerance is None or not self.comparable(point) or error is None:
                continue
            if asked.engine not in (None, "auto", setting.engine):
                continue
            if asked.method not in (None, setting.method):
                continue
            if asked.accuracy is not None:
                fits, rank = error + self.least <= asked.accuracy, point.cost(once=once)
            else:
                took = 2.0 * point.cost(once=once)
                fits, rank = took <= (asked.budget or 0.0), error
            if fits and (best is None or rank < best[0]):
                best = (rank, point)
        return None if best is None else self._chosen(best[1])

    def _chosen(self, point: Point) -> Chosen:
        return Chosen(
            point.setting,
            (self.error(point) or 0.0) + self.least,
            point.outcome,
            point.steps,
            point.evaluations,
            point.flows,
            point.errors.decides,
        )


def fingerprint(model: Declaration) -> str:
    """Return what tells a model from any other, and from itself run by another version.

    What does not move the model is left out.
    """
    told = model.model_dump(mode="json", exclude={"doc", "ranges", "settings"})
    text = json.dumps([version("contact-statecharts"), told], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def ordered(points: Sequence[Point]) -> list[Point]:
    """Return points family by family, from coarse to fine."""
    families = list(dict.fromkeys(point.setting.family for point in points))
    return sorted(points, key=lambda p: (families.index(p.setting.family), -p.setting.fineness))


def median_slope(x: Array, y: Array) -> float:
    """Return the median slope of all pairs of points (Theil, 1950; Sen, 1968)."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))


def unsettled(points: Sequence[Point], least: float) -> dict[str, float]:
    """Return the outputs whose error does not fall with the step -> error at the shortest."""
    found = {}
    for name in dict.fromkeys(name for point in points for name in point.errors.named):
        having = [point for point in points if name in point.errors.named]
        # Every step rounds.
        rounded = float(np.finfo(float).eps) * max(point.steps for point in having)
        pairs = [(point.setting.fineness, point.errors.named[name]) for point in having]
        if not falls(pairs, max(least, rounded / RESOLVED)):
            found[name] = min(pairs)[1]
    return found


def falls(pairs: Sequence[tuple[float, float]], least: float) -> bool:
    """Whether errors fall with the step, or cannot be told not to."""
    ordered = sorted(pairs)
    large = [(h, e) for h, e in ordered if e > max(RESOLVED * least, float(np.finfo(float).eps))]
    if len(large) < LEAST_POINTS or large[0] != ordered[0]:
        return True
    x, y = np.log(np.array(large)).T
    return median_slope(x, y) >= _CONVERGING
