"""The interface of an integrator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum
from typing import NamedTuple

import numpy as np

from statechart.arrays import Array
from statechart.automaton.automaton import Automaton
from statechart.automaton.constraints import Constraints
from statechart.automaton.regions import Mode
from statechart.automaton.trace import LARGEST
from statechart.engines.event_location import Search
from statechart.errors import StepFailure, TooLong
from statechart.formulas.tape import Tape, compile_tape

LONGEST_CHUNK = 64
"""Steps are made in chunks that grow by half, so that little is dropped behind an early event."""
NEAR = 0.05
"""A state may be this far off the constraints, in tolerances, before it is projected."""

# Steps that a path has room for at first.
_ROOM = 64


class Path:
    """The steps of the flow under way, in arrays that grow and are used again.

    Attributes
    ----------
    times : (capacity + 1,) array
        When every step ends, counted from where the flow starts; the first is 0.
    coefficients : (capacity, n, d + 1) array
        As in `Arc`.
    count : int
        Number of steps made; what lies behind them is void.
    """

    def __init__(self) -> None:
        self.times: Array = np.zeros(1)
        self.coefficients: Array = np.empty((0, 0, 0))
        self.count = 0

    def room(self, steps: int, variables: int, terms: int) -> None:
        """Make room for so many steps more, of at least so many terms.

        Raises
        ------
        TooLong
            If the steps made fill what memory a trace may take.
        StepFailure
            If there is no memory for them.
        """
        capacity, _, width = self.coefficients.shape
        needed = self.count + steps
        if needed <= capacity and (terms == width or (terms < width and self.count > 0)):
            return
        if self.count > 0:
            terms = max(terms, width)
        capacity = capacity if needed <= capacity else max(2 * capacity, needed, _ROOM)
        if 8 * self.count * variables * terms > LARGEST:
            raise TooLong(
                f"{self.count} steps in one mode take {LARGEST >> 20} MB, as much as a trace may; "
                "end the run earlier, or look for what makes the steps so short"
            )
        try:
            times, coefficients = np.zeros(capacity + 1), np.zeros((capacity, variables, terms))
        except MemoryError:
            raise StepFailure(
                f"{self.count} steps in one mode fill the memory; end the run earlier, or look for "
                "what makes the steps so short"
            ) from None
        if self.count > 0:
            times[: self.count + 1] = self.times[: self.count + 1]
            coefficients[: self.count, :, :width] = self.coefficients[: self.count]
        self.times, self.coefficients = times, coefficients

    def append(self, duration: float, coefficients: Array) -> None:
        """Add a step; its polynomials (n, d + 1) may be of any degree."""
        variables, terms = coefficients.shape
        self.room(1, variables, terms)
        self.coefficients[self.count, :, :terms] = coefficients
        self.coefficients[self.count, :, terms:] = 0.0
        self.times[self.count + 1] = self.times[self.count] + duration
        self.count += 1

    def arc(self) -> tuple[Array, Array]:
        """Return times and coefficients of the steps made, as in `Arc`."""
        return self.times[: self.count + 1].copy(), self.coefficients[: self.count].copy()


class Begin(Enum):
    """How a call for steps follows from the last one."""

    NEW = "another flow, or another run"
    MOVED = "the same flow, its state projected since"
    ON = "the same flow, where it was left"


class FlowWatch(NamedTuple):
    """A flow, and what it is watched for.

    Attributes
    ----------
    guards : Tape
        Outputs: the margins whose fall is an event.
    tolerances : (g,) array
        How far below zero each may go.
    constraints : Constraints
        What the states are to satisfy.
    parameters : (p,) array
        Values of the automaton's parameters.
    start : float
        When the flow begins.
    """

    guards: Tape
    tolerances: Array
    constraints: Constraints
    parameters: Array
    start: float


class Steps(NamedTuple):
    """What a call for steps made; the steps stand in the path.

    Attributes
    ----------
    finished : bool
        Whether the last one ends where they had to.
    first : int
        Where the last chunk of steps begins; in those before is no event, and they end on the
        flow's constraints.
    begun : (n,) array
        The state there.
    boxes : int
        Looked at in the search for events.
    found : Search or None
        What the search of the last chunk found; None where it was not searched, as that depends
        on whether its end is on the constraints.
    """

    finished: bool
    first: int
    begun: Array
    boxes: int = 0
    found: Search | None = None


class Engine(ABC):
    """An integrator: it makes a mode's steps, and knows nothing of events.

    An engine is created for one tolerance and may keep what it compiled for a mode.

    Attributes
    ----------
    name, method : str
        What it is called; `method` is `name` where there is only one.
    tolerance : float
        Relative.
    evaluations : int
        Of the rates, so far; 0 where they are not counted.
    sizes : (n,) array or None
        How large each variable is in the model's own scales, where it says so; set for each run.
    floor : (n,) array or float
        Errors of a variable that is smaller are relative to this; set for each flow.
    """

    name: str
    method: str
    tolerance: float
    evaluations: int = 0
    sizes: Array | None = None
    floor: Array | float = 0.0

    @abstractmethod
    def compile(self, automaton: Automaton, mode: Mode) -> object:
        """Return what `steps` needs to integrate `mode`."""

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
    ) -> Steps:
        """Take up to `count` steps, and append them to `path`.

        An engine that can look for events itself may go on by further chunks of steps, as long as
        there is nothing to be seen in those before.

        Parameters
        ----------
        stepper : object
            What `compile` returned.
        path : Path
            The steps of this flow so far.
        watch : Watch
            The flow, and what it is watched for.
        state : (n,) array
            Where to start; not modified.
        until : float
            Do not step beyond this time of the flow; the last step ends there exactly.
        count : int
            At most so many steps at first.
        begin : Begin
            How `state` follows from the last call with this stepper.
        end : (n,) array
            Takes the state at the end of the last step.

        Returns
        -------
        Steps

        Raises
        ------
        StepFailure, NonFinite
            When not a single step can be made.
        """


def rates_tape(automaton: Automaton, mode: Mode) -> Tape:
    """Return the rates of `mode` as a tape."""
    return compile_tape(
        mode.rates,
        variables=automaton.variables,
        parameters=automaton.parameters,
        time=automaton.time,
        definitions=mode.definitions,
    )
