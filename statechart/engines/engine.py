"""Interface of an integrator, and the dense output that it computes."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import Enum
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.constraints import Constraints
from statechart.automaton.modes import Reconstruction
from statechart.automaton.regions import Mode
from statechart.automaton.trace import LARGEST
from statechart.compiling import working_time
from statechart.errors import OutOfBudget, StepFailure, TooLong
from statechart.formulas.tape import Tape


class TimeBudget:
    """Time budget of several runs; a compilation is not interrupted."""

    def __init__(self, seconds: float, clock: Callable[[], float] = working_time) -> None:
        self.seconds, self.clock = seconds, clock
        self._until = math.inf

    def begin(self) -> None:
        """Start the clock."""
        self._until = self.clock() + self.seconds

    def remove_limit(self) -> None:
        """Remove the limit."""
        self._until = math.inf

    def check(self, now: float) -> None:
        """Raise if the time is over; `now` is the time that the run reached."""
        if self.clock() > self._until:
            raise OutOfBudget(
                f"the {self.seconds:g} s were used up at t = {now:.6g}; allow more time, "
                "shorten the run, or take a looser tolerance"
            )


# Initial capacity of a path in steps.
_MIN_CAPACITY = 64


class Path:
    """Steps of the current flow, in reused arrays that grow.

    `times` (capacity + 1,) are the ends of steps since the start of the flow; `coefficients`
    (capacity, n, d + 1) are as in `Arc`. Both are valid for the first `count` steps.
    """

    def __init__(self) -> None:
        self.times: Array = np.zeros(1)
        self.coefficients: Array = np.empty((0, 0, 0))
        self.count = 0

    def reserve(self, steps: int, variables: int, terms: int) -> None:
        """Reserve capacity for further steps of at least so many terms.

        Raise `TooLong` above the memory limit of a trace, `StepFailure` if there is no memory.
        """
        capacity, _, width = self.coefficients.shape
        needed = self.count + steps
        if needed <= capacity and (terms == width or (terms < width and self.count > 0)):
            return
        if self.count > 0:
            terms = max(terms, width)
        capacity = capacity if needed <= capacity else max(2 * capacity, needed, _MIN_CAPACITY)
        if 8 * self.count * variables * terms > LARGEST:
            raise TooLong(
                f"{self.count} steps in one mode take {LARGEST >> 20} MB, the largest trace "
                "allowed; end the run earlier, or remove what makes the steps so short"
            )
        try:
            times, coefficients = np.zeros(capacity + 1), np.zeros((capacity, variables, terms))
        except MemoryError:
            raise StepFailure(
                f"{self.count} steps in one mode fill the memory; end the run earlier, or "
                "remove what makes the steps so short"
            ) from None
        if self.count > 0:
            times[: self.count + 1] = self.times[: self.count + 1]
            coefficients[: self.count, :, :width] = self.coefficients[: self.count]
        self.times, self.coefficients = times, coefficients

    def append(self, duration: float, coefficients: Array) -> None:
        """Add a step with polynomials (n, d + 1) of any degree."""
        variables, terms = coefficients.shape
        self.reserve(1, variables, terms)
        self.coefficients[self.count, :, :terms] = coefficients
        self.coefficients[self.count, :, terms:] = 0.0
        self.times[self.count + 1] = self.times[self.count] + duration
        self.count += 1

    def arc(self) -> tuple[Array, Array]:
        """Return times and coefficients of the steps, as in `Arc`."""
        return self.times[: self.count + 1].copy(), self.coefficients[: self.count].copy()


FIRST_CHUNK = 4
LONGEST_CHUNK = 64
"""Steps are computed in chunks that grow by half, so that few are discarded after an event."""
GROWTH = 16.0
"""Growth factor of the look-ahead in time."""
MAX_DEFECT_BOXES = 256
"""Boxes of the search for the defect of a step."""
NEAR = 0.05
"""Constraint residual, in tolerances, above which a state is projected."""


class Continuation(Enum):
    """Start of a call for steps, relative to the last call."""

    NEW = "a new flow, or a new run"
    MOVED = "the same flow; its state was projected"
    ON = "the same flow, from its last state"
    BACK = "the same flow, from an earlier state"


class FlowWatch(NamedTuple):
    """A flow with its guards and constraints."""

    guards: Tape  # outputs: the margins whose fall is an event
    tolerances: Array  # (g,) of the margins
    constraints: Constraints
    parameters: Array  # (p,)
    start: float
    reconstruction: Reconstruction  # of dependent coordinates


class Pace(NamedTuple):
    """Tolerances and step limits of an engine."""

    tolerance: float
    max_step: float
    allowed: float  # as of `Engine`
    terms: int  # of the series


class StepFunction(NamedTuple):
    """Step function of a mode, for compiled loops."""

    address: int  # see `statechart.engines.taylor_loop.Step`
    fixed: Tape  # its parameters after the time, from those of the automaton
    takes: int  # number of its parameters, including the time
    pace: Pace


class Engine(ABC):
    """An integrator of one tolerance: it computes steps of a mode, without events."""

    name: str
    method: str
    tolerance: float  # relative
    sharp: bool = False  # the cost hardly rises with the accuracy
    gives_way: bool = False  # runs on a stiff mode end, so that another engine replaces it
    evaluations: int = 0  # of the rates; 0 if not counted
    sizes: Array | None = None  # (n,) scales of the variables in a run
    floor: Array | float = 0.0  # (n,) absolute tolerance / relative tolerance in a flow
    time_budget: TimeBudget | None = None  # such runs are computed step by step
    # Allowed error of the slope at the end of a step, relative to a variable and its change. The
    # slope of dense output has a lower order than the step.
    allowed: float

    @property
    def title(self) -> str:
        """Engine and method as text."""
        return self.name if self.method == self.name else f"{self.name} {self.method}"

    @abstractmethod
    def compile(self, automaton: Automaton, mode: Mode, rates: Tape) -> object:
        """Return the stepper of a mode with these rates, for `steps`."""

    def step_function(self, stepper: object) -> StepFunction | None:
        """Return the step function of a stepper for compiled loops, or None."""
        return None

    def check(  # noqa: B027
        self, stepper: object, path: Path, state: Array, parameters: Array, time: float
    ) -> None:
        """Raise if the method cannot continue from a state, after a path, with any step."""

    @abstractmethod
    def steps(
        self,
        stepper: object,
        path: Path,
        watch: FlowWatch,
        state: Array,
        until: float,
        count: int,
        continuation: Continuation,
        end: Array,
    ) -> bool:
        """Append up to `count` steps to `path`; return whether the last one ends at `until`.

        `until` is met exactly. `begin` relates `state` (n,) to the last call with this stepper;
        `end` (n,) receives the last state. An error means that no step is possible.
        """
