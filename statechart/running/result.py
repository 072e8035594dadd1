"""What a run gave: its trace, what can be evaluated along it, and what was asked for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from statechart.automaton.trace import Trace
from statechart.documents.setting import Setting
from statechart.observation.observer import Observer
from statechart.observation.outputs import OutputValue as Output
from statechart.reporting.pieces import Pieces
from statechart.running.estimate import Cost

if TYPE_CHECKING:
    from statechart.running.runner import Runner


@dataclass(frozen=True)
class Asked:
    """What was asked for instead of a tolerance, and what it took.

    Attributes
    ----------
    setting : Setting
        With the accuracy or the budget allowed.
    basis : str
        What the tolerance, or the first of several tolerances or steps, was chosen by.
    cost : Cost
        Of all runs.
    not_judged : tuple of str
        Outputs that the estimate leaves out: how often a Zeno sequence bounces has no answer.
    """

    setting: Setting
    basis: str
    cost: Cost
    not_judged: tuple[str, ...] = ()

    def reached(self, estimate: float | None) -> bool:
        """Whether `estimate` is what was asked for: of an accuracy, any of a budget."""
        return estimate is not None and estimate <= (self.setting.accuracy or math.inf)

    def report(self, estimate: float | None) -> dict[str, Any]:
        """Return this as one plain object."""
        return {
            "accuracy": self.setting.accuracy,
            "budget": self.setting.budget,
            "reached": self.reached(estimate),
            "basis": self.basis,
            "cost": asdict(self.cost),
            "not_judged": list(self.not_judged),
        }


@dataclass(frozen=True, eq=False)
class Result:
    """What a run gave.

    Attributes
    ----------
    trace : Trace
        Arcs and jumps, the outcome, warnings, costs.
    observer : Observer
        Evaluates formulas along the trace.
    error_estimate : float or None
        Where an accuracy was asked for: the largest difference between this run and one at 20
        times its tolerance, or what the scheme's order makes of those at up to four times its
        step, of the final state, the times of events and the outputs, each relative to its own
        size; inf where there is none. Of a run that a study measured, its error against the study's
        reference, and what that may be off by. None where nothing was estimated.
    timings : mapping of str to float
        What took how many seconds.
    runner : Runner
        What made it.
    asked : Asked or None
        The accuracy or the budget that was asked for, and what it took.
    """

    trace: Trace
    observer: Observer
    error_estimate: float | None
    timings: Mapping[str, float]
    runner: Runner
    asked: Asked | None = None

    def __reduce__(self) -> tuple[object, ...]:
        """Travel as what was found and what made it: the observer is made anew there."""
        setting = self.runner.setting
        if self.asked is not None:  # the tolerance or the step was found
            found = {"step": self.trace.step, "accuracy": None}
            tolerance = {"tolerance": self.trace.tolerance}
            setting = replace(setting, **(found if setting.stepped else tolerance))
        return _remade, (
            self.runner, setting, self.trace, self.error_estimate, self.timings, self.asked
        )  # fmt: skip

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know."""
        return self.trace.warnings

    @cached_property
    def outputs(self) -> Mapping[str, Output]:
        """The outputs that the model declares."""
        return self.runner.observers.outputs(self.observer).of(self.trace)

    @property
    def endless(self) -> frozenset[str]:
        """The outputs that count or list events of which a Zeno sequence has no end."""
        return self.runner.observers.outputs(self.observer).endless(self.trace)

    @cached_property
    def conditions(self) -> tuple[float | None, ...]:
        """How much an error is magnified into the time of every event; see `conditions`."""
        from statechart.observation.condition import conditions

        return conditions(self.observer, self.trace)

    def report(self, *, explain: bool = False, pieces: Pieces | None = None) -> dict[str, Any]:
        """Return the run as one plain object; see `statechart.reporting.report.report`."""
        from statechart.reporting.report import report

        return report(
            self.observer,
            self.trace,
            error_estimate=self.error_estimate,
            timings=self.timings,
            explain=explain,
            asked=None if self.asked is None else self.asked.report(self.error_estimate),
            conditions=() if self.asked is None else self.conditions,
            pieces=pieces,
        )

    def save(self, folder: Path | str) -> tuple[str, ...]:
        """Write tables, data set and figure; see `statechart.reporting.tables.write_run`."""
        from statechart.reporting.tables import write_run

        return write_run(folder, self.observer, self.trace, lambda: self.report(explain=True))


def _remade(
    runner: Runner,
    setting: Setting,
    trace: Trace,
    estimate: float | None,
    timings: Mapping[str, float],
    asked: Asked | None,
) -> Result:
    return Result(trace, runner.observers.at(setting), estimate, timings, runner, asked)
