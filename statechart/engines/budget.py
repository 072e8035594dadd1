"""A limit on the time of runs."""

from __future__ import annotations

import math
from collections.abc import Callable

from statechart.compiling import working_time
from statechart.errors import OutOfBudget


class Allowance:
    """Seconds that several runs share. A mode that is being compiled is not interrupted."""

    def __init__(self, seconds: float, clock: Callable[[], float] = working_time) -> None:
        self.seconds, self.clock = seconds, clock
        self._until = math.inf

    def begin(self) -> None:
        """Count from now on."""
        self._until = self.clock() + self.seconds

    def lift(self) -> None:
        """Count no more."""
        self._until = math.inf

    def check_for(self, seconds: float) -> None:
        """Raise where there is no time for what takes so many `seconds`."""
        if self.clock() + seconds > self._until:
            raise OutOfBudget(
                f"{self.seconds:g} s are too few to compile the mode's integrator; allow more "
                "time, or take the engine scipy"
            )

    def check(self, now: float) -> None:
        """Raise where the time is over; `now` is how far the run came."""
        if self.clock() > self._until:
            raise OutOfBudget(
                f"the {self.seconds:g} s were used up at t = {now:.6g}; allow more time, "
                "shorten the run, or take a looser tolerance"
            )
