"""Trace store: arcs and jumps of a run in blocks of arrays, in memory or, if many, on disk.

Compiled loops write a reused buffer, which is copied to a block when full and at the end of the
run. Arcs and jumps are created from blocks when read.
"""

from __future__ import annotations

import tempfile
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.clock import Clock
from statechart.automaton.lazy import LazySequence
from statechart.automaton.trace import Arc, Jump, Key, Roles
from statechart.errors import TooLong

Kind = tuple[Key, Roles]
"""Mode and roles of a flow."""

ARCS, TIMES, TERMS, EVENTS = range(4)
"""Indices of `TraceBuffer.used`."""
JUMP_OBJECT = -1
"""Kind of an event stored as a `Jump`."""

# Size of a buffer: arcs and events, times, coefficients.
_ARCS, _TIMES, _TERMS = 1 << 13, 1 << 14, 1 << 19

IN_MEMORY = 2**26
"""Bytes of a trace in memory; more are written to disk."""
_ALIGNED = 8  # bytes, of an array in a file

B = TypeVar("B", bound=tuple[Any, ...])


class Blocks(Generic[B]):
    """Named tuples of arrays, in order of addition.

    All blocks in memory are written to one file together, for the limit of open files.
    """

    def __init__(self) -> None:
        self._blocks: list[B] = []
        # Blocks on disk; bytes in memory, and in total.
        self._written, self._bytes, self._size = 0, 0, 0

    def __len__(self) -> int:
        return len(self._blocks)

    def __getitem__(self, place: int) -> B:
        return self._blocks[place]

    def add(self, block: B) -> None:
        """Append a block; raise `TooLong` if neither memory nor disk can store it."""
        self._blocks.append(block)
        size = sum([array.nbytes for array in block if isinstance(array, np.ndarray)])
        self._bytes += size
        self._size += size
        if self._bytes > IN_MEMORY:
            try:
                self._blocks[self._written :] = _on_disk(self._blocks[self._written :])
            except OSError as error:
                trace = f"a trace of {self._size >> 20} MB is more than is kept in memory"
                disk = f"the disk does not take it ({error.strerror})"
                raise TooLong(f"{trace}, and {disk}; end the run earlier") from None
            self._written, self._bytes = len(self._blocks), 0


def _on_disk(blocks: list[B]) -> list[B]:
    """Return blocks as views of a temporary file that vanishes with its last reader."""
    with tempfile.TemporaryFile(prefix="statechart-") as file:
        for block in blocks:
            for array in block:
                if isinstance(array, np.ndarray):
                    file.write(array.tobytes())
                    file.write(bytes(-array.nbytes % _ALIGNED))
        file.flush()
        mapped = np.memmap(file, np.uint8, "r")
    at, stored = 0, []
    for block in blocks:
        arrays: list[Any] = list(block)
        for k, array in enumerate(arrays):
            if isinstance(array, np.ndarray):
                arrays[k] = np.ndarray(array.shape, array.dtype, mapped[at : at + array.nbytes])
                at += array.nbytes + -array.nbytes % _ALIGNED
        stored.append(type(block)(*arrays))
    return stored


class TraceBuffer(NamedTuple):
    """Arcs and events in order."""

    arcs: NDArray[np.int32]  # (a, 4): kind, number of jumps before, steps, terms of polynomials
    places: NDArray[np.int64]  # (a, 2): offsets of times and coefficients
    starts: Array  # (a, 2): start as `Clock`
    times: Array  # of all arcs, concatenated
    coefficients: Array
    events: NDArray[np.int32]  # (e, 6): source and target kind, fallen margin; data of the laws
    numbers: Array  # (e, 6): time, energy before and after, time skipped; data of the laws
    states: Array  # (e, 2, n): before and after
    used: NDArray[np.int64]  # (4,): written arcs, times, coefficients, events


class RecordedEvent(NamedTuple):
    """An event of a block, which the laws convert to a jump."""

    j: int  # number of jumps before it
    source: Key
    target: Key
    fired: int  # index of the margin of the source mode
    path: int
    struck: int
    group: int
    t: float
    energy_before: float
    energy_after: float
    skipped: float
    normal: float
    tangential: float
    before: Array  # (n,)
    after: Array  # (n,)


