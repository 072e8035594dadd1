"""Livelock: runs that take jump after jump and get no further in time, or not far enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

from statechart.automaton.clock import Clock
from statechart.automaton.trace import FAR_TOO_MANY, Jump, Key
from statechart.errors import EventLoop, TooLong
from statechart.tabular import several

JUMPS_AT_ONCE = 64
"""More jumps than this at one instant are a loop; products of a few contacts settle in a handful.
"""

STEADY = 4096
"""Jumps whose pace was steady while their number doubled thrice go on like that, from so many on,
where no condition ends them."""


class Livelock:
    """Watches for falls at one instant that nothing comes of."""

    def __init__(self) -> None:
        self._stalled: tuple[float, float, tuple[str, ...]] | None = None
        self._stalls = 0
        self._rearranged: tuple[tuple[float, float], int] = (0.0, 0.0), 0

    def stalled(self, clock: Clock, fired: tuple[str, ...]) -> bool:
        """Note a fall that changes no mode: once a graze, at the same instant again a loop."""
        now, before = (clock.high, clock.low, fired), self._stalled
        near = before is not None and before[0] == now[0] and before[2] == fired
        # Time may creep on by less than a rounding.
        self._stalls = self._stalls + 1 if near else 0
        self._stalled = now
        return before == now or self._stalls > JUMPS_AT_ONCE

    def rearranged(self, clock: Clock, fired: tuple[str, ...]) -> None:
        """Note that a mode goes on by other equations: again and again at one instant is a loop.

        Raises
        ------
        EventLoop
            Where it is one.
        """
        now = (clock.high, clock.low)
        self._rearranged = (now, self._rearranged[1] + 1 if self._rearranged[0] == now else 1)
        if self._rearranged[1] > JUMPS_AT_ONCE:
            raise EventLoop(
                f"{', '.join(fired)} falls at t = {now[0]:.6g}, and equations of the mode "
                "follow one another for ever"
            )


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


def looping(last: Sequence[Jump], clock: Clock, label: Callable[[Key], str]) -> EventLoop:
    """Return the error of too many jumps at one instant, with the last ones."""
    recent = ", ".join(f"{jump.cause} -> {label(jump.target)}" for jump in last)
    return EventLoop(f"{JUMPS_AT_ONCE} jumps at t = {clock.high:.6g}: {recent}")
