"""What speed costs in accuracy: the record of a model run at many settings."""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_serializer

from statechart.arrays import Array
from statechart.documents.declaration import Declaration
from statechart.documents.setting import Setting

_Time = Annotated[float, Field(ge=0)]

RESOLVED = 20.0
"""Errors below so many times what the reference resolves are rounding."""
LEAST_POINTS = 3
"""Of a slope."""

# An output converges with the step if its error falls with at least this power of it: theory says
# 1, and a quarter is beyond what chance makes of three points or more.
_CONVERGING = 0.25


class _Record(BaseModel):
    """Base of what is written to a file and read back."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")


class Errors(_Record):
    """Of a run against the reference; None where there is nothing to compare.

    Attributes
    ----------
    state, times, outputs : float or None
        As in `statechart.observation.difference.Difference`; times and outputs None where the modes
        differ.
    named : mapping of str to float
        Of every output, whatever the modes.
    path : float or None
        See `statechart.observation.difference.distance`.
    energy : float or None
        Largest difference of the energy at the events and the end, relative to its size.
    violations : mapping of str to float
        By how much the run violates what must hold, whatever the reference (constraint, cone).
    """

    state: float | None = None
    times: float | None = None
    outputs: float | None = None
    named: dict[str, float] = {}
    path: float | None = None
    energy: float | None = None
    violations: dict[str, float] = {}

    @property
    def largest(self) -> float | None:
        """Of state, times, outputs and path."""
        found = [x for x in (self.state, self.times, self.outputs, self.path) if x is not None]
        return max(found, default=None)

    def without(self, names: Collection[str]) -> Errors:
        """Return the errors without those of some outputs."""
        if self.outputs is None or not names:
            return self
        left = [error for name, error in self.named.items() if name not in names]
        return self.model_copy(update={"outputs": max(left, default=0.0)})

    def worse(self, other: Errors) -> Errors:
        """Return the larger of the errors of two runs; None where one of them has none."""
        mine, its = self.model_dump(), other.model_dump()
        found = {
            name: None if its[name] is None or value is None else max(value, its[name])
            for name, value in mine.items()
            if name not in ("violations", "named")
        }
        named = {k: max(v, other.named[k]) for k, v in self.named.items() if k in other.named}
        violated = {k: max(v, other.violations.get(k, v)) for k, v in self.violations.items()}
        return Errors(**found, named=named, violations=violated)


class Point(_Record):
    """One setting: what it gave and what it cost.

    Attributes
    ----------
    setting : Setting
        What was run. A step, four times, of which three are shorter by up to a twentieth: events
        fall anywhere between two steps, and what is told is the worst of the four.
    outcome : str
        Why it ended.
    same_modes : bool
        Whether it took the modes of the reference, one by one.
    diverged : float or None
        When it first did not.
    parted : float or None
        When it left the reference for good to the eye; see
        `statechart.observation.difference.parted`.
    refused : str
        Why a run to an accuracy says itself that it did not reach it; else empty.
    errors : Errors
        Against the reference.
    seconds : float
        Median time of a run, compiling apart.
    repeats : int
        How many runs that is the median of.
    compiling : float
        How much longer the first run took.
    steps, evaluations : int
        Of the integrator and of the rates; evaluations are 0 where they are not counted.
    flows : int
        Number of arcs of the run.
    """

    setting: Setting
    outcome: str
    same_modes: bool
    diverged: float | None
    parted: float | None
    refused: str = ""
    errors: Errors
    seconds: _Time
    repeats: int
    compiling: _Time
    steps: int
    evaluations: int
    flows: int

    @field_serializer("setting")
    def _plain(self, setting: Setting) -> dict[str, Any]:
        # No run of a study has a budget.
        return {name: value for name, value in asdict(setting).items() if name != "budget"}


class Study(_Record):
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
    step : float
        Of the check, where it steps in time: no finer step can be judged. Else 0.
    planned : int
        Number of settings.
    points : tuple of Point
        Those that were run.
    left_out : mapping of str to str
        Setting -> why it was not run.
    """

    format: Literal["statechart trade 5"] = "statechart trade 5"
    model: str
    fingerprint: str
    until: float
    reference: str
    check: str
    resolution: Errors
    shift: Errors
    parted: float | None
    step: float = 0.0
    planned: int
    points: tuple[Point, ...] = ()
    left_out: dict[str, str] = {}

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

        Without that of outputs that do not converge, which are named apart (see `unsettled`).
        None where the motion has no accuracy, or the run did not get to the end.
        """
        largest = point.errors.without(self.unsettled()).largest
        if self.parted is not None or largest is None or not math.isfinite(largest):
            return None
        return max(largest, self.least)

    def unsettled(self) -> dict[str, float]:
        """Return the outputs that do not converge with the step -> their error at the shortest."""
        steps = [p for p in self.points if p.setting.step is not None]
        return {} if self.parted is not None else unsettled(steps, self.least)

    def comparable(self, point: Point) -> bool:
        """Whether a point took the modes of the reference and has an error."""
        return point.same_modes and self.error(point) is not None

    def front(self) -> tuple[Point, ...]:
        """Return the Pareto front: no other point is at least as accurate and faster.

        Only of points that took the modes of the reference; from the fastest on.
        """
        found: list[Point] = []
        least = math.inf
        for point in sorted(filter(self.comparable, self.points), key=lambda p: p.seconds):
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

    def choose(self, asked: Setting) -> Setting | None:
        """Return the cheapest setting that was seen to reach an accuracy, or the best in a time.

        Parameters
        ----------
        asked : Setting
            With an accuracy, or a budget for the run and a coarser one to compare it with,
            compiling included. An engine or a method that is named leaves out all others.

        Returns
        -------
        Setting or None
            One with a tolerance; None where none was seen to do.
        """
        best: tuple[float, Setting] | None = None
        for point in self.points:
            setting, error = point.setting, self.error(point)
            if setting.tolerance is None or not self.comparable(point) or error is None:
                continue
            if asked.engine not in (None, "auto", setting.engine):
                continue
            if asked.method not in (None, setting.method):
                continue
            if asked.accuracy is not None:
                fits, rank = error <= asked.accuracy, point.seconds
            else:
                took = 2.0 * (point.seconds + point.compiling)
                fits, rank = took <= (asked.budget or 0.0), error
            if fits and (best is None or rank < best[0]):
                best = (rank, setting)
        return None if best is None else best[1]


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
    """Return the outputs whose error does not fall with the step -> error at the shortest.

    Parameters
    ----------
    points : sequence of Point
        Of fixed steps.
    least : float
        Errors below `RESOLVED` times this cannot be told.
    """
    found = {}
    for name in dict.fromkeys(name for point in points for name in point.errors.named):
        pairs = sorted(
            (point.setting.fineness, point.errors.named[name])
            for point in points
            if name in point.errors.named
        )
        large = [(h, e) for h, e in pairs if e > max(RESOLVED * least, float(np.finfo(float).eps))]
        if len(large) < LEAST_POINTS or large[0] != pairs[0]:
            continue
        x, y = np.log(np.array(large)).T
        if median_slope(x, y) < _CONVERGING:
            found[name] = pairs[0][1]
    return found