def trace_buffer(
    variables: int, capacity: tuple[int, int, int, int] = (_ARCS, _TIMES, _TERMS, _ARCS)
) -> TraceBuffer:
    """Return an empty buffer for arcs, times, coefficients and events of `variables` variables."""
    arcs, times, terms, events = capacity
    return TraceBuffer(
        np.empty((arcs, 4), np.int32),
        np.empty((arcs, 2), np.int64),
        np.empty((arcs, 2)),
        np.empty(times),
        np.empty(terms),
        np.empty((events, 6), np.int32),
        np.empty((events, 6)),
        np.empty((events, 2, variables)),
        np.zeros(4, np.int64),
    )


def arc_polynomials(block: TraceBuffer, row: int, variables: int) -> tuple[Array, Array]:
    """Return times and coefficients of an arc of a block (see `Arc`)."""
    steps, width = block.arcs[row, 2:].tolist()
    at, begin = block.places[row].tolist()
    terms = block.coefficients[begin : begin + steps * variables * width]
    return block.times[at : at + steps + 1], terms.reshape(steps, variables, width)


def event_of(block: TraceBuffer, row: int, j: int, kinds: Sequence[Kind]) -> RecordedEvent:
    """Return an event of a block, preceded by `j` jumps."""
    source, target, *codes = block.events[row].tolist()
    numbers, states = block.numbers[row].tolist(), block.states[row].copy()
    return RecordedEvent(j, kinds[source][0], kinds[target][0], *codes, *numbers, *states)


def copy_buffer(buffer: TraceBuffer) -> TraceBuffer:
    """Return a copy of the written part of a buffer."""
    arcs, times, terms, events = buffer.used.tolist()
    arrays: tuple[Any, ...] = buffer
    counts = arcs, arcs, arcs, times, terms, events, events, events, len(buffer.used)
    return TraceBuffer._make([a[:n].copy() for a, n in zip(arrays, counts, strict=True)])


