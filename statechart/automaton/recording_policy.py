"""Recording policy of a run by steps, and the interface of outputs that are computed meanwhile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from statechart.automaton.trace import Trace
from statechart.documents.setting import Record


class OutputStream(Protocol):
    """Outputs computed from the pieces of a run that stores fewer of them."""

    @property
    def events(self) -> bool:
        """Whether it needs jumps, and the modes of arcs."""
        ...

    @property
    def motion(self) -> bool:
        """Whether it needs arcs and jumps between the start and the end."""
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
