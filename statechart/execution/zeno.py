"""Zeno sequences: jumps that accumulate at a finite time, recognised and summed (paper 2.1)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from statechart.automaton.trace import Clock, Jump, between

# Intervals that must shrink by one ratio before their sum is taken as geometric; half as many
# where they have shrunk to less than this part.
_INTERVALS = 8
_SHRUNK = 1e-4
# Relative spread of those ratios; a decaying but not geometric sequence has more.
_SPREAD = 1e-3
# A ratio that rises all the time tends to less than one if it rises by less than this part of its
# distance to one while the sum is done; that of 1/n**p never does, it rises by the part 1/p.
_RISE = 1e-3
# That spread corrects the sum by no more than this part of it.
_CORRECTION = 0.1
# How many geometric sequences the intervals may be the sum of, and how many of them lie between
# the sums that tell these apart: more would magnify errors less, and reach back to where there are
# further sequences.
_ORDER, _STRIDE = 3, 2
_KEPT = 2 * _ORDER * _STRIDE
# So many flows in turn that the time cannot tell apart have come to their end.
_UNRESOLVED = 3


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
        self.intervals = [*self.intervals[1 - _KEPT :], interval]


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
        intervals = series.intervals[-_INTERVALS - 1 :]
        if min(intervals) <= 0.0 or len(intervals) <= _INTERVALS // 2:
            return None
        if len(intervals) <= _INTERVALS and intervals[-1] > _SHRUNK * intervals[0]:
            return None
        ratios = [b / a for a, b in itertools.pairwise(intervals)]
        ratio = math.exp(math.fsum(map(math.log, ratios)) / len(ratios))
        if ratio >= 1.0 or max(ratios) - min(ratios) > _SPREAD * ratio:
            return None
        rises = [b - a for a, b in itertools.pairwise(ratios)]
        if min(rises) > 0.0 and sum(rises) > _RISE * len(rises) * (1.0 - ratio) ** 2:
            return None
        rest = intervals[-1] * ratio / (1.0 - ratio)
        return _remaining(series.intervals, rest) if rest < short * series.longest else None