class TraceStore:
    """Arcs and jumps of a run in blocks, created when read.

    A run is recorded in `buffer`, copied to a block when full and at the end; without a buffer,
    whole blocks are added. `arcs` and `jumps` grow with the run. `made` has jumps stored as
    objects, by the number of jumps before each; `last`, if set, creates the jump after all events.
    """

    def __init__(
        self,
        variables: int,
        kinds: list[Kind],
        buffer: TraceBuffer | None,
        jump: Callable[[RecordedEvent], Jump] | None,
        last: Callable[[], Jump] | None = None,
    ) -> None:
        self.buffer = trace_buffer(variables, (0, 0, 0, 0)) if buffer is None else buffer
        self.variables = variables
        self._kinds, self._jump = kinds, jump
        self.made: dict[int, Jump] = {}
        self.last = last
        self._blocks = Blocks[TraceBuffer]()
        # Numbers of arcs and events before each block.
        self._arcs, self._events = [0], [0]
        self._places: dict[Kind, int] = {}
        self.arcs = LazySequence(self._arc, self._arc_count)
        self.jumps = LazySequence(self._event, self._count)
        self.jumps.source = self

    def times(self) -> list[float]:
        """Return the times of the recorded jumps."""
        blocks = [*(self._blocks[k] for k in range(len(self._blocks))), self.buffer]
        chunks = [block.numbers[: block.used[EVENTS], 0] for block in blocks]
        times: list[float] = np.concatenate(chunks).tolist()
        for j, jump in self.made.items():
            times[j] = jump.t
        return times if self.last is None else [*times, self.last().t]

    def add(self, block: TraceBuffer) -> None:
        """Append a block."""
        self._blocks.add(block)
        arcs, _, _, events = block.used.tolist()
        self._arcs.append(self._arcs[-1] + arcs)
        self._events.append(self._events[-1] + events)

    def _arc_count(self) -> int:
        return self._arcs[-1] + int(self.buffer.used[ARCS])

    def _count(self) -> int:
        return self._events[-1] + int(self.buffer.used[EVENTS]) + (self.last is not None)

    def _arc(self, place: int) -> Arc:
        block, row = self._locate(self._arcs, place)
        kind, j = block.arcs[row, :2].tolist()
        mode, roles = self._kinds[kind]
        times, terms = arc_polynomials(block, row, self.variables)
        if block is self.buffer:  # overwritten by later arcs
            times, terms = times.copy(), terms.copy()
        return Arc(mode, roles, Clock._make(block.starts[row].tolist()), j, times, terms)

    def _event(self, j: int) -> Jump:
        jump = self.made.get(j)
        if jump is not None:
            return jump
        if self.last is not None and j == self._count() - 1:
            return self.last()
        assert self._jump is not None
        return self._jump(event_of(*self._locate(self._events, j), j, self._kinds))

    def _locate(self, begins: list[int], place: int) -> tuple[TraceBuffer, int]:
        block = bisect_right(begins, place) - 1
        row = place - begins[block]
        return (self.buffer if block == len(self._blocks) else self._blocks[block]), row

    def close(self) -> tuple[LazySequence[Arc], LazySequence[Jump]]:
        """Release the buffer; return arcs and jumps of the complete run."""
        self.seal()
        self.buffer = trace_buffer(self.variables, (0, 0, 0, 0))
        sequences = self.arcs, self.jumps
        # Without reference cycles, the trace is freed with its last reference.
        del self.arcs, self.jumps
        return sequences

    def kind(self, mode: Key, roles: Roles) -> int:
        """Return the index of a kind, after adding it if new."""
        kind = mode, roles
        place = self._places.get(kind)
        if place is None:
            count = len(self._places)
            # Compiled loops may have added kinds.
            self._places |= {kind: count + i for i, kind in enumerate(self._kinds[count:])}
            place = self._places.setdefault(kind, len(self._kinds))
            if place == len(self._kinds):
                self._kinds.append(kind)
        return place

    def add_arc(self, mode: Key, roles: Roles, start: Clock, times: Array, terms: Array) -> None:
        """Add an arc with times and coefficients as in `Arc`."""
        steps, width = len(times) - 1, _width(terms)
        size = steps * self.variables * width
        if self._reserve(1, len(times), size, 0):
            block = self.buffer
        else:
            # Longer than the buffer: a separate block.
            self.seal()
            block = trace_buffer(self.variables, (1, len(times), size, 0))
        arc, at, place, _ = block.used.tolist()
        block.arcs[arc] = self.kind(mode, roles), len(self.jumps), steps, width
        block.places[arc] = at, place
        block.starts[arc] = start
        block.times[at : at + len(times)] = times
        block.coefficients[place : place + size] = terms[:, :, :width].ravel()
        block.used[:3] += (1, len(times), size)
        if block is not self.buffer:
            self.add(block)

    def add_jump(self, jump: Jump) -> None:
        """Add a jump as an object."""
        self._reserve(0, 0, 0, 1)
        self.made[len(self.jumps)] = jump
        block = self.buffer
        block.events[block.used[EVENTS]] = JUMP_OBJECT
        block.used[EVENTS] += 1

    def replace_last(self, jump: Jump) -> None:
        """Replace the last jump."""
        self.made[len(self.jumps) - 1] = jump
        self.jumps.forget(len(self.jumps) - 1)

    def seal(self) -> None:
        """Move the written part of the buffer to a block."""
        if any(self.buffer.used.tolist()):
            self.add(copy_buffer(self.buffer))
            self.buffer.used[:] = 0

    def _reserve(self, arcs: int, times: int, terms: int, events: int) -> bool:
        """Reserve space in the buffer; return False if its capacity is too small."""
        buffer, required = self.buffer, (arcs, times, terms, events)
        arrays = buffer.arcs, buffer.times, buffer.coefficients, buffer.events
        capacity, used = [len(array) for array in arrays], buffer.used.tolist()
        if all(u + w <= c for u, w, c in zip(used, required, capacity, strict=True)):
            return True
        self.seal()
        return all(w <= c for w, c in zip(required, capacity, strict=True))


def jump_times(jumps: Sequence[Jump]) -> list[float]:
    """Return the times of jumps, without creating stored ones."""
    store = jumps.source if isinstance(jumps, LazySequence) else None
    return store.times() if isinstance(store, TraceStore) else [jump.t for jump in jumps]


def _width(terms: Array) -> int:
    """Return the number of leading terms of polynomials that are not all zero, at least one."""
    return int(np.flatnonzero(terms.any(axis=(0, 1))).max(initial=0)) + 1
