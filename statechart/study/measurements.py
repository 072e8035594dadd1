"""Errors and costs of runs of a model at many settings, against a reference."""

from __future__ import annotations

import hashlib
import json
import math
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
"""Least number of points of a slope."""
# Least convergence order of an output: theory gives 1, and three random points less than this.
_CONVERGING = 0.25


class Record(BaseModel, metaclass=Documented):
    """Base of data stored as JSON."""

    model_config = ConfigDict(frozen=True, extra="forbid", ser_json_inf_nan="strings")


class Errors(Record):
    """Errors of a run against the reference; None without a comparison."""

    # As in `statechart.observation.difference.Difference`; times and outputs are None if modes
    # differ.
    state: float | None = None
    times: float | None = None
    outputs: float | None = None
    named: dict[str, float] = {}  # by output, also if modes differ
    path: float | None = None  # see `statechart.observation.difference.distance`
    energy: float | None = None  # largest relative difference at the events and the end
    violations: dict[str, float] = {}  # of constraints and friction cones, without reference

    @property
    def largest(self) -> float | None:
        """Largest error of state, times, outputs and path."""
        found = [x for x in (self.state, self.times, self.outputs, self.path) if x is not None]
        return max(found, default=None)

    @property
    def parts(self) -> dict[str, float]:
        """The known errors by quantity."""
        parts = {"the final state": self.state, "the times of events": self.times}
        parts |= {"the path": self.path} | {f"output {n}": off for n, off in self.named.items()}
        return {what: off for what, off in parts.items() if off is not None}

    @property
    def decides(self) -> str:
        """The quantity with the largest error."""
        return max(self.parts, key=self.parts.__getitem__, default="")

    def without(self, names: Collection[str]) -> Errors:
        """Return the errors without some outputs."""
        if self.outputs is None or not names:
            return self
        left = [error for name, error in self.named.items() if name not in names]
        return self.model_copy(update={"outputs": max(left, default=0.0)})

    def worse(self, other: Errors) -> Errors:
        """Return the larger errors of two runs; None if one of them has none."""
        found, its = self.model_dump(exclude={"violations", "named"}), other.model_dump()
        for name, value in found.items():
            both = value is not None and its[name] is not None
            found[name] = max(value, its[name]) if both else None
        named = {k: max(v, other.named[k]) for k, v in self.named.items() if k in other.named}
        violated = {k: max(v, other.violations.get(k, v)) for k, v in self.violations.items()}
        return Errors(**found, named=named, violations=violated)


class Point(Record):
    """Errors and costs of the runs at one setting."""

    # A time step is run four times, three of them up to a twentieth shorter, and the worst counts:
    # the place of an event between two steps is random.
    setting: Setting
    outcome: str
    same_modes: bool  # as the reference
    diverged: float | None  # time of the first other mode
    parted: float | None  # see `statechart.observation.difference.separation_time`
    refused: str = ""  # warning of a run that missed its accuracy
    warnings: tuple[str, ...] = ()  # each text once
    errors: Errors
    seconds: _Time  # median of warm runs
    repeats: int  # number of warm runs
    cold: _Time | None  # first run of a process (`startup_cost`), if one could be started
    steps: int
    evaluations: int  # of the rates; 0 if not counted
    flows: int  # arcs of the run

    def cost(self, *, once: bool) -> float:
        """Return the seconds of a cold (`once`) or warm run."""
        return self.seconds if self.cold is None or not once else self.cold

    @field_serializer("setting")
    def _plain(self, setting: Setting) -> dict[str, Any]:
        # Never set in a study.
        unused = ("budget", "max_step", "impulse_bound")
        return {name: value for name, value in asdict(setting).items() if name not in unused}


