"""Arcs and jumps of a run in arrays, as compiled loops write them; made when they are looked at.

They are written on a pad, memory that is used again; what stands there is copied to a `Block`
whenever it is full, and at the end of the run.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from statechart.arrays import Array
from statechart.automaton.blocks import Blocks
from statechart.automaton.clock import Clock
from statechart.automaton.deferred import Recorded
from statechart.automaton.trace import Arc, Jump, Key, Roles

Kind = tuple[Key, Roles]
"""The mode that a flow shows, and whose equations apply."""

ARCS, TIMES, TERMS, EVENTS = range(4)
"""Places in `Block.used`."""
MADE = -1
"""As the kind of an event's source: the jump is kept as it was made."""

# What a pad holds: so many arcs and events, times, coefficients.
_ARCS, _TIMES, _TERMS = 1 << 13, 1 << 14, 1 << 19


class Block(NamedTuple):
    """Arcs and events in the order in which they were made.

    Attributes
    ----------
    arcs : (a, 4) array of int32
        Kind, number of jumps before it, steps, terms of its polynomials.
    places : (a, 2) array of int64
        Where its times and its coefficients begin.
    starts : (a, 2) array
        When it starts, a `Clock`.
    times, coefficients : (..,) arrays
        Of all arcs, one behind the other (see `Arc`).
    events : (e, 6) array of int32
        Kind left and kind entered, the margin that fell; the others are the laws' own.
    numbers : (e, 6) array
        When, energy before and after, time skipped; the others are the laws' own.
    states : (e, 2, n) array
        Before and after.
    used : (4,) array of int64
        How much of it is written: arcs, times, coefficients, events.
    """

    arcs: NDArray[np.int32]
    places: NDArray[np.int64]
    starts: Array
    times: Array
    coefficients: Array
    events: NDArray[np.int32]
    numbers: Array
    states: Array
    used: NDArray[np.int64]


class Event(NamedTuple):
    """One event of a block, as the laws are asked to make a jump of it.

    Attributes
    ----------
    j : int
        Number of jumps before it.
    source, target : Key
    fired : int
        Margin of the mode left.
    path, struck, group : int
    t, energy_before, energy_after, skipped : float
    normal, tangential : float
    before, after : (n,) array
    """

    j: int
    source: Key
    target: Key
    fired: int
    path: int
    struck: int
    group: int
    t: float
    energy_before: float
    energy_after: float
    skipped: float
    normal: float
    tangential: float
    before: Array
    after: Array


def pad(variables: int) -> Block:
    """Return memory to write on, for states of so many variables."""
    return _empty((_ARCS, _TIMES, _TERMS, _ARCS), variables)


def polynomials(block: Block, row: int, variables: int) -> tuple[Array, Array]:
    """Return the times and the coefficients of an arc of a block (see `Arc`)."""
    steps, width = block.arcs[row, 2:].tolist()
    at, begin = block.places[row].tolist()
    terms = block.coefficients[begin : begin + steps * variables * width]
    return block.times[at : at + steps + 1], terms.reshape(steps, variables, width)


def arc_of(block: Block, row: int, variables: int, kinds: Sequence[Kind]) -> Arc:
    """Return an arc of a block, which is written on no more."""
    kind, j = block.arcs[row, :2].tolist()
    mode, roles = kinds[kind]
    start = Clock._make(block.starts[row].tolist())
    times, terms = polynomials(block, row, variables)
    return Arc(mode, roles, start, j, times, terms)


def event_of(block: Block, row: int, j: int, kinds: Sequence[Kind]) -> Event:
    """Return an event of a block, before which there were `j` jumps."""
    source, target, *codes = block.events[row].tolist()
    numbers, states = block.numbers[row].tolist(), block.states[row].copy()
    return Event(j, kinds[source][0], kinds[target][0], *codes, *numbers, *states)


@lru_cache(maxsize=64)
def _nothing(variables: int) -> Block:
    """Return memory on which nothing is written."""
    return _empty((0, 0, 0, 0), variables)


