"""Zeno sequences: jumps that accumulate at a finite time, recognised and summed (paper 2.1)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.kernels.accumulation import COUNT, FIRST, HIGH, WIDTH, add_jump

# That spread corrects the sum by no more than this part of it.
_CORRECTION = 0.1
# How many geometric sequences the intervals may be the sum of, and how many of them lie between
# the sums that tell these apart: more would magnify errors less, and reach back to where there are
# further sequences.
_ORDER, _STRIDE = 3, 2


def _remaining(intervals: Sequence[float], geometric: float) -> float:
    """Return what further intervals sum to, by Wynn's epsilon algorithm.

    It is exact for ratios that are constant, and for those that tend to a constant by two more
    geometric sequences: a block rocks the faster, the less it tilts. Where rounding leaves the
    algorithm nothing to work with, what it found before is the better one, at first the sum
    `geometric` for a constant ratio.
    """
    count = len(intervals)
    sums = [-math.fsum(intervals[n:]) for n in range(count % _STRIDE, count + 1, _STRIDE)]
    best, near = geometric, _CORRECTION * geometric
    before, now = [0.0] * len(sums), sums
    for k in range(1, 2 * _ORDER + 1):
        differences = [b - a for a, b in itertools.pairwise(now)]
        if not differences or 0.0 in differences:
            break
        before, now = now, [c + 1.0 / d for c, d in zip(before[1:], differences, strict=False)]
        if k % 2 == 0:
            if not abs(now[-1] - best) < near:
                break
            # The first is often worse than the constant ratio's; from then on they converge.
            near = near if k == 2 else abs(now[-1] - best)
            best = now[-1]
    return best


class Accumulation:
    """Watches the jumps of every region and predicts where repeated ones accumulate.

    Regions are watched apart, as two of them can bounce in turn. The rest of a sequence sums to
    ``dt r / (1 - r)`` (equation 5, with its erratum) where the ratio r is constant; it may be
    skipped only when it is too short to matter, against the longest interval seen. A ratio so
    small that the intervals vanish before it is known needs no sum: the jumps have accumulated
    where the time no longer tells them apart. For the `series` (s, `WIDTH`) see
    `statechart.kernels.accumulation`.
    """

    def __init__(self, known: Sequence[tuple[str, str]] = ()) -> None:
        self._places = {pair: place for place, pair in enumerate(known)}
        self.series: Array = np.zeros((max(len(known), 4), WIDTH))
        self.series[:, HIGH] = math.nan

    def watch(
        self, pair: tuple[str, str], clock: Clock, short: float, *, flowed: bool
    ) -> float | None:
        """Return the time from a jump to the accumulation, once it is imminent; else None."""
        place = self._places.setdefault(pair, len(self._places))
        if place == len(self.series):
            more = np.zeros_like(self.series)
            more[:, HIGH] = math.nan
            self.series = np.concatenate([self.series, more])
        row = self.series[place]
        rest = add_jump(row, clock.high, clock.low, flowed, short)
        return None if rest < 0.0 else _summed(row, rest)

    def sum_from(self, place: int, rest: float) -> float:
        """Return it where the last ratio of a series of those known first gives `rest`."""
        return _summed(self.series[place], rest)


def _summed(row: Array, rest: float) -> float:
    intervals: list[float] = row[FIRST : FIRST + int(row[COUNT])].tolist()
    return 0.0 if rest == 0.0 else _remaining(intervals, rest)
