"""Running a model by time stepping, where its kind offers that: no mode's equations are built."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Protocol

from statechart.errors import SimulationError

if TYPE_CHECKING:
    from statechart.automaton import Automaton
    from statechart.trace import Key, Trace


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

        Returns
        -------
        Trace
            Also where the run could not go on; its outcome says so.
        """
        ...


class SteppingSimulator:
    """An automaton run by its time stepper: what `Simulator` is to engines.

    Parameters
    ----------
    automaton : Automaton
        What to run; it has a stepper.
    step : float
        Length of a step; what is longer than a run is as long as it.
    progress : bool
        Whether runs above about a second report to stderr.
    """

    def __init__(
        self,
        automaton: Automaton,
        step: float,
        *,
        progress: bool = False,
    ) -> None:
        if automaton.stepper is None:
            raise SimulationError(
                f"{automaton.name!r} cannot be stepped through time: only scenes of bodies in "
                "contact can; take the engine taylor or scipy"
            )
        self.automaton = automaton
        self.step = step
        self.stepper: TimeStepper = automaton.stepper()
        self.progress = progress

    def run(
        self,
        parameters: Mapping[str, float] | None = None,
        *,
        until: float,
        max_jumps: int = 100_000,
        throw: bool = True,
    ) -> Trace:
        """Run from the declared initial state, as `Simulator.run` does."""
        from statechart.simulate import Progress, error_of
        from statechart.trace import Outcome

        shown = Progress(until) if self.progress else None
        trace = self.stepper.run(
            parameters or {},
            step=min(self.step, until) or self.step,
            until=until,
            max_jumps=max_jumps,
            show=shown.show if shown else _silent,
        )
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        return trace


def _silent(time: float, jumps: int, steps: int) -> None:
    """Report nothing."""
