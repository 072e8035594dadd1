"""Zeno sequences: jumps that accumulate at a finite time, recognised and summed (paper 2.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from statechart.trace import Clock, Jump

__all__ = ["Accumulation"]

# Intervals that must shrink by one ratio before their sum is taken as geometric.
_INTERVALS = 8
# Relative spread of those ratios; a decaying but not geometric sequence has more.
_SPREAD = 1e-3


@dataclass(eq=False)
class Accumulation:
    """Watches repeated jumps of one region and predicts where they accumulate.

    The rest of a sequence is skipped only when it is too short to matter: its length is below
    ``sqrt(relative tolerance)`` of the longest interval seen. Its sum
    ``dt r / (1 - r)`` (equation 5, with its erratum) is then far below the tolerance in error.
    """

    _last: tuple[str, str] | None = None
    _clock: Clock = field(default_factory=Clock)
    _intervals: list[float] = field(default_factory=list)
    _longest: float = 0.0

    def watch(self, jump: Jump, clock: Clock, relative: float) -> float | None:
        """Return the time from `jump` to the accumulation, once it is imminent; else None."""
        name = (jump.region, jump.cause)
        if name != self._last:
            self._last, self._clock = name, clock
            self._intervals, self._longest = [], 0.0
            return None
        interval = (clock.high - self._clock.high) + (clock.low - self._clock.low)
        self._clock = clock
        self._longest = max(self._longest, interval)
        self._intervals = [*self._intervals[-_INTERVALS:], interval]
        if len(self._intervals) <= _INTERVALS or min(self._intervals) <= 0.0:
            return None
        ratios = [b / a for a, b in zip(self._intervals, self._intervals[1:], strict=False)]
        ratio = math.exp(math.fsum(map(math.log, ratios)) / len(ratios))
        if ratio >= 1.0 or max(ratios) - min(ratios) > _SPREAD * ratio:
            return None
        rest = interval * ratio / (1.0 - ratio)
        return rest if rest < math.sqrt(relative) * self._longest else None
