"""What a run by steps is made of: what is stepped, and what acts at the ends of steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.recorder import Recorder
from statechart.arrays import Array
from statechart.automaton.trace import Jump


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
    """What acts at the ends of steps."""

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
