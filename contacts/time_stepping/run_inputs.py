"""Inputs of a run by steps: the system that is stepped, its start, its span, what is kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from contacts.dynamics.setup import SceneSetup
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.recorder import Recorder
from contacts.time_stepping.stop_tapes import StopTapes
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.time_stepper import RECORD_ALL, Impulses, RecordingPolicy
from statechart.automaton.trace import Jump, Key
from statechart.errors import SimulationError
from statechart.formulas.tape import Tape


class Stepped(Protocol):
    """What is stepped."""

    @property
    def margins(self) -> dict[str, float]:
        """The least values seen."""
        ...

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader must know of the run."""
        ...

    def steps(self, start: float, h: float, state: Array, count: int) -> Chunk:
        """Take steps."""
        ...

    def depth_left(self, state: Array, time: float) -> float:
        """Return how deep something stays in what it touches, whatever moves; see `refused`.

        After the last steps, which have come near that state.
        """
        ...


class Control(Protocol):
    """Controllers and stops at the ends of steps."""

    def cut(self, chunk: Chunk, start: float, recorder: Recorder) -> tuple[Chunk, bool]:
        """Return the steps up to the first after which it may act, and whether there is one."""
        ...

    def lost(self, chunk: Chunk, start: float) -> tuple[int, str] | None:
        """Return the first step at whose end what it waits for has no value, and its name."""
        ...

    def turn(
        self, recorder: Recorder, jumps: Sequence[Jump], state: Array, solved: Array, h: float
    ) -> Array:
        """Act at the end of a step, after the jumps of the step; return the state then."""
        ...


@dataclass(frozen=True, eq=False)
class Stepping:
    """Inputs of a run of a scene."""

    name: str  # Of the model.
    # Of the variables and the parameters.
    names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    regions: tuple[str, ...]
    controls: Key  # States at the start of those of them, the last, that no step recognises.
    again: str  # Cause of an impact on a region that is not free.
    forces: int | None  # See `Recorder`.
    sticks: Bools  # (r,): see `Recorder`.
    angles: Bools  # (n,): which coordinates are angles.
    stops: StopTapes
    stop_names: tuple[str, ...]
    energy: Tape


class RunInputs(NamedTuple):
    """A run that can start, or why it cannot."""

    setup: SceneSetup
    stepped: Stepped
    codes: Ints  # (r,): modes at the start, as `contacts.states` numbers them.
    warnings: tuple[str, ...]  # Besides those of the setup.
    control: Control | None = None  # What acts at the ends of steps.
    failure: SimulationError | None = None  # Why not even one step can be made.
    # Lets it go on with other values of parameters; returns the numbers. None where it cannot.
    change: Callable[[Mapping[str, float]], SceneSetup] | None = None


class Span(NamedTuple):
    """How far a run goes, by which steps, who is told; after what time at most it is looked at.

    And what is kept of it.
    """

    step: float
    until: float
    max_jumps: int
    impulses: Impulses
    show: Callable[[float, int, int], None]
    every: float = math.inf
    policy: RecordingPolicy = RECORD_ALL
