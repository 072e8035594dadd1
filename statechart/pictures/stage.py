"""Interface by which a kind of document shows its runs."""

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
class FilmInstants:
    """Instants of a run for a film."""

    times: Array  # (k,), in order
    jumps: NDArray[np.int64]  # (k,), how many precede each instant
    keys: tuple[Key, ...]  # the mode at each
    states: Array  # (k, n), the automaton's variables
    columns: Mapping[str, Array]  # the observables that the stage wants; nan without a value
    parameters: Mapping[str, float]

    @property
    def values(self) -> Array:
        """Values (p,) of the parameters."""
        return np.fromiter(self.parameters.values(), float, len(self.parameters))


class Stage(Protocol):
    """Geometry of a model for pictures and films."""

    @property
    def observables(self) -> tuple[str, ...]:
        """Observables that a film needs beside the variables."""

    def film(self, moments: FilmInstants) -> Film:
        """Return the look of the model at instants of a run."""
