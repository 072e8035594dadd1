"""The interface of an integrator."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from statechart.automaton import Automaton
from statechart.compose import Mode
from statechart.tape import Tape, compile_tape

__all__ = ["Begin", "Engine", "Path", "rates_tape"]

Array = NDArray[np.float64]

# Steps that a path has room for at first.
_ROOM = 16


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
        """Make room for so many steps more, of at least so many terms."""
        capacity, _, width = self.coefficients.shape
        needed = self.count + steps
        if needed <= capacity and (terms == width or (terms < width and self.count > 0)):
            return
        if self.count > 0:
            terms = max(terms, width)
        capacity = capacity if needed <= capacity else max(2 * capacity, needed, _ROOM)
        times, coefficients = np.zeros(capacity + 1), np.zeros((capacity, variables, terms))
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
    """

    name: str
    method: str
    tolerance: float
    evaluations: int = 0
    sizes: Array | None = None

    @abstractmethod
    def compile(self, automaton: Automaton, mode: Mode) -> object:
        """Return what `steps` needs to integrate `mode`."""

    @abstractmethod
    def steps(
        self,
        stepper: object,
        path: Path,
        parameters: Array,
        start: float,
        state: Array,
        duration: float,
        count: int,
        begin: Begin,
        end: Array,
    ) -> bool:
        """Take up to `count` steps, and append them to `path`.

        Parameters
        ----------
        stepper : object
            What `compile` returned.
        path : Path
            The steps of this flow so far.
        parameters : (p,) array
            Values of the automaton's parameters.
        start : float
            Absolute time at which `state` holds.
        state : (n,) array
            Where to start; not modified.
        duration : float
            Do not step beyond ``start + duration``; the last step ends there exactly.
        count : int
            At most so many steps.
        begin : Begin
            How `state` follows from the last call with this stepper.
        end : (n,) array
            Takes the state at the end of the last step.

        Returns
        -------
        bool
            Whether the last step ends at the end of `duration`.

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
