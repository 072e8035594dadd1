"""The states of a run by steps as arrays, and arcs made of them where somebody looks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.polynomials import Pieces, defined
from contacts.time_stepping.stops import cut
from statechart.arrays import Array, Bools
from statechart.automaton.clock import Clock
from statechart.automaton.laws import roles_in
from statechart.automaton.lazy import LazySequence
from statechart.automaton.trace import Arc, Key
from statechart.automaton.trace_store import Blocks

# A block is written when it holds so many bytes; an arc made of one takes some times as many.
_BLOCK = 2**22


class _Begun(NamedTuple):
    """Where a block begins: when, after how many jumps, in which mode of what has modes."""

    start: Clock
    j: int
    key: Key


class _Block(NamedTuple):
    """Consecutive steps: ends (k + 1,), states (k + 1, w), solved (k, u), struck or not (k,), when.

    The last is how long after their middles (k,).
    """

    begun: _Begun
    times: Array
    states: Array
    solved: Array
    hit: Bools
    late: Array


class Track:
    """Collects steps.

    Parameters
    ----------
    coordinates : int
        How many there are.
    """

    def __init__(self, coordinates: int) -> None:
        self._coordinates = coordinates
        self._blocks = Blocks[_Block]()
        self._begun: _Begun | None = None
        self._open: list[Chunk] = []
        self._size = 0

    def add(self, chunk: Chunk, start: Clock, j: int, key: Key) -> None:
        """Append steps that begin at `start`, after `j` jumps."""
        begun = self._begun
        if begun is not None and ((begun.j, begun.key) != (j, key) or self._size > _BLOCK):
            self._seal()
        if self._begun is None:
            self._begun = _Begun(start, j, key)
        self._open.append(chunk)
        self._size += chunk.states.nbytes + chunk.solved.nbytes

    def arcs(self, end: float) -> LazySequence[Arc]:
        """Return the arcs of a run that ended at `end`, each made when it is looked at."""
        self._seal()
        blocks = self._blocks

        def arc(place: int) -> Arc:
            made = self._arc(blocks[place])
            if place < len(blocks) - 1:
                return made
            last = (end - made.start.high) - made.start.low
            if not last < made.times[-1]:
                return made
            step = int(np.searchsorted(made.times, last, side="right")) - 1
            return cut(made, max(step, 0), last)

        return LazySequence(arc, lambda: len(blocks), kept=False)

    def _seal(self) -> None:
        """Put what is open into a block; what is more than memory is to hold is on disk."""
        if self._begun is None:
            return
        chunks, begun = self._open, self._begun
        ends = [np.zeros(1)]
        for chunk in chunks:
            ends.append(chunk.ends(float(ends[-1][-1])))
        arrays = [
            np.concatenate(ends),
            np.concatenate([*(chunk.states[:-1] for chunk in chunks), chunks[-1].states[-1:]]),
            np.concatenate([chunk.solved for chunk in chunks]),
            np.concatenate([chunk.struck.any(axis=1) for chunk in chunks]),
            np.concatenate([chunk.late for chunk in chunks]),
        ]
        self._blocks.add(_Block(begun, *arrays))
        self._begun, self._open, self._size = None, [], 0

    def _arc(self, block: _Block) -> Arc:
        n, hit, h = self._coordinates, np.asarray(block.hit), np.diff(block.times)
        late = np.asarray(block.late)
        terms, _ = Pieces.of(block.states, block.solved[:, :n], h[:, None], late, hit, n)
        instants = block.times[:-1][hit] + (0.5 * h[hit] + late[hit])
        times = np.insert(block.times, np.flatnonzero(hit) + 1, instants)
        (start, j, key), solved = block.begun, np.repeat(block.solved, 1 + hit, axis=0)
        return Arc(key, roles_in(key), start, j, times, terms, defined(solved))
