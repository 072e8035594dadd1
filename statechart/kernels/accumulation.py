"""Prediction of accumulating jumps (Zeno) from intervals that shrink by a constant ratio."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.kernels.jit import kernel

# Number of intervals with one ratio that make a geometric sequence; half as many if they have
# shrunk below this part.
INTERVALS = 8
_SHRUNK = 1e-4
# Relative spread of those ratios; a decaying but not geometric sequence has more.
_SPREAD = 1e-3
# A monotonically rising ratio has a limit below one if it rises by less than this part of its
# distance to one over the intervals. The ratio of 1/n**p rises by the part 1/p.
_RISE = 1e-3
# Number of consecutive flows shorter than the round-off of time that end a sequence.
_UNRESOLVED = 3

MAX_INTERVALS = 12
"""Number of latest intervals that a series stores."""

(HIGH, LOW, LONGEST, UNRESOLVED, COUNT, FIRST) = range(6)
WIDTH = FIRST + MAX_INTERVALS
"""Columns of a series: time of its last jump (`HIGH` is NaN without one), longest interval since
they shrink, number of consecutive intervals below the round-off of time, number of stored
intervals, and these, the oldest first."""


@kernel
def add_jump(series: Array, high: float, low: float, flowed: bool, short: float) -> float:
    """Add a jump to a series (`WIDTH`,); return the time from there to the accumulation.

    The jump is at `high` + `low` (a `Clock`); `flowed`: it follows a flow, not another jump. An
    accumulation is imminent if it takes less than the part `short` of the longest interval. The
    time follows from the last ratio; -1 if no accumulation is imminent.
    """
    before, part = series[HIGH], series[LOW]
    series[HIGH], series[LOW] = high, low
    if before != before:
        return -1.0
    interval = (high - before) + (low - part)
    ulp = np.nextafter(abs(high), math.inf) - abs(high)
    series[UNRESOLVED] = series[UNRESOLVED] + 1.0 if flowed and interval < ulp else 0.0
    count = int(series[COUNT])
    if count == 0 or interval >= series[FIRST + count - 1]:
        count, series[LONGEST] = 0, interval
    if count == MAX_INTERVALS:
        for i in range(MAX_INTERVALS - 1):
            series[FIRST + i] = series[FIRST + i + 1]
        count -= 1
    series[FIRST + count] = interval
    series[COUNT] = count = count + 1
    if series[UNRESOLVED] >= _UNRESOLVED:
        return 0.0
    begin = max(count - INTERVALS - 1, 0)
    intervals = series[FIRST + begin : FIRST + count]
    n = len(intervals)
    # The intervals shrink: the last is the smallest.
    if intervals[n - 1] <= 0.0 or n <= INTERVALS // 2:
        return -1.0
    if n <= INTERVALS and intervals[n - 1] > _SHRUNK * intervals[0]:
        return -1.0
    logs, least, most, always, rise, last = 0.0, math.inf, -math.inf, True, 0.0, 0.0
    for i in range(n - 1):
        ratio = intervals[i + 1] / intervals[i]
        logs += math.log(ratio)
        least, most = min(least, ratio), max(most, ratio)
        if i > 0:
            always = always and ratio > last
            rise += ratio - last
        last = ratio
    ratio = math.exp(logs / (n - 1))
    if ratio >= 1.0 or most - least > _SPREAD * ratio:
        return -1.0
    if always and rise > _RISE * (n - 2) * ((1.0 - ratio) * (1.0 - ratio)):
        return -1.0
    rest = intervals[n - 1] * ratio / (1.0 - ratio)
    return rest if rest < short * series[LONGEST] else -1.0
