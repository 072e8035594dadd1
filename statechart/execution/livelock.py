"""Detection of livelock: jumps without progress in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from statechart.automaton.automaton import Automaton
from statechart.automaton.clock import Clock, between
from statechart.automaton.switches import is_of_switch
from statechart.automaton.trace import FAR_TOO_MANY, Jump
from statechart.errors import EventLoop, TooLong
from statechart.tabular import pluralise

JUMPS_AT_ONCE = 64
"""Limit of jumps at one instant; a few contacts need a handful."""

JUMPS_NEAR = 1024
"""Limit of jumps within the round-off of an instant, with or without flows between them."""
_ROUND_OFF, _STALL = (k * float(np.finfo(float).eps) for k in (4.0, 64.0))

SWITCHES = 512
"""Number of switches after which their pace is extrapolated, if it is steady over quarters."""
_TOO_MANY_SWITCHES = 1e6

STEADY = 4096
"""Number of jumps from which a pace that was steady over three doublings is extrapolated."""


class Livelock:
    """Counts jumps and stalls within the round-off of an instant."""

    def __init__(self, scale: float) -> None:
        self._scale = scale if scale < math.inf else 0.0
        self._since, self._changes = Clock(), 0
        self._switched: list[Clock] = []  # of the last switches
        self._stalled: tuple[Clock, tuple[str, ...]] | None = None
        self._stalls = 0

    def _stays(self, before: Clock, clock: Clock, round_off: float = _ROUND_OFF) -> bool:
        """Return whether two clocks are equal to round-off."""
        return between(before, clock) <= round_off * max(abs(clock.high), self._scale)

    def stalled(self, clock: Clock, fired: tuple[str, ...]) -> bool:
        """Return whether a fall without a jump repeats at one instant; the first is a graze."""
        event, before = (clock, fired), self._stalled
        same_time = before is not None and self._stays(before[0], clock, _STALL)
        # Time may advance by some round-off of a search, and several margins fall in turn.
        self._stalls = self._stalls + 1 if same_time else 0
        self._stalled = event
        return before == event or self._stalls > JUMPS_AT_ONCE

    def rearranged(self, clock: Clock, fired: tuple[str, ...]) -> bool:
        """Count a change of equations without a jump; return whether such changes accumulate.

        Raises `EventLoop` if they go on.
        """
        if not self._stays(self._since, clock):
            self._since, self._changes = clock, 0
        self._changes += 1
        if self._changes > JUMPS_AT_ONCE:
            fell = f"{', '.join(fired)} falls" if fired else "nothing falls"
            advice = ""
            if fired and is_of_switch(fired[0]):
                advice = "; write a state for each side, or smooth the function that switches"
            raise EventLoop(
                f"{fell} at t = {clock.high:.6g}, and equations of the mode follow one another "
                f"for ever{advice}"
            )
        return self._changes > JUMPS_AT_ONCE // 2

    def switched(self, clock: Clock, until: float) -> None:
        """Count a switch; raise `TooLong` if a steady pace of switches cannot reach the end."""
        times = self._switched
        times.append(clock)
        if len(times) <= SWITCHES:
            return
        self._switched = []
        paces = [between(a, b) for a, b in pairwise(times[:: SWITCHES // 4])]
        remaining, steady = clock.until(until), max(paces) <= 2.0 * min(paces)
        if steady and remaining * SWITCHES > _TOO_MANY_SWITCHES * sum(paces):
            raise TooLong(
                f"{SWITCHES} switches of sign, abs, min or max took {sum(paces):.3g}, and "
                f"{remaining:.3g} is left; end the run earlier, or smooth the functions that switch"
            )

    def check(self, jumps: Sequence[Jump], clock: Clock, automaton: Automaton) -> None:
        """Raise `EventLoop` if the last `JUMPS_NEAR` jumps took no more than round-off of time."""
        count = len(jumps)
        if count and count % JUMPS_NEAR == 0:
            first = jumps[count - JUMPS_NEAR].t
            if self._stays(Clock(first), clock):
                raise loop_error(jumps[-6:], clock, automaton, JUMPS_NEAR)


def check_pace(jumps: Sequence[Jump], clock: Clock, until: float, max_jumps: int) -> None:
    """Raise `TooLong` if a steady pace of jumps cannot reach the end of the run."""
    count = len(jumps)
    if count < STEADY or count & (count - 1):
        return
    times = [jumps[(count >> k) - 1].t for k in range(4)]
    paces = [
        (after - before) / (count >> k) for k, (after, before) in enumerate(pairwise(times), 1)
    ]
    remaining = clock.until(until)
    if max(paces) <= 2.0 * min(paces) and remaining > FAR_TOO_MANY * max_jumps * max(paces):
        raise TooLong(
            f"{count} jumps took {clock.high:.3g}, and {remaining:.3g} is left, too much for "
            f"{pluralise(max_jumps, 'jump')}; end the run earlier"
        )


def loop_error(
    last: Sequence[Jump], clock: Clock, automaton: Automaton, count: int = JUMPS_AT_ONCE
) -> EventLoop:
    """Return the error of too many jumps at one instant, with the last ones."""
    message = f"{count} jumps at t = {clock.high:.6g}: "
    message += ", ".join(f"{jump.cause} -> {automaton.label(jump.target)}" for jump in last)
    guards = {(r.name, e.cause): e.guard for r in automaton.regions for e in r.nesting.edges}
    fired = [(jump.region, jump.cause) for jump in last]
    if not guards or not {*fired} <= guards.keys():
        return EventLoop(message)
    guard_texts = [f"{event[1]} ({guards[event]})" for event in dict.fromkeys(fired)]
    if len(guard_texts) == 1:
        return EventLoop(
            f"{message}; the guard of {guard_texts[0]} holds after it too; let updates end it, "
            "give it a direction, such as x <= 0 and v < 0, or let it enter a second state"
        )
    return EventLoop(
        f"{message}; the guards of {' and '.join(guard_texts)} hold at once; leave a band between "
        "them, or give one a further condition"
    )
