"""Measurements of a model at many settings: errors and costs of runs against a reference."""

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

from statechart.arrays import EPS, Array
from statechart.documents.declaration import Declaration
from statechart.documents.documented import Documented
from statechart.documents.setting import Setting
from statechart.engines.request import Chosen

_Time = Annotated[float, Field(ge=0)]

RESOLVED = 20.0
"""Errors below so many times the resolution of the reference are round-off."""
MIN_POINTS = 3
"""Of a slope."""
# An output converges with the step if its error falls with at least this power of it: theory says
# 1, and a quarter is beyond what chance makes of three points or more.
_CONVERGING = 0.25


class Record(BaseModel, metaclass=Documented):
    """Base of data that are written to a file and read back."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")


class Errors(Record):
    """Errors of a run against the reference; None where there is nothing to compare."""

    # As in `statechart.observation.difference.Difference`; times and outputs None where the modes
    # differ.
    state: float | None = None
    times: float | None = None
    outputs: float | None = None
    named: dict[str, float] = {}  # Of every output, whatever the modes.
    path: float | None = None  # See `statechart.observation.difference.distance`.
    # Largest difference of the energy at the events and the end, relative to its size.
    energy: float | None = None
    # Violation of constraints and cones of friction, whatever the reference.
    violations: dict[str, float] = {}

    @property
    def largest(self) -> float | None:
        """Largest error of state, times, outputs and path."""
        found = [x for x in (self.state, self.times, self.outputs, self.path) if x is not None]
        return max(found, default=None)

    @property
    def decides(self) -> str:
        """The quantity that `largest` is of."""
        parts = {"the final state": self.state, "the times of events": self.times}
        parts |= {"the path": self.path} | {f"output {n}": off for n, off in self.named.items()}
        known = {what: off for what, off in parts.items() if off is not None}
        return max(known, key=known.__getitem__, default="")

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


class Point(Record):
    """Errors and costs of the runs at one setting."""

    # Of the run. A step is run four times, of which three are shorter by up to a twentieth: events
    # fall anywhere between two steps, and the worst of the four counts.
    setting: Setting
    outcome: str  # Why it ended.
    same_modes: bool  # Whether it took the modes of the reference, one by one.
    diverged: float | None  # When it first did not.
    # When it left the reference for good to the eye; see
    # `statechart.observation.difference.parted`.
    parted: float | None
    refused: str = ""  # Why a run to an accuracy warns that it did not reach it; else empty.
    warnings: tuple[str, ...] = ()  # Warnings of its runs, each text once.
    errors: Errors  # Against the reference.
    seconds: _Time  # Median time of a run that follows others in one process: warm.
    repeats: int  # Number of runs that the median is taken of.
    # Time of the first run of a process, see `startup_cost`; None where none could be started.
    cold: _Time | None
    # Of the integrator and of the rates; evaluations are 0 where they are not counted.
    steps: int
    evaluations: int
    flows: int  # Number of arcs of the run.

    def cost(self, *, once: bool) -> float:
        """Return the seconds of a run: of the first of a process, or of one that follows others."""
        return self.seconds if self.cold is None or not once else self.cold

    @field_serializer("setting")
    def _plain(self, setting: Setting) -> dict[str, Any]:
        # No run of a study has a budget, a longest step, or a bound of its impulses.
        unused = ("budget", "max_step", "impulse_bound")
        return {name: value for name, value in asdict(setting).items() if name not in unused}


class Third(Record):
    """The third of three runs, neither reference nor check, made where two did not agree."""

    setting: str  # Its label.
    parted: float | None  # When it left the nearer of the two others for good.
    errors: Errors  # Against that.
    odd: bool  # Whether the two others agree so much better that it is taken to be wrong.
    # Relative perturbation of the start of the reference that shows how the motion magnifies
    # round-off: it may be as large as the errors of a run.
    shift: float
    # When the reference left itself by that: then one that left it need not be wrong.
    edge: float | None


class Measurements(Record):
    """Measurements of a model at many settings; see `Study`."""

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

    def of(self, model: Declaration) -> bool:
        """Return whether measurements belong to this model and this version."""
        return self.fingerprint == fingerprint(model)

    @property
    def complete(self) -> bool:
        """True if every setting was run or left out for a reason."""
        return len(self.points) + len(self.left_out) >= self.planned

    @property
    def least(self) -> float:
        """Resolution: smaller errors may be those of the reference."""
        return max(self.resolution.largest or 0.0, self.shift.largest or 0.0)

    def error(self, point: Point) -> float | None:
        """Return the error of a point: the largest, and no less than the resolution.

        Of steps without that of outputs that do not converge (`unsettled`).
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
        """Return whether a point took the modes of the reference and has an error."""
        return point.same_modes and self.error(point) is not None

    def front(self, *, once: bool = False) -> tuple[Point, ...]:
        """Return the Pareto front: no other point is at least as accurate and faster.

        Only of points that took the modes of the reference; from the fastest on. `once` asks for
        the time of the first run of a process, not of one that follows others.
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

    def meets_tolerance(self, point: Point) -> bool | None:
        """Return whether the error of a run is below its tolerance; None where that is unknown.

        Users take a tolerance for a promise of the result. A run that warns that it failed
        promises nothing.
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
        """Return family -> (number of points whose error exceeds the tolerance, of how many)."""
        missed: Counter[str] = Counter()
        known: Counter[str] = Counter()
        for point in self.points:
            kept = self.meets_tolerance(point)
            if kept is not None:
                known[point.setting.family] += 1
                missed[point.setting.family] += not kept
        return {family: (missed[family], count) for family, count in known.items()}

    def choose(self, asked: Setting, *, once: bool) -> Chosen | None:
        """Return the cheapest setting that was seen to reach an accuracy, or the best in a time.

        The error that the reference itself may have counts on top. A named engine or method
        excludes all others. `once`: see `front`. None where no setting was seen to do.
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
        if best is None:
            return None
        point = best[1]
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
    """Return a digest of a model and this version, without what does not move the model."""
    declared = model.model_dump(mode="json", exclude={"doc", "ranges", "settings"})
    text = json.dumps([version("contact-statecharts"), declared], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


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
        rounded = EPS * max(point.steps for point in having)
        pairs = [(point.setting.fineness, point.errors.named[name]) for point in having]
        if not falls(pairs, max(least, rounded / RESOLVED)):
            found[name] = min(pairs)[1]
    return found


def falls(pairs: Sequence[tuple[float, float]], least: float) -> bool:
    """Return whether errors fall with the step, within their uncertainty."""
    ordered = sorted(pairs)
    large = [(h, e) for h, e in ordered if e > max(RESOLVED * least, EPS)]
    if len(large) < MIN_POINTS or large[0] != ordered[0]:
        return True
    x, y = np.log(np.array(large)).T
    return median_slope(x, y) >= _CONVERGING
