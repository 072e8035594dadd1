"""Jumps that accumulate at a finite time (Zeno), summed (paper 2.1), or lead nowhere (livelock)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from statechart.arrays import Array
from statechart.automaton.clock import Clock, between
from statechart.automaton.trace import FAR_TOO_MANY, Jump, Key
from statechart.errors import EventLoop, TooLong
from statechart.kernels.accumulation import COUNT, FIRST, HIGH, WIDTH, follow
from statechart.tabular import several

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
    where the time no longer tells them apart.
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
        rest = follow(row, clock.high, clock.low, flowed, short)
        return None if rest < 0.0 else _summed(row, rest)

    def found(self, place: int, rest: float) -> float:
        """Return it where the last ratio of a series of those known first gives `rest`."""
        return _summed(self.series[place], rest)


def _summed(row: Array, rest: float) -> float:
    intervals: list[float] = row[FIRST : FIRST + int(row[COUNT])].tolist()
    return 0.0 if rest == 0.0 else _remaining(intervals, rest)


JUMPS_AT_ONCE = 64
"""More jumps than this at one instant are a loop; products of a few contacts settle in a handful.
"""

JUMPS_NEAR = 1024
"""More jumps than this within the round-off of an instant are a loop, flows between them or not."""
_ROUND_OFF = 4.0 * float(np.finfo(float).eps)

STEADY = 4096
"""Jumps whose pace was steady while their number doubled thrice go on like that, from so many on,
where no condition ends them."""


class Livelock:
    """Counts what happens at one instant without end, or within the round-off of its time."""

    def __init__(self, scale: float) -> None:
        self._scale = scale if scale < math.inf else 0.0
        self._since, self._changes = Clock(), 0
        self._stalled: tuple[Clock, tuple[str, ...]] | None = None
        self._stalls = 0

    def _stays(self, before: Clock, clock: Clock) -> bool:
        """Return whether a clock has not passed another by more than round-off."""
        return between(before, clock) <= _ROUND_OFF * max(abs(clock.high), self._scale)

    def stalled(self, clock: Clock, fired: tuple[str, ...]) -> bool:
        """Note a fall that changes no mode: once a graze, at the same instant again a loop."""
        now, before = (clock, fired), self._stalled
        near = before is not None and self._stays(before[0], clock)
        # Time may creep on by less than its round-off, and several margins fall in turn.
        self._stalls = self._stalls + 1 if near else 0
        self._stalled = now
        return before == now or self._stalls > JUMPS_AT_ONCE

    def rearranged(self, clock: Clock, fired: tuple[str, ...]) -> None:
        """Note that a mode goes on by other equations.

        Again and again at one instant is an `EventLoop`.
        """
        if not self._stays(self._since, clock):
            self._since, self._changes = clock, 0
        self._changes += 1
        if self._changes > JUMPS_AT_ONCE:
            fell = f"{', '.join(fired)} falls" if fired else "nothing falls"
            raise EventLoop(
                f"{fell} at t = {clock.high:.6g}, and equations of the mode follow one another "
                "for ever"
            )

    def check(self, jumps: Sequence[Jump], clock: Clock, label: Callable[[Key], str]) -> None:
        """Raise `EventLoop` where the last `JUMPS_NEAR` jumps took no more than round-off.

        Looks whenever so many more have been made.
        """
        count = len(jumps)
        if count and count % JUMPS_NEAR == 0:
            first = jumps[count - JUMPS_NEAR].t
            if self._stays(Clock(first), clock):
                raise looping(jumps[-6:], clock, label, JUMPS_NEAR)


def check_pace(jumps: Sequence[Jump], clock: Clock, until: float, max_jumps: int) -> None:
    """Raise `TooLong` where steady jumps are so many that a run cannot reach its end."""
    count = len(jumps)
    if count < STEADY or count & (count - 1):
        return
    times = [jumps[(count >> k) - 1].t for k in range(4)]
    paces = [
        (after - before) / (count >> k) for k, (after, before) in enumerate(pairwise(times), 1)
    ]
    left = clock.until(until)
    if max(paces) <= 2.0 * min(paces) and left > FAR_TOO_MANY * max_jumps * max(paces):
        raise TooLong(
            f"{count} jumps took {clock.high:.3g}, and {left:.3g} is left, too much for "
            f"{several(max_jumps, 'jump')}; end the run earlier"
        )


def looping(
    last: Sequence[Jump], clock: Clock, label: Callable[[Key], str], count: int = JUMPS_AT_ONCE
) -> EventLoop:
    """Return the error of too many jumps at one instant, with the last ones."""
    recent = ", ".join(f"{jump.cause} -> {label(jump.target)}" for jump in last)
    return EventLoop(f"{count} jumps at t = {clock.high:.6g}: {recent}")
