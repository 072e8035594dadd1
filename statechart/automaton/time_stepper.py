"""Interface of time steppers: requests for a run and tolerances of impulses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple, Protocol

from statechart.automaton.recording_policy import RECORD_ALL, RecordingPolicy

if TYPE_CHECKING:
    from statechart.automaton.sampling import Sampling
    from statechart.automaton.trace import Arc, Jump, Key, Trace


class Impulses(NamedTuple):
    """How well the impulses of a step are to satisfy the contact laws."""

    tolerance: float = 1e-6  # In parts of the step's fastest approach; more is told.
    bound: float = math.inf  # More ends the run.


USUAL = Impulses()
"""Where nothing else is said."""


class TimeStepper(Protocol):
    """Steps a model through time, and recognises the state of every region at every step."""

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; return its mode and what a reader must know.

        Raises
        ------
        DeclarationProblem
            If no run can start there.
        SimulationError
            If the model has what the stepper lacks.
        """
        ...

    def run(
        self,
        overrides: Mapping[str, float],
        *,
        step: float,
        until: float,
        max_jumps: int,
        show: Callable[[float, int, int], None],
        impulses: Impulses = USUAL,
        policy: RecordingPolicy = RECORD_ALL,
    ) -> Trace:
        """Run from the declared initial state.

        Parameters
        ----------
        overrides : mapping of str to float
            Parameter -> value.
        step : float
            Length of every step but the last two, of which the last ends at `until`.
        until : float
            End of the run.
        max_jumps : int
            End after so many jumps.
        show : callable
            Called now and then with the time reached, the number of jumps and that of steps.
        impulses : Impulses
        policy : RecordingPolicy

        Returns
        -------
        Trace
            Also where the run could not go on; its outcome says so.
        """
        ...

    def stream(
        self,
        overrides: Mapping[str, float],
        sampling: Sampling,
        *,
        step: float,
        until: float,
        max_jumps: int,
        impulses: Impulses = USUAL,
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps as they come, an arc ending wherever the run is looked at.

        Raises
        ------
        SimulationError
            Where the run cannot go on, after all that it made.
        """
        ...