def _empty(room: tuple[int, int, int, int], variables: int) -> Block:
    arcs, times, terms, events = room
    return Block(
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


def copied(pad: Block, written: list[int]) -> Block:
    """Return a copy of what is written on a pad."""
    arcs, times, terms, events = written
    return Block(
        pad.arcs[:arcs].copy(),
        pad.places[:arcs].copy(),
        pad.starts[:arcs].copy(),
        pad.times[:times].copy(),
        pad.coefficients[:terms].copy(),
        pad.events[:events].copy(),
        pad.numbers[:events].copy(),
        pad.states[:events].copy(),
        pad.used.copy(),
    )


class Recording:
    """What a run has left so far.

    Parameters
    ----------
    variables : int
        Of a state.
    kinds : list of (Key, Roles)
        Those that blocks name by their places; may grow.
    memory : Block
        To be written on.
    jump : callable, optional
        Makes the jump of an event that a loop has written; asked when one is looked at.
    begun : bool
        Whether a run stands in the memory already, as far as it has come.

    Attributes
    ----------
    made : dict
        Number of jumps before it -> a jump that is kept as it was made.
    """

    def __init__(
        self,
        variables: int,
        kinds: list[Kind],
        memory: Block,
        jump: Callable[[Event], Jump] | None = None,
        *,
        begun: bool = False,
    ) -> None:
        self.memory, self.variables = memory, variables
        self._kinds, self._jump = kinds, jump
        self._places: dict[Kind, int] = {}
        self.made: dict[int, Jump] = {}
        self._blocks = Blocks[Block]()
        # How many arcs and events stand in the blocks before each.
        self._arcs, self._events = [0], [0]
        if not begun:
            memory.used[:] = 0

    @cached_property
    def arcs(self) -> Recorded[Arc]:
        """The arcs so far."""
        return Recorded(self._arc, lambda: self._arcs[-1] + int(self.memory.used[ARCS]))

    @cached_property
    def jumps(self) -> Recorded[Jump]:
        """The jumps so far."""
        return Recorded(self._event, lambda: self._events[-1] + int(self.memory.used[EVENTS]))

    def close(self) -> tuple[Recorded[Arc], Recorded[Jump]]:
        """Leave the pad to others; return the arcs and the jumps of the run, which has ended."""
        self.seal()
        self.memory = _nothing(self.variables)
        found = self.arcs, self.jumps
        # A trace that nobody has any more is to go at once: nothing here may point back at it.
        del self.arcs, self.jumps
        return found

    def kind(self, mode: Key, roles: Roles) -> int:
        """Return the place of a kind, a new one where it was none."""
        kind = mode, roles
        place = self._places.get(kind)
        if place is None:
            known = len(self._places)
            # Those that others have added since.
            self._places |= {kind: known + i for i, kind in enumerate(self._kinds[known:])}
            place = self._places.setdefault(kind, len(self._kinds))
            if place == len(self._kinds):
                self._kinds.append(kind)
        return place

    def add_arc(self, mode: Key, roles: Roles, start: Clock, times: Array, terms: Array) -> None:
        """Add a flow; `times` and `terms` as those of an `Arc`."""
        steps, width = len(times) - 1, _width(terms)
        size = steps * self.variables * width
        if self._room(1, len(times), size, 0):
            block = self.memory
        else:
            # Longer than any pad: a block of its own.
            self.seal()
            block = _empty((1, len(times), size, 0), self.variables)
        arc, at, place, _ = block.used.tolist()
        block.arcs[arc] = self.kind(mode, roles), len(self.jumps), steps, width
        block.places[arc] = at, place
        block.starts[arc] = start
        block.times[at : at + len(times)] = times
        block.coefficients[place : place + size] = terms[:, :, :width].ravel()
        block.used[:3] += (1, len(times), size)
        if block is not self.memory:
            self._keep(block)

    def add_jump(self, jump: Jump) -> None:
        """Add a jump that is kept as it is."""
        self._room(0, 0, 0, 1)
        self.made[len(self.jumps)] = jump
        block = self.memory
        block.events[block.used[EVENTS]] = MADE
        block.used[EVENTS] += 1

    def replace_last(self, jump: Jump) -> None:
        """Replace the last jump."""
        self.made[len(self.jumps) - 1] = jump
        self.jumps.forget(len(self.jumps) - 1)

    def seal(self) -> None:
        """Copy what is on the pad to a block."""
        written = self.memory.used.tolist()
        if not any(written):
            return
        self._keep(copied(self.memory, written))
        self.memory.used[:] = 0

    def _room(self, arcs: int, times: int, terms: int, events: int) -> bool:
        """Make room on the pad; False where it can never hold that much."""
        memory = self.memory
        room = len(memory.arcs), len(memory.times), len(memory.coefficients), len(memory.events)
        wanted = arcs, times, terms, events
        used = memory.used.tolist()
        if all(u + w <= most for u, w, most in zip(used, wanted, room, strict=True)):
            return True
        self.seal()
        return all(w <= most for w, most in zip(wanted, room, strict=True))

    def _keep(self, block: Block) -> None:
        self._blocks.add(block)
        self._arcs.append(self._arcs[-1] + int(block.used[ARCS]))
        self._events.append(self._events[-1] + int(block.used[EVENTS]))

    def _arc(self, place: int) -> Arc:
        block, row = self._found(self._arcs, place)
        arc = arc_of(block, row, self.variables, self._kinds)
        if block is self.memory:  # which is written on again
            arc = replace(arc, times=arc.times.copy(), coefficients=arc.coefficients.copy())
        return arc

    def _event(self, j: int) -> Jump:
        made = self.made.get(j)
        if made is not None:
            return made
        assert self._jump is not None
        return self._jump(event_of(*self._found(self._events, j), j, self._kinds))

    def _found(self, begins: list[int], place: int) -> tuple[Block, int]:
        """Return the block that holds a place of a sequence, and its row there."""
        block = bisect_right(begins, place) - 1
        row = place - begins[block]
        return (self.memory if block == len(self._blocks) else self._blocks[block]), row


def _width(terms: Array) -> int:
    """Return how many terms of polynomials are not zero in all; one at least."""
    width = terms.shape[2]
    while width > 1 and not terms[:, :, width - 1].any():
        width -= 1
    return width
