"""Time of a run in double-double precision."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from statechart.arrays import Array


class Clock(NamedTuple):
    """Time as an unevaluated sum ``high + low`` of two floats.

    ``|low|`` is at most half an ulp of `high`, or a few ulps of a `short` clock.
    """

    high: float = 0.0
    low: float = 0.0

    def later(self, duration: float) -> Clock:
        """Return the clock `duration` later (Knuth's two-sum)."""
        total = self.high + duration
        part = total - self.high
        error = (self.high - (total - part)) + (duration - part) + self.low
        high = total + error
        return Clock(high, error - (high - total))

    @property
    def short(self) -> Clock:
        """The same time with `high` of 15 digits, as multiples of steps such as 1e-3 are shown."""
        high = _decimal(self.high)
        return Clock(high, (self.high - high) + self.low)

    def until(self, end: float) -> float:
        """Return the time until `end`."""
        return (end - self.high) - self.low


def between(start: Clock, end: Clock) -> float:
    """Return the time from `start` to `end`, without cancellation."""
    return (end.high - start.high) + (end.low - start.low)


def decimals(times: Array) -> Array:
    """Return times of 15 digits (see `Clock.short`)."""
    return np.array([_decimal(t) for t in times.tolist()])


def _decimal(time: float) -> float:
    return float(f"{time:.15g}")
