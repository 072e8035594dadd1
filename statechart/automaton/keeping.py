"""What a run by steps keeps of its motion, and who is told of it on the way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from statechart.documents.setting import Record
from statechart.errors import StatechartError

if TYPE_CHECKING:
    from statechart.automaton.trace import Trace


class Watch(Protocol):
    """Who is told of a run that does not keep all its modes: outputs are computed there."""

    @property
    def events(self) -> bool:
        """Whether it looks at jumps and modes; arcs have no modes, else."""
        ...

    @property
    def motion(self) -> bool:
        """Whether it looks at arcs and jumps between the start and the end."""
        ...

    def add(self, piece: Trace) -> None:
        """Take the arcs and jumps since the last time."""
        ...

    def end(self, piece: Trace) -> Mapping[str, Any]:
        """Take the last ones, and the end of the run; return the outputs."""
        ...


class Keeping(NamedTuple):
    """What is kept; who is told of the rest, if anybody."""

    record: Record = Record.MODES
    watch: Watch | None = None


EVERYTHING = Keeping()


def check_kept(trace: Trace) -> None:
    """Check that what happened between start and end of a run was kept.

    Raises
    ------
    StatechartError
        If it was not.
    """
    if trace.record is Record.NOTHING:
        raise StatechartError(
            "the run recorded nothing between its start and its end: run it with record: poses, "
            "or --record poses"
        )
