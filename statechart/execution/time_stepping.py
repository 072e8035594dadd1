"""Runs of an automaton by its time stepper, without equations of modes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from statechart.automaton import time_stepper
from statechart.automaton.automaton import Automaton
from statechart.automaton.trace import Arc, Jump, Outcome, Trace
from statechart.documents.setting import Record
from statechart.errors import SimulationError
from statechart.execution.outcome import Progress, error_of


class SteppingSimulator:
    """An automaton with its time stepper; the counterpart of `Simulator`.

    The step is at most as long as the run.
    """

    def __init__(
        self,
        automaton: Automaton,
        step: float,
        impulses: time_stepper.Impulses = time_stepper.DEFAULT_IMPULSES,
        record: Record = Record.MODES,
        *,
        progress: bool = False,
    ) -> None:
        if automaton.stepper is None:
            raise SimulationError(
                f"{automaton.name!r} cannot be stepped through time: only scenes can; take the "
                "engine taylor or scipy"
            )
        self.automaton = automaton
        self.step, self.impulses, self.record = step, impulses, record
        self.new_outputs: Callable[[], time_stepper.OutputStream | None] = lambda: None
        self.stepper = automaton.stepper()
        self.progress = progress

    def run(
        self, parameters: Mapping[str, float] | None = None, *, until: float, throw: bool = True
    ) -> Trace:
        """Run from the declared initial state, as `Simulator.run` does."""
        shown = Progress(until) if self.progress else None
        request = self._request(until)._replace(record=self.record, outputs=self.new_outputs())
        try:
            trace = self.stepper.run(
                parameters or {}, request if shown is None else request._replace(show=shown.show)
            )
        finally:
            if shown:
                shown.close()
        if throw and not trace.outcome.succeeded and trace.outcome is not Outcome.INTERRUPTED:
            raise error_of(trace)
        return trace

    def stream(
        self, parameters: Mapping[str, float], sampling: time_stepper.Sampling, *, until: float
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps of a run as they are computed, as `Simulator.stream` does."""
        return self.stepper.stream(parameters, sampling, self._request(until))

    def _request(self, until: float) -> time_stepper.StepRequest:
        step = min(self.step, until) or self.step
        return time_stepper.StepRequest(step, until, self.automaton.max_jumps, self.impulses)
