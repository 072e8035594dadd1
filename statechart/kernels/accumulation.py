"""Prediction of accumulating jumps (Zeno) from intervals that shrink by a constant ratio."""

from __future__ import annotations

import math

import numpy as np

from statechart.arrays import Array
from statechart.kernels.jit import kernel

# Intervals that must shrink by one ratio before their sum is taken as geometric; half as many
# where they have shrunk to less than this part.
INTERVALS = 8
_SHRUNK = 1e-4
# Relative spread of those ratios; a decaying but not geometric sequence has more.
_SPREAD = 1e-3
# A ratio that rises all the time tends to less than one if it rises by less than this part of its
# distance to one while the sum is done; that of 1/n**p never does, it rises by the part 1/p.
_RISE = 1e-3
# So many flows in turn that the time cannot tell apart have come to their end.
_UNRESOLVED = 3

MAX_INTERVALS = 12
"""Number of latest intervals that a series stores."""

(HIGH, LOW, LONGEST, UNRESOLVED, COUNT, FIRST) = range(6)
WIDTH = FIRST + MAX_INTERVALS
"""Columns of a series: when its last jump was, the longest interval since they shrink, how many in
turn time could not tell apart, how many intervals are kept, and these, the oldest first. Not a
number as `HIGH`: there was no jump."""


@kernel
def add_jump(series: Array, high: float, low: float, flowed: bool, short: float) -> float:
    """Add a jump to a series (`WIDTH`,); return the time from there to the accumulation.

    The jump is at `high` + `low` (a `Clock`); `flowed`: it follows a flow, not another jump. An
    accumulation is imminent if it takes less than the part `short` of the longest interval; the
    time is by the last ratio, and -1 where it is not imminent, or there is none.
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
    # They shrink: the last is the least.
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
