"""Interface of time stepping: tolerances, recording, sampled control."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from statechart.automaton.trace import Arc, Jump, Key, Trace
from statechart.documents.setting import Record


class Impulses(NamedTuple):
    """Residuals of the impulses of a step, relative to its fastest approach velocity."""

    tolerance: float = 1e-6  # above it the steps are counted in a warning
    bound: float = math.inf  # above it the run ends


DEFAULT_IMPULSES = Impulses()
"""Default residuals."""


class OutputStream(Protocol):
    """Outputs computed during a run that does not store its motion."""

    @property
    def events(self) -> bool:
        """True if it needs jumps, and the modes of arcs."""

    @property
    def motion(self) -> bool:
        """True if it needs the arcs and jumps of the whole run."""

    def add(self, piece: Trace) -> None:
        """Process the arcs and jumps since the last call."""

    def end(self, piece: Trace) -> Mapping[str, Any]:
        """Process the last arcs and jumps; return the outputs."""


class StepRequest(NamedTuple):
    """Step size, end, limits and recording of a run by steps."""

    step: float  # all steps have this length except the last two
    until: float  # the end of the last step
    max_jumps: int  # a run ends after so many
    impulses: Impulses = DEFAULT_IMPULSES
    record: Record = Record.MODES  # stored parts of the run
    outputs: OutputStream | None = None  # computed from the rest
    show: Callable[[float, int, int], None] = lambda *_: None  # takes time, jumps and steps


class TimeStepper(Protocol):
    """Runs a model by time steps, and recognises its mode at every step."""

    def start(self, overrides: Mapping[str, float]) -> tuple[Key, tuple[str, ...]]:
        """Check the initial state; return its mode and warnings.

        Raises `DeclarationProblem` if no run can start, `SimulationError` for unsupported models.
        """

    def run(self, overrides: Mapping[str, float], request: StepRequest) -> Trace:
        """Run from the declared initial state.

        The outcome of the trace says whether the run is complete.
        """

    def stream(
        self, overrides: Mapping[str, float], sampling: Sampling, request: StepRequest
    ) -> Iterator[Arc | Jump]:
        """Yield arcs and jumps as they are computed; arcs end at instants of sampling.

        Raises `SimulationError` if the run cannot go on, after its last item.
        """


@dataclass(frozen=True)
class Sample:
    """State of a run at a sampling instant.

    Attributes
    ----------
    t : float
        Time.
    mode : mapping of str to str
        Region -> its state.
    values : mapping of str to float
        Variable -> its value.
    """

    t: float
    mode: Mapping[str, str]
    values: Mapping[str, float]


Control = Callable[[Sample], Mapping[str, float] | None]
"""Sample -> new values of parameters, or None."""


class Sampling(NamedTuple):
    """Sampling period (inf for none), and the controller."""

    every: float
    control: Control | None


def unread(arcs: Sequence[Arc], jumps: Sequence[Jump]) -> Callable[[], list[Arc | Jump]]:
    """Return a function that returns those added since its last call, by hybrid time."""
    read = [0, 0]

    def place(piece: Arc | Jump) -> tuple[int, int, float]:
        return (piece.j, 0, piece.start.high) if isinstance(piece, Arc) else (piece.j, 1, piece.t)

    def fresh() -> list[Arc | Jump]:
        pieces: list[Arc | Jump] = [*arcs[read[0] :], *jumps[read[1] :]]
        read[:] = len(arcs), len(jumps)
        return sorted(pieces, key=place)

    return fresh
