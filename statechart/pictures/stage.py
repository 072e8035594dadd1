"""What a kind of document offers so that its runs can be seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.trace import Key
from statechart.pictures.film import Film


@dataclass(frozen=True, eq=False)
class Moments:
    """Some instants of a run, as a stage wants them.

    Attributes
    ----------
    times : (k,) array
        In order.
    jumps : (k,) array of int
        How many jumps precede each.
    keys : tuple of Key
        The mode at each.
    states : (k, n) array
        The automaton's variables.
    columns : mapping of str to (k,) array
        The observables that the stage wants; not a number where they have no value.
    parameters : mapping of str to float
        Of the run.
    """

    times: Array
    jumps: NDArray[np.int64]
    keys: tuple[Key, ...]
    states: Array
    columns: Mapping[str, Array]
    parameters: Mapping[str, float]

    @property
    def values(self) -> Array:
        """Values (p,) of the parameters."""
        return np.fromiter(self.parameters.values(), float, len(self.parameters))


class Stage(Protocol):
    """A model as something to look at."""

    @property
    def wanted(self) -> tuple[str, ...]:
        """The observables that a film needs beside the variables."""

    def film(self, moments: Moments) -> Film:
        """Return what the model looks like at instants of a run."""
