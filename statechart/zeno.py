"""Zeno sequences: jumps that accumulate at a finite time, recognised and summed (paper 2.1)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from statechart.trace import Clock, Jump

__all__ = ["Accumulation", "between"]

# Intervals that must shrink by one ratio before their sum is taken as geometric.
_INTERVALS = 8
# Relative spread of those ratios; a decaying but not geometric sequence has more.
_SPREAD = 1e-3
# That spread corrects the sum by no more than this part of it.
_CORRECTION = 0.1
# So many flows in turn that the time cannot tell apart have come to their end.
_UNRESOLVED = 3


def between(start: Clock, end: Clock) -> float:
    """Return the time from `start` to `end`, to full precision even where it is tiny."""
    return (end.high - start.high) + (end.low - start.low)


@dataclass(eq=False)
class _Series:
    """The intervals between the jumps of one kind, as long as they shrink."""

    clock: Clock
    intervals: list[float] = field(default_factory=list)
    longest: float = 0.0
    unresolved: int = 0

    def add(self, clock: Clock, flowed: bool) -> None:
        interval = between(self.clock, clock)
        self.clock = clock
        self.unresolved = self.unresolved + 1 if flowed and interval < math.ulp(clock.high) else 0
        if not self.intervals or interval >= self.intervals[-1]:
            self.intervals, self.longest = [], interval
        self.intervals = [*self.intervals[-_INTERVALS:], interval]


def _remaining(intervals: Sequence[float], geometric: float) -> float:
    """Return what further intervals sum to, by Wynn's epsilon algorithm.

    It is exact for ratios that are constant, and for those that tend to a constant by a second
    geometric sequence: a block rocks the faster, the less it tilts. Where rounding leaves it
    nothing to work with, the sum `geometric` for a constant ratio is the better one.
    """
    sums = [-math.fsum(intervals[n:]) for n in range(0, len(intervals) + 1, _INTERVALS // 4)]
    best = geometric
    before, now = [0.0] * len(sums), sums
    for k in range(1, len(sums)):
        differences = [b - a for a, b in itertools.pairwise(now)]
        if 0.0 in differences:
            break
        before, now = now, [c + 1.0 / d for c, d in zip(before[1:], differences, strict=False)]
        if k % 2 == 0:
            best = now[-1]
    return best if abs(best - geometric) < _CORRECTION * geometric else geometric


class Accumulation:
    """Watches the jumps of every region and predicts where repeated ones accumulate.

    Regions are watched apart, as two of them can bounce in turn. The rest of a sequence sums to
    ``dt r / (1 - r)`` (equation 5, with its erratum) where the ratio r is constant; it may be
    skipped only when it is too short to matter, against the longest interval seen. A ratio so
    small that the intervals vanish before it is known needs no sum: the jumps have accumulated
    where the time no longer tells them apart.
    """

    def __init__(self) -> None:
        self._series: dict[tuple[str, str], _Series] = {}

    def watch(self, jump: Jump, clock: Clock, short: float) -> float | None:
        """Return the time from `jump` to the accumulation, once it is imminent; else None.

        Parameters
        ----------
        short : float
            Imminent is what takes less than this part of the longest interval.
        """
        series = self._series.get((jump.region, jump.cause))
        if series is None:
            self._series[jump.region, jump.cause] = _Series(clock)
            return None
        # What fires without a margin that fell follows a jump, not a flow.
        series.add(clock, bool(jump.fired))
        if series.unresolved >= _UNRESOLVED:
            return 0.0
        intervals = series.intervals
        if len(intervals) <= _INTERVALS or min(intervals) <= 0.0:
            return None
        ratios = [b / a for a, b in itertools.pairwise(intervals)]
        ratio = math.exp(math.fsum(map(math.log, ratios)) / len(ratios))
        if ratio >= 1.0 or max(ratios) - min(ratios) > _SPREAD * ratio:
            return None
        rest = intervals[-1] * ratio / (1.0 - ratio)
        return _remaining(intervals, rest) if rest < short * series.longest else None
