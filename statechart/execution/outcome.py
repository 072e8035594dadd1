"""Progress of a run, and its outcome as an error."""

from __future__ import annotations

from statechart import progress
from statechart.automaton.trace import Outcome, Trace
from statechart.compiling import working_time
from statechart.errors import SimulationError
from statechart.tabular import pluralise

_PROGRESS_AFTER = 1.0  # seconds of wall time before progress is shown, and between lines
TWO_BOUNDS = (
    "if it switches what decides it, give it two bounds: guards of a region that switch its "
    "states, and enabled: in(REGION.STATE)"
)
"""Advice against a relation that its own consequences change back."""
_MOVES = 0.2  # seconds between updates of a bar


class Progress:
    """Reports to stderr on runs above about a second: a bar on a terminal, else lines."""

    def __init__(self, until: float) -> None:
        self._until = until
        self._began = self._shown = working_time()
        self._display: progress.Display | None = None

    def show(self, time: float, jumps: int, steps: int) -> None:
        """Report the progress at intervals."""
        now = working_time()
        bar = self._display
        if now - self._shown < (_MOVES if bar is not None and bar.drawn else _PROGRESS_AFTER):
            return
        self._shown = now
        text = (
            f"t = {time:.6g} of {self._until:g}, {pluralise(jumps, 'jump')}, "
            f"{pluralise(steps, 'step')}, "
            f"{now - self._began:.0f} s"
        )
        self._display = self._display or progress.Display(self._until)
        self._display.show(time, text)

    def close(self) -> None:
        """End the report."""
        if self._display is not None:
            self._display.close()
            self._display = None


def error_of(trace: Trace) -> SimulationError:
    """Return the error of an outcome, with the trace."""
    return _ERRORS.get(trace.outcome, SimulationError)(trace.message, trace=trace)


_ERRORS = {Outcome[e.outcome]: e for e in SimulationError.__subclasses__()}
