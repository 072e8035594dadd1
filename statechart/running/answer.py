"""The answer to what is asked of a model: the best of several runs, with its error and its cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from statechart.automaton.trace import Outcome, Trace
from statechart.documents.setting import Setting
from statechart.observation.batch_outputs import OutputValue as Output
from statechart.observation.observer import Observer
from statechart.observation.outputs import Outputs, Scales

UNTOLD = (Outcome.OUT_OF_BUDGET, Outcome.UNSUPPORTED)
"""How runs end that say nothing of their error."""


@dataclass(frozen=True)
class Cost:
    """What an answer took.

    Attributes
    ----------
    runs, steps, evaluations : int
        Over all runs; evaluations of the rates are 0 where the engine does not count them.
    seconds : float
        Wall time; kernels that were compiled meanwhile, once on a machine, are no part of it.
    """

    runs: int
    steps: int
    evaluations: int
    seconds: float

    def __add__(self, other: Cost) -> Cost:
        """Return what both took."""
        return Cost(
            self.runs + other.runs,
            self.steps + other.steps,
            self.evaluations + other.evaluations,
            self.seconds + other.seconds,
        )


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
    decides : str
        The quantity whose error the estimate is, with its values in two runs; else empty.
    """

    setting: Setting
    basis: str
    cost: Cost
    not_judged: tuple[str, ...] = ()
    decides: str = ""

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
            "decides": self.decides,
        }


@dataclass(frozen=True, eq=False)
class Answer:
    """The best of several runs, with an estimate of its error.

    Attributes
    ----------
    observer, trace
        Of that run.
    estimate : float or None
        Its largest difference from the run at the tolerance before; inf where the two took
        different modes, None where there was only one.
    cost : Cost
        Of all runs.
    warnings : tuple of str
        Why the estimate is not what was asked for; empty where it is.
    not_judged : tuple of str
        Outputs that the estimate leaves out: they count or list the events of a Zeno sequence,
        which have no end. Of lists, what both runs have is compared.
    decides : str
        As of `Asked`.
    """

    observer: Observer
    trace: Trace
    estimate: float | None
    cost: Cost
    warnings: tuple[str, ...] = ()
    not_judged: tuple[str, ...] = ()
    decides: str = ""


class Made(NamedTuple):
    """A run, its outputs, their scales, and those that have any number of events."""

    trace: Trace
    outputs: Mapping[str, Output]
    scales: Scales
    endless: frozenset[str]

    @classmethod
    def of(cls, observer: Observer, trace: Trace) -> Made:
        """Evaluate the outputs of a run."""
        outputs = Outputs(observer)
        return cls(trace, outputs.of(trace), outputs.scales(trace), outputs.endless(trace))