class Third(Record):
    """The third run, neither reference nor check, if the first two did not agree."""

    setting: str  # label
    parted: float | None  # time of separation from the nearer of the others
    errors: Errors  # against that
    odd: bool  # whether it is taken to be wrong, since the others agree much better
    shift: float  # relative perturbation of the initial state, as large as the errors of runs
    edge: float | None  # time of separation of the reference from its perturbed run


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
        """Return whether the measurements are of this model and version."""
        return self.fingerprint == fingerprint(model)

    @property
    def complete(self) -> bool:
        """True if every setting was run or skipped for a reason."""
        return len(self.points) + len(self.left_out) >= self.planned

    @property
    def families(self) -> dict[str, list[Point]]:
        """The points by family of their settings."""
        found: dict[str, list[Point]] = {}
        for point in self.points:
            found.setdefault(point.setting.family, []).append(point)
        return found

    @property
    def least(self) -> float:
        """Resolution, below which errors may be those of the reference."""
        return max(self.resolution.largest or 0.0, self.shift.largest or 0.0)

    def error(self, point: Point) -> float | None:
        """Return the largest error of a point, at least the resolution.

        Outputs that do not converge with the step (`unconverged_outputs`) do not count. None for
        chaotic motion, or if the run did not reach the end.
        """
        errors = point.errors
        if point.setting.step is not None:
            errors = errors.without(self.unsettled())
        largest = errors.largest
        if self.parted is not None or largest is None or not math.isfinite(largest):
            return None
        return max(largest, self.least)

    def unsettled(self) -> dict[str, float]:
        """Return the outputs that do not converge with the step -> error at the shortest step."""
        steps = [p for p in self.points if p.setting.step is not None]
        finest = min((p.setting.impulse_tolerance or 0.0 for p in steps), default=0.0)
        steps = [p for p in steps if (p.setting.impulse_tolerance or 0.0) == finest]
        return {} if self.parted is not None else unconverged_outputs(steps, self.least)

    def comparable(self, point: Point) -> bool:
        """Return whether a point has the modes of the reference and an error."""
        return point.same_modes and self.error(point) is not None

    def front(self, *, once: bool = False) -> tuple[Point, ...]:
        """Return the Pareto front of error and cost, from the fastest on.

        Only comparable points count. `once`: the cost of a cold run.
        """
        found: list[Point] = []
        least = math.inf
        points = filter(self.comparable, self.points)
        for point in sorted(points, key=lambda p: p.cost(once=once)):
            if (error := self.error(point) or 0.0) < least:
                least = error
                found.append(point)
        return tuple(found)

    def meets_tolerance(self, point: Point) -> bool | None:
        """Return whether the error of a run is below its tolerance; None if unknown.

        A run that warns that it missed its accuracy counts as unknown.
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
        """Return family -> (number of points with error above tolerance, number of points)."""
        found: dict[str, list[bool]] = {}
        for point in self.points:
            kept = self.meets_tolerance(point)
            if kept is not None:
                found.setdefault(point.setting.family, []).append(not kept)
        return {family: (sum(missed), len(missed)) for family, missed in found.items()}

    def choose(self, requested: Setting, *, once: bool) -> Chosen | None:
        """Return the cheapest measured setting for an accuracy, or the most accurate for a budget.

        The resolution is added to the errors. A named engine or method excludes others. `once`: see
        `front`. None if no setting suffices.
        """
        able: list[tuple[float, float, Point]] = []
        for point in filter(self.comparable, self.points):
            setting, error = point.setting, (self.error(point) or 0.0) + self.least
            if setting.tolerance is None or requested.method not in (None, setting.method):
                continue
            if requested.engine not in (None, "auto", setting.engine):
                continue
            cost = point.cost(once=once)
            if requested.accuracy is not None and error <= requested.accuracy:
                able.append((cost, error, point))
            elif requested.accuracy is None and 2.0 * cost <= (requested.budget or 0.0):
                able.append((error, error, point))
        if not able:
            return None
        _, error, point = min(able, key=lambda one: one[0])
        counts = point.steps, point.evaluations, point.flows
        return Chosen(point.setting, error, point.outcome, *counts, point.errors.decides)


def fingerprint(model: Declaration) -> str:
    """Return a digest of this version and the parts of a model that affect its motion."""
    declared = model.model_dump(mode="json", exclude={"doc", "ranges", "settings"})
    text = json.dumps([version("contact-statecharts"), declared], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def median_slope(x: Array, y: Array) -> float:
    """Return the Theil-Sen estimator: the median slope of all pairs of points."""
    i, j = np.triu_indices(len(x), 1)
    return float(np.median((y[j] - y[i]) / (x[j] - x[i])))


def unconverged_outputs(points: Sequence[Point], least: float) -> dict[str, float]:
    """Return the outputs that do not converge with the step -> error at the shortest step."""
    found = {}
    for name in dict.fromkeys(name for point in points for name in point.errors.named):
        having = [point for point in points if name in point.errors.named]
        # Accumulated round-off.
        rounded = EPS * max(point.steps for point in having)
        pairs = [(point.setting.fineness, point.errors.named[name]) for point in having]
        if not converges(pairs, max(least, rounded / RESOLVED)):
            found[name] = min(pairs)[1]
    return found


def converges(pairs: Sequence[tuple[float, float]], least: float) -> bool:
    """Return whether errors converge with the step, within their uncertainty."""
    ordered = sorted(pairs)
    large = [(h, e) for h, e in ordered if e > max(RESOLVED * least, EPS)]
    if len(large) < MIN_POINTS or large[0] != ordered[0]:
        return True
    x, y = np.log(np.array(large)).T
    return median_slope(x, y) >= _CONVERGING
