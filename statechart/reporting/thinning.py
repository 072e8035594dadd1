"""Curves of very many points, drawn by what of them can be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.observation.sampling import Samples

# Columns of a figure: more than any screen or print shows of a curve.
COLUMNS = 2000
# Of a curve with more points in a column, on average, its least and greatest there are drawn.
_DENSE = 10


@dataclass(frozen=True, eq=False)
class Line:
    """How columns of samples are drawn: broken at jumps, which take no time.

    Attributes
    ----------
    times : (m,) array
        Of the points drawn, not a number at breaks.
    """

    times: Array
    _begins: NDArray[np.intp] | None
    _breaks: NDArray[np.intp]

    @classmethod
    def of(cls, samples: Samples) -> Line:
        """Return how samples are drawn; many by the least and the greatest in every column."""
        t, jumped = samples.t, np.flatnonzero(np.diff(samples.j)) + 1
        if len(t) <= _DENSE * COLUMNS:
            return cls(np.insert(t, jumped, np.nan), None, jumped)
        begins = _begins(t)
        if len(jumped) <= COLUMNS:
            begins = np.union1d(begins, jumped)
        # Two points a column; of more jumps than columns a line shows those between two of them.
        breaks = 2 * np.flatnonzero(np.isin(begins, jumped))
        return cls(np.insert(np.repeat(t[begins], 2), breaks, np.nan), begins, breaks)

    def values(self, column: Array) -> Array:
        """Return the values (m,) of a column of the samples."""
        if self._begins is not None:
            low = np.fmin.reduceat(column, self._begins)
            column = np.column_stack([low, np.fmax.reduceat(column, self._begins)]).ravel()
        return np.insert(column, self._breaks, np.nan)


def strongest(times: Array, sizes: Array, end: float) -> tuple[Array, Array]:
    """Return events and their sizes; of very many the one of greatest magnitude in every column."""
    if len(times) <= COLUMNS:
        return times, sizes
    column = np.minimum((times * (COLUMNS / end)).astype(np.intp), COLUMNS - 1)
    order = np.lexsort((-np.abs(sizes), column))
    chosen = order[np.flatnonzero(np.diff(column[order], prepend=-1))]
    return times[chosen], sizes[chosen]


def _begins(t: Array) -> NDArray[np.intp]:
    """Return the first row of every column that has one."""
    edges = np.linspace(t[0], t[-1], COLUMNS + 1)[:-1]
    begins: NDArray[np.intp] = np.unique(np.searchsorted(t, edges))
    return begins
