"""Progress of a run, and its outcome as an error."""

from __future__ import annotations

import sys

from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.errors import SimulationError

_PROGRESS_AFTER = 1.0  # seconds of wall time before progress is shown


class Progress:
    """Reports to stderr on runs above about a second.

    Parameters
    ----------
    until : float
        End of the run.
    """

    def __init__(self, until: float) -> None:
        self._until = until
        self._began = self._shown = working_time()

    def show(self, time: float, jumps: int, steps: int) -> None:
        """Say how far the run is, if that was not said within the last second."""
        now = working_time()
        if now - self._shown < _PROGRESS_AFTER:
            return
        self._shown = now
        sys.stderr.write(
            f"t = {time:.6g} of {self._until:g}, {jumps} jumps, {steps} steps, "
            f"{now - self._began:.0f} s\n"
        )
        sys.stderr.flush()


def error_of(trace: Trace) -> SimulationError:
    """Return the error that an outcome stands for, with the trace."""
    return _ERRORS.get(trace.outcome, SimulationError)(trace.message, trace=trace)


_ERRORS = {Outcome[e.outcome]: e for e in SimulationError.__subclasses__()}
