"""The interface of an integrator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import NamedTuple

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.constraints import Constraints
from statechart.automaton.modes import Reconstruction
from statechart.automaton.regions import Mode
from statechart.engines.path import Path
from statechart.formulas.tape import Tape

FIRST_CHUNK = 4
LONGEST_CHUNK = 64
"""Steps are made in chunks that grow by half, so that little is dropped behind an early event."""
GROWTH = 16.0
"""By which the look-ahead in time grows."""
LOOKS = 256
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
    constraints: Constraints  # What the states are to satisfy.
    parameters: Array  # (p,): values of the automaton's parameters.
    start: float  # When the flow begins.
    reconstruction: Reconstruction  # What follows from other variables in every state.


class Pace(NamedTuple):
    """Tolerances and step limits of an engine."""

    # See `Engine`, and the longest step in time.
    tolerance: float
    max_step: float
    allowed: float
    terms: int  # Of its series.


class Entry(NamedTuple):
    """Entry of compiled loops into a mode's step."""

    address: int  # See `statechart.engines.heyoka_step.Step`.
    fixed: Tape  # What it takes of the automaton's parameters, behind the time.
    takes: int  # How many parameters it takes, the time among them.
    pace: Pace


class Engine(ABC):
    """An integrator: it makes a mode's steps, and knows nothing of events.

    An engine is created for one tolerance and may keep what it compiled for a mode.
    """

    # What it is called; `method` is `name` where there is only one.
    name: str
    method: str
    tolerance: float  # Relative.
    sharp: bool = False  # Whether the last digits cost little more than the first.
    evaluations: int = 0  # Of the rates, so far; 0 where they are not counted.
    # (n,): how large each variable is in the model's own scales, where it says so; set for each
    # run.
    sizes: Array | None = None
    # (n,): errors of a variable that is smaller are relative to this; set for each flow.
    floor: Array | float = 0.0
    # Of what a variable is and moves in a step, how far the slope of the step may be off its rate.
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

        Parameters
        ----------
        stepper : object
            What `compile` returned.
        path : Path
            The steps of this flow so far.
        watch : FlowWatch
            The flow, and what it is watched for.
        state : (n,) array
            Where to start; not modified.
        until : float
            Do not step beyond this time of the flow; the last step ends there exactly.
        count : int
            At most so many steps.
        begin : Begin
            How `state` follows from the last call with this stepper.
        end : (n,) array
            Takes the state at the end of the last step.

        Raises
        ------
        StepFailure, NonFinite
            When not a single step can be made.
        """
