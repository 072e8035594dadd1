"""Pose recorder: the states of a run by steps, in memory or on disk, and their lazy arcs."""

from __future__ import annotations

import numpy as np

from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.lazy_arcs import ArcMaker, Line, Steps, Stretch
from contacts.time_stepping.stops import cut
from statechart.automaton.clock import Clock
from statechart.automaton.lazy import LazySequence
from statechart.automaton.trace import Arc, Key
from statechart.automaton.trace_store import Blocks

# Bytes of a block, which is one arc; an arc takes some times as many.
_BLOCK = 2**22


class PoseRecorder:
    """Collects steps in blocks; each is an arc."""

    def __init__(self, coordinates: int) -> None:
        self._coordinates = coordinates
        self._blocks = Blocks[Steps]()
        # Of each block: number of jumps before it, mode of the controllers.
        self._shown: list[tuple[int, Key]] = []
        self._open: list[Steps] = []
        self._size = 0

    def add(self, chunk: Chunk, start: Clock, j: int, key: Key) -> None:
        """Append steps that begin at `start`, after `j` jumps, in a mode of the controllers."""
        if self._open and (self._shown[-1] != (j, key) or self._size > _BLOCK):
            self._seal()
        if not self._open:
            self._shown.append((j, key))
        hit = np.any(chunk.struck, axis=1)
        self._open.append(Steps.of(chunk, hit, self._coordinates, start))
        self._size += chunk.states.nbytes + chunk.solved.nbytes

    def arcs(self, end: float) -> LazySequence[Arc]:
        """Return the arcs of a run that ended at `end`."""
        self._seal()
        blocks, shown, maker = self._blocks, self._shown, ArcMaker()

        def arc(place: int) -> Arc:
            steps, (j, key) = blocks[place], shown[place]
            stretch = Stretch(steps, 0, int(steps.places[-1]))
            made = maker.arc(Line(key, steps.begin, j, (stretch,)))
            last = (end - made.start.high) - made.start.low
            if place < len(blocks) - 1 or not last < made.times[-1]:
                return made
            step = int(np.searchsorted(made.times, last, side="right")) - 1
            return cut(made, max(step, 0), last)

        return LazySequence(arc, lambda: len(blocks), kept=False)

    def _seal(self) -> None:
        """Move the open steps to a block."""
        if self._open:
            self._blocks.add(Steps.joined(self._open))
            self._open, self._size = [], 0
