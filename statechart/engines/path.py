"""The steps of a flow while it is made."""

from __future__ import annotations

import numpy as np

from statechart.arrays import Array
from statechart.automaton.trace import LARGEST
from statechart.errors import StepFailure, TooLong

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
