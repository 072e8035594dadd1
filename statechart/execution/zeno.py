"""Zeno sequences: detection and summation of jumps that accumulate at a finite time (paper 2.1)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.kernels.accumulation import COUNT, FIRST, HIGH, WIDTH, add_jump

# Largest relative correction of the geometric sum.
_MAX_CORRECTION = 0.1
# Number of geometric sequences in the intervals, and stride of the partial sums that separate them:
# a larger stride magnifies errors less, but reaches back to earlier sequences.
_ORDER, _STRIDE = 3, 2


def _remaining(intervals: Sequence[float], geometric: float) -> float:
    """Return the sum of the further intervals by Wynn's epsilon algorithm.

    It is exact for constant ratios, and for ratios that tend to a constant by two more geometric
    sequences (a rocking block). Round-off ends the algorithm with its last estimate, at first the
    sum `geometric` for a constant ratio.
    """
    count = len(intervals)
    sums = [-math.fsum(intervals[n:]) for n in range(count % _STRIDE, count + 1, _STRIDE)]
    best, last_change = geometric, _MAX_CORRECTION * geometric
    before, current = [0.0] * len(sums), sums
    for k in range(1, 2 * _ORDER + 1):
        differences = [b - a for a, b in itertools.pairwise(current)]
        if not differences or 0.0 in differences:
            break
        following = [c + 1.0 / d for c, d in zip(before[1:], differences, strict=False)]
        before, current = current, following
        if k % 2 == 0:
            if not abs(current[-1] - best) < last_change:
                break
            # The first estimate is often worse than the geometric sum; later ones converge.
            last_change = last_change if k == 2 else abs(current[-1] - best)
            best = current[-1]
    return best


class Accumulation:
    """Predicts accumulations of repeated jumps, for every region and cause.

    With a constant ratio r the rest of a sequence lasts ``dt r / (1 - r)`` (equation 5, with its
    erratum); it is skipped only if it is short against the longest interval. If the intervals fall
    below the resolution of time before the ratio is known, the jumps have accumulated. For the
    `series` (s, `WIDTH`) see `statechart.kernels.accumulation`.
    """

    def __init__(self, pairs: Sequence[tuple[str, str]] = ()) -> None:
        self._places = {pair: place for place, pair in enumerate(pairs)}
        self.series: Array = np.zeros((max(len(pairs), 4), WIDTH))
        self.series[:, HIGH] = math.nan

    def watch(
        self, pair: tuple[str, str], clock: Clock, short: float, *, flowed: bool
    ) -> float | None:
        """Return the time from a jump to the accumulation, once it is imminent; else None."""
        place = self._places.setdefault(pair, len(self._places))
        if place == len(self.series):
            enlargement = np.zeros_like(self.series)
            enlargement[:, HIGH] = math.nan
            self.series = np.concatenate([self.series, enlargement])
        row = self.series[place]
        remaining = add_jump(row, clock.high, clock.low, flowed, short)
        return None if remaining < 0.0 else summed(row, remaining)


def summed(row: Array, remaining: float) -> float:
    """Return the time to the accumulation of a series, given the geometric sum `remaining`."""
    intervals: list[float] = row[FIRST : FIRST + int(row[COUNT])].tolist()
    return 0.0 if remaining == 0.0 else _remaining(intervals, remaining)
