"""The interface of an integrator, and the path that it makes."""

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


class Allowance:
    """Seconds that several runs share. A mode that is being compiled is not interrupted."""

    def __init__(self, seconds: float, clock: Callable[[], float] = working_time) -> None:
        self.seconds, self.clock = seconds, clock
        self._until = math.inf

    def begin(self) -> None:
        """Count from now on."""
        self._until = self.clock() + self.seconds

    def remove_limit(self) -> None:
        """Remove the limit."""
        self._until = math.inf

    def check_for(self, seconds: float) -> None:
        """Raise where there is no time for a compilation of so many `seconds`."""
        if seconds and self.clock() + seconds > self._until:
            raise OutOfBudget(
                f"{self.seconds:g} s are too few to compile the mode's integrator; allow more time"
            )

    def check(self, now: float) -> None:
        """Raise where the time is over; `now` is how far the run came."""
        if self.clock() > self._until:
            raise OutOfBudget(
                f"the {self.seconds:g} s were used up at t = {now:.6g}; allow more time, "
                "shorten the run, or take a looser tolerance"
            )


# Initial capacity of a path in steps.
_MIN_CAPACITY = 64


class Path:
    """The steps of the flow under way, in arrays that grow and are used again.

    `times` (capacity + 1,) are the ends of steps, counted from where the flow starts;
    `coefficients` (capacity, n, d + 1) are as in `Arc`. Beyond `count` steps both are void.
    """

    def __init__(self) -> None:
        self.times: Array = np.zeros(1)
        self.coefficients: Array = np.empty((0, 0, 0))
        self.count = 0

    def reserve(self, steps: int, variables: int, terms: int) -> None:
        """Reserve capacity for so many more steps, of at least so many terms.

        Raise `TooLong` if a trace may not take as much memory, `StepFailure` if there is none.
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
        """Add a step; its polynomials (n, d + 1) may be of any degree."""
        variables, terms = coefficients.shape
        self.reserve(1, variables, terms)
        self.coefficients[self.count, :, :terms] = coefficients
        self.coefficients[self.count, :, terms:] = 0.0
        self.times[self.count + 1] = self.times[self.count] + duration
        self.count += 1

    def arc(self) -> tuple[Array, Array]:
        """Return times and coefficients of the steps made, as in `Arc`."""
        return self.times[: self.count + 1].copy(), self.coefficients[: self.count].copy()


FIRST_CHUNK = 4
LONGEST_CHUNK = 64
"""Steps are made in chunks that grow by half, so that little is dropped behind an early event."""
GROWTH = 16.0
"""By which the look-ahead in time grows."""
MAX_DEFECT_BOXES = 256
"""Boxes in which a step is looked at for what it missed of its rates."""
NEAR = 0.05
"""A state may be this far off the constraints, in tolerances, before it is projected."""


class Begin(Enum):
    """Continuation of a call for steps."""

    NEW = "another flow, or another run"
    MOVED = "the same flow, its state projected since"
    ON = "the same flow, where it was left"
    BACK = "the same flow, from before where it was left"


class FlowWatch(NamedTuple):
    """A flow, and what it is watched for."""

    guards: Tape  # Outputs: the margins whose fall is an event.
    tolerances: Array  # (g,): how far below zero each may go.
    constraints: Constraints  # Constraints of the states.
    parameters: Array  # (p,): values of the automaton's parameters.
    start: float  # Start of the flow.
    reconstruction: Reconstruction  # The dependent coordinates.


class Pace(NamedTuple):
    """Tolerances and step limits of an engine."""

    # See `Engine`, and the longest step in time.
    tolerance: float
    max_step: float
    allowed: float
    terms: int  # Number of terms of its series.


class Entry(NamedTuple):
    """Entry of compiled loops into a mode's step."""

    address: int  # See `statechart.engines.taylor_loop.Step`.
    fixed: Tape  # Its parameters behind the time, from the automaton's.
    takes: int  # Number of its parameters, the time among them.
    pace: Pace


class Engine(ABC):
    """An integrator: it makes a mode's steps, and knows nothing of events.

    An engine is created for one tolerance and may keep what it compiled for a mode.
    """

    # Its name, and that of its method; the same where there is only one.
    name: str
    method: str
    tolerance: float  # Relative.
    sharp: bool = False  # The last digits cost little more than the first.
    # Whether runs end where its steps collapse on a stiff mode, for another to take its place.
    gives_way: bool = False
    evaluations: int = 0  # Evaluations of the rates so far; 0 if not counted.
    # (n,): how large each variable is in the model's own scales, where it says so; set for each
    # run.
    sizes: Array | None = None
    # (n,): errors of a variable that is smaller are relative to this; set for each flow.
    floor: Array | float = 0.0
    # Ends runs in time; such runs are made step by step.
    allowance: Allowance | None = None
    # Allowed error of the slope of a step, in parts of what a variable is and moves in the step.
    # The slope of a dense output is of a lower order than the step.
    allowed: float

    @property
    def title(self) -> str:
        """Engine and method, in words."""
        return self.name if self.method == self.name else f"{self.name} {self.method}"

    @abstractmethod
    def compile(self, automaton: Automaton, mode: Mode, rates: Tape) -> object:
        """Return what `steps` needs to integrate `mode`, whose rates are also on a tape."""

    def entry(self, stepper: object) -> Entry | None:
        """Return where compiled loops enter what `compile` returned; None where they cannot."""
        return None

    def compiling(self, rates: Tape) -> float:
        """Return about how many seconds `compile` takes."""
        return 0.0

    def check(self, stepper: object, state: Array, parameters: Array, time: float) -> None:  # noqa: B027
        """Raise `Unsupported` where the method cannot go on from a state, whatever its steps."""

    @abstractmethod
    def steps(
        self,
        stepper: object,
        path: Path,
        watch: FlowWatch,
        state: Array,
        until: float,
        count: int,
        begin: Begin,
        end: Array,
    ) -> bool:
        """Take up to `count` steps, and append them to `path`; whether the last ends at `until`.

        The flow stops at `until` exactly. `begin` says how `state` (n,), which is not modified,
        follows from the last call with this stepper (see `compile`); `end` (n,) takes the last
        state. An error means that not a single step can be made.
        """
