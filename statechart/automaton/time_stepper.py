"""Interface of time steppers: tolerances of impulses, recording policy, sampling of controllers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from statechart.automaton.trace import Arc, Jump, Key, Trace
from statechart.documents.setting import Record


class Impulses(NamedTuple):
    """Tolerances of the impulses of a step."""

    tolerance: float = 1e-6  # In parts of the step's fastest approach; more is told.
    bound: float = math.inf  # More ends the run.


DEFAULT_IMPULSES = Impulses()
"""Default tolerances."""


class OutputStream(Protocol):
    """Outputs computed from the pieces of a run that stores fewer of them."""

    @property
    def events(self) -> bool:
        """True if it needs jumps, and the modes of arcs."""
        ...

    @property
    def motion(self) -> bool:
        """True if it needs arcs and jumps between the start and the end."""
        ...

    def add(self, piece: Trace) -> None:
        """Take the arcs and jumps since the last call."""
        ...

    def end(self, piece: Trace) -> Mapping[str, Any]:
        """Take the last arcs and jumps, and the end of the run; return the outputs."""
        ...


class RecordingPolicy(NamedTuple):
    """Parts of a run that are stored, and the outputs that are computed from the rest."""

    record: Record = Record.MODES
    outputs: OutputStream | None = None


RECORD_ALL = RecordingPolicy()


class TimeStepper(Protocol):
    """Steps a model through time, and recognises the state of every region at every step."""

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; return its mode and the warnings.

        Raises `DeclarationProblem` if no run can start there, `SimulationError` if the model has
        what the stepper lacks.
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
        impulses: Impulses = DEFAULT_IMPULSES,
        policy: RecordingPolicy = RECORD_ALL,
    ) -> Trace:
        """Run from the declared initial state.

        All steps are of length `step` but the last two, of which the last ends at `until`. A run
        ends after `max_jumps`. `show` is called now and then with the time reached, the number of
        jumps and that of steps. Returns the trace also where the run could not go on; its outcome
        says so.
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
        impulses: Impulses = DEFAULT_IMPULSES,
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps as they come, an arc ending wherever the run is looked at.

        Raises `SimulationError` where the run cannot go on, after all that it made.
        """
        ...


@dataclass(frozen=True)
class Sample:
    """State of a run that a controller is shown at an instant.

    Attributes
    ----------
    t : float
        When.
    mode : mapping of str to str
        Region -> its state.
    values : mapping of str to float
        Variable -> its value.
    """

    t: float
    mode: Mapping[str, str]
    values: Mapping[str, float]


Control = Callable[[Sample], Mapping[str, float] | None]
"""Sample -> parameters that have other values from there on; None for no change."""


class Sampling(NamedTuple):
    """Instants at which a controller sees a run, and may change its parameters."""

    every: float  # Time between instants; inf for none.
    control: Control | None


def in_order(pieces: Iterable[Arc | Jump]) -> list[Arc | Jump]:
    """Return arcs and jumps on hybrid time: arcs of as many jumps, and the jump that ends them."""

    def place(piece: Arc | Jump) -> tuple[int, int, float]:
        if isinstance(piece, Arc):
            return piece.j, 0, piece.start.high
        return piece.j, 1, piece.t

    return sorted(pieces, key=place)
