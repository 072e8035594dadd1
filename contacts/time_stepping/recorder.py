"""From time steps to a trace: the mode of every region at every step, arcs and jumps.

Impacts are in the middle of their step, or later in it where that says so. A mode that begins
without an impact begins with its step; sticking begins with the step after the one that ended the
slip. A step that holds an impulse has no force, nor have those after it that still carry the
landing: what is shown is that of the nearest other step of the mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from contacts.states import (
    FREE,
    OFF_CODE,
    PIN,
    SLIDE_MINUS,
    SLIDE_PLUS,
    STATES,
    cause_of,
    undetermined,
)
from contacts.time_stepping.chunk import Chunk
from contacts.time_stepping.polynomials import defined, smooth, struck
from statechart.arrays import Array, Bools, Ints
from statechart.automaton.clock import Clock
from statechart.automaton.laws import roles_in
from statechart.automaton.trace import Arc, Jump, Key

# An arc longer than so many bytes goes on as another one.
_LONGEST = 2**23


@dataclass(eq=False)
class Recorder:
    """Collects steps as arcs and jumps.

    Parameters
    ----------
    regions : sequence of str
        Names of those that steps recognise.
    start : (r,) array
        Modes at the start.
    controls : Key
        States of further regions, which change only where they are told to.
    sticks : (r,) array of bool
        Whether the region has a pin beside slide.
    again : str
        Cause of an impact on a region that is not free.
    forces : int or None
        Place of the first region's V and H among the further unknowns; None: they have none.
    energy : callable
        (state, time) -> energy.
    coordinates : int
        How many there are; behind them and their rates stands what controllers remember.
    modes : bool
        Whether modes and jumps of regions are told; else it is counted how many jumps there are,
        and arcs end where they would.
    arcs_too : bool
        Whether somebody looks at arcs; else they are made of the last step alone, in which a stop
        condition may be met.

    Attributes
    ----------
    arcs, jumps : list
        Since they were last taken.
    told : list of Jump
        Those of further regions, as a trace tells them that has no others, and the stop.
    """

    regions: Sequence[str]
    start: Ints
    controls: Key
    sticks: Bools
    again: str
    forces: int | None
    energy: Callable[[Array, float], float]
    coordinates: int
    modes: bool = True
    arcs_too: bool = True
    clock: Clock = field(default_factory=Clock)
    arcs: list[Arc] = field(default_factory=list)
    jumps: list[Jump] = field(default_factory=list)
    told: list[Jump] = field(default_factory=list)
    count: int = 0
    indeterminate: dict[Key, tuple[str, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.row = self.start
        self._raw = self.start
        self.key = self._key(self.start)
        self.start_key = self.key
        self._began = self.clock
        self._open: list[tuple[Array, Array, Array]] = []
        self._size = 0

    def add(self, chunk: Chunk) -> None:
        """Append steps."""
        if not self.arcs_too:
            chunk = self._last(chunk)
        shown = self._shown(chunk.codes)
        hit: Bools = np.any(chunk.struck, axis=1)
        changed = self._changed(shown) | hit
        self._raw = chunk.codes[-1]
        after = np.concatenate([[False], hit[:-1]])
        breaks = np.unique(np.concatenate([[0], np.flatnonzero(changed | after), [len(shown)]]))
        halves = self._halves(chunk, hit)
        for first, last in zip(breaks[:-1].tolist(), breaks[1:].tolist(), strict=True):
            if hit[first]:
                self._strike(chunk, first, shown[first], next(halves))
                first += 1
            else:
                self._jumps(shown[first], chunk.states[first])
            if last > first:
                self._note_shared(chunk.shared[first:last])
                self._flow(chunk, first, last)

    def _last(self, chunk: Chunk) -> Chunk:
        """Count the jumps of all steps but the last, and return that one."""
        last = len(chunk.codes) - 1
        shown, hit = self._shown(chunk.codes)[:last], chunk.struck[:last].any(axis=1)
        changed = shown != np.vstack([self.row, shown[:-1]]) if last else np.zeros((0, 1))
        self.count += int(hit.sum()) + int(changed[~hit].sum())
        if last:
            self.row, self._raw = shown[-1], chunk.codes[last - 1]
        self._open, self._size = [], 0
        self.clock = self._began = self.clock.later(last * chunk.h).short
        return chunk.after(last)

    def changes(self, chunk: Chunk) -> Bools:
        """Return the steps (k,) in which `add` will record jumps."""
        return self._changed(self._shown(chunk.codes)) | np.any(chunk.struck, axis=1)

    def taken(self) -> tuple[list[Arc], list[Jump]]:
        """Hand over the arcs that have ended, and the jumps, since the last time."""
        found = self.arcs, self.jumps
        self.arcs, self.jumps = [], []
        return found

    def since(self, count: int) -> list[Jump]:
        """Return the jumps after so many."""
        return self.jumps[len(self.jumps) - (self.count - count) :] if self.modes else []

    def turn(
        self,
        region: str,
        cause: str,
        controls: Key,
        states: tuple[Array, Array],
        fired: tuple[str, ...],
    ) -> Jump:
        """Append a jump of a further region, from one state to another; return it."""
        self.close()
        target = (*self.key[: len(self.row)], *controls)
        jump = Jump(self.clock.high, self.count, region, cause, self.key, target, *states, fired)
        self._note(jump)
        self.told.append(replace(jump, j=len(self.told), source=self.controls, target=controls))
        self.controls, self.key = controls, target
        return jump

    def drop(self) -> Arc:
        """Take back the last arc, and the jumps before it; return the one that is the last now."""
        self.arcs.pop()
        last = self.arcs[-1]
        if self.modes:
            del self.jumps[len(self.jumps) - (self.count - last.j) :]
        self.count = last.j
        return last

    def rewind(self, last: Arc) -> None:
        """Go back to the end of the last arc, cut off, which stands in its place."""
        self.arcs[-1] = last
        self.key, self.clock = last.mode, last.end

    def stop(self, name: str, state: Array) -> None:
        """Append the jump of a stop condition."""
        self.close()
        key, controls = self.key, self.controls
        stopped = Jump(self.clock.high, self.count, "", "stop", key, key, state, state, (name,))
        self._note(stopped)
        self.told.append(replace(stopped, j=len(self.told), source=controls, target=controls))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is told of forces that the motion leaves open, once each."""
        return tuple(dict.fromkeys(map(undetermined, self.indeterminate.values())))

    def _key(self, row: Ints) -> Key:
        return (*map(STATES.__getitem__, row.tolist()), *self.controls)

    def _shown(self, codes: Ints) -> Ints:
        """Let a slip that comes to rest in a step last to its end."""
        before = np.vstack([self._raw, codes[:-1]])
        slid = (before == SLIDE_PLUS) | (before == SLIDE_MINUS)
        return np.where((codes == PIN) & slid & self.sticks, before, codes)

    def _changed(self, shown: Ints) -> Bools:
        found: Bools = np.any(shown != np.vstack([self.row, shown[:-1]]), axis=1)
        return found

    def _note_shared(self, shared: Bools) -> None:
        if shared.any() and self.modes:
            names = {self.regions[i] for i in np.flatnonzero(shared.any(axis=0)).tolist()}
            names.update(self.indeterminate.get(self.key, ()))
            self.indeterminate[self.key] = tuple(n for n in self.regions if n in names)

    def _flow(self, chunk: Chunk, first: int, last: int) -> None:
        """Append steps of one mode as one arc, or to the last arc."""
        h, left, right = chunk.h, chunk.states[first:last], chunk.states[first + 1 : last + 1]
        coefficients = smooth(left, right, h, self.coordinates)
        times: Array = h * np.arange(last - first + 1, dtype=float)
        self._arc(times, coefficients, chunk.solved[first:last])

    def _halves(self, chunk: Chunk, hit: Bools) -> Iterator[tuple[Array, Array]]:
        """Yield the coefficients (1, w, TERMS) of both parts of every step with impacts."""
        steps, n = np.flatnonzero(hit), self.coordinates
        left, right = chunk.states[steps], chunk.states[steps + 1]
        before = 0.5 * chunk.h + chunk.late[steps, None]
        lengths = before, chunk.h - before
        first, second = struck(left, right, chunk.solved[steps, :n], lengths, n)
        for i in range(len(steps)):
            yield first[i : i + 1], second[i : i + 1]

    def _strike(self, chunk: Chunk, k: int, row: Ints, halves: tuple[Array, Array]) -> None:
        """Append a step with impacts: one jump, whose impulses all regions feel."""
        before = 0.5 * chunk.h + chunk.late[k]
        times = np.array([0.0, before])
        self._arc(times, halves[0], self._held(chunk.solved[k]))
        self.close()
        if self.modes:
            self._struck(chunk, k, row, halves[0][0].sum(axis=1), halves[1][0, :, 0].copy())
        else:
            self.row, self.count = row, self.count + 1
        times = np.array([0.0, chunk.h - before])
        self._arc(times, halves[1], self._held(chunk.solved[k]))

    def _struck(self, chunk: Chunk, k: int, row: Ints, before: Array, after: Array) -> None:
        """Append the jump of a step with impacts, at the state before and after it."""
        felt = np.flatnonzero(chunk.impulses[k].any(axis=1))
        impulses = {
            self.regions[i]: (normal, tangential)
            for i, (normal, tangential) in zip(
                felt.tolist(), chunk.impulses[k, felt].tolist(), strict=True
            )
        }
        place = int(chunk.struck[k].argmax())
        time = self.clock.high
        self._jump(
            place,
            self._cause(int(self.row[place]), int(row[place]), True),
            row,
            before,
            after,
            impulses,
            (self.energy(before, time), self.energy(after, time)),
        )

    def _held(self, solved: Array) -> Array:
        """Return the unknowns (1, u) without forces where the mode at hand is open."""
        found = solved[None].copy()
        if self.forces is not None:
            for i in np.flatnonzero((self.row == FREE) | (self.row == OFF_CODE)).tolist():
                at = self.forces + 2 * i
                found[0, at : at + 2] = 0.0
        return found

    def _arc(self, times: Array, coefficients: Array, solved: Array) -> None:
        self._open.append((times, coefficients, solved))
        self.clock = self.clock.later(float(times[-1])).short
        self._size += coefficients.nbytes
        if self._size > _LONGEST:
            self.close()

    def close(self) -> None:
        """End the arc at hand."""
        if not self._open:
            return
        pieces, self._open, self._size = self._open, [], 0
        ends, reached = [np.zeros(1)], 0.0
        for times, _, _ in pieces:
            ends.append(reached + times[1:])
            reached = float(ends[-1][-1])
        self.arcs.append(
            Arc(
                self.key,
                roles_in(self.key),
                self._began,
                self.count,
                np.concatenate(ends),
                np.concatenate([piece[1] for piece in pieces]),
                defined(np.concatenate([piece[2] for piece in pieces])),
            )
        )
        self._began = self.clock

    def _jumps(self, row: Ints, state: Array) -> None:
        """Append a jump for every region that changes."""
        changed = np.flatnonzero(row != self.row).tolist()
        if not self.modes and changed:
            self.close()
            self.row, self.count = row, self.count + len(changed)
            return
        for i in changed:
            self.close()
            following = self.row.copy()
            following[i] = row[i]
            cause = self._cause(int(self.row[i]), int(row[i]), False)
            self._jump(i, cause, following, state, state, {}, None)

    def _jump(
        self,
        place: int,
        cause: str,
        row: Ints,
        before: Array,
        after: Array,
        impulses: Mapping[str, tuple[float, float]],
        energy: tuple[float, float] | None,
    ) -> None:
        target = self._key(row)
        self._note(
            Jump(
                self.clock.high,
                self.count,
                self.regions[place],
                cause,
                self.key,
                target,
                before,
                after,
                impulse=impulses,
                energy=energy,
            )
        )
        self.row, self.key = row, target

    def _note(self, jump: Jump) -> None:
        self.jumps.append(jump)
        self.count += 1

    def _cause(self, before: int, after: int, struck: bool) -> str:
        found = cause_of(STATES[before], STATES[after])
        lasting = found in ("liftoff", "stick", "slip", "reverse")
        return self.again if struck and lasting else found
